"""A plant under way: stepped piece by piece, commanded, read, taken back to an earlier state.

    with sg.Session(sg.Case("ferry", "mission")) as session:
        session.advance(to=300.0)
        session.command("genset_for.on", True)
        session.read("dc_for.v_dc")

A run to its end (`run_until`), a live run (`realtime/executive.py`) and a session in Python step by the same pieces:
give the commands that are due, step as far as nothing else is due, hand on what was recorded and logged.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from shipgrid.analysis.divergence import culprit
from shipgrid.assembly.crew import Crew
from shipgrid.assembly.energy import energy_balance, stored_energy
from shipgrid.assembly.hand_over import places_to_set, why_not_set
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import CHUNK_ROWS, EVENTS, Workspace
from shipgrid.errors import ParameterError, SolverError, TopologyError
from shipgrid.names import nearest
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.events import seconds
from shipgrid.scenarios.outside import Outside, in_range, range_text
from shipgrid.scenarios.results import Event
from shipgrid.scenarios.solver_events import SolverEvents
from shipgrid.scenarios.start import begin_at
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import WaveRecorder, Window

if TYPE_CHECKING:
    from shipgrid.analysis.steady_state import OperatingPoint

WALL_PER_CHUNK = 0.25
"""Wall-clock time [s] between two looks at the interrupt, the progress bar and the recorder's buffers."""
ORIGIN = "Python"
"""Whose the commands of a session are, in the event log."""

Progress = Callable[[float, float], None]


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


class Snapshots(Protocol):
    """What writes snapshots of a run under way: `resume.SnapshotWriter`."""

    def look(self, run: Run) -> None:
        """Write one if it is time to."""
        ...

    def write(self, run: Run) -> None:
        """Write one."""
        ...


class Startable(Protocol):
    """What a session can be made of beside a plan: `Case`."""

    @property
    def ship(self) -> Any:
        """The ship."""
        ...

    def plan(self) -> Plan:
        """Its plan."""
        ...

    def start(self, plan: Plan) -> tuple[Workspace, float]:
        """Where it begins, and the drift that is left there."""
        ...

    def timeline(self, run: Run) -> Timeline:
        """Who commands it."""
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


class Stepper:
    """The pieces that every run is stepped by.

    Parameters
    ----------
    run : Run
        Changed in place.
    due : Timeline
        What gives the commands.
    windows : sequence of Window
        Where every step is recorded.
    writer : Writer, optional
        Where recorded rows go.
    waves : WaveRecorder, optional
        In place of one for the windows.
    """

    def __init__(
        self,
        run: Run,
        due: Timeline,
        windows: Sequence[Window] = (),
        writer: Writer | None = None,
        waves: WaveRecorder | None = None,
    ):
        self.run, self.due, self.writer = run, due, writer
        self.waves = waves or WaveRecorder(run.plan, run.work, windows)
        self.most = min(run.plan.step.record_every, run.plan.step.slow_every) * (CHUNK_ROWS - 1)

    def horizon(self, stop: int) -> int:
        """The step up to which nothing is due, `stop` at most; commands that are due have been given."""
        n = self.run.work.n
        return int(min(stop, self.due.until(), self.waves.until(n)))

    def step(self, crew: Crew, steps: int) -> int:
        """Step; how many were, negative if the last of them failed: the run says why."""
        done = crew(steps, self.run.work.n)
        self.advanced(done)
        return done

    def advanced(self, done: int) -> None:
        """Book steps that have been run; a negative number says that the last of them failed."""
        run = self.run
        run.work.n += abs(done)
        if done < 0:
            run.failure = culprit(run.plan, run.work)

    def flush(self) -> None:
        """Empty the workspace's buffers into the writer and the event log."""
        run = self.run
        plan, step = run.plan, run.work.step
        for k, (group, every, _) in enumerate(recorded_groups(plan)):
            rows, written = int(step.rows[k]), (step.plant_rows, step.slow_rows)[k]
            if rows and self.writer is not None:
                newest = run.work.n // every
                at = (newest - rows + 1 + np.arange(rows)) * every * plan.h
                self.writer.append(group, at, *written[:, :rows])
            step.rows[k] = 0
        run.events += logged_events(plan, run.work, 0) + run.noted.new()
        step.event_count[0] = 0
        self.waves.flush(run.work.n, self.writer)
        if run.failure:
            run.events.append((run.t, plan.network.name, run.failure))

    def piece(self, crew: Crew, stop: int) -> int:
        """Give what is due, step as far as nothing else is and as the buffers last, empty them; steps done."""
        self.due.give()
        target = self.horizon(min(stop, self.run.work.n + self.most))
        done = self.step(crew, target - self.run.work.n)
        self.flush()
        return done


