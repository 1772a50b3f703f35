"""What a live run did with its time: percentiles, overruns, the worst steps and their causes, and a verdict.

Computation is what a step took, idle what was left of it, lateness how long after its instant it began
([DAgostino2020] fig. 12 has the first two and what the computer needed besides). Durations come from histograms of
10 ns kept in the loop, so that every step is in them; one beyond their end counts as that end, and the worst are kept
one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shipgrid.solvers import pacing
from shipgrid.solvers.pacing import BIN, PaceWork

BINS = 200_000
LONGEST = BINS * BIN * 1e-9
"""End of a histogram [s]: 2 ms."""
PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99.99": 0.9999}
BEHIND = 0.01
"""Part of its time by which a run that is in real time may be behind the clock at its end.

Who counts by the clock finds the plant's frequencies lower by it, and 1 % is as far as its synchronisers bring two
frequencies together (`automation/ac_tie.py`, `dw_max`): beyond that, nothing on the clock could be connected.
"""
NAMES = ("computation", "idle", "lateness")
CAUSES = {
    pacing.VISITED: "commands of the scenario",
    pacing.COMMANDED: "command from outside",
    pacing.EVENT: "event",
    pacing.RECORDED: "recording",
    pacing.BOOKED: "bookkeeping",
}
"""What a step did besides stepping, what takes longest first."""
COLUMNS = (
    ("computation", "s", "time that a step took, mean of a window"),
    ("idle", "s", "time that was left of a step, mean of a window"),
    ("lateness", "s", "time after its instant at which a step began, mean of a window"),
    ("overruns", "1", "steps so far that ended after their time"),
)


def columns(cores: int) -> list[tuple[str, str, str]]:
    """Name, unit and description of what is recorded of the cores' time, a row a window."""
    return [
        (f"realtime.core_{core}.{name}", unit, text) for core in range(1, cores + 1) for name, unit, text in COLUMNS
    ]


def percentile(histogram: np.ndarray, share: float) -> float | None:
    """Duration [s] that this share of the steps does not exceed, to the upper end of its bin; None without steps.

    Parameters
    ----------
    histogram : ndarray, shape (bins,)
        Steps by duration.
    share : float
        0 to 1.
    """
    total = int(histogram.sum())
    if total == 0:
        return None
    rank = max(1, int(np.ceil(share * total - 1e-9)))
    return float(np.searchsorted(np.cumsum(histogram), rank) + 1) * BIN * 1e-9


def figures(pace: PaceWork, h: float, factor: float) -> dict[str, Any]:
    """What there is to say about the steps so far.

    Parameters
    ----------
    pace : PaceWork
        Of a run under way, or of its end.
    h : float
        Step [s].
    factor : float
        Simulated over wall-clock time.

    Returns
    -------
    dict
        Times in seconds: `computation`, `idle`, `lateness` by percentile; mean computation and `duty`; counts. Where
        several cores share the plant, `cores` has what each computed; the step's computation is then that of all,
        with what they wait for each other.
    """
    p = pace.pacer[0]
    steps = max(1, int(p.steps))
    found: dict[str, Any] = {"steps": int(p.steps), "step_s": h, "factor": factor}
    for k, name in enumerate(NAMES):
        found[name] = {label: percentile(pace.pace_histogram[k], share) for label, share in PERCENTILES.items()}
    found["computation"] |= {"mean": 1e-9 * int(p.computed) / steps}
    worst = sorted((w for w in pace.pace_worst if w.computation > 0), key=lambda w: -w.computation)
    if worst:
        found["computation"]["worst"] = 1e-9 * int(worst[0].computation)
    found["duty"] = found["computation"]["mean"] * factor / h
    found["cores"] = [
        {label: percentile(histogram, share) for label, share in PERCENTILES.items()}
        | {"mean": 1e-9 * int(computed) / steps, "duty": 1e-9 * int(computed) / steps * factor / h}
        | {"worst": 1e-9 * int(worst)}
        for histogram, computed, worst in zip(pace.core_histogram, pace.core_computed, pace.core_worst, strict=False)
    ]
    found |= {
        "overruns": int(p.overruns),
        "overrun_spells": int(p.spells),
        "longest_spell_steps": int(p.longest_spell),
        "worst_end_after_deadline_s": 1e-9 * int(p.worst_late),
        "slip_s": 1e-9 * int(p.slip),
        "stalls_while_waiting": int(p.stalls),
        "stalled_s": 1e-9 * int(p.stalled),
        "longest_stall_s": 1e-9 * int(p.longest_stall),
        "worst_steps": [
            {
                "t_s": (int(w.step) - 1) * h,
                "computation_s": 1e-9 * int(w.computation),
                "lateness_s": 1e-9 * int(w.lateness),
                "cause": cause(int(w.did), 1e-9 * int(w.computation), found["computation"]["p99"]),
            }
            for w in worst
        ],
    }
    return found


def cause(did: int, took: float, usual: float) -> str:
    """What a long step did besides stepping; a stall of the machine where that cannot be the reason.

    Parameters
    ----------
    did : int
        Bits of `solvers/pacing.py`.
    took : float
        Its computation [s].
    usual : float
        What 99 % of the steps do not exceed [s]: rows, books and events are written within twice that.
    """
    for bit, text in CAUSES.items():
        if did & bit and took < 2.0 * usual:
            return text
    return "the machine was elsewhere" if took >= 2.0 * usual else "none known"


def verdict(found: dict[str, Any]) -> str:
    """One honest line about the figures of a run, or of its last leg."""
    since = found.get("from_s", 0.0)
    return _verdict(found) + (f"; since {since:g} s, where the run was continued" if since > 0.0 else "")


def _verdict(found: dict[str, Any]) -> str:
    duty, computation = found["duty"], found["computation"]
    took = f"mean computation {1e6 * computation['mean']:.2f} us of {1e6 * found['step_s'] / found['factor']:.4g} us"
    if found["steps"] == 0:
        return "no step was run"
    if found["overruns"] == 0:
        return f"in real time: no overrun in {found['steps']} steps, {took} ({100 * duty:.0f} %)"
    share = found["overruns"] / found["steps"]
    behind = found.get("end_after_deadline_s", 0.0) + found["slip_s"]
    spells = f"{found['overruns']} overruns ({100 * share:.2g} % of the steps) in {found['overrun_spells']} spells"
    late = f"the furthest {1e3 * found['worst_end_after_deadline_s']:.3g} ms late"
    if duty >= 1.0:
        return f"not in real time: a step takes longer than it may, {took} ({100 * duty:.0f} %); {spells}"
    if behind > BEHIND * found.get("wall_s", found["steps"] * found["step_s"] / found["factor"]):
        return f"not in real time: {behind:.3g} s behind the clock at the end; {spells}, {took} ({100 * duty:.0f} %)"
    moved = f"; the plan was moved by {1e3 * found['slip_s']:.3g} ms" if found["slip_s"] > 0.0 else ""
    return f"in real time but for {spells}, {late}{moved}; {took} ({100 * duty:.0f} %)"


def histograms(pace: PaceWork) -> dict[str, Any]:
    """The histograms without their empty bins: width of a bin, and (number of the bin, steps) by name."""
    found: dict[str, Any] = {"bin_s": BIN * 1e-9}
    for k, name in enumerate(NAMES):
        filled = np.flatnonzero(pace.pace_histogram[k])
        found[name] = [[int(b), int(pace.pace_histogram[k, b])] for b in filled]
    return found
