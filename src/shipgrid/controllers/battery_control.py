"""Control of a battery's buck-boost converter: droop, voltage forming or current, over one current loop.

Current loop, sampled once a switching period, with the measured battery voltage fed forward:

    s = clip((v_b - u)/v_dc, s_min, s_max),   u = PI(i_star - i_l)                        (1)
    K_p = omega_c L,   K_i = omega_c R                                                    (2)

(2) cancels the choke's pole, so the loop is first order with bandwidth omega_c, less the delay of 1.5 periods.
Its reference, positive discharging, battery side:

    droop (1)     i_star = i_set + K_dr (v_ref - v_f)                                     (3)
    voltage (2)   i_star = PI(v_ref - v_f), boost branch >= 0, buck branch <= 0           (4)
    current (3)   i_star = i_set                                                          (5)

v_f is the bus voltage through a low-pass; v_ref and i_set follow their commands at a limited rate. (4) has one PI for
boost and one for buck; the one not in use rests at zero. The branch changes when the current has come to zero and the
voltage is more than `v_band` on the other side.

With `alternate`, voltage forming drives one switch at a time, as the paper has it: boost the lower one, buck the upper
one, so that no current can flow against its branch. At light load it then comes to rest within the period; a mean of
i_star takes the driven switch only a share d of the period, less than (1) would have it,

    d = sqrt(2 L |i_star| v_open / (v_closed v_dc T))                                     (6)

where v_closed and v_open drive the current up and down again: v_b and v_dc - v_b of a boost, the other way round of a
buck. Whichever of (1) and (6) closes the switch for the shorter time is right; while it is (6), the integrator of (1)
rests. So i_star is the mean current in both kinds of conduction, down to no pulse at all. The gates follow one
sampling period later, with the duty ratio that belongs to them. Averaged modulators have no periods, hence no
discontinuous conduction: there `alternate` stays 0, both switches are driven, and i_star alone keeps the sign.

Every change of mode is bumpless: i_set, or the integrator of (4), is set so that i_star stays where it is, and i_set
then moves to its command, until it arrives at the faster rate of a hand-over. Started (`enable`), v_ref begins at the
measured voltage and i_star at zero. Unloading is droop with i_set moved, at the slower rate, to where i_star is zero:
the battery keeps holding the bus while others take its load over, or the voltage shows that nobody does.

The current is limited to i_max, and fades to zero over `soc_fade` as the charge comes to soc_min (discharging) or
soc_max (charging); the fade is an addition to the paper.

Source: [DAgostino2020] sec. 3.1, fig. 5b-d, table A1; (6) [DeGusseme2005]; docs/theory/battery.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.blocks.pi import PiState, pi
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, clip, maximum
from shipgrid.units import (
    Ampere,
    AmperePerSecond,
    AmperePerVolt,
    AmperePerVoltSecond,
    Henry,
    Hertz,
    Ohm,
    PerUnit,
    PerUnitPerSecond,
    RadianPerSecond,
    Ratio,
    Volt,
    VoltPerAmpere,
    VoltPerAmpereSecond,
    VoltPerSecond,
)

OFF, DROOP, VOLTAGE, CURRENT = 0.0, 1.0, 2.0, 3.0
BLOCKED, BOTH, LOWER, UPPER = 0.0, 1.0, 2.0, 3.0  # gates of the leg, as its modulator has them
SETTLED_A, SETTLED_V = 0.5, 0.1  # how close a ramped reference counts as arrived


class State:
    v_f: Volt = signal("filtered bus voltage", initial=750.0)
    v_ref: Volt = signal("bus voltage reference, ramped", initial=750.0)
    i_set: Ampere = signal("current set point, ramped")
    i_star: Ampere = signal("current reference")
    mode: Ratio = signal("mode in force, 0 off")
    handing: Ratio = signal("1 from a change of mode until the set point has arrived")
    boost: Ratio = signal("voltage forming: 1 on the boost branch, 0 on the buck branch", initial=1.0)
    pattern: Ratio = signal("gates that belong to the duty ratio now coming into force")
    current: PiState
    voltage_boost: PiState
    voltage_buck: PiState


class Input:
    i_l: Ampere = signal("choke current, from battery to bus")
    v_b: Volt = signal("voltage at the battery's terminals")
    v_dc: Volt = signal("bus voltage")
    soc: Ratio = signal("state of charge")
    enable: Ratio = signal("1 while the gates are released")
    unload: Ratio = signal("1 to bring the current to zero", initial=0.0)
    mode_ref: Ratio = signal("1 droop, 2 voltage forming, 3 current")
    v_dc_ref: Volt = signal("commanded bus voltage")
    i_ref: Ampere = signal("commanded battery current, positive discharging")
    alternate: Ratio = signal("1: voltage forming drives one switch at a time, 0: both", initial=0.0)


class Output:
    s: Ratio = signal("mean of the upper switch's switching function over the next period")
    gates: Ratio = signal("0 blocked, 1 both switches driven, 2 the lower alone, 3 the upper alone")
    ramping: Ratio = signal("1 while a reference still moves to its command")
    current_limit: Ratio = signal("1 while the current limit acts", limiter=True)
    duty_limit: Ratio = signal("1 while the duty ratio is at a limit", limiter=True)
    soc_low: Ratio = signal("1 while the low state of charge limits the discharge", limiter=True)
    soc_high: Ratio = signal("1 while the high state of charge limits the charge", limiter=True)


class Derived:
    k_p: VoltPerAmpere = signal("current loop, proportional gain")
    k_i: VoltPerAmpereSecond = signal("current loop, integral gain")
    K_dr: AmperePerVolt = signal("droop")
    K_p_v: AmperePerVolt = signal("voltage forming, proportional gain")
    K_i_v: AmperePerVoltSecond = signal("voltage forming, integral gain")
    i_max: Ampere = signal("current limit")
    omega_f: RadianPerSecond = signal("corner of the voltage filter")


def derive(p: BatteryControl) -> dict[str, float]:
    """Gains in SI, from the choke and from per-unit gains on i_n and v_dc_n."""
    omega_c, base = 2.0 * math.pi * p.f_c, p.i_n / p.v_dc_n
    return {
        "k_p": omega_c * p.L,  # (2)
        "k_i": omega_c * p.R,
        "K_dr": p.k_dr * base,
        "K_p_v": p.k_p_v * base,
        "K_i_v": p.k_i_v * base,
        "i_max": p.i_limit * p.i_n,
        "omega_f": 2.0 * math.pi * p.f_filter,
    }


@kernel
def update(t, dt, x: State, u: Input, p: BatteryControl, x_next: State, y: Output):
    x_next.v_f = low_pass(u.v_dc, x.v_f, p.omega_f, dt)
    v_dc = maximum(u.v_dc, 1.0)  # a dead bus has no duty ratio
    y.ramping = y.current_limit = y.duty_limit = y.soc_low = y.soc_high = 0.0
    if u.enable.real < 0.5:
        x_next.mode = OFF
        x_next.v_ref = x_next.v_f
        x_next.i_set = x_next.i_star = x_next.current.i = x_next.handing = 0.0
        x_next.voltage_boost.i = x_next.voltage_buck.i = 0.0
        x_next.pattern = y.gates = BLOCKED
        y.s = clip(u.v_b / v_dc, p.s_min, p.s_max)  # no current when the gates are released
        return

    mode = DROOP if u.unload.real > 0.5 else u.mode_ref.real
    changed = mode != x.mode.real
    x_next.mode = mode
    x_next.v_ref = ramp(u.v_dc_ref, x.v_ref, p.v_rate, dt)
    e = x_next.v_ref - x_next.v_f
    high = p.i_max * clip((u.soc - p.soc_min) / p.soc_fade, 0.0, 1.0)
    low = -p.i_max * clip((p.soc_max - u.soc) / p.soc_fade, 0.0, 1.0)

    if mode == VOLTAGE:
        if changed:
            x_next.boost = 1.0 if x.i_star.real > 0.0 or (x.i_star.real == 0.0 and e.real >= 0.0) else 0.0
            x_next.voltage_boost.i = x_next.voltage_buck.i = x.i_star - p.K_p_v * e
        if x_next.boost.real > 0.5:
            wanted = p.K_p_v * e + x_next.voltage_boost.i
            boosting = x_next.voltage_boost
            i_star = pi(e, 0.0, p.K_p_v, p.K_i_v, 0.0 * low, high, dt, boosting, boosting)  # (4)
            x_next.voltage_buck.i = 0.0 * e
            if i_star.real <= 0.0 and e.real < -p.v_band.real:
                x_next.boost = 0.0
        else:
            wanted = p.K_p_v * e + x_next.voltage_buck.i
            bucking = x_next.voltage_buck
            i_star = pi(e, 0.0, p.K_p_v, p.K_i_v, low, 0.0 * high, dt, bucking, bucking)
            x_next.voltage_boost.i = 0.0 * e
            if i_star.real >= 0.0 and e.real > p.v_band.real:
                x_next.boost = 1.0
    else:
        droop = p.K_dr * e if mode == DROOP else 0.0 * e
        if changed:
            x_next.i_set = x.i_star - droop
            x_next.handing = 0.0 if x.mode.real == OFF else 1.0
        target = -droop if u.unload.real > 0.5 else u.i_ref
        rate = p.i_rate_mode if x_next.handing.real > 0.5 and u.unload.real < 0.5 else p.i_rate
        x_next.i_set = ramp(target, x_next.i_set, rate, dt)
        if absolute(target - x_next.i_set).real <= SETTLED_A:
            x_next.handing = 0.0
        wanted = x_next.i_set + droop  # (3), (5)
        i_star = clip(wanted, low, high)
        y.ramping = 1.0 if absolute(target - x_next.i_set).real > SETTLED_A else 0.0
    x_next.i_star = i_star
    if absolute(u.v_dc_ref - x_next.v_ref).real > SETTLED_V:
        y.ramping = 1.0

    effort = pi(
        i_star - u.i_l, 0.0, p.k_p, p.k_i, u.v_b - p.s_max * v_dc, u.v_b - p.s_min * v_dc, dt, x.current, x_next.current
    )
    y.s = clip((u.v_b - effort) / v_dc, p.s_min, p.s_max)  # (1)
    y.duty_limit = 1.0 if y.s.real <= p.s_min.real + 1e-9 or y.s.real >= p.s_max.real - 1e-9 else 0.0

    y.gates = x.pattern
    x_next.pattern = BOTH
    if mode == VOLTAGE and u.alternate.real > 0.5:
        fall = maximum(v_dc - u.v_b, 1.0)
        if x_next.boost.real > 0.5:
            x_next.pattern = LOWER
            share = np.sqrt(2.0 * p.L * maximum(i_star, 0.0) * fall / (u.v_b * v_dc * dt))  # (6)
            rests = share.real < 1.0 - y.s.real
            y.s = 1.0 - share if rests else y.s
        else:
            x_next.pattern = UPPER
            share = np.sqrt(2.0 * p.L * maximum(-i_star, 0.0) * u.v_b / (fall * v_dc * dt))
            rests = share.real < y.s.real
            y.s = share if rests else y.s
        if rests:
            x_next.current.i = x.current.i
            y.duty_limit = 0.0

    y.current_limit = 1.0 if absolute(wanted).real > p.i_max.real else 0.0
    y.soc_low = 1.0 if wanted.real > high.real and high.real < p.i_max.real else 0.0
    y.soc_high = 1.0 if wanted.real < low.real and low.real > -p.i_max.real else 0.0


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, stage="inner", update=update)
class BatteryControl(Derived):
    """Sampled control of a battery converter."""

    L: Henry = param("choke inductance", default=0.8e-3, above=0.0, source="[DAgostino2020] table A1")
    R: Ohm = param("resistance of choke and switches", default=0.25, at_least=0.0, source="[DAgostino2020] table A1")
    f_c: Hertz = param("bandwidth of the current loop", default=300.0, above=0.0, source="typical: below f_sw/15")
    i_n: Ampere = param("rated battery current, base of the gains", default=128.0, above=0.0, source="one-hour current")
    v_dc_n: Volt = param("rated bus voltage, base of the gains", default=750.0, above=0.0, source="[DAgostino2020] A1")
    k_dr: PerUnit = param("droop gain", default=20.0, at_least=0.0, source="[DAgostino2020] table A1: 1/0.05")
    f_filter: Hertz = param("corner of the voltage filter", default=100.0, above=0.0, source="typical")
    k_p_v: PerUnit = param(
        "voltage forming, proportional gain",
        default=20.0,
        above=0.0,
        source="not in the paper; 10 kW at once dips the bus to 744 V",
    )
    k_i_v: PerUnitPerSecond = param(
        "voltage forming, integral gain", default=100.0, at_least=0.0, source="not in the paper, with k_p_v"
    )
    v_band: Volt = param(
        "voltage forming, hysteresis between boost and buck", default=2.0, at_least=0.0, source="typical"
    )
    i_rate: AmperePerSecond = param("rate of the current set point", default=50.0, above=0.0, source="typical")
    i_rate_mode: AmperePerSecond = param(
        "rate of the current set point after a change of mode",
        default=250.0,
        above=0.0,
        source="the whole of i_limit within 0.8 s: a hand-over shall settle within a second",
    )
    v_rate: VoltPerSecond = param("rate of the voltage reference", default=50.0, above=0.0, source="as the rectifier's")
    i_limit: PerUnit = param(
        "current limit, on i_n", default=1.5, above=0.0, source="typical; [DAgostino2020] fig. 10a"
    )
    s_min: Ratio = param("least duty ratio", default=0.02, at_least=0.0, below=0.5, source="minimum pulse, typical")
    s_max: Ratio = param("greatest duty ratio", default=0.98, above=0.5, at_most=1.0, source="minimum pulse, typical")
    soc_min: Ratio = param("no discharge below this charge", default=0.2, at_least=0.0, below=0.5, source="typical")
    soc_max: Ratio = param("no charging above this charge", default=0.9, above=0.5, at_most=1.0, source="typical")
    soc_fade: Ratio = param(
        "width over which the current limit fades out", default=0.02, above=0.0, below=0.2, source="typical"
    )
