"""What the step keeps besides the physics: clocks, recorder, energy audit, limiter and event logs.

All of it inside the compiled loop, in preallocated arrays; the runner empties them between chunks.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel

UNDERFLOW = 1e-150
"""A signal below this magnitude, in any SI unit, is zero."""


@kernel
def tick_clocks(clock_inc, clock_before, clock_ahead, clock_phase, clock_den, due, due_start, due_type):
    """Start a step: where in the last step, and where in the coming one, does each clock's instant fall?

    Integer arithmetic: the phase counts in units of 1/den of the clock's period, a step adds `inc`. Component types
    with an instance whose clock struck are marked as due, so that the others are passed by.
    """
    for k in range(due.shape[0]):
        due[k] = 0
    for c in range(clock_inc.shape[0]):
        clock_before[c] = clock_ahead[c]
        if clock_before[c] >= 0.0:
            for k in range(due_start[c], due_start[c + 1]):
                due[due_type[k]] = 1
        phase = clock_phase[c] + clock_inc[c]
        if phase >= clock_den[c]:
            phase -= clock_den[c]
            clock_ahead[c] = 1.0 - phase / clock_inc[c]
        else:
            clock_ahead[c] = -1.0
        clock_phase[c] = phase


@kernel
def remember(sig, sources, kept, previous):
    """Before the network is stepped: keep what samplers interpolate from, and hand elements their source inputs."""
    for j in range(kept.shape[0]):
        previous[kept[j]] = sig[kept[j]]
    for j in range(sources.shape[0]):
        sig[sources[j, 0]] = sig[sources[j, 1]]


@kernel
def record(
    done,
    sig,
    recorded,
    low_now,
    high_now,
    record_every,
    rows,
    value,
    low,
    high,
    slow_every,
    slow,
    slow_value,
    audit_every,
):
    """After step number `done`: keep extremes, write rows that are due; true if the audit is due."""
    for k in range(recorded.shape[0]):
        now = sig[recorded[k]]
        if now < low_now[k]:
            low_now[k] = now
        if now > high_now[k]:
            high_now[k] = now
    if done % record_every == 0:
        row = rows[0]
        for k in range(recorded.shape[0]):
            value[row, k] = sig[recorded[k]]
            low[row, k] = low_now[k]
            high[row, k] = high_now[k]
            low_now[k] = np.inf
            high_now[k] = -np.inf
        rows[0] = row + 1
    if done % slow_every == 0:
        row = rows[1]
        for k in range(slow.shape[0]):
            slow_value[row, k] = sig[slow[k]]
        rows[1] = row + 1
    return done % audit_every == 0


@kernel
def audit(
    done,
    sig,
    audit_every,
    h,
    n_energy,
    shunt_node,
    energy,
    shunt_g,
    limiters,
    limiter_was,
    limiter_time,
    watched,
    watched_was,
    event_count,
    event_step,
    event_which,
    event_value,
):
    """Underflow, power of the shunts, time that limiters act, changes of watched codes."""
    for k in range(sig.shape[0]):
        # what dies away (a genset at rest) would end in subnormal numbers, whose arithmetic doubles the time of a step
        if np.abs(sig[k]) < UNDERFLOW:
            sig[k] = 0.0
    dt = audit_every * h
    first = n_energy - shunt_node.shape[0]
    for k in range(shunt_node.shape[0]):
        v = sig[shunt_node[k]]
        energy[first + k] += dt * shunt_g[k] * v * v
    for k in range(limiters.shape[0]):
        active = 1.0 if sig[limiters[k]] > 0.5 else 0.0
        if active > 0.5:
            if limiter_was[k] < 0.5:
                if limiter_time[k, 2] == 0.0:
                    limiter_time[k, 1] = done * h
                limiter_time[k, 2] += 1.0
            limiter_time[k, 0] += dt
        limiter_was[k] = active
    for k in range(watched.shape[0]):
        value = sig[watched[k]]
        if value != watched_was[k]:
            watched_was[k] = value
            n = event_count[0]
            if n < event_step.shape[0]:
                event_step[n] = done
                event_which[n] = k
                event_value[n] = value
            event_count[0] = n + 1
