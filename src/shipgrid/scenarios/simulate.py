"""Runs a scenario on a ship and writes its output folder; offline, as fast as it goes, or paced."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from shipgrid.assembly.crew import Crew
from shipgrid.assembly.energy import stored_energy
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import CHUNK_ROWS, Workspace
from shipgrid.automation.interlocks import Interlocks
from shipgrid.automation.power_management import operator_of
from shipgrid.errors import ParameterError, SolverError
from shipgrid.names import checked
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.case import build, step_of
from shipgrid.scenarios.conclude import command_text, conclude
from shipgrid.scenarios.events import seconds
from shipgrid.scenarios.output_folder import (
    COMMANDS,
    MARK,
    REPORT,
    SNAPSHOT,
    finish,
    prepare,
    sync_folder,
    write_text,
)
from shipgrid.scenarios.outside import Outside, as_lines, merged_commands, read_outside
from shipgrid.scenarios.parts import Groups, parts_wanted
from shipgrid.scenarios.provenance import provenance, run_yaml, spans
from shipgrid.scenarios.recorder import Column
from shipgrid.scenarios.results import Results, open_results
from shipgrid.scenarios.resume import SnapshotWriter, logged_commands, unfinished_run
from shipgrid.scenarios.row_log import RowLog, bytes_needed
from shipgrid.scenarios.session import Progress, Run, first_rows, run_until
from shipgrid.scenarios.start import start
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import Window, merged, window_columns

TRIAL_STEPS = 2000
"""Steps that are timed to tell how long a run will take: some ten milliseconds."""


class Live(Protocol):
    """What paces a run to the wall clock: `realtime.executive.Executive`."""

    def groups(self, plan: Plan) -> tuple[dict[str, Sequence[Column]], dict[str, float]]:
        """Columns and period [s] of the groups that are recorded besides the plant's."""
        ...

    def workers(self, plan: Plan) -> int:
        """Threads that share a plant."""
        ...

    def __call__(
        self,
        run: Run,
        due: Timeline,
        end: float,
        log: RowLog,
        progress: Progress | None,
        windows: Sequence[Window],
        keeper: SnapshotWriter,
    ) -> None:
        """Step a run to its end."""
        ...


