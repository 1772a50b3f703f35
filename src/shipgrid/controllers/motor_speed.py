"""Speed control of a propulsion motor: a PI controller from speed error to torque, in per unit.

    tau_ref = PI(n_ref - n),   |tau_ref| <= tau_max share clip((v_dc - v_zero) / (v_full - v_zero), 0, 1)         (1)

The torque limit falls linearly to zero as the bus sinks from `v_full` to `v_zero`: a constant-power load on a bus
whose sources are at their limit would pull it down altogether. `share` is the part of the torque the on/off sequence
grants.

It runs at every step, like the current control below it: (1) closes a loop through the DC link, whose time constant
(link capacitance over the conductance tau_max omega / (v_full - v_zero)) is about a millisecond; a slower sampling of
v_dc would make it hunt.

Source: [DAgostino2020] table A1; docs/theory/propulsion.md.
"""

from __future__ import annotations

from shipgrid.controllers.blocks.pi import PiState, pi
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, clip
from shipgrid.units import PerUnit, PerUnitPerSecond, Ratio, Volt


class State:
    speed: PiState


class Input:
    n_ref: PerUnit = signal("speed reference over rated speed")
    omega_pu: PerUnit = signal("shaft speed over rated speed")
    v_dc: Volt = signal("bus voltage at the drive")
    enabled: Ratio = signal("1 while the gates are released", initial=1.0)
    share: Ratio = signal("part of the torque limit granted, 0 to 1", initial=1.0)


class Output:
    tau_ref: PerUnit = signal("torque reference over rated torque")
    torque_limited: Ratio = signal("1 while the torque limit acts", limiter=True)
    voltage_limited: Ratio = signal("1 while low bus voltage reduces the torque limit", limiter=True)
    all_torque: Ratio = signal("1 while the torque limit acts and `share` is 1")


@kernel
def update(dt, x: State, u: Input, p: MotorSpeed, x_next: State, y: Output):
    granted = clip((u.v_dc - p.v_zero) / (p.v_full - p.v_zero), 0.0, 1.0)
    y.voltage_limited = 1.0 if granted.real < 1.0 and u.enabled.real > 0.5 else 0.0
    if u.enabled.real > 0.5:
        limit = p.tau_max * clip(u.share, 0.0, 1.0) * granted
        y.tau_ref = pi(u.n_ref - u.omega_pu, 0.0, p.K_p, p.K_i, -limit, limit, dt, x.speed, x_next.speed)  # (1)
        y.torque_limited = 1.0 if absolute(y.tau_ref).real >= limit.real else 0.0
        y.all_torque = y.torque_limited if u.share.real >= 1.0 else 0.0
    else:
        x_next.speed.i = 0.0
        y.tau_ref = 0.0
        y.torque_limited = y.all_torque = 0.0


@component(state=State, input=Input, output=Output, stage="outer", update=update)
class MotorSpeed:
    """Speed PI with torque limit; per unit of rated torque and speed."""

    K_p: PerUnit = param("proportional gain", default=10.0, at_least=0.0, source="[DAgostino2020] table A1")
    K_i: PerUnitPerSecond = param("integral gain", default=15.0, at_least=0.0, source="[DAgostino2020] table A1")
    tau_max: PerUnit = param(
        "torque limit", default=1.257, above=0.0, source="7.2 over 5.73 kN m, [DAgostino2020] table A1"
    )
    v_full: Volt = param("bus voltage below which the torque limit falls", default=700.0, above=0.0, source="typical")
    v_zero: Volt = param("bus voltage at which it is zero", default=660.0, above=0.0, source="typical")
