"""Requirements on a run: was what was asked for met, by what margin, and when was it first missed?

A requirement names a signal, a window of time and one measure of the signal in it:

    band     every value inside [low, high]
    min      no value below
    max      no value above
    abs_max  no magnitude above
    mean     the time average inside [low, high]
    spread   the greatest less the smallest value, not above: neither drifts nor swings

and three on the means over the recording intervals, in which a ripple of the converters has fallen out:

    band_of_means  every mean inside [low, high]
    drift          the rise of the straight line through the means over the window, not above: the slope test
    swing          the greatest less the smallest distance of a mean from that line, not above: a sustained oscillation

It may be on the difference of two signals (`minus`). The first four may be softened by one rule in time:

    recovery    the signal may be outside, but for no longer than this at a stretch
    settles     it may be outside, but not later than this after the window's start

which then has the longest time outside, or the last time at which the signal was, as its value. In place of a signal
a requirement may name a figure of the whole run (`FIGURES`), which then has one value, at the end.

Where a recorder kept extremes between two values, they count, so that a peak between samples is not missed: a time
outside is then that of all recorded intervals with a value outside, never shorter than it was and up to two intervals
longer. Where it kept means, they are what is averaged, so that a ripple between samples falls out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from shipgrid.errors import ParameterError

MEASURES = ("band", "min", "max", "abs_max", "mean", "spread", "band_of_means", "drift", "swing")
PAIRS = ("band", "mean", "band_of_means")
"""Measures with two limits."""
RULES = ("recovery", "settles")
"""Rules in time that may soften a measure of single values."""
SOFTENED = ("band", "min", "max", "abs_max")
OF_MEANS = ("band_of_means", "drift", "swing")
UP_TO = ("abs_max", "spread", "drift", "swing")
"""Measures of a size, which has an upper limit only."""
FIGURES = {"energy_balance_error": "1"}
"""Figures of the whole run that can be required something of, with their units; as in `summary.json`."""


class Series(NamedTuple):
    """A recorded signal.

    Attributes
    ----------
    time, value : ndarray, shape (n,)
        Instants [s] and values.
    low, high : ndarray, shape (n,), or None
        Extremes over the interval that ends at each instant.
    unit : str
        Unit of the values.
    mean : ndarray, shape (n,), or None
        Means over the interval that ends at each instant.
    """

    time: np.ndarray
    value: np.ndarray
    low: np.ndarray | None
    high: np.ndarray | None
    unit: str
    mean: np.ndarray | None = None


class Recorded(Protocol):
    """Named series, as a run recorded them."""

    @property
    def signals(self) -> list[str]:
        """Names of the recorded signals."""
        ...

    def series(self, name: str) -> Series | None:
        """Signal `name`, or None if it was not recorded."""
        ...


@dataclass(frozen=True)
class Requirement:
    """One requirement, in SI.

    Attributes
    ----------
    name, signal : str
        What a person calls it; the public signal.
    measure : str
        One of `MEASURES`.
    low, high : float
        Limits; infinite where the measure has only one.
    start, end : float
        Window [s], both ends included.
    minus : str
        A signal to be subtracted, or nothing.
    rule : str
        One of `RULES`, or nothing.
    allowed : float
        Time that the rule allows [s].
    source : str
        Where the requirement comes from, in a few words; nothing where nobody says so.
    """

    name: str
    signal: str
    measure: str
    low: float = -math.inf
    high: float = math.inf
    start: float = 0.0
    end: float = math.inf
    minus: str = ""
    rule: str = ""
    allowed: float = 0.0
    source: str = ""

    @classmethod
    def from_mapping(cls, entry: Mapping[str, Any]) -> Requirement:
        """Make one from a scenario file's entry whose quantities are numbers in SI already.

        Parameters
        ----------
        entry : mapping
            `name`, `signal`, one of `MEASURES` (those of `PAIRS`: a pair), and perhaps `minus`, one of `RULES` [s],
            `from` and `until` [s], `source`.

        Raises
        ------
        ParameterError
            If it has not exactly one measure, its limits or window are empty, or it has a rule that does not go with
            its measure.
        """
        label = f"requirement {entry.get('name', '?')!r}"
        measures = [m for m in MEASURES if m in entry]
        if len(measures) != 1:
            raise ParameterError(f"{label} has {measures or 'no measure'}, expected exactly one of {list(MEASURES)}")
        measure = measures[0]
        limit = entry[measure]
        low, high = {
            "min": lambda: (limit, math.inf),
            "max": lambda: (-math.inf, limit),
            **{size: lambda: (0.0, limit) for size in UP_TO},
        }.get(measure, lambda: tuple(limit))()
        start, end = entry.get("from", 0.0), entry.get("until", math.inf)
        if not low <= high:
            raise ParameterError(f"{label}: {measure} = {limit} is empty, expected the lower limit first")
        if not start < end:
            raise ParameterError(f"{label}: its window {start} s .. {end} s is empty")
        rules = [rule for rule in RULES if rule in entry]
        if len(rules) > 1 or (rules and measure not in SOFTENED):
            raise ParameterError(f"{label} has {measure} with {rules}, expected one rule, with one of {list(SOFTENED)}")
        rule = rules[0] if rules else ""
        limits_and_window = float(low), float(high), float(start), float(end)
        minus, source = entry.get("minus", ""), entry.get("source", "")
        allowed = float(entry.get(rule, 0.0))
        return cls(entry["name"], entry["signal"], measure, *limits_and_window, minus, rule, allowed, source)

    @property
    def limits(self) -> list[float | None]:
        """Lower and upper limit; None where there is none."""
        low = None if self.measure in UP_TO else self.low
        return [x if x is not None and math.isfinite(x) else None for x in (low, self.high)]

    @property
    def subject(self) -> str:
        """What it is on, in words: the signal, or the difference of two."""
        return f"{self.signal} - {self.minus}" if self.minus else self.signal


@dataclass(frozen=True)
class Verdict:
    """What became of a requirement.

    Attributes
    ----------
    name, signal, measure, unit : str
        Of the requirement, and the unit of value, limit and margin: that of the signal, or seconds with a rule in time.
    limit : list of float or None
        Lower and upper limit; with a rule in time, of the time.
    window : list of float or None
        Start and end [s].
    value : float or None
        The value that decides: the one nearest to its limit, or furthest beyond it.
    margin : float or None
        Distance of `value` to its limit, in the signal's unit; negative if violated.
    at, first_violation : float or None
        When `value` occurred, and when the limit was first passed [s]; None for a mean.
    verdict : str
        `met`, `violated`, or `not evaluated` where the run did not reach the window or has no such signal.
    rule : str
        `recovery`, `settles`, or nothing.
    inside : list of float or None, or None
        With a rule in time: the limits of the signal itself.
    inside_unit : str
        Their unit.
    source : str
        Where the requirement comes from; nothing where nobody says so.
    """

    name: str
    signal: str
    measure: str
    unit: str
    limit: list[float | None]
    window: list[float | None]
    value: float | None
    margin: float | None
    at: float | None
    first_violation: float | None
    verdict: str
    rule: str = ""
    inside: list[float | None] | None = None
    inside_unit: str = ""
    source: str = ""

    @property
    def ok(self) -> bool:
        """Whether the requirement was met."""
        return self.verdict == "met"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `summary.json`; JSON has no infinity, so a value that is not finite becomes None."""
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(self).items()}


