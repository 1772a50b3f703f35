"""Recording while live: a process of its own takes rows out of the loop's rings and puts them on the disk.

The loop never waits for it. Rows it has not taken when their place is needed again are lost, and counted. It ends when
its standard input does, so also when the process that runs the plant is killed: then with all rows that were written.
"""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shipgrid.realtime.shared import SharedArrays
from shipgrid.scenarios.row_log import RowLog

LOOK = 0.05
"""Time [s] between two looks at the rings."""
SYNC = "sync\n"
"""Word for: take what is there, put it on the disk, and say when that is done."""


def spans(windows: Iterable[tuple[int, int, str]], n: int) -> list[tuple[str, int, int, int]]:
    """Group, first step, number of the first row and number after the last, of each window that goes on after step `n`.

    Parameters
    ----------
    windows : iterable of (int, int, str)
        First and last step, group; rows are counted through all of them.
    n : int
        Steps done before the recording began.
    """
    found, before = [], 0
    for first, last, group in windows:
        first = max(first, n + 1)
        if first <= last:
            found.append((group, first, before, before + last - first + 1))
            before += last - first + 1
    return found


def newest(ring: np.ndarray, taken: int, counted: Callable[[], int]) -> tuple[np.ndarray, np.ndarray, int]:
    """Copy what has come into a ring: numbers and contents, and how many were overwritten before they were copied.

    Parameters
    ----------
    ring : ndarray, shape (capacity, ...)
    taken : int
        How many have been taken before.
    counted : callable
        Says how many there are; asked again after the copy, since the writer goes on meanwhile.
    """
    capacity, count = len(ring), counted()
    numbers = np.arange(max(taken, count - capacity + 1), count)
    contents = ring[numbers % capacity]
    sound = numbers > counted() - capacity  # the next one to be written takes the place of the oldest
    numbers, contents = numbers[sound], contents[sound]
    return numbers, contents, int(numbers[0]) - taken if len(numbers) else 0


class Ring:
    """One ring of rows, read from another process.

    Parameters
    ----------
    group : str
        Of the log.
    rows : ndarray, shape (layers, capacity, columns)
    first, every : int
        Step number of the row that is counted 0, and steps between two rows.
    step : float
        Step [s].
    """

    def __init__(self, group: str, rows: np.ndarray, first: int, every: int, step: float):
        self.group, self.rows, self.first, self.every, self.step = group, rows, first, every, step
        self.taken = self.lost = 0

    def take(self, counted: Callable[[], int], log: RowLog) -> None:
        """Hand on the rows up to the number that `counted` says."""
        numbers, rows, lost = newest(self.rows.swapaxes(0, 1), self.taken, counted)
        self.lost += lost
        if len(numbers):
            log.append(self.group, (self.first + numbers * self.every) * self.step, *rows.swapaxes(0, 1))
            self.taken = int(numbers[-1]) + 1


def wave_count(wave_row: np.ndarray) -> int:
    """Rows of waveform windows so far, of the counter that says whether one is open as well."""
    state = int(wave_row[0])
    return state if state >= 0 else -1 - state


