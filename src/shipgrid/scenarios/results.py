"""A finished (or interrupted) run, as its output folder has it.

    run = open_results("results/mission-averaged")
    run["dc_for.v_dc"].sel(time=slice(170, 200)).plot()

Signals are read when they are used, never all at once.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shipgrid.analysis.requirements import Series, Verdict
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.names import nearest
from shipgrid.scenarios.conditions import Outcome
from shipgrid.scenarios.notebook import verdicts
from shipgrid.scenarios.output_folder import REPORT, RESULTS, SNAPSHOT, SUMMARY, UNFINISHED, place_of

if TYPE_CHECKING:
    import xarray

CITATION = re.compile(r"\[([A-Z][A-Za-z0-9.]*\d[A-Za-z0-9]*)\]")
"""A citation key in square brackets: starts with a capital, contains a digit."""
ALWAYS_CITED = "DAgostino2020"
"""The paper that describes the reference ship and its simulator."""
TABLES = ("events", "limiters")
ENDINGS = ("min", "max", "mean")
"""Of variables that say more of a signal: `<signal>_min` and so on."""


class Event(NamedTuple):
    """Something that happened: time [s], who reports it, and what."""

    time: float
    source: str
    text: str


AT_LIMIT = 0.01
"""Share of a run's time from which a limiter that acted is named after the run: what it holds runs at its limit."""


class Limiter(NamedTuple):
    """A limiter that acted.

    Attributes
    ----------
    signal : str
        Path of the output that is 1 while it acts.
    first_s, duration_s : float
        When it first acted, and for how long in total [s].
    times : int
        How many times it came on.
    share : float
        Share of the run's time, 0 to 1; not a number for a run without a length.
    meaning : str
        While what it acts, as the component declares it; empty if the run has no summary yet.
    """

    signal: str
    first_s: float
    duration_s: float
    times: int
    share: float
    meaning: str = ""

    @property
    def long(self) -> bool:
        """Whether it acted for at least `AT_LIMIT` of the time."""
        return self.share >= AT_LIMIT

    @classmethod
    def of(cls, row: tuple[str, float, float, int], length: float, meaning: str = "") -> Limiter:
        """A limiter from its row in the log.

        Parameters
        ----------
        row : (str, float, float, int)
            Signal, first time [s], duration [s], how many times.
        length : float
            Simulated time [s] of the run.
        meaning : str
            While what it acts.
        """
        return cls(*row, row[2] / length if length > 0.0 else math.nan, meaning)


