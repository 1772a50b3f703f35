"""Double-layer capacitor: two branches of a resistance and a capacitance, and a leakage resistance, side by side.

    C_1 dv_1/dt = (v - v_1) / R_1              (1)
    C_2 dv_2/dt = (v - v_2) / R_2              (2)
    i = (v - v_1) / R_1 + (v - v_2) / R_2 + v / R_leak      (3)

`v` is the voltage at its poles, `i` the current into it. The first branch is what a converter sees within seconds; the
second one takes charge over from it in minutes, so that the voltage sinks after a fast charge. Capacitances are
constant: that of a cell grows with its voltage, by a fifth to a third from half to full voltage, so that C_1 belongs to
the range of voltage that is used.

Source: [Zubieta2000], the immediate and the delayed branch.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Farad, Ohm, Volt


class State:
    """State of the capacitor."""

    v_1: Volt = signal("voltage of the immediate branch' capacitance")
    v_2: Volt = signal("voltage of the delayed branch' capacitance")


class Input:
    """Input of the capacitor."""

    v: Volt = signal("voltage at its poles")


class Output:
    """Output of the capacitor."""

    i_in: Ampere = signal("current into it")


@kernel
def derivatives(x: State, u: Input, p: Supercapacitor, dx: State):
    dx.v_1 = (u.v - x.v_1) / (p.R_1 * p.C_1)  # (1)
    dx.v_2 = (u.v - x.v_2) / (p.R_2 * p.C_2)  # (2)


@kernel
def outputs(x: State, u: Input, p: Supercapacitor, y: Output):
    y.i_in = (u.v - x.v_1) / p.R_1 + (u.v - x.v_2) / p.R_2 + u.v / p.R_leak  # (3)


@kernel
def stored_energy(x: State, p: Supercapacitor):
    return 0.5 * (p.C_1 * x.v_1**2 + p.C_2 * x.v_2**2)


@kernel
def losses(x: State, u: Input, p: Supercapacitor):
    return (u.v - x.v_1) ** 2 / p.R_1 + (u.v - x.v_2) ** 2 / p.R_2 + u.v**2 / p.R_leak


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("branch", v="v", i="i_in"),),
    passive=True,
)
class Supercapacitor:
    """Double-layer capacitor with an immediate and a delayed branch."""

    C_1: Farad = param("capacitance of the immediate branch", above=0.0)
    R_1: Ohm = param("resistance of the immediate branch", above=0.0)
    C_2: Farad = param("capacitance of the delayed branch", above=0.0)
    R_2: Ohm = param("resistance of the delayed branch", above=0.0)
    R_leak: Ohm = param("leakage resistance", above=0.0)
