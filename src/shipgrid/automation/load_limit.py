"""Blackout prevention: what feeds a drive limits its power, before it is overloaded itself.

The loading of a source is 1 at what the rule allows it, of a battery or of a genset:

    loading = i_star/i_most                                                            (1)
    loading = p_f/p_most,   p_f: power at the terminals through a low-pass             (2)

A source counts while load falls on it (on, and not a battery in the mode `current`) and closed ties join it to the bus
of the drive. The heaviest loaded one decides; with its capacity P and what the drive takes, p,

    free = (1 - loading) P,   dp_max/dt = free/T_cut,   0 <= p_max <= p + max(0, free)     (3)

So an overload is taken away at a rate of itself over `T_cut`, on whichever sources it falls and whatever share of it
they carry; and p_max waits where the drive would bring the source to its limit, not beyond. The drive's torque limit is
p_max over its speed. While it acts, the cruise control's reference moves along its ramp to a little less than the speed
that the ship has, or to what is ordered if that is less still. So the control comes to ask for what there is and no
more, nothing winds up, and the ship goes on along the usual ramp when there is power again.

Below 700 V the drive's own torque limit acts within a step (`controllers/motor_speed.py`): it catches the bus when a
source is lost, this brings it back to where the others are not overloaded.
"""

from __future__ import annotations

from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, clip, maximum, minimum
from shipgrid.units import (
    Ampere,
    MetrePerSecond,
    PerUnit,
    RadianPerSecond,
    Ratio,
    Second,
    Watt,
)

NOBODY = -1.0
"""Loading where no source counts: nothing is to be limited."""
SLOW = 0.02
"""Shaft speed below which power is no measure of torque [pu]."""


class LoadState:
    p_f: PerUnit = signal("filtered power of a genset")


class LoadInput:
    i_star: Ampere = signal("current reference of a battery", initial=0.0)
    p: PerUnit = signal("power of a genset", initial=0.0)
    mode: Ratio = signal("mode in force of a battery; 1: it shares by droop, 2: it forms the voltage", initial=0.0)
    connected: Ratio = signal("1 while a genset's rectifier is connected", initial=0.0)
    joined: Ratio = signal("1 while the source's bus and the drive's are one", initial=1.0)
    loading: Ratio = signal("the heaviest loading of the sources before this one", initial=NOBODY)
    capacity: Watt = signal("the capacity of that one", initial=0.0)
    which: Ratio = signal("number of that one", initial=0.0)


class LoadOutput:
    loading: Ratio = signal("the heaviest loading up to this source", initial=NOBODY)
    capacity: Watt = signal("the capacity of that one")
    which: Ratio = signal("number of that one")


@kernel
def load_update(t, dt, x: LoadState, u: LoadInput, p: SourceLoad, x_next: LoadState, y: LoadOutput):
    x_next.p_f = low_pass(u.p, x.p_f, p.omega_f, dt)
    own = u.i_star / p.i_most + x_next.p_f / p.p_most  # (1), (2): one of them is not connected
    counts = u.joined.real > 0.5 and (u.connected.real > 0.5 or 0.5 < u.mode.real < 2.5)
    y.loading, y.capacity, y.which = u.loading, u.capacity, u.which
    if counts and own.real > u.loading.real:
        y.loading, y.capacity, y.which = own, p.capacity, p.number


@component(state=LoadState, input=LoadInput, output=LoadOutput, update=load_update, stage="supervise")
class SourceLoad:
    """Loading of one source as one bus sees it: a link in the chain that finds the heaviest."""

    number: Ratio = param("its number, for the event log", above=0.0)
    capacity: Watt = param("power it gives at a loading of 1", above=0.0)
    i_most: Ampere = param("current of a battery at a loading of 1", default=1.0, above=0.0, source="its rule")
    p_most: PerUnit = param("power of a genset at a loading of 1", default=1.0, above=0.0, source="its rule")
    omega_f: RadianPerSecond = param(
        "corner of the power's low-pass", default=100.0, above=0.0, source="chosen: ten times slower than its sampling"
    )


