"""The wall clock inside the step loop: waiting for each step's instant, what each step took, commands from outside.

Step `n` of a live run begins at

    T_n = anchor + (n - anchor_step) (whole + num / den)                                   (pacing-1)

in whole nanoseconds, what is in brackets being the step divided by the factor of time; nothing is added up. It is
computed (`computation`), and what is left until T_n+1 is idle. A step that ends after T_n+1 is an overrun. Then either
the steps that follow run without waiting until the plan holds again (catch-up), or the grid is moved to begin now
(re-anchor); how far in all, is the slip.

An offline run has the same loop with the clock off: one comparison a step.

What another process or thread reads while the loop runs is written first and counted afterwards, into a ring; it looks
at the counter before and after it has copied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.kernel import fence, inlined, monotonic_ns
from shipgrid.solvers.crew import BUSY

BIN = 10
"""Width of a bin of the histograms [ns]."""
STALL = 5_000
"""A gap between two looks at the clock, while there is nothing to do, beyond which the machine was elsewhere [ns]."""
MOST_COMMANDS = 8
"""Commands from outside that are taken in one step; the others wait for the next."""
SLOTS = 16
"""Measurements that lie in the ring at a time: a reader has this many publications to copy one."""
COMPUTATION, IDLE, LATENESS, OVERRUNS = range(4)
COLUMNS = 4
"""Signals of a core in a row about a window: computation, idle and lateness [s], overruns so far."""
RECORDED, BOOKED, EVENT, COMMANDED, VISITED = 1, 2, 4, 8, 16
"""What a step did besides stepping, as bits: wrote a row, kept books, met an event, took a command, had a visit."""


def _record(*fields: tuple[str, str]) -> np.dtype:
    return np.dtype((np.record, list(fields)))


PACER = _record(
    ("on", "i8"),  # 1 in a live run
    ("stop", "i8"),  # set from outside: return before the next step
    ("virtual", "i8"),  # 1: the clock is what `virtual_cost` makes of it
    ("reanchor", "i8"),  # the policy after an overrun
    ("whole", "i8"),  # of a step on the clock, whole nanoseconds, and the rest as a fraction
    ("num", "i8"),
    ("den", "i8"),
    ("anchor", "i8"),
    ("anchor_step", "i8"),
    ("now", "i8"),  # the last look at the clock [ns]
    ("start", "i8"),  # when the step under way began [ns]
    ("did", "i8"),  # what it did, as bits
    ("events", "i8"),  # events before it
    ("steps", "i8"),
    ("overruns", "i8"),
    ("spells", "i8"),  # of overruns without a step on time between them
    ("spell_steps", "i8"),  # overruns of the present spell, and of the longest
    ("longest_spell", "i8"),
    ("worst_late", "i8"),  # furthest end after its T_n+1 [ns]
    ("slip", "i8"),  # by which the grid has been moved [ns]
    ("stalls", "i8"),  # gaps while waiting, their sum and the longest [ns]
    ("stalled", "i8"),
    ("longest_stall", "i8"),
    ("computed", "i8"),  # sum of computation [ns]
    ("window", "i8"),  # steps of a window, and those that the present one has
    ("in_window", "i8"),
    ("least_bad", "i8"),  # smallest computation in `pace_worst` [ns]
    ("publish_every", "i8"),  # steps between two publications, 0 for none
)
WORST = _record(("step", "i8"), ("computation", "i8"), ("lateness", "i8"), ("did", "i8"))
COMMAND = _record(("place", "i8"), ("value", "f8"), ("origin", "i8"), ("measured", "i8"))
"""A command from outside: where in the flat vector, what, whose, and the step of the measurement it answers."""
APPLIED = _record(("step", "i8"), ("place", "i8"), ("value", "f8"), ("origin", "i8"), ("measured", "i8"))


class PaceWork(NamedTuple):
    """What the wall clock needs in a run; nothing of it is part of the plant's state."""

    pacer: np.ndarray  # (1,) of PACER
    pace_histogram: np.ndarray  # (3, bins) steps by computation, idle, lateness; what is beyond is in the last bin
    core_histogram: np.ndarray  # (cores, bins) steps by what each core computed, where there are several
    core_computed: np.ndarray  # (cores,) sum of that, and the longest [ns]
    core_worst: np.ndarray
    pace_window: np.ndarray  # (3, cores x COLUMNS): low, high, sum since the last row
    pace_rows: np.ndarray  # (4, rows, cores x COLUMNS): means, lows, highs, means
    pace_count: np.ndarray  # (1,) rows so far
    pace_worst: np.ndarray  # of WORST: the longest computations
    virtual_cost: np.ndarray  # computation of each step [ns], in turn
    inbox: np.ndarray  # of COMMAND, a ring
    inbox_count: np.ndarray  # (3,) commands put in, taken out, and put into the log
    applied: np.ndarray  # of APPLIED, a ring
    applied_count: np.ndarray  # (1,)
    outbox: np.ndarray  # (SLOTS, signals) the flat vector as it was published, a ring
    outbox_step: np.ndarray  # (SLOTS,)
    outbox_count: np.ndarray  # (1,)


