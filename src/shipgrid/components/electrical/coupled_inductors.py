"""Two inductors on one core, or two lines side by side: self and mutual inductance.

    L_1 di_1/dt + M di_2/dt = v_1 - R_1 i_1            (1)
    M di_1/dt + L_2 di_2/dt = v_2 - R_2 i_2            (2)
    M = k sqrt(L_1 L_2)                                (3)

Each winding is a branch of its own, `first` and `second`, between the poles of a bus or `Across` two; the current of
a winding counts into its first node, and both currents into their first nodes magnetise the same way for k > 0.
Written per axis for three phases.
"""

from __future__ import annotations

import math

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Ratio, Volt


class State:
    """State of the windings."""

    i_1: Ampere = signal("current into the first winding")
    i_2: Ampere = signal("current into the second winding")


class Input:
    """Input of the windings."""

    v_1: Volt = signal("voltage across the first winding")
    v_2: Volt = signal("voltage across the second winding")


class Output:
    """Output of the windings."""

    i_1_in: Ampere = signal("current into the first winding")
    i_2_in: Ampere = signal("current into the second winding")


class Derived:
    """What follows from the coupling."""

    M: Henry = signal("mutual inductance")


def derive(p: CoupledInductors) -> dict[str, float]:
    """Mutual inductance: (3)."""
    return {"M": p.k * math.sqrt(p.L_1 * p.L_2)}


@kernel
def derivatives(t, x: State, u: Input, p: CoupledInductors, dx: State):
    e_1 = u.v_1 - p.R_1 * x.i_1  # (1), (2) solved for the rates
    e_2 = u.v_2 - p.R_2 * x.i_2
    determinant = p.L_1 * p.L_2 - p.M**2
    dx.i_1 = (p.L_2 * e_1 - p.M * e_2) / determinant
    dx.i_2 = (p.L_1 * e_2 - p.M * e_1) / determinant


@kernel
def outputs(t, x: State, u: Input, p: CoupledInductors, y: Output):
    y.i_1_in = x.i_1
    y.i_2_in = x.i_2


@kernel
def stored_energy(x: State, p: CoupledInductors):
    return 0.5 * (p.L_1 * x.i_1**2 + p.L_2 * x.i_2**2) + p.M * x.i_1 * x.i_2


@kernel
def losses(x: State, p: CoupledInductors):
    return p.R_1 * x.i_1**2 + p.R_2 * x.i_2**2


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("first", v="v_1", i="i_1_in"), Terminal("second", v="v_2", i="i_2_in")),
    passive=True,
)
class CoupledInductors(Derived):
    """Two magnetically coupled inductors."""

    L_1: Henry = param("self inductance of the first winding", above=0.0)
    L_2: Henry = param("self inductance of the second winding", above=0.0)
    k: Ratio = param(
        "coupling, M / sqrt(L_1 L_2)", default=0.9, above=-1.0, below=1.0, source="typical of windings on one core"
    )
    R_1: Ohm = param("resistance of the first winding", default=0.0, at_least=0.0, source="ideal")
    R_2: Ohm = param("resistance of the second winding", default=0.0, at_least=0.0, source="ideal")
