"""A plant as one system of equations: every signal an unknown, every equation a row, nothing stepped.

    E dz/dt = F(z)                                                                          (1)

`z` holds the states, the outputs, the node voltages and the port voltages of a plan; an input is the signal that it is
connected to. E has ones where a row is a rate, and zeros where it is an equation that holds at every instant:

    dx/dt = f(x, u) - omega J x                   states of elements, machines and continuous components       (2)
    0 = g(x, u) - y                               outputs                                                      (3)
    0 = c (v_plus - v_minus) - v                  ports                                                        (4)
    C dv/dt = -g v - sum w c i - omega C J v      nodes; without capacitance the left side is zero             (5)
    T_s dx/dt = x_next(x, u) - x                  sampled components; angles less omega T_s                    (6)

Values and exact derivatives of f, g and x_next come from the components' own kernels, called uncompiled with complex
numbers, one complex step for each state and input. (6) is exact at rest; `linearise` says what it makes of it beside
rest. Two things that a kernel cannot be asked for stand as rational functions (Pade) between two signals: the dead
time of a sampled modulation, 1.5 periods from the sample to the middle of the hold, and of a delay line.

States that do not follow from (2) and (6) are left out and stay what they are: those that only count, those that an
open contact or an active limiter holds, and codes of sequences (whatever depends on nothing that moves).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.special import factorial

from shipgrid.analysis.islands import find_islands, pairs_of
from shipgrid.assembly.layout import ONE, ZERO, TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.errors import SteadyStateError
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.connections import Legs
from shipgrid.model.kernel import argument_names, reads_time, uncompiled
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of, parameter_dtype
from shipgrid.modulators.gates import LOWER, UPPER
from shipgrid.solvers.companion import state_space

COMPLEX_STEP = 1e-40
MODULATION_DELAY = 1.5
"""Sampling periods from a sample to the middle of the hold of what was computed from it."""
SAMPLED, SAMPLED_LEG, DIRECT = ("s_alpha_ref", "s_beta_ref"), ("s_ref",), ("s_alpha", "s_beta")
"""What modulators put in force: a reference held from instant to instant, or a vector at once."""
LONGEST_RAMP = 2**30
"""Periods after which what still moves evenly is taken for a timer."""
MARGIN = 1e-6
"""Share of the bus voltage by which the voltage of a blocked bridge may pass it before its diodes conduct."""
PROBE = 1e-9
"""Time [s] by which a state is moved on to see whether a limiter holds it."""


def pade(delay: float, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """State-space form A, b, c, d of the Pade quotient of `order` for a dead time of `delay` [s]."""
    from scipy.signal import tf2ss  # a third of a second, which a run has no use for

    k = np.arange(order + 1)
    a = factorial(2 * order - k) / (factorial(k) * factorial(order - k))  # of s^k; the numerator has (-s)^k
    A, B, C, D = tf2ss(((-1.0) ** k * a)[::-1], a[::-1])
    return A / delay, B[:, 0] / delay, C[0], float(D[0, 0])


@dataclass(frozen=True)
class DeadTime:
    """A dead time between two signals, as a rational function with states of its own.

    Attributes
    ----------
    source, target : int
        Places of what goes in and of what comes out.
    states : range
        Places of its states.
    A, b, c, d : ndarray, ndarray, ndarray, float
        dx/dt = A x + b source, target = c x + d source.
    """

    source: int
    target: int
    states: range
    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


@dataclass
class FloatingPole:
    """A pole of a blocked bridge at a linear element: what its potential would be without a current.

    Attributes
    ----------
    legs : Legs
    path : str
        Of its switching function.
    x, u : ndarray of int
        Places of states and inputs of the element.
    A, B : ndarray
        Rows of the state whose rate the pole's voltage drives.
    column : int
        Of the pole's voltage among the inputs.
    """

    legs: Legs
    path: str
    x: np.ndarray
    u: np.ndarray
    A: np.ndarray
    B: np.ndarray
    column: int

    def voltage(self, sig: np.ndarray, alias: np.ndarray) -> float:
        """Voltage [V] at which the state stands still."""
        others = np.delete(self.B, self.column) @ np.delete(sig[alias[self.u]], self.column)
        return float(-(self.A @ sig[self.x] + others) / self.B[self.column])


class _Line:
    """A delay line whose content is one value: what a kernel sees of it at rest."""

    def __init__(self, value: complex):
        self.value = value

    def __getitem__(self, _: Any) -> complex:
        return self.value

    def __setitem__(self, _: Any, __: Any) -> None:
        """What is written comes out later, by the dead time that stands beside."""


@dataclass
class Block:
    """What one component says at a point: values and derivatives of its equations.

    Attributes
    ----------
    path : str
    sampled : bool
        `rate` is then the next state, not the rate of change.
    period : float
        Sampling period [s].
    x, y, u : ndarray of int
        Places of states, outputs and inputs.
    rate, output : ndarray
    by_rate, by_output : ndarray
        Derivatives by states and inputs, in this order.
    held : ndarray of bool
        States that a limiter holds.
    """

    path: str
    sampled: bool
    period: float
    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    rate: np.ndarray
    output: np.ndarray
    by_rate: np.ndarray
    by_output: np.ndarray
    held: np.ndarray

    @property
    def columns(self) -> np.ndarray:
        """Places of what it is differentiated by."""
        return np.concatenate([self.x, self.u])


class _Record:
    """Named numbers on plain objects, blocks nested: for a kernel that runs uncompiled much faster than a recarray."""

    def __init__(self, names: list[str]):
        self.top = SimpleNamespace()
        self.slots: list[tuple[dict[str, Any], str]] = []
        for name in names:
            *blocks, last = name.split(".")
            owner = self.top
            for block in blocks:
                if not hasattr(owner, block):
                    setattr(owner, block, SimpleNamespace())
                owner = getattr(owner, block)
            self.slots.append((vars(owner), last))
        self.write(np.zeros(len(names), dtype=complex))

    def write(self, values: np.ndarray) -> None:
        for (owner, name), value in zip(self.slots, values, strict=True):
            owner[name] = value

    def read(self) -> np.ndarray:
        return np.array([owner[name] for owner, name in self.slots], dtype=complex)


class _Kernels:
    """One component's kernels on complex records of its own."""

    def __init__(self, plan: Plan, t: TypeLayout, k: int):
        kind, placed = t.kind, t.placed[k]
        self.plan, self.kind, self.path = plan, kind, placed.path
        self.clock = int(plan.clock_of[kind.key][k])
        self.period = float(plan.periods[self.clock])
        self.x = np.arange(t.x + k * t.nx, t.x + (k + 1) * t.nx)
        self.u = np.arange(t.u + k * t.nu, t.u + (k + 1) * t.nu)
        self.y = np.arange(t.y + k * t.ny, t.y + (k + 1) * t.ny)
        parts = {"x": kind.state, "x_next": kind.state, "dx": kind.state, "u": kind.input, "y": kind.output}
        self.named = {name: _Record(names_of(record)) for name, record in parts.items()}
        width = len(t.parameters) // len(t.placed)
        p = _Record(list(parameter_dtype(kind.cls).names or ()))
        p.write(t.parameters[k * width : (k + 1) * width].astype(complex))
        self.parameters = p.top
        self.records: dict[str, Any] = {name: record.top for name, record in self.named.items()}
        self.records |= {"t": 0.0, "dt": self.period, "tables": plan.step.tables, "p": p.top}
        self.sampled = "update" in kind.kernels
        reads = [name for name in ("derivatives", "outputs", "update") if reads_time(kind.kernels.get(name))]
        if reads:
            raise SteadyStateError(
                f"no operating point: '{self.path}' ({kind.name}) reads the time in `{reads[0]}`; "
                "expected a state in its place, for an angle one that `rotates`"
            )
        late = getattr(placed.item, "dead_times", dict)()
        names = names_of(kind.input)
        self.late = {names.index(name): seconds for name, seconds in late.items()}

    def call(self, name: str) -> None:
        kernel = self.kind.kernels[name]
        uncompiled(kernel)(*[self.records[argument] for argument in argument_names(kernel)])

    def evaluate(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates (or next states) and outputs, for complex states and inputs."""
        named = self.named
        named["x"].write(x)
        named["u"].write(u)
        named["y"].write(y)
        if self.late:
            self.records["delays"] = _Line(u[next(iter(self.late))])
        kernels = self.kind.kernels
        rate = np.zeros(0, dtype=complex)
        if self.sampled:
            named["x_next"].write(x)
            self.call("update")
            rate = named["x_next"].read()
            named["x"].write(rate)  # outputs, where there are any beside, are those of the new state
        elif "derivatives" in kernels:
            named["dx"].write(0.0 * x)
            self.call("derivatives")
            rate = named["dx"].read()
        if "outputs" in kernels:
            self.call("outputs")
        return rate, named["y"].read()

    def limited(self, x: np.ndarray, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Which states the limiter holds: a moment on, it makes them the same whatever they are."""
        held = np.zeros(len(x), dtype=bool)
        if "limit" not in self.kind.kernels or self.sampled:
            return held
        base = x + PROBE * rate
        for k in range(len(x)):
            stepped = base.astype(complex)
            stepped[k] += 1j * COMPLEX_STEP
            self.named["x"].write(stepped)
            self.named["u"].write(u.astype(complex))
            self.call("limit")
            held[k] = not self.named["x"].read()[k].imag
        return held

    def block(self, sig: np.ndarray, alias: np.ndarray) -> Block:
        """Values and derivatives at a point."""
        x, y = sig[self.x], sig[self.y]
        source = alias[self.u]
        u = sig[source]
        y = y.astype(complex)
        rate, output = self.evaluate(x.astype(complex), u.astype(complex), y)
        n, m = len(x), len(u)
        by_rate, by_output = np.zeros((len(rate), n + m)), np.zeros((len(output), n + m))
        for k in range(n + m):
            xs, us = x.astype(complex), u.astype(complex)
            (xs if k < n else us)[k if k < n else k - n] += 1j * COMPLEX_STEP
            stepped_rate, stepped_output = self.evaluate(xs, us, y)
            by_rate[:, k] = np.imag(stepped_rate) / COMPLEX_STEP
            by_output[:, k] = np.imag(stepped_output) / COMPLEX_STEP
        held = self.limited(x, u, np.real(rate)) if len(rate) else np.zeros(n, dtype=bool)
        return Block(
            self.path, self.sampled, self.period, self.x, self.y, self.u,
            np.real(rate), np.real(output), by_rate, by_output, held,
        )  # fmt: skip


class Equations:
    """The equations of a plan, with its contacts as they stand in a flat vector.

    Attributes
    ----------
    size : int
        Length of the vector of all signals: the plan's flat vector, then the states of the dead times.
    alias : ndarray of int
        Place of the signal that stands behind each place.
    islands : list of Island
    dead_times : list of DeadTime
    """

    def __init__(self, plan: Plan, sig: np.ndarray, *, order: int, order_line: int):
        plan.refuse_parts()
        self.plan, layout = plan, plan.layout
        self.size = layout.size
        self.names: dict[int, str] = {}
        for path, place in layout.index.items():
            self.names.setdefault(place, path)
        for (part, path), place in layout.slots.items():
            if part != "u" or place not in self.names:
                self.names[place] = path
        self.alias = self._aliases(sig)
        self.kernels = [
            _Kernels(plan, t, k)
            for t in layout.types
            if not t.kind.linear and set(t.kind.kernels) & {"derivatives", "update", "outputs"}
            for k in range(len(t.placed))
        ]
        self.owner = np.full(self.size, -1)  # which of these kernels a state or output is of
        for number, kernels in enumerate(self.kernels):
            self.owner[kernels.x] = self.owner[kernels.y] = number
        self.sampled_modulators = self._modulators()
        self._elements(sig)
        self.islands = find_islands(plan, self.alias, self.opened)
        self._dead_times(order, order_line)
        self._network()
        self.angle_island = {place: i for i, island in enumerate(self.islands) for place in island.angles}

    # who stands where

    def _aliases(self, sig: np.ndarray) -> np.ndarray:
        alias = np.arange(self.size)
        for name, gather in self.plan.gathers.items():
            pairs = gather["latest"] if name == "network" else np.concatenate([gather["measured"], gather["latest"]])
            alias[pairs[:, 0]] = pairs[:, 1]
        self.blocked = self._blocked(sig, alias)
        for legs in self.plan.network.legs.values():
            if self._references(legs) == DIRECT and legs.path not in self.blocked:  # its vector is in force at once
                for pole, name in zip(legs.poles, DIRECT, strict=True):
                    alias[self.plan.layout.index[pole]] = self.plan.layout.slots["u", f"{legs.modulator}.{name}"]
        while np.any(alias[alias] != alias):
            alias = alias[alias]
        return alias

    def _references(self, legs: Legs) -> tuple[str, ...]:
        """Names of the inputs that a bridge's modulator puts in force."""
        inputs = names_of(type_of(self.plan.network.placed[legs.modulator].item).input)
        return next((names for names in (SAMPLED, SAMPLED_LEG, DIRECT) if set(names) <= set(inputs)), ())

    def _modulators(self) -> list[tuple[Placed, float, list[tuple[int, int]], np.ndarray]]:
        """Modulators that hold: path, period, pairs of reference and switching function, and their own states."""
        found, layout = [], self.plan.layout
        for legs in self.plan.network.legs.values():
            references = self._references(legs)
            if references not in (SAMPLED, SAMPLED_LEG):
                continue
            placed = self.plan.network.placed[legs.modulator]
            t = next(t for t in layout.types if placed in t.placed)
            k = t.placed.index(placed)
            links = [
                (layout.slots["u", f"{placed.path}.{name}"], layout.index[pole])
                for name, pole in zip(references, legs.poles, strict=True)
            ]
            period = float(self.plan.periods[self.plan.clock_of[t.kind.key][k]])
            found.append((placed, period, links, np.arange(t.x + k * t.nx, t.x + (k + 1) * t.nx)))
        return found

    def _blocked(self, sig: np.ndarray, alias: np.ndarray) -> set[str]:
        """Bridges whose gates are blocked at the point."""
        slots = self.plan.layout.slots
        gates = {path: ("u", f"{legs.modulator}.gates") for path, legs in self.plan.network.legs.items()}
        return {path for path, slot in gates.items() if slot in slots and sig[alias[slots[slot]]] < 0.5}

    def _elements(self, sig: np.ndarray) -> None:
        """Matrices of the linear elements, with their contacts as they stand."""
        layout = self.plan.layout
        self.elements: list[tuple[Placed, np.ndarray, np.ndarray, np.ndarray, Any]] = []
        self.opened: list[str] = []
        self.held: set[int] = set()
        poles = {
            pole: legs for path, legs in self.plan.network.legs.items() if path in self.blocked for pole in legs.poles
        }
        self.floating: list[FloatingPole] = []
        for t in layout.types:
            if not t.kind.linear:
                continue
            states = names_of(t.kind.state)
            inputs = names_of(t.kind.input)
            outputs = names_of(t.kind.output)
            ends = [terminal.v for terminal in t.kind.terminals]
            for k, placed in enumerate(t.placed):
                x = np.arange(t.x + k * t.nx, t.x + (k + 1) * t.nx)
                position = int(sig[self.alias[layout.place(placed.variant, placed.path)]]) if placed.variant else 0
                position = position if 0 <= position < len(placed.positions) else 0
                space = state_space(placed.item, position)
                A, B, C, D = space.A.copy(), space.B.copy(), space.C.copy(), space.D.copy()
                held = [states.index(name) for name in placed.positions[position] or ()]
                u = np.array([t.u + k * t.nu + inputs.index(name) for name in [*ends, *space.sources]])
                for column, end in enumerate(t.kind.terminals):  # blocked legs whose diodes do not conduct
                    pole = placed.ports[end.name].coefficient or ""
                    if pole in poles:
                        rows = [int(row) for row in np.flatnonzero(B[:, column]) if row not in held]
                        self.floating += [
                            FloatingPole(poles[pole], pole, x, u, A[row].copy(), B[row].copy(), column)
                            for row in rows[:1]
                        ]
                        held += rows
                A[held, :] = A[:, held] = 0.0
                B[held, :] = C[:, held] = 0.0
                self.held |= set(x[held])
                if placed.positions[position] is not None and len(held) == len(states):
                    D[:] = 0.0
                    self.opened.append(placed.path)
                y = np.array([t.y + k * t.ny + outputs.index(end.i) for end in t.kind.terminals])
                self.elements.append((placed, x, u, y, (A, B, C, D)))

    def _dead_times(self, order: int, order_line: int) -> None:
        self.dead_times: list[DeadTime] = []
        self.late: dict[int, int] = {}  # the place that stands for an input behind a dead time
        extra_pairs: dict[int, int] = {}

        def add(source: int, target: int, delay: float, order: int, name: str) -> None:
            A, b, c, d = pade(delay, order)
            states = range(self.size, self.size + order)
            self.size += order
            for k, place in enumerate(states):
                self.names[place] = f"{name} (dead time {k + 1})"
            self.dead_times.append(DeadTime(source, target, states, A, b, c, d))

        for _, period, links, _ in self.sampled_modulators:
            for source, target in links:
                add(source, target, MODULATION_DELAY * period, order, self.names[target])
                extra_pairs[target] = self.dead_times[-1].states.start
        for island in self.islands:
            for a, b in list(island.pairs):
                if a in extra_pairs and b in extra_pairs:
                    island.pairs += [(extra_pairs[a] + k, extra_pairs[b] + k) for k in range(order)]
        for kernels in self.kernels:
            for position, seconds in kernels.late.items():
                place = int(kernels.u[position])
                late = self.size
                self.size += 1
                self.names[late] = f"{self.names[place]} (late)"
                self.late[place] = late
                if seconds > 0.0:
                    add(place, late, seconds, order_line, self.names[place])
        self.alias = np.concatenate([self.alias, np.arange(len(self.alias), self.size)])
        self.owner = np.concatenate([self.owner, np.full(self.size - len(self.owner), -1)])
        self.inner = self.alias.copy()  # what a kernel sees: behind the dead times
        for place, late in self.late.items():
            self.inner[place] = late if any(d.target == late for d in self.dead_times) else self.alias[place]

    def _network(self) -> None:
        """Ports and nodes: who meets whom."""
        layout, network = self.plan.layout, self.plan.network
        self.ports: list[tuple[int, int, int, int, int, float]] = []  # v, i, plus, minus, coefficient, weight
        self.idle: set[int] = set()  # voltages of ports of stamped devices at blocked poles: there is no current
        poles = {pole for path in self.blocked for pole in network.legs[path].poles}
        for t in layout.types:
            for k, placed in enumerate(t.placed):
                for end in t.kind.terminals:
                    binding = placed.ports[end.name]
                    v = t.u + k * t.nu + names_of(t.kind.input).index(end.v)
                    i = t.y + k * t.ny + names_of(t.kind.output).index(end.i)
                    nodes = [layout.index[node] if node else ZERO for node in (binding.plus, binding.minus)]
                    c = layout.place(binding.coefficient, placed.path) if binding.coefficient else ONE
                    if t.kind.stamped and binding.coefficient in poles:
                        self.idle.add(v)
                    self.ports.append((v, i, nodes[0], nodes[1], int(self.alias[c]), binding.weight))
        self.nodes = {
            layout.index[name]: (network.capacitances.get(name, 0.0), network.conductances.get(name, 0.0))
            for name in layout.nodes
        }
        for t in layout.types:  # voltages of ports follow from nodes as they turn; these follow from the machine itself
            for k in range(len(t.placed) if t.kind.stamped else 0):
                vectors = [(t.u + k * t.nu + a, t.u + k * t.nu + b) for a, b in pairs_of(names_of(t.kind.input))]
                vectors = [pair for pair in vectors if self.idle.issuperset(pair)]
                own = range(t.y + k * t.ny, t.y + (k + 1) * t.ny)
                for island in self.islands:
                    island.pairs += [pair for pair in vectors if any(a in own for a, _ in island.pairs)]
        current_of: dict[int, int] = {}  # the coefficient of a port, to the port's current
        for t in layout.types:
            for k, placed in enumerate(t.placed):
                for end in t.kind.terminals:
                    pole = placed.ports[end.name].coefficient
                    if pole:
                        i = t.y + k * t.ny + names_of(t.kind.output).index(end.i)
                        current_of[layout.place(pole, placed.path)] = i
        self.meters = [
            (
                layout.index[f"{legs.path}.i_dc"],
                layout.index[legs.bus.nodes[0]],
                legs.weight,
                [(int(self.alias[layout.index[pole]]), current_of[layout.index[pole]]) for pole in legs.poles],
            )
            for legs in network.legs.values()
        ]

    def conducting(self, sig: np.ndarray) -> str:
        """What to tell of a blocked bridge whose diodes would conduct at a point; empty if there is none."""
        index, across = self.plan.layout.index, {path: {} for path in self.blocked}
        for pole in self.floating:
            across[pole.legs.path][pole.path] = pole.voltage(sig, self.alias)
        for v, _, _, _, c, _ in self.ports:
            if v in self.idle:
                path = next(p for p in self.blocked if c in [index[pole] for pole in self.plan.network.legs[p].poles])
                across[path][self.names[c]] = float(sig[v])
        for path, voltages in across.items():
            legs = self.plan.network.legs[path]
            v_dc, poles = float(sig[index[legs.bus.nodes[0]]]), [voltages.get(pole, 0.0) for pole in legs.poles]
            line = math.sqrt(3.0) * math.hypot(*poles)
            if len(poles) == 2 and line > v_dc * (1.0 + MARGIN):
                what = f"the peak of its line voltage is {line:.4g} V, its bus {v_dc:.4g} V"
                return f"the diodes of '{path}' conduct: {what}"
            if len(poles) == 1 and voltages and not -MARGIN * v_dc <= poles[0] <= v_dc * (1.0 + MARGIN):
                return f"the diodes of '{path}' conduct: its pole is at {poles[0]:.4g} V, its bus at {v_dc:.4g} V"
        slots, net = self.plan.layout.slots, self.plan.net
        for b, (path, legs) in enumerate(self.plan.network.legs.items()):
            slot = ("u", f"{legs.modulator}.gates")
            gates = float(sig[self.alias[slots[slot]]]) if slot in slots else 1.0
            i = float(sig[net.port_i[net.bridge_port[b, 0]]])
            for code, name, way, against in ((LOWER, "lower", "out of", i > 0.0), (UPPER, "upper", "into", i < 0.0)):
                if gates == code and against:
                    return f"{abs(i):.4g} A would flow {way} '{path}', of which only the {name} switch is driven"
        return ""

    # values and derivatives

    def at(self, sig: np.ndarray, stirred: Iterable[int] = ()) -> Point:
        """Everything that the equations say at a point.

        Parameters
        ----------
        sig : ndarray
            All signals.
        stirred : iterable of int
            Places of commands or inputs that are going to be disturbed: what depends on them is no constant.
        """
        with np.errstate(all="ignore"):
            blocks = [kernels.block(sig, self.inner) for kernels in self.kernels]
        return Point(self, sig, blocks, stirred)

    def arrived(self, point: Point) -> np.ndarray:
        """The signals with every ramp where it arrives; what never does is a timer, and stays."""
        sig = point.sig.copy()
        for kernels in self.kernels:
            for place in kernels.x[point.drifting[kernels.x]]:
                k = int(place - kernels.x[0])

                def pace(value: float, kernels: _Kernels = kernels, k: int = k) -> float:
                    x = sig[kernels.x].copy()
                    x[k] = value
                    rate, _ = kernels.evaluate(
                        *(v.astype(complex) for v in (x, sig[self.inner[kernels.u]], sig[kernels.y]))
                    )
                    return float(rate[k].real) - value

                start, first = float(sig[place]), pace(float(sig[place]))
                n = 1
                while n < LONGEST_RAMP and abs(pace(start + n * first) / first - 1.0) < 1e-6:
                    n *= 2
                if n >= LONGEST_RAMP:
                    continue
                low = n // 2
                while n - low > 1:
                    middle = (low + n) // 2
                    even = abs(pace(start + middle * first) / first - 1.0) < 1e-6
                    low, n = (middle, n) if even else (low, middle)
                sig[place] = start + n * first
        return sig


class Point:
    """The equations' values and derivatives at one vector of signals.

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
    """

    def __init__(self, equations: Equations, sig: np.ndarray, blocks: list[Block], stirred: Iterable[int] = ()):
        self.equations, self.sig, self.blocks, self.stirred = equations, sig, blocks, list(stirred)
        size = equations.size
        self.residual = np.zeros(size)
        self.rates = np.zeros(size, dtype=bool)
        self.active = np.zeros(size, dtype=bool)
        self.period = np.zeros(size)  # of a sampled state
        self.rows: list[np.ndarray] = []
        self.columns: list[np.ndarray] = []
        self.values: list[np.ndarray] = []
        for block in blocks:
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
        """Triples of -omega J over all pairs that are states, in (2) and (5)."""
        rows, columns, values = [], [], []
        for island, speed in zip(self.equations.islands, omega, strict=True):
            for a, b in island.pairs:
                if self.rates[a] and self.active[a]:
                    rows += [a, b]
                    columns += [b, a]
                    values += [speed, -speed]
        return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64), np.array(values)

    def turned(self, omega: np.ndarray) -> np.ndarray:
        """The residual in the turning frames: (2) to (6)."""
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

    def generator(self) -> list[np.ndarray]:
        """For each island, what its vectors and angles do when it is turned: d sig / d angle."""
        found = []
        for island in self.equations.islands:
            g = np.zeros(self.equations.size)
            for a, b in island.pairs:
                g[a], g[b] = -self.sig[b], self.sig[a]
            g[island.angles] = 1.0
            found.append(g)
        return found


def wrapped(angle: float) -> float:
    """`angle` brought to -pi .. pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
