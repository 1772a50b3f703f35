"""Resistor between two nodes; with a contact in series.

    i = v / R            (1)

`v` is the voltage from the first node to the second, `i` flows the same way. Its power counts as a loss. Written
per axis for three phases.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Ohm, Volt


class Input:
    """Input of the resistor."""

    v: Volt = signal("voltage from the first node to the second")


class Output:
    """Output of the resistor."""

    i: Ampere = signal("current from the first node to the second")


@kernel
def outputs(t, u: Input, p: Resistor, y: Output):
    y.i = u.v / p.R  # (1)


@kernel
def losses(y: Output, p: Resistor):
    return p.R * y.i**2  # from the current: there is none while the contact is open


@component(
    input=Input,
    output=Output,
    outputs=outputs,
    losses=losses,
    terminals=(Terminal("branch", v="v", i="i"),),
    variants={"open": ()},
    passive=True,
)
class Resistor:
    """Resistor between two nodes."""

    R: Ohm = param("resistance", at_least=1e-6)
