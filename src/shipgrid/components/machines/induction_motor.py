"""Squirrel-cage induction motor with the pump or fan on its shaft, switched direct on line.

Per unit inside (base: rated shaft power, peak phase voltage, nominal frequency), SI at the terminals. Space vectors
in the stator's axes, x = x_alpha + j x_beta, currents into the windings, rotor values as seen from the stator:

    psi_s = x_ss i_s + x_m i_r,   psi_r = x_m i_s + x_rr i_r,   x_ss = x_ls + x_m,   x_rr = x_lr + x_m     (1)
    dpsi_s/dt = omega_b (v_s - r_s i_s)                                                                    (2)
    dpsi_r/dt = omega_b (j omega psi_r - r_r i_r)                                                          (3)
    2 H domega/dt = t_e - t_l,   t_e = Im(conj(psi_s) i_s),   t_l = load t_n omega |omega|                 (4)

`omega` is the rotor's electrical speed over the nominal frequency, so that its slip on a grid of frequency f is
1 - omega f_n / f. In the stator's axes the motor has no angle: given the speed, (2) and (3) are linear. One cage: the
rise of the rotor's resistance at standstill (deep bars, double cage) is left out, and so is saturation, which makes
starting currents larger still; no iron loss, no friction beside the load.

For the network, one implicit Euler step of length gh with k = gh omega_b eliminates the rotor. With c = 1 - j k omega,
d = c x_rr + k r_r and the speed predicted from the torque at the step's start (second order, as for the generator),

    (x_ss + k r_s - x_m^2 c / d) i_s = psi_s + k v_s - (x_m / d) psi_r                                     (5)
    i_r = (psi_r - c x_m i_s) / d                                                                          (6)

Source: [Krause2013] ch. 6; docs/theory/loads.md.
"""

from __future__ import annotations

import math

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.ops import absolute, hypot
from shipgrid.units import (
    Ampere,
    Hertz,
    NewtonMetre,
    PerSecond,
    PerUnit,
    RadianPerSecond,
    Ratio,
    Second,
    Siemens,
    Var,
    Volt,
    Watt,
)


class State:
    """State of the motor."""

    psi_s_alpha: PerUnit = signal("stator flux linkage, alpha axis")
    psi_s_beta: PerUnit = signal("stator flux linkage, beta axis")
    psi_r_alpha: PerUnit = signal("rotor flux linkage in the stator's axes, alpha axis")
    psi_r_beta: PerUnit = signal("rotor flux linkage in the stator's axes, beta axis")
    omega: PerUnit = signal("electrical speed of the rotor, 1 is synchronous at nominal frequency", absurd=10.0)


class Input:
    """Input of the motor."""

    v_alpha: Volt = signal("terminal voltage, alpha axis")
    v_beta: Volt = signal("terminal voltage, beta axis")
    load: PerUnit = signal("torque of the pump or fan over its nominal one", initial=1.0)


class Output:
    """Output of the motor."""

    i_alpha: Ampere = signal("current into the stator, alpha axis")
    i_beta: Ampere = signal("current into the stator, beta axis")
    i_rms: Ampere = signal("length of the stator current, as the rms value of a phase")
    tau_e: NewtonMetre = signal("air-gap torque, positive ahead")
    p_ac: Watt = signal("active power taken")
    q_ac: Var = signal("reactive power taken")


class Derived:
    """Bases, and the inverse of (1)."""

    V_b: Volt = signal("base voltage, phase peak")
    I_b: Ampere = signal("base current, phase peak")
    Y_b: Siemens = signal("base admittance")
    tau_b: NewtonMetre = signal("base torque")
    omega_b: RadianPerSecond = signal("base angular frequency")
    r_H: PerSecond = signal("1 / (2 H)")
    x_ss: PerUnit = signal("self reactance of the stator")
    x_rr: PerUnit = signal("self reactance of the rotor")
    y_s: Ratio = signal("x_rr / (x_ss x_rr - x_m^2), 1/pu")
    y_m: Ratio = signal("x_m / (x_ss x_rr - x_m^2), 1/pu")
    y_r: Ratio = signal("x_ss / (x_ss x_rr - x_m^2), 1/pu")


