"""The search of an operating point: Newton's method on the equations of a plant, its frequencies among the unknowns.

A signal that is held is an equation more, and what is set free for it an unknown more. The angle of one rotor or
controller of each island is kept: it means nothing, and the island's frequency is found in its place.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import MatrixRankWarning, splu

from shipgrid.analysis.equations import Equations
from shipgrid.analysis.point import Point
from shipgrid.errors import SteadyStateError

ITERATIONS = 60
CONVERGED = 1e-9
"""Largest last step of Newton's method, relative to the size of each signal (or to 1, if that is larger)."""
HALVINGS = 8
FIRST_STEP, LAST_STEP, GROWTH, LONGEST_SEARCH = 1e-4, 1e5, 1.7, 150
"""Steps in time [s] by which a search that fails starts again, by how much they grow, and how many there are."""
RESTS = 1e-9
"""Residual, each equation over its largest term, below which rounding decides and a step is taken as it comes."""
QUIET = 3
"""Iterations without a change of any code, after which what still changes is taken for timers."""


def jacobian(point: Point, omega: np.ndarray) -> sparse.csr_matrix:
    """Derivatives of the turned residual by all places, inputs handed to their sources.

    Parameters
    ----------
    point : Point
    omega : ndarray
        Frequency [rad/s] of each island.
    """
    rows, columns, values = point.rotation(omega)
    size = point.equations.size
    return point.matrix() @ point.seen() + sparse.csr_matrix((values, (rows, columns)), shape=(size, size))


