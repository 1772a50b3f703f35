"""The rows of a run under way: a plain file a group that only grows, so that no instant of a killed process harms it.

A NetCDF-4 file is inconsistent while the library writes to it, and a process killed then leaves none. Here a row is its
time and its values, one after the other; a snapshot says how many rows of each group belong to it, and what lies behind
them, half a row among it, is dropped when the run is continued. `results.nc` is made of these files when the run ends;
who opens an unfinished run makes one elsewhere, and changes nothing here.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.scenarios.output_folder import COLUMNS, RESULTS, ROWS, SNAPSHOT, sync_file, write_text
from shipgrid.scenarios.recorder import CHUNK_ROWS, LAYERS, Column, ResultsWriter
from shipgrid.scenarios.snapshot import read
from shipgrid.scenarios.waveforms import Window, window_columns

BYTES_PER_VALUE = 2 * 16
"""Disk space set aside before a run starts: four single-precision numbers a recorded value, as rows while the run goes
on, and in the results made of them, before compression."""

GROUP = re.compile(r"[a-z]+(/[0-9]+)?")
"""Name of a group: it becomes that of a file."""


class RowLog:
    """Append rows to the files of a folder.

    Parameters
    ----------
    folder : Path
        Where they are.
    groups : mapping of str to sequence of Column
        Signals of each group, as `ResultsWriter` takes them.
    periods : mapping of str to float
        Sampling period of a group [s].
    attributes : mapping of str to str
        For the whole of `results.nc`.
    rows : mapping of str to int, optional
        Rows of each group that are kept of what is there; none of it if left out.

    Raises
    ------
    ValueError
        If the name of a group cannot be made that of a file.
    OSError
        If a file cannot be written, or has fewer rows.
    """

    def __init__(
        self,
        folder: Path,
        groups: Mapping[str, Sequence[Column]],
        periods: Mapping[str, float],
        attributes: Mapping[str, Any],
        rows: Mapping[str, int] | None = None,
    ):
        self.folder, self.groups = folder, {name: list(columns) for name, columns in groups.items()}
        self.periods, self.attributes = dict(periods), dict(attributes)
        paths = {name: _path(folder, name) for name in self.groups}
        head = {"groups": self.groups, "periods": self.periods, "attributes": self.attributes}
        write_text(folder / COLUMNS, json.dumps(head))
        self.files: dict[str, BinaryIO] = {}
        self.row = {name: _row(name, len(columns)) for name, columns in self.groups.items()}
        for name, row in self.row.items():
            file = self.files[name] = open(paths[name], "ab")  # noqa: SIM115
            kept = (rows or {}).get(name, 0) * row.itemsize
            if file.tell() < kept:
                raise OSError(f"{file.name} is damaged: {file.tell()} bytes, expected {kept} or more")
            file.truncate(kept)
            file.seek(kept)

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
        mean: np.ndarray | None = None,
    ) -> None:
        """Add rows to a group, as `ResultsWriter.append`; they are on their way to the disk."""
        rows = np.empty(len(time), self.row[group])
        rows["time"] = time
        given = [layer for layer in (value, low, high, mean) if layer is not None]
        for k, layer in enumerate(given):
            rows["layers"][:, k] = layer
        self.files[group].write(rows.tobytes())

    def sync(self) -> dict[str, int]:
        """Put everything on the disk, and say how many rows each group has there."""
        for file in self.files.values():
            file.flush()
            os.fsync(file.fileno())
        return {name: file.tell() // self.row[name].itemsize for name, file in self.files.items()}

    def catch_up(self) -> None:
        """Go on behind what another process has appended."""
        for file in self.files.values():
            file.seek(0, os.SEEK_END)

    def close(self) -> None:
        """Close the files, also those that the disk has no room for."""
        for file in self.files.values():
            try:
                file.close()
            except OSError:  # what waited is lost; it was not promised to anybody
                file.close()

    def __enter__(self) -> RowLog:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def make_results(
    folder: Path,
    log: Path,
    events: Iterable[tuple[float, str, str]],
    limiters: Iterable[tuple[str, float, float, int]],
) -> None:
    """Make `results.nc` of all whole rows of a run that has ended; an older one is replaced whole.

    Parameters
    ----------
    folder : Path
        Where it is put.
    log : Path
        Folder of the rows, on the same disk.
    events, limiters
        Logs of the run, as `ResultsWriter` takes them.

    Raises
    ------
    OSError
        If it cannot be written; an older one is untouched.
    """
    _write_results(log, log, events, limiters, None)
    sync_file(log / RESULTS)
    os.replace(log / RESULTS, folder / RESULTS)


def recover_results(log: Path, to: Path) -> None:
    """Make `results.nc` of a run that was killed or still goes on, as far as its last snapshot.

    Parameters
    ----------
    log : Path
        Folder of its rows and its snapshot. Nothing in it is changed.
    to : Path
        Folder where it is made.

    Raises
    ------
    InputErrors
        If there is no snapshot, or it is damaged.
    OSError
        If rows are missing, or there is no room.
    """
    about, _ = read(log / SNAPSHOT)
    _write_results(to, log, about["events"], about["limiters"], about["rows"])


def _write_results(
    folder: Path,
    log: Path,
    events: Iterable[tuple[float, str, str]],
    limiters: Iterable[tuple[str, float, float, int]],
    rows: Mapping[str, int] | None,
) -> None:
    """Write `results.nc` into a folder, with so many rows of each group; all whole ones if that is left out."""
    head = json.loads((log / COLUMNS).read_text())
    with ResultsWriter(folder, head["groups"], head["periods"], head["attributes"]) as writer:
        for name, columns in head["groups"].items():
            row, path = _row(name, len(columns)), _path(log, name)
            left = path.stat().st_size // row.itemsize if rows is None else rows[name]
            with path.open("rb") as file:
                while left > 0:
                    part = np.fromfile(file, row, min(left, CHUNK_ROWS))
                    if not len(part):
                        raise OSError(f"{path} is damaged: {left} rows less than there were")
                    writer.append(name, part["time"], *(part["layers"][:, k] for k in range(row["layers"].shape[0])))
                    left -= len(part)
        writer.events(events)
        writer.limiters(limiters)


def _path(folder: Path, group: str) -> Path:
    if not GROUP.fullmatch(group):
        raise ValueError(f"{group!r} is not the name of a group, expected such as 'plant' or 'waveforms/0'")
    return folder / f"{group.replace('/', '-')}{ROWS}"


def _row(group: str, columns: int) -> np.dtype:
    """A row of a group: every step of a window is recorded, so that it has no extremes and means."""
    layers = 1 if group.startswith("waveforms/") else len(LAYERS)
    return np.dtype([("time", "<f8"), ("layers", "<f4", (layers, columns))])


def bytes_needed(plan: Plan, end: float, windows: Sequence[Window]) -> int:
    """Disk space [bytes] that a run needs at most.

    Parameters
    ----------
    plan : Plan
    end : float
        Length of the run [s].
    windows : sequence of Window
        Where every step is recorded.
    """
    values = sum(BYTES_PER_VALUE * len(names) * end / plan.record_period[group] for group, names in plan.groups.items())
    rows = sum(window.last - window.first + 1 for window in windows)
    return int(values) + 2 * rows * (4 * len(window_columns(plan)) + 8) + 8_000_000
