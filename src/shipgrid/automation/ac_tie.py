"""Control of an AC tie: it synchronises the two bars before it closes, and unloads itself before it opens.

    open -> synchronising -> closed -> unloading -> open

With dtheta the angle by which the bar `from` leads the bar `to`, and V the lengths of their voltages in per unit, the
inverters of the moved bar (`to`, or with `sign` -1 the other) get trims of frequency, voltage and power:

    synchronising   dw = clip(k_p dtheta + x, +-dw_max),   dx/dt = k_i dtheta, |x| <= dw_max           (1)
                    d(dV)/dt = k_v (V_from - V_to), |dV| <= dV_max                                     (2)
    closed, open    the trims that were, taken back along a straight line in `t_decay`: droop shares    (3)
    unloading       d(dp)/dt = rate clip(p/p_open, +-1),   d(dV)/dt = v_rate clip(q/q_open, +-1)       (4)

p, q: what flows from `from` to `to`. It closes when angle, frequency and voltage have agreed for `hold`, or when one
bar has been dead for `t_dead` (an inverter that starts leaves `v_dead` sooner). Where the loads of the bars differ by
more than dw_max/m_p no lock is possible: after `patience` it gives up and says so, and goes on only watching. It opens
when little flows, or after `t_unload` at the latest; and at once where the power does not follow, because only one of
the bars has an inverter.

The angle is that of the product v_from conj(v_to) through a low-pass, the frequency difference the slope of that angle.
Source: synchronising limits tighter than class practice (10 degrees, 0.2 Hz, 5 %); docs/theory/grid_forming.md.
"""

from __future__ import annotations

import math

from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, arctan2, clip, hypot, minimum, wrap
from shipgrid.units import (
    Ampere,
    Hertz,
    PerSecond,
    PerUnit,
    PerUnitPerSecond,
    Radian,
    RadianPerSecond,
    Ratio,
    Second,
    Volt,
    VoltAmpere,
)

OPEN, SYNCHRONISING, CLOSED, UNLOADING = 0.0, 2.0, 1.0, 3.0
STATES = {0: "open", 1: "closed", 2: "synchronising", 3: "unloading"}
REFUSALS = {1: "both bars are live and could not be brought into step"}


class State:
    """State of the control."""

    state: Ratio = signal("0 open, 1 closed, 2 synchronising, 3 unloading")
    elapsed: Second = signal("time in this state")
    refused: Ratio = signal("1: gave up synchronising while the command stands")
    product: PerUnit = signal("product of the bars' voltages through the low-pass, in phase")
    across: PerUnit = signal("product of the bars' voltages through the low-pass, across")
    slip: Hertz = signal("difference of the frequencies, through a low-pass")
    in_step: Second = signal("for how long the bars have been in step")
    dead: Second = signal("for how long a bar has been dead")
    integral: PerUnit = signal("integrator of the frequency trim")
    dw: PerUnit = signal("frequency trim when it was last moved")
    dV: PerUnit = signal("voltage trim when it was last moved")
    dp: PerUnit = signal("power trim when it was last moved")
    share: Ratio = signal("what is left of the trims")
    p_before: PerUnit = signal("power through the tie when unloading began")


class Input:
    """Input of the control."""

    close: Ratio = signal("command")
    from_alpha: Volt = signal("voltage of one bar, alpha axis")
    from_beta: Volt = signal("voltage of one bar, beta axis")
    to_alpha: Volt = signal("voltage of the other bar, alpha axis")
    to_beta: Volt = signal("voltage of the other bar, beta axis")
    i_alpha: Ampere = signal("tie current, alpha axis")
    i_beta: Ampere = signal("tie current, beta axis")


class Output:
    """Output of the control."""

    code: Ratio = signal("state of the control")
    closed: Ratio = signal("1: closed")
    position: Ratio = signal("contact position of the branch: 0 closed, 1 open", initial=1.0)
    refused: Ratio = signal("reason why it does not close, 0: none")
    dw_sync: PerUnit = signal("frequency trim for the moved inverters")
    dV_sync: PerUnit = signal("voltage trim for the moved inverters")
    dp_sync: PerUnit = signal("power trim for the moved inverters")


class Derived:
    """Base."""

    v_b: Volt = signal("base voltage, peak of a phase")