class Results:
    """One run, read from its folder.

    Parameters
    ----------
    folder : Path or str
        Output folder of a run; nothing in it is changed. One that goes on, or was killed, has no `summary.json`; what
        it has recorded up to its last snapshot is then read from a file in the system's folder for temporary ones,
        which is removed with `close`, or when the process ends.
    file : Path, optional
        Its `results.nc`, where it is known to be complete although there is no `summary.json` yet.

    Attributes
    ----------
    folder : Path
        Where it lies.
    summary : dict
        Contents of `summary.json`, empty if there is none yet.

    Raises
    ------
    InputErrors
        If there are no results in the folder, or they cannot be read.
    """

    def __init__(self, folder: Path | str, file: Path | None = None):
        import netCDF4

        self.folder = Path(folder)
        self._remove_made: Callable[[], object] = lambda: None
        self._path = file or self._recorded()
        if not self._path.is_file():
            raise InputErrors([f"{self.folder}: no {RESULTS} here, expected the output folder of a run"])
        try:
            self._file = netCDF4.Dataset(self._path, "r")
        except OSError as error:
            raise InputErrors([f"{self._path}: cannot be read as NetCDF-4 ({error})"]) from error
        summary = self.folder / SUMMARY
        ended = self._path.parent == self.folder and summary.is_file()
        self.summary: dict[str, Any] = json.loads(summary.read_text()) if ended else {}
        self._where: dict[str, str] = {}
        self._windows: dict[str, list[str]] = {}  # groups of the waveform windows that have a signal
        self._endings: dict[str, set[str]] = {}
        for name, group in _groups(self._file):
            if name in TABLES or "time" not in group.dimensions:
                continue
            for variable in group.variables:
                base, _, ending = variable.rpartition("_")
                if ending in ENDINGS and base in group.variables:
                    self._endings.setdefault(base, set()).add(ending)
                elif variable != "time" and name.startswith("waveforms"):
                    self._windows.setdefault(variable, []).append(name)
                elif variable != "time":
                    self._where[variable] = name
        self._datasets: dict[str, xarray.Dataset] = {}

    def _recorded(self) -> Path:
        """The file with what the run has recorded: its own if it has ended, else one that is made of its rows."""
        log = self.folder / UNFINISHED
        if (self.folder / SUMMARY).is_file() or not (log / SNAPSHOT).is_file():
            return self.folder / RESULTS
        from shipgrid.scenarios.row_log import recover_results

        try:
            made = Path(tempfile.mkdtemp(prefix="shipgrid-results-"))
            self._remove_made = weakref.finalize(self, shutil.rmtree, made, ignore_errors=True)
            recover_results(log, made)
        except (InputErrors, OSError, RuntimeError) as wrong:
            self._remove_made()
            if (log / SNAPSHOT).is_file():
                problem = f"{self.folder}: what this run has recorded so far cannot be read ({wrong})"
                raise wrong if isinstance(wrong, InputErrors) else InputErrors([problem]) from wrong
            if self.folder.is_dir():  # it has ended in the meantime
                return self.folder / RESULTS
            problem = f"{self.folder}: the run has ended in the meantime, expected {place_of(self.folder)}"
            raise InputErrors([problem]) from wrong
        return made / RESULTS

    def __repr__(self) -> str:
        words = [f"{len(self.signals)} signals", f"{len(self.events)} events"]
        if self.requirements:
            violated = any(verdict.verdict == "violated" for verdict in self.requirements)
            words.append("a requirement is violated" if violated else "no requirement violated")
            unseen = sum(verdict.verdict == "not evaluated" for verdict in self.requirements)
            words += [f"{unseen} of {len(self.requirements)} not evaluated"] if unseen else []
        missing = [outcome.name for outcome in self.timeline if outcome.missing]
        words += [f"never or too seldom: {', '.join(missing)}"] if missing else []
        if not self.summary:
            words.append("not finished")
        elif self.summary.get("interrupted"):
            words.append(f"interrupted at {self.summary['simulated_s']:g} s")
        return f"<Results {self.name!r}: {', '.join(words)}>"

    def _repr_html_(self) -> str:
        return verdicts(repr(self)[1:-1], self.requirements)

    def _ipython_key_completions_(self) -> list[str]:
        return self.signals

    @property
    def name(self) -> str:
        """Scenario and fidelity, or the folder's name if the run has no summary yet."""
        if "scenario" in self.summary:
            return f"{self.summary['scenario']}-{self.summary.get('fidelity', 'averaged')}"
        return self.folder.name

    @property
    def signals(self) -> list[str]:
        """Names of all recorded signals, phase quantities of waveform windows too."""
        return sorted({*self._where, *self._windows})

    @property
    def windows(self) -> list[str]:
        """Groups of the waveform windows, for `group`: each has every step of its time."""
        return sorted({w for found in self._windows.values() for w in found}, key=lambda w: int(w.rpartition("/")[2]))

    def group(self, name: str) -> xarray.Dataset:
        """All signals of one sampling rate.

        Parameters
        ----------
        name : str
            `plant`, `slow`, `waveforms/...`.

        Returns
        -------
        xarray.Dataset
            Read from the file only where it is used.
        """
        import xarray

        if name not in self._datasets:
            self._datasets[name] = xarray.open_dataset(self._path, group=name, engine="netcdf4", decode_times=False)
        return self._datasets[name]

    def __getitem__(self, signal: str) -> xarray.DataArray:
        """One signal over time, with unit and description.

        `<signal>_min`, `<signal>_max` and `<signal>_mean` are extremes and mean of the interval before each instant.
        A phase quantity is that of all waveform windows, one after the other; a public signal at every step of a
        window is `run.group(run.windows[0])[signal]`.
        """
        base, _, ending = signal.rpartition("_")
        where = self._where.get(signal) or (self._where.get(base) if ending in self._endings.get(base, ()) else None)
        if where is None and signal in self._windows:
            import xarray

            parts = [self.group(window)[signal] for window in self._windows[signal]]
            return parts[0] if len(parts) == 1 else xarray.concat(parts, "time", combine_attrs="override")
        if where is None:
            raise ParameterError(f"no signal {signal!r} in {self.folder}{nearest(signal, self.signals)}")
        return self.group(where)[signal]

    def __contains__(self, signal: str) -> bool:
        return signal in self._where or signal in self._windows

    def series(self, name: str, within: tuple[float, float] | None = None) -> Series | None:
        """One signal as plain arrays with its extremes and means; None if it was not recorded.

        Parameters
        ----------
        name : str
            Its public name.
        within : (float, float), optional
            A time [s], from and to: a waveform window that has all of it is preferred.
        """
        windows = [self._file[window] for window in self._windows.get(name, ())]
        if within is not None or name not in self._where:
            covering = [w for w in windows if within is not None and _covers(w, within)]
            chosen = covering[:1] or ([] if name in self._where else windows)
            if chosen:
                time, value = (np.concatenate([np.asarray(w[v][:]) for w in chosen]) for v in ("time", name))
                return Series(time, value, None, None, chosen[0][name].units, None)
        if name not in self._where:
            return None
        group = self._file[self._where[name]]
        kept = self._endings.get(name, ())
        low, high, mean = (np.asarray(group[f"{name}_{e}"][:]) if e in kept else None for e in ENDINGS)
        return Series(np.asarray(group["time"][:]), np.asarray(group[name][:]), low, high, group[name].units, mean)

    def description(self, signal: str) -> str:
        """One sentence on what a signal is.

        Parameters
        ----------
        signal : str
            Its public name.
        """
        return self._file[self._where.get(signal) or self._windows[signal][0]][signal].long_name

    @cached_property
    def events(self) -> list[Event]:
        """What happened, in order of time."""
        return sorted((Event(*row) for row in self._rows("events", Event._fields)), key=lambda e: e.time)

    @cached_property
    def limiters(self) -> list[Limiter]:
        """Which limiters acted, when first, how long, how often and in what share of the time; the longest first."""
        meanings = {row["signal"]: row.get("meaning", "") for row in self.summary.get("limiters", ())}
        rows = self._rows("limiters", ("signal", "first_s", "duration_s", "count"))
        found = [Limiter.of(row, self._length, meanings.get(row[0], "")) for row in rows]
        return sorted(found, key=lambda limiter: -limiter.duration_s)

    @property
    def at_limit(self) -> list[Limiter]:
        """Limiters that acted for at least `AT_LIMIT` of the time, the longest first."""
        return [limiter for limiter in self.limiters if limiter.long]

    @property
    def _length(self) -> float:
        """Simulated time [s]: the summary's, or that of the last row while there is none."""
        if "simulated_s" in self.summary:
            return float(self.summary["simulated_s"])
        groups = [self._file[name] for name in set(self._where.values())]
        return max((float(group["time"][-1]) for group in groups if len(group["time"])), default=0.0)

    def _rows(self, table: str, columns: Iterable[str]) -> list[tuple]:
        if table not in self._file.groups:
            return []
        group = self._file[table]
        return list(zip(*(np.asarray(group[column][:]).tolist() for column in columns), strict=True))

    @cached_property
    def requirements(self) -> list[Verdict]:
        """What was asked, and what became of it."""
        return self._verdicts("requirements")

    @cached_property
    def class_limits(self) -> list[Verdict]:
        """Limits of class societies and standards that concern this run, and what became of them."""
        return self._verdicts("class_limits")

    def _verdicts(self, key: str) -> list[Verdict]:
        known = Verdict.__dataclass_fields__
        rows = self.summary.get(key, [])
        return [Verdict(**{field: row.get(field, known[field].default) for field in known}) for row in rows]

    @cached_property
    def timeline(self) -> list[Outcome]:
        """What became of the entries of the time-line that waited for a condition."""
        return [Outcome(**row) for row in self.summary.get("timeline", [])]

    @property
    def ok(self) -> bool:
        """Whether no requirement was violated, and what the time-line waited for happened.

        A requirement whose window the run did not reach is not violated; nor is anything missing before the scenario's
        end.
        """
        violated = any(verdict.verdict == "violated" for verdict in self.requirements)
        return not violated and not any(outcome.missing for outcome in self.timeline)

    @cached_property
    def attributes(self) -> dict[str, Any]:
        """Provenance and whatever else the runner wrote for the whole file."""
        return {name: self._file.getncattr(name) for name in self._file.ncattrs()}

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """Contents of `run.yaml`, with the ship and the scenario file in it read too; empty if there is none yet."""
        path = self.folder / "run.yaml"
        if not path.is_file():
            return {}
        from ruamel.yaml import YAML

        yaml = YAML(typ="safe", pure=True)
        settings = yaml.load(path.read_text(encoding="utf-8")) or {}
        # Ship and scenario stand there as the text of their files.
        return {key: yaml.load(value) if key in ("ship", "scenario") else value for key, value in settings.items()}

    def report(self, path: Path | str | None = None) -> Path:
        """Write the report, one self-contained HTML file.

        Parameters
        ----------
        path : Path or str, optional
            Where to; `report.html` in the run's folder if not given, the only thing that is ever written there.

        Returns
        -------
        Path
            Where it is.
        """
        from shipgrid.io.report import write_report

        return write_report(self, path or self.folder / REPORT)

    def cite(self) -> str:
        """BibTeX entries of the components and methods this run used."""
        keys = [ALWAYS_CITED, *str(self.attributes.get("references", "")).split()]
        return bibliography(dict.fromkeys(keys))

    def close(self) -> None:
        """Close the file; signals not read yet are no longer available."""
        for dataset in self._datasets.values():
            dataset.close()
        if self._file.isopen():
            self._file.close()
        self._remove_made()

    def __enter__(self) -> Results:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def open_results(folder: Path | str) -> Results:
    """Open the output folder of a run.

    Parameters
    ----------
    folder : Path or str
        Where its `results.nc` lies; nothing in it is changed. Also the hidden folder of a run under way, or of one
        that was killed: what was recorded up to its last snapshot.

    Raises
    ------
    InputErrors
        If there are no readable results.
    """
    return Results(folder)