def derive(p: InductionMotor) -> dict[str, float]:
    """Bases, and (1) solved for the currents."""
    V_b, omega_b = math.sqrt(2.0 / 3.0) * p.v_n, 2.0 * math.pi * p.f_n
    I_b = 2.0 / 3.0 * p.p_n / V_b
    x_ss, x_rr = p.x_ls + p.x_m, p.x_lr + p.x_m
    determinant = x_ss * x_rr - p.x_m**2
    return {
        "V_b": V_b,
        "I_b": I_b,
        "Y_b": I_b / V_b,
        "tau_b": p.p_n * p.n_p / omega_b,
        "omega_b": omega_b,
        "r_H": 0.5 / p.H,
        "x_ss": x_ss,
        "x_rr": x_rr,
        "y_s": x_rr / determinant,
        "y_m": p.x_m / determinant,
        "y_r": x_ss / determinant,
    }


@kernel
def currents(x, p):
    """Stator and rotor currents of the flux linkages, (1) solved: i_s alpha, beta, i_r alpha, beta [pu]."""
    return (
        p.y_s * x.psi_s_alpha - p.y_m * x.psi_r_alpha,
        p.y_s * x.psi_s_beta - p.y_m * x.psi_r_beta,
        p.y_r * x.psi_r_alpha - p.y_m * x.psi_s_alpha,
        p.y_r * x.psi_r_beta - p.y_m * x.psi_s_beta,
    )


@kernel
def load_torque(omega, u, p):
    """Torque of the pump or fan [pu]: (4)."""
    return u.load * p.t_n * omega * absolute(omega)


@kernel
def derivatives(x: State, u: Input, p: InductionMotor, dx: State):
    s_alpha, s_beta, r_alpha, r_beta = currents(x, p)
    dx.psi_s_alpha = p.omega_b * (u.v_alpha / p.V_b - p.r_s * s_alpha)  # (2)
    dx.psi_s_beta = p.omega_b * (u.v_beta / p.V_b - p.r_s * s_beta)
    dx.psi_r_alpha = p.omega_b * (-x.omega * x.psi_r_beta - p.r_r * r_alpha)  # (3)
    dx.psi_r_beta = p.omega_b * (x.omega * x.psi_r_alpha - p.r_r * r_beta)
    t_e = x.psi_s_alpha * s_beta - x.psi_s_beta * s_alpha
    dx.omega = p.r_H * (t_e - load_torque(x.omega, u, p))  # (4)


@kernel
def outputs(x: State, u: Input, p: InductionMotor, y: Output):
    s_alpha, s_beta, _, _ = currents(x, p)
    y.i_alpha = p.I_b * s_alpha
    y.i_beta = p.I_b * s_beta
    y.i_rms = p.I_b * hypot(s_alpha, s_beta) / math.sqrt(2.0)
    y.tau_e = p.tau_b * (x.psi_s_alpha * s_beta - x.psi_s_beta * s_alpha)
    y.p_ac = 1.5 * (u.v_alpha * y.i_alpha + u.v_beta * y.i_beta)
    y.q_ac = 1.5 * (u.v_beta * y.i_alpha - u.v_alpha * y.i_beta)


@kernel
def quotient(a, b, c, d):
    """(a + j b) / (c + j d) as two reals."""
    size = c * c + d * d
    return (a * c + b * d) / size, (b * c - a * d) / size


@kernel
def stage(gh, x, u, p):
    """An implicit Euler step of length `gh` [s] from `x`, the rotor eliminated.

    Returns
    -------
    omega : float
        Predicted speed at the end of the step.
    k, kw : float
        The step in radians of the base frequency, and `k omega`.
    m_re, m_im : float
        x_m / d of (5).
    z_re, z_im : float
        Factor of i_s in (5).
    w_re, w_im : float
        Its right-hand side without k v_s.
    """
    s_alpha, s_beta, _, _ = currents(x, p)
    t_e = x.psi_s_alpha * s_beta - x.psi_s_beta * s_alpha
    omega = x.omega + gh * p.r_H * (t_e - load_torque(x.omega, u, p))
    k = gh * p.omega_b
    kw = k * omega
    m_re, m_im = quotient(p.x_m, 0.0, p.x_rr + k * p.r_r, -kw * p.x_rr)
    z_re = p.x_ss + k * p.r_s - p.x_m * (m_re + kw * m_im)  # c = 1 - j k omega
    z_im = -p.x_m * (m_im - kw * m_re)
    w_re = x.psi_s_alpha - (m_re * x.psi_r_alpha - m_im * x.psi_r_beta)
    w_im = x.psi_s_beta - (m_re * x.psi_r_beta + m_im * x.psi_r_alpha)
    return omega, k, kw, m_re, m_im, z_re, z_im, w_re, w_im