class Session:
    """A plant stepped from Python.

    What it computes does not depend on the pieces it is stepped by. With several threads it is used with `with`, or
    closed with `close`.

    Parameters
    ----------
    of : Case or Plan
        A ship with its scenario, whose time-line goes on while it is stepped; or the plan of a circuit.
    start : Workspace, OperatingPoint or mapping of str to float, optional
        Where a plan begins: the end of another run of it, an operating point, or values [SI] by path with all others at
        their declared initial value. A case has its own start.
    workers : int
        Threads that share the parts of a plant that is cut; what is computed does not depend on how many there are.

    Attributes
    ----------
    plan : Plan
    given : list of Outside
        Commands that it has been given and that took effect, each with the number of steps done before it.

    Raises
    ------
    ParameterError
        If a case is given a start.
    SteadyStateError
        If the start state that a scenario asks for does not exist.
    TopologyError
        If the start is of another plan, or a path does not exist.
    """

    def __init__(
        self,
        of: Startable | Plan,
        start: Workspace | OperatingPoint | Mapping[str, float] | None = None,
        *,
        workers: int = 1,
    ) -> None:
        if isinstance(of, Plan):
            self.plan, self.ship = of, None
            self._run = Run(of, begin_at(of, start))
            self._places, self._commands = places_to_set(of), None
            self._due = Timeline(of, self._run.work, self._run.events, (), places=self._places)
        else:
            if start is not None:
                raise ParameterError("a case begins where its scenario says, expected no start")
            self.plan, self.ship = of.plan(), of.ship
            work, _ = of.start(self.plan)
            self._run = Run(self.plan, work, ship=of.ship)
            self._due = of.timeline(self._run)
            self._places, self._commands = self._due.places, of.ship.commands
        self._stepper = Stepper(self._run, self._due)
        self._before = stored_energy(self.plan, self._run.work)
        self._crew = Crew(self.plan, self._run.work, workers)
        self._read: dict[str, int] = {}
        self.given: list[Outside] = []

    def __enter__(self) -> Session:
        self._crew.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End its threads; state, events and energies can still be read."""
        self._crew.__exit__()

    def __repr__(self) -> str:
        return f"<Session of {self.plan.network.name} at {self.time:g} s>"

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._run.t

    @property
    def steps(self) -> int:
        """Steps done."""
        return self._run.work.n

    @property
    def work(self) -> Workspace:
        """The state: it changes as the session goes on (`snapshot` makes a copy)."""
        return self._run.work

    def advance(self, by: float | None = None, *, to: float | None = None) -> None:
        """Step on, for some time or to a time, to the nearest step.

        Parameters
        ----------
        by : float, optional
            Time [s] to go on for; one step if neither is given.
        to : float, optional
            Time [s] to go on to.

        Raises
        ------
        ParameterError
            If both are given, or what is given is no time from now on.
        SolverError
            If the run diverged: says when, where and the likely cause. It cannot go on then, but be restored.
        """
        if by is not None and to is not None:
            raise ParameterError("advance: expected a time to go on for (by) or to go on to (to), not both")
        now, h = self.steps, self.plan.h
        name, value = ("to", to) if to is not None else ("by", by)
        length = h if value is None else seconds(name, value)
        stop = (0 if to is not None else now) + (round(length / h) if math.isfinite(length) else -1 - now)
        if stop < now:
            expected = f"a time from {self.time:g} s on" if to is not None else "a time from 0 s on"
            raise ParameterError(f"advance: {name} = {value!r} s, expected {expected}")
        if self._run.failure:
            raise SolverError(f"{self._run.failure}; the session can be restored to an earlier state")
        while self._run.work.n < stop:
            self._stepper.piece(self._crew, stop)
            if self._run.failure:
                raise SolverError(self._run.failure)

    def command(self, path: str, value: float | bool | str) -> str:
        """Give a command, which holds from the next step on.

        Parameters
        ----------
        path : str
            Of a command of the ship, `genset_for.on`; at circuit level also of a constant input, `grid.v_pu`, and of a
            contact, `breaker.close`.
        value : float, bool or str
            In SI units; a word where the command takes words.

        Returns
        -------
        str
            Why the interlocks hold it back; empty if it has taken effect. What is held back is tried again until it
            can be obeyed or another command takes its place.

        Raises
        ------
        ParameterError
            If there is no such command, or it does not take this value.
        """
        number = self._checked(path, value)
        reason = self._due.command(path, number, ORIGIN)
        if not reason:
            self.given.append(Outside(self.steps, path, number, ORIGIN))
        return reason

    def read(self, path: str) -> float:
        """Value of a signal now, in SI units.

        Parameters
        ----------
        path : str
            Of a public signal, `dc_for.v_dc`, of a signal of the circuit, or of a command.

        Raises
        ------
        ParameterError
            If there is none; with the nearest.
        """
        place = self._read.get(path)
        if place is None:
            place = self._read[path] = self._place(path)
        return float(self._run.work.sig[place])

    @property
    def signals(self) -> list[str]:
        """Names that `read` takes: public signals, signals of the circuit, commands."""
        index = self.plan.layout.index
        commands = (path.removeprefix("command:") for path in index if path.startswith("command:"))
        inner = (path for path in index if path in self.plan.layout.unit)
        return sorted({*self.plan.network.published, *commands, *inner})

    @property
    def commands(self) -> list[str]:
        """Paths that `command` takes."""
        return sorted(self._places if self._commands is None else self._commands)

    @property
    def events(self) -> list[Event]:
        """What has happened so far: time [s], source, text."""
        return sorted((Event(*row) for row in self._run.events), key=lambda event: event.time)

    @property
    def energy(self) -> dict[str, dict[str, float]]:
        """Energy [J] so far by component path, in the ledgers `sources`, `consumers`, `losses` and `stored`."""
        return energy_balance(self.plan, self._run.work, self._before)[0]

    @property
    def energy_balance_error(self) -> float:
        """(sources - consumers - losses - stored) over the energy exchanged, so far."""
        return energy_balance(self.plan, self._run.work, self._before)[1]

    def snapshot(self) -> SessionState:
        """A copy of everything that goes on, to come back to."""
        logged = list(self._run.events), self._due.state(), list(self.given)
        return SessionState(self.plan, snapshot.copied(self._run.work), *logged)

    def restore(self, state: SessionState) -> None:
        """Go back to a snapshot; what follows is what followed it then, to the last bit.

        Parameters
        ----------
        state : SessionState
            Of this session, or of another one of the same plan.

        Raises
        ------
        TopologyError
            If it is of another plan.
        """
        if state.plan is not self.plan:
            name = state.plan.network.name
            raise TopologyError(f"the snapshot is of another plan of '{name}', expected one of this session's plan")
        run = self._run
        snapshot.take_back(run.work, state.work)
        run.events[:], run.failure = state.events, ""
        run.noted = SolverEvents(self.plan, run.work)
        self._due.set_state(state.due)
        self.given = list(state.given)

    def _place(self, path: str) -> int:
        index, published = self.plan.layout.index, self.plan.network.published
        if path in published:
            return index[published[path].source]
        place = index.get(path, index.get(f"command:{path}"))
        if place is None:
            raise ParameterError(f"{self.plan.network.name} has no signal '{path}'{nearest(path, self.signals)}")
        return place

    def _checked(self, path: str, value: float | bool | str) -> float:
        """The number of a command's value."""
        if path not in (self._places if self._commands is None else self._commands):
            why = why_not_set(self.plan, path)
            hint = f": {why}" if why else nearest(path, self.commands)
            raise ParameterError(f"{self.plan.network.name} has no command '{path}'{hint}")
        command = None if self._commands is None else self._commands[path]
        words = (command.words if command is not None else None) or {}
        if isinstance(value, str) and value not in words:
            expected = f"expected {range_text(command)}" if command is not None else "expected a number in SI units"
            raise ParameterError(f"{path}: '{value}' is no value of it, {expected}")
        number = words[value] if isinstance(value, str) else float(value)
        if not math.isfinite(number) or (command is not None and not in_range(command, number)):
            expected = range_text(command) if command is not None else "a finite number"
            raise ParameterError(f"{path} = {value!r} is out of range, expected {expected}")
        return number


