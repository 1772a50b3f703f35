"""Breaker: the closed contact is a small resistance, the open one is nothing.

    closed: i = v / R_on,    open: i = 0            (1)

It has the command `<path>.close`, or follows a signal. All poles move at once, at the start of a step. A current that
it interrupts is gone within the step, and with it what was stored in the inductances in series: there is no arc.
Where that matters, give the current another way; `ThreePoleBreaker` opens each pole at its current's zero.
Written per axis for three phases.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Ohm, Volt


class Input:
    """Input of the breaker."""

    v: Volt = signal("voltage from the first node to the second")


class Output:
    """Output of the breaker."""

    i: Ampere = signal("current from the first node to the second")


@kernel
def outputs(t, u: Input, p: Breaker, y: Output):
    y.i = u.v / p.R_on  # (1)


@kernel
def losses(y: Output, p: Breaker):
    return p.R_on * y.i**2  # from the current: there is none while the contact is open


@component(
    input=Input,
    output=Output,
    outputs=outputs,
    losses=losses,
    terminals=(Terminal("branch", v="v", i="i"),),
    variants={"open": ()},
    passive=True,
    operated=True,
)
class Breaker:
    """Breaker between two buses, DC or three-phase."""

    R_on: Ohm = param(
        "resistance of a closed contact",
        default=1e-4,
        at_least=1e-6,
        source="typical; less drowns the current in the rounding of the voltages beside it",
    )