@kernel
def stamp(gh, x: State, u: Input, p: InductionMotor, n):
    _, k, _, _, _, z_re, z_im, w_re, w_im = stage(gh, x, u, p)
    y_re, y_im = quotient(k * p.Y_b, 0.0, z_re, z_im)
    h_re, h_im = quotient(w_re, w_im, z_re, z_im)
    n.g_aa = y_re
    n.g_ab = -y_im
    n.g_ba = y_im
    n.g_bb = y_re
    n.h_a = p.I_b * h_re
    n.h_b = p.I_b * h_im


@kernel
def advance(gh, x: State, u: Input, p: InductionMotor, x_next: State):
    omega, k, kw, m_re, m_im, z_re, z_im, w_re, w_im = stage(gh, x, u, p)
    v_alpha, v_beta = u.v_alpha / p.V_b, u.v_beta / p.V_b
    s_alpha, s_beta = quotient(w_re + k * v_alpha, w_im + k * v_beta, z_re, z_im)  # (5)
    # (6): d = x_m / m
    right_alpha = x.psi_r_alpha - p.x_m * (s_alpha + kw * s_beta)
    right_beta = x.psi_r_beta - p.x_m * (s_beta - kw * s_alpha)
    r_alpha = (m_re * right_alpha - m_im * right_beta) / p.x_m
    r_beta = (m_re * right_beta + m_im * right_alpha) / p.x_m
    psi_s_alpha, psi_s_beta = (
        x.psi_s_alpha + k * (v_alpha - p.r_s * s_alpha),
        x.psi_s_beta + k * (v_beta - p.r_s * s_beta),
    )
    x_next.psi_s_alpha = psi_s_alpha
    x_next.psi_s_beta = psi_s_beta
    x_next.psi_r_alpha = p.x_m * s_alpha + p.x_rr * r_alpha
    x_next.psi_r_beta = p.x_m * s_beta + p.x_rr * r_beta
    t_e = psi_s_alpha * s_beta - psi_s_beta * s_alpha
    x_next.omega = x.omega + gh * p.r_H * (t_e - load_torque(omega, u, p))


@kernel
def stored_energy(x: State, p: InductionMotor):
    s_alpha, s_beta, r_alpha, r_beta = currents(x, p)
    stator = x.psi_s_alpha * s_alpha + x.psi_s_beta * s_beta
    rotor = x.psi_r_alpha * r_alpha + x.psi_r_beta * r_beta
    return p.p_n * (0.5 * (stator + rotor) / p.omega_b + p.H * x.omega**2)


@kernel
def losses(x: State, p: InductionMotor):
    s_alpha, s_beta, r_alpha, r_beta = currents(x, p)
    return p.p_n * (p.r_s * (s_alpha**2 + s_beta**2) + p.r_r * (r_alpha**2 + r_beta**2))


@kernel
def consumed(x: State, u: Input, p: InductionMotor):
    return p.p_n * load_torque(x.omega, u, p) * x.omega


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
    stored_energy=stored_energy,
    losses=losses,
    consumed=consumed,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha"), Terminal("beta", v="v_beta", i="i_beta")),
    passive=True,
)
class InductionMotor(Derived):
    """Squirrel-cage motor with its pump or fan; in per unit a motor of 37 kW, 460 V, 1705 rpm."""

    p_n: Watt = param(
        "rated shaft power, the base of the per-unit values", default=5e3, above=0.0, source="a small pump"
    )
    v_n: Volt = param("rated voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("rated frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    n_p: Ratio = param("pole pairs", default=2.0, at_least=1.0, source="[Krause2013] table 6.10-1")
    r_s: PerUnit = param(
        "stator resistance",
        default=0.0153,
        at_least=0.0,
        source="0.087 ohm of the 50 hp motor, [Krause2013] table 6.10-1",
    )
    x_ls: PerUnit = param("stator leakage reactance", default=0.0532, above=0.0, source="0.302 ohm of that motor")
    x_m: PerUnit = param("magnetising reactance", default=2.305, above=0.0, source="13.08 ohm of that motor")
    x_lr: PerUnit = param("rotor leakage reactance", default=0.0532, above=0.0, source="0.302 ohm of that motor")
    r_r: PerUnit = param("rotor resistance", default=0.0402, above=0.0, source="0.228 ohm of that motor")
    H: Second = param(
        "inertia constant of motor and load", default=0.79, above=0.0, source="1.662 kg m2 of that motor at 1800 rpm"
    )
    t_n: PerUnit = param(
        "torque of the pump or fan at synchronous speed, over p_n / omega_n",
        default=0.8,
        at_least=0.0,
        source="typical",
    )
