"""Limits of a dq vector: its length with the angle kept, or what is left to one axis by the other."""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.ops import hypot, maximum


@kernel
def limit_length(d, q, longest):
    """Vector shortened to the length `longest` where it exceeds it, and 1.0 where it did, else 0.0."""
    length = hypot(d, q)
    if length.real > longest.real:
        return d * longest / length, q * longest / length, 1.0
    return d * 1.0, q * 1.0, 0.0


@kernel
def room_beside(d, longest):
    """Largest component at right angles to `d` in a vector no longer than `longest`."""
    return np.sqrt(maximum(longest * longest - d * d, 0.0))
