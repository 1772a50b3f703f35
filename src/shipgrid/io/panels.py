"""What a report plots: which signals share a panel, reduced to what a screen can show, and the band of events.

Reduction is MinMaxLTTB [VanDerDonckt2023]: of each interval it keeps extremes, then the points that shape the curve.
All signals of a panel are shown at the union of the instants kept for each, by their means over the recording intervals
where the recorder kept them. Extremes (those the recorder kept, or else the values themselves) are gathered over the
rows between two of these instants, so that no peak is lost.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from tsdownsample import MinMaxLTTBDownsampler, NaNMinMaxLTTBDownsampler

from shipgrid.analysis.requirements import Series
from shipgrid.scenarios.results import Event, Results
from shipgrid.units import KNOT

POINTS = 1500
"""About as many instants a panel shows."""
VISIBLE = 2e-3
"""An envelope narrower than this part of the panel's height is not drawn."""


@dataclass(frozen=True)
class Panel:
    """One plot: title, unit shown, kind of equipment or bus, symbol, and what its SI value is multiplied by."""

    title: str
    unit: str
    kind: str
    symbol: str
    factor: float = 1.0
    least: float = 0.0
    """Least height of the axis: what would fill it is not worth more."""
    none: float | None = None
    """A value that means there is none: the frequency of a dead bar."""
    band: bool = True
    """Whether extremes are drawn: one late step of a second would hide the others."""


@dataclass(frozen=True)
class Command:
    """How a command's value is shown: what its row is called, unit, and what its SI value is multiplied by."""

    word: str
    unit: str
    factor: float = 1.0

    def say(self, text: str) -> str:
        """The value of an event's `text` with the unit people use; other text as it is."""
        given = GIVEN.match(text)
        return f"{round(float(given[1]) * self.factor, 3) + 0.0:.3g} {self.unit}" if given else text


PANELS = (
    Panel("Ship speed", "kn", "hull", "u_ship", 1.0 / KNOT),
    Panel("DC bus voltage", "V", "dc", "v_dc"),
    Panel("Battery current, discharging positive", "A", "bess", "i_b"),
    Panel("State of charge", "%", "bess", "soc", 100.0),
    Panel("Genset power at the terminals", "kW", "genset", "p_ac", 1e-3),
    Panel("Genset speed", "pu", "genset", "omega_pu"),
    Panel("Genset voltage", "pu", "genset", "v_pu"),
    Panel("Propulsion power", "kW", "propulsion", "p_dc", 1e-3),
    Panel("Propeller thrust", "kN", "propeller", "thrust", 1e-3),
    Panel("Voltage of the AC bars", "pu", "ac", "v_pu", least=0.1),
    Panel("Frequency of the AC bars", "Hz", "ac", "f", least=1.0, none=0.0),
    Panel("Time of a step, mean of each second", "µs", "realtime.core", "(computation|idle)", 1e6, band=False),
    Panel("Overruns so far", "", "realtime.core_1", "overruns", least=1.0, band=False),
)
STATES = (
    ("dc_tie", "closed", {1: "closed"}),
    ("ac_tie", "closed", {1: "closed"}),
    ("genset", "on", {1: "on"}),
    ("bess", "mode", {1: "droop", 2: "voltage", 3: "current"}),
    ("inverter", "on", {1: "on"}),
)
"""Signals that are drawn as bars above the plots: kind, symbol, and the word for each value."""
COMMANDS = {
    ("propulsion", "speed_ref"): Command("speed", "kn", 1.0 / KNOT),
    ("bess", "i_ref"): Command("current", "A"),
    ("bess", "v_dc_ref"): Command("voltage", "V"),
    ("rectifier", "v_dc_ref"): Command("voltage", "V"),
}
"""Commands whose values are drawn as bars, from one event of that source to the next."""
GIVEN = re.compile(r"set to ([-+.\deE]+)(?: (?!by )\S+?)?(?:,? by .*)?$")
"""Text of an event that gives a command a value in SI, whoever gave it."""
CUT = "cut back"
CUT_BACK = re.compile(r"(\w+) (?:cut back for (\w+)|free again)$")
"""Text of an event of blackout prevention: the drive, and the source for which it is cut back."""


