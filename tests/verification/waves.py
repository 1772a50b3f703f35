"""Figures of a waveform given by points in time, straight in between: means, ripple, harmonics, distortion, peaks.

Times need not be equidistant, so that the waves of two programs, or the reconstructed edges of one, are measured by
the same lines.
"""

from __future__ import annotations

import math

import numpy as np


def part(t, y, start, stop):
    """The waveform between two times, its ends interpolated."""
    inside = (t > start) & (t < stop)
    ends = np.interp([start, stop], t, y)
    return np.concatenate([[start], t[inside], [stop]]), np.concatenate([ends[:1], y[inside], ends[1:]])


def mean(t, y, start, stop):
    """Mean between two times."""
    t, y = part(t, y, start, stop)
    return float(np.trapezoid(y, t) / (stop - start))


def rms(t, y, start, stop):
    """Root of the mean square; the square of a straight line is integrated exactly."""
    t, y = part(t, y, start, stop)
    return math.sqrt(float(np.sum(np.diff(t) * (y[1:] ** 2 + y[1:] * y[:-1] + y[:-1] ** 2)) / 3.0 / (stop - start)))


def harmonics(t, y, f, start, stop, count):
    """Complex amplitudes of the harmonics 1 to `count` of `f`, over a whole number of its periods.

    The phase is that of the cosine at time zero. The integral of straight line times exponential is exact; two points
    at one time are a jump.
    """
    t, y = part(t, y, start, stop)
    dt, dy = np.diff(t), np.diff(y)
    jump = dt <= 0.0
    slope = dy / np.where(jump, 1.0, dt)
    found = []
    for n in range(1, count + 1):
        w = 2.0 * math.pi * f * n
        e = np.exp(-1j * w * t)
        # by parts: the jumps of y, at the two ends and in between, and the slope of each piece
        pieces = np.where(jump, 1j * w * e[:-1] * dy, slope * (e[:-1] - e[1:]))
        integral = (y[0] * e[0] - y[-1] * e[-1]) / (1j * w) + np.sum(pieces) / (1j * w) ** 2
        found.append(2.0 * integral / (stop - start))
    return np.array(found)


def thd(amplitudes):
    """Total harmonic distortion: everything from the second harmonic on over the fundamental."""
    return float(np.sqrt(np.sum(np.abs(amplitudes[1:]) ** 2)) / abs(amplitudes[0]))


def ripple(t, y, period, start, stop):
    """Peak-to-peak value within a period, mean over the periods between two times."""
    count = round((stop - start) / period)
    found = [part(t, y, start + k * period, start + (k + 1) * period)[1] for k in range(count)]
    return float(np.mean([np.max(piece) - np.min(piece) for piece in found]))


def peak(t, y, start, stop):
    """Largest value between two times, and when."""
    t, y = part(t, y, start, stop)
    k = int(np.argmax(y))
    return float(y[k]), float(t[k])