def no_pace() -> PaceWork:
    """The clock of an offline run: off."""
    return pace_work(bins=1, windows=1, worst=1, commands=1, signals=0)


def pace_work(*, bins: int, windows: int, worst: int, commands: int, signals: int, cores: int = 1) -> PaceWork:
    """Arrays of these sizes, the clock off.

    Parameters
    ----------
    bins : int
        Of a histogram.
    windows : int
        Rows of windows that are kept at a time.
    worst : int
        Steps that are remembered one by one.
    commands : int
        That may wait, and that are remembered, at a time.
    signals : int
        Length of the flat vector, where others may read it while the run goes on; else 0.
    cores : int
        That share the plant.
    """
    window = np.zeros((3, cores * COLUMNS))
    window[0], window[1] = np.inf, -np.inf
    return PaceWork(
        pacer=np.zeros(1, PACER),
        pace_histogram=np.zeros((3, bins), np.int64),
        core_histogram=np.zeros((cores if cores > 1 else 0, bins), np.int64),
        core_computed=np.zeros(cores, np.int64),
        core_worst=np.zeros(cores, np.int64),
        pace_window=window,
        pace_rows=np.zeros((4, windows, cores * COLUMNS)),
        pace_count=np.zeros(1, np.int64),
        pace_worst=np.zeros(worst, WORST),
        virtual_cost=np.zeros(1, np.int64),
        inbox=np.zeros(commands, COMMAND),
        inbox_count=np.zeros(3, np.int64),
        applied=np.zeros(commands, APPLIED),
        applied_count=np.zeros(1, np.int64),
        outbox=np.zeros((SLOTS, signals)),
        outbox_step=np.zeros(SLOTS, np.int64),
        outbox_count=np.zeros(1, np.int64),
    )


@kernel
def instant(pacer, n):
    """When step `n` begins [ns]; exact for years: what is multiplied with `num` alone would overflow within hours."""
    p = pacer[0]
    k = n - p.anchor_step
    return p.anchor + k * p.whole + k * p.num // p.den


@inlined
def begin_step(done, sig, pacer, event_count, inbox, inbox_count, applied, applied_count):
    """Wait for the instant of step number `done` and take commands that have come; true if the loop shall return."""
    p = pacer[0]
    if p.on == 0:
        return False
    if p.stop != 0:
        return True
    due = instant(pacer, done - 1)
    if p.virtual != 0:
        now = p.now
        if now < due:
            now = due
    else:
        now = monotonic_ns()
        before = now
        while now < due:
            now = monotonic_ns()
            gap = now - before
            if gap > STALL:
                p.stalls += 1
                p.stalled += gap
                if gap > p.longest_stall:
                    p.longest_stall = gap
            before = now
    p.start = now
    p.events = event_count[0]
    taken = inbox_count[1]
    last = inbox_count[0]
    if last > taken + MOST_COMMANDS:
        last = taken + MOST_COMMANDS
    while taken < last:
        asked = inbox[taken % inbox.shape[0]]
        sig[asked.place] = asked.value
        log = applied[applied_count[0] % applied.shape[0]]
        log.step = done - 1
        log.place = asked.place
        log.value = asked.value
        log.origin = asked.origin
        log.measured = asked.measured
        fence()
        applied_count[0] += 1
        taken += 1
        inbox_count[1] = taken
        p.did |= COMMANDED
    return False


