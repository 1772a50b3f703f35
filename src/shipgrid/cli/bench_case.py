"""What a process of its own does for `shipgrid bench`: it starts one bundled case and times its steps.

Apart from the command, so that this process starts without what only a command line needs.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

SPELLS = 60
"""Number of spells of steps that are timed one by one."""
SPELL = 5000
"""Steps of each: some 20 ms, against which a call from Python and a look at the clock are nothing."""


def start_case(ship: str, scenario: str, fidelity: str) -> tuple[dict[str, Any], Any]:
    """Start a bundled case and make its first step.

    Parameters
    ----------
    ship, scenario, fidelity : str
        Names of bundled ones, and the detail of the converters.

    Returns
    -------
    dict, Run
        Seconds for imports, reading, assembling, start (with the compiler's) and first step; and the run.
    """
    began = time.perf_counter()
    from shipgrid.io.scenario_file import load_case
    from shipgrid.scenarios import session
    from shipgrid.scenarios import simulate as simulation
    from shipgrid.scenarios.case import DEFAULT_STEP

    imported = time.perf_counter()
    loaded_ship, loaded_scenario = load_case(ship, scenario)
    loaded_ship = loaded_scenario.ship_at_start(loaded_ship)
    read = time.perf_counter()
    plan = simulation.build(loaded_ship, DEFAULT_STEP, fidelity, loaded_scenario.rules)
    built = time.perf_counter()
    work, _ = simulation.start(plan, loaded_ship, loaded_scenario)
    started = time.perf_counter()
    run = session.Run(plan, work)
    _advance(run, 1)
    figures = {
        "import_s": imported - began,
        "read_s": read - imported,
        "assemble_s": built - read,
        "start_s": started - built,
        "first_step_s": time.perf_counter() - started,
        "cpu_s": time.process_time(),
    }
    return figures, run


def step_times(ship: str, scenario: str, fidelity: str, step: float) -> dict[str, float]:
    """Time of a step [us] from the start of a case on, see `spell_times`: before its first command.

    Parameters
    ----------
    ship, scenario, fidelity : str
        Names of bundled ones, and the detail of the converters.
    step : float
        Step [s].
    """
    from shipgrid.io.scenario_file import load_case
    from shipgrid.scenarios import simulate as simulation

    loaded_ship, loaded_scenario = load_case(ship, scenario)
    loaded_ship = loaded_scenario.ship_at_start(loaded_ship)
    plan = simulation.build(loaded_ship, step, fidelity, loaded_scenario.rules)
    work, _ = simulation.start(plan, loaded_ship, loaded_scenario)
    return spell_times(plan, work)


def spell_times(plan: Any, work: Any, spells: int = SPELLS) -> dict[str, float]:
    """Time of a step [us]: median, mean, percentiles and worst over spells of `SPELL` steps.

    The stepping alone is timed: what has been recorded is thrown away between two spells, and the crew is entered once.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where to begin; it is stepped on.
    spells : int
        Number of spells.

    Raises
    ------
    SolverError
        If the run diverges.
    """
    import numpy as np

    from shipgrid.analysis.divergence import culprit
    from shipgrid.assembly.crew import Crew
    from shipgrid.assembly.workspace import CHUNK_ROWS
    from shipgrid.errors import SolverError

    steps = min(SPELL, min(plan.step.record_every, plan.step.slow_every) * (CHUNK_ROWS - 1))  # what the buffers hold
    times = []
    with Crew(plan, work) as crew:
        for _ in range(spells + 1):
            began = time.perf_counter()
            done = crew(steps, work.n)
            times.append(1e6 * (time.perf_counter() - began) / steps)
            work.n += abs(done)
            work.step.rows[:], work.step.event_count[0] = 0, 0
            if done < 0:
                raise SolverError(culprit(plan, work))
    del times[0]  # the processor's caches and clock settle in it
    low, median, high = np.percentile(times, (5.0, 50.0, 95.0))
    return {
        "median_us": float(median),
        "mean_us": float(np.mean(times)),
        "p05_us": float(low),
        "p95_us": float(high),
        "worst_us": float(max(times)),
    }


def child(ship: str, scenario: str, fidelity: str, steps: list[float]) -> None:
    """What a process of its own does for `shipgrid.cli.bench.measure`: prints its figures as JSON.

    Parameters
    ----------
    ship, scenario, fidelity : str
        Names of bundled ones, and the detail of the converters.
    steps : list of float
        Step lengths [s] to time.
    """
    figures, _ = start_case(ship, scenario, fidelity)
    figures["first_step_at"] = time.time()
    if steps:
        figures["steps"] = {f"{1e6 * h:g} us": step_times(ship, scenario, fidelity, h) for h in steps}
    sys.stdout.write(json.dumps(figures))


def _advance(run: Any, steps: int) -> None:
    from shipgrid.scenarios.session import run_until

    run_until(run, None, (run.work.n + steps) * run.plan.h)
