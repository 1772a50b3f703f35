"""Dead times as rational functions between two signals: Pade quotients, with states of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import factorial


@dataclass(frozen=True)
class DeadTime:
    """A dead time between two signals, as a rational function with states of its own.

    Attributes
    ----------
    source, target : int
        Places of what goes in and of what comes out.
    states : range
        Places of its states.
    A, b, c, d : ndarray, ndarray, ndarray, float
        dx/dt = A x + b source, target = c x + d source.
    """

    source: int
    target: int
    states: range
    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


def pade(delay: float, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """State-space form A, b, c, d of a Pade quotient.

    Parameters
    ----------
    delay : float
        Dead time [s].
    order : int
        Of numerator and denominator: as many states.
    """
    from scipy.signal import tf2ss  # a third of a second, which a run has no use for

    k = np.arange(order + 1)
    a = factorial(2 * order - k) / (factorial(k) * factorial(order - k))  # of s^k; the numerator has (-s)^k
    A, B, C, D = tf2ss(((-1.0) ** k * a)[::-1], a[::-1])
    return A / delay, B[:, 0] / delay, C[0], float(D[0, 0])
