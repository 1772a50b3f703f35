"""Integration of the reference solver: from one instant to the next, over the events of the diodes in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import Radau

from shipgrid.errors import SolverError
from shipgrid.solvers.reference_plant import ReferencePlant

DIFFERENCE = 1e-7
"""Relative step of the Jacobian's forward differences: half the digits."""
JACOBIAN_LIFE = 40
"""Segments for which a Jacobian is used again: it only steers Newton's iteration and never the result."""
LOOKS = 4
"""How often in a step of the integration the conditions of the diodes are looked at."""
CLOSE = 1e-14
"""Time [s] between two integrations that count as one."""
SEARCH = 60
"""Most integrations that look for one event."""


class Integration:
    """SciPy's Radau method on a plant.

    Parameters
    ----------
    plant : ReferencePlant
    rtol, atol : float
        Relative tolerance; absolute one on the size of a state.
    """

    def __init__(self, plant: ReferencePlant, rtol: float, atol: float):
        self.plant, self.rtol, self.atol = plant, rtol, atol
        self.jacobians: dict[Any, tuple[np.ndarray, int]] = {}  # by topology; segments that each has served

    def integrate(self, t: float, seconds: float) -> None:
        """From an instant to the next, over the events in between; time is counted so that it keeps its digits.

        Parameters
        ----------
        t : float
            Time of the first [s].
        seconds : float
            From there to the next [s].

        Raises
        ------
        SolverError
            If the integration fails, or no state of the diodes holds.
        """
        gone = 0.0
        while gone < seconds:
            gone += self._to_event(t + gone, seconds - gone)
            if gone < seconds:
                self.plant.conduct()

    def _to_event(self, t: float, seconds: float) -> float:
        """To the first event of the diodes, at most `seconds` on: returns how far."""
        plant = self.plant
        z = plant.sig[plant.places]
        margins = np.array([c.margin for c in plant.conditions(z)])
        floor = np.minimum(margins, 0.0) - 1.0
        looks = LOOKS if plant.network.diodes.any_free else 1

        def excess(at: float, z: np.ndarray) -> float:
            """By how many of their tolerances the conditions hold at a time from here, or fail."""
            plant.t = t + at
            return float(np.min(np.array([c.margin for c in plant.conditions(z)]) - floor, initial=np.inf))

        topology = plant.network.topology
        if topology in self.jacobians:
            jacobian, age = self.jacobians[topology]
            self.jacobians[topology] = jacobian, age + 1
        solver = self._solver(t, z, seconds)
        good, left = float(np.min(margins - floor, initial=np.inf)), 0.0
        while solver.status == "running":
            start, z = solver.t, solver.y
            _step(solver, t)
            between = solver.dense_output()
            for at in np.linspace(start, solver.t, looks + 1)[1:].tolist():
                found = excess(at, solver.y if at == solver.t else between(at))
                if found < 0.0:
                    return self._land(t, (start, z), (left, good), (at, found), excess)
                left, good = at, found
        return seconds

    def _land(
        self,
        t: float,
        start: tuple[float, np.ndarray],
        low: tuple[float, float],
        high: tuple[float, float],
        excess: Callable[[float, np.ndarray], float],
    ) -> float:
        """Integrate to where a condition fails by less than one tolerance: returns when, counted from t.

        Parameters
        ----------
        t : float
            Origin of the times [s].
        start : (float, ndarray)
            Time and state from which to integrate.
        low, high : (float, float)
            Time and `excess` before the event, and after it.
        excess : callable
        """
        (a, f_a), (b, f_b) = (low[0], low[1] + 0.5), (high[0], high[1] + 0.5)
        side = 0
        for _ in range(SEARCH):
            at = b - f_b * (b - a) / (f_b - f_a) if f_b < 0.0 and b - a > CLOSE else b
            solver = self._solver(t + start[0], start[1], at - start[0])
            while solver.status == "running":
                _step(solver, t)
            found = excess(at, solver.y) + 0.5
            if abs(found) < 0.5 or at == b:
                return at
            if found < 0.0:  # false position, the end that stays counting half [Dowell1971]
                b, f_b, f_a, side = at, found, f_a * (0.5 if side < 0 else 1.0), -1
            else:
                a, f_a, f_b, side = at, found, f_b * (0.5 if side > 0 else 1.0), 1
        raise SolverError(f"reference run: no event of a diode found at {t:.9f} s")

    def _solver(self, t: float, z: np.ndarray, seconds: float) -> Radau:
        """The integration from z on, at the time t."""
        plant = self.plant
        asked_at, topology = -1.0, plant.network.topology

        def slope(at: float, z: np.ndarray) -> np.ndarray:
            """The last Jacobian, unless it is old, or Newton's iteration failed with it (it is asked for again)."""
            nonlocal asked_at
            jacobian, age = self.jacobians.get(topology, (None, JACOBIAN_LIFE))
            if jacobian is None or age >= JACOBIAN_LIFE or at == asked_at:
                jacobian = self._jacobian(z)
                self.jacobians[topology] = jacobian, 0
            asked_at = at
            return jacobian

        def right(at: float, z: np.ndarray) -> np.ndarray:
            plant.t = t + at
            return plant.rates(z)

        scale: Any = self.atol * plant.size  # SciPy takes an array, its types do not say so
        return Radau(right, 0.0, z, seconds, rtol=self.rtol, atol=scale, jac=slope, first_step=seconds)

    def _jacobian(self, z: np.ndarray) -> np.ndarray:
        """d(dz/dt)/dz by forward differences."""
        plant = self.plant
        base = plant.rates(z)
        found = np.empty((len(z), len(z)))
        for k in range(len(z)):
            step = DIFFERENCE * max(abs(z[k]), plant.size[k])
            moved = z.copy()
            moved[k] += step
            found[:, k] = (plant.rates(moved) - base) / step
        return found


def _step(solver: Radau, t: float) -> None:
    message = solver.step()
    if solver.status == "failed":
        raise SolverError(f"reference run failed at {t + solver.t:.9f} s: {message}")
