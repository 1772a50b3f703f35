"""Runs a scenario on a ship: time-line, recording, logs, requirements; offline, as fast as it goes."""

from __future__ import annotations

import json
import math
import os
import platform
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numba
import numpy as np

import shipgrid
from shipgrid.analysis.class_limits import class_verdicts
from shipgrid.analysis.divergence import culprit
from shipgrid.analysis.requirements import FIGURES, evaluate
from shipgrid.analysis.steady_state import carried_over, operating_point
from shipgrid.assembly.code_store import code_digest
from shipgrid.assembly.crew import Crew
from shipgrid.assembly.energy import stored_energy
from shipgrid.assembly.plan import CHUNK_ROWS, EVENTS, Plan, Workspace, assemble, new_workspace
from shipgrid.assembly.start import settle_outputs
from shipgrid.automation.interlocks import Interlocks
from shipgrid.automation.power_management import equip, operator_of
from shipgrid.errors import InputErrors, ParameterError, SolverError
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.network import FIDELITIES, Network
from shipgrid.model.records import size_of
from shipgrid.names import checked
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.events import seconds
from shipgrid.scenarios.output_folder import (
    COMMANDS,
    MARK,
    MARK_BEGINS,
    REALTIME,
    REPORT,
    RESULTS,
    SNAPSHOT,
    SUMMARY,
    UNFINISHED,
    OutputFolder,
    check_room,
    copy_rows,
    finish,
    prepare,
    sync_folder,
    taken_over,
    unfinished,
    write_text,
)
from shipgrid.scenarios.outside import Outside, as_lines, merged_commands, read_outside
from shipgrid.scenarios.parts import Groups, parts_wanted
from shipgrid.scenarios.recorder import Column
from shipgrid.scenarios.results import Limiter, Results, citation_keys, open_results
from shipgrid.scenarios.row_log import RowLog, make_results
from shipgrid.scenarios.solver_events import SolverEvents
from shipgrid.scenarios.timeline import TIMELINE, Timeline
from shipgrid.scenarios.waveforms import WaveRecorder, Window, merged, window_columns

DEFAULT_STEP, SHORTEST_STEP, LONGEST_STEP = 30e-6, 1e-6, 1e-3
"""Step lengths [s]."""
TRIAL_STEPS = 2000
"""Steps that are timed to tell how long a run will take: some ten milliseconds."""
WALL_PER_CHUNK = 0.25
"""Wall-clock time [s] between two looks at the interrupt, the progress bar and the recorder's buffers."""
SNAPSHOT_S = 10.0
"""Wall-clock time [s] between two snapshots of a run under way: what is lost when it is killed."""
BYTES_PER_VALUE = 2 * 16
"""Disk space set aside before a run starts: four single-precision numbers a recorded value, as rows while the run goes
on, and in the results made of them, before compression."""

Progress = Callable[[float, float], None]


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
        keeper: Keeper,
    ) -> None:
        """Step a run to its end."""
        ...


class Writer(Protocol):
    """Where rows go: `RowLog`, or a memory of them; it keeps no array that it is handed."""

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
    ) -> None:
        """Add rows to a group: times [s], values, extremes over the interval that ends at each."""
        ...


@dataclass
class Run:
    """One run under way: a plan, its workspace, and what has been logged so far."""

    plan: Plan
    work: Workspace
    events: list[tuple[float, str, str]] = field(default_factory=list)
    wall_s: float = 0.0
    interrupted: bool = False
    failure: str = ""
    continued: bool = False
    ship: Any = None
    rules: Sequence[Any] = ()
    """What the plan was made of, where it was made of a ship."""
    realtime: dict[str, Any] = field(default_factory=dict)
    """What the monitor of a live run has found."""
    folder: Path | None = None
    """Where it is written."""
    workers: int = 1
    """Threads that share the parts of a plan that has some."""
    noted: SolverEvents = field(init=False)
    """What of the solver's notes has been logged."""

    def __post_init__(self) -> None:
        self.noted = SolverEvents(self.plan, self.work)

    @property
    def t(self) -> float:
        """Simulated time [s]."""
        return self.work.n * self.plan.h