class Recorder:
    """What the process does, and what it is told.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        The rings and their counters.
    told : dict
        `n`: steps done before; `step`; `every`: steps between rows by group; `windows`: (first, last, group);
        `weights`: what windows' columns are made of.
    log : RowLog
    """

    def __init__(self, arrays: dict[str, np.ndarray], told: dict[str, Any], log: RowLog):
        self.arrays, self.log, n, step = arrays, log, told["n"], told["step"]
        names = {"plant": ("plant_rows", "rows", 0), "slow": ("slow_rows", "rows", 1)}
        names["realtime"] = ("pace_rows", "pace_count", 0)
        self.rings = []
        for group, (rows, counter, k) in names.items():
            every = told["every"][group]
            ring = Ring(group, arrays[rows], (n // every + 1) * every, every, step)
            self.rings.append((ring, arrays[counter], k))
        self.step, self.waves, self.waves_taken, self.waves_lost = step, arrays["wave_rows"], 0, 0
        self.weights = np.array(told["weights"])
        self.windows = spans(told["windows"], n)

    def look(self) -> None:
        """Take what is new."""
        for ring, counter, k in self.rings:
            ring.take(lambda counter=counter, k=k: int(counter[k]), self.log)
        numbers, waves, lost = newest(self.waves, self.waves_taken, lambda: wave_count(self.arrays["wave_row"]))
        self.waves_lost += lost
        for group, first, begin, end in self.windows:
            inside = (numbers >= begin) & (numbers < end)
            if np.any(inside):
                self.log.append(group, (first + numbers[inside] - begin) * self.step, waves[inside] @ self.weights)
        if len(numbers):
            self.waves_taken = int(numbers[-1]) + 1

    def lost(self) -> dict[str, int]:
        """Rows that were not taken in time, by group."""
        found = {ring.group: ring.lost for ring, _, _ in self.rings} | {"waveforms": self.waves_lost}
        return {group: rows for group, rows in found.items() if rows}


def main() -> None:
    """Read what to do from the standard input, do it until that ends, and say what there is on the disk."""
    told = json.loads(sys.stdin.readline())
    shared = SharedArrays(Path(told["memory"]))
    with RowLog(Path(told["folder"]), told["groups"], told["periods"], told["attributes"], told["rows"]) as log:
        recorder = Recorder(shared.arrays, told, log)
        print("ready", flush=True)
        failure, asked, rows = "", "a look", {}
        while not failure and asked:
            asked = sys.stdin.readline() if select.select([sys.stdin], [], [], LOOK)[0] else "a look"
            failure = _attempt(recorder.look)
            if asked == SYNC:
                failure = failure or _attempt(lambda: rows.update(log.sync()))
                print(failure or ("rows were lost" if recorder.lost() else ""), flush=True)
        failure = failure or _attempt(lambda: rows.update(log.sync()))
    with contextlib.suppress(BrokenPipeError):  # nobody is left to hear it
        print(json.dumps({"rows": rows, "lost": recorder.lost(), "failure": failure}), flush=True)


def _attempt(what: Any) -> str:
    try:
        what()
    except OSError as wrong:  # the disk is full, say: the ship sails on
        return str(wrong)
    return ""


class Recording:
    """The recording process, from the side of the one that runs the plant.

    Parameters
    ----------
    shared : SharedArrays
        With the rings.
    log : RowLog
        Whose files it goes on; nobody else may append while it runs.
    told : dict
        As of `Recorder`.
    """

    def __init__(self, shared: SharedArrays, log: RowLog, told: dict[str, Any]):
        told |= {"memory": str(shared.path), "folder": str(log.folder), "groups": log.groups}
        self.before = log.sync()
        told |= {"periods": log.periods, "attributes": log.attributes, "rows": self.before}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "shipgrid.realtime.recording"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the other process
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps(told) + "\n")
        self.process.stdin.flush()
        if self.process.stdout.readline() != "ready\n":
            raise OSError("the recording process did not start")

    def sync(self) -> None:
        """Have everything recorded so far on the disk.

        Raises
        ------
        OSError
            If that cannot be.
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(SYNC)
        self.process.stdin.flush()
        failure = self.process.stdout.readline().strip()
        if failure or self.process.poll() is not None:
            raise OSError(failure or "the recording process died")

    def rows(
        self, windows: Iterable[tuple[int, int, str]], n: int, counted: Mapping[str, np.ndarray]
    ) -> dict[str, int]:
        """Rows of each group that belong to a state, of the counters as they were then.

        Parameters
        ----------
        windows, n
            As of `spans`.
        counted : mapping of str to ndarray
            `rows`, `pace_count`, `wave_row`.
        """
        found, waves = dict(self.before), wave_count(counted["wave_row"])
        for group, k in (("plant", 0), ("slow", 1)):
            found[group] += int(counted["rows"][k])
        found["realtime"] += int(counted["pace_count"][0])
        for group, _, begin, end in spans(windows, n):
            found[group] += max(0, min(waves, end) - begin)
        return found

    def end(self) -> dict[str, Any]:
        """Let it take the last rows, and hear what it says: `rows` on the disk, `lost`, `failure`."""
        said, _ = self.process.communicate()
        return json.loads(said) if said else {"rows": {}, "lost": {}, "failure": "the recording process died"}


if __name__ == "__main__":
    main()
