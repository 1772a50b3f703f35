"""Elementary operations that are right for real numbers and for complex ones.

The imaginary part belongs to differentiation: a kernel called with `x + 1e-40j` returns its derivative there. These
functions branch on real parts and carry the imaginary part along; plain `abs`, `min`, `max` and `arctan2` do not.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from shipgrid.model.kernel import kernel


@kernel
def absolute(a):
    """Magnitude of `a`, with the sign of the derivative right on both sides."""
    return -a if a.real < 0.0 else a


@kernel
def minimum(a, b):
    """The smaller of two, by real part; a value that is no number is handed on, so that the step's check sees it."""
    return a if a.real <= b.real or a.real != a.real else b


@kernel
def maximum(a, b):
    """The larger of two, by real part; a value that is no number is handed on."""
    return a if a.real >= b.real or a.real != a.real else b


@kernel
def clip(a, low, high):
    """`a` held between `low` and `high`, by real part."""
    return minimum(maximum(a, low), high)


@kernel
def sign(a):
    """1.0, 0.0 or -1.0 by real part."""
    return 1.0 if a.real > 0.0 else (-1.0 if a.real < 0.0 else 0.0)


@kernel
def hypot(a, b):
    """Length of a vector; its derivative at zero is taken as zero."""
    squared = a * a + b * b
    return np.sqrt(squared) if squared.real > 0.0 else 0.0 * squared


def _arctan2(y: Any, x: Any) -> Any:
    if isinstance(y, complex) or isinstance(x, complex):
        y, x = complex(y), complex(x)
        angle, squared = math.atan2(y.real, x.real), x.real**2 + y.real**2
        return complex(angle, (x.real * y.imag - y.real * x.imag) / squared if squared > 0.0 else 0.0)
    return math.atan2(y, x)


@overload(_arctan2)
def _overload_arctan2(y, x):
    if isinstance(y, types.Complex) or isinstance(x, types.Complex):

        def for_complex(y, x):
            angle, squared = math.atan2(y.real, x.real), x.real**2 + y.real**2
            return complex(angle, (x.real * y.imag - y.real * x.imag) / squared if squared > 0.0 else 0.0)

        return for_complex
    return lambda y, x: math.atan2(y, x)


@kernel
def arctan2(y, x):
    """Angle of the vector (x, y), from -pi to pi; its derivative at zero is taken as zero."""
    return _arctan2(y, x)


@kernel
def wrap(angle):
    """`angle` brought into -pi .. pi by whole turns."""
    return angle - 2.0 * math.pi * np.floor((angle.real + math.pi) / (2.0 * math.pi))


@kernel
def interp(a, tables, start, n, low, step):
    """Linear interpolation in an equidistant table of `n` values at `tables[start:]`, held constant outside it.

    Parameters
    ----------
    a : float
        Where.
    tables : ndarray
        Pool of tables.
    start, n : int
        Where this table lies in the pool, and its length.
    low, step : float
        Argument of its first value, and the distance between two.
    """
    place = clip((a - low) / step, 0.0, n - 1.0)
    k = min(int(place.real), n - 2) if place.real > 0.0 else 0  # 0 as well where the place is no number
    f = place - k
    return tables[start + k] * (1.0 - f) + tables[start + k + 1] * f


@kernel
def catmull_rom(f):
    """Weights of four neighbouring values at the fraction `f` between the middle two: a cubic without kinks.

    Slopes at the middle two are their central differences, so that value and slope meet from interval to interval.
    """
    return (
        0.5 * f * (f * (2.0 - f) - 1.0),
        0.5 * (f * f * (3.0 * f - 5.0) + 2.0),
        0.5 * f * (f * (4.0 - 3.0 * f) + 1.0),
        0.5 * f * f * (f - 1.0),
    )
