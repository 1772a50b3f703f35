"""Waveforms between the steps of a switching run: the edges inside a step, and the currents on either side of them.

A step carries a leg's mean switching function, so that the values at the ends of steps are right and the current in
between is not on their chord. Where the leg switched is known, and with it the current: between two edges it is
straight up to terms of second order in the step,

    i(t) = chord(t) + r v_dc (S(t) - chord of S(t)),      S(t) = integral of s               (modulation-3)

`r` is the rate of the current per volt of the pole, 1/L of a choke. For a bridge S is a vector like s, alpha and beta;
r then has the sign and the axis of the current.

docs/theory/modulation.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shipgrid.errors import ParameterError
from shipgrid.model.kernel import uncompiled
from shipgrid.modulators.gates import duty_ratios

Array = NDArray[np.float64]
FULL = 1e-6
"""Means this close to 0 or 1 are those of steps without an edge: what single precision leaves."""


@dataclass(frozen=True)
class SwitchingFunction:
    """Switching function of a leg over time, or a linear combination of several: constant between edges.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Start [s], then the edges, ascending.
    value : ndarray, shape (n,)
        From each of these times to the next; the last for ever.
    """

    time: Array
    value: Array

    def __post_init__(self) -> None:
        if len(self.time) != len(self.value) or len(self.time) < 1 or np.any(np.diff(self.time) < 0.0):
            raise ParameterError("a switching function needs as many values as times, and times that ascend")

    @property
    def edges(self) -> Array:
        """Times [s] at which it changes."""
        return self.time[1:][np.diff(self.value) != 0.0]

    def __call__(self, t: ArrayLike) -> Array:
        """Value just after each time [s]."""
        return self.value[np.maximum(np.searchsorted(self.time, t, side="right") - 1, 0)]

    def integral(self, t: ArrayLike) -> Array:
        """Integral from the start to each time [s]."""
        t = np.asarray(t, dtype=float)
        done = np.concatenate([[0.0], np.cumsum(self.value[:-1] * np.diff(self.time))])
        k = np.maximum(np.searchsorted(self.time, t, side="right") - 1, 0)
        return done[k] + self.value[k] * (t - self.time[k])


def combination(weights: Sequence[float], legs: Sequence[SwitchingFunction]) -> SwitchingFunction:
    """Sum of switching functions times weights.

    Parameters
    ----------
    weights : sequence of float
    legs : sequence of SwitchingFunction
        With a common start.

    Returns
    -------
    SwitchingFunction
    """
    times = np.unique(np.concatenate([leg.time for leg in legs]))
    return SwitchingFunction(times, sum((w * leg(times) for w, leg in zip(weights, legs, strict=True)), 0.0 * times))


def alpha_beta(legs: Sequence[SwitchingFunction]) -> tuple[SwitchingFunction, SwitchingFunction]:
    """Alpha and beta components of the three legs of a bridge."""
    third = 1.0 / np.sqrt(3.0)
    return combination((2.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0), legs), combination((0.0, third, -third), legs)


def of_carrier(time: ArrayLike, duty: ArrayLike, f_sw: float, end: float, shift: float = 0.0) -> SwitchingFunction:
    """Switching function of a leg under a triangular carrier that is 1 at time zero.

    Parameters
    ----------
    time : array_like, shape (n,)
        When each duty ratio comes into force [s], ascending.
    duty : array_like, shape (n,)
        Duty ratios; what lies beyond 0 or 1 is cut.
    f_sw : float
        Frequency of the carrier [Hz].
    end : float
        Until when [s].
    shift : float
        The carrier's lead, in periods.

    Returns
    -------
    SwitchingFunction
    """
    start = np.atleast_1d(np.asarray(time, dtype=float))
    m = np.clip(np.atleast_1d(np.asarray(duty, dtype=float)), 0.0, 1.0)
    if len(start) != len(m) or f_sw <= 0.0:
        raise ParameterError("of_carrier needs one duty ratio for each time, and a carrier that turns")
    phase = start * f_sw + shift
    until = np.append(start[1:], end) * f_sw + shift
    place = phase - np.floor(phase)
    on = np.where((place >= 0.5 * (1.0 - m)) & (place < 0.5 * (1.0 + m)), 1.0, 0.0)
    found_t, found_s = [start], [np.where(m >= 1.0, 1.0, np.where(m <= 0.0, 0.0, on))]
    longest = float(np.max(until - np.floor(phase)))
    for n in range(int(np.ceil(longest))):
        for sign, value in ((-1.0, 1.0), (1.0, 0.0)):
            edge = np.floor(phase) + n + 0.5 * (1.0 + sign * m)
            inside = (edge > phase) & (edge < until) & (m > 0.0) & (m < 1.0)
            found_t.append((edge[inside] - shift) / f_sw)
            found_s.append(np.full(np.count_nonzero(inside), value))
    times, values = np.concatenate(found_t), np.concatenate(found_s)
    order = np.argsort(times, kind="stable")
    return _without_repeats(times[order], values[order])


def of_bridge(
    time: ArrayLike, alpha: ArrayLike, beta: ArrayLike, f_sw: float, end: float, *, injection: float = 1.0
) -> list[SwitchingFunction]:
    """Switching functions of the three legs of a bridge from its modulation vectors; as `of_carrier`.

    Parameters
    ----------
    time, f_sw, end
        As for `of_carrier`.
    alpha, beta : array_like, shape (n,)
        Modulation vectors.
    injection : float
        1 with min-max injection, 0 without.

    Returns
    -------
    list of SwitchingFunction
    """
    vectors = zip(np.atleast_1d(alpha), np.atleast_1d(beta), strict=True)
    duty = np.array([uncompiled(duty_ratios)(float(a), float(b), injection) for a, b in vectors])
    return [of_carrier(time, leg, f_sw, end) for leg in duty.T]


def of_means(time: ArrayLike, mean: ArrayLike, on: ArrayLike) -> SwitchingFunction:
    """Switching function of a leg from its mean over each step and its position at the ends of steps.

    One edge in a step lies where the mean puts it, exactly. Two have the right distance and are put around the middle.

    Parameters
    ----------
    time : array_like, shape (n + 1,)
        Ends of the steps [s], the first one's start before them.
    mean : array_like, shape (n,)
        Mean of each step, from 0 to 1.
    on : array_like, shape (n + 1,)
        1 while the upper switch is on, else 0, at each of these times.

    Returns
    -------
    SwitchingFunction
    """
    t, s, x = (np.asarray(a, dtype=float) for a in (time, mean, on))
    if not len(t) == len(x) == len(s) + 1:
        raise ParameterError("of_means needs a mean for each step and a position at each of its ends")
    return _of_positions(t, s, x[:-1], x[1:])


def of_steps(time: ArrayLike, mean: ArrayLike, still: ArrayLike | None = None) -> SwitchingFunction:
    """Switching function of a leg from its means over steps alone.

    A step without an edge tells the position at both its ends. In a run of steps with edges the positions alternate,
    one edge a step; a single such step between two of one position has two. What does not come out so, and what has
    no step without an edge beside it (averaged modulators, blocked gates), keeps the mean of the step.

    Parameters
    ----------
    time : array_like, shape (n + 1,)
        Ends of the steps [s], the first one's start before them.
    mean : array_like, shape (n,)
        Mean of each step, from 0 to 1.
    still : array_like of bool, shape (n,), optional
        Steps in which the leg rests for a while: they keep their mean.

    Returns
    -------
    SwitchingFunction
    """
    t, s = np.asarray(time, dtype=float), np.asarray(mean, dtype=float)
    if len(t) != len(s) + 1:
        raise ParameterError("of_steps needs a mean for each step")
    resting = np.zeros(len(s), dtype=bool) if still is None else np.asarray(still, dtype=bool)
    whole = ((s < FULL) | (s > 1.0 - FULL)) & ~resting
    before = np.where(whole, np.round(s), np.nan)
    after = before.copy()
    inside = ~whole & ~resting
    edges = np.diff(inside.astype(int), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1  # of each run
    start = np.append(after, np.nan)[first - 1]
    end = np.append(before, np.nan)[last + 1]
    count = last - first + 1
    turned = count % 2 == 1
    start = np.where(np.isnan(start), np.where(turned, 1.0 - end, end), start)
    end = np.where(np.isnan(end), np.where(turned, 1.0 - start, start), end)
    told = ~np.isnan(start) & ((count == 1) | (turned == (start != end)))
    rows = np.flatnonzero(inside)
    place = rows - np.repeat(first, count)
    before[rows] = np.where(np.repeat(told, count), np.abs(np.repeat(start, count) - place % 2), np.nan)
    after[rows] = 1.0 - before[rows]
    after[last] = np.where(told, end, np.nan)
    return _of_positions(t, s, before, after)


def _of_positions(t: Array, s: Array, before: Array, after: Array) -> SwitchingFunction:
    """From means, and positions at the start and at the end of each step; where these are no numbers, the mean."""
    h, known = np.diff(t), ~np.isnan(before)
    one = known & (before != after)
    share = np.where(before > 0.5, s, 1.0 - s)  # of the step before the only edge
    two = known & ~one & (np.abs(s - before) > 1e-12)
    half = 0.5 * h * np.abs(s - before)
    middle = 0.5 * (t[:-1] + t[1:])
    times = np.concatenate([t[:-1], t[:-1][one] + (h * share)[one], (middle - half)[two], (middle + half)[two], t[-1:]])
    last = after[-1:] if known[-1] else s[-1:]
    values = np.concatenate([np.where(known, before, s), after[one], 1.0 - before[two], before[two], last])
    order = np.argsort(times, kind="stable")
    return _without_repeats(times[order], values[order])


def at_rest(time: ArrayLike, value: ArrayLike, mean: ArrayLike, rate: float, v_dc: ArrayLike) -> Array:
    """Switching function at which a leg's current would have stood still, of each step.

    Parameters
    ----------
    time, value, v_dc : array_like, shape (n + 1,)
        Ends of steps [s], the first one's start before them; current [A] and bus voltage [V] there.
    mean : array_like, shape (n,)
        Mean switching function of each step.
    rate : float
        As for `between_steps`.

    Returns
    -------
    ndarray, shape (n,)
    """
    v = np.asarray(v_dc, dtype=float)
    return np.asarray(mean) - np.diff(value) / (rate * np.diff(time) * 0.5 * (v[1:] + v[:-1]))


def of_one_switch(
    time: ArrayLike, mean: ArrayLike, low: ArrayLike, rest: ArrayLike, command: SwitchingFunction, *, lower: bool
) -> SwitchingFunction:
    """Switching function of a leg of which only one switch is driven.

    In a part of a step without a driven switch the opposite diode conducts until the current is at rest, and then the
    leg floats: how long, follows from the mean of that part.

    Parameters
    ----------
    time : array_like, shape (n + 1,)
        Ends of the steps [s], the first one's start before them.
    mean, low, rest : array_like, shape (n,)
        Mean of each step, its lower bound (`leg.s` and the modulator's `lo`), and `at_rest`.
    command : SwitchingFunction
        What the modulator would have both switches do.
    lower : bool
        Whether it is the lower switch that is driven.

    Returns
    -------
    SwitchingFunction
    """
    t = np.asarray(time, dtype=float)
    diode, driven = (1.0, 0.0) if lower else (0.0, 1.0)
    times: list[float] = []
    values: list[float] = []
    edges = command.edges
    rows = zip(t[:-1], t[1:], np.asarray(mean), np.asarray(low), np.asarray(rest), strict=True)
    for start, end, s, least, floating in rows:
        nodes = [start, *edges[slice(*np.searchsorted(edges, (start + 1e-12, end - 1e-12)))], end]
        parts = [(a, b, command(0.5 * (a + b)) == diode) for a, b in pairwise(nodes)]
        on = driven * sum(b - a for a, b, free in parts if not free)
        left = s * (end - start) - on  # volt-seconds, over v_dc, of the parts without a driven switch
        time_left = sum(b - a for a, b, free in parts if free)
        for k, (a, b, free) in enumerate(parts):
            times.append(a)
            if not free:
                values.append(driven)
                continue
            span = b - a
            taken = least * (end - start) - on if k == 0 and len(parts) > 1 else left * span / time_left
            left, time_left = left - taken, time_left - span
            conducts = min(max((taken - floating * span) / (diode - floating), 0.0), span)
            values.append(diode if conducts > 0.0 else floating)
            if 0.0 < conducts < span * (1.0 - 1e-9):
                times.append(a + conducts)
                values.append(floating)
    return _without_repeats(np.array(times), np.array(values))


def between_steps(
    time: ArrayLike, value: ArrayLike, s: SwitchingFunction, rate: float, v_dc: ArrayLike
) -> tuple[Array, Array]:
    """A current with its edges: (modulation-3).

    Parameters
    ----------
    time, value : array_like, shape (n,)
        Ends of steps [s], and the current there.
    s : SwitchingFunction
        Of the pole that drives it.
    rate : float
        Rate of the current per volt of the pole [A/(V s)]: 1/L of a choke that counts its current out of the pole.
    v_dc : array_like, shape (n,)
        Bus voltage at the ends of steps [V].

    Returns
    -------
    times, values : ndarray
        Ends of steps and edges, straight in between.
    """
    t, i = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    inside = s.edges[(s.edges > t[0]) & (s.edges < t[-1])]
    every = np.unique(np.concatenate([t, inside]))
    beside = s.integral(every) - np.interp(every, t, s.integral(t))
    return every, np.interp(every, t, i) + rate * np.interp(every, t, np.broadcast_to(v_dc, t.shape)) * beside


def corners(time: ArrayLike, value: ArrayLike, s: ArrayLike, weights: Sequence[float] = (1.0,)) -> tuple[Array, Array]:
    """A choke's current with its corners at the edges of the legs that drive it, from recorded steps alone.

    How much its slope changes with the legs follows from one step to the next: everything else moves slowly.

    Parameters
    ----------
    time, value : array_like, shape (n,)
        Ends of steps [s], and the current there.
    s : array_like, shape (n,) or (legs, n)
        Mean switching functions of the step that ends at each.
    weights : sequence of float
        What each leg counts in the voltage across the choke.

    Returns
    -------
    times, values : ndarray
        As they are where no edge is known (averaged fidelity, blocked gates).
    """
    t, i, means = np.asarray(time), np.asarray(value), np.atleast_2d(np.asarray(s, dtype=float))[:, 1:]
    still = None
    if len(means) == 1:  # a choke at rest between two steps: a leg with one switch driven
        zero = np.abs(i) <= 1e-6 * np.max(np.abs(i), initial=0.0)
        rests = zero[:-1] & zero[1:]
        near = rests | np.append(rests[1:], False) | np.append(False, rests[:-1])
        still = near & (means[0] > FULL) & (means[0] < 1.0 - FULL)
    legs = combination(weights, [of_steps(t, leg, still) for leg in means])
    mean = np.asarray(weights) @ means
    moved = np.diff(mean)
    if len(legs.edges) == 0 or not np.any(moved):
        return t, i
    rate = float(np.sum(moved * np.diff(np.diff(i) / np.diff(t))) / np.sum(moved**2))
    return between_steps(t, i, legs, rate, 1.0)


def pulses(time: ArrayLike, value: ArrayLike, s: ArrayLike, weights: Sequence[float]) -> tuple[Array, Array]:
    """A bridge's voltage with its edges, from its means over steps: a line that jumps at each edge.

    Parameters
    ----------
    time, value : array_like, shape (n,)
        Ends of steps [s], and the mean of the step that ends at each.
    s, weights
        As for `corners`.

    Returns
    -------
    times, values : ndarray
        Two points for each piece; where no edge is known a piece is a step.
    """
    t, v, means = np.asarray(time, dtype=float), np.asarray(value, dtype=float)[1:], np.atleast_2d(s)[:, 1:]
    legs = combination(weights, [of_steps(t, leg) for leg in means])
    mean = np.asarray(weights) @ means
    telling = np.abs(mean) > 0.1
    v_dc = np.zeros(len(v))
    if telling.any():
        v_dc = np.interp(np.arange(len(v)), np.flatnonzero(telling), v[telling] / mean[telling])
    nodes = np.unique(np.concatenate([t, legs.edges]))
    step = np.clip(np.searchsorted(t, nodes[:-1], side="right") - 1, 0, len(v) - 1)
    pieces = v[step] + (legs(nodes[:-1]) - mean[step]) * v_dc[step]
    return np.repeat(nodes, 2)[1:-1], np.repeat(pieces, 2)


def _without_repeats(times: Array, values: Array) -> SwitchingFunction:
    """Without points at which nothing changes; of several at one time the last stands."""
    last = np.append(np.diff(times) > 0.0, True)
    times, values = times[last], values[last]
    kept = np.append(True, np.diff(values) != 0.0)
    return SwitchingFunction(times[kept], values[kept])
