"""Three-phase load whose power follows the length of its voltage: ZIP, exponential, constant power.

    P = P_0 F_p(r) r^2,   Q = Q_0 F_q(r) r^2,   F = z + i / r + (1 - z - i) r^(alpha - 2)     (1)
    i_alpha = g v_alpha + b v_beta,   i_beta = g v_beta - b v_alpha                           (2)
    g = P_0 F_p / v_n^2,   b = Q_0 F_q / v_n^2,   r = max(sqrt(w), r_min)                     (3)
    T_v dw/dt = |v|^2 / V_b^2 - w,   V_b = sqrt(2/3) v_n                                        (4)

`z` and `i` are the shares of constant impedance and of constant current, the rest goes with the exponent `alpha`:
ZIP with alpha = 0, an exponential load with z = i = 0, constant power, the default, with all of them zero. A
controlled load knows its voltage through a filter: at once it is the admittance that it was, and within T_v its power
comes back to (1). So what oscillates faster than 1/T_v meets a positive conductance, what moves slower a negative one.
Below `r_min` it is a constant impedance: no consumer draws constant power from a grid that is going down.

For the network, (2) is linear in the voltage and follows w, which an implicit Euler step moves by little (gh / T_v):
its Norton equivalent is (2) with the w at the end of the step that belongs to the last voltage known, and the
derivative of that. What is left out is of second order in the step, and at rest smaller still: gh / T_v (omega gh)^2.

Source: [Kundur1994] sec. 7.1; docs/theory/loads.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.ops import maximum
from shipgrid.units import Ampere, PerUnit, Ratio, Second, Siemens, Var, Volt, Watt


class State:
    """State of the load."""

    w: PerUnit = signal("square of the voltage's length over its nominal one, through the filter", initial=1.0)


class Input:
    """Input of the load."""

    v_alpha: Volt = signal("bar voltage, alpha axis")
    v_beta: Volt = signal("bar voltage, beta axis")
    demand: PerUnit = signal("what is switched on, over its nominal value", initial=1.0)


class Output:
    """Output of the load."""

    i_alpha: Ampere = signal("current into the load, alpha axis")
    i_beta: Ampere = signal("current into the load, beta axis")
    p_ac: Watt = signal("active power taken")
    q_ac: Var = signal("reactive power taken")


class Derived:
    """Its admittance at nominal voltage."""

    G_0: Siemens = signal("conductance of a phase at nominal voltage")
    B_0: Siemens = signal("susceptance of a phase at nominal voltage, inductive positive")
    r_w: Ratio = signal("1 / V_b^2, to bring the square of a voltage to (4)")


def derive(p: VoltageDependentLoad) -> dict[str, float]:
    """Admittance at nominal voltage: (3) with F = 1."""
    q_0 = p.p_0 * math.tan(math.acos(p.power_factor))
    return {"G_0": p.p_0 / p.v_n**2, "B_0": q_0 / p.v_n**2, "r_w": 1.5 / p.v_n**2}


@kernel
def dependence(w, z, i, alpha, r_min):
    """Admittance over its nominal value, F of (1), and its derivative by w."""
    r = np.sqrt(maximum(w, r_min * r_min))
    rest = (1.0 - z - i) * np.exp((alpha - 2.0) * np.log(r))
    slope = (-i / r + (alpha - 2.0) * rest) / (2.0 * r * r)
    return z + i / r + rest, slope if w.real > (r_min * r_min).real else 0.0 * slope


@kernel
def derivatives(x: State, u: Input, p: VoltageDependentLoad, dx: State):
    dx.w = (p.r_w * (u.v_alpha**2 + u.v_beta**2) - x.w) / p.T_v  # (4)


@kernel
def outputs(x: State, u: Input, p: VoltageDependentLoad, y: Output):
    f_p, _ = dependence(x.w, p.z_p, p.i_p, p.alpha_p, p.r_min)
    f_q, _ = dependence(x.w, p.z_q, p.i_q, p.alpha_q, p.r_min)
    g, b = u.demand * p.G_0 * f_p, u.demand * p.B_0 * f_q  # (3)
    y.i_alpha = g * u.v_alpha + b * u.v_beta  # (2)
    y.i_beta = g * u.v_beta - b * u.v_alpha
    y.p_ac = 1.5 * g * (u.v_alpha**2 + u.v_beta**2)
    y.q_ac = 1.5 * b * (u.v_alpha**2 + u.v_beta**2)


@kernel
def stamp(gh, x: State, u: Input, p: VoltageDependentLoad, n):
    k = gh / p.T_v
    squared = u.v_alpha**2 + u.v_beta**2
    w = (x.w + k * p.r_w * squared) / (1.0 + k)
    f_p, slope_p = dependence(w, p.z_p, p.i_p, p.alpha_p, p.r_min)
    f_q, slope_q = dependence(w, p.z_q, p.i_q, p.alpha_q, p.r_min)
    g, b = u.demand * p.G_0 * f_p, u.demand * p.B_0 * f_q
    by_v = u.demand * 2.0 * k * p.r_w / (1.0 + k)  # dw/dv = by_v v
    g_w, b_w = by_v * p.G_0 * slope_p, by_v * p.B_0 * slope_q
    m_alpha, m_beta = g_w * u.v_alpha + b_w * u.v_beta, g_w * u.v_beta - b_w * u.v_alpha
    n.g_aa = g + m_alpha * u.v_alpha
    n.g_ab = b + m_alpha * u.v_beta
    n.g_ba = -b + m_beta * u.v_alpha
    n.g_bb = g + m_beta * u.v_beta
    n.h_a = -m_alpha * squared
    n.h_b = -m_beta * squared


@kernel
def advance(gh, x: State, u: Input, p: VoltageDependentLoad, x_next: State):
    k = gh / p.T_v
    x_next.w = (x.w + k * p.r_w * (u.v_alpha**2 + u.v_beta**2)) / (1.0 + k)


@kernel
def consumed(x: State, u: Input, p: VoltageDependentLoad):
    f_p, _ = dependence(x.w, p.z_p, p.i_p, p.alpha_p, p.r_min)
    return 1.5 * u.demand * p.G_0 * f_p * (u.v_alpha**2 + u.v_beta**2)


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stamp=stamp,
    advance=advance,
    consumed=consumed,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha"), Terminal("beta", v="v_beta", i="i_beta")),
)
class VoltageDependentLoad(Derived):
    """Three-phase load by its power's dependence on the voltage; constant power unless told otherwise."""

    p_0: Watt = param("active power at nominal voltage", default=10e3, above=0.0, source="typical hotel load of a bar")
    power_factor: Ratio = param(
        "cos phi at nominal voltage, lagging", default=0.9, above=0.0, at_most=1.0, source="typical"
    )
    v_n: Volt = param("nominal voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    z_p: Ratio = param("share of constant impedance in the active power", default=0.0, source="constant power")
    i_p: Ratio = param("share of constant current in the active power", default=0.0, source="constant power")
    alpha_p: Ratio = param("exponent of the rest of the active power", default=0.0, source="constant power")
    z_q: Ratio = param("share of constant impedance in the reactive power", default=0.0, source="constant power")
    i_q: Ratio = param("share of constant current in the reactive power", default=0.0, source="constant power")
    alpha_q: Ratio = param("exponent of the rest of the reactive power", default=0.0, source="constant power")
    T_v: Second = param(
        "time constant of the voltage filter", default=5e-3, above=0.0, source="a third of a cycle, typical"
    )
    r_min: PerUnit = param(
        "voltage below which it is a constant impedance", default=0.7, above=0.0, source="usual in stability programs"
    )
