"""What `shipgrid warm` compiles and `shipgrid bench` measures: the bundled cases, from cold files to steps."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from typing import Any

SPELLS = 60
"""Number of spells of steps that are timed one by one."""
SPELL = 5000
"""Steps of each: some 20 ms, against which a call from Python and a look at the clock are nothing."""


def warm_up() -> float:
    """Compile every component type of the package, so that no ship waits for one; returns the seconds it took."""
    from shipgrid.assembly.code_store import compile_missing
    from shipgrid.model.component import load_all

    began = time.perf_counter()
    compile_missing(kind for kind in load_all().values() if kind.cls.__module__.startswith("shipgrid."))
    return time.perf_counter() - began


def measure() -> dict[str, Any]:
    """Times of every bundled case, each started in processes of their own, on one core.

    Returns
    -------
    dict
        `cases`, by ship, scenario and fidelity: `cold` and `warm` start (`start_case`, and `process_s` from the start
        of the process to its first step) and `steps` by step length (`step_times`); and the provenance. The first case
        of a ship and fidelity starts with nothing compiled, its `cold` is with the compiler; the others find what that
        one compiled.
    """
    from shipgrid.errors import InputErrors
    from shipgrid.io.scenario_file import load_case
    from shipgrid.io.ship_file import bundled
    from shipgrid.model.network import FIDELITIES
    from shipgrid.scenarios import provenance
    from shipgrid.scenarios import simulate as simulation
    from shipgrid.scenarios.case import DEFAULT_STEP

    cases: dict[str, Any] = {}
    for ship in bundled("ship"):
        with tempfile.TemporaryDirectory() as cache:
            for scenario, fidelity in itertools.product(bundled("scenario"), FIDELITIES):
                try:
                    loaded = load_case(ship, scenario)[1]
                except InputErrors:  # a scenario for another ship
                    continue
                of_scenario = loaded.step if fidelity == "averaged" else None
                steps = sorted({DEFAULT_STEP, of_scenario or DEFAULT_STEP})
                case = (cache, ship, scenario, fidelity)
                cold, warm = _in_a_process(*case, []), _in_a_process(*case, steps)
                cases[f"{ship} {scenario} {fidelity}"] = {"cold": cold, "steps": warm.pop("steps"), "warm": warm}
    return {
        "cases": cases,
        **provenance.provenance(simulation.build(load_case("ferry", "mission")[0], DEFAULT_STEP)),
    }


def flat(figures: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Names, joined by points, and values of nested figures."""
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def start_case(ship: str, scenario: str, fidelity: str) -> tuple[dict[str, Any], Any]:
    """Start a bundled case: seconds for imports, reading, assembling, start (with the compiler's), and the run."""
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
    from shipgrid.assembly.plan import CHUNK_ROWS
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
    """What a process of its own does for `measure`: prints its figures as JSON."""
    figures, _ = start_case(ship, scenario, fidelity)
    figures["first_step_at"] = time.time()
    if steps:
        figures["steps"] = {f"{1e6 * h:g} us": step_times(ship, scenario, fidelity, h) for h in steps}
    sys.stdout.write(json.dumps(figures))


def _in_a_process(cache: str, ship: str, scenario: str, fidelity: str, steps: list[float]) -> dict[str, Any]:
    code = f"from shipgrid.cli.bench import child; child({ship!r}, {scenario!r}, {fidelity!r}, {steps!r})"
    began = time.time()
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "SHIPGRID_CACHE": cache},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    figures = json.loads(done.stdout)
    figures["process_s"] = figures.pop("first_step_at") - began
    return figures


def _advance(run: Any, steps: int) -> None:
    from shipgrid.scenarios.session import run_until

    run_until(run, None, (run.work.n + steps) * run.plan.h)
