"""The executive: a run's steps, paced to the wall clock, in a thread that holds no interpreter lock.

The same compiled loop as offline, with its clock on (`solvers/pacing.py`). It returns to Python only where the
scenario gives a command, where a waveform window begins or ends, and to stop; these visits take some tens of
microseconds and are counted like everything else. Rows go through rings to a process of their own
(`realtime/recording.py`), so that the disk is never waited for; the main thread looks on: progress, event log, Ctrl-C.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from shipgrid.assembly.crew import Crew
from shipgrid.assembly.crew import cores as usable
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.errors import ParameterError, RealTimeError
from shipgrid.model.kernel import CLOCKS
from shipgrid.realtime import monitor
from shipgrid.realtime.desk import ORIGINS
from shipgrid.realtime.recording import Recording
from shipgrid.realtime.shared import SharedArrays
from shipgrid.scenarios.output_folder import COMMANDS
from shipgrid.scenarios.outside import Outside
from shipgrid.scenarios.resume import SnapshotWriter
from shipgrid.scenarios.row_log import RowLog
from shipgrid.scenarios.session import Interrupt, Progress, Run, Stepper, last_rows, logged_events
from shipgrid.scenarios.simulate import time_of_a_step
from shipgrid.scenarios.snapshot import copied
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import FOREVER, WaveRecorder, Window
from shipgrid.solvers import pacing

POLICIES = ("catch-up", "re-anchor")
FACTORS = (1e-3, 1e3)
"""Range of the factor of time."""
LOOK = 0.25
"""Time [s] between two looks of the main thread at the run."""
WINDOW = 1.0
"""Wall-clock time [s] that a row about computation and idle time is made of."""
RING_WAVES, RING_WINDOWS, RING_COMMANDS, WORST = 16_384, 256, 4096, 32
"""Steps of a waveform window (0.5 s at 30 us), rows about the clock and commands that may wait; worst steps kept."""
PUBLISH = 30e-6
"""Time [s] between two publications of the public signals, where somebody reads them."""
PRIORITY = 80
MCL_CURRENT, LOCKED = 1, "locked"
"""`mlockall` of what there is now: by the start of the clock everything has been touched. The word for it."""
SWITCH = 1e-4
"""Longest time [s] that one Python thread keeps another waiting in a live run."""


@dataclass
class Executive:
    """How a run is paced, and what became of it.

    Parameters
    ----------
    factor : float
        Simulated over wall-clock time.
    policy : {"catch-up", "re-anchor"}
        After an overrun: run the steps that follow without waiting until the plan holds again, or let the plan begin
        anew, later.
    cores : sequence of int
        Processor cores for the loop, as many threads as there are that share the parts of a plant which has some; one
        on any core if left out.
    virtual_cost : sequence of int, optional
        For tests: nanoseconds that each step takes, in turn, on a clock that does not exist.
    attached : callable, optional
        Called with the shared arrays and the run before the first step; what it returns is called after the last.
    snapshot_every : float
        Wall-clock time [s] between two snapshots, from which the run can be continued; each keeps the loop for some
        tens of microseconds. One is always written at the start, and when the run is stopped.

    Raises
    ------
    ParameterError
        For a factor out of range, or a policy that there is not.
    """

    factor: float = 1.0
    policy: str = "catch-up"
    cores: Sequence[int] = ()
    virtual_cost: Sequence[int] | None = None
    attached: Callable[[SharedArrays, Run], Callable[[], dict[str, Any]]] | None = None
    snapshot_every: float = 60.0
    paused: threading.Event = field(default_factory=threading.Event, init=False)
    stopped: threading.Event = field(default_factory=threading.Event, init=False)
    wanted: threading.Event = field(default_factory=threading.Event, init=False)
    singles: int = field(default=0, init=False)
    counting: threading.Lock = field(default_factory=threading.Lock, init=False)
    pace: pacing.PaceWork = field(default_factory=pacing.no_pace, init=False)

    def __post_init__(self) -> None:
        if not FACTORS[0] <= self.factor <= FACTORS[1]:
            raise ParameterError(f"factor = {self.factor!r}, expected {FACTORS[0]:g} to {FACTORS[1]:g}")
        if self.policy not in POLICIES:
            raise ParameterError(f"there is no overrun policy '{self.policy}', expected {' or '.join(POLICIES)}")
        if sys.platform not in CLOCKS:
            raise RealTimeError(f"live runs need a POSIX clock, and {sys.platform} has none")

    def groups(self, plan: Plan) -> tuple[dict[str, Any], dict[str, float]]:
        """Columns and period [s] of what is recorded besides the plant."""
        return {"realtime": monitor.columns(self.workers(plan))}, {"realtime": self.window(plan) * plan.h}

    def workers(self, plan: Plan) -> int:
        """Threads that share a plant."""
        return max(1, min(len(self.cores), len(plan.parts)))

    def window(self, plan: Plan) -> int:
        """Steps of a window."""
        return max(1, round(WINDOW * self.factor / plan.h))

    def pause(self) -> None:
        """Let the plant stand still before its next step; the plan begins anew when it goes on."""
        self.paused.set()
        self.pace.pacer[0].stop = 1

    def step(self, count: int = 1) -> None:
        """Run some steps of a plant that stands still; one that sails has no use for them."""
        with self.counting:
            self.singles += count if self.paused.is_set() else 0

    def go_on(self) -> None:
        """End a pause."""
        with self.counting:
            self.paused.clear()
            self.singles = 0

    def snapshot(self) -> None:
        """Have a snapshot written of the state before the next step, while the run goes on."""
        self.wanted.set()
        self.pace.pacer[0].stop = 1

    def stop(self) -> None:
        """End the run before its next step, to be continued."""
        self.stopped.set()
        self.pace.pacer[0].stop = 1

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
        """Step a run to its end, as `session.run_until` does, but by the clock."""
        plan, work = run.plan, run.work
        time_of_a_step(plan, work)  # compiled, and in the caches, before the clock is on
        waves = WaveRecorder(plan, work, windows)
        if not run.continued:
            waves.first(log)
        keeper.write(run)
        shared = self._share(run)
        waves = WaveRecorder(plan, work, windows, FOREVER)
        with (log.folder / COMMANDS).open("a") as kept, shared:
            steps = _Steps(self, run, due, waves, round(end / plan.h), kept, keeper)
            written = self._record(steps, shared, log, end, progress)
        if steps.wrong is not None:
            raise steps.wrong
        run.events.sort(key=lambda event: event[0])
        work.step.rows[:], work.step.event_count[0], work.step.wave_row[0] = 0, 0, -1
        if work.n < steps.last and not run.failure:
            keeper.write(run)
            run.interrupted = True
            run.events.append((run.t, plan.network.name, "interrupted"))
        last_rows(run, log)
        found = monitor.figures(work.pace, plan.h, self.factor) | steps.found
        found |= {"rows_lost": written["lost"], "policy": self.policy}
        found["verdict"] = monitor.verdict(found)
        run.realtime = found | {"histograms": monitor.histograms(work.pace)}
        if written["failure"]:
            raise OSError(written["failure"])

    def _record(
        self, steps: _Steps, shared: SharedArrays, log: RowLog, end: float, progress: Progress | None
    ) -> dict[str, Any]:
        """Run the steps while another process records them; what that one says at the end."""
        run, plan, n, keeper = steps.plant, steps.plant.plan, steps.plant.work.n, steps.keeper
        every = {name: round(period / plan.h) for name, period in log.periods.items()}
        windows = [(window.first, window.last, window.group) for window in steps.waves.windows]
        told = {"n": n, "step": plan.h, "every": every, "windows": windows, "weights": steps.waves.weights.tolist()}
        recording = Recording(shared, log, told)
        try:
            detach = self.attached(shared, run) if self.attached else dict
            shared.path.unlink()  # all who look at it have mapped it; a run that is killed leaves nothing behind
            try:
                with Interrupt() as interrupt, _quiet():
                    steps.start()
                    while steps.is_alive():
                        steps.join(LOOK)
                        steps.log_events()
                        if interrupt.asked:
                            self.stop()
                        if time.monotonic() - keeper.written > self.snapshot_every and not self.wanted.is_set():
                            self.snapshot()
                        steps.write_commands()
                        self._write_snapshot(steps, recording, windows, n)
                        if progress is not None:
                            progress((n + int(self.pace.pacer[0].steps)) * plan.h, end)
            finally:
                if steps.is_alive():  # something went wrong here: the plant does not sail on without a crew
                    self.stop()
                    steps.join()
                steps.found |= detach()
        finally:
            self.go_on()  # what was asked of this run is not asked of the next
            self.stopped.clear()
            self.wanted.clear()
            written = recording.end()
            log.catch_up()
        steps.log_events()
        steps.write_commands()
        return written

    def _write_snapshot(self, steps: _Steps, recording: Recording, windows: list[tuple[int, int, str]], n: int) -> None:
        """Write the snapshot that has been asked for, if its state has been copied."""
        if steps.state is None:
            return
        state, logged, counted = steps.state
        steps.state = None
        try:
            recording.sync()
            os.fsync(steps.kept.fileno())
            steps.keeper.put(state, logged, recording.rows(windows, n, counted))
        except OSError as wrong:  # the older one stays, and the ship sails on
            what = f"no snapshot could be written: {wrong}"
            steps.plant.events.append((state.n * steps.plant.plan.h, steps.plant.plan.network.name, what))
            steps.keeper.written = time.monotonic()

    def _share(self, run: Run) -> SharedArrays:
        """Put everything that other processes look at into shared memory, the clock's arrays among it."""
        plan, work = run.plan, run.work
        pace = pacing.pace_work(
            bins=monitor.BINS,
            windows=RING_WINDOWS,
            worst=WORST,
            commands=RING_COMMANDS,
            signals=len(work.sig) if self.attached else 0,
            cores=self.workers(plan),
        )
        p = pace.pacer[0]
        period = Fraction(plan.h).limit_denominator(10**9) / Fraction(self.factor).limit_denominator(10**6) * 10**9
        p.whole, p.den = int(period), period.denominator
        p.num = period.numerator - p.whole * p.den
        p.on, p.window, p.reanchor = 1, self.window(plan), int(self.policy == "re-anchor")
        p.publish_every = max(1, round(PUBLISH / plan.h)) if self.attached else 0
        if self.virtual_cost is not None:
            p.virtual = 1
            pace = pace._replace(virtual_cost=np.array(self.virtual_cost, np.int64))
        names = ("rows", "plant_rows", "slow_rows", "wave_row")
        step = {name: getattr(work.step, name) for name in names}
        waves = RING_WAVES if plan.step.wave_source.size else 1
        step["wave_rows"] = np.zeros((waves, work.step.wave_rows.shape[1]))
        if self.attached:  # whoever looks before the first step sees the plant as it starts
            pace.outbox[0], pace.outbox_step[0], pace.outbox_count[0] = work.sig, work.n, 1
        shared = SharedArrays.create(step | pace._asdict())
        work.step = work.step._replace(**{name: shared.arrays[name] for name in step})
        work.pace = self.pace = pacing.PaceWork(**{name: shared.arrays[name] for name in pace._fields})
        return shared


