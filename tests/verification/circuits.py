"""Small circuits with closed forms, shared by the verification tests."""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Ratio, Volt


class BranchState:
    i: Ampere = signal("branch current")


class BranchInput:
    v: Volt = signal("voltage across the branch")
    e: Volt = signal("source voltage, driving current in", initial=0.0)


class BranchOutput:
    i_in: Ampere = signal("current into the branch")


@kernel
def branch_derivatives(x, u, p, dx):
    dx.i = (u.v + u.e - p.R * x.i) / p.L


@kernel
def branch_outputs(x, y):
    y.i_in = x.i


@kernel
def branch_losses(x, p):
    return p.R * x.i**2


@kernel
def branch_energy(x, p):
    return 0.5 * p.L * x.i**2


@kernel
def branch_supplied(x, u):
    return u.e * x.i


@component(
    state=BranchState,
    input=BranchInput,
    output=BranchOutput,
    derivatives=branch_derivatives,
    outputs=branch_outputs,
    losses=branch_losses,
    stored_energy=branch_energy,
    supplied=branch_supplied,
    terminals=(Terminal("ends", v="v", i="i_in"),),
    variants={"open": ("i",)},
)
class SourceBranch:
    """R, L and a source in series, with a contact."""

    R: Ohm = param("resistance", at_least=0.0)
    L: Henry = param("inductance", above=0.0)


class HoldInput:
    wanted: Ratio = signal("value to give")


class HoldOutput:
    value: Ratio = signal("the same")
    s: Ratio = signal("the same, as a switching function")


@kernel
def hold_outputs(u, y):
    y.value = u.wanted
    y.s = u.wanted


@component(input=HoldInput, output=HoldOutput, outputs=hold_outputs, stage="outer")
class Hold:
    """Gives its input on."""


class ClockState:
    last: Volt = signal("last sample")
    count: Ratio = signal("samples taken")


class ClockInput:
    v: Volt = signal("what is sampled")


class ClockOutput:
    sample: Volt = signal("sampled value")
    at: Volt = signal("its time, as the controller sees it")


@kernel
def clock_update(t, x, u, x_next, y):
    y.sample = u.v
    y.at = t
    x_next.last = u.v
    x_next.count = x.count + 1.0


@component(state=ClockState, input=ClockInput, output=ClockOutput, update=clock_update, stage="inner")
class Sampler:
    """Samples a voltage."""
