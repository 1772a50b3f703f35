"""The rows of a run under way: a plain file a group that only grows, so that no instant of a killed process harms it.

A NetCDF-4 file is inconsistent while the library writes to it, and a process killed then leaves none. Here a row is its
time and its values, one after the other; a snapshot says how many rows of each group belong to it, and what lies behind
them, half a row among it, is dropped when the run is continued. `results.nc` is made of these files when the run ends,
or when an unfinished run is opened.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from shipgrid.scenarios.output_folder import sync_file, write_text
from shipgrid.scenarios.recorder import CHUNK_ROWS, FILE_NAME, LAYERS, Column, ResultsWriter
from shipgrid.scenarios.snapshot import read

HEAD = "columns.json"
"""File that says what the rows are."""


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
        head = {"groups": self.groups, "periods": self.periods, "attributes": self.attributes}
        write_text(folder / HEAD, json.dumps(head))
        self.files: dict[str, BinaryIO] = {}
        self.row = {name: _row(name, len(columns)) for name, columns in self.groups.items()}
        for name, row in self.row.items():
            file = self.files[name] = open(_path(folder, name), "ab")  # noqa: SIM115
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
    rows: Mapping[str, int] | None = None,
) -> None:
    """Make `results.nc` of the rows of a run; an older one is replaced whole.

    Parameters
    ----------
    folder : Path
        Where it is put.
    log : Path
        Folder of the rows.
    events, limiters
        Logs of the run, as `ResultsWriter` takes them.
    rows : mapping of str to int, optional
        Rows of each group to take; all whole ones if left out.
    """
    head = json.loads((log / HEAD).read_text())
    with tempfile.TemporaryDirectory(dir=log) as made:
        with ResultsWriter(made, head["groups"], head["periods"], head["attributes"]) as writer:
            for name, columns in head["groups"].items():
                row, path = _row(name, len(columns)), _path(log, name)
                left = path.stat().st_size // row.itemsize if rows is None else rows[name]
                with path.open("rb") as file:
                    while left > 0:
                        part = np.fromfile(file, row, min(left, CHUNK_ROWS))
                        if not len(part):
                            raise OSError(f"{path} is damaged: {left} rows less than there were")
                        writer.append(
                            name, part["time"], *(part["layers"][:, k] for k in range(row["layers"].shape[0]))
                        )
                        left -= len(part)
            writer.events(events)
            writer.limiters(limiters)
        sync_file(Path(made) / FILE_NAME)
        os.replace(Path(made) / FILE_NAME, folder / FILE_NAME)


def recover_results(folder: Path, log: Path, snapshot: Path) -> None:
    """Make `results.nc` of a run that was killed or still goes on, as far as its last snapshot.

    Parameters
    ----------
    folder, log : Path
        As of `make_results`.
    snapshot : Path
        The run's last.

    Raises
    ------
    InputErrors
        If there is none, or it is damaged.
    """
    about, _ = read(snapshot)
    make_results(folder, log, about["events"], about["limiters"], about["rows"])


def _path(folder: Path, group: str) -> Path:
    return folder / f"{group.replace('/', '-')}.rows"


def _row(group: str, columns: int) -> np.dtype:
    """A row of a group: every step of a window is recorded, so that it has no extremes and means."""
    layers = 1 if group.startswith("waveforms/") else len(LAYERS)
    return np.dtype([("time", "<f8"), ("layers", "<f4", (layers, columns))])
