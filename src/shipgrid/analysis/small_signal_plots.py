"""Figures of small signals: eigenvalues with the names of the dominant modes, magnitude and phase over frequency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from shipgrid.errors import ShipgridError

if TYPE_CHECKING:
    from shipgrid.analysis.frequency_response import FrequencyResponse
    from shipgrid.analysis.modes import Mode, Modes


def _pyplot() -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise ShipgridError("a figure needs matplotlib: pip install 'shipgrid[plot]'") from None
    return plt


def mode_label(mode: Mode) -> str:
    """What a mode is called in a figure: the states that take part most, and its frequency or time constant."""
    size = f"{mode.frequency:.3g} Hz, ζ {mode.damping:.2f}" if mode.eigenvalue.imag else f"τ {mode.time_constant:.3g} s"
    return f"{', '.join(mode.states[:2])}  ({size})"


def draw_modes(
    modes: Modes, axes: Any | None = None, *, label: int = 8, window: tuple[float, float] | None = None
) -> Any:
    """Eigenvalues in the upper half plane, both axes linear near zero and logarithmic beyond.

    Parameters
    ----------
    modes : Modes
    axes : matplotlib axes, optional
    label : int
        How many dominant modes are numbered, and named beside the figure.
    window : (float, float), optional
        Smallest real and largest imaginary part shown [1/s].
    """
    if axes is None:
        _, axes = _pyplot().subplots(figsize=(9.0, 5.5), constrained_layout=True)
    assert axes is not None
    values = np.array([mode.eigenvalue for mode in modes], dtype=complex)
    sigma_of, omega_of = np.real(values), np.imag(values)
    named = modes.dominant(label)
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
    for k, mode in enumerate(named, start=1):
        z = mode.eigenvalue
        axes.plot(z.real, z.imag, "x", color=f"C{(k - 1) % 10}", ms=8, mew=2.0, label=f"{k}  {mode_label(mode)}")
        axes.annotate(str(k), (z.real, z.imag), xytext=(4, 5), textcoords="offset points", fontsize=8)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    axes.grid(alpha=0.25)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=7, frameon=False)
    return axes


def draw_response(response: FrequencyResponse, axes: Any | None = None, **style: Any) -> Any:
    """Magnitude over phase; of a matrix, its diagonal.

    Parameters
    ----------
    response : FrequencyResponse
    axes : pair of matplotlib axes, optional
    **style
        Passed on to matplotlib.
    """
    if axes is None:
        _, axes = _pyplot().subplots(2, 1, sharex=True, figsize=(8.0, 6.0), constrained_layout=True)
    assert axes is not None
    magnitude, phase = axes
    value = response.value
    if value.ndim > 1:
        value = np.stack([value[:, k, k] for k in range(value.shape[1])], axis=1)
    magnitude.loglog(response.frequency, np.abs(value), **style)
    phase.semilogx(response.frequency, np.degrees(np.unwrap(np.angle(value), axis=0)), **style)
    magnitude.set_ylabel(response.name)
    phase.set_ylabel("phase, degrees")
    phase.set_xlabel("frequency, Hz")
    for axis in axes:
        axis.grid(alpha=0.3, which="both")
    return axes
