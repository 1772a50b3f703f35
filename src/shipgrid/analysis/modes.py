"""Modes: eigenvalues with names.

A mode is an eigenvalue lambda = sigma + j omega: what goes as exp(sigma t) cos(omega t). Its frequency is omega / 2 pi,
its damping ratio -sigma / |lambda|, its time constant -1 / sigma. How much a state takes part in it,

    p_k = |v_k w_k| / sum |v_k w_k|            v, w: right and left eigenvector                 (1)

has no unit and does not depend on those of the states ([Kundur1994] sec. 12.2.3). Both axes of a turning pair, and all
states of one dead time, count as one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eig

from shipgrid.analysis.small_signal_plots import draw_modes

TWINS = 0.01
SWINGS = 0.9
"""Damping ratio below which an oscillation is seen as one."""


@dataclass(frozen=True)
class Mode:
    """One real eigenvalue, or a conjugate pair (given by the one above the axis).

    Attributes
    ----------
    eigenvalue : complex
        [1/s].
    participation : dict of str to float
        Share of each state, the largest first; they sum to one.
    """

    eigenvalue: complex
    participation: dict[str, float]

    @property
    def frequency(self) -> float:
        """Frequency of the oscillation [Hz], 0 for a real eigenvalue."""
        return self.eigenvalue.imag / (2.0 * np.pi)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 for a real mode that decays, negative for one that grows."""
        size = abs(self.eigenvalue)
        return -self.eigenvalue.real / size if size > 0.0 else 0.0

    @property
    def time_constant(self) -> float:
        """Time constant of the envelope [s], negative for a mode that grows."""
        return -1.0 / self.eigenvalue.real if self.eigenvalue.real else np.inf

    @property
    def states(self) -> list[str]:
        """The states that take part most: as many as make up half of the mode, at most four."""
        found, total = [], 0.0
        for name, share in self.participation.items():
            found.append(name)
            total += share
            if total >= 0.5 or len(found) == 4:
                break
        return found

    @property
    def label(self) -> str:
        """Its name in a figure: the states that take part most, and its frequency or time constant."""
        oscillation = f"{self.frequency:.3g} Hz, ζ {self.damping:.2f}"
        size = oscillation if self.eigenvalue.imag else f"τ {self.time_constant:.3g} s"
        return f"{', '.join(self.states[:2])}  ({size})"

    def __str__(self) -> str:
        shares = ", ".join(f"{name} {100.0 * self.participation[name]:.0f} %" for name in self.states)
        oscillation = f"{self.frequency:8.2f} Hz  zeta {self.damping:6.3f}" if self.eigenvalue.imag else " " * 24
        return f"{self.eigenvalue.real:11.3f} 1/s {oscillation}  {shares}"


