"""Operating points by Newton's method: where a plant, seen from frames that turn with it, stands still.

The unknowns are those of `equations`, and the frequency of each AC island; the angle of the first rotor or controller
of an island is given, since it means nothing. Any signal may be held at a value if as many commands or open inputs are
set free: "the choke carries 100 A; find the duty ratio".

A plant with sequences (gensets that start, contactors that close) has many points of rest, most of them switched off.
So the search starts where the plant itself has come to rest under its commands (`run_to_rest`), unless it is given
another start; Newton's method then takes out what the run leaves: slow drifts, and the sawtooth that sampling puts on
everything.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from shipgrid.analysis.equations import Equations
from shipgrid.analysis.newton_search import NewtonSearch, largest_coefficients
from shipgrid.analysis.point import Point
from shipgrid.analysis.settling import run_to_rest
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.hand_over import taken_over
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.start import settle_modulators, settle_outputs
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.equipment.ship import Ship
from shipgrid.errors import SteadyStateError
from shipgrid.html_table import table
from shipgrid.model.connections import DcBus
from shipgrid.model.network import Network

ORDER, ORDER_LINE = 3, 4
"""Orders of the Pade quotients for the dead time of a modulation, and for that of a delay line."""
TURN, EVENLY = 1.0, 1e-6
"""Angle [rad] by which a plant is turned to see whether it rests in any direction; what is then off, of its size."""
SWEEPS = 4
"""Times that all outputs are evaluated before the search, each from those before."""


@dataclass(frozen=True, repr=False)
class OperatingPoint:
    """A plant at rest.

    Attributes
    ----------
    plan : Plan
    equations : Equations
    sig : ndarray
        Every signal, the vectors of each island in its own turning frame (`alpha` is d, `beta` is q).
    omega : ndarray
        Angular frequency [rad/s] of each AC island, in the order of the equations' islands; `frequency` has names.
    error : float
        Last step of Newton's method, relative to the size of the signals.
    """

    plan: Plan
    equations: Equations
    sig: np.ndarray
    omega: np.ndarray
    error: float

    def __repr__(self) -> str:
        return f"<OperatingPoint of {self.plan.network.name}: {self.plan.layout.size} signals>"

    def _repr_html_(self) -> str:
        network, layout = self.plan.network, self.plan.layout
        public = [(name, self[name], signal.unit, signal.description) for name, signal in network.published.items()]
        inner = [(path, self[path], layout.unit[path], layout.description[path]) for path in sorted(layout.unit)]
        return table(repr(self)[1:-1], ("signal", "value", "unit", ""), public or inner)

    def _ipython_key_completions_(self) -> list[str]:
        return sorted({*self.plan.network.published, *self.plan.layout.unit})

    @property
    def frequency(self) -> dict[str, float]:
        """Frequency [Hz] of each AC island."""
        return {i.name: float(w) / (2.0 * np.pi) for i, w in zip(self.equations.islands, self.omega, strict=True)}

    def __getitem__(self, path: str) -> float:
        """Value of a signal."""
        return float(self.sig[self.equations.alias[place_of(self.plan, path)]])

    def workspace(self) -> Workspace:
        """A workspace from which a run goes on at this point.

        Sampled controllers sample at its first instant; the modulations that are in force until then are the means.
        """
        work = new_workspace(self.plan)
        n = self.plan.layout.size
        work.sig[:] = self.sig[self.equations.inner[:n]]
        for _, _, links, states in self.equations.sampled_modulators:
            work.sig[states] = [self.sig[target] for _, target in links]
        for t in self.plan.layout.types:
            if hasattr(t.kind.cls, "delay_length"):
                for k, kernels in enumerate(k for k in self.equations.kernels if k.kind is t.kind):
                    first = int(kernels.parameters.line.real)
                    cells = t.placed[k].item.delay_length(kernels.period)
                    work.step.delays[first : first + cells] = self.sig[self.equations.inner[kernels.u[0]]]
        settle_modulators(self.plan, work)
        work.step.previous[:] = work.sig
        work.step.watched_was[:] = work.sig[self.plan.step.watched]
        return work


def place_of(plan: Plan, path: str) -> int:
    """Place of a signal, a command or a public signal.

    Parameters
    ----------
    plan : Plan
    path : str
    """
    if path in plan.network.published:
        path = plan.network.published[path].source
    elif f"command:{path}" in plan.layout.index:
        path = f"command:{path}"
    return plan.layout.place(path, "operating point")


def input_place(plan: Plan, path: str) -> int:
    """Place of a component's input itself, not of what it is connected to; of a command or signal otherwise.

    Parameters
    ----------
    plan : Plan
    path : str
    """
    return plan.layout.slots.get(("u", path), -1) if ("u", path) in plan.layout.slots else place_of(plan, path)


def steady_state(
    plan: Plan | Ship,
    commands: Mapping[str, float] | None = None,
    *,
    hold: Mapping[str, float] | None = None,
    free: Iterable[str] = (),
    start: Workspace | OperatingPoint | Mapping[str, float] | None = None,
) -> OperatingPoint:
    """Operating point of a plant.

    Parameters
    ----------
    plan : Plan or Ship
        Of a ship that of its averaged plan: alongside, as a scenario begins, but for the commands that are given.
    commands : mapping of str to float, optional
        Commands, by path, that stand.
    hold : mapping of str to float, optional
        Signals that have to have a value.
    free : iterable of str
        As many commands or unconnected inputs, whose values are found.
    start : Workspace, OperatingPoint or mapping of str to float, optional
        Where the search starts: a plant at rest or nearly so, or values of signals with all others at their declared
        initial values (DC buses at nominal voltage). If left out the plant is run until it comes to rest.

    Returns
    -------
    OperatingPoint

    Raises
    ------
    SteadyStateError
        If there is none, or the search does not find it: names the worst equations and the limiters that act.
    """
    hold, free, commands = dict(hold or {}), list(free), dict(commands or {})
    if isinstance(plan, Ship):
        moored = {path: c.default if c.moored is None else c.moored for path, c in plan.commands.items()}
        plan, commands = _averaged(plan), moored | commands
    if len(hold) != len(free):
        raise SteadyStateError(f"{len(hold)} signals are held and {len(free)} set free: expected as many")
    work = _start(plan, commands, start)
    equations = Equations(plan, work.sig, order=ORDER, order_line=ORDER_LINE)
    sig, omega = _first_guess(equations, work)
    held = np.array([equations.alias[place_of(plan, path)] for path in hold], dtype=np.int64)
    freed = np.array([equations.alias[input_place(plan, path)] for path in free], dtype=np.int64)
    search = NewtonSearch(equations, held, np.array(list(hold.values())), freed)
    point = Point(equations, sig)
    for path, place in zip(free, freed, strict=True):
        if point.active[place]:
            raise SteadyStateError(f"'{path}' follows from the plant's equations: expected a command or an open input")
    found = search.newton(sig, omega) or search.newton(*search.slowly(sig, omega))
    if found is None:
        raise SteadyStateError(search.complaint())
    conducting = equations.conducting(found[0])
    if conducting:
        raise SteadyStateError(
            f"no operating point: {conducting}; there is none with diodes that conduct, expected driven gates or a run"
        )
    _check_turning(equations, found[0], found[1])
    point = OperatingPoint(plan, equations, *found)
    _settle_modulators(point)
    return point


def _averaged(ship: Ship) -> Plan:
    network = Network(ship.name)
    ship.build(network)
    return assemble(network)


def _settle_modulators(point: OperatingPoint) -> None:
    """Bring what modulators put out up to the point: bounds of legs, and whether they are limited."""
    work, layout = point.workspace(), point.plan.layout
    for t in (t for t in layout.types if "modulate" in t.kind.kernels):
        own = slice(t.y, t.y + t.ny * len(t.placed))
        point.sig[own] = work.sig[own]


def _check_turning(equations: Equations, sig: np.ndarray, omega: np.ndarray) -> None:
    """A plant that turns evenly rests in any direction; one with unbalance or harmonics in one direction at most.

    Raises
    ------
    SteadyStateError
        If it does not rest once all its vectors and angles are turned: names where.
    """
    plan = equations.plan
    if not equations.islands or any(sig[plan.layout.index[path]] > 0.5 for path in plan.limiter_paths):
        return  # at the edge of a limit rounding decides which side a turned point is on
    turned = sig.copy()
    for island in equations.islands:
        for a, b in island.pairs:
            turned[a], turned[b] = _rotated(sig[a], sig[b], TURN)
        turned[island.angles] += TURN
    for _ in range(SWEEPS):
        _follow(equations, turned)
    point = Point(equations, turned)
    size = np.maximum(np.abs(sig), 1.0)
    for island in equations.islands:
        for a, b in island.pairs:
            size[a] = size[b] = max(np.hypot(sig[a], sig[b]), 1.0)
    error = np.where(point.active, np.abs(point.turned(omega)) / largest_coefficients(point) / size, 0.0)
    worst = int(np.argmax(error))
    if error[worst] > EVENLY:
        raise SteadyStateError(
            f"no operating point: {equations.names[worst]} does not turn evenly with its island (off by "
            f"{100.0 * error[worst]:.2g} % where the frame is turned): is something unbalanced, or has harmonics?"
        )


def _start(
    plan: Plan, commands: dict[str, float], start: Workspace | OperatingPoint | Mapping[str, float] | None
) -> Workspace:
    start = start.workspace() if isinstance(start, OperatingPoint) else start
    if isinstance(start, Workspace):
        work = taken_over(start, plan)
    elif start is None:
        return run_to_rest(plan, commands)[0]
    else:
        work = new_workspace(plan)
        for bus in plan.network.buses.values():
            if isinstance(bus, DcBus):
                work.sig[plan.layout.index[bus.nodes[0]]] = bus.v_n
        for path, value in start.items():
            work.sig[place_of(plan, path)] = value
    for path, value in commands.items():
        work.sig[plan.layout.place(f"command:{path}", "operating point")] = value
    if not isinstance(start, Workspace):
        settle_outputs(plan, work)
    return work


def _first_guess(equations: Equations, work: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Signals in frames whose d axes lie on a bus voltage of each island, and the frequencies.

    The angle of a sampled controller is that of its next instant: it is brought to where it is now.
    """
    start, n = work.sig, len(work.sig)
    sig = np.zeros(equations.size)
    sig[:n] = start[equations.alias[:n]]
    omega = np.zeros(len(equations.islands))
    for island in equations.islands:
        angle = 0.0
        if island.buses:
            a, b = island.pairs[0]
            angle = float(np.arctan2(sig[b], sig[a]))
        elif island.angles:
            angle = float(sig[island.angles[0]])
        for a, b in island.pairs:
            sig[a], sig[b] = _rotated(sig[a], sig[b], -angle)
        sig[island.angles] -= angle
    point = Point(equations, sig)
    rate = point.turned(omega)
    ahead = _time_to_next(equations.plan, work)
    for i, island in enumerate(equations.islands):
        angles = [place for place in island.angles if point.active[place]]
        if angles:  # a machine's is exact; of the sampled ones that of the longest period is smoothest
            best = max(angles, key=lambda place: np.inf if point.period[place] == 0.0 else point.period[place])
            omega[i] = rate[best]
        for kernels in equations.kernels:
            for place in kernels.x[np.isin(kernels.x, angles)]:
                if kernels.sampled:
                    sig[place] -= omega[i] * ahead[kernels.clock]
    for _ in range(SWEEPS):
        _settle_dead_times(equations, sig, omega)
        _follow(equations, sig)
    return sig, omega