@inlined
def end_step(
    done,
    sig,
    pacer,
    posts,
    pace_histogram,
    core_histogram,
    core_computed,
    core_worst,
    pace_window,
    pace_rows,
    pace_count,
    pace_worst,
    virtual_cost,
    event_count,
    record_every,
    slow_every,
    audit_every,
    outbox,
    outbox_step,
    outbox_count,
):
    """Publish what step number `done` has led to, then book the time it took."""
    p = pacer[0]
    if p.on == 0:
        return
    if p.publish_every != 0 and done % p.publish_every == 0:
        slot = outbox_count[0] % SLOTS
        for k in range(outbox.shape[1]):
            outbox[slot, k] = sig[k]
        outbox_step[slot] = done
        fence()
        outbox_count[0] += 1
    due, begun = instant(pacer, done), instant(pacer, done - 1)
    now = p.start + virtual_cost[(done - 1) % virtual_cost.shape[0]] if p.virtual != 0 else monotonic_ns()
    p.now = now
    did = p.did
    p.did = 0
    if done % record_every == 0 or done % slow_every == 0:
        did |= RECORDED
    if done % audit_every == 0:
        did |= BOOKED
    if event_count[0] != p.events:
        did |= EVENT
    computation, late = now - p.start, p.start - begun
    idle = due - now
    p.steps += 1
    p.computed += computation
    if idle < 0:
        p.overruns += 1
        if p.spell_steps == 0:
            p.spells += 1
        p.spell_steps += 1
        if p.spell_steps > p.longest_spell:
            p.longest_spell = p.spell_steps
        if -idle > p.worst_late:
            p.worst_late = -idle
        if p.reanchor != 0:
            p.anchor -= idle
            p.slip -= idle
        idle = 0
    else:
        p.spell_steps = 0
    count(pace_histogram, COMPUTATION, computation)
    count(pace_histogram, IDLE, idle)
    count(pace_histogram, LATENESS, late)
    for core in range(posts.shape[0]):
        own = computation - posts[0, BUSY] if core == 0 else posts[core, BUSY]  # the leader has waited for the others
        if p.virtual != 0:
            own = computation
        core_computed[core] += own
        if own > core_worst[core]:
            core_worst[core] = own
        if core < core_histogram.shape[0]:
            count(core_histogram, core, own)
        bound(pace_window, core * COLUMNS + COMPUTATION, 1e-9 * own)
        bound(pace_window, core * COLUMNS + IDLE, 1e-9 * (idle + computation - own))
        bound(pace_window, core * COLUMNS + LATENESS, 1e-9 * late)
    p.in_window += 1
    if done % p.window == 0:
        row = pace_count[0] % pace_rows.shape[1]
        close_window(pace_window, pace_rows, row, p.in_window, p.overruns)
        p.in_window = 0
        fence()
        pace_count[0] += 1
    if computation > p.least_bad:
        remember_worst(pacer, pace_worst, done, computation, late, did)


@kernel
def count(pace_histogram, which, duration):
    """Add a duration [ns] to a histogram."""
    k = duration // BIN
    if k < 0:
        k = 0
    if k >= pace_histogram.shape[1]:
        k = pace_histogram.shape[1] - 1
    pace_histogram[which, k] += 1


@kernel
def bound(pace_window, which, duration):
    """Add a duration [s] to what is kept of a window."""
    if duration < pace_window[0, which]:
        pace_window[0, which] = duration
    if duration > pace_window[1, which]:
        pace_window[1, which] = duration
    pace_window[2, which] += duration


@kernel
def close_window(pace_window, pace_rows, row, steps, overruns):
    """Write the row of a window: means, lows, highs, and means again; and begin the next."""
    for which in range(pace_window.shape[1]):
        if which % COLUMNS == OVERRUNS:
            for layer in range(4):
                pace_rows[layer, row, which] = overruns
            continue
        pace_rows[0, row, which] = pace_window[2, which] / steps
        pace_rows[1, row, which] = pace_window[0, which]
        pace_rows[2, row, which] = pace_window[1, which]
        pace_rows[3, row, which] = pace_window[2, which] / steps
        pace_window[0, which] = np.inf
        pace_window[1, which] = -np.inf
        pace_window[2, which] = 0.0


@kernel
def remember_worst(pacer, pace_worst, done, computation, late, did):
    """Put a step in the place of the shortest of the longest, and find which is the shortest now."""
    least = 0
    for k in range(pace_worst.shape[0]):
        if pace_worst[k].computation < pace_worst[least].computation:
            least = k
    pace_worst[least].step = done
    pace_worst[least].computation = computation
    pace_worst[least].lateness = late
    pace_worst[least].did = did
    least = 0
    for k in range(pace_worst.shape[0]):
        if pace_worst[k].computation < pace_worst[least].computation:
            least = k
    pacer[0].least_bad = pace_worst[least].computation