@dataclass(frozen=True, repr=False)
class Modes:
    """Modes of a plant beside an operating point: a sequence, the rightmost first.

    Attributes
    ----------
    modes : tuple of Mode
    """

    modes: tuple[Mode, ...]

    def __repr__(self) -> str:
        return f"<Modes: {len(self.modes)}, the rightmost {self.modes[0]}>" if self.modes else "<Modes: none>"

    def __iter__(self) -> Iterator[Mode]:
        return iter(self.modes)

    def __len__(self) -> int:
        return len(self.modes)

    def __getitem__(self, k: int) -> Mode:
        return self.modes[k]

    def __str__(self) -> str:
        return "\n".join(str(mode) for mode in self.modes)

    @property
    def eigenvalues(self) -> np.ndarray:
        """Every eigenvalue [1/s], both of a pair."""
        both = [[m.eigenvalue, np.conj(m.eigenvalue)] if m.eigenvalue.imag else [m.eigenvalue] for m in self.modes]
        return np.array([value for values in both for value in values], dtype=complex)

    @property
    def stable(self) -> bool:
        """Whether every mode decays."""
        return all(mode.eigenvalue.real < 0.0 for mode in self.modes)

    def nearest(self, eigenvalue: complex) -> Mode:
        """The mode whose eigenvalue is nearest to one [1/s].

        Parameters
        ----------
        eigenvalue : complex
            Either of a pair.
        """
        wanted = complex(eigenvalue.real, abs(eigenvalue.imag))
        return min(self.modes, key=lambda mode: abs(mode.eigenvalue - wanted))

    def of(self, state: str) -> list[Mode]:
        """Modes in which a state (or any state of a component) takes a tenth or more, the largest share first.

        Parameters
        ----------
        state : str
            Path of the state or of the component.
        """

        def share(mode: Mode) -> float:
            parts = (p for name, p in mode.participation.items() if name == state or name.startswith(f"{state}."))
            return sum(parts)

        return sorted((mode for mode in self.modes if share(mode) >= 0.1), key=share, reverse=True)

    def without(self, *parts: str) -> Modes:
        """The modes in which none of these components (with all that is under their paths) takes half or more.

        Parameters
        ----------
        *parts : str
            Paths of the components.
        """

        def share(mode: Mode) -> float:
            return sum(p for name, p in mode.participation.items() if name.startswith(tuple(f"{x}." for x in parts)))

        return Modes(tuple(mode for mode in self.modes if share(mode) < 0.5))

    def dominant(self, n: int = 9) -> list[Mode]:
        """The `n` modes that are seen longest: least damped and slowest oscillations and slowest of all.

        Of modes that are the same to 1 % (those of twins) one is taken.

        Parameters
        ----------
        n : int
            How many.
        """
        distinct: list[Mode] = []
        for mode in self.modes:
            if all(abs(mode.eigenvalue - other.eigenvalue) > TWINS * abs(other.eigenvalue) for other in distinct):
                distinct.append(mode)
        swinging = [mode for mode in distinct if mode.damping < SWINGS]
        found = sorted(swinging, key=lambda mode: mode.damping)[: n // 3]
        found += [mode for mode in swinging if mode not in found][: n // 3]
        found += [mode for mode in distinct if mode not in found][: n - len(found)]
        return sorted(found, key=lambda mode: -mode.eigenvalue.real)

    def plot(self, axes: object | None = None, *, label: int = 8, window: tuple[float, float] | None = None) -> object:
        """Draw the eigenvalues, the dominant ones with their names.

        Parameters
        ----------
        axes : matplotlib axes, optional
            Where; a new figure if left out.
        label : int
            How many modes are named.
        window : (float, float), optional
            Smallest real and largest imaginary part shown; everything if left out.

        Returns
        -------
        matplotlib axes
        """
        values = np.array([mode.eigenvalue for mode in self.modes], dtype=complex)
        named = [(mode.eigenvalue, mode.label) for mode in self.dominant(label)]
        return draw_modes(values, named, axes, window=window)


def modes_of(
    matrix: np.ndarray,
    basis: np.ndarray,
    coordinates: np.ndarray,
    groups: list[str],
    to_rate: Callable[[np.ndarray], np.ndarray] = lambda value: value,
) -> Modes:
    """Modes of a matrix on coordinates.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    basis, coordinates : ndarray, shapes (states, n) and (n, states)
        States from coordinates, and back.
    groups : list of str
        Name of each state; those of one name count as one.
    to_rate : callable
        Turns eigenvalues of the matrix into those in 1/s; what is not finite then is no mode.
    """
    decomposed: Any = eig(matrix, left=True, right=True)
    values, left, right = decomposed
    rates = to_rate(values.astype(complex))
    names, number = np.unique(groups, return_inverse=True)
    found = []
    for k, rate in enumerate(rates):
        if not np.isfinite(rate) or rate.imag < -1e-9 * abs(rate):
            continue
        if abs(rate.imag) <= 1e-9 * abs(rate):
            rate = complex(rate.real, 0.0)
        shares = np.abs((basis @ right[:, k]) * (coordinates.T @ left[:, k].conj()))
        by_name = np.bincount(number, weights=shares, minlength=len(names))
        by_name = by_name / max(float(by_name.sum()), 1e-300)
        order = np.argsort(-by_name)
        found.append(Mode(complex(rate), {str(names[j]): float(by_name[j]) for j in order if by_name[j] > 1e-3}))
    return Modes(tuple(sorted(found, key=lambda mode: (-mode.eigenvalue.real, mode.eigenvalue.imag))))
