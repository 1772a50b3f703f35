"""Secondary winding of a transformer: leakage and resistance behind an ideal ratio and the turn of the vector group.

Space vectors, side 1 at the core, side 2 at the line, a and phi as in `components/electrical/transformer.py`:

    L_2 di_2/dt = v_2 - R_2 i_2 - v_1 exp(j phi) / a            (1)
    i_1 = -exp(-j phi) i_2 / a                                  (2)

With an R-L branch for the primary winding and a magnetising branch between the two it is a transformer in parts: that
is how a core comes in which is no linear element.

Source: docs/theory/network.md.
"""

from __future__ import annotations

from shipgrid.components.electrical.transformer import Derived, derive
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Ratio, Volt


class State:
    """State of the winding."""

    i_2_alpha: Ampere = signal("line current into the winding, alpha axis")
    i_2_beta: Ampere = signal("line current into the winding, beta axis")


class Input:
    """Input of the winding."""

    v_1_alpha: Volt = signal("voltage at the core, alpha axis")
    v_1_beta: Volt = signal("voltage at the core, beta axis")
    v_2_alpha: Volt = signal("line voltage, alpha axis")
    v_2_beta: Volt = signal("line voltage, beta axis")


class Output:
    """Output of the winding."""

    i_1_alpha_in: Ampere = signal("current into the core's terminal, alpha axis")
    i_1_beta_in: Ampere = signal("current into the core's terminal, beta axis")
    i_2_alpha_in: Ampere = signal("current into the line terminal, alpha axis")
    i_2_beta_in: Ampere = signal("current into the line terminal, beta axis")


@kernel
def derivatives(t, x: State, u: Input, p: SecondaryWinding, dx: State):
    dx.i_2_alpha = (u.v_2_alpha - p.R_2 * x.i_2_alpha - p.c * u.v_1_alpha + p.s * u.v_1_beta) / p.L_2  # (1)
    dx.i_2_beta = (u.v_2_beta - p.R_2 * x.i_2_beta - p.c * u.v_1_beta - p.s * u.v_1_alpha) / p.L_2


@kernel
def outputs(t, x: State, u: Input, p: SecondaryWinding, y: Output):
    y.i_1_alpha_in = -p.c * x.i_2_alpha - p.s * x.i_2_beta  # (2)
    y.i_1_beta_in = -p.c * x.i_2_beta + p.s * x.i_2_alpha
    y.i_2_alpha_in = x.i_2_alpha
    y.i_2_beta_in = x.i_2_beta


@kernel
def stored_energy(x: State, p: SecondaryWinding):
    return 0.5 * p.L_2 * (x.i_2_alpha**2 + x.i_2_beta**2)


@kernel
def losses(x: State, p: SecondaryWinding):
    return p.R_2 * (x.i_2_alpha**2 + x.i_2_beta**2)


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
    terminals=(
        Terminal("core_alpha", v="v_1_alpha", i="i_1_alpha_in"),
        Terminal("core_beta", v="v_1_beta", i="i_1_beta_in"),
        Terminal("line_alpha", v="v_2_alpha", i="i_2_alpha_in"),
        Terminal("line_beta", v="v_2_beta", i="i_2_beta_in"),
    ),
    passive=True,
)
class SecondaryWinding(Derived):
    """Ideal ratio with the secondary's leakage, between the bus of a core and the line."""

    v_1n: Volt = param("rated voltage at the core, line to line, rms", default=400.0, above=0.0, source="typical")
    v_2n: Volt = param("rated line voltage, line to line, rms", default=400.0, above=0.0, source="typical")
    R_2: Ohm = param("resistance, equivalent star", at_least=0.0)
    L_2: Henry = param("leakage inductance, equivalent star", above=0.0)
    clock: Ratio = param("clock number of the vector group", default=0.0, at_least=0.0, at_most=11.0, source="Yy0")