class _Steps(threading.Thread):
    """The thread that runs the steps.

    Parameters
    ----------
    executive : Executive
    run : Run
    due : Timeline
    waves : WaveRecorder
    last : int
        Step number to stop at.
    kept : TextIO
        Where commands from outside are written.
    keeper : Keeper
        What knows what a snapshot has besides the workspace.
    """

    def __init__(
        self,
        executive: Executive,
        run: Run,
        due: Timeline,
        waves: WaveRecorder,
        last: int,
        kept: TextIO,
        keeper: SnapshotWriter,
    ):
        super().__init__(name="shipgrid-steps", daemon=True)
        self.executive, self.plant, self.due, self.waves, self.last = executive, run, due, waves, last
        self.stepper = Stepper(run, due, waves=waves)
        self.kept, self.keeper = kept, keeper
        self.state: tuple[Workspace, dict[str, Any], dict[str, np.ndarray]] | None = None
        self.wrong: BaseException | None = None
        self.found: dict[str, Any] = {}
        self.events_seen = self.applied_seen = 0
        self.logging = threading.Lock()
        self.lines: deque[str] = deque()
        plan = run.plan
        self.path = {plan.layout.index[f"command:{path}"]: path for path in plan.network.commands}

    def run(self) -> None:
        """Until the end, a failure, or a request to stop."""
        try:
            self._sail()
        except BaseException as wrong:  # the main thread raises it
            self.wrong = wrong
        finally:
            if self.found.get("scheduling", {}).get("memory") == LOCKED:  # the process', it outlives the thread
                ctypes.CDLL(None).munlockall()

    def _sail(self) -> None:
        executive, plan, work = self.executive, self.plant.plan, self.plant.work
        cores, workers = list(executive.cores) or [None], executive.workers(plan)
        spare = workers < len(usable())
        settled: dict[int, dict[str, str]] = {}

        def joined(worker: int) -> None:
            settled[worker] = settle(cores[worker], spare=spare)

        with Crew(plan, work, workers, joined, crowded=workers > max(1, len(set(executive.cores)))) as crew:
            joined(0)  # after the others have begun: a thread inherits the cores of the one that starts it
            self.found["scheduling"] = settled[0]
            if len(settled) > 1:
                self.found["crew"] = [settled[w] | {"parts": crew.parts(w)} for w in sorted(settled)]
            self._steps(crew)

    def _steps(self, crew: Crew) -> None:
        executive, run, plan, work = self.executive, self.plant, self.plant.plan, self.plant.work
        p = work.pace.pacer[0]
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        first, spent, began = work.n, 0, self._anchor()
        while work.n < self.last and not run.failure:
            p.stop = 0
            if executive.stopped.is_set():
                break
            if executive.wanted.is_set():
                self._copy_state()
            standing = executive.paused.is_set()
            if standing and executive.singles == 0:
                spent += int(p.now) - began
                asked = executive.stopped, executive.wanted
                while executive.paused.is_set() and executive.singles == 0 and not any(a.is_set() for a in asked):
                    time.sleep(1e-3)
                began = self._anchor()  # nobody was late meanwhile
                continue
            self.log_events()  # before the commands of this instant, as offline
            given, done = self.due.give(), 0
            stop = self.stepper.horizon(self.last)
            if given:
                p.did |= pacing.VISITED
                while done == 0:  # a request waits for one step: what has been given belongs to it
                    p.stop = 0
                    done = self.stepper.step(crew, 1)
            else:
                stop = min(stop, work.n + executive.singles) if standing else stop
                done = self.stepper.step(crew, stop - work.n)
            self._booked(done, standing=standing)
        spent += int(p.now) - began
        run.wall_s += 1e-9 * spent
        steps = work.n - int(p.anchor_step)
        due = int(p.anchor) + steps * int(p.whole) + steps * int(p.num) // int(p.den)
        self.found |= {
            "from_s": first * plan.h,
            "simulated_s": (work.n - first) * plan.h,
            "wall_s": 1e-9 * spent,
            "end_after_deadline_s": 1e-9 * (int(p.now) - due),
            "involuntary_switches": resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw - before,
        }

    def _booked(self, done: int, *, standing: bool) -> None:
        """Count steps that have been run singly; log a failure of the last of them."""
        run = self.plant
        with self.executive.counting:
            self.executive.singles = max(0, self.executive.singles - abs(done) * standing)
        if run.failure:
            run.events.append((run.t, run.plan.network.name, run.failure))

    def _copy_state(self) -> None:
        """Copy what a snapshot has, for the main thread to write."""
        work = self.plant.work
        self.log_events()
        counted = {"rows": work.step.rows, "pace_count": work.pace.pace_count, "wave_row": work.step.wave_row}
        counted = {name: array.copy() for name, array in counted.items()}
        self.state = copied(work), self.keeper.logged(self.plant), counted
        self.executive.wanted.clear()
        work.pace.pacer[0].did |= pacing.VISITED

    def _anchor(self) -> int:
        """Let the next step begin now; the clock [ns]."""
        work = self.plant.work
        p = work.pace.pacer[0]
        now = int(p.now) if p.virtual else time.monotonic_ns()
        p.anchor, p.anchor_step, p.now = now, work.n, now
        return now

    def write_commands(self) -> None:
        """Write down the commands from outside; by the main thread, so that the loop waits for no disk."""
        while self.lines:
            self.kept.write(self.lines.popleft())
        self.kept.flush()

    def log_events(self) -> None:
        """Put what the steps have met, and the commands from outside that they have taken, into the event log."""
        run, pace = self.plant, self.plant.work.pace
        with self.logging:
            taken, met = int(pace.applied_count[0]), int(run.work.step.event_count[0])
            if met > self.events_seen:
                run.events += logged_events(run.plan, run.work, self.events_seen)
                self.events_seen = met
            run.events += run.noted.new()
            for k in range(self.applied_seen, taken):
                entry = pace.applied[k % len(pace.applied)]
                origin = ORIGINS[int(entry.origin)]
                command = Outside(int(entry.step), self.path[int(entry.place)], float(entry.value), origin)
                self.due.obeyed(command)
                self.lines.append(f"{command.step},{command.path},{command.value!r},{origin}\n")
            self.applied_seen = pace.inbox_count[2] = taken  # their places may be used again


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Python's own interruptions away from the visits of the loop."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
        sys.setswitchinterval(interval)


