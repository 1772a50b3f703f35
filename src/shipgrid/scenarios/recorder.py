"""The results of a run as a NetCDF-4 file.

One group per sampling rate (`plant`, `slow`, `waveforms/...`) with its unlimited `time`; one variable per signal, named
`<equipment>.<symbol>`, with `units` and `long_name`; where a recorder thins a signal out, `<name>_min`, `<name>_max`
and `<name>_mean` hold the extremes and the mean of all steps over the interval that ends at each `time`. The group
`events` is the event log, the group `limiters` the log of active limiters.

Values are stored in single precision (7 digits), time in double. Rows are written in blocks of one HDF5 chunk, so that
memory stays small. A process killed while the library writes leaves no file that can be read; so the rows of a run
under way are kept by `row_log.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import netCDF4
import numpy as np

from shipgrid.scenarios.output_folder import RESULTS

CHUNK_ROWS = 8192
"""Rows of one block: 32 kB a variable. A write costs about 0.7 ms whatever its length, so that short blocks are slow;
100 signals with their extremes and means wait in 13 MB."""

LAYERS = (
    ("", "{}"),
    ("_min", "{}, smallest since the last row"),
    ("_max", "{}, largest since the last row"),
    ("_mean", "{}, mean since the last row"),
)
"""What may be kept of a signal: the ending of the variable's name, and its description."""

Column = tuple[str, str, str] | tuple[str, str, str, Mapping[str, str | float]]
"""Name, unit and description of a signal, and further attributes of its variable."""


class Group:
    """The variables of one sampling rate, and the rows that wait to be written."""

    def __init__(self, group: netCDF4.Dataset, columns: Sequence[Column], period: float | None):
        group.createDimension("time", None)
        self.time = group.createVariable("time", "f8", ("time",), zlib=True, complevel=1, chunksizes=(CHUNK_ROWS,))
        self.time.units, self.time.long_name = "s", "time since the start of the scenario"
        if period is not None:
            group.period_s = period
        self.group, self.columns = group, [column[:3] for column in columns]
        self.attributes = [dict(column[3]) if len(column) > 3 else {} for column in columns]
        self.layers: list[list[netCDF4.Variable]] = []
        self._add_layers(1)
        self.rows = 0
        self.waiting = 0
        self.buffer: np.ndarray | None = None
        self.stamps = np.empty(CHUNK_ROWS)

    def _variable(self, name: str, unit: str, text: str) -> netCDF4.Variable:
        variable = self.group.createVariable(
            name, "f4", ("time",), zlib=True, complevel=1, shuffle=True, chunksizes=(CHUNK_ROWS,)
        )
        variable.set_var_chunk_cache(size=2 * 4 * CHUNK_ROWS)  # the library's own keeps megabytes of each variable
        variable.units, variable.long_name = unit, text
        return variable

    def _add_layers(self, count: int) -> None:
        """Make the variables of the first `count` of `LAYERS` that are not there yet."""
        for ending, says in LAYERS[len(self.layers) : count]:
            self.layers.append([self._variable(n + ending, u, says.format(text)) for n, u, text in self.columns])
        for variable, attributes in zip(self.layers[0], self.attributes, strict=True):
            variable.setncatts(attributes)

    def append(self, time: np.ndarray, layers: Sequence[np.ndarray]) -> None:
        """Add rows: `time[n]`, and the first of `LAYERS`, each `[n, columns]`; as many as at the first time."""
        if self.buffer is None:
            self._add_layers(len(layers))
            self.buffer = np.empty((len(layers), CHUNK_ROWS, len(self.columns)), np.float32)
        if len(layers) != len(self.buffer):
            raise ValueError("extremes and means are recorded for all rows of a group, or for none")
        done = 0
        while done < len(time):
            n = min(len(time) - done, CHUNK_ROWS - self.waiting)
            place = slice(self.waiting, self.waiting + n)
            self.stamps[place] = time[done : done + n]
            for layer, rows in zip(self.buffer, layers, strict=True):
                layer[place] = rows[done : done + n]
            self.waiting += n
            done += n
            if self.waiting == CHUNK_ROWS:
                self.write()

    def write(self) -> None:
        """Put the waiting rows into the file."""
        if not self.waiting or self.buffer is None:
            return
        rows = slice(self.rows, self.rows + self.waiting)
        for layer, variables in zip(self.buffer, self.layers, strict=True):
            columns = np.ascontiguousarray(layer[: self.waiting].T)
            for variable, column in zip(variables, columns, strict=True):
                variable[rows] = column
        self.time[rows] = self.stamps[: self.waiting]
        self.rows += self.waiting
        self.waiting = 0


