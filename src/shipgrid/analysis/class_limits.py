"""Limits of class societies and standards, applied to every run: voltage, frequency, gensets' steps, harmonics.

    IACS UR E5      AC bars: voltage +6/-10 %, outside for 1.5 s at most, and never beyond +-20 %;
                    frequency +-5 %, outside for 5 s at most, and never beyond +-10 %; DC buses: +-10 %
    ISO 8528-5      gensets of class G2 (G3): speed never beyond -10/+12 % (-7/+10 %), outside its steady band for 5 s
                    (3 s) at most; voltage never beyond -20/+25 % (-15/+20 %), further than 2.5 % (1 %) from rated
                    for 6 s (4 s) at most
    IACS UR E24     AC bars, in waveform windows: total harmonic distortion up to 8 %, each harmonic up to 5 %

The steady band of a speed is from no load to the droop that the class allows at full load (5 %, 3 %), with 2 % more on
either side. Bars are judged by their one-cycle rms, gensets' voltages by their means over a recording interval: a
contactor that energises a filter takes the instantaneous voltage away for a millisecond, which no meter of rms shows.

Bars of inverters have even harmonics of their own: one reference a carrier period, with min-max injection
(docs/theory/modulation.md, modulation-5).

A bus counts while a source feeds it, through closed ties too, and a genset while it is on; each from `SETTLING` after
that. Limits are those of the editions known to the authors: to be confirmed in the edition in force. They are no
requirements of a scenario, and a run that violates one is still complete.

Source: IACS UR E5 and E24, ISO 8528-5:2018.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.analysis.harmonics import ORDERS, fundamental, spectrum
from shipgrid.analysis.requirements import Recorded, Requirement, Series, Verdict, judge

SETTLING = 0.2
"""Time [s] after which a bus that a source has begun to feed is judged."""
E5, G2, G3, E24 = "IACS UR E5", "ISO 8528-5 G2", "ISO 8528-5 G3", "IACS UR E24"
THD, SINGLE = 0.08, 0.05
"""Limits of harmonics over the fundamental: orders 2 to 40 together, and each."""


@dataclass(frozen=True)
class ClassLimit:
    """A band for a signal of every item of a kind, over its nominal value; beyond for `recovery` [s] at most."""

    basis: str
    name: str
    kind: str
    symbol: str
    low: float
    high: float
    recovery: float = 0.0
    means: bool = False
    """Whether means of the recording intervals are judged in place of their extremes."""


LIMITS = (
    ClassLimit(E5, "voltage", "ac", "v_rms_pu", 0.90, 1.06, recovery=1.5),
    ClassLimit(E5, "voltage, transient", "ac", "v_rms_pu", 0.80, 1.20),
    ClassLimit(E5, "frequency", "ac", "f", 0.95, 1.05, recovery=5.0),
    ClassLimit(E5, "frequency, transient", "ac", "f", 0.90, 1.10),
    ClassLimit(E5, "voltage", "dc", "v_dc", 0.90, 1.10),
    ClassLimit(G2, "speed, transient", "genset", "omega_pu", 0.90, 1.12),
    ClassLimit(G2, "speed", "genset", "omega_pu", 0.93, 1.02, recovery=5.0),
    ClassLimit(G2, "voltage, transient", "genset", "v_pu", 0.80, 1.25, means=True),
    ClassLimit(G2, "voltage", "genset", "v_pu", 0.975, 1.025, recovery=6.0, means=True),
    ClassLimit(G3, "speed, transient", "genset", "omega_pu", 0.93, 1.10),
    ClassLimit(G3, "speed", "genset", "omega_pu", 0.95, 1.02, recovery=3.0),
    ClassLimit(G3, "voltage, transient", "genset", "v_pu", 0.85, 1.20, means=True),
    ClassLimit(G3, "voltage", "genset", "v_pu", 0.99, 1.01, recovery=4.0, means=True),
)


def class_verdicts(ship: Any, run: Recorded) -> list[Verdict]:
    """Judge a run by every limit that concerns something that was in operation.

    Parameters
    ----------
    ship : Ship
    run : Recorded
        What was recorded; a `Results` is one.
    """
    found = []
    for limit in LIMITS:
        for name, nominal in _nominal(ship, limit).items():
            signal = f"{name}.{limit.symbol}"
            series = run.series(signal)
            if series is None or len(series.time) == 0:
                continue
            if limit.means and series.mean is not None:
                series = Series(series.time, series.mean, None, None, series.unit)
            rule = {"rule": "recovery", "allowed": limit.recovery} if limit.recovery else {}
            text = f"{limit.basis}: {limit.name}"
            asked = Requirement(text, signal, "band", limit.low * nominal, limit.high * nominal, **rule)
            counts = _for_a_while(series.time, _in_operation(ship, run, name, limit.kind, series.time))
            verdict = judge(asked, series, counts)
            if verdict.verdict != "not evaluated":
                found.append(verdict)
    return found + _harmonics(ship, run)


def _nominal(ship: Any, limit: ClassLimit) -> dict[str, float]:
    """Names of what a limit is on, with the nominal value of its signal."""
    if limit.kind == "genset":
        return dict.fromkeys(ship.items("genset"), 1.0)
    symbol = {"v_dc": "v_n", "f": "f_n"}.get(limit.symbol)
    buses = {
        name: bus for name, bus in ship.buses.items() if ("f" in {s.name for s in bus.signals}) == (limit.kind == "ac")
    }
    return {name: getattr(bus, symbol) if symbol else 1.0 for name, bus in buses.items()}


def _in_operation(ship: Any, run: Recorded, name: str, kind: str, time: np.ndarray) -> np.ndarray:
    """When a genset is on, or a bus fed by a source on it or on one that closed ties join to it."""

    def any_of(signals: Iterable[str]) -> np.ndarray:
        return np.logical_or.reduce(
            [_value(run, signal, time) > 0.0 for signal in signals] or [np.zeros(len(time), bool)]
        )

    if kind == "genset":
        return any_of([f"{name}.on"])
    fed = {bus: any_of(_sources(ship, bus)) for bus in ship.buses}
    ties = ship.items(f"{kind}_breaker")
    for _ in ties:  # as many times as the longest chain of ties
        for tie, item in ties.items():
            joined = _value(run, f"{tie}.closed", time) > 0.5
            either = joined & (fed[item.from_] | fed[item.to])
            fed[item.from_], fed[item.to] = fed[item.from_] | either, fed[item.to] | either
    return fed[name]


def _sources(ship: Any, bus: str) -> list[str]:
    """Signals that are above zero while a source on a bus works."""
    inverters = [f"{name}.on" for name, item in ship.items("inverter").items() if item.grid == bus]
    batteries = [f"{name}.mode" for name, item in ship.items("bess").items() if item.bus == bus]
    rectifiers = [f"{name}.modulation" for name, item in ship.items("rectifier").items() if item.bus == bus]
    return inverters + batteries + rectifiers


def _value(run: Recorded, signal: str, time: np.ndarray) -> np.ndarray:
    """The last recorded value of a signal at some instants; 0 where there is none."""
    series = run.series(signal)
    if series is None or len(series.time) == 0:
        return np.zeros(len(time))
    return series.value[np.maximum(np.searchsorted(series.time, time, side="right") - 1, 0)]


def _for_a_while(time: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Instants at which something has been on for `SETTLING`, or since the start of the record."""
    off = np.maximum.accumulate(np.where(on, -np.inf, time))
    return time - off >= SETTLING