def settle(core: int | None, *, spare: bool = True) -> dict[str, str]:
    """Ask the system for what helps this thread to be on time, and say what was granted.

    Parameters
    ----------
    core : int, optional
        Processor core to stay on.
    spare : bool
        Whether a core is left for the rest of the machine: without one a thread that never sleeps has no priority.

    Returns
    -------
    dict of str to str
        `core`, `priority`, `memory`: what is in force, or why it is not.
    """
    found = {"core": "any", "priority": "normal", "memory": "not locked"}
    if core is not None and hasattr(os, "sched_setaffinity"):
        try:
            os.sched_setaffinity(0, {core})
            found["core"] = str(core)
        except OSError as wrong:
            found["core"] = f"{', '.join(map(str, usable()))}: core {core}: {wrong.strerror}"
    if not sys.platform.startswith("linux"):
        return found
    try:
        runtime = int(Path("/proc/sys/kernel/sched_rt_runtime_us").read_text())
    except OSError:
        runtime = 0
    if not spare:
        found["priority"] = "normal: no core is left for the rest of the machine"
    elif runtime != -1:
        # a thread that never sleeps is stopped for the rest of each period: 50 ms of every second by default
        found["priority"] = "normal: kernel.sched_rt_runtime_us is not -1"
    else:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            found["priority"] = f"SCHED_FIFO {PRIORITY}"
        except OSError as wrong:
            found["priority"] = f"normal: {wrong.strerror}"
    library = ctypes.CDLL(None, use_errno=True)
    locked = library.mlockall(MCL_CURRENT) == 0
    found["memory"] = LOCKED if locked else f"not locked: {os.strerror(ctypes.get_errno())}"
    return found
