"""What is said of a run once it has ended: limiters, energy, requirements, summary."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from shipgrid.analysis.class_limits import class_verdicts
from shipgrid.analysis.requirements import FIGURES, evaluate
from shipgrid.assembly.energy import energy_balance
from shipgrid.assembly.plan import Plan
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.records import size_of
from shipgrid.scenarios.output_folder import (
    COMMANDS,
    REALTIME,
    RESULTS,
    SUMMARY,
    OutputFolder,
    sync_folder,
    write_text,
)
from shipgrid.scenarios.outside import as_lines, merged_commands, read_outside
from shipgrid.scenarios.results import Limiter, Results
from shipgrid.scenarios.row_log import make_results
from shipgrid.scenarios.session import Run
from shipgrid.scenarios.timeline import TIMELINE, Timeline


def limiter_rows(run: Run) -> list[tuple[str, float, float, int]]:
    """Signal, first time [s], total time [s] and number of times of each limiter that acted."""
    times = run.work.step.limiter_time
    return [
        (path, float(first), float(total), int(count))
        for path, (total, first, count) in zip(run.plan.limiter_paths, times, strict=True)
        if count > 0
    ]


def limiter_meaning(plan: Plan, path: str) -> str:
    """While what a limiter acts, from the declaration of its signal: "1 while the current limit acts".

    Parameters
    ----------
    plan : Plan
        The plant.
    path : str
        One of its `limiter_paths`.
    """
    for placed in plan.network.placed.values():
        name = path.removeprefix(f"{placed.path}.")
        if name != path and size_of(type_of(placed.item).output):
            for declared in fields_of(type_of(placed.item).output):
                if declared.name == name:
                    return declared.signal.description.removeprefix("1 while ")
    return ""


def _limiter_entry(plan: Plan, row: tuple[str, float, float, int], length: float) -> dict[str, Any]:
    """A limiter as `summary.json` has it."""
    limiter = Limiter.of(row, length, limiter_meaning(plan, row[0]))
    entry = {"signal": limiter.signal, "first_s": limiter.first_s, "duration_s": limiter.duration_s}
    share = limiter.share if math.isfinite(limiter.share) else None
    return entry | {"count": limiter.times, "share": share, "meaning": limiter.meaning}


def command_text(ship: Any, path: str, value: float) -> str:
    """What a command's event says: the word where it takes words, else the value with its SI unit."""
    command = ship.commands[path]
    words = {code: word for word, code in (command.words or {}).items()}
    if value in words:
        return f"set to {words[value]}"
    return f"set to {value:.6g} {'' if command.unit == '1' else command.unit}".rstrip()


def conclude(
    run: Run,
    due: Timeline,
    ship: Any,
    scenario: Any,
    fidelity: str,
    place: OutputFolder,
    about: Mapping[str, str],
    kept: dict[str, Any],
) -> None:
    """Write results and summary of a run into its folder."""
    plan, work, folder = run.plan, run.work, place.path
    limiters = limiter_rows(run)
    complete = not run.interrupted and not run.failure and work.n >= round(scenario.duration / plan.h)
    outcomes = due.outcomes(complete=complete)
    run.events += [(run.t, TIMELINE, outcome.text) for outcome in outcomes if outcome.missing]
    make_results(folder, place.unfinished, run.events, limiters)
    files = [path for path in (folder / COMMANDS, place.unfinished / COMMANDS) if path.is_file()]
    given = merged_commands(*(read_outside(path, ship.commands) for path in files))
    if given:
        write_text(folder / COMMANDS, as_lines(given))
    energy, imbalance = energy_balance(plan, work, kept["before"])
    summary: dict[str, Any] = {
        "scenario": scenario.name,
        "ship": ship.name,
        "fidelity": fidelity,
        "step_s": plan.h,
        "simulated_s": run.t,
        "steps": work.n,
        "wall_s": run.wall_s,
        "startup_s": kept["startup_s"],
        "us_per_step": 1e6 * (run.realtime["computation"]["mean"] if run.realtime else run.wall_s / max(1, work.n)),
        "start_drift_per_s": kept["drift"],
        "energy": energy,
        "energy_balance_error": imbalance,
        "interrupted": run.interrupted,
        "continued_at_s": kept["continued_at_s"],
        "failure": run.failure,
        "limiters": [_limiter_entry(plan, row, run.t) for row in limiters],
        "timeline": [outcome.as_dict() for outcome in outcomes],
        **about,
    }
    if run.realtime:
        summary["realtime"] = {name: value for name, value in run.realtime.items() if name != "histograms"}
        write_text(folder / REALTIME, json.dumps(run.realtime))
    with Results(folder, folder / RESULTS) as written:
        figures = {name: summary[name] for name in FIGURES}
        summary["requirements"] = [v.as_dict() for v in evaluate(scenario.requirements, written, run.t, figures)]
        summary["class_limits"] = [v.as_dict() for v in class_verdicts(ship, written)]
    write_text(folder / SUMMARY, json.dumps(summary, indent=1))
    sync_folder(folder)
