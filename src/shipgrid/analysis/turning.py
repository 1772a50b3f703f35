"""Eigenvalues that say nothing, and names of states without their axes.

A plant that turns evenly also rests in any other direction: each island has an eigenvalue at zero, or at one over a
period, that says nothing. It is taken out by counting the island's angles from one of them.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space

from shipgrid.analysis.steady_state import OperatingPoint

INVARIANT = 1e-6
"""Turning an island counts as free if it changes no rate by more than this share of its terms (of its largest
coefficient, where those vanish)."""


def state_names(point: OperatingPoint) -> dict[int, str]:
    """Names of places, without the axis of a turning pair and the number of a dead time's state.

    Parameters
    ----------
    point : OperatingPoint
    """
    names = {place: name.partition(" (dead time")[0] for place, name in point.equations.names.items()}
    for island in point.equations.islands:
        for pair in island.pairs:
            for place, axis in zip(pair, ("alpha", "beta"), strict=True):
                names[place] = names[place].replace(f".{axis}.", ".").replace(f"_{axis}", "").removesuffix(f".{axis}")
    return names


def without_turning(
    A: np.ndarray,
    basis: np.ndarray,
    coordinates: np.ndarray,
    generators: list[np.ndarray],
    places: np.ndarray,
    point: OperatingPoint,
    fixed: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Count the angles of each island that may point anywhere from one of them.

    Parameters
    ----------
    A : ndarray
        Matrix on coordinates.
    basis, coordinates : ndarray
        States from coordinates and back.
    generators : list of ndarray
        For each island, what turning it does to the states.
    places : ndarray of int
        Places of the states.
    point : OperatingPoint
    fixed : float
        Eigenvalue of what does not change: 0 for rates, 1 for a period.
    """
    for island, g in zip(point.equations.islands, generators, strict=True):
        angles = [int(np.flatnonzero(places == place)[0]) for place in island.angles if place in places]
        if not angles:
            continue
        count = basis[angles[0]]  # the angle it is counted from, from the coordinates
        turn = _at_rest(A - fixed * np.eye(len(A)), coordinates @ g, count)
        if turn is None:
            continue
        keep = null_space(count[None, :])
        back = keep.T @ (np.eye(len(turn)) - np.outer(turn, count) / (count @ turn))
        A, basis, coordinates = back @ A @ keep, basis @ keep, back @ coordinates
    return A, basis, coordinates


def _at_rest(A: np.ndarray, turn: np.ndarray, count: np.ndarray) -> np.ndarray | None:
    """The turn with what follows it (a meter that compares two islands sees it), if the plant rests after it."""
    rows = 1.0 / np.maximum(np.max(np.abs(A), axis=1), 1e-300)
    scaled = rows[:, None] * A
    left = scaled @ turn
    if np.any(np.abs(left) > INVARIANT):
        columns = 1.0 / np.maximum(np.max(np.abs(scaled), axis=0), 1e-300)
        with_count = np.vstack([scaled * columns, count * columns])
        turn = turn + columns * np.linalg.lstsq(with_count, np.append(-left, 0.0), rcond=1e-10)[0]
    return turn if np.all(np.abs(scaled @ turn) <= INVARIANT * (1.0 + np.abs(scaled) @ np.abs(turn))) else None