def judge(requirement: Requirement, series: Series | None, counts: np.ndarray | None = None) -> Verdict:
    """Judge one requirement.

    Parameters
    ----------
    requirement : Requirement
        What is asked, SI.
    series : Series or None
        Its signal as recorded, less what it says to subtract; None if it was not.
    counts : ndarray of bool, shape (n,), optional
        Instants of the series that count, each with the interval before it; all if left out. Not for a mean.

    Returns
    -------
    Verdict
        With value, margin and times. A value that is not a number violates any requirement. A window that the run
        reached only in part is judged only if it is violated already; else it is `not evaluated`.
    """
    r = requirement
    window = [r.start, r.end if math.isfinite(r.end) else None]
    unit = "" if series is None else series.unit
    limits, in_time = r.limits, {}
    if r.rule:
        in_time = {"rule": r.rule, "inside": limits, "inside_unit": unit}
        limits, unit = [None, r.allowed], "s" if unit else ""

    def verdict(word: str, value: float | None = None, margin: float | None = None, *when: float | None) -> Verdict:
        at, first = when or (None, None)
        judged = value, margin, at, first, word
        return Verdict(r.name, r.subject, r.measure, unit, limits, window, *judged, source=r.source, **in_time)

    if series is None:
        return verdict("not evaluated")
    if r.measure in OF_MEANS and series.mean is not None:
        series = series._replace(value=series.mean, low=series.mean, high=series.mean)
        whole = np.concatenate([[False], series.time[:-1] >= r.start])
        counts = whole if counts is None else counts & whole
    time, low, high, begins = _window(series, r.start, r.end, counts)
    if len(time) == 0:
        return verdict("not evaluated")
    # The last row of a complete window may lie up to one sampling interval before its end.
    tolerance = float(series.time[-1] - series.time[-2]) if len(series.time) > 1 else 0.0
    complete = not math.isfinite(r.end) or bool(series.time[-1] >= r.end - tolerance)

    if r.measure == "mean":
        mean = _time_average(series, r.start, r.end)
        margin = min(mean - r.low, r.high - mean)
        if not complete:
            return verdict("not evaluated", mean, margin)
        return verdict("met" if margin >= 0.0 else "violated", mean, margin)

    if r.measure in ("drift", "swing"):
        value = _along_a_line(time, high)[("drift", "swing").index(r.measure)]
        margin = r.high - value
        if not complete and margin >= 0.0:
            return verdict("not evaluated", value, margin)
        return verdict("met" if margin >= 0.0 else "violated", value, margin)

    if r.measure == "abs_max":
        high = np.maximum(np.abs(low), np.abs(high))
        below, above = np.full(len(high), np.inf), r.high - high
    elif r.measure == "spread":
        spread = np.maximum.accumulate(high) - np.minimum.accumulate(low)
        high, below, above = spread, np.full(len(high), np.inf), r.high - spread
    else:
        below, above = low - r.low, r.high - high
    margins = np.minimum(below, above)
    margins[np.isnan(margins)] = -np.inf
    if r.rule:
        value, at, first = _time_outside(r, time, begins, margins < 0.0)
        margin = r.allowed - value
    else:
        worst = int(np.argmin(margins))
        value = float(low[worst] if below[worst] < above[worst] else high[worst])
        at, margin = float(time[worst]), float(margins[worst])
        first = float(time[np.argmax(margins < 0.0)])
    if margin < 0.0:
        return verdict("violated", value, margin, at, first)
    return verdict("met" if complete else "not evaluated", value, margin, at, None)


