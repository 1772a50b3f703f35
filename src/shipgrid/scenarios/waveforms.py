"""Waveform windows: every step recorded, public signals and phase quantities.

Each window is a group of the results, `waveforms/0` and so on. Inside a window the compiled loop copies the signals
that waveforms are made of into preallocated rows (`solvers/bookkeeping.py`); the runner empties them every `WAVE_ROWS`
steps and makes the waveforms of them: phase quantities are weighted sums of alpha-beta signals
(docs/decisions/0001-alpha-beta-nodes.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import WAVE_ROWS, Workspace
from shipgrid.errors import InputErrors
from shipgrid.model.public_signals import terms_of
from shipgrid.scenarios.recorder import Column

FOREVER = 2**62


@dataclass(frozen=True)
class Window:
    """Numbers of the first and the last recorded step, and the group they go to."""

    first: int
    last: int
    group: str


def merged(windows: Iterable[tuple[float, float]], step: float, end: float) -> list[Window]:
    """Windows in order of time; those that touch or overlap become one.

    Parameters
    ----------
    windows : iterable of (float, float)
        From and to [s].
    step : float
        Step [s].
    end : float
        End of the run [s].

    Raises
    ------
    InputErrors
        For windows that are none, or that lie outside the run, or between two steps.
    """
    problems, spans = [], []
    for start, stop in windows:
        text = f"--waveforms: {start:g} s to {stop:g} s"
        if not (math.isfinite(start) and math.isfinite(stop) and 0.0 <= start < stop):
            problems.append(f"{text} ends before it begins or begins before 0 s")
        elif stop > end * (1.0 + 1e-12):
            problems.append(f"{text} is not within the run, expected an end up to {end:g} s")
        else:
            # a hair of a step for what the quotient is rounded by
            first, last = math.ceil(start / step - 1e-6), math.floor(stop / step + 1e-6)
            if last <= first:
                problems.append(f"{text} is shorter than a step, expected at least {2.0 * step:g} s")
            spans.append((first, last))
    if problems:
        raise InputErrors(problems)
    joined: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if joined and first <= joined[-1][1] + 1:
            joined[-1] = joined[-1][0], max(last, joined[-1][1])
        else:
            joined.append((first, last))
    return [Window(first, last, f"waveforms/{k}") for k, (first, last) in enumerate(joined)]


def window_columns(plan: Plan) -> list[Column]:
    """Name, unit, description and attributes of everything that a window records.

    Parameters
    ----------
    plan : Plan
    """
    network = plan.network
    columns: list[Column] = [(p.name, p.unit, p.description) for p in network.published.values()]
    for wave in network.waveforms.values():
        attributes: dict[str, Any] = {"cell_methods": "time: mean"} if wave.mean else {}
        attributes |= {"carrier_hz": wave.carrier} if wave.carrier else {}
        columns.append((wave.name, wave.unit, wave.description, attributes))
    return columns


class WaveRecorder:
    """Switches the recording of every step on and off, and hands the rows on.

    Parameters
    ----------
    plan : Plan
    work : Workspace
    windows : sequence of Window
        In order of time, none overlapping.
    room : int
        Steps for which nobody empties the buffer.
    """

    def __init__(self, plan: Plan, work: Workspace, windows: Sequence[Window], room: int = WAVE_ROWS):
        self.room = room
        self.windows, self.step, self.h = list(windows), work.step, plan.h
        self.sig, self.n = work.sig, work.n
        self.sources = plan.step.wave_source
        column = {int(place): k for k, place in enumerate(self.sources)}
        waves: list[Any] = [*plan.network.published.values(), *plan.network.waveforms.values()]
        self.weights = np.zeros((len(self.sources), len(waves) if windows else 0))
        for k, wave in enumerate(waves if windows else ()):
            for source, weight in terms_of(wave):
                self.weights[column[plan.layout.index[source]], k] += weight

    def until(self, n: int) -> int:
        """Switch recording on or off for the steps that follow number `n`, and say how far that holds."""
        for window in self.windows:
            if n < window.last:
                inside = n + 1 >= window.first
                self._switch(on=inside)
                return min(window.last, n + self.room) if inside else window.first - 1
        self._switch(on=False)
        return FOREVER

    def _switch(self, *, on: bool) -> None:
        rows = int(self.step.wave_row[0])
        rows = rows if rows >= 0 else -1 - rows
        self.step.wave_row[0] = rows if on else -1 - rows

    def first(self, writer: Any) -> None:
        """Record the instant at which the run starts, if a window has it."""
        for window in self.windows:
            if window.first <= self.n <= window.last:
                self._write(writer, window, np.array([self.n]), self.sig[self.sources][None, :])

    def flush(self, n: int, writer: Any) -> None:
        """Hand on what has been recorded up to step number `n`."""
        rows = int(self.step.wave_row[0])
        self.step.wave_row[0] = -1
        for window in self.windows if rows > 0 else ():
            if window.first <= n <= window.last:
                self._write(writer, window, np.arange(n - rows + 1, n + 1), self.step.wave_rows[:rows])

    def _write(self, writer: Any, window: Window, steps: np.ndarray, rows: np.ndarray) -> None:
        if writer is not None:
            writer.append(window.group, steps * self.h, rows @ self.weights)
