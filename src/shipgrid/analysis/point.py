"""The equations of a plant at one vector of signals: residual, derivatives, and what of it stands still.

States that do not follow from (2) and (6) of `equations` are left out and stay what they are: those that only count,
those that an open contact or an active limiter holds, and codes of sequences (whatever depends on nothing that moves).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import sparse

from shipgrid.analysis.component_equations import Block, ComponentKernels
from shipgrid.analysis.equations import Equations
from shipgrid.assembly.layout import ZERO
from shipgrid.errors import SteadyStateError
from shipgrid.model.component import fields_of

LONGEST_RAMP = 2**30
"""Periods after which what still moves evenly is taken for a timer."""


class Point:
    """The equations' values and derivatives at one vector of signals.

    Parameters
    ----------
    equations : Equations
    sig : ndarray
        All signals.
    stirred : iterable of int
        Places of commands or inputs that are going to be disturbed: what depends on them is no constant.

    Attributes
    ----------
    residual : ndarray
        F of every row, rotation left out.
    triples : (rows, columns, values)
        Its derivatives, by place; an input counts as a place of its own.
    rates : ndarray of bool
        Rows that are rates.
    active : ndarray of bool
        Rows (and unknowns) that there are; the others stand still.
    period : ndarray
        Sampling period [s] of a sampled state, 0 elsewhere.
    renewed : ndarray of bool
        Constants that have to be brought up to date.
    drifting : ndarray of bool
        Ramps and timers: they move evenly, whatever else does.
    """

    def __init__(self, equations: Equations, sig: np.ndarray, stirred: Iterable[int] = ()):
        self.equations, self.sig, self.stirred = equations, sig, list(stirred)
        with np.errstate(all="ignore"):
            self.blocks = [kernels.block(sig, equations.inner) for kernels in equations.kernels]
        size = equations.size
        self.residual = np.zeros(size)
        self.rates = np.zeros(size, dtype=bool)
        self.active = np.zeros(size, dtype=bool)
        self.period = np.zeros(size)  # of a sampled state
        self.rows: list[np.ndarray] = []
        self.columns: list[np.ndarray] = []
        self.values: list[np.ndarray] = []
        for block in self.blocks:
            self._block(block)
        self._elements()
        self._network()
        self._dead_times()
        self._left_out()

    def _add(self, rows: Any, columns: Any, values: np.ndarray) -> None:
        rows, columns = np.atleast_1d(rows), np.atleast_1d(columns)
        self.rows.append(np.repeat(rows, len(columns)))
        self.columns.append(np.tile(columns, len(rows)))
        self.values.append(np.asarray(values, dtype=float).reshape(len(rows), len(columns)).ravel())

    def _block(self, block: Block) -> None:
        x, y = block.x, block.y
        if len(block.rate):
            self.active[x], self.rates[x] = True, True
            if block.sampled:
                self.residual[x] = (block.rate - self.sig[x]) / block.period
                self.period[x] = block.period
                self._add(x, block.columns, block.by_rate / block.period)
                self._add_diagonal(x, -1.0 / block.period)
            else:
                self.residual[x] = block.rate
                self._add(x, block.columns, block.by_rate)
            self.active[x[block.held]] = False
        self.active[y] = True
        self.residual[y] = block.output - self.sig[y]
        self._add(y, block.columns, block.by_output)
        self._add_diagonal(y, -1.0)

    def _add_diagonal(self, places: np.ndarray, value: float) -> None:
        self.rows.append(places)
        self.columns.append(places)
        self.values.append(np.full(len(places), value))

    def _elements(self) -> None:
        sig, e = self.sig, self.equations
        for _, x, u, y, (A, B, C, D) in e.elements:
            source = sig[e.alias[u]]
            self.residual[x] = A @ sig[x] + B @ source
            self.residual[y] = C @ sig[x] + D @ source - sig[y]
            self.active[x] = self.rates[x] = True
            self.active[y] = True
            self._add(x, np.concatenate([x, u]), np.hstack([A, B]))
            self._add(y, np.concatenate([x, u]), np.hstack([C, D]))
            self._add_diagonal(y, -1.0)
        self.active[list(e.held)] = False

    def _network(self) -> None:
        sig, e = self.sig, self.equations
        for node, (capacitance, conductance) in e.nodes.items():
            self.active[node] = True
            self.rates[node] = capacitance > 0.0
            self.residual[node] = -conductance * sig[node]
            self._add(node, node, np.array(-conductance))
        for v, i, plus, minus, c, weight in e.ports:
            self.active[v] = True
            if v in e.idle:  # its voltage is the one at which no current flows
                self.residual[v] = sig[i]
                self._add(v, i, np.array(1.0))
                continue
            across = sig[plus] - sig[minus]
            self.residual[v] = sig[c] * across - sig[v]
            self._add(v, [v, plus, minus, c], np.array([-1.0, sig[c], -sig[c], across]))
            for node, sign in ((plus, 1.0), (minus, -1.0)):
                if node != ZERO:
                    self.residual[node] -= sign * weight * sig[c] * sig[i]
                    self._add(node, [i, c], -sign * weight * np.array([sig[c], sig[i]]))
        for m, dc, weight, poles in e.meters:  # current and power out of the bus into a bridge, and counted into it
            current, v_dc = weight * sum(sig[s] * sig[i] for s, i in poles), sig[dc]
            self.active[m : m + 4] = True
            self.residual[m : m + 4] = (
                current - sig[m],
                sig[m] * v_dc - sig[m + 1],
                -sig[m] - sig[m + 2],
                -sig[m + 1] - sig[m + 3],
            )
            for s, i in poles:
                self._add(m, [s, i], weight * np.array([sig[i], sig[s]]))
            self._add(m + 1, [m, dc], np.array([v_dc, sig[m]]))
            self._add(m + 2, m, np.array(-1.0))
            self._add(m + 3, m + 1, np.array(-1.0))
            self._add_diagonal(np.arange(m, m + 4), -1.0)
        # a node with capacitance: its row becomes a rate
        self.per_farad = np.ones(e.size)
        for node, (capacitance, _) in e.nodes.items():
            if capacitance > 0.0:
                self.per_farad[node] = 1.0 / capacitance
                self.residual[node] /= capacitance

    def _dead_times(self) -> None:
        sig, e = self.sig, self.equations
        for d in e.dead_times:
            states, source = np.array(d.states), int(e.alias[d.source])
            self.residual[states] = d.A @ sig[states] + d.b * sig[source]
            self.residual[d.target] = d.c @ sig[states] + d.d * sig[source] - sig[d.target]
            self.active[states] = self.rates[states] = True
            self.active[d.target] = True
            column = d.source if e.inner[d.source] == source else source
            self._add(states, np.append(states, column), np.column_stack([d.A, d.b]))
            self._add(d.target, np.append(states, [column, d.target]), np.append(d.c, [d.d, -1.0]))

    def _left_out(self) -> None:
        """Take out what stands still: counters, angles of nothing, codes; and what depends on such alone."""
        e, layout = self.equations, self.equations.plan.layout
        angles = np.zeros(e.size, dtype=bool)
        for t in layout.types:
            for k, f in enumerate(fields_of(t.kind.state) if t.nx else ()):
                places = t.x + k + t.nx * np.arange(len(t.placed))
                if f.signal.counts:
                    self.active[places] = False
                if f.signal.rotates:
                    angles[places] = True
                    self.active[[place for place in places if place not in e.angle_island]] = False
        rows, columns, values = (np.concatenate(part) for part in (self.rows, self.columns, self.values))
        values = values * self.per_farad[rows]
        bad = ~np.isfinite(values)
        if np.any(bad):
            raise SteadyStateError(f"no derivative of {e.names[int(rows[bad][0])]} by {e.names[int(columns[bad][0])]}")
        keep = values != 0.0
        self.triples = rows[keep], columns[keep], values[keep]
        self._constants()
        self.drifting &= ~angles

    def _constants(self) -> None:
        """States and outputs of kernels that depend on nothing that moves are constants."""
        e = self.equations
        of_kernel = np.zeros(e.size, dtype=bool)
        for block in self.blocks:
            of_kernel[block.y] = True
            of_kernel[block.x] = len(block.rate) > 0
        rows, columns, values = self.triples
        disturbed = np.isin(columns, self.stirred) | np.isin(e.inner[columns], self.stirred)
        columns = e.inner[columns]
        own = rows == columns
        by_itself = np.zeros(e.size)
        np.add.at(by_itself, rows[own], values[own])
        sampled = self.period > 0.0
        kept = by_itself * self.period + 1.0  # how much of a sampled state its next value keeps
        idle = np.where(
            sampled, (kept == 1.0) | (kept == 0.0), ~self.rates | ((by_itself == 0.0) & (self.residual == 0.0))
        )
        for island in e.islands:
            if len(island.angles) == 1:  # what turns an island by itself, a modulation's reference say, is no timer
                idle[island.angles] &= self.residual[island.angles] == 0.0
        self.renewed = np.zeros(e.size, dtype=bool)  # constants that have to be brought up to date
        self.drifting = np.zeros(e.size, dtype=bool)  # ramps and timers: they move evenly, whatever else does
        while True:
            moves = np.zeros(e.size, dtype=bool)
            moves[rows[(self.active[columns] | disturbed) & ~own]] = True
            still = self.active & of_kernel & ~moves & idle
            if not np.any(still):
                return
            self.active[still] = False
            self.renewed |= still & (~sampled & ~self.rates | sampled & (kept == 0.0))
            self.drifting |= still & sampled & (kept == 1.0) & (self.residual != 0.0)

    # as matrices

    @property
    def unknown(self) -> np.ndarray:
        """Places of the unknowns."""
        return np.flatnonzero(self.active)

    def matrix(self) -> sparse.csr_matrix:
        """Derivatives of all rows by all places, an input a place of its own."""
        rows, columns, values = self.triples
        return sparse.csr_matrix((values, (rows, columns)), shape=(self.equations.size,) * 2)

    def seen(self) -> sparse.csr_matrix:
        """Matrix that hands every place to those that read it: places x places."""
        size = self.equations.size
        return sparse.csr_matrix((np.ones(size), (np.arange(size), self.equations.inner)), shape=(size, size))

    def rotation(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triples of -omega J over all pairs that are states, in (2) and (5) of `equations`.

        Parameters
        ----------
        omega : ndarray
            Frequency [rad/s] of each island.
        """
        rows, columns, values = [], [], []
        for island, speed in zip(self.equations.islands, omega, strict=True):
            for a, b in island.pairs:
                if self.rates[a] and self.active[a]:
                    rows += [a, b]
                    columns += [b, a]
                    values += [speed, -speed]
        return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64), np.array(values)

    def turned(self, omega: np.ndarray) -> np.ndarray:
        """The residual in the turning frames: (2) to (6) of `equations`.

        Parameters
        ----------
        omega : ndarray
            Frequency [rad/s] of each island.
        """
        e = self.equations
        found = self.residual.copy()
        rows, columns, values = self.rotation(omega)
        np.add.at(found, rows, values * self.sig[columns])
        for place, i in e.angle_island.items():
            period = self.period[place]
            if period > 0.0:
                found[place] = (wrapped(period * (found[place] - omega[i]))) / period
            else:
                found[place] -= omega[i]
        return found

    def arrived(self) -> np.ndarray:
        """The signals with every ramp where it arrives; what never does is a timer, and stays."""
        sig = self.sig.copy()
        for kernels in self.equations.kernels:
            for place in kernels.x[self.drifting[kernels.x]]:
                sig[place] = self._arrival(sig, kernels, int(place))
        return sig

    def _arrival(self, sig: np.ndarray, kernels: ComponentKernels, place: int) -> float:
        """Value of a state of a component where it ends to move evenly; what it is now if that never happens."""
        k = place - int(kernels.x[0])

        def pace(value: float) -> float:
            x = sig[kernels.x].copy()
            x[k] = value
            rate, _ = kernels.evaluate(
                *(v.astype(complex) for v in (x, sig[self.equations.inner[kernels.u]], sig[kernels.y]))
            )
            return float(rate[k].real) - value

        start = float(sig[place])
        first = pace(start)
        n = 1
        while n < LONGEST_RAMP and abs(pace(start + n * first) / first - 1.0) < 1e-6:
            n *= 2
        if n >= LONGEST_RAMP:
            return start
        low = n // 2
        while n - low > 1:
            middle = (low + n) // 2
            even = abs(pace(start + middle * first) / first - 1.0) < 1e-6
            low, n = (middle, n) if even else (low, middle)
        return start + n * first


def wrapped(angle: float) -> float:
    """An angle brought to -pi .. pi.

    Parameters
    ----------
    angle : float
        [rad].
    """
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
