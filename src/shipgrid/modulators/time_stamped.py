"""Pulse-width modulators that know every edge: the exact part of a step that each switch is closed.

The carrier is a symmetric triangle between 0 and 1: 1 at phase 0, 0 at half a period. The upper switch is on while
the duty ratio m lies above it, so that its pulse of m periods lies around half a period,

    on from r = (1 - m)/2 to g = (1 + m)/2 of each period                                       (1)

and the time it has been on, in periods, since phase 0 is

    F(phi; m) = m floor(phi) + clip(phi - floor(phi) - r, 0, m)                                 (2)

so a step from phi_0 to phi_1 has the mean switching function (F(phi_1) - F(phi_0)) / (phi_1 - phi_0), whatever the
number of edges in it: none is dropped, and none has to be looked for. Phases are those of `Carrier`, ratios of whole
numbers, and a step ends at the very number at which the next one starts: a sum over steps keeps the two ends alone.

A duty ratio computed at one sampling instant comes into force at the next (computation delay) and is held for a
period (regular sampling, once or twice a carrier period by the choice of the clock; a carrier that is no multiple
of the clock is asynchronous). In the step with the instant, at its fraction f, (2) is taken on both sides of f.

A duty ratio beyond 0 or 1 (over-modulation) is cut, and `limited` says so.

With a `dead_time`, each edge opens one switch at once and closes the other that much later. In between the current
decides: `lo` counts only what the upper switch is closed, `hi` all but what the lower switch is closed. With a
`min_pulse`, a leg that has switched stands for that long at least: the edge of a shorter pulse is carried out late,
or not at all if the next one has come by then; `postponed` counts how often. Time is then walked edge by edge, and
what the legs have done since the last edge goes from step to step. Gates act at the start of a step.

`lead` (modulators/gates.py) with a dead time is that of the middle between `lo` and `hi`. A leg with one switch driven
hands over how long it waits for it and where it is sampled; its `lead` is then only the integral of s from the wait's
end to the sampling instant, and the solver completes it (docs/theory/conduction.md).

Source: [Holmes2003] ch. 3; docs/theory/modulation.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import clip, maximum, minimum
from shipgrid.modulators.gates import (
    BOTH,
    LIMIT,
    LOWER,
    UPPER,
    BridgeGates,
    LegGates,
    block,
    duty_ratios,
    over_modulated,
)
from shipgrid.units import Ratio, Second

TIE = 1e-11
"""An edge this close to a step's end, in steps, is the next step's: rounding carries none out twice, or not at all."""


class CarrierOutput:
    """Output of a carrier."""

    phase: Ratio = signal("phase at the start of the coming step, in periods, from 0 to below 1")
    phase_next: Ratio = signal("phase at its end")
    turns: Ratio = signal("periods completed in between")


@kernel
def carrier_modulate(fraction, phase, phase_next, y):
    """Phase of its clock, from whole numbers: it does not drift."""
    y.phase = phase
    y.phase_next = phase_next
    y.turns = 1.0 if fraction >= 0.0 else 0.0


@component(output=CarrierOutput, modulate=carrier_modulate, stage="modulate")
class Carrier:
    """Triangular carrier; its frequency is that of its clock."""


@kernel
def so_far(phase, duty):
    """Time [periods] that the upper switch has been on since phase 0, and edges: (2), for a `duty` from 0 to 1."""
    whole = np.floor(phase)
    since = phase - whole - 0.5 * (1.0 - duty)
    if since < 0.0:
        return duty * whole, 2.0 * whole
    if since < duty:
        return duty * whole + since, 2.0 * whole + 1.0
    return duty * whole + duty, 2.0 * whole + 2.0


@kernel
def edges_of(count, duty):
    """`count` edges, or none of a leg that never switches."""
    return count if 0.0 < duty < 1.0 else 0.0


@kernel
def is_on(phase, duty):
    """Whether the upper switch is on just after `phase`: 1 or 0."""
    place = phase - np.floor(phase)
    inside = place >= 0.5 * (1.0 - duty) and place < 0.5 * (1.0 + duty)
    return 1.0 if duty >= 1.0 or (duty > 0.0 and inside) else 0.0


@kernel
def next_edge(phase, duty):
    """Phase of the first edge after `phase`, infinite if there is none."""
    if not 0.0 < duty < 1.0:
        return np.inf
    whole = np.floor(phase)
    place = phase - whole
    rise, fall = 0.5 * (1.0 - duty), 0.5 * (1.0 + duty)
    return whole + (rise if place < rise else (fall if place < fall else 1.0 + rise))


@kernel
def undriven(phase, advance, fraction, before, after, position):
    """Share of a step from its start for which the command stays in `position`, whose switch is not driven."""
    duty, start = after if fraction == 0.0 else before, 0.0
    for _ in range(2):
        at = phase + start * advance
        if is_on(at, duty) != position:
            return start
        edge = start + (next_edge(at, duty) - at) / advance
        if fraction <= start or edge < fraction:
            return minimum(edge, 1.0)
        duty, start = after, fraction
    return 1.0


@kernel
def pulse(phase, end, turns, fraction, before, after):
    """One step of an ideal leg: mean switching function, lead (3) and number of edges.

    Parameters
    ----------
    phase, end, turns : float
        Phase of the carrier at the step's start and at its end, and periods completed in between.
    fraction : float
        Where in the step the duty ratio changes; below 0: nowhere.
    before, after : float
        Duty ratio until then and from then on.
    """
    per_step = 1.0 / (end - phase + turns)
    on_0, edges_0 = so_far(phase, before)
    on_1, edges_1 = so_far(end, after)
    on_1 += turns * after
    edges_1 += 2.0 * turns
    if fraction < 0.0:
        s = (on_1 - on_0) * per_step
        return clip(s, 0.0, 1.0), 0.0, edges_of(edges_1 - edges_0, before)  # beyond 0 or 1 there is only rounding
    at = phase + fraction * (end - phase + turns)
    on_f, edges_f = so_far(at, before)
    on_g, edges_g = so_far(at, after)
    first = (on_f - on_0) * per_step
    s = first + (on_1 - on_g) * per_step
    edges = edges_of(edges_f - edges_0, before) + edges_of(edges_1 - edges_g, after)
    jump = 1.0 if is_on(at, before) != is_on(at, after) else 0.0
    return clip(s, 0.0, 1.0), first - fraction * s, edges + jump


@kernel
def drive(phase, advance, fraction, before, after, dead, shortest, on, stood):
    """One step of a leg with dead time and least pulse, edge by edge.

    Parameters
    ----------
    phase, advance : float
        Phase of the carrier at the step's start, and periods a step.
    fraction, before, after : float
        As for `pulse`.
    dead, shortest : float
        Dead time and least pulse, in steps.
    on, stood : float
        State the gates last went to (1: upper), and how long ago, in steps.

    Returns
    -------
    lo, hi, lead, edges, postponed, on, stood : tuple of float
    """
    place = phase - np.floor(phase)
    duty = before
    tau = 0.0
    stop = 1.0 if fraction < 0.0 else fraction
    lo = hi = first = edges = postponed = 0.0
    last = fraction < 0.0
    waiting = is_on(place, duty) != on and stood < shortest
    while True:
        command = is_on(place, duty)
        if command == on or stood >= shortest:
            if waiting:
                postponed += 1.0
                waiting = False
            if command != on:
                on = command
                stood = 0.0
                edges += 1.0
        else:
            waiting = True
        edge = next_edge(place, duty)
        at_edge = tau + (edge - place) / advance
        at_release = tau + shortest - stood if waiting else np.inf
        end = minimum(stop, minimum(at_edge, at_release))
        if not end < stop - TIE:  # so too with a value that is no number
            end = stop
        span = end - tau
        blank = minimum(span, maximum(dead - stood, 0.0))
        if on > 0.5:
            lo += span - blank
            hi += span
        else:
            hi += blank
        stood += span
        tau = end
        if end < stop:
            if at_release <= at_edge:
                stood = shortest
                place += span * advance
            else:
                place = edge
        else:
            place += span * advance
            if last:
                break
            last = True
            first = 0.5 * (lo + hi)
            duty = after
            stop = 1.0
        place -= np.floor(place)
    lead = 0.0 if fraction < 0.0 else first - fraction * 0.5 * (lo + hi)
    return minimum(lo, 1.0), minimum(hi, 1.0), lead, edges, postponed, on, minimum(stood, maximum(dead, shortest))


class LegState:
    """State of the half-bridge modulator."""

    active: Ratio = signal("reference in force", initial=0.5)
    on: Ratio = signal("1 if the gates last went to the upper switch")
    stood: Second = signal("how long ago, up to the dead time or the least pulse")
    edges: Ratio = signal("edges so far", counts=True)
    postponed: Ratio = signal("how often so far a least pulse made an edge late or void", counts=True)


class LegInput:
    """Input of the half-bridge modulator."""

    s_ref: Ratio = signal("reference of the controller's last sampling instant")
    gates: Ratio = signal("0 blocked, 1 both switches driven, 2 the lower alone, 3 the upper alone", initial=1.0)
    phase: Ratio = signal("phase of the carrier at the start of the step")
    phase_next: Ratio = signal("phase of the carrier at its end")
    turns: Ratio = signal("carrier periods completed in between")


class LegOutput(LegGates):
    """Output of the half-bridge modulator."""

    wait: Ratio = signal("share of the step before the first part in which a switch is driven, if only one ever is")
    sampled: Ratio = signal("share of the step before the sampling instant, if only one switch is driven, else 0")


@kernel
def leg_modulate(dt, fraction, x, u, p, y):
    """The coming step of a leg, with the sampling instant at `fraction` of it (none: below 0)."""
    phase, end = u.phase + p.shift, u.phase_next + p.shift
    before = clip(x.active, 0.0, 1.0)
    after = clip(u.s_ref, 0.0, 1.0) if fraction >= 0.0 else before
    if p.dead_time + p.min_pulse > 0.0:
        y.lo, y.hi, y.lead, edges, postponed, x.on, stood = drive(
            phase,
            end - phase + u.turns,
            fraction,
            before,
            after,
            p.dead_time / dt,
            p.min_pulse / dt,
            x.on,
            x.stood / dt,
        )
        x.stood = stood * dt
    else:
        y.lo, y.lead, edges = pulse(phase, end, u.turns, fraction, before, after)
        y.hi = y.lo
        postponed = 0.0
    if fraction >= 0.0:
        x.active = u.s_ref
    y.limited = 1.0 if x.active > 1.0 + LIMIT or x.active < -LIMIT else 0.0
    y.wait = y.sampled = 0.0
    if u.gates < 0.5:
        y.lo, y.hi, y.lead, y.limited = 0.0, 1.0, 0.0, 0.0
    else:
        x.edges += edges
        x.postponed += postponed
        if u.gates != BOTH and p.dead_time + p.min_pulse == 0.0:
            diode = 1.0 if u.gates == LOWER else 0.0
            y.wait = undriven(phase, end - phase + u.turns, fraction, before, after, diode)
            if fraction > 0.0:
                y.sampled = fraction
                y.lead += fraction * y.lo - diode * minimum(y.wait, fraction)
        if u.gates == LOWER:
            y.lo = 0.0
        elif u.gates == UPPER:
            y.hi = 1.0


@component(state=LegState, input=LegInput, output=LegOutput, modulate=leg_modulate, stage="modulate")
class TimeStampedLeg:
    """Pulse-width modulator of a half-bridge leg."""

    dead_time: Second = param("dead time after each edge", default=0.0, at_least=0.0, source="neglected")
    min_pulse: Second = param("least time between two edges", default=0.0, at_least=0.0, source="neglected")
    shift: Ratio = param("carrier's lead, in periods", default=0.0, at_least=0.0, at_most=1.0, source="none")


class BridgeState:
    """State of the bridge modulator."""

    alpha: Ratio = signal("reference in force, alpha axis")
    beta: Ratio = signal("reference in force, beta axis")
    on_a: Ratio = signal("1 if the gates last went to the upper switch, leg a")
    on_b: Ratio = signal("1 if the gates last went to the upper switch, leg b")
    on_c: Ratio = signal("1 if the gates last went to the upper switch, leg c")
    stood_a: Second = signal("how long ago, up to the dead time or the least pulse, leg a")
    stood_b: Second = signal("how long ago, up to the dead time or the least pulse, leg b")
    stood_c: Second = signal("how long ago, up to the dead time or the least pulse, leg c")
    edges: Ratio = signal("edges of the three legs so far", counts=True)
    postponed: Ratio = signal("how often so far a least pulse made an edge late or void", counts=True)


class BridgeInput:
    """Input of the bridge modulator."""

    s_alpha_ref: Ratio = signal("reference of the controller's last sampling instant, alpha axis")
    s_beta_ref: Ratio = signal("reference of the controller's last sampling instant, beta axis")
    gates: Ratio = signal("1 released, 0 blocked", initial=1.0)
    phase: Ratio = signal("phase of the carrier at the start of the step")
    phase_next: Ratio = signal("phase of the carrier at its end")
    turns: Ratio = signal("carrier periods completed in between")


@kernel
def bridge_modulate(dt, fraction, x, u, p, y):
    """As `leg_modulate`, for the three legs of a bridge."""
    a, b, c = duty_ratios(x.alpha, x.beta, p.injection)
    a_next, b_next, c_next = a, b, c
    if fraction >= 0.0:
        x.alpha = u.s_alpha_ref
        x.beta = u.s_beta_ref
        a_next, b_next, c_next = duty_ratios(x.alpha, x.beta, p.injection)
    y.limited = over_modulated(a_next, b_next, c_next)
    a, a_next = clip(a, 0.0, 1.0), clip(a_next, 0.0, 1.0)
    b, b_next = clip(b, 0.0, 1.0), clip(b_next, 0.0, 1.0)
    c, c_next = clip(c, 0.0, 1.0), clip(c_next, 0.0, 1.0)
    phase_a, phase_b, phase_c = u.phase + p.shift_a, u.phase + p.shift_b, u.phase + p.shift_c
    end_a, end_b, end_c = u.phase_next + p.shift_a, u.phase_next + p.shift_b, u.phase_next + p.shift_c
    late = 0.0
    if p.dead_time + p.min_pulse > 0.0:
        dead, shortest = p.dead_time / dt, p.min_pulse / dt
        advance = u.phase_next - u.phase + u.turns
        y.lo_a, y.hi_a, y.lead_a, n_a, late_a, x.on_a, stood_a = drive(
            phase_a, advance, fraction, a, a_next, dead, shortest, x.on_a, x.stood_a / dt
        )
        y.lo_b, y.hi_b, y.lead_b, n_b, late_b, x.on_b, stood_b = drive(
            phase_b, advance, fraction, b, b_next, dead, shortest, x.on_b, x.stood_b / dt
        )
        y.lo_c, y.hi_c, y.lead_c, n_c, late_c, x.on_c, stood_c = drive(
            phase_c, advance, fraction, c, c_next, dead, shortest, x.on_c, x.stood_c / dt
        )
        x.stood_a, x.stood_b, x.stood_c = stood_a * dt, stood_b * dt, stood_c * dt
        late = late_a + late_b + late_c
    else:
        y.lo_a, y.lead_a, n_a = pulse(phase_a, end_a, u.turns, fraction, a, a_next)
        y.lo_b, y.lead_b, n_b = pulse(phase_b, end_b, u.turns, fraction, b, b_next)
        y.lo_c, y.lead_c, n_c = pulse(phase_c, end_c, u.turns, fraction, c, c_next)
        y.hi_a, y.hi_b, y.hi_c = y.lo_a, y.lo_b, y.lo_c
    if u.gates < 0.5:
        block(y)
    else:
        x.edges += n_a + n_b + n_c
        x.postponed += late


@component(state=BridgeState, input=BridgeInput, output=BridgeGates, modulate=bridge_modulate, stage="modulate")
class TimeStampedBridge:
    """Pulse-width modulator of a three-phase two-level bridge."""

    injection: Ratio = param(
        "1: min-max injection, 0: sine against triangle", default=1.0, at_least=0.0, at_most=1.0, source="linear range"
    )
    dead_time: Second = param("dead time after each edge", default=0.0, at_least=0.0, source="neglected")
    min_pulse: Second = param("least time between two edges of a leg", default=0.0, at_least=0.0, source="neglected")
    shift_a: Ratio = param("carrier's lead, leg a, in periods", default=0.0, at_least=0.0, at_most=1.0, source="none")
    shift_b: Ratio = param("carrier's lead, leg b, in periods", default=0.0, at_least=0.0, at_most=1.0, source="none")
    shift_c: Ratio = param("carrier's lead, leg c, in periods", default=0.0, at_least=0.0, at_most=1.0, source="none")
