"""What a report shows of waveform windows: a few cycles of each three-phase set, its harmonics, and DC ripple.

Drawings are SVG in the page's colours, made here: a window has its own time, apart from that of the other plots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from shipgrid.analysis.edges import corners, pulses
from shipgrid.analysis.harmonics import ORDERS, Spectrum, fundamental, ripple, spectrum
from shipgrid.scenarios.results import Results

CYCLES, PULSED_CYCLES = 3.0, 1.0
"""Cycles of the fundamental that a drawing shows, of smooth quantities and of pulses."""
COLUMNS = 400
"""Columns of a drawing: what lies in one is drawn by its first, least, greatest and last value."""
PHASES, LINES = ("a", "b", "c"), ("ab", "bc", "ca")
CHOKE = ("i_b", "s")
"""Symbols of an item's choke current and of the switching function of the leg that drives it."""
DRIVEN = {f"i_{phase}": tuple(1.0 * (k == j) - 1.0 / 3.0 for j in range(3)) for k, phase in enumerate(PHASES)}
"""Symbols of the currents that a three-phase bridge drives, and what each of its legs counts for them."""
BETWEEN = {f"v_{a}{b}": tuple(1.0 * (k == a) - 1.0 * (k == b) for k in PHASES) for a, b in LINES}
"""The same of the voltages between its poles."""
SAME = 0.02
"""Fundamentals of an item's quantities that differ by less are one, that of the cleanest quantity."""
SMALLEST = 1e-3
"""A fundamental below this share of the largest of its unit in the window is nothing but numerical dust."""
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 420, 156, 46, 18, 8
ZERO = TOP + (HEIGHT - BOTTOM - TOP) / 2.0


@dataclass
class Set:
    """One three-phase set of a window: a current or a voltage of an item."""

    stem: str
    unit: str
    description: str
    phases: list[str]
    mean_of_step: bool
    carrier: float
    values: dict[str, np.ndarray] = field(default_factory=dict)
    lines: Spectrum | None = None


def windows_of(run: Results) -> list[dict[str, Any]]:
    """Each waveform window of a run, as plain data for the page.

    Parameters
    ----------
    run : Results

    Returns
    -------
    list of dict
        `start`, `end`, `steps`, `step` [s]; `sets` [{`name`, `text`, `wave`, `bars`, `facts`}]; `orders`, the table of
        harmonics, and `carriers`, the lines around the carriers; `ripple`, rows of DC quantities.
    """
    return [window for group in run.windows if (window := _window(run.group(group)))]


def _window(data: Any) -> dict[str, Any] | None:
    time = data["time"].values
    if len(time) < 2:
        return None
    sets = [s for s in _sets(data) if _analyse(s, time)]
    _one_fundamental(sets, time)
    largest: dict[str, float] = {}
    for s in sets:
        largest[s.unit] = max(largest.get(s.unit, 0.0), _of(s).harmonic(1))
    sets = [s for s in sets if _of(s).harmonic(1) > SMALLEST * largest[s.unit]]
    orders = [1, *(n for n in range(2, ORDERS + 1) if any(_share(s, n) >= 5e-5 for s in sets))]
    return {
        "start": float(time[0]),
        "end": float(time[-1]),
        "steps": len(time),
        "step": float(time[-1] - time[0]) / (len(time) - 1),
        "sets": [_shown(s, time, data) for s in sets],
        "names": [f"{s.stem}_{s.phases[0]}" for s in sets],
        "orders": [(n, [f"{100.0 * _share(s, n):.2f}" for s in sets]) for n in orders],
        "carriers": [row for s in sets for row in _carrier_rows(s)],
        "ripple": _ripple_rows(data, time),
    }


def _of(s: Set) -> Spectrum:
    assert s.lines is not None
    return s.lines


def _share(s: Set, order: int) -> float:
    return _of(s).harmonic(order) / _of(s).harmonic(1)


def _sets(data: Any) -> list[Set]:
    """Three-phase sets of a window: variables of one stem with all its phases."""
    found = []
    for name in map(str, data.data_vars):
        for phases in (PHASES, LINES):
            stem = name.removesuffix(f"_{phases[0]}")
            if stem != name and all(f"{stem}_{p}" in data for p in phases) and data[name].attrs["units"] != "1":
                attrs = data[name].attrs
                text = attrs["long_name"].rpartition(",")[0] or attrs["long_name"]
                carrier = float(attrs.get("carrier_hz", 0.0))
                made = Set(stem, attrs["units"], text, list(phases), "cell_methods" in attrs, carrier)
                made.values = {p: data[f"{stem}_{p}"].values.astype(float) for p in phases}
                found.append(made)
    return found