@dataclass
class Keeper:
    """Writes the snapshots of a run under way.

    Parameters
    ----------
    path : Path
        Of the snapshot.
    log : RowLog
        Where the run's rows go.
    due : Timeline
        It remembers what those who command the plant do.
    about : dict
        What does not change during the run.
    """

    path: Path
    log: RowLog
    due: Timeline
    about: dict[str, Any]
    written: float = 0.0

    def look(self, run: Run) -> None:
        """Write a snapshot if it is time to; the buffers of the workspace are empty."""
        if time.monotonic() - self.written >= SNAPSHOT_S:
            self.write(run)

    def write(self, run: Run) -> None:
        """Put the rows on the disk, then the snapshot that goes with them."""
        self.put(run.work, self.logged(run), self.log.sync())

    def logged(self, run: Run) -> dict[str, Any]:
        """A copy of what the run and those who command it remember besides the workspace."""
        events = sorted(run.events, key=lambda event: event[0])  # of a live run they come as they are looked for
        return {"events": events, "limiters": limiter_rows(run), "wall_s": run.wall_s} | self.due.remembered()

    def put(self, work: Workspace, logged: dict[str, Any], rows: dict[str, int]) -> None:
        """Write a snapshot whose rows are on the disk."""
        snapshot.write(self.path, work, self.about | logged | {"rows": rows})
        self.written = time.monotonic()


def build(
    ship: Any, step: float, fidelity: str = "averaged", rules: Sequence[Any] = (), parts: Groups | None = None
) -> Plan:
    """Network and plan of a ship at one step length.

    Parameters
    ----------
    ship : Ship
    step : float
        Step [s].
    fidelity : {"averaged", "switching"}
        Detail of the converters.
    rules : sequence of object
        Rules of power management in force.
    parts : mapping of str to sequence of str, optional
        Names of buses by part, where the plant is cut (`assembly/partition.py`).
    """
    network = Network(ship.name, fidelity)
    ship.build(network)
    equip(network, ship, rules)
    return assemble(network, step, parts=parts)


def start(plan: Plan, ship: Any, scenario: Any) -> tuple[Workspace, float]:
    """Workspace at the start a scenario asks for, and the drift left in it.

    Parameters
    ----------
    plan : Plan
    ship : Ship
    scenario : Scenario

    Returns
    -------
    work : Workspace
    drift : float
        Of an operating point; 0 for a cold start.
    """
    commands = scenario.start_commands(ship)
    if scenario.start_state == "moored":
        if plan.network.fidelity == "averaged" and not plan.parts:
            return operating_point(plan, commands)
        mean = build(ship, plan.h, rules=scenario.rules)
        work, drift = operating_point(mean, commands)
        return carried_over(mean, work, plan), drift
    work = new_workspace(plan)
    for path, value in commands.items():
        work.sig[plan.layout.place(f"command:{path}", "start")] = value
    settle_outputs(plan, work)
    return work, 0.0


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
    if fidelity not in FIDELITIES:
        raise ParameterError(f"there is no fidelity '{fidelity}', expected one of {', '.join(FIDELITIES)}")
    of_scenario = scenario.step if fidelity == "averaged" else None
    h = seconds("step", next(h for h in (step, of_scenario, DEFAULT_STEP) if h is not None))
    if not SHORTEST_STEP <= h <= LONGEST_STEP:
        raise ParameterError(f"step = {h!r} s, expected {SHORTEST_STEP:g} s to {LONGEST_STEP:g} s")
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
    whole = {"ship": ship.text, "scenario": scenario.text, "waveforms": _spans(windows, h), **snapshot.identity(plan)}
    if resume:
        folder, saved, arrays = _unfinished_run(place, plan, whole, end, windows)
    else:
        folder, saved, arrays = prepare(place, _bytes_needed(plan, end, windows)), {}, {}
    try:
        about = provenance(plan)
        if resume:
            work = snapshot.restore(plan, saved["n"], arrays)
            run = Run(plan, work, [(t, who, what) for t, who, what in saved["events"]], saved["wall_s"], continued=True)
            saved["continued_at_s"].append(run.t)
            older = saved["from"] / COMMANDS
            outside = merged_commands(outside, read_outside(older, ship.commands) if older.is_file() else ())
            given = merged_commands(outside, _logged_commands(folder, ship, work.n if live else None))
            if found is not None:
                found(run.t, saved["from"])
        else:
            work, drift = start(plan, ship, scenario)
            run, given = Run(plan, work), outside
            saved = {"startup_s": 0.0, "drift": drift, "before": stored_energy(plan, work), "continued_at_s": []}
        run.ship, run.rules, run.folder = ship, scenario.rules, folder.path
        run.workers = live.workers(plan) if live else workers
        text = _run_yaml(ship, scenario, fidelity, h, end, overrides or {}, about, waveforms, groups)
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
    keeper = Keeper(folder.unfinished / SNAPSHOT, log, due, kept)
    try:
        with log:
            if not run.continued:
                _first_rows(run, log)
            (live or go)(run, due, end, log, progress, windows, keeper)
        _conclude(run, due, ship, scenario, fidelity, folder, about, kept)
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


