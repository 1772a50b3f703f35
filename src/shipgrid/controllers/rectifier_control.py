"""Control of the active rectifier: PLL, DC voltage, reactive power and dq current, sampled twice a carrier period.

The d axis lies on the voltage at the capacitor of the LCL filter as a transducer sees it, the damping resistor in
series with it included: the control takes it from the samples of the capacitor and of both currents. Currents are in
the rectifier's sign (positive into the converter, i = -i_1), so that i_d > 0 is power into the DC bus and i_q > 0
reactive power delivered to the AC bus. Everything is per unit on the rating (DC: on V_dc and rating / V_dc) between the
measurements and the modulation vector

    s = v* / v_dc  in alpha-beta, advanced by 1.5 omega T_s,   |s| <= m_max / sqrt 3,       (1)

which takes back the turn of the frame during computation (one period) and hold (half a period).

The DC current is that of the poles, from what the control knows:

    i_dc = (v*_d i_d + v*_q i_q) / v_dc,   v* of the sample before: the one in force        (2)

In the frame of the vector it is the mean over the period in which s is held; the current at an instant has a sawtooth
on it, since the current vector turns while s stands (+-0.014 pu at half load), and a sample of that is off by its peak.

References and their limits, v_lim = m_max v_dc / sqrt 3, X_1 the reactance of the converter-side choke:

    0 <= i_d* <= min(i_max, share 0.95 v_lim / X_1)                                         (3)
    |i_q*| <= sqrt(i_max^2 - i_d*^2)                              priority to the d axis    (4)
    i_q* <= (sqrt((0.95 v_lim)^2 - (X_1 i_d*)^2) - |v_C|) / X_1                             (5)
    i_d* <= sqrt(i_max^2 - i_q0^2),   where (4) would leave less than (5) asks for          (6)
    i_q0 = ((0.95 v_lim)^2 - |v_C|^2 - (X_1 i_max)^2) / (2 X_1 |v_C|)

(5) is an addition to the paper. At half load and unity power factor the converter of the paper would need more voltage
than its DC bus gives; without (5) the reactive power integrator winds up and the power control is lost. With it the
rectifier draws just the reactive power that keeps 5 % of the voltage for control. i_d* in (5) is
filtered, |v_C| is the feed-forward. (6) is where the limits of voltage and current meet: beyond it the d axis would
take the room of the reactive current that it needs itself, and the current would no longer be controlled. With the
paper's choke (3) ends the d-axis current before.

`enable` = 0 holds all integrators so that the voltage asked for is the measured capacitor voltage: enabling makes no
current. `limit` is the sequence's bound on both axes for taking and shedding load.

Source: [DAgostino2020] sec. 3.2, table A1; limits and filters: docs/theory/converters.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.controllers.blocks.limiter import room_beside
from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.blocks.pll import PllState, pll
from shipgrid.controllers.current_dq import CurrentDqState, current_dq
from shipgrid.controllers.dc_voltage import DcVoltageState, dc_voltage
from shipgrid.controllers.reactive_power import ReactivePowerState, reactive_power
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.frames import rotate, unrotate
from shipgrid.model.ops import hypot, maximum, minimum
from shipgrid.units import (
    Ampere,
    Henry,
    Hertz,
    Ohm,
    PerUnit,
    PerUnitPerSecond,
    RadianPerSecond,
    RadianPerSecond2,
    Ratio,
    Volt,
    VoltAmpere,
    Watt,
)

SQRT3 = math.sqrt(3.0)
V_DC_FLOOR = 0.1  # pu, keeps (1) finite on a dead bus


class State:
    pll: PllState
    current: CurrentDqState
    dc: DcVoltageState
    reactive: ReactivePowerState
    v_ff_d: PerUnit = signal("feed-forward voltage, d axis")
    v_ff_q: PerUnit = signal("feed-forward voltage, q axis")
    vs_d: PerUnit = signal("converter voltage in force, d axis")
    vs_q: PerUnit = signal("converter voltage in force, q axis")
    i_dc_f: PerUnit = signal("filtered DC current")
    v_f: PerUnit = signal("filtered length of the measured voltage")
    q_f: PerUnit = signal("filtered reactive power, positive delivered to the AC bus")
    i_d_ref_f: PerUnit = signal("filtered d-axis current reference")


class Input:
    v_c_alpha: Volt = signal("voltage of the capacitor behind its damping resistor, alpha")
    v_c_beta: Volt = signal("voltage of the capacitor behind its damping resistor, beta")
    i_1_alpha: Ampere = signal("converter-side current towards the grid, alpha")
    i_1_beta: Ampere = signal("converter-side current towards the grid, beta")
    i_2_alpha: Ampere = signal("grid-side current towards the grid, alpha")
    i_2_beta: Ampere = signal("grid-side current towards the grid, beta")
    v_dc: Volt = signal("DC bus voltage")
    v_dc_ref: Volt = signal("reference of the DC voltage, at no load in droop")
    mode: Ratio = signal("0 droop, 1 voltage (forms the bus alone)", initial=0.0)
    enable: Ratio = signal("1: the gates switch", initial=1.0)
    limit: PerUnit = signal("largest current reference of either axis", initial=10.0)


class Output:
    s_alpha: Ratio = signal("modulation vector, alpha")
    s_beta: Ratio = signal("modulation vector, beta")
    modulation: Ratio = signal("length of the converter voltage over its limit v_dc / sqrt 3")
    i_dc: Ampere = signal("current into the DC bus, mean of a sampling period")
    p_dc: Watt = signal("power into the DC bus, mean of a sampling period")
    i_d: PerUnit = signal("d-axis current, positive into the DC bus")
    i_q: PerUnit = signal("q-axis current, positive delivering reactive power")
    i_d_ref: PerUnit = signal("reference of the d-axis current")
    i_q_ref: PerUnit = signal("reference of the q-axis current")
    v_d: PerUnit = signal("voltage across capacitor and damping resistor, d axis")
    v_q: PerUnit = signal("voltage across capacitor and damping resistor, q axis: zero when locked")
    omega: RadianPerSecond = signal("speed of that voltage's vector")
    current_limit: Ratio = signal("1 while a limit of the current, (3), (4) or (6), holds its reference", limiter=True)
    modulation_limit: Ratio = signal("1 while the converter voltage is at its limit", limiter=True)
    q_bound: Ratio = signal("1 while the bridge's voltage bounds the reactive current, by (5)", limiter=True)
    reverse_limit: Ratio = signal("1 while the d-axis reference stands at zero: no reverse power", limiter=True)


class Derived:
    V_b: Volt = signal("base voltage, phase peak")
    I_b: Ampere = signal("base current, phase peak")
    I_dc_b: Ampere = signal("base of the DC current")
    omega_n: RadianPerSecond = signal("nominal angular frequency")
    X_1: PerUnit = signal("reactance of the converter-side choke at nominal frequency")
    pll_k_p: RadianPerSecond = signal("proportional gain of the PLL")
    pll_k_i: RadianPerSecond2 = signal("integral gain of the PLL")
    pll_band_w: RadianPerSecond = signal("largest deviation of the PLL's speed")
    omega_ff: RadianPerSecond = signal("corner of the feed-forward filter")
    omega_meas: RadianPerSecond = signal("corner of the measurement filters")


def derive(p: RectifierControl) -> dict[str, float]:
    V_b = math.sqrt(2.0 / 3.0) * p.V_n
    I_b = 2.0 / 3.0 * p.S_n / V_b
    omega_n = 2.0 * math.pi * p.f_n
    omega_0 = 2.0 * math.pi * p.pll_f
    return {
        "V_b": V_b,
        "I_b": I_b,
        "I_dc_b": p.S_n / p.V_dc_n,
        "omega_n": omega_n,
        "X_1": omega_n * p.L_1 * I_b / V_b,
        "pll_k_p": 2.0 * p.pll_zeta * omega_0,
        "pll_k_i": omega_0**2,
        "pll_band_w": 2.0 * math.pi * p.pll_band,
        "omega_ff": 2.0 * math.pi * p.f_ff,
        "omega_meas": 2.0 * math.pi * p.f_meas,
    }


@kernel
def q_headroom(i_d, v_c, v_lim, p):
    """Largest q-axis current [pu] that leaves the converter `1 - p.margin` of its voltage for control: (5)."""
    return (room_beside(p.X_1 * i_d, p.margin * v_lim) - v_c) / p.X_1


@kernel
def d_headroom(v_c, v_lim, p):
    """Largest d-axis current [pu] that leaves room for the q-axis current it needs: (3), (6)."""
    v_max = p.margin * v_lim
    i_d = minimum(p.i_max, p.share * v_max / p.X_1)  # (3)
    i_q = minimum(q_headroom(i_d, v_c, v_lim, p), 0.0)
    if hypot(i_d, i_q).real <= p.i_max.real:
        return i_d + 0.0 * v_c
    needed = (v_max * v_max - v_c * v_c - p.X_1 * p.X_1 * p.i_max * p.i_max) / (2.0 * p.X_1 * v_c)
    return room_beside(needed, p.i_max)  # (6)


@kernel
def update(t, dt, x: State, u: Input, p: RectifierControl, x_next: State, y: Output):
    # measurements, per unit, on the PLL's d axis
    cos, sin = np.cos(x.pll.theta), np.sin(x.pll.theta)
    v_alpha = u.v_c_alpha + p.R_d * (u.i_1_alpha - u.i_2_alpha)  # across the damping resistor too
    v_beta = u.v_c_beta + p.R_d * (u.i_1_beta - u.i_2_beta)
    v_d, v_q = rotate(v_alpha / p.V_b, v_beta / p.V_b, cos, sin)
    i_d, i_q = rotate(-u.i_1_alpha / p.I_b, -u.i_1_beta / p.I_b, cos, sin)
    v_c = hypot(v_d, v_q)
    v_dc = u.v_dc / p.V_dc_n
    omega = pll(v_q, v_c, p.omega_n, p.pll_k_p, p.pll_k_i, p.pll_band_w, dt, x.pll, x_next.pll)
    x_next.v_ff_d = low_pass(v_d, x.v_ff_d, p.omega_ff, dt)
    x_next.v_ff_q = low_pass(v_q, x.v_ff_q, p.omega_ff, dt)
    i_dc = (x.vs_d * i_d + x.vs_q * i_q) / maximum(v_dc, V_DC_FLOOR)  # (2)
    x_next.i_dc_f = low_pass(i_dc, x.i_dc_f, p.omega_meas, dt)
    x_next.v_f = low_pass(v_c, x.v_f, p.omega_meas, dt)
    x_next.q_f = low_pass(v_d * i_q - v_q * i_d, x.q_f, p.omega_meas, dt)

    # references and their limits
    v_lim = p.m_max * u.v_dc / (SQRT3 * p.V_b)
    v_ff = hypot(x_next.v_ff_d, x_next.v_ff_q)
    d_high = d_headroom(v_ff, v_lim, p)
    i_d_ref = dc_voltage(
        u.v_dc_ref / p.V_dc_n, v_dc, x_next.i_dc_f, u.mode, u.enable, minimum(d_high, u.limit), p, dt, x.dc, x_next.dc
    )
    x_next.i_d_ref_f = low_pass(i_d_ref, x.i_d_ref_f, p.omega_meas, dt)
    bound = q_headroom(x_next.i_d_ref_f, v_ff, v_lim, p)  # (5)
    room = minimum(room_beside(i_d_ref, p.i_max), u.limit)  # (4)
    i_q_ref = reactive_power(
        x_next.v_f,
        x_next.q_f,
        u.enable,
        -room,
        maximum(minimum(room, bound), -room),
        p,
        dt,
        x.reactive,
        x_next.reactive,
    )

    # converter voltage and modulation
    x_l = p.X_1 * omega / p.omega_n
    vs_d, vs_q, limited = current_dq(
        i_d_ref,
        i_q_ref,
        i_d,
        i_q,
        x_next.v_ff_d,
        x_next.v_ff_q,
        x_l,
        v_lim,
        p.K_p,
        p.K_i,
        dt,
        x.current,
        x_next.current,
    )
    if u.enable.real < 0.5:
        x_next.current.d = 0.0
        x_next.current.q = 0.0
    x_next.vs_d, x_next.vs_q = vs_d, vs_q
    ahead = x.pll.theta + 1.5 * omega * dt
    vs_alpha, vs_beta = unrotate(vs_d, vs_q, np.cos(ahead), np.sin(ahead))
    per_volt = p.V_b / (p.V_dc_n * maximum(v_dc, V_DC_FLOOR))
    y.s_alpha = vs_alpha * per_volt  # (1)
    y.s_beta = vs_beta * per_volt

    on = 1.0 if u.enable.real > 0.5 else 0.0
    y.modulation = on * SQRT3 * hypot(vs_d, vs_q) * per_volt
    y.i_dc = i_dc * p.I_dc_b
    y.p_dc = y.i_dc * u.v_dc
    y.i_d, y.i_q, y.i_d_ref, y.i_q_ref = i_d, i_q, i_d_ref, i_q_ref
    y.v_d, y.v_q, y.omega = v_d, v_q, omega
    q_at_room = (room - i_q_ref).real <= 0.0 or (i_q_ref + room).real <= 0.0
    y.current_limit = on if (i_d_ref - d_high).real >= 0.0 or (q_at_room and room.real < u.limit.real) else 0.0
    y.modulation_limit = on * limited
    y.q_bound = on if (i_q_ref - bound).real >= 0.0 else 0.0
    y.reverse_limit = on if i_d_ref.real <= 0.0 else 0.0


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, stage="inner", update=update)
class RectifierControl(Derived):
    """Grid-side control of the active rectifier of a diesel genset."""

    S_n: VoltAmpere = param(
        "rating, base of the per-unit values", default=596e3, above=0.0, source="[DAgostino2020] table A1"
    )
    V_n: Volt = param("nominal AC voltage, line to line", default=480.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal AC frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    V_dc_n: Volt = param("nominal DC voltage", default=750.0, above=0.0, source="[DAgostino2020] table A1")
    L_1: Henry = param(
        "converter-side inductance of the filter",
        default=1.3228e-3,
        above=0.0,
        source="1.29 pu, [DAgostino2020] table A1",
    )
    R_d: Ohm = param(
        "damping resistance between the capacitor and where the voltage is measured",
        default=0.0,
        at_least=0.0,
        source="an undamped filter",
    )
    K_p: PerUnit = param(
        "proportional gain of the current control", default=1.0, above=0.0, source="[DAgostino2020] table A1"
    )
    K_i: PerUnitPerSecond = param(
        "integral gain of the current control", default=7.0, above=0.0, source="[DAgostino2020] table A1"
    )
    K_p_dc: PerUnit = param(
        "proportional gain of the DC current control", default=0.2, above=0.0, source="[DAgostino2020] table A1"
    )
    K_i_dc: PerUnitPerSecond = param(
        "integral gain of the DC current control", default=0.5, above=0.0, source="[DAgostino2020] table A1"
    )
    K_v: PerUnit = param("droop of the DC voltage", default=0.05, above=0.0, source="[DAgostino2020] table A1")
    K_p_form: PerUnit = param(
        "proportional gain of the DC voltage control alone on the bus",
        default=2.0,
        above=0.0,
        source="eigenvalues, docs/theory/converters.md",
    )
    K_i_form: PerUnitPerSecond = param(
        "integral gain of the DC voltage control alone on the bus",
        default=20.0,
        above=0.0,
        source="eigenvalues, docs/theory/converters.md",
    )
    E_ref: PerUnit = param(
        "reference of the AC voltage at no reactive power", default=1.0, above=0.0, source="nominal voltage"
    )
    K_e: PerUnit = param("droop of the AC voltage", default=0.05, above=0.0, source="[DAgostino2020] table A1")
    q_max: PerUnit = param("largest reference of the reactive power", default=0.6, above=0.0, source="design choice")
    K_p_q: PerUnit = param(
        "proportional gain of the reactive power control", default=0.02, above=0.0, source="[DAgostino2020] table A1"
    )
    K_i_q: PerUnitPerSecond = param(
        "integral gain of the reactive power control", default=0.05, above=0.0, source="[DAgostino2020] table A1"
    )
    i_max: PerUnit = param(
        "largest length of the current reference", default=1.2, above=0.0, source="design choice, usual overload"
    )
    m_max: Ratio = param(
        "largest converter voltage over v_dc / sqrt 3: 1 with min-max injection, 0.866 without",
        default=1.0,
        above=0.0,
        at_most=1.0,
        source="min-max injection",
    )
    margin: Ratio = param(
        "share of the converter's voltage that references may use",
        default=0.95,
        above=0.0,
        at_most=1.0,
        source="design choice, docs/theory/converters.md",
    )
    share: Ratio = param(
        "share of that voltage the d-axis current may use across the choke",
        default=0.8,
        above=0.0,
        at_most=1.0,
        source="design choice, docs/theory/converters.md",
    )
    f_ff: Hertz = param(
        "corner of the feed-forward filter",
        default=150.0,
        above=0.0,
        source="middle of 100 to 200 Hz, docs/theory/converters.md",
    )
    f_meas: Hertz = param(
        "corner of the filters of DC current, voltage and reactive power",
        default=100.0,
        above=0.0,
        source="design choice, docs/theory/converters.md",
    )
    pll_f: Hertz = param(
        "natural frequency of the PLL", default=20.0, above=0.0, source="half the bandwidth of the current control"
    )
    pll_zeta: Ratio = param("damping ratio of the PLL", default=0.707, above=0.0, source="second-order optimum")
    pll_band: Hertz = param(
        "largest deviation of the PLL from the nominal frequency", default=10.0, above=0.0, source="design choice"
    )