class ResultsWriter:
    """Write `results.nc`.

    Parameters
    ----------
    folder : Path or str
        Where `results.nc` is made; it must exist.
    groups : mapping of str to sequence of (name, unit, description)
        Signals of each group. A name with `/` makes nested groups.
    periods : mapping of str to float
        Sampling period of a group [s], where it has a constant one.
    attributes : mapping of str to str, float or int
        Provenance and whatever else belongs to the whole file.

    Raises
    ------
    OSError
        If the file cannot be made, or the disk is full.
    """

    def __init__(
        self,
        folder: Path | str,
        groups: Mapping[str, Sequence[Column]],
        periods: Mapping[str, float] | None = None,
        attributes: Mapping[str, Any] | None = None,
    ):
        self.path = Path(folder) / RESULTS
        self.file = netCDF4.Dataset(self.path, "w", format="NETCDF4")
        self.file.setncatts({"Conventions": "CF-1.11", **(attributes or {})})
        periods = periods or {}
        self.groups = {
            name: Group(self.file.createGroup(name), columns, periods.get(name)) for name, columns in groups.items()
        }
        self._events: list[tuple[float, str, str]] = []
        self._limiters: list[tuple[str, float, float, int]] = []

    def _table(self, name: str, columns: Mapping[str, str], rows: Sequence[tuple[Any, ...]]) -> None:
        """A group of one variable a column; texts in fixed width, since HDF5 fails on others of a file opened twice."""
        group = self.file.createGroup(name)
        group.createDimension("row", len(rows))
        for k, (column, kind) in enumerate(columns.items()):
            values = [row[k] for row in rows]
            if kind == "text":
                texts = np.array([text.encode() for text in values], "S")
                width = max(1, texts.itemsize)
                group.createDimension(f"{column}_length", width)
                variable = group.createVariable(column, "S1", ("row", f"{column}_length"))
                variable.set_auto_chartostring(False)
                variable[:] = texts.astype(f"S{width}").view("S1").reshape(len(rows), width)
                variable.setncattr("_Encoding", "utf-8")
            else:
                variable = group.createVariable(column, kind, ("row",))
                variable[:] = values
                if kind == "f8":
                    variable.units = "s"

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
        mean: np.ndarray | None = None,
    ) -> None:
        """Add rows to a group.

        Parameters
        ----------
        group : str
            Name of the group.
        time : ndarray, shape (n,)
            Instants of the rows [s], increasing.
        value : ndarray, shape (n, m)
            Values at these instants, SI, in the order of the group's signals.
        low, high : ndarray, shape (n, m), optional
            Extremes over the interval that ends at each instant; in every call of a group, or in none.
        mean : ndarray, shape (n, m), optional
            Means over that interval, with the extremes; in every call of a group, or in none.

        Raises
        ------
        ValueError
            If shapes disagree.
        OSError
            If the disk is full.
        """
        layers = [value] if low is None or high is None else [value, low, high]
        layers += [] if mean is None or len(layers) == 1 else [mean]
        shape = (len(time), len(self.groups[group].columns))
        if any(layer.shape != shape for layer in layers):
            raise ValueError(f"group {group!r} expects arrays of shape {shape}, got {[a.shape for a in layers]}")
        self.groups[group].append(time, layers)

    def events(self, rows: Iterable[tuple[float, str, str]]) -> None:
        """Add to the event log: time [s], source (equipment or command), text."""
        self._events += rows

    def limiters(self, rows: Iterable[tuple[str, float, float, int]]) -> None:
        """Add to the log of active limiters: signal, first time active [s], total duration [s], how often."""
        self._limiters += rows

    def close(self) -> None:
        """Write what waits, and close the file; a second call does nothing."""
        if not self.file.isopen():
            return
        try:
            for group in self.groups.values():
                group.write()
            self._table("events", {"time": "f8", "source": "text", "text": "text"}, self._events)
            limiters = {"signal": "text", "first_s": "f8", "duration_s": "f8", "count": "i8"}
            self._table("limiters", limiters, self._limiters)
        finally:
            self.file.close()

    def __enter__(self) -> ResultsWriter:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