def derive(p: AcTie) -> dict[str, float]:
    """Base voltage."""
    return {"v_b": math.sqrt(2.0 / 3.0) * p.v_n}


@kernel
def compare(dt, x: State, u: Input, p: AcTie, x_next: State):
    """Angle of `from` before `to` [rad], voltage difference [pu]; books for how long a bar is dead or both agree."""
    v_from = hypot(u.from_alpha, u.from_beta) / p.v_b
    v_to = hypot(u.to_alpha, u.to_beta) / p.v_b
    product = (u.from_alpha * u.to_alpha + u.from_beta * u.to_beta) / p.v_b**2
    across = (u.from_beta * u.to_alpha - u.from_alpha * u.to_beta) / p.v_b**2
    before = arctan2(x.across, x.product)
    x_next.product = low_pass(product, x.product, p.omega_f, dt)
    x_next.across = low_pass(across, x.across, p.omega_f, dt)
    angle = arctan2(x_next.across, x_next.product)
    x_next.slip = low_pass(wrap(angle - before) / (2.0 * math.pi * dt), x.slip, p.omega_f, dt)
    dv = v_from - v_to
    alike = absolute(dv).real < p.dv_max.real and absolute(x_next.slip).real < p.df_max.real
    alike = alike and absolute(angle).real < p.dtheta_max.real
    x_next.in_step = x.in_step + dt if alike else 0.0
    x_next.dead = x.dead + dt if minimum(v_from, v_to).real < p.v_dead.real else 0.0
    return angle, dv


@kernel
def synchronise(angle, dv, dt, x: State, p: AcTie, x_next: State):
    """Move frequency and voltage towards agreement: (1), (2)."""
    x_next.integral = clip(x.integral + p.k_i * angle * dt, -p.dw_max, p.dw_max)
    x_next.dw = p.sign * clip(p.k_p * angle + x_next.integral, -p.dw_max, p.dw_max)
    x_next.dV = clip(x.dV + p.sign * p.k_v * dv * dt, -p.dV_max, p.dV_max)


@kernel
def unload(p_tie, q_tie, dt, x: State, p: AcTie, x_next: State):
    """Move power and voltage until little flows: (4); whether it does."""
    x_next.dp = clip(x.dp + p.sign * p.rate * dt * clip(p_tie / p.p_open, -1.0, 1.0), -1.0, 1.0)
    x_next.dV = clip(x.dV + p.sign * p.v_rate * dt * clip(q_tie / p.q_open, -1.0, 1.0), -p.dV_max, p.dV_max)
    return absolute(p_tie).real < p.p_open.real and absolute(q_tie).real < p.q_open.real


@kernel
def hold_trims(x: State, x_next: State):
    """Begin to move the trims from where they are now."""
    x_next.dw, x_next.dV, x_next.dp = x.share * x.dw, x.share * x.dV, x.share * x.dp


