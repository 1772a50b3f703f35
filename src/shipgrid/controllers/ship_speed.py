"""Cruise control above a propulsion drive: from ship speed to shaft speed reference.

    u_ramp  follows speed_ref at `rate`                                             (1)
    u_lag   follows u_ramp with the time constant `T_lag`                           (2)
    y = PI((u_lag - u_ship) / u_n),   |y| <= 1                                      (3)
    n_ref = y ((1 + y_0^2) / (y^2 + y_0^2))^(1/4)                                   (4)
    di/dt = K_i e  + (i_neighbour - i) / T_share  - w i / T_leak                    (5)
    w = max(0, 1 - max(|u_lag|, |speed_ref|) / u_leak)

(1) and (2) keep the power of acceleration below the sources' limit and the overshoot below 2 %. The published
controller is (3) with n_ref = y. (4) and the other two terms of (5) are additions to it, each for a reason:

*Thrust.* It goes with the square of shaft speed, so that the gain of the published loop goes with the speed: with its
gains of 3 and 1 the damping ratio falls to 0.2 at 90 rpm, and thrust swings by half of its peak when the ship leaves.
With (4) the loop has the same gain above `y_0`: y is a share of the thrust at rated speed, down to `y_0`, below which
the shaft speed is in proportion to it. A root alone is infinitely steep at zero: the shaft would be thrown through
standstill, and the motor's torque be that of its inertia (docs/decisions/0019-screws-against-the-flow.md). K_i follows
from a damping ratio of 0.7 with the published K_p (docs/decisions/0012-cruise-control.md). K_i = 1 with a y_0 far above
1 is the published controller.

*Sharing.* Every drive has its own integrator, and all act on the one speed of the ship: what they differ by is never
corrected. So each one's is drawn to that of its neighbour (the drives of a ship form a ring) while that is on: the
difference dies out with `T_share` and the sum is untouched. Given unequal references, two drives part by a bounded
amount instead of winding up against each other.

*Leak.* The loop gain still vanishes at standstill. At zero speed nothing needs an integrator (no resistance), so it
leaks while the reference is below `u_leak`, before its ramp and behind it: on the way from ahead to astern it keeps
what it has. Against a steady force at standstill (wind) the ship holds with a slight creep.

*Hold.* While the drive gives all the torque that motor and bus bear and the shaft is short of its reference, the
integrator of (5) does not wind up any further in that direction: K_i e is left out. Where blackout prevention cuts the
drive back it is not held: there the reference comes down to what there is (`automation/load_limit.py`).

While the drive is off it follows the ship's and the shaft's actual speed, and takes over from there.

Source: [DAgostino2020] table A1; docs/theory/propulsion.md.
"""

from __future__ import annotations

import numpy as np

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
    i_neighbour: Ratio = signal("integrator of the next drive in the ring", initial=0.0)
    neighbour_enabled: Ratio = signal("1 while that drive is on", initial=0.0)
    all_torque: Ratio = signal("1 while the drive gives all the torque that motor and bus bear", initial=0.0)


class Output:
    n_ref: PerUnit = signal("shaft speed reference over rated speed")
    limited: Ratio = signal("1 while the shaft speed limit acts", limiter=True)


@kernel
def demand(n, y_0):
    """What gives the shaft speed `n` by (4)."""
    rated, share = 1.0 + y_0 * y_0, n * n
    return n * np.sqrt((share + np.sqrt(share * share + 4.0 * rated * y_0 * y_0)) / (2.0 * rated))


@kernel
def update(dt, x: State, u: Input, p: ShipSpeed, x_next: State, y: Output):
    if u.enabled.real > 0.5:
        x_next.u_ramp = ramp(u.speed_ref, x.u_ramp, p.rate, dt)  # (1)
        x_next.u_lag = low_pass(x_next.u_ramp, x.u_lag, 1.0 / p.T_lag, dt)  # (2)
        e = (x_next.u_lag - u.u_ship) / p.u_n
        thrust = pi(e, 0.0, p.K_p, p.K_i, -1.0, 1.0, dt, x.speed, x_next.speed)  # (3)
        y.n_ref = thrust * np.sqrt(np.sqrt((1.0 + p.y_0 * p.y_0) / (thrust * thrust + p.y_0 * p.y_0)))  # (4)
        aim = maximum(absolute(x_next.u_lag), absolute(u.speed_ref))
        leak = maximum(0.0, 1.0 - aim / p.u_leak) / p.T_leak
        if u.all_torque.real > 0.5 and (e * (y.n_ref - u.omega_pu)).real > 0.0:
            x_next.speed.i = x.speed.i
        share = (u.i_neighbour - x.speed.i) / p.T_share if u.neighbour_enabled.real > 0.5 else 0.0 * x.speed.i
        x_next.speed.i += dt * (share - leak * x.speed.i)  # (5)
        y.limited = 1.0 if absolute(thrust).real >= 1.0 else 0.0
    else:
        x_next.u_ramp = u.u_ship
        x_next.u_lag = u.u_ship
        y.n_ref = clip(u.omega_pu, -1.0, 1.0)
        x_next.speed.i = demand(y.n_ref, p.y_0)
        y.limited = 0.0


@component(state=State, input=Input, output=Output, stage="outer", update=update)
class ShipSpeed:
    """Ship speed PI with ramp and lag on its reference, its output in per unit of the thrust at rated shaft speed."""

    K_p: PerUnit = param("proportional gain", default=3.0, at_least=0.0, source="[DAgostino2020] table A1")
    K_i: PerUnitPerSecond = param(
        "integral gain", default=0.2, at_least=0.0, source="damping ratio 0.7: docs/theory/propulsion.md; published: 1"
    )
    y_0: Ratio = param(
        "demand, as a share of thrust at rated speed, below which shaft speed is in proportion to it",
        default=0.05,
        above=0.0,
        source="0.03 to 0.15 tried: docs/decisions/0019-screws-against-the-flow.md; published: far above 1",
    )
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
        source="without it the published control overshoots by 2.7 %: docs/theory/propulsion.md",
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