class NewtonSearch:
    """Newton's method, and what it needs where it starts too far away.

    Parameters
    ----------
    equations : Equations
    held : ndarray of int
        Places of the signals that have to have a value.
    wanted : ndarray
        These values.
    freed : ndarray of int
        Places of as many commands or open inputs, whose values are found.
    """

    def __init__(self, equations: Equations, held: np.ndarray, wanted: np.ndarray, freed: np.ndarray):
        self.equations, self.held, self.wanted, self.freed = equations, held, wanted, freed
        self.point, self.omega, self.step = None, np.zeros(0), np.inf

    def newton(self, sig: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Signals, frequencies and the last step; None if the search fails.

        Parameters
        ----------
        sig : ndarray
            All signals where it starts.
        omega : ndarray
            Frequency [rad/s] of each island there.
        """
        try:
            point = Point(self.equations, sig)
        except SteadyStateError:
            return None
        point = Point(self.equations, point.arrived())
        quiet, norm = 0, self.norm(point, omega)
        for _ in range(ITERATIONS):
            stale = point.renewed & (point.residual != 0.0)
            move_sig, move_omega = self.move(point, omega)
            share, found, new_norm = 1.0, point, np.inf
            for _ in range(HALVINGS):
                found, trial_omega = self.after(point, share * move_sig), omega + share * move_omega
                new_norm = np.inf if found is None else self.norm(found, trial_omega)
                if new_norm < norm or norm < RESTS or (np.isfinite(new_norm) and np.any(stale)):
                    break
                share *= 0.5
            if found is None or (not new_norm < 2.0 * max(norm, RESTS) and not np.any(stale)):
                return None
            point, omega, norm = found, omega + share * move_omega, new_norm
            step = float(np.max(np.abs(share * move_sig) / np.maximum(np.abs(point.sig), 1.0), initial=0.0))
            self.point, self.omega, self.step = point, omega, step
            quiet = quiet + 1 if not np.any(stale & ~point.rates) else 0  # codes at rest; timers may run on
            if step < CONVERGED and (not np.any(stale) or quiet >= QUIET):
                sig = point.arrived()
                if np.array_equal(sig, point.sig):
                    return sig, omega, step
                point = Point(self.equations, sig)  # a ramp has moved on: the rest follows
                norm = self.norm(point, omega)
        return None

    def slowly(self, sig: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearer to rest: implicit Euler steps in time that grow, which a stable plant follows from anywhere.

        Parameters
        ----------
        sig : ndarray
            All signals where it starts.
        omega : ndarray
            Frequency [rad/s] of each island there.
        """
        point, tau = Point(self.equations, Point(self.equations, sig).arrived()), FIRST_STEP
        for _ in range(LONGEST_SEARCH):
            move_sig, move_omega = self.move(point, omega, tau)
            found = self.after(point, move_sig)
            if found is None or np.max(np.abs(move_sig) / np.maximum(np.abs(point.sig), 10.0)) > 10.0:
                tau *= 0.25
                if tau < 1e-3 * FIRST_STEP:
                    break
                continue
            point, omega, tau = found, omega + move_omega, GROWTH * tau
            if tau > LAST_STEP:
                break
        return point.sig, omega

    def after(self, point: Point, move: np.ndarray) -> Point | None:
        """The equations after a step; constants that depend on what moved are brought up to date.

        Parameters
        ----------
        point : Point
        move : ndarray
            Of all signals.
        """
        sig = point.sig + move
        stale = point.renewed & (point.residual != 0.0)
        sig[stale] += np.where(point.period > 0.0, point.period, 1.0)[stale] * point.residual[stale]
        try:
            return Point(self.equations, sig)
        except (SteadyStateError, ValueError, OverflowError):  # where it went there are no numbers
            return None

    def norm(self, point: Point, omega: np.ndarray) -> float:
        """Size of the residual, each equation over its largest coefficient.

        Parameters
        ----------
        point : Point
        omega : ndarray
            Frequency [rad/s] of each island.
        """
        found = (point.turned(omega) / largest_coefficients(point))[point.unknown]
        size = float(np.sqrt(np.sum(found**2) + np.sum((point.sig[self.held] - self.wanted) ** 2)))
        return size if np.isfinite(size) else np.inf

    def move(self, point: Point, omega: np.ndarray, tau: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """A step of Newton's method; of implicit Euler's, if a time is given. Of signals and frequencies.

        Parameters
        ----------
        point : Point
        omega : ndarray
            Frequency [rad/s] of each island.
        tau : float
            The time [s].
        """
        e, sig, held, wanted, freed = self.equations, point.sig, self.held, self.wanted, self.freed
        unknown = np.concatenate([point.unknown, freed])
        F = np.concatenate([point.turned(omega)[point.unknown], sig[held] - wanted])
        full = jacobian(point, omega)
        top = full[point.unknown][:, unknown]
        if np.isfinite(tau):
            still = np.concatenate([point.rates[point.unknown] / tau, np.zeros(len(freed))])
            top = top - sparse.diags(still).tocsr()[: len(point.unknown)]
        bottom = sparse.csr_matrix(
            (np.ones(len(held)), (np.arange(len(held)), _position(unknown, held))), shape=(len(held), len(unknown))
        )
        turning = [
            (i, next(place for place in island.angles if point.active[place]))
            for i, island in enumerate(e.islands)
            if any(point.active[place] for place in island.angles)
        ]
        row = np.full(e.size, -1)
        row[point.unknown] = np.arange(len(point.unknown))
        by_omega = sparse.lil_matrix((len(F), len(turning)))
        gauge = sparse.lil_matrix((len(turning), len(unknown) + len(turning)))
        for column, (i, place) in enumerate(turning):
            island = e.islands[i]
            for a, b in island.pairs:
                if point.rates[a] and point.active[a]:
                    by_omega[row[a], column] = sig[b]
                    by_omega[row[b], column] = -sig[a]
            for angle in island.angles:
                if point.active[angle]:
                    by_omega[row[angle], column] = -1.0
            gauge[column, row[place]] = 1.0
        J = sparse.vstack([sparse.hstack([sparse.vstack([top, bottom]), by_omega]), gauge]).tocsc()
        found = _solve(J, -np.concatenate([F, np.zeros(len(turning))]))
        move, move_omega = np.zeros(e.size), np.zeros(len(e.islands))
        move[unknown] = found[: len(unknown)]
        move_omega[[i for i, _ in turning]] = found[len(unknown) :]
        return move, move_omega

    def complaint(self) -> str:
        """What to tell the user where there is no operating point, or none is found."""
        point, e = self.point, self.equations
        if point is None:
            return "no operating point: the search diverged at once; start it nearer, or from a run"
        residual = np.where(point.active, np.abs(point.turned(self.omega)), 0.0)
        worst = int(np.argmax(residual / largest_coefficients(point)))
        active = [path for path in e.plan.limiter_paths if point.sig[e.plan.layout.index[path]] > 0.5]
        limits = f"; limits active: {', '.join(active)}" if active else ""
        return (
            f"no operating point: the last step is still {self.step:.1e} of a signal's size; "
            f"largest residual {residual[worst]:.3g} at {e.names[worst]}{limits}"
        )


def largest_coefficients(point: Point) -> np.ndarray:
    """Largest coefficient of each equation, or 1, if that is larger.

    Parameters
    ----------
    point : Point
    """
    rows, _, values = point.triples
    scale = np.ones(point.equations.size)
    np.maximum.at(scale, rows, np.abs(values))
    return scale


def _position(unknown: np.ndarray, places: np.ndarray) -> np.ndarray:
    where = {int(place): k for k, place in enumerate(unknown)}
    missing = [int(place) for place in places if int(place) not in where]
    if missing:
        raise SteadyStateError("a signal that is held does not move: nothing it depends on is free")
    return np.array([where[int(place)] for place in places], dtype=np.int64)


def _solve(J: Any, right: np.ndarray) -> np.ndarray:
    """Solution of J x = right; the shortest one where J leaves something open (a bus without voltage, say)."""
    rows = np.asarray(np.abs(J).max(axis=1).todense()).ravel()
    rows = 1.0 / np.where(rows > 0.0, rows, 1.0)
    scaled = sparse.diags(rows) @ J
    columns = np.asarray(np.abs(scaled).max(axis=0).todense()).ravel()
    columns = 1.0 / np.where(columns > 0.0, columns, 1.0)
    scaled = (scaled @ sparse.diags(columns)).tocsc()
    right = rows * right
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", MatrixRankWarning)
            x = splu(scaled).solve(right)
        if np.all(np.isfinite(x)) and np.max(np.abs(scaled @ x - right)) <= 1e-8 * max(np.max(np.abs(right)), 1e-300):
            return columns * x
    except (RuntimeError, MatrixRankWarning):
        pass  # singular: the shortest solution is asked for below
    x = np.linalg.lstsq(scaled.toarray(), right, rcond=1e-12)[0]
    return columns * x