@kernel
def update(t, dt, x: State, u: Input, p: AcTie, x_next: State, y: Output):
    wanted = u.close.real > 0.5
    angle, dv = compare(dt, x, u, p, x_next)
    p_tie = 1.5 * (u.to_alpha * u.i_alpha + u.to_beta * u.i_beta) / p.S_n
    q_tie = 1.5 * (u.to_beta * u.i_alpha - u.to_alpha * u.i_beta) / p.S_n
    may_close = x_next.dead.real >= p.t_dead.real or x_next.in_step.real >= p.hold.real
    state = x.state.real
    now = state
    refused = x.refused.real if wanted else 0.0

    if state == OPEN:
        if wanted and may_close:
            now = CLOSED
        elif wanted and refused == 0.0 and x_next.dead.real == 0.0:
            now = SYNCHRONISING
    elif state == SYNCHRONISING:
        if not wanted:
            now = OPEN
        elif may_close:
            now = CLOSED
        elif x.elapsed.real >= p.patience.real:
            now = OPEN
            refused = 1.0
    elif state == CLOSED:
        if not wanted:
            now = UNLOADING
    elif wanted:
        now = CLOSED

    moving = now in (SYNCHRONISING, UNLOADING)
    if moving and now != state:
        hold_trims(x, x_next)
        x_next.integral = p.sign * x_next.dw
        x_next.share = 1.0
        x_next.p_before = p_tie
    elif now == SYNCHRONISING:
        synchronise(angle, dv, dt, x, p, x_next)
    elif now == UNLOADING:
        little = unload(p_tie, q_tie, dt, x, p, x_next)
        stands = absolute(p_tie - x.p_before).real < absolute(p.follows * x.dp).real
        if x.elapsed.real >= p.t_judge.real and stands:
            x_next.share = 0.0
            now = OPEN
        elif little or x.elapsed.real >= p.t_unload.real:
            now = OPEN
    else:
        x_next.share = ramp(0.0, x.share, 1.0 / p.t_decay, dt)  # (3)

    x_next.state = now
    x_next.elapsed = x.elapsed + dt if now == state else 0.0 * x.elapsed
    x_next.refused = refused if now != CLOSED else 0.0
    y.code = now
    y.closed = 1.0 if now in (CLOSED, UNLOADING) else 0.0
    y.position = 1.0 - y.closed
    y.refused = x_next.refused
    y.dw_sync = x_next.share * x_next.dw
    y.dV_sync = x_next.share * x_next.dV
    y.dp_sync = x_next.share * x_next.dp


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, update=update, stage="supervise")
class AcTie(Derived):
    """Closing and opening of an AC tie, with its synchroniser."""

    v_n: Volt = param("nominal voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    S_n: VoltAmpere = param(
        "rating of the inverters it moves", default=50e3, above=0.0, source="[DAgostino2020] table A1"
    )
    sign: Ratio = param(
        "1: it moves the bar `to`, -1: the bar `from`", default=1.0, at_least=-1.0, at_most=1.0, source="equipment"
    )
    k_p: PerUnit = param("frequency trim per angle [pu/rad]", default=0.02, above=0.0, source="poles -3.8 +- 4.0j 1/s")
    k_i: PerUnitPerSecond = param("its integral gain [pu/(rad s)]", default=0.08, above=0.0, source="with k_p")
    k_v: PerSecond = param("voltage trim per difference and second", default=0.5, above=0.0, source="2 s, gentle")
    dw_max: PerUnit = param("largest frequency trim", default=0.01, above=0.0, source="0.6 Hz")
    dV_max: PerUnit = param("largest voltage trim", default=0.05, above=0.0, source="the band of the bar's voltage")
    dtheta_max: Radian = param(
        "largest angle at closing", default=math.radians(2.0), above=0.0, source="class practice: 10 degrees"
    )
    df_max: Hertz = param("largest difference of frequency at closing", default=0.05, above=0.0, source="0.2 Hz")
    dv_max: PerUnit = param("largest difference of voltage at closing", default=0.01, above=0.0, source="5 %")
    hold: Second = param("time in step before closing", default=0.2, at_least=0.0, source="class practice")
    omega_f: RadianPerSecond = param(
        "corner of the low-passes of angle and slip", default=2.0 * math.pi * 20.0, above=0.0, source="of a transducer"
    )
    v_dead: PerUnit = param("below this a bar is dead", default=0.05, above=0.0, source="dead-bus rule, 5 %")
    t_dead: Second = param(
        "time dead before it closes there", default=0.1, at_least=0.0, source="a bar that starts is above 5 % sooner"
    )
    t_decay: Second = param("time in which the trims are taken back", default=5.0, above=0.0, source="gentle")
    patience: Second = param("longest synchronising", default=20.0, above=0.0, source="seven times the longest seen")
    rate: PerUnitPerSecond = param("rate of the power trim when unloading", default=0.25, above=0.0, source="typical")
    v_rate: PerUnitPerSecond = param("rate of the voltage trim then", default=0.02, above=0.0, source="0.08 pu/s of q")
    p_open: PerUnit = param("active power at which it opens", default=0.03, above=0.0, source="typical")
    q_open: PerUnit = param("reactive power at which it opens", default=0.05, above=0.0, source="typical")
    t_judge: Second = param(
        "time of unloading after which it judges whether power follows",
        default=0.5,
        above=0.0,
        source="ten times the angle loop's",
    )
    follows: Ratio = param(
        "change of power over that of its set point below which nothing can be moved",
        default=0.05,
        above=0.0,
        source="a tenth of the 0.5 of two equal inverters",
    )
    t_unload: Second = param("longest unloading", default=5.0, above=0.0, source="twice that of 0.5 pu")
