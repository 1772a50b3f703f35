"""Signals of a run as a picture file: one panel a unit, extremes as a shaded band where they were recorded."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shipgrid.analysis.requirements import Series
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.waves import with_edges
from shipgrid.scenarios.results import Results

FORMATS = (".png", ".svg", ".pdf")
GAP = 10.0
"""Instants further apart than this many of their usual distances are not joined."""


def plot(
    run: Results, signals: Sequence[str], out: Path | str, start: float = -math.inf, end: float = math.inf
) -> Path:
    """Plot signals of a run against time.

    Parameters
    ----------
    run : Results
        The run.
    signals : sequence of str
        Public names; those of one unit share a panel.
    out : Path or str
        Picture file; its ending decides the format (png, svg, pdf).
    start, end : float
        Time shown [s].

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    InputErrors
        For signals that were not recorded, all at once; if there is nothing between `start` and `end`; if `out` has
        another ending; if matplotlib (the extra `plot`) is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputErrors(["plotting needs matplotlib: pip install 'shipgrid[plot]'"]) from error
    panels: dict[str, list[tuple[str, Series]]] = {}
    problems = []
    if Path(out).suffix not in FORMATS:
        problems.append(f"{out}: is no picture, expected a name that ends in {', '.join(FORMATS)}")
    for name in signals:
        series = run.series(name, (start, end))
        if series is None:
            problems.append(_unknown(run, name))
        elif not np.any((series.time >= start) & (series.time <= end)):
            problems.append(f"{name}: nothing recorded between {start:g} s and {end:g} s")
        else:
            panels.setdefault(series.unit, []).append((name, series))
    if problems or not panels:
        raise InputErrors(problems or ["no signal named"])

    figure = Figure(figsize=(9.0, 1.2 + 2.2 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (unit, curves) in zip(axes, panels.items(), strict=True):
        for name, s in curves:
            # One row more on either side, so that a line runs on to the edge of the picture.
            first, last = np.searchsorted(s.time, [start, end])
            rows = slice(max(int(first) - 1, 0), int(last) + 1)
            (line,) = ax.plot(*_line(run, name, s, rows), label=name, linewidth=1.2)
            if s.low is not None and s.high is not None:
                ax.fill_between(
                    s.time[rows], s.low[rows], s.high[rows], step="pre", alpha=0.25, color=line.get_color(), lw=0
                )
        label = run.description(curves[0][0]) if len(curves) == 1 else ""
        ax.set_ylabel("\n".join(textwrap.wrap(f"{label} [{unit}]".lstrip(), 28)))
        ax.grid(alpha=0.3)
        ax.legend(loc="best", fontsize="small")
    shown = [s for curves in panels.values() for _, s in curves]
    axes[-1].set_xlim(max(start, min(s.time[0] for s in shown)), min(end, max(s.time[-1] for s in shown)))
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(run.name, fontsize="medium")
    figure.savefig(out, dpi=150)
    return Path(out)


def _line(run: Results, name: str, s: Series, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Points to join: in a waveform window with the edges inside steps, where they are known."""
    for group in run.windows:
        data = run.group(group)
        if name in data and len(data["time"]) == len(s.time) and float(data["time"][0]) == s.time[0]:
            return with_edges(data, name, rows)
    return _with_gaps(s.time[rows], s.value[rows])


def _with_gaps(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of a line that is broken between two waveform windows."""
    steps = np.diff(time)
    after = np.flatnonzero(steps > GAP * np.median(steps)) + 1 if len(steps) else []
    return np.insert(time, after, np.nan), np.insert(value.astype(float), after, np.nan)


def _unknown(run: Results, name: str) -> str:
    try:
        run[name]
    except ParameterError as error:
        return str(error)
    return f"{name}: is the extreme of another signal, which is drawn with it"
