"""Series resistance and inductance between two nodes: a cable, a choke, a fault path; with a contact in series.

    L di/dt = v - R i            (1)

`v` is the voltage from the first node to the second, `i` flows the same way. With the contact open the current is
held at zero. Written per axis for three phases.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Volt


class State:
    """State of the branch."""

    i: Ampere = signal("current from the first node to the second")


class Input:
    """Input of the branch."""

    v: Volt = signal("voltage from the first node to the second")


class Output:
    """Output of the branch."""

    i_in: Ampere = signal("current into the branch at the first node")


@kernel
def derivatives(t, x: State, u: Input, p: RlBranch, dx: State):
    dx.i = (u.v - p.R * x.i) / p.L  # (1)


@kernel
def outputs(t, x: State, u: Input, p: RlBranch, y: Output):
    y.i_in = x.i


@kernel
def stored_energy(x: State, p: RlBranch):
    return 0.5 * p.L * x.i**2


@kernel
def losses(x: State, u: Input, p: RlBranch):
    return p.R * x.i**2


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("branch", v="v", i="i_in"),),
    variants={"open": ("i",)},
    passive=True,
)
class RlBranch:
    """Series R-L branch between two nodes."""

    R: Ohm = param("resistance", at_least=0.0)
    L: Henry = param("inductance", above=0.0)
