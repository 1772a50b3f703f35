"""Capacitor with its series resistance, between two nodes.

    C dv_c/dt = i,    i = (v - v_c) / R            (1)

Every capacitor has some resistance, and a bus between two of them needs it. Capacitance without resistance belongs to
a bus (`Network.capacitance`), where capacitors in parallel are one. `R C` may be far below the step.
Written per axis for three phases (star).
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Farad, Ohm, Volt


class State:
    """State of the capacitor."""

    v_c: Volt = signal("voltage of the capacitance, from the first node to the second")


class Input:
    """Input of the capacitor."""

    v: Volt = signal("voltage from the first node to the second")


class Output:
    """Output of the capacitor."""

    i: Ampere = signal("current from the first node to the second")


@kernel
def derivatives(t, x: State, u: Input, p: Capacitor, dx: State):
    dx.v_c = (u.v - x.v_c) / (p.R * p.C)  # (1)


@kernel
def outputs(t, x: State, u: Input, p: Capacitor, y: Output):
    y.i = (u.v - x.v_c) / p.R


@kernel
def stored_energy(x: State, p: Capacitor):
    return 0.5 * p.C * x.v_c**2


@kernel
def losses(y: Output, p: Capacitor):
    return p.R * y.i**2


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("branch", v="v", i="i"),),
    passive=True,
)
class Capacitor:
    """Capacitor with series resistance between two nodes."""

    C: Farad = param("capacitance", above=0.0)
    R: Ohm = param("series resistance; capacitance without any belongs to a bus", at_least=1e-6)
