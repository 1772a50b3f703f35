"""DC sources: a voltage behind a resistance, or behind a resistance and an inductance; a current.

    DcSource             i = (v - v_pu v_0) / R                         (1)
    InductiveDcSource    L di/dt = v - v_pu v_0 - R i                   (2)
    CurrentSource        i = -i_pu i_0                                  (3)

`i` is the current into the source, so that a source that delivers has i < 0. `v_pu` and `i_pu` scale what the source
gives: a constant that an event sets, or a signal, held over a step. A CurrentSource with i_0 < 0 is a load of constant
current.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, PerUnit, Volt


class VoltageInput:
    """Input of a voltage source."""

    v: Volt = signal("voltage at the terminal")
    v_pu: PerUnit = signal("source voltage over its nominal value", initial=1.0)


class SourceOutput:
    """Output of a source."""

    i_in: Ampere = signal("current into the source; negative where it delivers")


@kernel
def outputs(t, u: VoltageInput, p: DcSource, y: SourceOutput):
    y.i_in = (u.v - u.v_pu * p.v_0) / p.R  # (1)


@kernel
def losses(u: VoltageInput, p: DcSource):
    return (u.v - u.v_pu * p.v_0) ** 2 / p.R


@kernel
def supplied(u: VoltageInput, p: DcSource):
    return u.v_pu * p.v_0 * (u.v_pu * p.v_0 - u.v) / p.R


@component(
    input=VoltageInput,
    output=SourceOutput,
    outputs=outputs,
    losses=losses,
    supplied=supplied,
    terminals=(Terminal("branch", v="v", i="i_in"),),
)
class DcSource:
    """DC voltage behind a resistance."""

    v_0: Volt = param("voltage", default=750.0, source="nominal voltage of the ferry's DC buses")
    R: Ohm = param("series resistance", at_least=1e-6)


class InductiveState:
    """State of the source behind an inductance."""

    i: Ampere = signal("current into the source; negative where it delivers")


@kernel
def inductive_derivatives(t, x: InductiveState, u: VoltageInput, p: InductiveDcSource, dx: InductiveState):
    dx.i = (u.v - u.v_pu * p.v_0 - p.R * x.i) / p.L  # (2)


@kernel
def inductive_outputs(t, x: InductiveState, u: VoltageInput, p: InductiveDcSource, y: SourceOutput):
    y.i_in = x.i


@kernel
def inductive_stored_energy(x: InductiveState, p: InductiveDcSource):
    return 0.5 * p.L * x.i**2


@kernel
def inductive_losses(x: InductiveState, p: InductiveDcSource):
    return p.R * x.i**2


@kernel
def inductive_supplied(x: InductiveState, u: VoltageInput, p: InductiveDcSource):
    return -u.v_pu * p.v_0 * x.i


@component(
    state=InductiveState,
    input=VoltageInput,
    output=SourceOutput,
    derivatives=inductive_derivatives,
    outputs=inductive_outputs,
    stored_energy=inductive_stored_energy,
    losses=inductive_losses,
    supplied=inductive_supplied,
    terminals=(Terminal("branch", v="v", i="i_in"),),
    variants={"open": ("i",)},
)
class InductiveDcSource:
    """DC voltage behind a resistance and an inductance."""

    v_0: Volt = param("voltage", default=750.0, source="nominal voltage of the ferry's DC buses")
    R: Ohm = param("series resistance", at_least=0.0)
    L: Henry = param("series inductance", above=0.0)


class CurrentInput:
    """Input of a current source."""

    v: Volt = signal("voltage at the terminal")
    i_pu: PerUnit = signal("source current over its nominal value", initial=1.0)


@kernel
def current_outputs(t, u: CurrentInput, p: CurrentSource, y: SourceOutput):
    y.i_in = -u.i_pu * p.i_0  # (3)


@kernel
def current_supplied(u: CurrentInput, p: CurrentSource):
    return u.v * u.i_pu * p.i_0


@component(
    input=CurrentInput,
    output=SourceOutput,
    outputs=current_outputs,
    supplied=current_supplied,
    terminals=(Terminal("branch", v="v", i="i_in"),),
)
class CurrentSource:
    """DC current, delivered to the bus at the first node; negative: a load of constant current."""

    i_0: Ampere = param("current", default=1.0, source="one ampere, for `i_pu` to scale")
