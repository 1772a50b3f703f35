"""First-order low-pass, sampled.

    y <- y + (1 - exp(-omega_c dt)) (u - y)        (1)

Exact for an input held over the sampling period.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel


@kernel
def low_pass(u, y, omega_c, dt):
    """Next value of the filtered `y` for the input `u` and the corner `omega_c` [rad/s]."""
    return y + (1.0 - np.exp(-omega_c * dt)) * (u - y)
