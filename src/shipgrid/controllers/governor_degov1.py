"""DEGOV1: speed governor of a diesel genset with droop, Woodward type.

    e = omega_ref - omega - droop fb,   fb = throttle (M = 0) or p_e / (1 + T_E s) (M = 1)      (1)
    y_1 = (1 + T_3 s) / (1 + T_1 s + T_1 T_2 s^2) e             electric control box            (2)
    y_2 = (1 + T_4 s) / ((1 + T_5 s)(1 + T_6 s)) y_1            actuator                        (3)
    throttle = K y_2 / s,   T_min .. T_max, without wind-up                                     (4)

The droop signal is taken before the engine's dead time, which the engine has. In steady state
omega = omega_ref - droop throttle. With the fuel cut the error is taken as zero and the rack closes, so that nothing
winds up and the next start begins at rest.

The throttle is brake torque, so its lower stop, where no fuel is injected, is not zero but the engine's friction, and
negative: an unloaded engine above its speed comes down. With zero there it would stay above it for good.

The shortest time constant is 9 ms (T_5): a clock of 0.5 ms steps it with an error of 1e-3 of it.

Source: model DEGOV1 of the PSS/E library; gains [DAgostino2020] table A1, time constants of the block it names.
"""

from __future__ import annotations

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import clip
from shipgrid.units import PerUnit, Ratio, Second


class State:
    z_1: PerUnit = signal("control box: error through its two lags")
    z_2: Ratio = signal("control box: rate of z_1, pu/s")
    a_1: PerUnit = signal("actuator: after its first lag")
    a_2: PerUnit = signal("actuator: after both lags")
    throttle: PerUnit = signal("fuel rack, in brake torque")
    p_f: PerUnit = signal("filtered electrical power")


class Input:
    omega: PerUnit = signal("shaft speed")
    omega_ref: PerUnit = signal("speed reference at no load")
    p_e: PerUnit = signal("electrical power, used with M = 1", initial=0.0)
    fuel: Ratio = signal("1 while fuel is admitted", initial=1.0)


class Output:
    limited: Ratio = signal("1 while the rack stands at its upper stop", limiter=True)


@kernel
def derivatives(t, x: State, u: Input, p: Degov1, dx: State):
    fb = x.p_f if p.M.real > 0.5 else x.throttle
    e = u.omega_ref - u.omega - p.droop * fb if u.fuel.real > 0.5 else 0.0 * u.omega  # (1)
    dx.z_1 = x.z_2  # (2)
    dx.z_2 = (e - x.z_1 - p.T_1 * x.z_2) / (p.T_1 * p.T_2)
    y_1 = x.z_1 + p.T_3 * x.z_2
    dx.a_1 = (y_1 - x.a_1) / p.T_5  # (3)
    dx.a_2 = (x.a_1 - x.a_2) / p.T_6
    y_2 = x.a_2 + p.T_4 / p.T_6 * (x.a_1 - x.a_2)
    dx.throttle = p.K * y_2  # (4)
    dx.p_f = (u.p_e - x.p_f) / p.T_E


@kernel
def outputs(t, x: State, u: Input, p: Degov1, y: Output):
    y.limited = 1.0 if x.throttle.real >= p.T_max.real else 0.0


@kernel
def limit(x: State, u: Input, p: Degov1):
    x.throttle = clip(x.throttle, p.T_min, p.T_max) if u.fuel.real > 0.5 else 0.0 * x.throttle


@component(state=State, input=Input, output=Output, derivatives=derivatives, outputs=outputs, limit=limit)
class Degov1:
    """Diesel governor; per unit of the generator's base. Every lag is at least four periods of its 0.5 ms clock."""

    K: PerUnit = param("actuator gain, 1/s", default=8.0, above=0.0, source="[DAgostino2020] table A1")
    droop: PerUnit = param("speed droop", default=0.05, at_least=0.0, source="[DAgostino2020] table A1")
    M: Ratio = param(
        "droop signal: 0 throttle, 1 electrical power", default=0.0, at_least=0.0, at_most=1.0, source="typical"
    )
    T_1: Second = param("control box, lag", default=0.01, at_least=2e-3, source="default of the block")
    T_2: Second = param("control box, second lag", default=0.02, at_least=2e-3, source="default of the block")
    T_3: Second = param("control box, lead", default=0.2, at_least=0.0, source="default of the block")
    T_4: Second = param("actuator, lead", default=0.25, at_least=0.0, source="default of the block")
    T_5: Second = param("actuator, first lag", default=0.009, at_least=2e-3, source="default of the block")
    T_6: Second = param("actuator, second lag", default=0.0384, at_least=2e-3, source="default of the block")
    T_max: PerUnit = param("upper stop of the rack", default=1.1, above=0.0, source="default of the block")
    T_min: PerUnit = param(
        "lower stop of the rack", default=-0.05, at_most=0.0, source="friction of the engine without fuel; block: 0"
    )
    T_E: Second = param("filter of the electrical power", default=0.05, at_least=2e-3, source="typical")
