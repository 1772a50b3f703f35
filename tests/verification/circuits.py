"""Small circuits with closed forms, shared by the verification tests."""

from __future__ import annotations

import numpy as np

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, RadianPerSecond, Ratio, Volt


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


class WaveOutput:
    e_alpha: Volt = signal("alpha axis")
    e_beta: Volt = signal("beta axis")


@kernel
def wave_outputs(t, p, y):
    y.e_alpha = p.peak * np.cos(p.omega * t)
    y.e_beta = p.peak * np.sin(p.omega * t)


@component(output=WaveOutput, outputs=wave_outputs, stage="measure")
class Wave:
    """A balanced three-phase voltage, for the sources of branches: held over each step."""

    peak: Volt = param("peak of a phase", above=0.0)
    omega: RadianPerSecond = param("angular frequency", above=0.0)


class GateOutput:
    lo_a: Ratio = signal("least, leg a", initial=0.0)
    hi_a: Ratio = signal("greatest, leg a", initial=1.0)
    lo_b: Ratio = signal("least, leg b", initial=0.0)
    hi_b: Ratio = signal("greatest, leg b", initial=1.0)
    lo_c: Ratio = signal("least, leg c", initial=0.0)
    hi_c: Ratio = signal("greatest, leg c", initial=1.0)
    lead_a: Ratio = signal("lead, leg a")
    lead_b: Ratio = signal("lead, leg b")
    lead_c: Ratio = signal("lead, leg c")


@component(output=GateOutput, stage="modulate")
class Gates:
    """Bounds of a bridge's legs as a test writes them; blocked to begin with."""


class LegGateOutput:
    lo: Ratio = signal("least", initial=0.0)
    hi: Ratio = signal("greatest", initial=1.0)
    lead: Ratio = signal("lead")


@component(output=LegGateOutput, stage="modulate")
class LegGates:
    """Bounds of a leg as a test writes them; blocked to begin with."""


class ToggleState:
    high: Ratio = signal("1 if the last one was high")


class ToggleOutput:
    s: Ratio = signal("reference: 0.2 and 0.8 in turn")


@kernel
def toggle_update(x, x_next, y):
    y.s = 0.2 + 0.6 * x.high
    x_next.high = 1.0 - x.high


@component(state=ToggleState, output=ToggleOutput, update=toggle_update, stage="inner")
class Toggle:
    """A reference that changes at each instant."""
