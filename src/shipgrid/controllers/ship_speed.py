"""Cruise control above a propulsion drive: from ship speed to shaft speed reference.

    u_ramp  follows speed_ref at `rate`                                             (1)
    u_lag   follows u_ramp with the time constant `T_lag`                           (2)
    n_ref = PI((u_lag - u_ship) / u_n),   |n_ref| <= 1 pu                           (3)
    di/dt = K_i e  + (i_neighbour - i) / T_share  - w i / T_leak                    (4)
    w = max(0, 1 - |u_lag| / u_leak)

(1) and (2) keep the power of acceleration below the sources' limit and the overshoot below 2 %. The other two terms
of (4) are additions to the published controller, each for a reason:

*Sharing.* Every drive has its own integrator, and all act on the one speed of the ship: what they differ by is never
corrected. So each one's is drawn to that of its neighbour (the drives of a ship form a ring) while that is on: the
difference dies out with `T_share` and the sum is untouched. Given unequal references, two drives part by a bounded
amount instead of winding up against each other.

*Leak.* Thrust goes with the square of shaft speed, so that the loop gain vanishes at standstill: with a pure
integrator the screws swing to and fro for an hour, 0.05 pu after five minutes, while the ship rocks by some mm/s. At
zero speed nothing needs an integrator (no resistance), so it leaks while the reference is below `u_leak`. The ship
then settles without swinging: the speed dies out as 1/(0.1 t), within 5 mm/s a minute after the reference has come to
rest (tested). Against a steady force at standstill (wind) it holds with a slight creep: 3 cm/s for 1 kN.

While the drive is off it follows the ship's and the shaft's actual speed, and takes over from there.

Source: [DAgostino2020] table A1; docs/theory/propulsion.md.
"""

from __future__ import annotations

from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.blocks.pi import PiState, pi
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, clip, maximum
from shipgrid.units import KNOT, MetrePerSecond, MetrePerSecond2, PerUnit, PerUnitPerSecond, Ratio, Second


class State:
    speed: PiState
    u_ramp: MetrePerSecond = signal("reference after the ramp")
    u_lag: MetrePerSecond = signal("reference after ramp and lag")


class Input:
    speed_ref: MetrePerSecond = signal("commanded speed of the ship, positive ahead")
    u_ship: MetrePerSecond = signal("speed of the ship", initial=0.0)
    omega_pu: PerUnit = signal("shaft speed over rated speed")
    enabled: Ratio = signal("1 while the drive is on", initial=1.0)
    i_neighbour: PerUnit = signal("integrator of the next drive in the ring", initial=0.0)
    neighbour_enabled: Ratio = signal("1 while that drive is on", initial=0.0)


class Output:
    n_ref: PerUnit = signal("shaft speed reference over rated speed")
    limited: Ratio = signal("1 while the shaft speed limit acts", limiter=True)


@kernel
def update(dt, x: State, u: Input, p: ShipSpeed, x_next: State, y: Output):
    if u.enabled.real > 0.5:
        x_next.u_ramp = ramp(u.speed_ref, x.u_ramp, p.rate, dt)  # (1)
        x_next.u_lag = low_pass(x_next.u_ramp, x.u_lag, 1.0 / p.T_lag, dt)  # (2)
        e = (x_next.u_lag - u.u_ship) / p.u_n
        y.n_ref = pi(e, 0.0, p.K_p, p.K_i, -1.0, 1.0, dt, x.speed, x_next.speed)  # (3)
        leak = maximum(0.0, 1.0 - absolute(x_next.u_lag) / p.u_leak) / p.T_leak
        share = (u.i_neighbour - x.speed.i) / p.T_share if u.neighbour_enabled.real > 0.5 else 0.0 * x.speed.i
        x_next.speed.i += dt * (share - leak * x.speed.i)  # (4)
        y.limited = 1.0 if absolute(y.n_ref).real >= 1.0 else 0.0
    else:
        x_next.u_ramp = u.u_ship
        x_next.u_lag = u.u_ship
        y.n_ref = clip(u.omega_pu, -1.0, 1.0)
        x_next.speed.i = y.n_ref
        y.limited = 0.0


@component(state=State, input=Input, output=Output, stage="outer", update=update)
class ShipSpeed:
    """Ship speed PI with ramp and lag on its reference; per unit of 10 kn and of rated shaft speed."""

    K_p: PerUnit = param("proportional gain", default=3.0, at_least=0.0, source="[DAgostino2020] table A1")
    K_i: PerUnitPerSecond = param("integral gain", default=1.0, at_least=0.0, source="[DAgostino2020] table A1")
    u_n: MetrePerSecond = param(
        "ship speed that is 1 pu", default=10.0 * KNOT, above=0.0, source="10 kn, [DAgostino2020] table A1"
    )
    rate: MetrePerSecond2 = param(
        "ramp of the reference", default=0.05 * KNOT, above=0.0, source="0.05 kn/s: docs/theory/propulsion.md"
    )
    T_lag: Second = param(
        "time constant of the lag",
        default=10.0,
        above=0.0,
        source="without it 2.7 % overshoot: docs/theory/propulsion.md",
    )
    T_share: Second = param(
        "time constant of sharing between drives", default=20.0, above=0.0, source="chosen: slower than K_p / K_i"
    )
    u_leak: MetrePerSecond = param(
        "reference below which the integrator leaks", default=0.5 * KNOT, above=0.0, source="chosen by trial"
    )
    T_leak: Second = param(
        "time constant of the leak", default=20.0, above=0.0, source="chosen by trial: 5 to 30 s tried"
    )
