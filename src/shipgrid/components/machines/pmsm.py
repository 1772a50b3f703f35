"""Permanent-magnet synchronous motor with sinusoidal back-emf, salient or not.

    L_d di_d/dt = v_d - R_s i_d + omega_e L_q i_q                          (1)
    L_q di_q/dt = v_q - R_s i_q - omega_e (L_d i_d + psi_f)                (2)
    dtheta_e/dt = omega_e = n_p omega_m                                    (3)
    tau_e = 3/2 n_p (psi_f i_q + (L_d - L_q) i_d i_q)                      (4)

The d axis lies on the magnets, theta_e from the alpha axis. omega_m comes from the shaft and is held over a step.
Linear magnetics; no iron loss (it would be below 1 % here), no cogging.

The Norton equivalent of an implicit Euler step of length gh: (1) and (2) at its end, with the angle there known from
(3),

    [L_d/gh + R_s   -omega_e L_q  ] i_dq = v_dq + [L_d i_d/gh, L_q i_q/gh - omega_e psi_f]         (5)
    [omega_e L_d     L_q/gh + R_s ]

turned into the alpha-beta axes by that angle. It is exact: nothing in (1) to (3) is nonlinear while omega_m is held.

Source: docs/theory/propulsion.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.frames import rotate, unrotate
from shipgrid.model.ops import wrap
from shipgrid.units import Ampere, Henry, NewtonMetre, Ohm, Radian, RadianPerSecond, Ratio, Volt, Watt, Weber


class State:
    i_d: Ampere = signal("direct-axis current into the motor")
    i_q: Ampere = signal("quadrature-axis current into the motor")
    theta_e: Radian = signal("electrical angle of the magnets from the alpha axis", rotates=True)


class Input:
    v_alpha: Volt = signal("stator voltage, alpha axis")
    v_beta: Volt = signal("stator voltage, beta axis")
    omega_m: RadianPerSecond = signal("mechanical speed of the rotor")


class Output:
    i_alpha: Ampere = signal("current into the stator, alpha axis")
    i_beta: Ampere = signal("current into the stator, beta axis")
    tau_e: NewtonMetre = signal("air-gap torque, positive ahead")
    p_s: Watt = signal("electrical power into the stator")


@kernel
def derivatives(x: State, u: Input, p: Pmsm, dx: State):
    omega_e = p.n_p * u.omega_m
    v_d, v_q = rotate(u.v_alpha, u.v_beta, np.cos(x.theta_e), np.sin(x.theta_e))
    dx.i_d = (v_d - p.R_s * x.i_d + omega_e * p.L_q * x.i_q) / p.L_d  # (1)
    dx.i_q = (v_q - p.R_s * x.i_q - omega_e * (p.L_d * x.i_d + p.psi_f)) / p.L_q  # (2)
    dx.theta_e = omega_e  # (3)


@kernel
def outputs(x: State, u: Input, p: Pmsm, y: Output):
    y.i_alpha, y.i_beta = unrotate(x.i_d, x.i_q, np.cos(x.theta_e), np.sin(x.theta_e))
    y.tau_e = 1.5 * p.n_p * (p.psi_f + (p.L_d - p.L_q) * x.i_d) * x.i_q  # (4)
    y.p_s = 1.5 * (u.v_alpha * y.i_alpha + u.v_beta * y.i_beta)


@kernel
def stamp(gh, x: State, u: Input, p: Pmsm, n):
    omega_e = p.n_p * u.omega_m
    angle = x.theta_e + gh * omega_e
    cos, sin = np.cos(angle), np.sin(angle)
    n.angle, n.cos, n.sin = angle, cos, sin
    z_d, z_q = p.L_d / gh + p.R_s, p.L_q / gh + p.R_s
    determinant = z_d * z_q + omega_e * omega_e * p.L_d * p.L_q
    y_dd, y_dq = z_q / determinant, omega_e * p.L_q / determinant  # inverse of the matrix in (5)
    y_qd, y_qq = -omega_e * p.L_d / determinant, z_d / determinant
    e_d, e_q = p.L_d * x.i_d / gh, p.L_q * x.i_q / gh - omega_e * p.psi_f
    column_a = unrotate(y_dd * cos - y_dq * sin, y_qd * cos - y_qq * sin, cos, sin)
    column_b = unrotate(y_dd * sin + y_dq * cos, y_qd * sin + y_qq * cos, cos, sin)
    n.g_aa, n.g_ba = column_a
    n.g_ab, n.g_bb = column_b
    n.h_a, n.h_b = unrotate(y_dd * e_d + y_dq * e_q, y_qd * e_d + y_qq * e_q, cos, sin)


@kernel
def advance(gh, x: State, u: Input, p: Pmsm, n, x_next: State):
    omega_e = p.n_p * u.omega_m
    v_d, v_q = rotate(u.v_alpha, u.v_beta, n.cos, n.sin)
    z_d, z_q = p.L_d / gh + p.R_s, p.L_q / gh + p.R_s
    determinant = z_d * z_q + omega_e * omega_e * p.L_d * p.L_q
    e_d, e_q = v_d + p.L_d * x.i_d / gh, v_q + p.L_q * x.i_q / gh - omega_e * p.psi_f
    x_next.i_d = (z_q * e_d + omega_e * p.L_q * e_q) / determinant  # (5)
    x_next.i_q = (z_d * e_q - omega_e * p.L_d * e_d) / determinant
    x_next.theta_e = n.angle


@kernel
def limit(x: State):
    x.theta_e = wrap(x.theta_e)


@kernel
def stored_energy(x: State, p: Pmsm):
    return 0.75 * (p.L_d * x.i_d**2 + p.L_q * x.i_q**2)


@kernel
def losses(x: State, p: Pmsm):
    return 1.5 * p.R_s * (x.i_d**2 + x.i_q**2)


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stamp=stamp,
    advance=advance,
    limit=limit,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha"), Terminal("beta", v="v_beta", i="i_beta")),
    passive=True,
)
class Pmsm:
    """Permanent-magnet synchronous motor; by default 270 kW, 480 V, 450 rpm, 22.5 Hz, 347 A."""

    n_p: Ratio = param("pole pairs", default=3.0, at_least=1.0, source="60 * 22.5 Hz / 450 rpm, [DAgostino2020] A1")
    psi_f: Weber = param(
        "magnet flux linkage", default=2.595, above=0.0, source="5.73 kN m at 347 A with i_d = 0, [DAgostino2020] A1"
    )
    R_s: Ohm = param("winding resistance", default=8e-3, at_least=0.0, source="typical: 0.01 pu of 0.799 ohm")
    L_d: Henry = param("direct-axis inductance", default=1.83e-3, above=0.0, source="480 V at the rated point")
    L_q: Henry = param("quadrature-axis inductance", default=1.83e-3, above=0.0, source="480 V at the rated point")
