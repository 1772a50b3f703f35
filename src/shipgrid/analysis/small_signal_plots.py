"""Figures of small signals: eigenvalues with the names of the dominant modes, magnitude and phase over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shipgrid.errors import ShipgridError


def _pyplot() -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise ShipgridError("a figure needs matplotlib: pip install 'shipgrid[plot]'") from None
    return plt


def draw_modes(
    eigenvalues: np.ndarray,
    named: Sequence[tuple[complex, str]],
    axes: Any | None = None,
    *,
    window: tuple[float, float] | None = None,
) -> Any:
    """Eigenvalues in the upper half plane, both axes linear near zero and logarithmic beyond.

    Parameters
    ----------
    eigenvalues : ndarray of complex
        [1/s], of a pair the one above the axis.
    named : sequence of (complex, str)
        Eigenvalues that are numbered, and their names beside the figure.
    axes : matplotlib axes, optional
        Where; a new figure if left out.
    window : (float, float), optional
        Smallest real and largest imaginary part shown [1/s].

    Returns
    -------
    matplotlib axes
    """
    if axes is None:
        _, axes = _pyplot().subplots(figsize=(9.0, 5.5), constrained_layout=True)
    assert axes is not None
    sigma_of, omega_of = np.real(eigenvalues), np.imag(eigenvalues)
    axes.plot(sigma_of, omega_of, "x", color="0.55", ms=5, mew=1.0)
    axes.set_xscale("symlog", linthresh=0.1)
    axes.set_yscale("symlog", linthresh=1.0)
    low, high = window or (1.3 * float(np.min(sigma_of)), 1.5 * max(float(np.max(omega_of)), 1.0))
    right = max(0.0, float(np.max(sigma_of)))
    axes.set_xlim(low, 0.3 if right <= 0.0 else 2.0 * right)
    axes.set_ylim(-0.5, high)
    zeta = 0.1
    sigma = -np.geomspace(1e-3, -low, 200)
    axes.plot(sigma, -sigma * np.sqrt(1.0 / zeta**2 - 1.0), lw=0.7, ls=":", color="0.6")
    axes.annotate("ζ 0.1", (sigma[120], -sigma[120] * 9.95), fontsize=7, color="0.5")
    axes.axvline(0.0, lw=0.8, color="tab:red")
    for k, (z, name) in enumerate(named, start=1):
        axes.plot(z.real, z.imag, "x", color=f"C{(k - 1) % 10}", ms=8, mew=2.0, label=f"{k}  {name}")
        axes.annotate(str(k), (z.real, z.imag), xytext=(4, 5), textcoords="offset points", fontsize=8)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    axes.grid(alpha=0.25)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=7, frameon=False)
    return axes


def draw_response(frequency: np.ndarray, value: np.ndarray, name: str, axes: Any | None = None, **style: Any) -> Any:
    """Magnitude over phase; of a matrix, its diagonal.

    Parameters
    ----------
    frequency : ndarray
        [Hz].
    value : ndarray of complex, shape (n,) or (n, m, m)
    name : str
        What it is of, with its unit.
    axes : pair of matplotlib axes, optional
        For magnitude and phase; a new figure if left out.
    **style
        Passed on to matplotlib.

    Returns
    -------
    pair of matplotlib axes
    """
    if axes is None:
        _, axes = _pyplot().subplots(2, 1, sharex=True, figsize=(8.0, 6.0), constrained_layout=True)
    assert axes is not None
    magnitude, phase = axes
    if value.ndim > 1:
        value = np.stack([value[:, k, k] for k in range(value.shape[1])], axis=1)
    magnitude.loglog(frequency, np.abs(value), **style)
    phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(value), axis=0)), **style)
    magnitude.set_ylabel(name)
    phase.set_ylabel("phase, degrees")
    phase.set_xlabel("frequency, Hz")
    for axis in axes:
        axis.grid(alpha=0.3, which="both")
    return axes
