"""AC1A: alternator-rectifier exciter with its voltage regulator (brushless, field current feedback).

    dv_m/dt = (v_t - v_m) / T_R                                               transducer         (1)
    e = v_ref - v_m - v_f,   v_f = K_F/T_F (v_fe - x_f),   dx_f/dt = (v_fe - x_f) / T_F          (2)
    y_l = (1 + T_C s) / (1 + T_B s) e,   bypassed where T_B = 0                                  (3)
    dv_a/dt = (K_A y_l - v_a) / T_A,   V_Amin .. V_Amax, without wind-up      regulator          (4)
    v_r = clip(v_a, V_Rmin, V_Rmax)                                                              (5)
    dv_e/dt = (v_r - v_fe) / T_E,   v_e >= 0                                  exciter            (6)
    v_fe = v_e (K_E + S_E(v_e)) + K_D i_fd                                                       (7)
    E_fd = v_e FEX(K_C i_fd / v_e)                                            rectifier          (8)

S_E goes through (E_1, S_1) and (E_2, S_2): exponential, A exp(B v_e), or quadratic, B (v_e - A)^2 / v_e above A. Over-
and under-excitation limiters are not modelled. Switched off, the regulator's input is zero: the exciter decays, and
the field freewheels through the rotating rectifier (FEX = 0).

Ceiling: with V_Rmax = 6.03 the steady field voltage ends at 3.75 pu where i_fd = E_fd.
The shortest time constant is 20 ms (T_R): the clock of 0.5 ms is that of the governor.

Source: [IEEE421.5] type AC1A, annex C (FEX) and its sample data; K_A, T_A [DAgostino2020] table A1.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import clip, maximum
from shipgrid.units import PerUnit, Ratio, Second


class State:
    v_m: PerUnit = signal("measured terminal voltage")
    x_l: PerUnit = signal("lead-lag state")
    v_a: PerUnit = signal("regulator output before its last limiter")
    v_e: PerUnit = signal("exciter voltage behind the commutating reactance")
    x_f: PerUnit = signal("rate feedback: exciter field current through its lag")


class Input:
    v_t: PerUnit = signal("terminal voltage")
    v_ref: PerUnit = signal("voltage reference")
    i_fd: PerUnit = signal("generator field current")
    on: Ratio = signal("1 while the regulator is excited", initial=1.0)


class Output:
    E_fd: PerUnit = signal("generator field voltage")
    v_fe: PerUnit = signal("exciter field current")
    limited: Ratio = signal("1 while the regulator's output is limited", limiter=True)


class Derived:
    A: PerUnit = signal("saturation law, first constant")
    B: Ratio = signal("saturation law, second constant, 1/pu")


def derive(p: Ac1a) -> dict[str, float]:
    """Constants of the saturation law through its two points."""
    E_1, S_1, E_2, S_2 = p.E_1, p.S_1, p.E_2, p.S_2
    if p.quadratic > 0.5:
        root = math.sqrt(S_1 * E_1 / (S_2 * E_2))
        A = (root * E_2 - E_1) / (root - 1.0)
        return {"A": A, "B": S_1 * E_1 / (E_1 - A) ** 2}
    B = math.log(S_1 / S_2) / (E_1 - E_2)
    return {"A": S_1 / math.exp(B * E_1), "B": B}


@kernel
def saturation(v_e, p):
    """Saturation voltage v_e S_E(v_e) [pu] of the exciter."""
    if p.quadratic.real > 0.5:
        return p.B * maximum(v_e - p.A, 0.0) ** 2
    return v_e * p.A * np.exp(p.B * v_e)


@kernel
def fex(i_n):
    """Voltage factor of the loaded rectifier for the normalised current `i_n` ([IEEE421.5] annex C)."""
    if i_n.real <= 0.0:
        return 1.0 + 0.0 * i_n
    if i_n.real <= 0.433:
        return 1.0 - 0.577 * i_n
    if i_n.real < 0.75:
        return np.sqrt(0.75 - i_n**2)
    if i_n.real <= 1.0:
        return 1.732 * (1.0 - i_n)
    return 0.0 * i_n


@kernel
def rectified(v_e, i_fd, p):
    """Field voltage behind the rectifier, (8); a dead exciter leaves the field current freewheeling."""
    return v_e * fex(p.K_C * i_fd / v_e) if v_e.real > 1e-6 else 0.0 * v_e


@kernel
def derivatives(t, x: State, u: Input, p: Ac1a, dx: State):
    v_fe = p.K_E * x.v_e + saturation(x.v_e, p) + p.K_D * u.i_fd  # (7)
    e = u.v_ref - x.v_m - p.K_F / p.T_F * (v_fe - x.x_f) if u.on.real > 0.5 else 0.0 * x.v_m  # (2)
    dx.v_m = (u.v_t - x.v_m) / p.T_R  # (1)
    dx.x_f = (v_fe - x.x_f) / p.T_F
    if p.T_B.real > 0.0:
        dx.x_l = (e - x.x_l) / p.T_B  # (3)
        y_l = x.x_l + p.T_C / p.T_B * (e - x.x_l)
    else:
        dx.x_l = 0.0 * e
        y_l = e
    dx.v_a = (p.K_A * y_l - x.v_a) / p.T_A  # (4)
    v_a = clip(x.v_a, p.V_Amin, p.V_Amax)  # inside a step too: its trial value runs beyond what `limit` leaves of it
    dx.v_e = (clip(v_a, p.V_Rmin, p.V_Rmax) - v_fe) / p.T_E  # (5), (6)


@kernel
def outputs(t, x: State, u: Input, p: Ac1a, y: Output):
    y.E_fd = rectified(x.v_e, u.i_fd, p)  # (8)
    y.v_fe = p.K_E * x.v_e + saturation(x.v_e, p) + p.K_D * u.i_fd
    y.limited = 1.0 if x.v_a.real >= p.V_Rmax.real or x.v_a.real <= p.V_Rmin.real else 0.0


@kernel
def limit(x: State, u: Input, p: Ac1a):
    x.v_a = clip(x.v_a, p.V_Amin, p.V_Amax)
    x.v_e = maximum(x.v_e, 0.0)


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    limit=limit,
)
class Ac1a(Derived):
    """Excitation system AC1A; E_fd and i_fd per unit of the no-load field on the air-gap line."""

    K_A: PerUnit = param("regulator gain", default=600.0, above=0.0, source="[DAgostino2020] table A1")
    T_A: Second = param("regulator lag", default=0.05, at_least=2e-3, source="[DAgostino2020] table A1")
    T_R: Second = param("transducer lag", default=0.02, at_least=2e-3, source="default of the block")
    T_B: Second = param("lead-lag, lag; 0 bypasses it", default=0.0, at_least=0.0, source="[IEEE421.5] sample data")
    T_C: Second = param("lead-lag, lead", default=0.0, at_least=0.0, source="[IEEE421.5] sample data")
    V_Amin: PerUnit = param("lower limit of v_a", default=-14.5, at_most=0.0, source="[IEEE421.5] sample data")
    V_Amax: PerUnit = param("upper limit of v_a", default=14.5, above=0.0, source="[IEEE421.5] sample data")
    V_Rmin: PerUnit = param("lower limit of v_r", default=-5.43, at_most=0.0, source="[IEEE421.5] sample data")
    V_Rmax: PerUnit = param("upper limit of v_r", default=6.03, above=0.0, source="[IEEE421.5] sample data")
    K_F: PerUnit = param("rate feedback gain, s", default=0.03, at_least=0.0, source="[IEEE421.5] sample data")
    T_F: Second = param("rate feedback lag", default=1.0, at_least=2e-3, source="[IEEE421.5] sample data")
    K_E: PerUnit = param("exciter self-excitation constant", default=1.0, above=0.0, source="[IEEE421.5] sample data")
    T_E: Second = param(
        "exciter time constant",
        default=0.10,
        at_least=2e-3,
        source="[Stamford2020] brushless, 650 to 825 kVA: 0.099 s; the sample data's 0.8 s are of a power station's",
    )
    K_C: PerUnit = param("rectifier loading", default=0.2, at_least=0.0, source="[IEEE421.5] sample data")
    K_D: PerUnit = param("demagnetising factor", default=0.38, at_least=0.0, source="[IEEE421.5] sample data")
    E_1: PerUnit = param("exciter voltage, upper point", default=4.18, above=0.0, source="[IEEE421.5] sample data")
    S_1: PerUnit = param("saturation factor there", default=0.10, above=0.0, source="[IEEE421.5] sample data")
    E_2: PerUnit = param("exciter voltage, lower point", default=3.14, above=0.0, source="[IEEE421.5] sample data")
    S_2: PerUnit = param("saturation factor there", default=0.03, above=0.0, source="[IEEE421.5] sample data")
    quadratic: Ratio = param(
        "saturation law: 0 exponential, 1 quadratic", default=0.0, at_least=0.0, at_most=1.0, source="[IEEE421.5]"
    )
