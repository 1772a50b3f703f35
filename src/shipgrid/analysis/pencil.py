"""The linear equations beside a point, and their states by themselves.

    E dz/dt = A z + B d,        E of ones (rates) and zeros (what holds at every instant)       (1)

Sampled components: by the bilinear transformation, or held, as `linearise` says. The states by themselves,

    dx/dt = A_x x + B_x d,      z = S x + D d                                                   (2)

follow by solving the rows without rates. Where only inductances meet at a node, its voltage is in none of those rows;
it is what keeps the sum of the currents zero, so that these are fewer than they look: (2) is then given in coordinates
of the plane in which the sum vanishes.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from shipgrid.analysis.point import Point
from shipgrid.errors import ParameterError
from shipgrid.solvers.reference_network import SINGULAR

STEPS = "a current into a node where only inductances meet cannot step; ask for the response in frequency"


@dataclass(frozen=True)
class Pencil:
    """Equation (1).

    Attributes
    ----------
    point : Point
    places : ndarray of int
        Place of each unknown; a sampled state has two unknowns, itself and the one half way.
    rates : ndarray of bool
        Rows of E that are one.
    A : sparse matrix, shape (n, n)
    columns : sparse matrix, shape (n, places)
        Derivatives of the rows by every place, an input a place of its own.

    A sampled state has two unknowns of one place: what its own component computes with, and half way to the next,
    which is what others see.
    """

    point: Point
    places: np.ndarray
    rates: np.ndarray
    A: sparse.csc_matrix
    columns: sparse.csr_matrix

    def row(self, place: int) -> int:
        """Number of a place among the unknowns; of a sampled state that which others see.

        Parameters
        ----------
        place : int
            Among all signals.

        Raises
        ------
        ParameterError
            If it does not move.
        """
        found = np.flatnonzero(self.places == place)
        if not len(found):
            name = self.point.equations.names[place]
            raise ParameterError(f"'{name}' does not move at this operating point")
        return int(found[-1])


def pencil_at(point: Point, omega: np.ndarray, held: Collection[int] = ()) -> Pencil:
    """Linear equations beside a point.

    Parameters
    ----------
    point : Point
    omega : ndarray
        Frequency [rad/s] of each island.
    held : collection of int
        Places that keep their value between the instants of the clock that is treated exactly.

    Returns
    -------
    Pencil
    """
    e = point.equations
    fixed = np.zeros(e.size, dtype=bool)
    fixed[list(held)] = True
    inside = point.active & ~fixed
    if len(held):  # dead times of modulations that are held
        for d in e.dead_times:
            if fixed[d.target]:
                inside[list(d.states)] = False
    places = np.flatnonzero(inside | (fixed & point.active))
    sampled = places[(point.period[places] > 0.0) & ~fixed[places]]
    n = len(places)
    row = np.full(e.size, -1)
    row[places] = np.arange(n)
    half = np.full(e.size, -1)
    half[sampled] = n + np.arange(len(sampled))

    rows, columns, values = point.triples
    keep = (row[rows] >= 0) & ~fixed[rows]
    rows, columns, values = rows[keep], columns[keep], values[keep]
    is_half = half[rows] >= 0
    # bilinear: T dw/dt = (P - I) x + Q u, and 0 = ((P + I) x + Q u)/2 - w with P + I = (P - I) + 2 I
    triples_r = [np.where(is_half, half[rows], row[rows]), row[rows[is_half]], row[sampled]]
    triples_c = [columns, columns[is_half], sampled]
    triples_v = [values, 0.5 * point.period[rows[is_half]] * values[is_half], np.ones(len(sampled))]
    size = n + len(sampled)
    M = _matrix(triples_r, triples_c, triples_v, (size, e.size))
    turn_r, turn_c, turn_v = _turning(point, omega, fixed)
    turn_keep = row[turn_r] >= 0
    turn_half = np.where(half[turn_r] >= 0, half[turn_r], row[turn_r])[turn_keep]
    turning = _matrix([turn_half], [turn_c[turn_keep]], [turn_v[turn_keep]], (size, e.size))
    # who reads a sampled state from outside sees what was computed, held: on the mean what it is half way
    every_r, every_c, every_v = (np.concatenate(part).astype(int if k < 2 else float) for k, part in
                                 enumerate((triples_r, triples_c, triples_v)))  # fmt: skip
    of_row = np.concatenate([places, sampled])[every_r]
    seen = e.inner[every_c]
    outside = (half[seen] >= 0) & (e.owner[of_row] != e.owner[seen])
    inside_only = _matrix([every_r[~outside]], [every_c[~outside]], [every_v[~outside]], (size, e.size))
    A = (inside_only @ point.seen() + turning)[:, places]
    on_half = _matrix(
        [row[sampled], every_r[outside]],
        [np.arange(len(sampled)), half[seen[outside]] - n],
        [-np.ones(len(sampled)), every_v[outside]],
        (size, len(sampled)),
    )
    A = sparse.csc_matrix(sparse.hstack([A, on_half]))
    rates = np.concatenate([(point.rates[places] & (point.period[places] == 0.0)) | fixed[places], sampled >= 0])
    return Pencil(point, np.concatenate([places, sampled]), rates, A, M)


def _matrix(rows: list, columns: list, values: list, shape: tuple[int, int]) -> sparse.csr_matrix:
    triple = np.concatenate(values), (np.concatenate(rows).astype(int), np.concatenate(columns).astype(int))
    return sparse.csr_matrix(triple, shape=shape)


def _turning(point: Point, omega: np.ndarray, fixed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """-omega J of all pairs that are states, held ones among them."""
    rows, columns, values = point.rotation(omega)
    more: list[tuple[int, int, float]] = []
    for island, speed in zip(point.equations.islands, omega, strict=True):
        for a, b in island.pairs:
            if fixed[a] and fixed[b] and not point.rates[a]:
                more += [(a, b, speed), (b, a, -speed)]
    if not more:
        return rows, columns, values
    extra = np.array(more)
    return (
        np.concatenate([rows, extra[:, 0].astype(int)]),
        np.concatenate([columns, extra[:, 1].astype(int)]),
        np.concatenate([values, extra[:, 2]]),
    )


@dataclass(frozen=True)
class States:
    """Equation (2).

    Attributes
    ----------
    A, B : ndarray
        Of the coordinates; all states are theirs where no currents have to sum to zero.
    rows : ndarray of int
        Which unknowns of the pencil are the states.
    basis : ndarray, shape (states, coordinates)
        The states from the coordinates.
    project : ndarray, shape (states, states)
        Brings any states onto the plane in which the currents sum to zero, as a voltage impulse would.
    full, full_B, full_S : ndarray
        A, B and S on states instead of coordinates.
    S, D : ndarray
        Every unknown of the pencil from coordinates and disturbances.
    """

    A: np.ndarray
    B: np.ndarray
    rows: np.ndarray
    basis: np.ndarray
    project: np.ndarray
    full: np.ndarray
    full_B: np.ndarray
    full_S: np.ndarray
    S: np.ndarray
    D: np.ndarray

    @property
    def coordinates(self) -> np.ndarray:
        """The coordinates from states."""
        return self.basis.T @ self.project


def states_of(pencil: Pencil, B: np.ndarray | None = None, *, steps: bool = False) -> States:
    """Eliminate everything that is no state.

    Parameters
    ----------
    pencil : Pencil
    B : ndarray, optional
        Columns of disturbances.
    steps : bool
        The disturbances may step: refuse those that then make an impulse.

    Raises
    ------
    ParameterError
        If they would.
    """
    A, size = pencil.A.toarray(), len(pencil.places)
    B = np.zeros((size, 0)) if B is None else B
    x, w = np.flatnonzero(pencil.rates), np.flatnonzero(~pencil.rates)
    n = len(x)
    A_ww = A[np.ix_(w, w)]
    balance = 1.0 / np.maximum(np.max(np.abs(A_ww), axis=1, initial=0.0), 1e-12)
    rest = balance[:, None] * np.hstack([A[np.ix_(w, x)], B[w]])
    left, values, right = np.linalg.svd(balance[:, None] * A_ww)
    null = values <= SINGULAR * np.max(values, initial=1.0)
    W = -(right[~null].T / values[~null]) @ (left[:, ~null].T @ rest)  # w from states and disturbances, so far
    A_xw = A[np.ix_(x, w)]
    A_x, B_x = A[np.ix_(x, x)] + A_xw @ W[:, :n], B[x] + A_xw @ W[:, n:]
    basis = project = np.eye(n)
    if np.any(null):
        Q, into = left[:, null].T @ rest[:, :n], left[:, null].T @ rest[:, n:]
        if steps and np.any(np.abs(into) > 1e-9 * np.max(np.abs(rest))):
            raise ParameterError(STEPS)
        P = A_xw @ right[null].T
        seen = np.max(np.abs(Q), axis=1) > 1e-12  # the others are nodes with nothing on them
        if np.any(seen):
            Q = Q[seen] / np.max(np.abs(Q[seen]), axis=1)[:, None]
            back = np.linalg.pinv(Q @ P, rcond=1e-9) @ Q
            project = np.eye(n) - P @ back
            basis = null_space(Q, rcond=1e-9)
            W = W - right[null].T @ np.hstack([back @ A_x, back @ B_x])
            A_x, B_x = project @ A_x, project @ B_x
    S, D = np.zeros((size, n)), np.zeros((size, B.shape[1]))
    S[x, np.arange(n)] = 1.0
    S[w], D[w] = W[:, :n], W[:, n:]
    into_basis = basis.T @ project
    return States(
        into_basis @ A_x @ basis, into_basis @ B_x, x, basis, project, A_x, B_x, S, S @ basis, D
    )  # fmt: skip
