"""Hysteresis current control of a motor drive: each phase current is kept within a band about its reference.

A leg goes to its lower switch when its phase current has risen to the reference plus the band, to its upper switch when
it has fallen to the reference minus the band, and stays as it is in between,

    e_k = i_k - i_k_ref,    s_k: 1 -> 0 at e_k >= band,    0 -> 1 at e_k <= -band               (1)

The crossings lie inside a step. Where, follows from the machine's own equations: its current moves, in the dq frame of
the rotor in which the reference stands still, by

    L_d di_d/dt = v_d - R i_d + omega_e L_q i_q                                                 (2)
    L_q di_q/dt = v_q - R i_q - omega_e (L_d i_d + psi_f)                                       (3)
    de/dt = di/dt + j omega_e (i - i_ref)                              seen from the stator     (4)

with the stator voltage of the eight switch positions, v_alpha = (2 s_a - s_b - s_c) v_dc / 3 and
v_beta = (s_b - s_c) v_dc / sqrt 3. Each error is taken as a straight line between two crossings, its slope at the
rotor's angle in the middle of the step. The first crossing changes the slopes of all three phases, and the search goes
on from there: a leg may switch any number of times in a step, up to `MOST` crossings in all, beyond which
`capped` counts. What (4) leaves out is seen in the current at the next step: no error builds up.

The star point is insulated, so that three legs decide on two currents: while the other two hold a phase outside its
band nothing in (1) can turn it back, and an error reaches up to twice the band.

With a `dead_time`, a crossing opens one switch at once and closes the other that much later. In between both are open,
and the diode that the current asks for has the leg: a leg turns at once where that is the diode of the switch that
is to close, else late, and the error goes on over the band for so long. `lo` counts only what the upper switch is
closed, `hi` all but what the lower switch is closed, as in modulators/time_stamped.py; the solver finds which holds.

Without gates the comparators go on; a leg takes up their state when the gates are released. `lead` as in
modulators/time_stamped.py.

Source: [Brod1985]; docs/theory/modulation.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.frames import SQRT3_2, alpha_beta_to_abc, unrotate
from shipgrid.model.ops import clip, maximum, minimum
from shipgrid.modulators.gates import BridgeGates, block
from shipgrid.units import Ampere, Henry, Ohm, Radian, RadianPerSecond, Ratio, Second, Volt, Weber

MOST = 64
"""Crossings a step. The ferry's motor at 30 us has two at most; with a band of 1 A, at 90 us, it has ten."""


class HysteresisState:
    """State of the comparators."""

    s_a: Ratio = signal("leg a: 1 upper switch, 0 lower")
    s_b: Ratio = signal("leg b: 1 upper switch, 0 lower")
    s_c: Ratio = signal("leg c: 1 upper switch, 0 lower")
    dead_a: Second = signal("leg a: time until its switch closes")
    dead_b: Second = signal("leg b: time until its switch closes")
    dead_c: Second = signal("leg c: time until its switch closes")
    crossings: Ratio = signal("edges of the three legs so far", counts=True)
    capped: Ratio = signal("steps so far with more crossings than are followed", counts=True)


class HysteresisInput:
    """Input of the comparators: the motor at the step's start."""

    i_d: Ampere = signal("direct-axis current")
    i_q: Ampere = signal("quadrature-axis current")
    theta_e: Radian = signal("electrical angle of the rotor")
    omega_m: RadianPerSecond = signal("mechanical speed")
    v_dc: Volt = signal("bus voltage at the drive")
    i_d_ref: Ampere = signal("reference of the direct-axis current", initial=0.0)
    i_q_ref: Ampere = signal("reference of the quadrature-axis current")
    gates: Ratio = signal("1 released, 0 blocked", initial=1.0)


@kernel
def crossing(s, e, slope, band):
    """When a phase of switch position `s`, error `e` and slope of it crosses its band: time from now, or infinity."""
    outward = e if s > 0.5 else -e  # (1) is the same for both switches, mirrored
    if outward >= band:
        return 0.0
    speed = slope if s > 0.5 else -slope
    return (band - outward) / speed if speed > 0.0 else np.inf


@kernel
def compare(s, e, band):
    """Position of a leg at error `e`: (1)."""
    return 0.0 if e >= band else (1.0 if e <= -band else s)


@kernel
def conducts(s, dead, i):
    """Where the potential of a leg is: at its closed switch, or, while both are open, at the diode that carries `i`."""
    return s if dead <= 0.0 else (0.0 if i > 0.0 else 1.0)