def _unfinished_run(
    place: Path, plan: Plan, whole: Mapping[str, Any], end: float, windows: Sequence[Window]
) -> tuple[OutputFolder, dict[str, Any], dict[str, np.ndarray]]:
    """The run of a plan that got furthest towards a place: a folder to write it on in, and what its snapshot has."""
    fitting, problems = [], []
    for path in unfinished(place):
        try:
            saved, arrays = snapshot.read(path / UNFINISHED / SNAPSHOT)
        except InputErrors as wrong:
            problems += wrong.problems
            continue
        differing = snapshot.differences(saved["identity"], whole)
        if differing:
            problems += [f"--resume: the unfinished run in {path} is another one:", *(f"  {d}" for d in differing)]
        elif saved["n"] > round(end / plan.h):
            at = f"{saved['n'] * plan.h:g} s"
            problems.append(f"--resume: the unfinished run in {path} is at {at} already, expected a later end")
        else:
            fitting.append((saved, path, arrays))
    if not fitting:
        beside = f"{place.parent}/.{place.name}-*"
        state = f"{place} has a finished run" if (place / MARK).is_file() else f"there is no {place}"
        problems = problems or [
            f"--resume: nothing to continue: {state}, and no unfinished one lies beside it ({beside})"
        ]
        raise InputErrors(problems)
    saved, path, arrays = max(fitting, key=lambda found: found[0]["n"])
    saved["from"] = path
    needed = _bytes_needed(plan, end - saved["n"] * plan.h, windows)
    if path == Path(os.path.abspath(place)):  # interrupted, and put there: it stays until there is more
        folder = prepare(place, needed)
        try:
            copy_rows(path, folder)
        except BaseException:
            folder.discard()
            raise
        return folder, saved, arrays
    check_room(place, needed)
    folder = taken_over(path, place)
    if folder is None:
        raise InputErrors([f"--resume: the unfinished run in {path} is being run by another process"])
    (path / SUMMARY).unlink(missing_ok=True)  # of an end that was not reached
    return folder, saved, arrays


def _logged_commands(folder: OutputFolder, ship: Any, forget: int | None) -> list[Outside]:
    """What an unfinished live run was given while it ran; commands from step `forget` on are dropped for ever.

    Those that came after its snapshot are repeated offline. Live, whoever gave them meets the plant as it was before
    them, and will give his own.
    """
    path = folder.unfinished / COMMANDS
    if not path.is_file():
        return []
    found = read_outside(path, ship.commands, torn=True)
    found = [command for command in found if forget is None or command.step < forget]
    write_text(path, as_lines(found))
    return found


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


