"""What a waveform consists of: fundamental, harmonics, distortion, lines around the carrier, ripple.

**Fundamental.** The largest line of the Hann-windowed spectrum up to 450 Hz gives a first guess; then the advance of
the phase between two neighbouring stretches of whole cycles, divided by the time between them, corrects it until it
stands. A window with fewer than three cycles of the largest line has no fundamental.

**Harmonics**, in the manner of [IEC61000.4.7]: a rectangular interval of whole cycles, those that come nearest to the
standard's 0.2 s from below (11 or 12 of 60 Hz), has lines every 1/N of the fundamental. A harmonic is the subgroup of
its line and the two beside it where N is 5 or more, and its line alone where there are fewer cycles. THD is the root
of the sum of squares of orders 2 to 40 over the fundamental. `distortion` has everything but the mean and the
fundamental in place of these: carriers above the 40th order, and lines that are no harmonics.

The integral over the whole cycles is a trapezoidal sum with an end between two samples, and its lines fall exactly on
multiples of f_1/N: nothing leaks for want of a whole number of samples. Of a quantity that is the mean over each
step, the lines are divided by what that mean takes from them, sin(pi f h)/(pi f h).

Source: [IEC61000.4.7], 3.2 and 3.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

INTERVAL = 0.2
"""Time [s] of the standard: 10 cycles of 50 Hz, 12 of 60 Hz."""
ORDERS = 40
"""Highest order that counts for the THD."""
SUBGROUPED = 5
"""Cycles from which a harmonic is its line with both neighbours: below, these belong to nothing in particular."""
LEAST_CYCLES = 3.0
"""Fewer cycles than this in a window, and its fundamental is not looked for."""
HIGHEST = 450.0
"""Highest fundamental [Hz] that is looked for: grids of 50, 60 and 400 Hz, motors; beyond are carriers."""
NOTHING = 1e-6
"""A waveform whose alternating part is this share of its mean, or less, has no fundamental."""


@dataclass(frozen=True)
class Spectrum:
    """Lines of a waveform over whole cycles of its fundamental.

    Attributes
    ----------
    f_1 : float
        Fundamental [Hz].
    cycles : int
        Whole cycles in the interval: lines are f_1 over this apart.
    mean : float
    rms : float
        Of everything, the mean included.
    lines : ndarray of complex
        Peak values; number `k` has the frequency k f_1 / cycles; phases are those of a cosine at `start`.
    start : float
        Beginning of the interval [s].
    """

    f_1: float
    cycles: int
    mean: float
    rms: float
    lines: np.ndarray
    start: float

    @property
    def frequency(self) -> np.ndarray:
        """Frequency [Hz] of each line."""
        return np.arange(len(self.lines)) * self.f_1 / self.cycles

    def harmonic(self, order: int) -> float:
        """Peak value of a harmonic, as subgroup where the interval has the cycles for it.

        Parameters
        ----------
        order : int
            1: the fundamental; 0 beyond half the sampling frequency.
        """
        k = order * self.cycles
        around = 1 if self.cycles >= SUBGROUPED else 0
        found = self.lines[k - around : k + around + 1]
        return float(np.sqrt(np.sum(np.abs(found) ** 2))) if k < len(self.lines) else 0.0

    @property
    def thd(self) -> float:
        """Harmonics of the orders 2 to 40 over the fundamental."""
        others = sum(self.harmonic(order) ** 2 for order in range(2, ORDERS + 1))
        return math.sqrt(others) / self.harmonic(1)

    @property
    def distortion(self) -> float:
        """Everything but mean and fundamental, over the fundamental."""
        rest = 2.0 * (self.rms**2 - self.mean**2) - float(np.abs(self.lines[self.cycles])) ** 2
        return math.sqrt(max(rest, 0.0)) / float(np.abs(self.lines[self.cycles]))

    def around(self, carrier: float, count: int = 4, orders: float = 8.0) -> list[tuple[float, float]]:
        """Largest lines near a carrier: frequency [Hz] and peak value, largest first.

        Parameters
        ----------
        carrier : float
            Its frequency, or a multiple of it [Hz].
        count : int
            How many; lines beside a larger one belong to it and are left out.
        orders : float
            How far to either side to look, in fundamentals.
        """
        near = np.flatnonzero(np.abs(self.frequency - carrier) <= orders * self.f_1)
        size, found = np.abs(self.lines), []
        for k in near[np.argsort(-size[near])] if len(near) else ():
            if all(abs(int(k) - other) > 1 for other in found) and len(found) < count:
                found.append(int(k))
        return [(float(self.frequency[k]), float(size[k])) for k in found]


def line(time: np.ndarray, value: np.ndarray, f: float, start: float, stop: float) -> complex:
    """Peak value and phase of one frequency between two times, the phase that of a cosine at time zero.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
        Samples, straight in between.
    f : float
        Frequency [Hz].
    start, stop : float
        Interval [s], whole cycles of what is not to leak into it.
    """
    first, last = np.searchsorted(time, [start, stop])
    t = np.concatenate([[start], time[first:last], [stop]])
    y = np.concatenate([np.interp([start], time, value), value[first:last], np.interp([stop], time, value)])
    return 2.0 / (stop - start) * complex(np.trapezoid(y * np.exp(-2j * math.pi * f * t), t))


def fundamental(time: np.ndarray, value: np.ndarray) -> float | None:
    """Frequency [Hz] of the largest alternating part of a waveform.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Instants [s], equally spaced.
    value : ndarray, shape (n,)
        Samples.

    Returns
    -------
    float or None
        None where there is nothing alternating, or the window has fewer than three cycles of it.
    """
    if len(time) < 16 or not np.all(np.isfinite(value)):
        return None
    h = (time[-1] - time[0]) / (len(time) - 1)
    level = float(np.mean(value))
    alternating = value - level
    if np.max(np.abs(alternating)) <= NOTHING * max(abs(level), 1e-9):
        return None
    n = 1 << (4 * len(time) - 1).bit_length()  # a power of two, whose transform is fast
    size = np.abs(np.fft.rfft(alternating * np.hanning(len(time)), n))
    span = n * h
    lowest = math.ceil(LEAST_CYCLES * n / len(time))
    size = size[: min(len(size) - 1, math.ceil(HIGHEST * span))]
    k = int(np.argmax(size))
    if k < lowest - 4:  # something slower than the window is larger
        return None
    f = k / span
    for _ in range(20):
        cycles = math.floor(0.5 * f * (time[-1] - time[0]) + 1e-9)
        if cycles < 1:
            return None
        half = cycles / f
        # both stretches count their phase from their own beginnings
        a = line(time - time[0], value, f, 0.0, half)
        b = line(time - time[0] - half, value, f, 0.0, half)
        step = float(np.angle(b / a)) / (2.0 * math.pi * half) if a != 0.0 else 0.0
        f += step
        if abs(step) < 1e-10 * f:
            break
    return f if f * (time[-1] - time[0]) >= LEAST_CYCLES - 1e-6 else None


def spectrum(time: np.ndarray, value: np.ndarray, f_1: float, *, mean_of_step: bool = False) -> Spectrum:
    """Lines of a waveform over the last whole cycles of its fundamental, up to 0.2 s of them.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Instants [s], equally spaced.
    value : ndarray, shape (n,)
        Samples.
    f_1 : float
        Fundamental [Hz].
    mean_of_step : bool
        Whether each sample is the mean since the one before.

    Raises
    ------
    ValueError
        If there is less than one cycle.
    """
    from scipy.signal import czt  # a second to import, and most runs never come here

    h = (time[-1] - time[0]) / (len(time) - 1)
    cycles = math.floor(min(time[-1] - time[0], INTERVAL) * f_1 + 1e-6)
    if cycles < 1:
        raise ValueError(f"{time[-1] - time[0]:g} s have no whole cycle of {f_1:g} Hz")
    T = cycles / f_1
    first = max(math.floor((time[-1] - T - time[0]) / h + 1e-6), 0)
    y = np.asarray(value[first:], dtype=float)
    whole = min(math.floor(T / h + 1e-9), len(y) - 1)
    rest = T / h - whole  # of a step, from the last whole one to the end of the interval
    weights = np.ones(whole + 1)
    weights[0], weights[-1] = 0.5, 0.5 + 0.5 * rest
    after = y[whole] + rest * (y[min(whole + 1, len(y) - 1)] - y[whole])
    count = math.floor(0.5 * T / h)
    lines = czt(y[: whole + 1] * weights, count, np.exp(-2j * math.pi * h / T)) + 0.5 * rest * after
    lines = 2.0 * h / T * lines
    squares = float(np.sum(weights * y[: whole + 1] ** 2) + 0.5 * rest * after**2) * h / T
    mean = float(0.5 * lines[0].real)
    lines[0] = mean
    if mean_of_step:
        before = np.sum(np.abs(lines[1:]) ** 2)
        lines = lines / np.sinc(np.arange(count) * h / T)
        squares += 0.5 * float(np.sum(np.abs(lines[1:]) ** 2) - before)
    return Spectrum(f_1, cycles, mean, math.sqrt(max(squares, 0.0)), lines, float(time[first]))


def ripple(time: np.ndarray, value: np.ndarray, f: float) -> tuple[float, float]:
    """Peak-to-peak value within a period: mean over the periods of a window, and the largest.

    Parameters
    ----------
    time, value : ndarray
        Points, straight in between; they need not be equally spaced.
    f : float
        Frequency [Hz] whose periods are looked at.
    """
    periods = math.floor((time[-1] - time[0]) * f + 1e-6)
    if periods < 1:
        return float(np.ptp(value)), float(np.ptp(value))
    ends = time[0] + np.arange(periods + 1) / f
    at_ends = np.interp(ends, time, value)
    rows = np.searchsorted(time, ends)
    found = [np.ptp(np.concatenate([value[rows[k] : rows[k + 1]], at_ends[k : k + 2]])) for k in range(periods)]
    return float(np.mean(found)), float(np.max(found))
