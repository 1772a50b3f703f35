"""Diesel engine of a genset: fuel to torque after the dead time, friction without fuel, starter.

    T_m = throttle(t - T_D) + crank T_s max(0, 1 - omega / omega_s) - (1 - fuel) T_f clip(omega / omega_f)      (1)

The throttle is calibrated in brake torque, as in the governor models it comes from: with fuel the friction is inside
it. Without fuel the friction brakes the shaft; below `omega_f` it falls to zero with the speed, so that the shaft
stops and does not turn back. The starter is a series motor: its torque falls from standstill to its no-load speed.

The dead time, from the rack to the mean torque of the cylinders fired with it, is a delay line with linear
interpolation. The torque is held over a sampling period, so the line is read half a period early: the mean of what is
held is on time. Stage `outer`: the throttle written at an instant is the governor's at that instant.

The shaft power is counted by the generator (`supplied`), which has torque and speed of the same step.

Source: dead time of the governor block that [DAgostino2020] names; docs/theory/machines.md.
"""

from __future__ import annotations

import math

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import clip, maximum
from shipgrid.units import PerUnit, Ratio, Second


class State:
    position: Ratio = signal("cell of the delay line that is written next", rotates=True)


class Input:
    throttle: PerUnit = signal("fuel rack, in brake torque at rated speed")
    omega: PerUnit = signal("shaft speed")
    fuel: Ratio = signal("1 while fuel is admitted", initial=1.0)
    crank: Ratio = signal("1 while the starter is engaged", initial=0.0)


class Output:
    T_m: PerUnit = signal("torque on the generator's shaft")


class Derived:
    line: Ratio = signal("first cell of the delay line in the pool (set at assembly)")


def derive(p: DieselEngine) -> dict[str, float]:
    return {"line": 0.0}


@kernel
def cells(delay, dt):
    """Cells of a line that holds `delay` [s] in samples of `dt` [s]: two to interpolate between, one being written."""
    return math.ceil(delay / dt) + 2


@kernel
def update(t, dt, x: State, u: Input, p: DieselEngine, x_next: State, y: Output, delays):
    n, line, write = cells(p.T_D.real, dt), int(p.line.real), int(x.position.real)
    delays[line + write] = u.throttle.real
    age = maximum(p.T_D.real / dt - 0.5, 0.0)  # in samples, half a period early: see the module's text
    whole = int(age)
    newer, older = (write - whole) % n, (write - whole - 1) % n
    late = delays[line + newer] + (age - whole) * (delays[line + older] - delays[line + newer])
    x_next.position = float((write + 1) % n)
    starter = u.crank * p.T_s * maximum(1.0 - u.omega / p.omega_s, 0.0)
    friction = (1.0 - u.fuel) * p.T_f * clip(u.omega / p.omega_f, -1.0, 1.0)
    y.T_m = late + starter - friction  # (1)


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, update=update, stage="outer")
class DieselEngine(Derived):
    """Diesel engine with starter; torques per unit of the generator's base."""

    T_D: Second = param(
        "dead time from rack to torque",
        default=0.024,
        at_least=0.0,
        source="default of the block; two firing intervals of six cylinders at 1800 rpm",
    )
    T_f: PerUnit = param(
        "friction torque without fuel",
        default=0.05,
        at_least=0.0,
        source="typical: friction mean effective pressure 1 bar, brake mean effective pressure 20 bar at rating",
    )
    omega_f: PerUnit = param(
        "speed below which the friction falls with the speed", default=0.02, above=0.0, source="numerical: 36 rpm"
    )
    T_s: PerUnit = param(
        "starter torque at standstill", default=0.15, above=0.0, source="typical: three times the friction"
    )
    omega_s: PerUnit = param("no-load speed of the starter", default=0.4, above=0.0, source="typical")

    def delay_length(self, dt: float) -> int:
        """Cells of the delay line for a sampling period of `dt` [s]."""
        return cells(self.T_D, dt)

    def dead_times(self) -> dict[str, float]:
        """Inputs that act late, and by how much [s]: what small signals have in the place of the delay line."""
        return {"throttle": self.T_D}
