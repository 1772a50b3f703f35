"""What `shipgrid warm` compiles and `shipgrid bench` measures: the ferry's mission, from cold files to steps."""

from __future__ import annotations

import time
from typing import Any

SPELLS = 40
"""Number of spells of steps that are timed one by one."""
SPELL = 0.05
"""Simulated time [s] of each."""


def warm_up() -> float:
    """Compile everything that a run of the ferry needs; returns the seconds it took."""
    began = time.perf_counter()
    _, started = _start()
    _advance(started, 10)
    return time.perf_counter() - began


def measure() -> dict[str, Any]:
    """Times of one start and of many spells of steps, on this machine, one core.

    Returns
    -------
    dict of str to float
        Seconds for reading, assembling, start; microseconds a step as median, mean, 5th, 95th percentile and worst.
    """
    import numpy as np

    from shipgrid.scenarios.runner import provenance

    figures, started = _start()
    steps = round(SPELL / started.plan.h)
    began = time.perf_counter()
    _advance(started, steps)
    figures["first_steps_s"] = time.perf_counter() - began
    spells = []
    for _ in range(SPELLS):
        began = time.perf_counter()
        _advance(started, steps)
        spells.append(1e6 * (time.perf_counter() - began) / steps)
    low, median, high = np.percentile(spells, (5.0, 50.0, 95.0))
    return {
        **figures,
        "step_s": started.plan.h,
        "us_per_step_median": float(median),
        "us_per_step_mean": float(np.mean(spells)),
        "us_per_step_p05": float(low),
        "us_per_step_p95": float(high),
        "us_per_step_worst_spell": float(max(spells)),
        **provenance(started.plan),
    }


def _start() -> tuple[dict[str, Any], Any]:
    began = time.perf_counter()
    from shipgrid.io.scenario_file import load_case
    from shipgrid.scenarios import runner

    imported = time.perf_counter()
    ship, scenario = load_case("ferry", "mission")
    read = time.perf_counter()
    plan = runner.build(ship, runner.DEFAULT_STEP)
    built = time.perf_counter()
    # With the compiler's work in it where its cache is cold.
    work, _ = runner.start(plan, ship, scenario)
    started = time.perf_counter()
    figures = {
        "import_s": imported - began,
        "read_s": read - imported,
        "assemble_s": built - read,
        "start_s": started - built,
    }
    return figures, runner.Run(plan, work)


def _advance(run: Any, steps: int) -> None:
    from shipgrid.scenarios.runner import go

    go(run, (), (run.work.n + steps) * run.plan.h)
