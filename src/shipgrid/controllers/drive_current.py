"""Averaged current control of a motor drive: the voltage that brings the current to its reference in `tau_c`.

    i_q_ref = tau_ref tau_n / (3/2 n_p psi_f),   i_d_ref = 0                             (1)
    v_d = R i_d - omega_e L_q i_q + L_d (i_d_ref - i_d) / tau_c                          (2)
    v_q = R i_q + omega_e (L_d i_d + psi_f) + L_q (i_q_ref - i_q) / tau_c                (3)
    |v| <= v_dc / sqrt(3)                                                                (4)
    s = v / v_dc, turned by theta_e + omega_e dt / 2                                     (5)

It stands for the hysteresis control of the paper seen over a few switching periods. It runs at every step and its
bridge carries no computation delay, as a hysteresis comparator has none. (5) holds the voltage vector still over a
step while the rotor turns: half a step's advance makes the mean right. When (4) acts the vector is shortened and
keeps its direction.

Source: docs/theory/propulsion.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.frames import unrotate
from shipgrid.model.ops import hypot, maximum
from shipgrid.units import Ampere, Henry, NewtonMetre, Ohm, PerUnit, Radian, RadianPerSecond, Ratio, Second, Volt, Weber

V_DC_LEAST = 1.0
"""Bus voltage [V] that (5) divides by at least: on a dead bus `s` stays bounded."""


class Input:
    tau_ref: PerUnit = signal("torque reference over rated torque")
    i_d: Ampere = signal("direct-axis current")
    i_q: Ampere = signal("quadrature-axis current")
    theta_e: Radian = signal("electrical angle of the rotor")
    omega_m: RadianPerSecond = signal("mechanical speed")
    v_dc: Volt = signal("bus voltage at the drive")
    blocked: Ratio = signal("1 while the gates are blocked", initial=0.0)


class Output:
    s_alpha: Ratio = signal("switching function of the bridge, alpha axis")
    s_beta: Ratio = signal("switching function of the bridge, beta axis")
    i_q_ref: Ampere = signal("reference of the quadrature-axis current")
    voltage_limited: Ratio = signal("1 while the bus voltage limits the motor's", limiter=True)


@kernel
def update(dt, u: Input, p: DriveCurrent, y: Output):
    if u.blocked.real > 0.5:
        y.s_alpha = 0.0
        y.s_beta = 0.0
        y.i_q_ref = 0.0
        y.voltage_limited = 0.0
    else:
        omega_e = p.n_p * u.omega_m
        i_q_ref = u.tau_ref * p.tau_n / (1.5 * p.n_p * p.psi_f)  # (1)
        v_d = p.R * u.i_d - omega_e * p.L_q * u.i_q - p.L_d * u.i_d / p.tau_c  # (2)
        v_q = p.R * u.i_q + omega_e * (p.L_d * u.i_d + p.psi_f) + p.L_q * (i_q_ref - u.i_q) / p.tau_c  # (3)
        v_dc = maximum(u.v_dc, V_DC_LEAST)
        shorten = hypot(v_d, v_q) * math.sqrt(3.0) / v_dc  # (4)
        scale = 1.0 / (v_dc * maximum(shorten, 1.0))
        angle = u.theta_e + 0.5 * omega_e * dt
        y.s_alpha, y.s_beta = unrotate(scale * v_d, scale * v_q, np.cos(angle), np.sin(angle))  # (5)
        y.i_q_ref = i_q_ref
        y.voltage_limited = 1.0 if shorten.real > 1.0 else 0.0


@component(input=Input, output=Output, stage="inner", update=update)
class DriveCurrent:
    """Current control of a permanent-magnet motor with i_d = 0; it knows the motor's parameters exactly."""

    n_p: Ratio = param("pole pairs", default=3.0, at_least=1.0, source="60 * 22.5 Hz / 450 rpm")
    psi_f: Weber = param("magnet flux linkage", default=2.595, above=0.0, source="5.73 kN m at 347 A with i_d = 0")
    R: Ohm = param("resistance of winding and closed switch", default=10e-3, at_least=0.0, source="as the motor's")
    L_d: Henry = param("direct-axis inductance", default=1.83e-3, above=0.0, source="as the motor's")
    L_q: Henry = param("quadrature-axis inductance", default=1.83e-3, above=0.0, source="as the motor's")
    tau_n: NewtonMetre = param("rated torque", default=5729.6, above=0.0, source="270 kW at 450 rpm")
    tau_c: Second = param("time constant of the current", default=1e-3, above=0.0, source="docs/theory/propulsion.md")
