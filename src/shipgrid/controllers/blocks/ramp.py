"""Rate limiter: the output moves towards the input at most `rate` a second."""

from __future__ import annotations

from shipgrid.model import kernel
from shipgrid.model.ops import clip


@kernel
def ramp(u, y, rate, dt):
    """Next value of the output `y` for the input `u`."""
    return y + clip(u - y, -rate * dt, rate * dt)
