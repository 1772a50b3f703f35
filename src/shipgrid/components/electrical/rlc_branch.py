"""Series resistance, inductance and capacitance between two nodes: a tuned filter, a snubber with its leads.

    L di/dt = v - R i - v_c            (1)
    C dv_c/dt = i                      (2)

`v` is the voltage from the first node to the second, `i` flows the same way. With the contact open no current flows
and the capacitor is discharged. Written per axis for three phases (star).
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Farad, Henry, Ohm, Volt


class State:
    """State of the branch."""

    i: Ampere = signal("current from the first node to the second")
    v_c: Volt = signal("voltage of the capacitance")


class Input:
    """Input of the branch."""

    v: Volt = signal("voltage from the first node to the second")


class Output:
    """Output of the branch."""

    i_in: Ampere = signal("current into the branch at the first node")


@kernel
def derivatives(t, x: State, u: Input, p: RlcBranch, dx: State):
    dx.i = (u.v - p.R * x.i - x.v_c) / p.L  # (1)
    dx.v_c = x.i / p.C  # (2)


@kernel
def outputs(t, x: State, u: Input, p: RlcBranch, y: Output):
    y.i_in = x.i


@kernel
def stored_energy(x: State, p: RlcBranch):
    return 0.5 * (p.L * x.i**2 + p.C * x.v_c**2)


@kernel
def losses(x: State, u: Input, p: RlcBranch):
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
    variants={"open": ("i", "v_c")},
    passive=True,
)
class RlcBranch:
    """Series R-L-C branch between two nodes."""

    R: Ohm = param("resistance", at_least=0.0)
    L: Henry = param("inductance", above=0.0)
    C: Farad = param("capacitance", above=0.0)