def _follow(equations: Equations, sig: np.ndarray) -> None:
    """Bring outputs and what else follows from states and node voltages nearer, in place."""
    point = Point(equations, sig)
    follows = point.active & ~point.rates
    follows[list(equations.nodes)] = False
    sig[follows] += point.residual[follows]


def _settle_dead_times(equations: Equations, sig: np.ndarray, omega: np.ndarray) -> None:
    """Fill the dead times with what goes in, steadily turning backwards in the frame where it is a vector."""
    speed = {a: (b, w) for island, w in zip(equations.islands, omega, strict=True) for a, b in island.pairs}
    by_target = {d.target: d for d in equations.dead_times}
    second = {b for b, _ in speed.values()}
    for d in equations.dead_times:
        source = complex(sig[equations.alias[d.source]])
        other, w = by_target.get(speed.get(d.target, (-1, 0.0))[0]), speed.get(d.target, (-1, 0.0))[1]
        if d.target in second:
            continue
        if other is not None:
            source += 1j * sig[equations.alias[other.source]]
        inside = np.linalg.solve(1j * w * np.eye(len(d.b)) - d.A, d.b * source)
        out = d.c @ inside + d.d * source
        sig[np.array(d.states)], sig[d.target] = inside.real, out.real
        if other is not None:
            sig[np.array(other.states)], sig[other.target] = inside.imag, out.imag


def _rotated(a: float, b: float, angle: float) -> tuple[float, float]:
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * a - sin * b, sin * a + cos * b


def _time_to_next(plan: Plan, work: Workspace) -> np.ndarray:
    """Time [s] until the next instant of each clock."""
    left = (plan.step.clock_den - work.step.clock_phase) / plan.step.clock_inc
    return plan.h * np.mod(left, plan.step.clock_den / plan.step.clock_inc)