def _along_a_line(time: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """Rise of the straight line through some values over their time, and their spread about it."""
    t, y = time - time.mean(), value.astype(float) - value.mean()
    slope = float(t @ y / (t @ t)) if len(t) > 1 else 0.0
    return abs(slope) * float(np.ptp(time)), float(np.ptp(y - slope * t))


def _time_outside(
    r: Requirement, time: np.ndarray, begins: np.ndarray, outside: np.ndarray
) -> tuple[float, float | None, float | None]:
    """Time that a rule judges, when it ended, and when it had become longer than allowed [s]."""
    if not outside.any():
        return 0.0, None, None
    if r.rule == "settles":
        last = float(time[outside][-1])
        return last - r.start, last, r.start + r.allowed
    stretches = np.flatnonzero(np.diff(np.concatenate([[False], outside, [False]]).astype(int)))
    starts, ends = begins[stretches[::2]], time[stretches[1::2] - 1]
    longest = int(np.argmax(ends - starts))
    late = np.flatnonzero(ends - starts > r.allowed)
    first = float(starts[late[0]] + r.allowed) if len(late) else None
    return float(ends[longest] - starts[longest]), float(ends[longest]), first


def evaluate(
    requirements: Iterable[Requirement], run: Recorded, end: float = 0.0, figures: Mapping[str, float] | None = None
) -> list[Verdict]:
    """Judge all requirements of a scenario.

    Parameters
    ----------
    requirements : iterable of Requirement
        What is asked.
    run : Recorded
        What was recorded; a `Results` is one.
    end : float
        When the run ended [s]: the instant of its figures.
    figures : mapping of str to float, optional
        Values of `FIGURES`; what is required of one that is missing is not evaluated.
    """
    figures = figures or {}

    def series(name: str) -> Series | None:
        if name not in FIGURES:
            return run.series(name)
        if name not in figures:
            return None
        return Series(np.array([end]), np.array([figures[name]]), None, None, FIGURES[name])

    return [
        judge(r, difference(series(r.signal), series(r.minus)) if r.minus else series(r.signal)) for r in requirements
    ]


def difference(first: Series | None, second: Series | None) -> Series | None:
    """One signal less another, at the instants of the first; None if one of them is.

    Extremes of the intervals are not known of a difference and are left out.

    Parameters
    ----------
    first, second : Series or None
    """
    if first is None or second is None or len(second.time) == 0:
        return None
    mean = None
    if first.mean is not None and second.mean is not None and np.array_equal(first.time, second.time):
        mean = first.mean - second.mean
    value = first.value - np.interp(first.time, second.time, second.value)
    return Series(first.time, value, None, None, first.unit, mean)


def _window(
    series: Series, start: float, end: float, counts: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Instants, lows, highs and starts of intervals inside the window; of one partly in it the last value."""
    time = series.time
    inside = (time >= start) & (time <= end)
    begins = np.maximum(np.concatenate([time[:1], time[:-1]]), start)
    low, high = series.value, series.value
    if series.low is not None and series.high is not None:
        whole = np.concatenate([[False], time[:-1] >= start])
        low, high = np.where(whole, series.low, low), np.where(whole, series.high, high)
    if counts is not None:
        inside &= counts
    return time[inside], low[inside], high[inside], begins[inside]


def _time_average(series: Series, start: float, end: float) -> float:
    """Time average over the recorded part of the window: of the intervals wholly in it, else trapezia of the values."""
    inside = (series.time >= start) & (series.time <= end)
    if series.mean is not None:
        begins = np.concatenate([series.time[:1], series.time[:-1]])
        whole = inside & (begins >= start) & (begins < series.time)
        if whole.any():
            return float(np.average(series.mean[whole].astype(float), weights=(series.time - begins)[whole]))
    t, value = series.time[inside], series.value[inside].astype(float)
    if len(t) == 1:
        return float(value[0])
    return float(np.trapezoid(value, t) / (t[-1] - t[0]))