def panels_of(run: Results) -> list[dict[str, Any]]:
    """Plots of a run, as plain data for the page.

    Parameters
    ----------
    run : Results
        What was recorded; a panel with nothing recorded, or nothing but zeros, is left out.

    Returns
    -------
    list of dict
        `title`, `unit`, `time`, `signals` [{`name`, `values`, `low`, `high`}], `limits` [{`level`, `start`, `end`}].
    """
    made = [_panel(panel, run, names) for panel in PANELS if (names := signals_of(run, panel.kind, panel.symbol))]
    return [panel for panel in made if panel["time"]]


def signals_of(run: Results, kind: str, symbol: str) -> list[str]:
    """Recorded signals `<item>.<symbol>` of the items of a kind: `genset` has `genset`, `genset_for` ..., fore first.

    Parameters
    ----------
    run : Results
        What was recorded.
    kind, symbol : str
        Beginning of the item's name, and the signal's name after the dot, a regular expression.
    """
    pattern = re.compile(rf"{re.escape(kind)}(_\w+)?\.{symbol}")
    found = [name for name in run.signals if pattern.fullmatch(name)]
    return sorted(found, key=lambda name: ("_for." not in name, name))


def _panel(panel: Panel, run: Results, names: Sequence[str]) -> dict[str, Any]:
    series = [s for name in names if (s := run.series(name)) is not None and len(s.time)]
    if panel.none is not None:
        series = [_without(s, panel.none) for s in series]
    if not any(np.any(np.abs(s.value) > 0.0) for s in series):
        series, names = [], []
    series = [_of_means(s) for s in series]
    kept = [_reduced(s, max(POINTS // len(series), 100)) for s in series]
    time = np.unique(np.concatenate([s.time[k] for s, k in zip(series, kept, strict=True)])) if series else np.empty(0)
    curves = [_at(s, time) for s in series]
    finite = [value[np.isfinite(value)] for value, _, _ in curves]
    span = float(np.ptp(np.concatenate(finite))) if any(map(len, finite)) else 0.0
    signals = []
    for name, (value, low, high) in zip(names, curves, strict=True):
        signal: dict[str, Any] = {"name": name, "values": _numbers(value * panel.factor)}
        if panel.band and np.any(high > low + VISIBLE * span):
            signal["low"], signal["high"] = _numbers(low * panel.factor), _numbers(high * panel.factor)
        signals.append(signal)
    return {
        "title": panel.title,
        "unit": panel.unit,
        "least": panel.least,
        "time": [round(float(t), 6) for t in time],
        "rows": max((len(s.time) for s in series), default=0),
        "signals": signals,
        "limits": _limits(run, names, panel.factor),
    }


def _of_means(series: Series) -> Series:
    """The same signal with its means over the recording intervals as values: a ripple would be sampled at random."""
    if series.mean is None or series.low is None or series.high is None:
        return series
    return series._replace(value=np.where(np.isnan(series.value), np.nan, series.mean))


def _without(series: Series, none: float) -> Series:
    """The same signal with no value where it is `none`, or was so in the interval before."""
    gone = series.value == none
    if series.low is None or series.high is None:
        return series._replace(value=np.where(gone, np.nan, series.value))
    gone |= series.low == none
    value, low, high = (np.where(gone, np.nan, x) for x in (series.value, series.low, series.high))
    return series._replace(value=value, low=low, high=high)


def _reduced(series: Series, points: int) -> np.ndarray:
    """Rows to keep of one signal."""
    n = len(series.time)
    if n <= points:
        return np.arange(n)
    value = np.ascontiguousarray(series.value)
    sampler = NaNMinMaxLTTBDownsampler() if np.isnan(value).any() else MinMaxLTTBDownsampler()
    return sampler.downsample(np.ascontiguousarray(series.time), value, n_out=points).astype(int)


def _at(series: Series, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values at some instants, and extremes over the rows that end there; NaN where the signal has no row."""
    rows = np.clip(np.searchsorted(series.time, time), 0, len(series.time) - 1)
    there = series.time[rows] == time
    value = np.where(there, series.value[rows], np.nan)
    # Of the rows (previous kept, this kept]: `reduceat` takes from each start up to the next start.
    mine = rows[there]
    starts = np.concatenate([[0], mine[:-1] + 1])
    low, high = (np.full(len(time), np.nan) for _ in range(2))
    lows = series.value if series.low is None else series.low
    highs = series.value if series.high is None else series.high
    low[there] = np.fmin.reduceat(lows[: mine[-1] + 1], starts)
    high[there] = np.fmax.reduceat(highs[: mine[-1] + 1], starts)
    return value, low, high


def _numbers(values: np.ndarray) -> list[float | None]:
    """Five significant digits; None where there is no value."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]


def _limits(run: Results, names: Sequence[str], factor: float) -> list[dict[str, float | None]]:
    """Limits of the run's requirements on these signals, to be drawn as lines; each once."""
    rows = {
        (level * factor, v.window[0], v.window[1])
        for v in run.requirements
        if v.signal in names and v.measure in ("band", "band_of_means", "min", "max") and v.limit and v.window
        for level in v.limit
        if level is not None
    }
    return [{"level": level, "start": start, "end": end} for level, start, end in sorted(rows, key=str)]


def bars_of(run: Results, end: float) -> list[dict[str, Any]]:
    """Rows of bars above the plots: values of commands, states of equipment.

    Parameters
    ----------
    run : Results
        What was recorded.
    end : float
        End of the run [s].

    Returns
    -------
    list of dict
        `label`, `title`, and `bars` [[start, end, word]]; items that do the same share a row.
    """
    rows: dict[tuple, list[str]] = {}
    alike: dict[tuple[str, str], int] = {}

    def add(source: str, bars: list[tuple[float, float, str]]) -> None:
        kind = _kind(source)
        alike[kind] = alike.get(kind, 0) + 1
        rows.setdefault((*kind, tuple(bars)), []).append(source)

    for source, bars in _command_bars(run.events, end).items():
        add(source, bars)
    for drive, bars in _cut_back(run.events, end).items():
        add(f"{drive}.{CUT}", bars)
    for kind, symbol, words in STATES:
        for name in signals_of(run, kind, symbol):
            series = run.series(name)
            if series is not None and len(series.time):
                add(name, _state_bars(series, words))
    return [
        {
            "label": _label(names, stem, symbol, whole=len(names) == alike[stem, symbol] > 1),
            "title": ", ".join(names),
            "bars": list(bars),
        }
        for (stem, symbol, bars), names in rows.items()
        if bars
    ]


def _command_bars(events: Iterable[Event], end: float) -> Mapping[str, list[tuple[float, float, str]]]:
    """From each value of a command to its next one, in the order of `COMMANDS`."""
    given: dict[str, list[tuple[float, str]]] = {}
    for event in events:
        command = COMMANDS.get(_kind(event.source))
        if command is not None:
            given.setdefault(event.source, []).append((event.time, command.say(event.text)))
    order = list(COMMANDS)
    sources = sorted(given, key=lambda source: (order.index(_kind(source)), "_for." not in source, source))
    return {
        source: [(a[0], b[0], a[1]) for a, b in pairwise([*given[source], (end, "")]) if b[0] > a[0]]
        for source in sources
    }


def _cut_back(events: Iterable[Event], end: float) -> Mapping[str, list[tuple[float, float, str]]]:
    """For each drive, while it is cut back, the source for which."""
    given: dict[str, list[tuple[float, str]]] = {}
    for event in events:
        said = CUT_BACK.match(event.text)
        if said:
            given.setdefault(said[1], []).append((event.time, f"for {said[2]}" if said[2] else ""))
    return {
        drive: [(a[0], b[0], a[1]) for a, b in pairwise([*rows, (end, "")]) if a[1] and b[0] > a[0]]
        for drive, rows in given.items()
    }


def _kind(source: str) -> tuple[str, str]:
    """`bess`, `i_ref` of `bess_for.i_ref`."""
    item, _, symbol = source.partition(".")
    return _stem(item), symbol


def _state_bars(series: Series, words: Mapping[int, str]) -> list[tuple[float, float, str]]:
    """Intervals in which a code stands still at a value that has a word."""
    code = np.where(np.isfinite(series.value), np.rint(series.value), -1.0).astype(int)  # -1 has no word
    edges = np.flatnonzero(np.diff(code)) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(code) - 1]])
    return [
        (float(series.time[a]), float(series.time[b]), words[int(code[a])])
        for a, b in zip(starts, ends, strict=True)
        if int(code[a]) in words
    ]


def _stem(item: str) -> str:
    """`bess` of `bess_for`."""
    return item.rpartition("_")[0] or item


def _label(names: Sequence[str], stem: str, symbol: str, whole: bool) -> str:
    """Name of a row: the kind if all its items share the row, else the item; and the command's word."""
    item = stem if whole else names[0].partition(".")[0]
    command = COMMANDS.get((stem, symbol))
    word = command.word if command is not None else symbol if symbol in ("mode", CUT) else ""
    return f"{item} {word}".rstrip()
