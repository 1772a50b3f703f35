"""Reference frames, one convention, stated once.

Amplitude-invariant Clarke and Park: `x_alpha = x_a` for a balanced set, so p = 3/2 (v_alpha i_alpha + v_beta i_beta).
The q axis leads the d axis by 90 degrees; `theta` is the angle of the d axis from the alpha axis. Ship grids are
three-wire (insulated neutral, IEC 60092-502), so that no zero sequence current flows and alpha-beta holds all of it.
"""

from __future__ import annotations

import math

from shipgrid.model.kernel import kernel

SQRT3_2 = math.sqrt(3.0) / 2.0

PHASES = {"a": (1.0, 0.0), "b": (-0.5, SQRT3_2), "c": (-0.5, -SQRT3_2)}
"""Each phase quantity as a weighted sum of its alpha-beta vector."""


@kernel
def abc_to_alpha_beta(a, b, c):
    """Clarke transform of three phase quantities without their zero sequence."""
    return (2.0 * a - b - c) / 3.0, (b - c) / (2.0 * SQRT3_2)


@kernel
def alpha_beta_to_abc(alpha, beta):
    """Phase quantities of an alpha-beta vector."""
    return alpha, -0.5 * alpha + SQRT3_2 * beta, -0.5 * alpha - SQRT3_2 * beta


@kernel
def rotate(alpha, beta, cos, sin):
    """Alpha-beta to dq, for the cosine and sine of the d axis' angle."""
    return cos * alpha + sin * beta, cos * beta - sin * alpha


@kernel
def unrotate(d, q, cos, sin):
    """Dq to alpha-beta, for the cosine and sine of the d axis' angle."""
    return cos * d - sin * q, sin * d + cos * q
