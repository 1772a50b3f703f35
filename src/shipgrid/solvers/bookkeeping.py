"""What the step keeps besides the physics: clocks, recorder, energy audit, limiter and event logs.

All of it inside the compiled loop, in preallocated arrays; the runner empties them between chunks.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.kernel import inlined
from shipgrid.solvers.companion import GAMMA

UNDERFLOW = 1e-150
"""A signal below this magnitude, in any SI unit, is zero."""


@inlined
def tick_clocks(
    clock_inc,
    clock_before,
    clock_ahead,
    clock_phase,
    clock_den,
    due,
    due_idle,
    due_start,
    due_condition,
    due_value,
):
    """Start a step: where in the last step, and where in the coming one, does each clock's instant fall?

    Integer arithmetic: the phase counts in units of 1/den of the clock's period, a step adds `inc`. What is
    due depends on which clocks struck, so that all else is passed by.
    """
    for k in range(due.shape[0]):
        due[k] = due_idle[k]
    for c in range(clock_inc.shape[0]):
        clock_before[c] = clock_ahead[c]
        if clock_before[c] >= 0.0:
            for k in range(due_start[c], due_start[c + 1]):
                due[due_condition[k]] = due_value[k]
        phase = clock_phase[c] + clock_inc[c]
        if phase >= clock_den[c]:
            phase -= clock_den[c]
            clock_ahead[c] = 1.0 - phase / clock_inc[c]
        else:
            clock_ahead[c] = -1.0
        clock_phase[c] = phase


@inlined
def remember(sig, sources, kept, previous):
    """Before the network is stepped: keep what samplers interpolate from, and hand elements their source inputs."""
    for j in range(kept.shape[0]):
        previous[kept[j]] = sig[kept[j]]
    for j in range(sources.shape[0]):
        sig[sources[j, 0]] = sig[sources[j, 1]]


@inlined
def record(
    done,
    sig,
    recorded,
    interval,
    n_plant,
    record_every,
    slow_every,
    rows,
    plant_rows,
    slow_rows,
    audit_every,
    booked,
    wave_source,
    wave_row,
    wave_rows,
):
    """After step number `done`: keep extremes and sums, write rows that are due; true if the audit is due."""
    if wave_row[0] >= 0:
        row = wave_row[0] % wave_rows.shape[0]
        for k in range(wave_source.shape[0]):
            wave_rows[row, k] = sig[wave_source[k]]
        wave_row[0] += 1
    for k in range(recorded.shape[0]):
        now = sig[recorded[k]]
        if now < interval[k, 0]:
            interval[k, 0] = now
        if now > interval[k, 1]:
            interval[k, 1] = now
        interval[k, 2] += now
    if done % record_every == 0:
        row = rows[0] % plant_rows.shape[1]
        write_row(sig, recorded, interval, 0, n_plant, record_every, plant_rows, row)
        rows[0] += 1
    if done % slow_every == 0:
        write_row(
            sig, recorded, interval, n_plant, recorded.shape[0], slow_every, slow_rows, rows[1] % slow_rows.shape[1]
        )
        rows[1] += 1
    since = done % audit_every
    booked[0] = since + 1 == audit_every or audit_every == 1
    return since == 0


@kernel
def write_row(sig, recorded, interval, first, last, steps, written, row):
    """Write values, lows, highs and means of the signals `first` to `last`, and begin their next interval."""
    for k in range(first, last):
        written[0, row, k - first] = sig[recorded[k]]
        written[1, row, k - first] = interval[k, 0]
        written[2, row, k - first] = interval[k, 1]
        written[3, row, k - first] = interval[k, 2] / steps
        interval[k, 0] = np.inf
        interval[k, 1] = -np.inf
        interval[k, 2] = 0.0


@inlined
def book_contacts(
    sig, position, element_positions, moved, drop_first, drop_row, drop_a, drop_b, drop_s, drop_ledger, energy
):
    """After a contact has moved, before the step: what is stored in the states it puts to zero is lost there.

    The energy of a linear element is a quadratic form of its states; the terms with a state that the new position holds
    at zero go. Those held before are zero already.
    """
    for e in range(position.shape[0]):
        now = position[e]
        if now < 0 or now >= element_positions[e]:
            now = 0
        for k in range(drop_row[drop_first[e] + now], drop_row[drop_first[e] + now + 1]):
            energy[drop_ledger[e]] += drop_s[k] * sig[drop_a[k]] * sig[drop_b[k]]
    moved[0] = 0


@inlined
def book_shunts_first(sig, shunt_node, shunt_g, stage_power, n_energy):
    """The first stage's share of the mean power of each shunt."""
    first = n_energy - shunt_node.shape[0]
    for i in range(shunt_node.shape[0]):
        v = sig[shunt_node[i]]
        stage_power[first + i] = (1.0 - GAMMA) * shunt_g[i] * v * v


@inlined
def book_shunts_second(sig, shunt_node, shunt_g, stage_power, n_energy):
    """The second stage's share."""
    first = n_energy - shunt_node.shape[0]
    for i in range(shunt_node.shape[0]):
        v = sig[shunt_node[i]]
        stage_power[first + i] = stage_power[first + i] + GAMMA * shunt_g[i] * v * v


@inlined
def audit(
    done,
    sig,
    audit_every,
    h,
    n_energy,
    shunt_node,
    energy,
    stage_power,
    limiters,
    limiter_was,
    limiter_time,
    watched,
    watched_was,
    event_count,
    event_step,
    event_which,
    event_value,
    audited_from,
    absurd,
):
    """Underflow, power of the shunts, time that limiters act, changes of watched codes.

    Returns the place of a signal beyond what is plausible, or not a number; -1 if there is none.
    """
    wrong = -1
    for k in range(audited_from, audited_from + absurd.shape[0]):
        # what dies away (a genset at rest) would end in subnormal numbers, whose arithmetic doubles the time of a step
        if np.abs(sig[k]) < UNDERFLOW:
            sig[k] = 0.0
        if not (np.abs(sig[k]) <= absurd[k - audited_from]):
            wrong = k
    dt = audit_every * h
    first = n_energy - shunt_node.shape[0]
    for k in range(shunt_node.shape[0]):
        energy[first + k] += dt * stage_power[first + k]
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
            n = event_count[0] % event_step.shape[0]
            event_step[n] = done
            event_which[n] = k
            event_value[n] = value
            event_count[0] += 1
    return wrong
