"""Proportional-integral controller with conditional integration.

    u* = K_p e + x + ff,   u = clip(u*)                          (1)
    dx = K_i e dt  where u = u* or e (u* - u) < 0, else 0        (2)

The integrator stands still while the output is limited and the error would drive it further. Every controller that
does not say otherwise uses it (docs/theory/converters.md, eq. (converters-1)).
"""

from __future__ import annotations

from shipgrid.model import kernel, signal
from shipgrid.model.ops import clip
from shipgrid.units import Ratio


class PiState:
    """State of one controller, in the unit of its output."""

    i: Ratio = signal("integrator", initial=0.0)


@kernel
def pi(e, ff, k_p, k_i, low, high, dt, x, x_next):
    """Output of the controller for the error `e`, with the feed-forward `ff`, held between `low` and `high`."""
    wanted = k_p * e + x.i + ff
    u = clip(wanted, low, high)
    excess = (wanted - u).real
    x_next.i = x.i + (k_i * e * dt if excess == 0.0 or e.real * excess < 0.0 else 0.0)
    return u
