"""Salient-pole synchronous generator: field, one damper an axis, and the rotor's inertia.

Per unit inside (base: rated apparent power, peak phase voltage, nominal frequency), SI at the terminals. The d axis
lies on the field, q leads it by 90 degrees, `theta` is the angle of d from alpha. i_d, i_q deliver.

    psi_d  = -X_d i_d + X_ad (i_f + i_kd)                X_d = X_l + X_ad                       (1)
    psi_f  = -X_ad i_d + X_ff i_f + X_ad i_kd            X_ff = X_ad + X_f                      (2)
    psi_kd = -X_ad i_d + X_ad i_f + X_kkd i_kd           X_kkd = X_ad + X_kd                    (3)
    psi_q  = -X_q i_q + X_aq i_kq                        X_q = X_l + X_aq                       (4)
    psi_kq = -X_aq i_q + X_kkq i_kq                      X_kkq = X_aq + X_kq                    (5)
    dpsi_d/dt = omega_b (v_d + R_s i_d + omega psi_q)                                           (6)
    dpsi_q/dt = omega_b (v_q + R_s i_q - omega psi_d)                                           (7)
    dpsi_f/dt = omega_b (R_f E_fd / X_ad - R_f i_f)                                             (8)
    dpsi_kd/dt = -omega_b R_kd i_kd,    dpsi_kq/dt = -omega_b R_kq i_kq                         (9)
    2 H domega/dt = T_m - t_e - t_x,    t_e = psi_d i_q - psi_q i_d,    dtheta/dt = omega_b omega     (10)
    t_x = brushless p_f omega / max(|omega|, omega_x)^2,    p_f = (R_f / X_ad) E_fd i_f         (11)

The fundamental reactances and resistances follow from the data-sheet values by the classical relations (`derive`),
without Canay's mutual leakage: the machine's own time constants then differ from the data-sheet ones by up to 10 %.
No saturation; no zero sequence (insulated star point). The artificial damping torque of transient-stability programs
is zero: the dampers that it stands for are here.

A brushless exciter takes the field's power p_f from the shaft, (11), but for what is left to a supply of its own (field
flashing) below the speed omega_x. What the exciter and its rotating rectifier lose themselves is not modelled.

For the network, one implicit Euler step of length gh eliminates the rotor circuits (`stage`): what remains is an
emf behind a reactance an axis, coupled by the speed. Speed and angle at the end of that step are predicted from the
torque at its start: second order, since the speed enters multiplied by the step again.

Source: [Krause2013] ch. 5; [Kundur1994] sec. 3.4 and 4.2; docs/theory/machines.md.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from shipgrid.errors import ParameterError
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.frames import rotate, unrotate
from shipgrid.model.ops import absolute, hypot, maximum, wrap
from shipgrid.units import (
    Ampere,
    Hertz,
    PerSecond,
    PerUnit,
    Radian,
    RadianPerSecond,
    Ratio,
    Second,
    Siemens,
    Var,
    Volt,
    VoltAmpere,
    Watt,
)

FLASHING = 0.2
"""Speed [pu] below which an exciter on the shaft gives no longer what the field asks for: below firing speed."""


class State:
    psi_d: PerUnit = signal("stator flux linkage, d axis")
    psi_f: PerUnit = signal("field flux linkage")
    psi_kd: PerUnit = signal("damper flux linkage, d axis")
    psi_q: PerUnit = signal("stator flux linkage, q axis")
    psi_kq: PerUnit = signal("damper flux linkage, q axis")
    omega: PerUnit = signal("speed, 1 is synchronous speed at nominal frequency", absurd=10.0)
    theta: Radian = signal("electrical angle of the field axis", rotates=True)


class Input:
    v_alpha: Volt = signal("terminal voltage, alpha")
    v_beta: Volt = signal("terminal voltage, beta")
    E_fd: PerUnit = signal("field voltage, 1 gives rated voltage at no load on the air-gap line")
    T_m: PerUnit = signal("torque of the engine on the shaft")


class Output:
    i_alpha: Ampere = signal("current into the terminal, alpha")
    i_beta: Ampere = signal("current into the terminal, beta")
    i_fd: PerUnit = signal("field current, 1 gives rated voltage at no load on the air-gap line")
    v_t: PerUnit = signal("terminal voltage")
    v_rms: Volt = signal("terminal voltage, line to line")
    p_ac: Watt = signal("active power delivered at the terminals")
    q_ac: Var = signal("reactive power delivered at the terminals")
    p_pu: PerUnit = signal("active power delivered at the terminals over the rating")
    t_e: PerUnit = signal("air-gap torque, positive braking the shaft")


class Derived:
    V_b: Volt = signal("base voltage, phase peak")
    I_b: Ampere = signal("base current, phase peak")
    Y_b: Siemens = signal("base admittance")
    omega_b: RadianPerSecond = signal("base angular frequency")
    r_H: PerSecond = signal("1 / (2 H)")
    X_ad: PerUnit = signal("magnetising reactance, d axis")
    X_aq: PerUnit = signal("magnetising reactance, q axis")
    X_f: PerUnit = signal("field leakage reactance")
    X_kd: PerUnit = signal("damper leakage reactance, d axis")
    X_kq: PerUnit = signal("damper leakage reactance, q axis")
    R_f: PerUnit = signal("field resistance")
    v_f: PerUnit = signal("field voltage for E_fd = 1, R_f / X_ad")
    v_x: PerUnit = signal("the part of it that comes from the shaft")
    R_kd: PerUnit = signal("damper resistance, d axis")
    R_kq: PerUnit = signal("damper resistance, q axis")
    X_ff: PerUnit = signal("field self reactance")
    X_kkd: PerUnit = signal("damper self reactance, d axis")
    X_kkq: PerUnit = signal("damper self reactance, q axis")
    B_dd: Ratio = signal("inverse of (1)-(3): -i_d per psi_d, 1/pu")
    B_df: Ratio = signal("inverse of (1)-(3): -i_d per psi_f and i_f per psi_d, 1/pu")
    B_dk: Ratio = signal("inverse of (1)-(3): -i_d per psi_kd and i_kd per psi_d, 1/pu")
    B_ff: Ratio = signal("inverse of (1)-(3): i_f per psi_f, 1/pu")
    B_fk: Ratio = signal("inverse of (1)-(3): i_f per psi_kd and i_kd per psi_f, 1/pu")
    B_kk: Ratio = signal("inverse of (1)-(3): i_kd per psi_kd, 1/pu")
    B_qq: Ratio = signal("inverse of (4)-(5): -i_q per psi_q, 1/pu")
    B_qk: Ratio = signal("inverse of (4)-(5): -i_q per psi_kq and i_kq per psi_q, 1/pu")
    B_kkq: Ratio = signal("inverse of (4)-(5): i_kq per psi_kq, 1/pu")


def derive(p: SynchronousGenerator) -> dict[str, float]:
    """Bases, and the classical relations between data-sheet and fundamental values ([Kundur1994] sec. 4.2).

    Raises
    ------
    ParameterError
        If the reactances are not in the order that gives positive leakage reactances.
    """
    for order in (("X_l", "X_d2", "X_d1", "X_d"), ("X_l", "X_q2", "X_q")):
        values = [getattr(p, name) for name in order]
        if any(low >= high for low, high in pairwise(values)):
            found = ", ".join(f"{name} = {value:g} pu" for name, value in zip(order, values, strict=True))
            raise ParameterError(f"SynchronousGenerator: {found}, expected {' < '.join(order)}")
    omega_b = 2.0 * math.pi * p.f_n
    V_b = math.sqrt(2.0 / 3.0) * p.v_n
    X_l = p.X_l
    X_ad, X_aq = p.X_d - X_l, p.X_q - X_l
    X_f = X_ad * (p.X_d1 - X_l) / (p.X_d - p.X_d1)
    X_kd = (p.X_d1 - X_l) * (p.X_d2 - X_l) / (p.X_d1 - p.X_d2)
    X_kq = X_aq * (p.X_q2 - X_l) / (p.X_q - p.X_q2)
    X_ff, X_kkd, X_kkq = X_ad + X_f, X_ad + X_kd, X_aq + X_kq
    B_d = np.linalg.inv([[p.X_d, X_ad, X_ad], [X_ad, X_ff, X_ad], [X_ad, X_ad, X_kkd]])
    B_q = np.linalg.inv([[p.X_q, X_aq], [X_aq, X_kkq]])
    I_b = 2.0 / 3.0 * p.S_n / V_b
    R_f = X_ff / (omega_b * p.T_d01)
    return {
        "V_b": V_b,
        "I_b": I_b,
        "Y_b": I_b / V_b,
        "omega_b": omega_b,
        "r_H": 0.5 / p.H,
        "X_ad": X_ad,
        "X_aq": X_aq,
        "X_f": X_f,
        "X_kd": X_kd,
        "X_kq": X_kq,
        "R_f": R_f,
        "v_f": R_f / X_ad,
        "v_x": p.brushless * R_f / X_ad,
        "R_kd": (X_kd + X_ad * X_f / X_ff) / (omega_b * p.T_d02),
        "R_kq": X_kkq / (omega_b * p.T_q02),
        "X_ff": X_ff,
        "X_kkd": X_kkd,
        "X_kkq": X_kkq,
        "B_dd": B_d[0, 0],
        "B_df": B_d[0, 1],
        "B_dk": B_d[0, 2],
        "B_ff": B_d[1, 1],
        "B_fk": B_d[1, 2],
        "B_kk": B_d[2, 2],
        "B_qq": B_q[0, 0],
        "B_qk": B_q[0, 1],
        "B_kkq": B_q[1, 1],
    }


@kernel
def currents(x, p):
    """Currents of the flux linkages, (1)-(5) solved: i_d, i_f, i_kd, i_q, i_kq [pu]."""
    i_d = -(p.B_dd * x.psi_d + p.B_df * x.psi_f + p.B_dk * x.psi_kd)
    i_f = p.B_df * x.psi_d + p.B_ff * x.psi_f + p.B_fk * x.psi_kd
    i_kd = p.B_dk * x.psi_d + p.B_fk * x.psi_f + p.B_kk * x.psi_kd
    i_q = -(p.B_qq * x.psi_q + p.B_qk * x.psi_kq)
    i_kq = p.B_qk * x.psi_q + p.B_kkq * x.psi_kq
    return i_d, i_f, i_kd, i_q, i_kq


@kernel
def exciter_torque(omega, i_f, E_fd, p):
    """Torque [pu] that a brushless exciter takes from the shaft for the field: (11)."""
    if omega.real > FLASHING:
        return p.v_x * E_fd * i_f / omega
    speed = maximum(absolute(omega), FLASHING)
    return p.v_x * E_fd * i_f * omega / (speed * speed)


@kernel
def derivatives(t, x: State, u: Input, p: SynchronousGenerator, dx: State):
    i_d, i_f, i_kd, i_q, i_kq = currents(x, p)
    v_d, v_q = rotate(u.v_alpha / p.V_b, u.v_beta / p.V_b, np.cos(x.theta), np.sin(x.theta))
    dx.psi_d = p.omega_b * (v_d + p.R_s * i_d + x.omega * x.psi_q)  # (6)
    dx.psi_q = p.omega_b * (v_q + p.R_s * i_q - x.omega * x.psi_d)  # (7)
    dx.psi_f = p.omega_b * (p.v_f * u.E_fd - p.R_f * i_f)  # (8)
    dx.psi_kd = -p.omega_b * p.R_kd * i_kd  # (9)
    dx.psi_kq = -p.omega_b * p.R_kq * i_kq
    t_x = exciter_torque(x.omega, i_f, u.E_fd, p)
    dx.omega = p.r_H * (u.T_m - (x.psi_d * i_q - x.psi_q * i_d) - t_x)  # (10)
    dx.theta = p.omega_b * x.omega


@kernel
def outputs(t, x: State, u: Input, p: SynchronousGenerator, y: Output):
    i_d, i_f, _, i_q, _ = currents(x, p)
    i_alpha, i_beta = unrotate(i_d * p.I_b, i_q * p.I_b, np.cos(x.theta), np.sin(x.theta))
    v = hypot(u.v_alpha, u.v_beta)
    y.i_alpha = -i_alpha  # delivered inside, into the device at the terminal
    y.i_beta = -i_beta
    y.i_fd = p.X_ad * i_f
    y.v_t = v / p.V_b
    y.v_rms = math.sqrt(1.5) * v
    y.p_ac = 1.5 * (u.v_alpha * i_alpha + u.v_beta * i_beta)
    y.q_ac = 1.5 * (u.v_beta * i_alpha - u.v_alpha * i_beta)
    y.p_pu = y.p_ac / p.S_n
    y.t_e = x.psi_d * i_q - x.psi_q * i_d


@kernel
def stage(gh, x, u, p):
    """What an implicit Euler step of length `gh` [s] from `x` leaves of the machine at its stator.

    Returns
    -------
    k : float
        `omega_b gh`, the step in radians of the base frequency.
    r_f, r_kd, a_d, e_d, X_sd : float
        Rotor of the d axis eliminated: right-hand sides of (2), (3), inverse determinant, and
        `psi_d = e_d - X_sd i_d` at the end of the step.
    a_q, e_q, X_sq : float
        The same of the q axis: inverse self reactance, and `psi_q = e_q - X_sq i_q`.
    """
    k = gh * p.omega_b
    # (2), (8) and (3), (9): [[x_f, X_ad], [X_ad, x_k]] [i_f, i_kd] = [r_f, r_kd] + X_ad i_d
    x_f, x_k = p.X_ff + k * p.R_f, p.X_kkd + k * p.R_kd
    a_d = 1.0 / (x_f * x_k - p.X_ad * p.X_ad)
    r_f = x.psi_f + k * p.v_f * u.E_fd
    r_kd = x.psi_kd
    e_d = p.X_ad * a_d * ((x_k - p.X_ad) * r_f + (x_f - p.X_ad) * r_kd)
    X_sd = p.X_d - p.X_ad * p.X_ad * a_d * (x_k + x_f - 2.0 * p.X_ad)
    # (5), (9): x_kq i_kq = psi_kq + X_aq i_q
    a_q = 1.0 / (p.X_kkq + k * p.R_kq)
    e_q = p.X_aq * a_q * x.psi_kq
    X_sq = p.X_q - p.X_aq * p.X_aq * a_q
    return k, r_f, r_kd, a_d, e_d, X_sd, a_q, e_q, X_sq


@kernel
def stamp(gh, x: State, u: Input, p: SynchronousGenerator, n):
    i_d, i_f, _, i_q, _ = currents(x, p)
    t_x = exciter_torque(x.omega, i_f, u.E_fd, p)
    omega = x.omega + gh * p.r_H * (u.T_m - (x.psi_d * i_q - x.psi_q * i_d) - t_x)  # (10), predicted
    theta = x.theta + gh * p.omega_b * omega
    cos, sin = np.cos(theta), np.sin(theta)
    n.speed, n.angle, n.cos, n.sin = omega, theta, cos, sin
    k, _, _, _, e_d, X_sd, _, e_q, X_sq = stage(gh, x, u, p)
    # (6), (7) of the step's end: [[z_d, -b], [c, z_q]] [i_d, i_q] = [w_d, w_q] - k [v_d, v_q]
    z_d, z_q = X_sd + k * p.R_s, X_sq + k * p.R_s
    b, c = k * omega * X_sq, k * omega * X_sd
    w_d = e_d - x.psi_d - k * omega * e_q
    w_q = e_q - x.psi_q + k * omega * e_d
    a = 1.0 / (z_d * z_q + b * c)
    # -i of that, turned to alpha-beta; its conductance splits into a mean, a saliency and a rotation
    g = 0.5 * k * a * p.Y_b
    mean, half, skew, turn = g * (z_q + z_d), g * (z_q - z_d), g * (b - c), g * (b + c)
    cos2, sin2 = cos * cos - sin * sin, 2.0 * sin * cos
    n.g_aa = mean + half * cos2 - skew * sin2
    n.g_bb = mean - half * cos2 + skew * sin2
    n.g_ab = half * sin2 + skew * cos2 + turn
    n.g_ba = half * sin2 + skew * cos2 - turn
    h_d, h_q = -p.I_b * a * (z_q * w_d + b * w_q), -p.I_b * a * (z_d * w_q - c * w_d)
    n.h_a, n.h_b = unrotate(h_d, h_q, cos, sin)


@kernel
def advance(gh, x: State, u: Input, p: SynchronousGenerator, n, x_next: State):
    omega = n.speed
    k, r_f, r_kd, a_d, e_d, X_sd, a_q, e_q, X_sq = stage(gh, x, u, p)
    kv_d, kv_q = rotate(k / p.V_b * u.v_alpha, k / p.V_b * u.v_beta, n.cos, n.sin)
    z_d, z_q = X_sd + k * p.R_s, X_sq + k * p.R_s
    b, c = k * omega * X_sq, k * omega * X_sd
    w_d = e_d - x.psi_d - k * omega * e_q - kv_d
    w_q = e_q - x.psi_q + k * omega * e_d - kv_q
    a = 1.0 / (z_d * z_q + b * c)
    i_d, i_q = a * (z_q * w_d + b * w_q), a * (z_d * w_q - c * w_d)
    psi_d, psi_q = e_d - X_sd * i_d, e_q - X_sq * i_q
    x_f, x_k = p.X_ff + k * p.R_f, p.X_kkd + k * p.R_kd
    r_f, r_kd = r_f + p.X_ad * i_d, r_kd + p.X_ad * i_d
    i_f, i_kd = a_d * (x_k * r_f - p.X_ad * r_kd), a_d * (x_f * r_kd - p.X_ad * r_f)
    i_kq = a_q * (x.psi_kq + p.X_aq * i_q)
    x_next.psi_d = psi_d
    x_next.psi_q = psi_q
    x_next.psi_f = x.psi_f + k * (p.v_f * u.E_fd - p.R_f * i_f)
    x_next.psi_kd = x.psi_kd - k * p.R_kd * i_kd
    x_next.psi_kq = x.psi_kq - k * p.R_kq * i_kq
    x_next.omega = x.omega + gh * p.r_H * (u.T_m - (psi_d * i_q - psi_q * i_d) - exciter_torque(omega, i_f, u.E_fd, p))
    x_next.theta = n.angle  # the predicted one: the network was solved with it, and the currents must agree


@kernel
def limit(x: State):
    x.theta = wrap(x.theta)


@kernel
def stored_energy(x: State, p: SynchronousGenerator):
    i_d, i_f, i_kd, i_q, i_kq = currents(x, p)
    magnetic = x.psi_f * i_f + x.psi_kd * i_kd + x.psi_kq * i_kq - x.psi_d * i_d - x.psi_q * i_q
    return p.S_n * (0.5 * magnetic / p.omega_b + p.H * x.omega**2)


@kernel
def losses(x: State, p: SynchronousGenerator):
    i_d, i_f, i_kd, i_q, i_kq = currents(x, p)
    stator = p.R_s * (i_d**2 + i_q**2)
    return p.S_n * (stator + p.R_f * i_f**2 + p.R_kd * i_kd**2 + p.R_kq * i_kq**2)


@kernel
def supplied(x: State, u: Input, p: SynchronousGenerator):
    """Power from the engine's shaft, and that of the field as far as the shaft does not give it."""
    _, i_f, _, _, _ = currents(x, p)
    apart = p.v_f * u.E_fd * i_f - exciter_torque(x.omega, i_f, u.E_fd, p) * x.omega
    return p.S_n * (u.T_m * x.omega + apart)


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
    limit=limit,
    stored_energy=stored_energy,
    losses=losses,
    supplied=supplied,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha"), Terminal("beta", v="v_beta", i="i_beta")),
    passive=True,
)
class SynchronousGenerator(Derived):
    """Salient-pole synchronous generator with its rotor. `X_d1` is transient (X_d'), `X_d2` subtransient (X_d'')."""

    S_n: VoltAmpere = param("rated apparent power", default=596e3, above=0.0, source="[DAgostino2020] table A1")
    v_n: Volt = param("rated voltage, line to line", default=480.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    H: Second = param(
        "inertia constant, kinetic energy at synchronous speed over S_n",
        default=0.17,
        above=0.0,
        source="[DAgostino2020] table A1, read as H: as 2H the speed loop would be on the edge of stability",
    )
    X_d: PerUnit = param(
        "synchronous reactance, d axis", default=2.40, above=0.0, source="typical: 4-pole, low voltage"
    )
    X_d1: PerUnit = param("transient reactance, d axis", default=0.17, above=0.0, source="typical: 4-pole, low voltage")
    X_d2: PerUnit = param("subtransient reactance, d", default=0.12, above=0.0, source="typical: 4-pole, low voltage")
    X_q: PerUnit = param("synchronous reactance, q axis", default=1.40, above=0.0, source="typical: X_q/X_d 0.55-0.85")
    X_q2: PerUnit = param("subtransient reactance, q", default=0.15, above=0.0, source="typical: 4-pole, low voltage")
    X_l: PerUnit = param("stator leakage reactance", default=0.07, above=0.0, source="typical: 4-pole, low voltage")
    R_s: PerUnit = param("stator resistance", default=0.012, at_least=0.0, source="typical: 4-pole, low voltage")
    brushless: Ratio = param(
        "share of the field's power that its exciter takes from the shaft: 1 brushless, 0 with a supply of its own",
        default=1.0,
        at_least=0.0,
        at_most=1.0,
        source="the exciter is an AC1A, an alternator with rotating rectifiers",
    )
    T_d01: Second = param(
        "transient time constant, d axis, stator open",
        default=2.0,
        above=0.0,
        source="[Basler2007] table 18: four poles, frame of 570 mm, where 500 to 900 kVA are built",
    )
    T_d02: Second = param("subtransient time constant, d, stator open", default=0.017, above=0.0, source="typical")
    T_q02: Second = param("subtransient time constant, q, stator open", default=0.06, above=0.0, source="typical")