def _conclude(
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


def go(
    run: Run,
    due: Timeline | None,
    end: float,
    writer: Writer | None = None,
    progress: Progress | None = None,
    windows: Sequence[Window] = (),
    keeper: Keeper | None = None,
) -> None:
    """Step a run to its end, giving each command at its step.

    Parameters
    ----------
    run : Run
        Changed in place; stops early at a failure or an interrupt and says so there.
    due : Timeline or None
        What gives the commands; there are none without.
    end : float
        Simulated time [s] at which to stop.
    writer : Writer, optional
        Where recorded rows go.
    progress : callable, optional
        Called with simulated time and end time [s] after each chunk.
    windows : sequence of Window
        Where every step is recorded, each into its own group of the writer.
    keeper : Keeper, optional
        What writes snapshots, between two chunks.
    """
    plan, work = run.plan, run.work
    last = round(end / plan.h)
    due = due or Timeline(plan, work, run.events, ())
    most = min(plan.step.record_every, plan.step.slow_every) * (CHUNK_ROWS - 1)
    chunk = min(most, 2000)
    waves = WaveRecorder(plan, work, windows)
    if not run.continued:
        waves.first(writer)
    if keeper is not None:
        keeper.write(run)  # so that there is something to continue at any instant
    with Interrupt() as interrupt, Crew(plan, work, run.workers) as crew:
        began = time.perf_counter() - run.wall_s
        while work.n < last and not interrupt.asked:
            due.give()
            stop = int(min(last, work.n + chunk, due.until(), waves.until(work.n)))
            now = time.perf_counter()
            done = crew(stop - work.n, work.n)
            took = time.perf_counter() - now
            work.n += abs(done)
            _flush(run, writer)
            waves.flush(work.n, writer)
            if done < 0:
                run.failure = culprit(plan, work)
                run.events.append((run.t, plan.network.name, run.failure))
                break
            run.wall_s = time.perf_counter() - began
            if keeper is not None:
                keeper.look(run)
            if took > 0.0:
                chunk = int(min(most, max(500, done * WALL_PER_CHUNK / took)))
            if progress is not None:
                try:
                    progress(run.t, end)
                except KeyboardInterrupt:
                    interrupt.asked = True
        if interrupt.asked and work.n < last:
            if keeper is not None:
                keeper.write(run)
            run.interrupted = True
            run.events.append((run.t, plan.network.name, "interrupted"))
    last_rows(run, writer)
    run.wall_s = time.perf_counter() - began


class Interrupt:
    """While it is entered, Ctrl-C asks for a stop between two chunks and does nothing else.

    A KeyboardInterrupt would be raised when the compiled loop returns, before what it did has been booked.
    """

    asked = False

    def __enter__(self) -> Interrupt:
        self.main = threading.current_thread() is threading.main_thread()
        if self.main:
            self.before = signal.signal(signal.SIGINT, self._ask)
        return self

    def _ask(self, number: int, frame: object) -> None:
        self.asked = True

    def __exit__(self, *exception: object) -> None:
        if self.main:
            signal.signal(signal.SIGINT, self.before)


def last_rows(run: Run, writer: Writer | None) -> None:
    """Write the instant at which a run ended, with the extremes since the last row, where no row is due there."""
    plan, work = run.plan, run.work
    if writer is None or work.n == 0:
        return
    at, last = np.array([run.t]), work.sig[plan.step.recorded][None, :]
    low, high, total = work.step.interval.T[:, None, :]
    for group, every, part in recorded_groups(plan):
        steps = work.n % every
        if steps:
            layers = last, np.minimum(low, last), np.maximum(high, last), total / steps
            writer.append(group, at, *(layer[:, part] for layer in layers))


def recorded_groups(plan: Plan) -> tuple[tuple[str, int, slice], ...]:
    """Recorder groups: name, steps between two rows, and which of the recorded signals they have."""
    step = plan.step
    return (
        ("plant", step.record_every, slice(None, step.n_plant)),
        ("slow", step.slow_every, slice(step.n_plant, None)),
    )


def _first_rows(run: Run, writer: RowLog) -> None:
    first = run.work.sig[run.plan.step.recorded][None, :]
    for group, _, part in recorded_groups(run.plan):
        writer.append(group, np.zeros(1), *(first[:, part],) * 4)


def _flush(run: Run, writer: Writer | None) -> None:
    """Empty the workspace's buffers into the writer and the event log."""
    plan, step = run.plan, run.work.step
    for k, (group, every, _) in enumerate(recorded_groups(plan)):
        rows, written = int(step.rows[k]), (step.plant_rows, step.slow_rows)[k]
        if rows and writer is not None:
            newest = run.work.n // every
            at = (newest - rows + 1 + np.arange(rows)) * every * plan.h
            writer.append(group, at, *written[:, :rows])
        step.rows[k] = 0
    run.events += logged_events(plan, run.work, 0) + run.noted.new()
    step.event_count[0] = 0


def logged_events(plan: Plan, work: Workspace, first: int) -> list[tuple[float, str, str]]:
    """Events that the step has logged, from number `first` on, as far as the log still has them."""
    step, count = work.step, int(work.step.event_count[0])
    events = []
    if count - first > EVENTS:
        lost, first = count - EVENTS - first, count - EVENTS
        t = float(step.event_step[first % EVENTS] * plan.h)
        events.append((t, plan.network.name, f"{lost} events before this were not kept"))
    for k in (number % EVENTS for number in range(first, count)):
        watched = plan.network.watched[step.event_which[k]]
        code = int(step.event_value[k])
        if watched.refusal and code == 0:
            continue
        text = watched.texts.get(code, f"code {code}")
        t = float(step.event_step[k] * plan.h)
        events.append((t, watched.owner, f"refused: {text}" if watched.refusal else text))
    return events


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


def energy_balance(
    plan: Plan, work: Workspace, before: Mapping[str, float]
) -> tuple[dict[str, dict[str, float]], float]:
    """Where the energy came from and went, by component, and the relative error of the balance.

    Parameters
    ----------
    plan, work
        A run.
    before : mapping of str to float
        `stored_energy` at its start.

    Returns
    -------
    ledgers : dict of str to dict of str to float
        `sources`, `consumers`, `losses`, `stored` (change) in joule by component path.
    error : float
        (sources - consumers - losses - stored) over the energy exchanged: what sources gave or took, each instant by
        its magnitude, what was stored in the network at the start (it may swing to and fro unseen), and of everything
        else the change of what is stored.
    """
    names = {"supplied": "sources", "consumed": "consumers", "losses": "losses"}
    ledgers: dict[str, dict[str, float]] = {"sources": {}, "consumers": {}, "losses": {}, "stored": {}}
    for (path, ledger), value in zip(plan.energy_items, work.energy, strict=True):
        place = ledgers[names[ledger]]
        short = path.removesuffix(".alpha").removesuffix(".beta")
        place[short] = place.get(short, 0.0) + float(value)
    after = stored_energy(plan, work)
    for path, value in after.items():
        short = path.removesuffix(".alpha").removesuffix(".beta")
        ledgers["stored"][short] = ledgers["stored"].get(short, 0.0) + value - before.get(path, 0.0)
    net = sum(ledgers["sources"].values()) - sum(sum(ledgers[k].values()) for k in ("consumers", "losses", "stored"))
    apart = {path for path, placed in plan.network.placed.items() if not placed.ports}  # a hull, a shaft
    exchanged = work.exchanged + sum(abs(joule) for path, joule in before.items() if path not in apart)
    exchanged += sum(abs(after[path] - before.get(path, 0.0)) for path in apart & set(after))
    if exchanged == 0.0:  # neither a source nor anything stored: what was booked at all is wrong, or nothing was
        exchanged = sum(abs(joule) for ledger in ledgers.values() for joule in ledger.values())
    return ledgers, net / exchanged if exchanged > 0.0 else 0.0


def provenance(plan: Plan) -> dict[str, str]:
    """Versions a result depends on, and what to cite.

    The commit is that of the working copy the package lies in, with `-dirty` where it has changes; "unknown" elsewhere.
    """
    home = Path(shipgrid.__file__).parent
    commit = "unknown"
    try:
        top = _git(home, "rev-parse", "--show-toplevel")
        if (Path(top) / "src" / "shipgrid").resolve() == home.resolve():
            commit = _git(home, "rev-parse", "HEAD") + ("-dirty" if _git(home, "status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        pass
    modules = {t.kind.cls.__module__ for t in plan.layout.types} | {"shipgrid.solvers.companion"}
    return {
        "version": shipgrid.__version__,
        "commit": commit,
        "code": code_digest(plan.kinds),
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
        "machine": platform.machine() + f", {os.cpu_count()} cores",
        "references": " ".join(citation_keys(sorted(modules))),
    }


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()


def _spans(windows: Sequence[Window], h: float) -> str | None:
    return ", ".join(f"{w.first * h!r} s to {w.last * h!r} s" for w in windows) or None


def _bytes_needed(plan: Plan, end: float, windows: Sequence[Window]) -> int:
    values = sum(BYTES_PER_VALUE * len(names) * end / plan.record_period[group] for group, names in plan.groups.items())
    rows = sum(window.last - window.first + 1 for window in windows)
    return int(values) + 2 * rows * (4 * len(window_columns(plan)) + 8) + 8_000_000


def _run_yaml(
    ship: Any,
    scenario: Any,
    fidelity: str,
    step: float,
    end: float,
    overrides: Mapping[str, str],
    about: Mapping[str, str],
    waveforms: Sequence[tuple[float, float]],
    parts: Groups | None,
) -> str:
    """Everything needed to repeat the run: the files as read, with the options."""
    lines = [
        f"{MARK_BEGINS} everything needed to repeat this run, with `shipgrid run` and the path of this file.",
        "schema: 1",
        f"fidelity: {fidelity}",
        f"step: {step!r} s",
        f"until: {end!r} s",
        f"version: {about['version']}",
        f"commit: {about['commit']}",
        *(["waveforms:", *(f"  - {a!r} s:{b!r} s" for a, b in waveforms)] if waveforms else []),
        *(["parts:", *(f"  {name}: [{', '.join(buses)}]" for name, buses in parts.items())] if parts else []),
        f"outside: {COMMANDS}  # beside this file, if there were any: commands given while a live run ran",
        "set:",
        *(f"  {path}: {json.dumps(value)}" for path, value in overrides.items()),
        "ship: |2",  # the indentation said, whatever the text begins with
        *(f"  {line}" for line in ship.text.splitlines()),
        "scenario: |2",
        *(f"  {line}" for line in scenario.text.splitlines()),
        "",
    ]
    return "\n".join(line if line != "set:" or overrides else "set: {}" for line in lines)