def _analyse(s: Set, time: np.ndarray, f_1: float | None = None) -> bool:
    """Find its fundamental, or take it as given, and its lines; whether there are any."""
    value = s.values[s.phases[0]]
    f_1 = f_1 or fundamental(time, value)
    if f_1 is None:
        return False
    s.lines = spectrum(time, value, f_1, mean_of_step=s.mean_of_step)
    return s.lines.harmonic(1) > 0.0


def _one_fundamental(sets: Sequence[Set], time: np.ndarray) -> None:
    """Take the fundamental of an item from its cleanest quantity, where the others have about the same."""
    for s in sets:
        own = [o for o in sets if o.stem.partition(".")[0] == s.stem.partition(".")[0]]
        f_1 = _of(min(own, key=lambda o: _of(o).distortion)).f_1
        if f_1 != _of(s).f_1 and abs(f_1 / _of(s).f_1 - 1.0) < SAME:
            _analyse(s, time, f_1)


def with_edges(data: Any, name: str, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """A quantity of a waveform window with the edges inside its steps, for a line from point to point.

    Parameters
    ----------
    data : xarray.Dataset
        The window.
    name : str
        Currents of a choke get their corners, voltages of a bridge their jumps, where the legs that drive them are
        recorded and known; anything else is as recorded.
    rows : slice
        Steps of the window.

    Returns
    -------
    times, values : ndarray
    """
    item, _, symbol = name.partition(".")
    time, value = data["time"].values[rows], data[name].values[rows].astype(float)
    alone = symbol == CHOKE[0] and f"{item}.{CHOKE[1]}" in data  # a battery's choke, and not phase b
    legs = [f"{item}.{CHOKE[1]}"] if alone else [f"{item}.s_{phase}" for phase in PHASES]
    weights = (1.0,) if alone else {**DRIVEN, **BETWEEN}.get(symbol, ())
    if not weights or len(time) < 3 or not all(leg in data for leg in legs):
        return time, value
    s = np.array([data[leg].values[rows].astype(float) for leg in legs])
    return (pulses if symbol in BETWEEN else corners)(time, value, s, weights)


def _shown(s: Set, time: np.ndarray, data: Any) -> dict[str, Any]:
    lines = _of(s)
    first = np.searchsorted(time, time[-1] - (PULSED_CYCLES if s.mean_of_step else CYCLES) / lines.f_1)
    peak = lines.harmonic(1)
    facts = [
        ("fundamental", f"{lines.f_1:.3f} Hz"),
        ("peak", f"{peak:.4g} {s.unit}"),
        ("rms", f"{peak / math.sqrt(2.0):.4g} {s.unit}"),
        ("THD", f"{100.0 * lines.thd:.2f} %"),
        ("all distortion", f"{100.0 * lines.distortion:.2f} %"),
    ]
    shown = {p: with_edges(data, f"{s.stem}_{p}", slice(first, None)) for p in s.phases}
    drawn_through = s.mean_of_step and len(next(iter(shown.values()))[0]) == len(time) - first
    return {
        "name": f"{s.stem}_{', _'.join(s.phases)}",
        "text": s.description,
        "facts": facts,
        "wave": wave_drawing(shown, s.unit, steps=drawn_through),
        "bars": bar_drawing(lines, s.carrier),
        "cycles": lines.cycles,
    }


def _carrier_rows(s: Set) -> list[dict[str, Any]]:
    """Lines around one and two times the carrier, in per cent of the fundamental."""
    rows, lines = [], _of(s)
    for multiple in (1, 2) if s.carrier else ():
        near = [(f, a / lines.harmonic(1)) for f, a in lines.around(multiple * s.carrier)]
        near = [(f, share) for f, share in near if share >= 1e-4]
        if near:
            text = ",  ".join(f"{f:.0f} Hz {100.0 * share:.2f} %" for f, share in sorted(near))
            rows.append({"name": f"{s.stem}_{s.phases[0]}", "carrier": f"{multiple} x {s.carrier:g} Hz", "lines": text})
    return rows


def _ripple_rows(data: Any, time: np.ndarray) -> list[dict[str, str]]:
    """Mean and ripple of choke currents, with the corners between steps, and of DC bus voltages."""
    rows = []
    for name in map(str, data.data_vars):
        item, _, symbol = name.partition(".")
        leg = f"{item}.{CHOKE[1]}"
        if symbol == CHOKE[0] and leg in data and "carrier_hz" in data[leg].attrs:
            value, f = data[name].values.astype(float), float(data[leg].attrs["carrier_hz"])
            found = ripple(*with_edges(data, name), f)
            rows.append(_ripple_row(name, value, "A", *found, f"within a period of {f:g} Hz"))
        if symbol == "v_dc":
            value = data[name].values.astype(float)
            whole = float(np.ptp(value))
            rows.append(_ripple_row(name, value, "V", whole, whole, "in the window"))
    return rows


def _ripple_row(name: str, value: np.ndarray, unit: str, mean: float, largest: float, of: str) -> dict[str, str]:
    return {
        "name": name,
        "mean": f"{float(np.mean(value)):.5g} {unit}",
        "pp": f"{mean:.4g} {unit}",
        "largest": f"{largest:.4g} {unit}",
        "of": of,
    }


def wave_drawing(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], unit: str, *, steps: bool = False) -> str:
    """Curves over time as SVG, time counted from the first instant in milliseconds.

    Parameters
    ----------
    curves : mapping of str to (ndarray, ndarray)
        Times [s] and values by phase.
    unit : str
    steps : bool
        Whether a value holds for the whole step before it.
    """
    top = max(float(np.max(np.abs(v))) for _, v in curves.values()) or 1.0
    began = min(float(t[0]) for t, _ in curves.values())
    span = max(float(t[-1]) for t, _ in curves.values()) - began or 1.0
    parts = [_frame(top, f"{1e3 * span:.3g} ms", unit)]
    for k, curve in enumerate(curves.values()):
        t, y = _columns(*curve)
        x_at = LEFT + (WIDTH - LEFT - 4) * (t - began) / span
        y_at = ZERO - (ZERO - TOP) * y / top
        points = zip(x_at, y_at, strict=True)
        path = "V{1:.1f}H{0:.1f}" if steps else "L{0:.1f},{1:.1f}"
        text = "".join(path.format(x, y) for x, y in points)
        start = f"M{x_at[0]:.1f},{y_at[0]:.1f}"
        parts.append(f'<path class="curve" style="stroke:var(--c{k})" d="{start}{text}"/>')
    return _svg(parts, f"{', '.join(curves)} over time")