def _harmonics(ship: Any, run: Recorded) -> list[Verdict]:
    """Distortion of the bars' voltages in each waveform window."""
    found = []
    for bar in ship.buses:
        series = run.series(f"{bar}.v_a")
        for time, value in _windows(series) if series is not None else ():
            f_1 = fundamental(time, value)
            if f_1 is None:
                continue
            lines = spectrum(time, value, f_1)
            largest = max(lines.harmonic(order) for order in range(2, ORDERS + 1)) / lines.harmonic(1)
            for text, share, most in (("THD", lines.thd, THD), ("largest harmonic", largest, SINGLE)):
                word = "met" if share <= most else "violated"
                span: list[float | None] = [float(time[0]), float(time[-1])]
                said: Mapping[str, Any] = {"value": share, "margin": most - share, "at": None, "first_violation": None}
                found.append(
                    Verdict(f"{E24}: {text}", f"{bar}.v_a", "max", "1", [None, most], span, **said, verdict=word)
                )
    return found


def _windows(series: Series) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Times and values of the windows of a phase quantity, which follow each other in its series."""
    gaps = np.diff(series.time)
    cuts = np.flatnonzero(gaps > 1.5 * gaps.min()) + 1 if len(gaps) else []
    yield from zip(np.split(series.time, cuts), np.split(series.value.astype(float), cuts), strict=True)
