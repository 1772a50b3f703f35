"""Choke with an end at each side, either of which may be a converter's pole.

    L di/dt = v_a - v_b - R i            (1)

`i` flows from a to b. Unlike a branch between two buses it has two terminals, so that a half-bridge leg or a bridge
may stand at either end. Written per axis for three phases.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Volt


class State:
    """State of the choke."""

    i: Ampere = signal("current from a to b")


class Input:
    """Input of the choke."""

    v_a: Volt = signal("voltage at a")
    v_b: Volt = signal("voltage at b")


class Output:
    """Output of the choke."""

    i_a: Ampere = signal("current into the choke at a")
    i_b: Ampere = signal("current into the choke at b")


@kernel
def derivatives(t, x: State, u: Input, p: Choke, dx: State):
    dx.i = (u.v_a - u.v_b - p.R * x.i) / p.L  # (1)


@kernel
def outputs(t, x: State, u: Input, p: Choke, y: Output):
    y.i_a = x.i
    y.i_b = -x.i


@kernel
def stored_energy(x: State, p: Choke):
    return 0.5 * p.L * x.i**2


@kernel
def losses(x: State, p: Choke):
    return p.R * x.i**2


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("a", v="v_a", i="i_a"), Terminal("b", v="v_b", i="i_b")),
    variants={"open": ("i",)},
    passive=True,
)
class Choke:
    """Choke between two buses or converter poles."""

    R: Ohm = param("resistance of choke and closed switch", at_least=0.0)
    L: Henry = param("inductance", above=0.0)
