"""Poles of a plant with sampled control, exactly: one sampling period as a matrix.

At an instant the modulation computed a period ago comes into force, and the controllers of that clock sample and
compute; until the next instant the rest of the plant is a differential equation in which all that stands still. In the
turning frame a vector that stands still turns backwards:

    z+ = R(-omega T) flow(jump(z))                                                          (1)

A plant that turns evenly repeats itself from period to period in that frame: z+ = z, which Newton's method finds, with
the sawtooth that is inside the period. The derivative of (1) there, put together from the kernels' complex steps,

    M = exp(h A_n) ... exp(h A_2) exp(h A_1) J                                              (2)

has the multipliers of the sampled system; J is that of the jump, A_j that of the plant in the middle of a part of the
period. The poles are ln(mu) / T. Components on other clocks are in A as `linearise` takes them (bilinear, dead time of
their modulation by a Pade quotient), so (2) is exact for a plant with one rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from shipgrid.analysis.component_equations import ComponentKernels
from shipgrid.analysis.equations import Equations
from shipgrid.analysis.modes import Modes, modes_of
from shipgrid.analysis.pencil import pencil_at, states_of
from shipgrid.analysis.point import Point, wrapped
from shipgrid.analysis.steady_state import OperatingPoint, input_place
from shipgrid.analysis.step_response import Response
from shipgrid.analysis.turning import state_names, without_turning
from shipgrid.assembly.plan import Plan
from shipgrid.errors import ParameterError, SteadyStateError
from shipgrid.model.component import STAGES

PARTS = 6
"""Parts of a period in (2). What is held turns by omega T / PARTS in one, 2 degrees at 60 Hz and 1620 Hz."""
ITERATIONS, CONVERGED = 12, 1e-9
SMALL = 1e-4
"""Part of a step of which the effect over one period is taken as that of the whole, by a central difference."""
FORGOTTEN = 1e-3
"""A multiplier below this is that of a signal forgotten within a few periods (rounding spreads it round zero)."""


@dataclass(frozen=True)
class SampledModel:
    """A plant beside its periodic state, the controllers of one clock as they are.

    Attributes
    ----------
    plan : Plan
    point : OperatingPoint
        The mean operating point that it belongs to.
    period : float
        Sampling period [s].
    sig : ndarray
        Every signal just before a sampling instant, in the turning frames.
    omega : ndarray
        Frequency [rad/s] of each island.
    M : ndarray
        (2), on the states.
    """

    plan: Plan
    point: OperatingPoint
    period: float
    sig: np.ndarray
    omega: np.ndarray
    M: np.ndarray
    basis: np.ndarray
    coordinates: np.ndarray
    places: np.ndarray
    generators: list[np.ndarray]

    def modes(self) -> Modes:
        """Poles of the sampled system with the states that take part in each."""
        matrix = self.coordinates @ self.M @ self.basis
        generators = [g[self.places] for g in self.generators]
        matrix, basis, coordinates = without_turning(
            matrix, self.basis, self.coordinates, generators, self.places, self.point, fixed=1.0
        )
        names = state_names(self.point)

        def to_rate(mu: np.ndarray) -> np.ndarray:
            with np.errstate(divide="ignore"):
                return np.where(np.abs(mu) > FORGOTTEN, np.log(mu), np.nan) / self.period

        return modes_of(matrix, basis, coordinates, [names[int(p)] for p in self.places], to_rate)

    def step(self, at: str, amount: float, until: float, signals: Sequence[str]) -> Response:
        """What a step of a command or an open input at a sampling instant does to states.

        Parameters
        ----------
        at : str
            Path of the command or input.
        amount : float
            Size of the step.
        until : float
            Length of the response [s].
        signals : sequence of str
            Paths of states, or of what the sampled controllers give; vectors in the island's frame.

        Returns
        -------
        Response
            At the sampling instants, just before each; the first is that of the step.

        Raises
        ------
        ParameterError
            If a signal is none of these.
        """
        place = int(self.point.equations.alias[input_place(self.plan, at)])
        period = _Period(self.plan, self.point, _clock(self.point.equations, 1.0 / self.period), stirred=(place,))
        model = period.solve()
        rows = []
        for path in signals:
            found = np.flatnonzero(model.places == self.plan.layout.place(path, "a state"))
            if not len(found):
                raise ParameterError(f"'{path}' is no state that moves, nor given by a controller at this rate")
            rows.append(found[0])
        forward = model.coordinates @ model.M @ model.basis
        push = model.coordinates @ period.pushed(model, place, amount)
        z = np.zeros((round(until / self.period) + 1, len(forward)))
        for k in range(1, len(z)):
            z[k] = forward @ z[k - 1] + push
        values = z @ model.basis[rows].T
        return Response(self.period * np.arange(len(z)), dict(zip(signals, values.T, strict=True)))


def sampled_model(plan: Plan, point: OperatingPoint, rate: float | None) -> SampledModel:
    """The model (2) of a plant.

    Parameters
    ----------
    plan : Plan
    point : OperatingPoint
    rate : float, optional
        Of the clock [Hz]; that of the plant's modulators if left out.

    Raises
    ------
    ParameterError
        If the plant has no controllers of that rate, or several rates and none is given.
    SteadyStateError
        If the plant does not repeat itself from period to period.
    """
    period = _Period(plan, point, _clock(point.equations, rate))
    return period.solve()


def _clock(equations: Equations, rate: float | None) -> int:
    periods = equations.plan.periods
    there = sorted({modulator[1] for modulator in equations.sampled_modulators})
    if rate is None:
        if len(there) != 1:
            rates = ", ".join(f"{1.0 / period:g}" for period in there) or "none"
            raise ParameterError(
                f"sampled control at one rate is asked for, there are modulators at {rates} Hz: give `rate`"
            )
        rate = 1.0 / there[0]
    clocks = {kernels.clock for kernels in equations.kernels if kernels.sampled}
    found = [c for c in clocks if abs(periods[c] * rate - 1.0) < 1e-6]
    if not found:
        rates = ", ".join(f"{1.0 / periods[c]:g}" for c in sorted(clocks))
        raise ParameterError(f"no controller is sampled at {rate:g} Hz: there are {rates} Hz")
    return found[0]


class _Period:
    """One period of (1), and its derivative."""

    def __init__(self, plan: Plan, point: OperatingPoint, clock: int, stirred: tuple[int, ...] = ()):
        self.plan, self.point, self.T = plan, point, float(plan.periods[clock])
        e = self.equations = point.equations
        order = {t.kind.key: (STAGES.index(t.kind.stage), k) for k, t in enumerate(plan.ordered_types)}
        exact = [k for k in e.kernels if k.sampled and k.clock == clock and not k.late]
        self.exact: list[ComponentKernels] = sorted(exact, key=lambda k: order[k.kind.key])
        modulators = [m for m in e.sampled_modulators if abs(m[1] - self.T) < 1e-9 * self.T]
        self.links = [(int(e.alias[source]), target) for _, _, links, _ in modulators for source, target in links]
        at = Point(e, point.sig, stirred)
        places = np.concatenate([np.concatenate([k.x, k.y]) for k in self.exact] + [[t for _, t in self.links]])
        self.held = [int(place) for place in places.astype(int) if at.active[place]]
        self.active = at.active.copy()

    def at(self, sig: np.ndarray) -> Point:
        found = Point(self.equations, sig)
        found.active = self.active  # what is constant is so over the whole period
        return found

    def solve(self) -> SampledModel:
        e, T = self.equations, self.T
        sig, omega = self._start(), self.point.omega.copy()
        pencil = pencil_at(self.at(sig), omega, self.held)
        states = states_of(pencil)
        places = pencil.places[states.rows]
        self.half = pencil.places[np.flatnonzero(self.half_rows(pencil))]
        inside = sig[self.half].copy()
        is_angle = np.isin(places, list(e.angle_island))
        islands = [
            (i, next(np.flatnonzero(places == a)[0] for a in island.angles if a in places))
            for i, island in enumerate(e.islands)
            if any(a in places for a in island.angles)
        ]
        step = np.inf
        for _ in range(ITERATIONS):
            before = self.values(sig, inside, places)
            after_sig, after_inside, M = self.map(sig, inside, omega)
            after = self.values(after_sig, after_inside, places)
            missing = after - before
            missing[is_angle] = [wrapped(a) for a in missing[is_angle]]
            generators = e.generators(after_sig)
            coordinates, basis = states.coordinates, states.basis
            columns = [M - np.eye(len(M))] + [-T * generators[i][places][:, None] for i, _ in islands]
            J = np.hstack([coordinates @ columns[0] @ basis] + [coordinates @ c for c in columns[1:]])
            gauge = np.zeros((len(islands), J.shape[1]))
            for row, (_, k) in enumerate(islands):
                gauge[row, : basis.shape[1]] = basis[k]
            J = np.vstack([J, gauge])
            right = -np.concatenate([coordinates @ missing, np.zeros(len(islands))])
            scale = 1.0 / np.maximum(np.max(np.abs(J), axis=0), 1e-300)
            move = scale * np.linalg.lstsq(J * scale, right, rcond=1e-13)[0]
            dz = basis @ move[: basis.shape[1]]
            for k, (i, _) in enumerate(islands):
                omega[i] += move[basis.shape[1] + k]
            step = np.max(np.abs(dz) / np.maximum(np.abs(before), 1.0), initial=0.0)
            if step < CONVERGED:
                found = e.generators(sig)
                return SampledModel(self.plan, self.point, T, sig, omega, M, basis, coordinates, places, found)
            sig, inside = sig.copy(), inside.copy()
            n = len(places) - len(inside)
            sig[places[:n]] += dz[:n]
            inside += dz[n:]
            sig = self.follow(sig, inside, omega)
        raise SteadyStateError(f"sampled at {1.0 / T:g} Hz the plant does not repeat itself: last step {step:.1e}")

    def pushed(self, model: SampledModel, place: int, amount: float) -> np.ndarray:
        """What a step of a constant at the first instant has done to the states a period later, to first order."""
        ends = []
        for sign in (1.0, -1.0):
            sig = model.sig.copy()
            sig[place] += sign * SMALL * amount
            after, inside, _ = self.map(sig, sig[self.half], model.omega)
            ends.append(self.values(after, inside, model.places))
        return (ends[0] - ends[1]) / (2.0 * SMALL)

    def half_rows(self, pencil) -> np.ndarray:
        """Unknowns of a pencil that are states half way."""
        rows = np.zeros(len(pencil.places), dtype=bool)
        seen: set[int] = set()
        for k, place in enumerate(pencil.places):
            rows[k] = int(place) in seen
            seen.add(int(place))
        return rows

    def values(self, sig: np.ndarray, inside: np.ndarray, places: np.ndarray) -> np.ndarray:
        n = len(places) - len(inside)
        return np.concatenate([sig[places[:n]], inside])

    def _start(self) -> np.ndarray:
        """The mean point, what is held turned back to when it was computed."""
        sig = self.point.sig.copy()
        speed = {
            pair: w for island, w in zip(self.equations.islands, self.point.omega, strict=True) for pair in island.pairs
        }
        held = set(self.held)
        from_source = {target: source for source, target in self.links}
        for (a, b), w in speed.items():
            if a not in held or b not in held or a in self.equations.angle_island:
                continue
            periods = 2.0 if a in from_source else 1.0
            x, y = (from_source.get(a, a), from_source.get(b, b))
            cos, sin = np.cos(w * self.T * periods), np.sin(w * self.T * periods)
            d, q = self.point.sig[x], self.point.sig[y]
            sig[a], sig[b] = cos * d + sin * q, cos * q - sin * d
        return sig

    # the two halves of (1)

    def map(self, sig: np.ndarray, inside: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signals a period later, and the derivative of the states by those before."""
        pencil = pencil_at(self.at(sig), omega, self.held)
        states = states_of(pencil)
        places = pencil.places[states.rows]
        n = len(places)
        by_state = np.zeros((self.equations.size, n))
        whole = ~self.half_rows(pencil)
        by_state[pencil.places[whole]] = states.full_S[whole]
        sig = sig.copy()
        for source, target in self.links:
            sig[target] = sig[source]
            by_state[target] = by_state[source]
        for kernels in self.exact:
            with np.errstate(all="ignore"):
                block = kernels.block(sig, self.equations.inner)
            columns = by_state[self.equations.inner[block.columns]]
            if len(block.rate):
                sig[block.x], by_state[block.x] = block.rate, block.by_rate @ columns
            sig[block.y], by_state[block.y] = block.output, block.by_output @ columns
        M = np.eye(n)
        held = np.isin(places, self.held)
        M[held] = by_state[places[held]]
        h = self.T / PARTS
        for _ in range(PARTS):
            sig, inside, _ = self.flow(sig, inside, omega, 0.5 * h)
            sig, inside, A = self.flow(sig, inside, omega, 0.5 * h)
            M = expm(h * A) @ M
        sig = self.follow(sig, inside, omega)
        return sig, inside, M

    def flow(
        self, sig: np.ndarray, inside: np.ndarray, omega: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Go on by `h` with what is held turning backwards: exact for the linear part, of order two for the rest."""
        point = self.at(sig)
        pencil = pencil_at(point, omega, self.held)
        F = self.residual(point, pencil, inside, omega)
        states = states_of(pencil, F[:, None])
        n = len(states.rows)
        hold = np.zeros((n + 1, n + 1))
        hold[:n, :n], hold[:n, n] = states.full, states.full_B[:, 0]
        dx = expm(h * hold)[:n, n]
        move = states.full_S @ dx + states.D[:, 0]
        move[states.rows] = dx
        half = self.half_rows(pencil)
        sig = sig.copy()
        sig[pencil.places[~half]] += move[~half]
        return sig, inside + move[half], states.full

    def follow(self, sig: np.ndarray, inside: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """Bring what is no state up to date."""
        return self.flow(sig, inside, omega, 0.0)[0]

    def residual(self, point: Point, pencil, inside: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """Rates and unbalances of a pencil's rows between two instants."""
        e = self.equations
        turned = point.turned(omega)
        half = self.half_rows(pencil)
        held = np.zeros(e.size, dtype=bool)
        held[self.held] = True
        turning = np.zeros(e.size)
        for island, w in zip(e.islands, omega, strict=True):
            for a, b in island.pairs:
                if held[a] and held[b] and a not in e.angle_island:
                    turning[a], turning[b] = w * point.sig[b], -w * point.sig[a]
            for a in island.angles:
                if held[a]:
                    turning[a] = -w
        F = np.empty(len(pencil.places))
        for k, place in enumerate(pencil.places):
            if half[k]:
                F[k] = turned[place]
            elif held[place]:
                F[k] = turning[place]
            else:
                F[k] = turned[place]
        for k, place in enumerate(self.half):  # the algebraic row of a state half way
            row = int(np.flatnonzero((pencil.places == place) & ~half)[0])
            F[row] = 0.5 * point.period[place] * turned[place] + point.sig[place] - inside[k]
        return F