def citation_keys(modules: Iterable[str]) -> list[str]:
    """Keys cited in the docstrings of modules, for the file attribute `references`.

    Parameters
    ----------
    modules : iterable of str
        Full names of the modules of the components and methods a run uses.
    """
    texts = (importlib.import_module(name).__doc__ or "" for name in modules)
    return sorted({key for text in texts for key in CITATION.findall(text)})


def bibliography(keys: Iterable[str]) -> str:
    """BibTeX entries of citation keys.

    Parameters
    ----------
    keys : iterable of str
        Keys of `references.bib`.

    Raises
    ------
    ParameterError
        If a key is not there.
    """
    text = files("shipgrid.data").joinpath("references.bib").read_text(encoding="utf-8")
    entries = {m[1]: m[0].strip() for m in re.finditer(r"^@\w+\{([^,]+),.*?^\}", text, re.MULTILINE | re.DOTALL)}
    keys = list(keys)
    missing = [key for key in keys if key not in entries]
    if missing:
        raise ParameterError(f"references.bib has no {missing}")
    return "\n\n".join(entries[key] for key in keys)


def _groups(dataset: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    """All groups of a file with their full names, nested ones too."""
    for name, group in dataset.groups.items():
        full = f"{path}/{name}" if path else name
        yield full, group
        yield from _groups(group, full)


def _covers(window: Any, within: tuple[float, float]) -> bool:
    """Whether a group has all of a time, but for what no step ends at."""
    time = window["time"]
    if len(time) < 2:
        return False
    step = float(time[1] - time[0])
    return bool(time[0] - step < within[0] and within[1] < time[-1] + step)