@kernel
def hysteresis_modulate(dt, fraction, x, u, p, y):
    """Follow the three errors through the coming step, crossing by crossing."""
    omega = p.n_p * u.omega_m
    cos, sin = np.cos(u.theta_e), np.sin(u.theta_e)
    e_d, e_q = u.i_d - u.i_d_ref, u.i_q - u.i_q_ref
    e_alpha, e_beta = unrotate(e_d, e_q, cos, sin)
    e_a, e_b, e_c = alpha_beta_to_abc(e_alpha, e_beta)
    if u.gates < 0.5:
        x.s_a, x.s_b, x.s_c = compare(x.s_a, e_a, p.band), compare(x.s_b, e_b, p.band), compare(x.s_c, e_c, p.band)
        x.dead_a = x.dead_b = x.dead_c = 0.0
        block(y)
        return

    # slopes in A per step, at the angle of the step's middle
    half = 0.5 * omega * dt
    cos, sin = cos - half * sin - 0.5 * half * half * cos, sin + half * cos - 0.5 * half * half * sin
    g_d, g_q = dt / p.L_d, dt / p.L_q
    free_d = g_d * (omega * p.L_q * u.i_q - p.R * u.i_d) - omega * dt * e_q  # (2), (4) without voltage
    free_q = -g_q * (omega * (p.L_d * u.i_d + p.psi_f) + p.R * u.i_q) + omega * dt * e_d  # (3), (4)
    free_alpha, free_beta = unrotate(free_d, free_q, cos, sin)
    v_dc = u.v_dc
    gain_aa = v_dc * (g_d * cos * cos + g_q * sin * sin)
    gain_bb = v_dc * (g_d * sin * sin + g_q * cos * cos)
    gain_ab = v_dc * (g_d - g_q) * cos * sin

    i_a, i_b, i_c = alpha_beta_to_abc(*unrotate(u.i_d_ref, u.i_q_ref, cos, sin))  # references, at the same angle

    s_a, s_b, s_c = x.s_a, x.s_b, x.s_c
    dead_a, dead_b, dead_c = x.dead_a / dt, x.dead_b / dt, x.dead_c / dt  # in steps, like all that follows
    up_a = up_b = up_c = down_a = down_b = down_c = 0.0
    y.limited = 0.0
    on_a = on_b = on_c = first_a = first_b = first_c = tau = 0.0
    count = 0
    while True:
        d_a = conducts(s_a, dead_a, e_a + i_a)
        d_b = conducts(s_b, dead_b, e_b + i_b)
        d_c = conducts(s_c, dead_c, e_c + i_c)
        v_alpha, v_beta = (2.0 * d_a - d_b - d_c) / 3.0, (d_b - d_c) / (2.0 * SQRT3_2)
        a, b, c = alpha_beta_to_abc(
            free_alpha + gain_aa * v_alpha + gain_ab * v_beta, free_beta + gain_ab * v_alpha + gain_bb * v_beta
        )
        t_a, t_b, t_c = crossing(s_a, e_a, a, p.band), crossing(s_b, e_b, b, p.band), crossing(s_c, e_c, c, p.band)
        left = 1.0 - tau
        span = minimum(t_a, minimum(t_b, t_c))
        closes = minimum(
            dead_a if dead_a > 0.0 else np.inf,
            minimum(dead_b if dead_b > 0.0 else np.inf, dead_c if dead_c > 0.0 else np.inf),
        )
        crosses = span < minimum(left, closes) and count < MOST
        if not crosses:
            y.limited = 1.0 if span < minimum(left, closes) else y.limited
            span = minimum(left, closes)
        on_a += span * d_a
        on_b += span * d_b
        on_c += span * d_c
        up_a += span * d_a if dead_a > 0.0 else 0.0
        up_b += span * d_b if dead_b > 0.0 else 0.0
        up_c += span * d_c if dead_c > 0.0 else 0.0
        down_a += span * (1.0 - d_a) if dead_a > 0.0 else 0.0
        down_b += span * (1.0 - d_b) if dead_b > 0.0 else 0.0
        down_c += span * (1.0 - d_c) if dead_c > 0.0 else 0.0
        before = clip(fraction - tau, 0.0, span)
        first_a += before * d_a
        first_b += before * d_b
        first_c += before * d_c
        dead_a, dead_b, dead_c = maximum(dead_a - span, 0.0), maximum(dead_b - span, 0.0), maximum(dead_c - span, 0.0)
        if not crosses and left <= closes:
            break
        tau += span
        e_a += span * a
        e_b += span * b
        e_c += span * c
        if not crosses:
            continue
        if t_a == span:
            s_a, dead_a = 1.0 - s_a, p.dead_time / dt
        elif t_b == span:
            s_b, dead_b = 1.0 - s_b, p.dead_time / dt
        else:
            s_c, dead_c = 1.0 - s_c, p.dead_time / dt
        count += 1
    x.s_a, x.s_b, x.s_c = s_a, s_b, s_c
    x.dead_a, x.dead_b, x.dead_c = dead_a * dt, dead_b * dt, dead_c * dt
    x.crossings += count
    x.capped += y.limited
    y.lo_a, y.lo_b, y.lo_c = on_a - up_a, on_b - up_b, on_c - up_c
    y.hi_a, y.hi_b, y.hi_c = on_a + down_a, on_b + down_b, on_c + down_c
    sampled = fraction if fraction >= 0.0 else 0.0
    y.lead_a = first_a - sampled * on_a
    y.lead_b = first_b - sampled * on_b
    y.lead_c = first_c - sampled * on_c


@component(
    state=HysteresisState,
    input=HysteresisInput,
    output=BridgeGates,
    modulate=hysteresis_modulate,
    stage="modulate",
)
class HysteresisBridge:
    """Hysteresis current control of a permanent-magnet motor's bridge; it knows the motor's parameters exactly."""

    band: Ampere = param(
        "half-width of the band", default=24.5, above=0.0, source="typical: 5 % of the rated current's peak"
    )
    dead_time: Second = param("dead time after each edge", default=0.0, at_least=0.0, source="neglected")
    n_p: Ratio = param("pole pairs", default=3.0, at_least=1.0, source="60 * 22.5 Hz / 450 rpm")
    psi_f: Weber = param("magnet flux linkage", default=2.595, above=0.0, source="5.73 kN m at 347 A with i_d = 0")
    R: Ohm = param("resistance of winding and closed switch", default=10e-3, at_least=0.0, source="as the motor's")
    L_d: Henry = param("direct-axis inductance", default=1.83e-3, above=0.0, source="as the motor's")
    L_q: Henry = param("quadrature-axis inductance", default=1.83e-3, above=0.0, source="as the motor's")