def _columns(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First, least, greatest and last point of each column of a drawing, in their order."""
    if len(time) <= 4 * COLUMNS:
        return time, value
    kept = []
    for rows in np.array_split(np.arange(len(time)), COLUMNS):
        inside = value[rows]
        kept += sorted({int(rows[0]), int(rows[np.argmin(inside)]), int(rows[np.argmax(inside)]), int(rows[-1])})
    return time[kept], value[kept]


def bar_drawing(lines: Spectrum, carrier: float) -> str:
    """Harmonics 2 to 40, and the lines around twice a carrier beyond them, in per cent of the fundamental, as SVG.

    Parameters
    ----------
    lines : Spectrum
    carrier : float
        Frequency [Hz] of the carrier; 0 without one.
    """
    last = max(ORDERS, min(2.2 * carrier, 0.9 * float(lines.frequency[-1])) / lines.f_1)
    size = 100.0 * np.abs(lines.lines) / lines.harmonic(1)
    order = lines.frequency / lines.f_1
    inside = (order > 1.5) & (order <= last)
    top = float(np.max(size[inside], initial=0.0)) or 1.0
    parts = [_frame(top, f"order {last:.0f}", "%", signed=False)]
    for n, share in zip(order[inside], size[inside], strict=True):
        if share > 0.004 * top:
            x = LEFT + (WIDTH - LEFT - 4) * n / last
            height = (HEIGHT - BOTTOM - TOP) * share / top
            whole = "harmonic" if abs(n - round(n)) < 1e-6 else "between"
            title = f"{n:.3g} x {lines.f_1:.4g} Hz: {share:.3g} %"
            parts.append(
                f'<path class="{whole}" d="M{x:.1f},{HEIGHT - BOTTOM}v{-height:.1f}"><title>{title}</title></path>'
            )
    return _svg(parts, "harmonics in per cent of the fundamental")


def _frame(top: float, right: str, unit: str, *, signed: bool = True) -> str:
    """Axes: zero, the greatest value, what the right end of the x axis is."""
    floor = HEIGHT - BOTTOM
    rules = [(TOP, f"{top:.3g} {unit}"), *([(ZERO, "0"), (floor, f"{-top:.3g}")] if signed else [(floor, "0")])]
    lines = "".join(f'<path class="rule" d="M{LEFT},{y:.1f}H{WIDTH}"/>' for y, _ in rules)
    texts = "".join(
        f'<text x="{LEFT - 4}" y="{max(y + 4, 10):.1f}" text-anchor="end">{escape(text)}</text>' for y, text in rules
    )
    return f'{lines}{texts}<text x="{WIDTH - 2}" y="{HEIGHT - 4}" text-anchor="end">{escape(right)}</text>'


def _svg(parts: Sequence[str], says: str) -> str:
    inside = "".join(parts)
    label = escape(says, quote=True)
    return f'<svg class="wave" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{inside}</svg>'