class PathInput:
    before: Ratio = signal("1 while the ties before this one are closed", initial=1.0)
    closed: Ratio = signal("1 while this tie is closed")


class PathOutput:
    joined: Ratio = signal("1 while all of them are")


@kernel
def path_outputs(t, u: PathInput, y: PathOutput):
    y.joined = u.before * u.closed


@component(input=PathInput, output=PathOutput, outputs=path_outputs, stage="supervise")
class TiePath:
    """Ties in series, all of them closed or not."""


class State:
    p_max: PerUnit = signal("power allowed to the drive, over its rating", initial=2.0)
    held: Second = signal("time for which the limit has not acted")
    cause: Ratio = signal("number of the source for which it was cut back last, 0: free")


class Input:
    loading: Ratio = signal("the heaviest loading of the sources that feed the drive")
    capacity: Watt = signal("capacity of that source")
    which: Ratio = signal("number of that source")
    granted: Ratio = signal("part of the torque limit that the drive's sequence grants")
    tau_ref: PerUnit = signal("torque reference of the drive")
    torque_limited: Ratio = signal("1 while its torque limit acts")
    omega_pu: PerUnit = signal("shaft speed over rated speed")
    speed_ref: MetrePerSecond = signal("commanded speed of the ship")
    u_ship: MetrePerSecond = signal("speed of the ship", initial=0.0)


class Output:
    share: Ratio = signal("part of the torque limit granted", initial=1.0)
    speed_ref: MetrePerSecond = signal("speed reference for the cruise control")
    p_limit: Watt = signal("power allowed to the drive")
    limited: Ratio = signal("1 while the drive is cut back for its sources", limiter=True)


@kernel
def update(t, dt, x: State, u: Input, p: LoadLimit, x_next: State, y: Output):
    omega = maximum(absolute(u.omega_pu), SLOW)
    braking = u.tau_ref.real * u.omega_pu.real < 0.0  # it feeds its bus, which an overload is glad of
    taken = 0.0 * u.tau_ref if braking else absolute(u.tau_ref) * omega
    free = (1.0 - u.loading) * u.capacity / p.rating
    room = taken + maximum(free, 0.0) if u.loading.real > NOBODY else p.tau_max + 0.0 * free
    x_next.p_max = clip(minimum(x.p_max + free * dt / p.T_cut, room), 0.0, p.tau_max)  # (3)
    mine = x_next.p_max / (p.tau_max * omega)
    y.share = 0.0 + u.granted if braking else minimum(u.granted, mine)
    acts = u.torque_limited.real > 0.5 and mine.real < u.granted.real and not braking
    x_next.held = 0.0 if acts else minimum(x.held + dt, p.t_free)
    x_next.cause = x.cause if x_next.held.real < p.t_free.real else 0.0
    if acts and x_next.cause.real < 0.5:
        x_next.cause = u.which
    y.limited = 1.0 if acts else 0.0
    y.speed_ref = 0.0 + u.speed_ref
    if acts and u.speed_ref.real >= 0.0:
        y.speed_ref = minimum(u.speed_ref, maximum(p.back * u.u_ship, 0.0))
    elif acts:
        y.speed_ref = maximum(u.speed_ref, minimum(p.back * u.u_ship, 0.0))
    y.p_limit = x_next.p_max * p.rating


@component(state=State, input=Input, output=Output, update=update, stage="supervise")
class LoadLimit:
    """Limit of a drive's power by the loading of the sources that feed it; per unit of the drive's rating."""

    rating: Watt = param("rated power of the drive", above=0.0)
    tau_max: PerUnit = param("torque limit of the drive", above=0.0)
    T_cut: Second = param("time constant of taking an overload away", above=0.0)
    t_free: Second = param(
        "time without a limit after which the drive counts as free again", default=15.0, above=0.0, source="chosen"
    )
    back: Ratio = param(
        "speed, over the ship's, to which the cruise control's reference moves while it acts",
        default=0.95,
        above=0.0,
        at_most=1.0,
        source="chosen by trial: with 1 the control goes on asking for more than there is",
    )
