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

Here is who stands where: `point` has values and derivatives at one z, and which states of it stand still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.analysis.component_equations import ComponentKernels
from shipgrid.analysis.dead_time import DeadTime, pade
from shipgrid.analysis.islands import find_islands, pairs_of
from shipgrid.assembly.layout import ONE, ZERO
from shipgrid.assembly.plan import Plan
from shipgrid.model.component import type_of
from shipgrid.model.connections import Legs
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.modulators.gates import LOWER, UPPER
from shipgrid.solvers.companion import state_space

MODULATION_DELAY = 1.5
"""Sampling periods from a sample to the middle of the hold of what was computed from it."""
SAMPLED, SAMPLED_LEG, DIRECT = ("s_alpha_ref", "s_beta_ref"), ("s_ref",), ("s_alpha", "s_beta")
"""What modulators put in force: a reference held from instant to instant, or a vector at once."""
MARGIN = 1e-6
"""Share of the bus voltage by which the voltage of a blocked bridge may pass it before its diodes conduct."""


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
        """Voltage [V] at which the state stands still.

        Parameters
        ----------
        sig : ndarray
            All signals.
        alias : ndarray of int
            Place of the signal that stands behind each place.
        """
        others = np.delete(self.B, self.column) @ np.delete(sig[alias[self.u]], self.column)
        return float(-(self.A @ sig[self.x] + others) / self.B[self.column])


class Equations:
    """The equations of a plan, with its contacts as they stand in a flat vector.

    Parameters
    ----------
    plan : Plan
    sig : ndarray
        A flat vector: contacts and gates are as it says.
    order, order_line : int
        Orders of the Pade quotients for the dead time of a modulation, and for that of a delay line.

    Attributes
    ----------
    size : int
        Length of the vector of all signals: the plan's flat vector, then the states of the dead times.
    alias : ndarray of int
        Place of the signal that stands behind each place.
    inner : ndarray of int
        The same as a kernel sees it: behind the dead times.
    kernels : list of ComponentKernels
        Of every component that is no linear element.
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
            ComponentKernels(plan, t, k)
            for t in layout.types
            if not t.kind.linear and set(t.kind.kernels) & {"derivatives", "update", "outputs"}
            for k in range(len(t.placed))
        ]
        for kernels in self.kernels:
            kernels.refuse_time()
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
        """What to tell of a blocked bridge whose diodes would conduct at a point; empty if there is none.

        Parameters
        ----------
        sig : ndarray
            All signals at the point.
        """
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

    def generators(self, sig: np.ndarray) -> list[np.ndarray]:
        """For each island, what its vectors and angles do when it is turned: d sig / d angle.

        Parameters
        ----------
        sig : ndarray
            All signals.
        """
        found = []
        for island in self.islands:
            g = np.zeros(self.size)
            for a, b in island.pairs:
                g[a], g[b] = -sig[b], sig[a]
            g[island.angles] = 1.0
            found.append(g)
        return found