def simulate(
    ship: Any,
    scenario: Any,
    *,
    fidelity: str = "averaged",
    step: float | None = None,
    until: float | None = None,
    out: str | Path | None = None,
    report: bool = True,
    progress: Progress | None = None,
    planned: Callable[[float], None] | None = None,
    overrides: Mapping[str, str] | None = None,
    waveforms: Sequence[tuple[float, float]] = (),
    resume: bool = False,
    found: Callable[[float, Path], None] | None = None,
    live: Live | None = None,
    outside: Sequence[Outside] = (),
    parts: str | int | Groups | None = None,
    workers: int = 1,
) -> Results:
    """Run a scenario on a ship and write its output folder.

    Parameters
    ----------
    ship : Ship
    scenario : Scenario
    fidelity : {"averaged", "switching"}
        Detail of the converters.
    step : float, optional
        Step [s]; the scenario's own (averaged only), or 30 us.
    until : float, optional
        End [s], in place of the scenario's.
    out : path, optional
        Output folder; `results/<scenario>-<fidelity>` if left out. Replaced whole by rename.
    report : bool
        Whether to write `report.html`.
    progress : callable, optional
        Called with simulated time and end time [s] several times a second.
    planned : callable, optional
        Called once, before the first step, with the wall-clock time [s] that the steps will take, judged by a trial.
    overrides : mapping of str to str, optional
        `--set` entries the ship and the scenario were made with, for `run.yaml`.
    waveforms : sequence of (float, float)
        Windows [s], from and to, in which every step is recorded, phase quantities too.
    resume : bool
        Continue the unfinished run of that output folder from its last snapshot; its end may be another one. The
        results are those of a run that was never interrupted, to the last bit.
    found : callable, optional
        Called once, before a run is continued, with the simulated time [s] it has got to, and the folder it lies in.
    live : Live, optional
        What paces the run to the wall clock; it goes as fast as it can if left out.
    outside : sequence of Outside
        Commands that a live run was given while it ran, to be given again at the same steps. What an unfinished run
        was to be given, or if it was live had been, need not be named here when it is continued.
    parts : str, int or mapping, optional
        What the plant is cut into, at stub lines: "ship" as its file says, a number of parts, or buses by the name of a
        part.
    workers : int
        Threads that share the parts; what is computed does not depend on how many there are. A live run has its own.

    Returns
    -------
    Results
        Also if requirements are violated (`ok` is False), or the run was interrupted.

    Raises
    ------
    ParameterError
        If fidelity, step, end, a window, a name or the output folder cannot be used; nothing is written then.
    InputErrors
        If there is nothing to continue, or only runs of another ship, scenario, step or program, with what differs.
    SolverError
        If the run diverged; what was computed before is in the output folder. If the disk is full; what was computed
        stays beside the output folder, to be continued.
    SteadyStateError
        If the start state asked for does not exist.
    """
    began = time.perf_counter()
    h = step_of(scenario, fidelity, step)
    end = scenario.duration if until is None else seconds("until", until)
    if not (math.isfinite(end) and end > 0.0):
        raise ParameterError(f"until = {end!r} s is not a positive time")
    for what, made in (("ship", ship), ("scenario", scenario)):  # one made in Python has been read from no file
        checked(made.name, what)
    ship = scenario.ship_at_start(ship)
    groups = parts_wanted(ship, parts, h)
    plan = build(ship, h, fidelity, scenario.rules, groups)
    windows = merged(waveforms, h, end)
    place = Path(out or default_place(scenario, fidelity))
    whole = {"ship": ship.text, "scenario": scenario.text, "waveforms": spans(windows, h), **snapshot.identity(plan)}
    if resume:
        folder, saved, arrays = unfinished_run(place, plan, whole, end, windows)
    else:
        folder, saved, arrays = prepare(place, bytes_needed(plan, end, windows)), {}, {}
    try:
        about = provenance(plan)
        if resume:
            work = snapshot.restore(plan, saved["n"], arrays)
            run = Run(plan, work, [(t, who, what) for t, who, what in saved["events"]], saved["wall_s"], continued=True)
            saved["continued_at_s"].append(run.t)
            older = saved["from"] / COMMANDS
            outside = merged_commands(outside, read_outside(older, ship.commands) if older.is_file() else ())
            given = merged_commands(outside, logged_commands(folder, ship, work.n if live else None))
            if found is not None:
                found(run.t, saved["from"])
        else:
            work, drift = start(plan, ship, scenario)
            run, given = Run(plan, work), outside
            saved = {"startup_s": 0.0, "drift": drift, "before": stored_energy(plan, work), "continued_at_s": []}
        run.ship, run.rules, run.folder = ship, scenario.rules, folder.path
        run.workers = live.workers(plan) if live else workers
        text = run_yaml(ship, scenario, fidelity, h, end, overrides or {}, about, waveforms, groups)
        write_text(folder.path / MARK, text)
        if outside:
            write_text(folder.path / COMMANDS, as_lines(outside))
        if planned is not None:
            planned(time_of_a_step(plan, work, workers=run.workers) * (round(end / h) - work.n))
        folder.unfinished.mkdir(exist_ok=True)
        columns, periods = _recorded(plan, windows)
        if live is not None:
            more, of_more = live.groups(plan)
            columns, periods = columns | more, periods | of_more
        log = RowLog(folder.unfinished, columns, periods, about, saved.get("rows"))
        sync_folder(folder.path)
        sync_folder(folder.path.parent)
    except BaseException:
        if resume and (folder.unfinished / SNAPSHOT).is_file():
            folder.release()
        else:
            folder.discard()
        raise
    commanders = {"interlocks": Interlocks(ship, plan), "operator": operator_of(scenario.rules, ship, plan)}
    said = partial(command_text, ship)
    waiting = {"entries": scenario.entries, "named_times": scenario.named_times}
    due = Timeline(
        plan, work, run.events, scenario.events, said, **commanders, **waiting, outside=given, continued=resume
    )
    if resume:
        due.remember(saved)
    saved["startup_s"] += time.perf_counter() - began
    kept = {name: saved[name] for name in ("startup_s", "drift", "before", "continued_at_s")} | {"identity": whole}
    keeper = SnapshotWriter(folder.unfinished / SNAPSHOT, log, due, kept)
    try:
        with log:
            if not run.continued:
                first_rows(run, log)
            (live or run_until)(run, due, end, log, progress, windows, keeper)
        conclude(run, due, ship, scenario, fidelity, folder, about, kept)
    except BaseException as error:
        folder.release()
        if isinstance(error, (OSError, RuntimeError)):  # the disk is full, say
            raise SolverError(
                f"the results could not be written beyond {run.t:g} s: {error}; what was computed is in {folder.path}, "
                "and --resume continues it"
            ) from error
        raise
    final = folder.commit()
    if report:
        with open_results(final) as written:
            written.report(final / REPORT)
    if not run.interrupted:
        finish(final)
    if run.failure:
        raise SolverError(f"{run.failure}; results up to then are in {final}")
    return open_results(final)


def default_place(scenario: Any, fidelity: str) -> Path:
    """Folder of the results of a scenario's runs.

    Raises
    ------
    ParameterError
        If the scenario's name cannot be part of a folder's.
    """
    return Path("results") / f"{checked(scenario.name, 'scenario')}-{fidelity}"


def time_of_a_step(plan: Plan, work: Workspace, steps: int = TRIAL_STEPS, workers: int = 1) -> float:
    """Wall-clock time [s] of a step, by a trial on a copy.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where to begin; not changed.
    steps : int
        Length of the trial.
    workers : int
        Threads.
    """
    trial = work.snapshot()
    steps = min(steps, plan.step.record_every * (CHUNK_ROWS - 2))  # nobody empties the trial's buffers
    with Crew(plan, trial, workers) as crew:
        crew(1, trial.n)  # with the compiler's work in it, where nothing has run yet
        began = time.perf_counter()
        crew(steps, trial.n + 1)
        return (time.perf_counter() - began) / steps


def _recorded(plan: Plan, windows: Sequence[Window]) -> tuple[dict[str, Sequence[Column]], dict[str, float]]:
    """Columns and sampling period of each group that is recorded."""
    columns: dict[str, Sequence[Column]] = {
        group: [(n, plan.network.published[n].unit, plan.network.published[n].description) for n in names]
        for group, names in plan.groups.items()
    }
    columns |= dict.fromkeys((w.group for w in windows), window_columns(plan))
    return columns, plan.record_period | dict.fromkeys((w.group for w in windows), plan.h)
