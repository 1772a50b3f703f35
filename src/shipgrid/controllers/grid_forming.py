"""Grid-forming control of a two-level inverter behind an LCL filter: it makes voltage and frequency, others follow.

Per unit on the inverter's rating and the bar's voltage; dq on the internal angle theta, which this controller turns
itself. `s` is the Laplace variable in (1) to (5), the kernel is their sampled form.

    p = v_cd i_gd + v_cq i_gq,   q = v_cq i_gd - v_cd i_gq
    omega = omega* + m_p (1 + T_1 s)/(1 + T_2 s) omega_c/(s + omega_c) (P* + dp_sync - p) + dw,
    dtheta/dt = omega                                                                                            (1)
    E     = V* + m_q (Q* - omega_q/(s + omega_q) q) + dV                                                         (2)
    dv_t  = R_v s/(s + omega_RV) i_g                                     transient virtual resistor              (3)
    dv_v  = (1 + j sigma) k_pRVI max(0, |i_1| - I_n) i_1                 threshold virtual impedance             (4)
    v_c*  = E - dv_t - dv_v                                                                                      (5)
    i_1*  = PI_v(v_c* - v_c) + j omega C v_c + F_i i_g,                  |i_1*| <= i_max                         (6)
    v_m*  = PI_c(i_1* - i_1) + j omega L_1 i_1 + F_v F(s) v_c,           |v_m*| <= v_dc / sqrt 3                 (7)

v_c is what a transducer sees of the filter's capacitor, the damping resistor in series with it included: the control
takes it from the samples of the capacitor and of both currents.

dw and dV are the trims of a tie that moves the bar and of the inverter's own synchroniser, dw_sync + dw_join.

The low-pass of (1) is the inertia (H = 1/(2 m_p omega_c)), its lead-lag the damping; T_1 = T_2 takes the lead-lag out.
Both limits keep the vector's angle. An integrator stands still while its limit acts and the error would drive it
further; the voltage integrator does so at the modulation limit as well, since the current loop cannot follow there.
The virtual impedance alone would be unstable in a bolted short circuit: the limit of (6) bounds the current there, and
with it the loops are damped.

The bridge obeys half a period after the period of computation, 1.5 T_s in all, and the modulation vector is turned
ahead by 1.5 omega T_s for it. The gains belong to this rate and delay, and without the
advance the isolated inverter is unstable on a resistance parallel to an inductance. There damping falls with the
resistance's share; a series load knows no such limit.

After the grid-forming control of Qoria, Gruson, Colas, Guillaud and co-authors as open Dynawo models have it;
values: [DAgostino2020] table A1; gains: docs/theory/grid_forming.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.frames import rotate, unrotate
from shipgrid.model.ops import hypot, maximum, wrap
from shipgrid.units import (
    Ampere,
    Hertz,
    PerSecond,
    PerUnit,
    PerUnitPerSecond,
    Radian,
    RadianPerSecond,
    Ratio,
    Second,
    Volt,
    VoltAmpere,
)

SQRT3 = math.sqrt(3.0)


class Vector:
    """A dq vector."""

    d: PerUnit = signal("component along the internal angle", initial=0.0)
    q: PerUnit = signal("component 90 degrees ahead", initial=0.0)


class State:
    """State of the controller."""

    theta: Radian = signal("internal angle", rotates=True)
    v_set: PerUnit = signal("voltage set point on its ramp")
    power: PerUnit = signal("power error through the low-pass")
    lead: PerUnit = signal("state of the lead-lag")
    reactive: PerUnit = signal("reactive power through the low-pass")
    i_g_slow: Vector
    v_c_forward: Vector
    voltage: Vector
    current: Vector


class Input:
    """Input of the controller."""

    v_c_alpha: Volt = signal("voltage of the capacitor behind its damping resistor, alpha axis")
    v_c_beta: Volt = signal("voltage of the capacitor behind its damping resistor, beta axis")
    i_1_alpha: Ampere = signal("converter current towards the grid, alpha axis")
    i_1_beta: Ampere = signal("converter current towards the grid, beta axis")
    i_g_alpha: Ampere = signal("grid current towards the grid, alpha axis")
    i_g_beta: Ampere = signal("grid current towards the grid, beta axis")
    v_dc: Volt = signal("DC bus voltage")
    enable: Ratio = signal("1: gates work; 0: blocked, everything but the angle is reset")
    v_ref: PerUnit = signal("voltage set point V*, reached at the ramp's rate", initial=1.0)
    p_ref: PerUnit = signal("power set point P*", initial=0.0)
    q_ref: PerUnit = signal("reactive power set point Q*", initial=0.0)
    omega_ref: PerUnit = signal("frequency set point", initial=1.0)
    dw_sync: PerUnit = signal("frequency trim of a tie's synchroniser", initial=0.0)
    dV_sync: PerUnit = signal("voltage trim of a tie's synchroniser", initial=0.0)
    dw_join: PerUnit = signal("frequency trim of its own synchroniser", initial=0.0)
    dV_join: PerUnit = signal("voltage trim of its own synchroniser", initial=0.0)
    dp_sync: PerUnit = signal("power trim of a tie that unloads", initial=0.0)


class Output:
    """Output of the controller."""

    s_alpha: Ratio = signal("modulation, alpha axis: bridge voltage over DC voltage")
    s_beta: Ratio = signal("modulation, beta axis")
    f: Hertz = signal("internal frequency")
    p: PerUnit = signal("active power where the chokes meet, delivered")
    q: PerUnit = signal("reactive power where the chokes meet, delivered")
    modulation: Ratio = signal("length of the modulation vector, 1 at its limit")
    current_limit: Ratio = signal("1 while the current reference is limited", limiter=True)
    virtual_impedance: Ratio = signal("1 while the threshold virtual impedance acts", limiter=True)
    modulation_limit: Ratio = signal("1 while the modulation vector is limited", limiter=True)


class Derived:
    """Bases."""

    v_b: Volt = signal("base voltage, peak of a phase")
    i_b: Ampere = signal("base current, peak of a phase")
    omega_b: RadianPerSecond = signal("base angular frequency")


def derive(p: GridForming) -> dict[str, float]:
    """Bases from the ratings."""
    v_b = math.sqrt(2.0 / 3.0) * p.v_n
    return {"v_b": v_b, "i_b": 2.0 / 3.0 * p.S_n / v_b, "omega_b": 2.0 * math.pi * p.f_n}


@kernel
def droop(p_ac, q_ac, dt, x: State, u: Input, p: GridForming, x_next: State):
    """Frequency and voltage of the droops [pu]: (1), (2)."""
    x_next.power = low_pass(u.p_ref + u.dp_sync - p_ac, x.power, p.omega_c, dt)
    x_next.lead = low_pass(x_next.power, x.lead, 1.0 / p.T_2, dt)
    x_next.reactive = low_pass(q_ac, x.reactive, p.omega_q, dt)
    x_next.v_set = ramp(u.v_ref, x.v_set, p.v_rate, dt)
    lead = x_next.lead + p.T_1 / p.T_2 * (x_next.power - x_next.lead)
    omega = u.omega_ref + p.m_p * lead + u.dw_sync + u.dw_join  # (1)
    e = x_next.v_set + p.m_q * (u.q_ref - x_next.reactive) + u.dV_sync + u.dV_join  # (2)
    return omega, maximum(e, 0.0)


@kernel
def virtual_impedance(i_d, i_q, i_n, k_p, sigma):
    """Voltage drop of the threshold virtual impedance [pu] at the current i: (4)."""
    r = k_p * maximum(hypot(i_d, i_q) - i_n, 0.0)
    return r * (i_d - sigma * i_q), r * (i_q + sigma * i_d)


@kernel
def limit(d, q, length):
    """The vector (d, q), no longer than `length`, its angle kept; and by what it was shortened."""
    wanted = hypot(d, q)
    if wanted.real <= length.real:
        return d, q, 0.0 * d, 0.0 * q
    ratio = length / wanted
    return ratio * d, ratio * q, (1.0 - ratio) * d, (1.0 - ratio) * q


@kernel
def integrate(e_d, e_q, k_i, blocked, dt, x: Vector, x_next: Vector):
    """Vector integrator, standing still while `blocked`."""
    gain = 0.0 if blocked else k_i * dt
    x_next.d = x.d + gain * e_d
    x_next.q = x.q + gain * e_q


@kernel
def rest(x: State, u: Input, p: GridForming, dt, x_next: State, y: Output):
    """Blocked: the angle turns on at the set frequency, all else is reset."""
    x_next.theta = wrap(x.theta + p.omega_b * u.omega_ref * dt)
    x_next.v_set = 0.0
    x_next.power = 0.0
    x_next.lead = 0.0
    x_next.reactive = 0.0
    x_next.i_g_slow.d = 0.0
    x_next.i_g_slow.q = 0.0
    x_next.v_c_forward.d = 0.0
    x_next.v_c_forward.q = 0.0
    x_next.voltage.d = 0.0
    x_next.voltage.q = 0.0
    x_next.current.d = 0.0
    x_next.current.q = 0.0
    y.s_alpha = 0.0
    y.s_beta = 0.0
    y.f = u.omega_ref * p.f_n
    y.p = 0.0
    y.q = 0.0
    y.modulation = 0.0
    y.current_limit = 0.0
    y.virtual_impedance = 0.0
    y.modulation_limit = 0.0


@kernel
def update(t, dt, x: State, u: Input, p: GridForming, x_next: State, y: Output):
    if u.enable.real < 0.5:
        rest(x, u, p, dt, x_next, y)
        return
    cos, sin = np.cos(x.theta), np.sin(x.theta)
    i_d, i_q = rotate(u.i_1_alpha / p.i_b, u.i_1_beta / p.i_b, cos, sin)
    ig_d, ig_q = rotate(u.i_g_alpha / p.i_b, u.i_g_beta / p.i_b, cos, sin)
    v_d, v_q = rotate(u.v_c_alpha / p.v_b, u.v_c_beta / p.v_b, cos, sin)
    v_d, v_q = v_d + p.R_d * (i_d - ig_d), v_q + p.R_d * (i_q - ig_q)  # across the damping resistor too

    y.p = v_d * ig_d + v_q * ig_q
    y.q = v_q * ig_d - v_d * ig_q
    omega, e = droop(y.p, y.q, dt, x, u, p, x_next)

    x_next.i_g_slow.d = low_pass(ig_d, x.i_g_slow.d, p.omega_RV, dt)
    x_next.i_g_slow.q = low_pass(ig_q, x.i_g_slow.q, p.omega_RV, dt)
    drop_d, drop_q = virtual_impedance(i_d, i_q, p.I_n, p.k_pRVI, p.sigma)
    e_d = e - p.R_v * (ig_d - x_next.i_g_slow.d) - drop_d - v_d  # (3), (5)
    e_q = -p.R_v * (ig_q - x_next.i_g_slow.q) - drop_q - v_q

    wanted_d = p.K_pv * e_d + x.voltage.d - omega * p.C * v_q + p.F_i * ig_d  # (6)
    wanted_q = p.K_pv * e_q + x.voltage.q + omega * p.C * v_d + p.F_i * ig_q
    i_ref_d, i_ref_q, cut_d, cut_q = limit(wanted_d, wanted_q, p.i_max)

    x_next.v_c_forward.d = low_pass(v_d, x.v_c_forward.d, p.omega_F, dt)
    x_next.v_c_forward.q = low_pass(v_q, x.v_c_forward.q, p.omega_F, dt)
    ei_d, ei_q = i_ref_d - i_d, i_ref_q - i_q
    v_ref_d = p.K_pc * ei_d + x.current.d - omega * p.L_1 * i_q + p.F_v * x_next.v_c_forward.d  # (7)
    v_ref_q = p.K_pc * ei_q + x.current.q + omega * p.L_1 * i_d + p.F_v * x_next.v_c_forward.q
    v_dc = maximum(u.v_dc, 1.0)  # a bus without voltage gives no modulation: the sequence does not enable there
    v_max = v_dc / (SQRT3 * p.v_b)
    vm_d, vm_q, lost_d, lost_q = limit(v_ref_d, v_ref_q, v_max)

    limited = hypot(cut_d, cut_q).real > 0.0
    saturated = hypot(lost_d, lost_q).real > 0.0
    outwards = (e_d * cut_d + e_q * cut_q).real > 0.0 or (e_d * lost_d + e_q * lost_q).real > 0.0
    integrate(e_d, e_q, p.K_iv, outwards, dt, x.voltage, x_next.voltage)
    integrate(ei_d, ei_q, p.K_ic, (ei_d * lost_d + ei_q * lost_q).real > 0.0, dt, x.current, x_next.current)

    turn = x.theta + 1.5 * p.omega_b * omega * dt  # where the frame is when the bridge obeys, on the mean
    s_alpha, s_beta = unrotate(vm_d, vm_q, np.cos(turn), np.sin(turn))
    y.s_alpha = s_alpha * p.v_b / v_dc
    y.s_beta = s_beta * p.v_b / v_dc
    y.f = omega * p.f_n
    y.modulation = hypot(vm_d, vm_q) / v_max
    y.current_limit = 1.0 if limited else 0.0
    y.virtual_impedance = 1.0 if hypot(drop_d, drop_q).real > 0.0 else 0.0
    y.modulation_limit = 1.0 if saturated else 0.0
    x_next.theta = wrap(x.theta + p.omega_b * omega * dt)


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, update=update, stage="inner")
class GridForming(Derived):
    """Droop, virtual impedances, voltage and current loops of a grid-forming inverter."""

    S_n: VoltAmpere = param("rating", default=50e3, above=0.0, source="[DAgostino2020] table A1")
    v_n: Volt = param("line voltage, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    L_1: PerUnit = param("converter-side inductance of the filter", default=0.891, above=0.0, source="sizing rule")
    C: PerUnit = param("filter capacitance", default=0.06, above=0.0, source="[DAgostino2020] table A1")
    R_d: PerUnit = param(
        "damping resistance between the capacitor and where the voltage is measured",
        default=0.0,
        at_least=0.0,
        source="an undamped filter",
    )
    m_p: PerUnit = param("frequency droop", default=0.02, at_least=0.0, source="[DAgostino2020] table A1")
    m_q: PerUnit = param("voltage droop", default=0.02, at_least=0.0, source="[DAgostino2020] table A1")
    omega_c: RadianPerSecond = param("power low-pass", default=31.41, above=0.0, source="[DAgostino2020] table A1")
    omega_q: RadianPerSecond = param("reactive low-pass", default=31.41, above=0.0, source="as omega_c")
    T_1: Second = param("lead of the lead-lag", default=0.033, at_least=0.0, source="[DAgostino2020] table A1")
    T_2: Second = param("lag of the lead-lag", default=0.011, above=0.0, source="[DAgostino2020] table A1")
    R_v: PerUnit = param("transient virtual resistance", default=0.09, at_least=0.0, source="[DAgostino2020] table A1")
    omega_RV: RadianPerSecond = param("its high-pass", default=16.66, above=0.0, source="[DAgostino2020] table A1")
    k_pRVI: PerUnit = param(
        "virtual resistance per current above the threshold",
        default=0.6716,
        at_least=0.0,
        source="[DAgostino2020] table A1, printed there as a resistance",
    )
    sigma: Ratio = param("X/R of the virtual impedance", default=5.0, at_least=0.0, source="[DAgostino2020] table A1")
    I_n: PerUnit = param("threshold of the virtual impedance", default=1.0, above=0.0, source="rated current")
    i_max: PerUnit = param("limit of the current reference", default=1.25, above=0.0, source="above the 1.2 pu of (4)")
    K_pv: PerUnit = param("voltage loop, proportional", default=0.45, at_least=0.0, source="eigenvalue search")
    K_iv: PerSecond = param("voltage loop, integral", default=225.0, at_least=0.0, source="eigenvalue search")
    F_i: Ratio = param("feed-forward of the grid current", default=0.8, at_least=0.0, source="eigenvalue search")
    K_pc: PerUnit = param("current loop, proportional", default=0.79, at_least=0.0, source="eigenvalue search")
    K_ic: PerSecond = param("current loop, integral", default=36.0, at_least=0.0, source="eigenvalue search")
    F_v: Ratio = param("feed-forward of the capacitor voltage", default=0.5, at_least=0.0, source="eigenvalue search")
    omega_F: RadianPerSecond = param(
        "low-pass of that feed-forward", default=2.0 * math.pi * 700.0, above=0.0, source="eigenvalue search"
    )
    v_rate: PerUnitPerSecond = param(
        "ramp of the voltage set point", default=1.0 / 1.5, above=0.0, source="black start in 1 to 2 s"
    )


PRESETS = {
    "default": {"L_1": 0.891},
    "paper": {
        "L_1": 1.54,
        "K_pv": 1.29,
        "K_iv": 11.8,
        "F_i": 0.845,
        "K_pc": 0.39,
        "K_ic": 124.0,
        "F_v": 0.85,
        "omega_F": 2.0 * math.pi * 480.0,
    },
}
"""Filter and gains that differ from the declared defaults, by the name of the filter preset."""