@dataclass(frozen=True, eq=False)
class SessionState:
    """A state of a session to come back to: what `Session.snapshot` gives.

    Attributes
    ----------
    plan : Plan
        Whose it is.
    work : Workspace
        The plant.
    events : list
        What had happened.
    due : dict
        What commands the plant, as far as it was.
    given : list
        Commands of the session up to then.
    """

    plan: Plan
    work: Workspace
    events: list[tuple[float, str, str]]
    due: dict[str, Any]
    given: list[Outside]

    def __repr__(self) -> str:
        return f"<SessionState of {self.plan.network.name} at {self.work.n * self.plan.h:g} s>"


def run_until(
    run: Run,
    due: Timeline | None,
    end: float,
    writer: Writer | None = None,
    progress: Progress | None = None,
    windows: Sequence[Window] = (),
    snapshots: Snapshots | None = None,
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
    snapshots : Snapshots, optional
        What writes snapshots, between two chunks.
    """
    plan, work = run.plan, run.work
    last = round(end / plan.h)
    stepper = Stepper(run, due or Timeline(plan, work, run.events, ()), windows, writer)
    chunk = min(stepper.most, 2000)
    if not run.continued:
        stepper.waves.first(writer)
    if snapshots is not None:
        snapshots.write(run)  # so that there is something to continue at any instant
    with Interrupt() as interrupt, Crew(plan, work, run.workers) as crew:
        began = time.perf_counter() - run.wall_s
        while work.n < last and not interrupt.asked:
            now = time.perf_counter()
            done = stepper.piece(crew, min(last, work.n + chunk))
            took = time.perf_counter() - now
            if run.failure:
                break
            run.wall_s = time.perf_counter() - began
            if snapshots is not None:
                snapshots.look(run)
            if took > 0.0:
                chunk = int(min(stepper.most, max(500, done * WALL_PER_CHUNK / took)))
            if progress is not None:
                try:
                    progress(run.t, end)
                except KeyboardInterrupt:
                    interrupt.asked = True
        if interrupt.asked and work.n < last:
            if snapshots is not None:
                snapshots.write(run)
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


def first_rows(run: Run, writer: Writer) -> None:
    """Write the instant at which a run begins."""
    first = run.work.sig[run.plan.step.recorded][None, :]
    for group, _, part in recorded_groups(run.plan):
        writer.append(group, np.zeros(1), *(first[:, part],) * 4)


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
