"""Two runs side by side: signal by signal the largest and the mean difference."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from shipgrid.analysis.requirements import Recorded, Series


class Difference(NamedTuple):
    """How a signal differs between two runs (second minus first), at the first run's instants.

    Attributes
    ----------
    signal, unit : str
        Which.
    largest, at : float
        Largest magnitude of the difference, and when [s].
    mean : float
        Mean magnitude.
    relative : float
        `largest` over the largest magnitude of the signal in the first run (0 where both are zero throughout).
    """

    signal: str
    unit: str
    largest: float
    at: float
    mean: float
    relative: float


class Comparison(NamedTuple):
    """Differences of the signals both runs have, largest relative one first, and the signals only one has."""

    differences: list[Difference]
    only_first: list[str]
    only_second: list[str]


def compare(
    first: Recorded, second: Recorded, signals: Iterable[str] | None = None, *, means: bool = False
) -> Comparison:
    """Compare two runs.

    Parameters
    ----------
    first, second : Recorded
        Two `Results`. The second is interpolated linearly to the first's instants, over the time both cover.
    signals : iterable of str, optional
        Which signals; all that both have, if not given.
    means : bool
        Whether to compare means over the recording intervals, where both runs kept them, in place of the values at
        their ends: a ripple of the converters falls out.

    Returns
    -------
    Comparison
        With a difference that is not a number reported as infinite.
    """
    mine, theirs = set(first.signals), set(second.signals)
    wanted = sorted(mine & theirs) if signals is None else [s for s in signals if s in mine & theirs]
    differences = []
    for name in wanted:
        a, b = first.series(name), second.series(name)
        if a is None or b is None or len(a.time) == 0 or len(b.time) == 0:
            continue
        if means and a.mean is not None and b.mean is not None:
            a, b = a._replace(value=a.mean), b._replace(value=b.mean)
        found = difference(name, a, b)
        if found is not None:
            differences.append(found)
    differences.sort(key=lambda d: -d.relative)
    return Comparison(differences, sorted(mine - theirs), sorted(theirs - mine))


def difference(name: str, a: Series, b: Series) -> Difference | None:
    """Difference of one signal between two runs.

    Parameters
    ----------
    name : str
        Name of the signal.
    a, b : Series
        As the first and the second run recorded it.

    Returns
    -------
    Difference or None
        None if the runs have no time in common.
    """
    common = (a.time >= b.time[0]) & (a.time <= b.time[-1])
    if not common.any():
        return None
    t, value = a.time[common], a.value[common].astype(float)
    other = np.interp(t, b.time, b.value.astype(float))
    gap = np.abs(other - value)
    gap[np.isnan(gap)] = np.inf
    k = int(np.argmax(gap))
    scale = float(np.nanmax(np.abs(value), initial=0.0))
    largest = float(gap[k])
    relative = 0.0 if largest == 0.0 else largest / scale if scale > 0.0 else np.inf
    return Difference(name, a.unit, largest, float(t[k]), float(gap.mean()), float(relative))
