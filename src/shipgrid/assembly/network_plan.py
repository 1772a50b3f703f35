"""From network to the arrays of the nodal solver: elements, ports, order of elimination, bridges."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from shipgrid.assembly.layout import ONE, ZERO, Layout
from shipgrid.assembly.line_end import LineEnd, end_matrices, end_space
from shipgrid.assembly.partition import Part
from shipgrid.errors import TopologyError
from shipgrid.model.component import type_of
from shipgrid.model.connections import AcBus, DcBus, PortBinding
from shipgrid.model.network import Network
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.solvers.companion import GAMMA, stage_matrices, state_space
from shipgrid.solvers.nodal import NetworkPlan
from shipgrid.solvers.topology import elimination_order, later_neighbours

ABSURD = {DcBus: 3.0, AcBus: 4.0}
"""A node voltage beyond this multiple of the nominal peak means that the run has diverged: no equipment stands it."""


def network_plan(network: Network, layout: Layout, step: float) -> NetworkPlan:
    """Arrays of the nodal solver; nodes are renumbered into their order of elimination."""
    gh = GAMMA * step
    ends = network.ends if isinstance(network, Part) else []
    cut = {end.placed.path for end in ends if end.near}
    elements = [p for t in layout.types if t.kind.linear for p in t.placed if p.path not in cut]
    machines = [p for t in layout.types if t.kind.stamped for p in t.placed]
    meeting = [list(p.ports.values()) for p in elements + machines] + [end.bindings for end in ends]
    pairs = _pairs(network, layout.nodes, meeting)
    order = elimination_order(len(layout.nodes), pairs)
    rank = {old: new for new, old in enumerate(order)}
    names = [layout.nodes[k] for k in order]
    number = {name: k for k, name in enumerate(names)}
    n = len(names)
    later, neighbour = later_neighbours(n, [(rank[a], rank[b]) for a, b in pairs])

    @cache
    def matrices(item: Any, positions: tuple[tuple[str, ...] | None, ...]) -> tuple[Any, list[Any]]:
        """Of equal elements, the axes of a three-phase one among them, once: B, sources; matrices in each position."""
        states = names_of(type_of(item).state)
        spaces = [state_space(item, k) for k in range(len(positions))]
        held = [None if v is None else tuple(states.index(s) for s in v) for v in positions]
        return spaces[0], [stage_matrices(space, gh, rows) for space, rows in zip(spaces, held, strict=True)]

    ports, sparse = _Ports(layout, number), _Sparse()
    state_signal: list[int] = []
    driven: list[tuple[int, int, float]] = []  # place of a state, port and rate, for every state that a port drives

    def add(
        placed: Placed,
        selector: str | None,
        space: Any,
        blocks: list[Any],
        sources: list[int],
        states: list[str],
        met: list[Any],
    ) -> None:
        """Add one linear element: what moves its contacts, matrices, places of its sources, states, and its ports."""
        selected = layout.place(selector, placed.path) if selector else None
        sparse.add(blocks, len(state_signal), len(ports), sources, selected)
        places = [layout.slots["x", f"{placed.path}.{s}"] for s in states]
        state_signal.extend(places)
        for r, c in zip(*np.nonzero(space.B[:, : len(met)]), strict=True):
            driven.append((places[r], len(ports) + int(c), float(space.B[r, c])))
        ports.add(placed.path, met)

    for placed in elements:
        space, blocks = matrices(placed.item, tuple(placed.positions))
        sources = [layout.slots["u", f"{placed.path}.{name}"] for name in space.sources]
        states = names_of(type_of(placed.item).state)
        add(placed, placed.variant, space, blocks, sources, states, _terminals(layout, placed))
    line_port = []
    for end in ends:
        space, blocks = end_space(end, 0, step), end_matrices(end, step, gh)
        sources = [layout.slots["u", f"{end.placed.path}.{name}"] for name in space.sources[:-1]]
        sources.append(layout.index[f"{end.name}.wave"])
        met = _terminals(layout, end.placed, end.rest)
        if end.at_node:
            met.append((end.node, layout.index[f"{end.name}.v"], layout.index[f"{end.name}.i"]))
        says = layout.index[f"{end.name}.says"]  # it meets no node: no voltage to be told
        met.append((PortBinding(None), says, says))
        add(end.placed, end.position, space, blocks, sources, end.states, met)
        line_port.append(len(ports) - 1)
    n_linear_ports = len(ports)
    machine_w, machine_port = [], []
    for placed in machines:
        machine_w.append(ports.w_next)
        machine_port.append(len(ports))
        ports.add(placed.path, _terminals(layout, placed))

    terms = ports.terms()
    capacitance = np.array([network.capacitances.get(name, 0.0) for name in names])
    bus_of = {node: bus for bus in network.buses.values() for node in bus.nodes}
    peak = {DcBus: 1.0, AcBus: math.sqrt(2.0 / 3.0)}
    limit = np.array([ABSURD[type(bus_of[m])] * bus_of[m].v_n * peak[type(bus_of[m])] for m in names])
    return NetworkPlan(
        gh=gh,
        n_nodes=n,
        node_signal=_integers(layout.index[name] for name in names),
        node_c_gh=capacitance / gh,
        node_g=np.array([network.conductances.get(name, 0.0) for name in names]),
        node_limit=limit,
        state_signal=_integers(state_signal),
        **sparse.arrays(),
        n_linear_ports=n_linear_ports,
        mean_port=_integers(()),
        mean_node=_integers(()),
        n_linear_terms=sum(1 for t in terms if t[1] < n_linear_ports),
        **ports.arrays(terms),
        later=later,
        neighbour=neighbour,
        used=_integers(sorted({t[3] for t in terms} | _entries(n, later, neighbour))),
        machine_w=_integers(machine_w),
        machine_port=_integers(machine_port),
        **_bridges(network, layout, ports, driven),
        **_lines(layout, ends, line_port),
    )


def _terminals(layout: Layout, placed: Placed, names: list[str] | None = None) -> list[tuple[PortBinding, int, int]]:
    """Where an element's terminals, or those of these names, meet the nodes; places of voltage and current."""
    return [
        (
            placed.ports[terminal.name],
            layout.slots["u", f"{placed.path}.{terminal.v}"],
            layout.slots["y", f"{placed.path}.{terminal.i}"],
        )
        for terminal in type_of(placed.item).terminals
        if names is None or terminal.name in names
    ]


def _lines(layout: Layout, ends: list[LineEnd], line_port: list[int]) -> dict[str, np.ndarray]:
    """Fields of `NetworkPlan` that describe the ends of stub lines."""

    def places(name: str) -> list[int]:
        return [layout.index[f"{end.name}.{name}"] for end in ends]

    kept = places("i")  # the far end has no element whose current it is
    for k, end in enumerate(ends):
        if end.near:
            kept[k] = layout.slots["x", f"{end.placed.path}.{end.state}"]
    outputs = places("i")
    for k, end in enumerate(ends):
        if end.near:
            terminal = next(t for t in type_of(end.placed.item).terminals if t.name == end.terminal)
            outputs[k] = layout.slots["y", f"{end.placed.path}.{terminal.i}"]
    closed = np.ones((len(ends), max([len(end.placed.positions) for end in ends] or [1])), dtype=np.int64)
    for k, end in enumerate(ends):
        closed[k] = not end.opens[0]  # a position that there is not is the first
        closed[k, : len(end.opens)] = ~np.array(end.opens)
    return {
        "line_in": _integers(places("in_1") + places("in_2"), 2, len(ends)),
        "line_out": _integers(places("out_1") + places("out_2"), 2, len(ends)),
        "line_wave": _integers(places("wave")),
        "line_port": _integers(line_port),
        "line_select": _integers(layout.index[end.position] if end.position else ZERO for end in ends),
        "line_before": _integers(places("before")),
        "line_sent": _integers(places("sent")),
        "line_closed": closed,
        "line_state": _integers(kept),
        "line_current": _integers(outputs),
        "line_sense": np.array([end.senses for end in ends], dtype=float).reshape(-1, 2),
    }


def _integers(values: Any, *shape: int) -> np.ndarray:
    return np.array(list(values), dtype=np.int64).reshape(*(shape or (-1,)))


def _pairs(network: Network, nodes: list[str], around: list[list[PortBinding]]) -> list[tuple[int, int]]:
    """Nodes, by their number, that an element joins, or a floating leg: it couples what meets its bridge's poles."""
    number = {name: k for k, name in enumerate(nodes)}
    meeting: list[list[int]] = []
    at_pole: dict[str, list[int]] = {}
    for bindings in around:
        ends = {node for binding in bindings for node in (binding.plus, binding.minus) if node is not None}
        met = sorted(number[node] for node in ends)
        meeting.append(met)
        for binding in bindings:
            if binding.coefficient:
                at_pole.setdefault(binding.coefficient, []).extend(met)
    meeting += [[k for pole in legs.poles for k in at_pole.get(pole, [])] for legs in network.legs.values()]
    return [(a, b) for met in meeting for a in met for b in met]


def _entries(n: int, later: np.ndarray, neighbour: np.ndarray) -> set[int]:
    """Places in the matrix of what elimination reads and writes: the diagonal, and each node with its later ones."""
    width = n + 1
    found = {k * width + k for k in range(n)}
    for k in range(n):
        for c in neighbour[later[k] : later[k + 1]]:
            found |= {k * width + int(c), int(c) * width + k}
    return found


class _Ports:
    """Ports of all elements and machines, in their order: where they are connected, and their part in the matrix."""

    def __init__(self, layout: Layout, number: dict[str, int]):
        self.layout, self.number = layout, number
        self.n = len(number)
        self.plus: list[int] = []
        self.minus: list[int] = []
        self.c: list[int] = []
        self.v: list[int] = []
        self.i: list[int] = []
        self.w: list[int] = []
        self.first: list[int] = []
        self.count: list[int] = []
        self.weight: list[float] = []
        self.at_pole: dict[str, list[int]] = {}
        self.w_next = 0

    def __len__(self) -> int:
        return len(self.plus)

    def add(self, path: str, terminals: list[tuple[PortBinding, int, int]]) -> None:
        """Add the terminals of one element: where each meets the nodes, places of its voltage and its current."""
        m, first = len(terminals), len(self)
        for r, (binding, v, i) in enumerate(terminals):
            self.plus.append(self.number[binding.plus] if binding.plus else self.n)
            self.minus.append(self.number[binding.minus] if binding.minus else self.n)
            self.c.append(self.layout.place(binding.coefficient, path) if binding.coefficient else ONE)
            self.v.append(v)
            self.i.append(i)
            self.w.append(self.w_next + r * m)
            self.first.append(first)
            self.count.append(m)
            self.weight.append(binding.weight)
            if binding.coefficient:
                self.at_pole.setdefault(binding.coefficient, []).append(first + r)
        self.w_next += m * m

    def ends(self, j: int) -> list[tuple[float, int]]:
        """Sign and number of the nodes at a port; ground is none."""
        return [(sign, node) for sign, node in ((1.0, self.plus[j]), (-1.0, self.minus[j])) if node != self.n]

    def terms(self) -> list[tuple[int, int, int, int, float]]:
        """What the ports' admittances add to the matrix: place of w, both ports, place in the matrix, factor."""
        return [
            (self.w[j] + c, j, self.first[j] + c, node_j * (self.n + 1) + node_k, sign_j * sign_k * self.weight[j])
            for j in range(len(self))
            for sign_j, node_j in self.ends(j)
            for c in range(self.count[j])
            for sign_k, node_k in self.ends(self.first[j] + c)
        ]

    def arrays(self, terms: list[tuple[int, int, int, int, float]]) -> dict[str, np.ndarray]:
        """Fields of `NetworkPlan`."""
        inject = [(j, node, sign * self.weight[j]) for j in range(len(self)) for sign, node in self.ends(j)]
        found = {f"port_{key}": _integers(getattr(self, key)) for key in ("plus", "minus", "c", "v", "i", "w")}
        return found | {
            "port_first": _integers(self.first),
            "port_count": _integers(self.count),
            "port_weight": np.array(self.weight, dtype=float),
            "term_w": _integers(t[0] for t in terms),
            "term_j": _integers(t[1] for t in terms),
            "term_k": _integers(t[2] for t in terms),
            "term_y": _integers(t[3] for t in terms),
            "term_factor": np.array([t[4] for t in terms]),
            "inject_port": _integers(t[0] for t in inject),
            "inject_node": _integers(t[1] for t in inject),
            "inject_factor": np.array([t[2] for t in inject]),
        }


def _bridges(
    network: Network, layout: Layout, ports: _Ports, driven: list[tuple[int, int, float]]
) -> dict[str, np.ndarray]:
    """Fields of `NetworkPlan` that describe bridges and their legs."""
    found: dict[str, list[Any]] = {
        key: [] for key in ("lo", "hi", "lead", "wait", "sampled", "rate", "port", "node", "weight", "s", "meter")
    }
    leg_first, related_first, related, touched_first, touched = [0], [0], [], [0], []
    clamps: list[int] = []
    diodes: list[float] = []
    lead: list[tuple[int, int, int, float]] = []
    at_poles: dict[int, str] = {}
    for b, legs in enumerate(network.legs.values()):
        met = [ports.at_pole.get(pole, []) for pole in legs.poles]
        if any(len(j) != 1 for j in met):
            how = "nothing" if not any(met) else "more than one terminal"
            raise TopologyError(f"{legs.path}: its poles feed {how}, expected one terminal")
        poles = [j[0] for j in met]
        for phase in legs.phases:
            for key in ("lo", "hi", "lead"):
                found[key].append(layout.place(f"{legs.modulator}.{key}{phase}", legs.path))
            for key in ("wait", "sampled"):
                found[key].append(layout.index.get(f"{legs.modulator}.{key}{phase}", ZERO))
            own = [abs(rate) for _, j, rate in driven if j == poles[0] and len(legs.phases) == 1]
            found["rate"].append(own[0] if own else 0.0)
        leg_first.append(len(found["lo"]))
        node = ports.number[legs.bus.nodes[0]]
        found["port"].append([*poles, poles[0]][:2])
        found["node"].append(node)
        found["weight"].append(legs.weight)
        places = [layout.index[pole] for pole in legs.poles]
        found["s"].append([*places, places[0]][:2])
        found["meter"].append(layout.index[f"{legs.path}.i_dc"])
        firsts = sorted({ports.first[j] for j in poles})
        for first in firsts:
            other = at_poles.setdefault(first, legs.path)
            if other != legs.path:
                raise TopologyError(
                    f"{other} and {legs.path} feed the same element: expected a bridge at one of its terminals only"
                )
        related += [first + c for first in firsts for c in range(ports.count[first])]
        nodes = {k for j in related[related_first[-1] :] for k in (ports.plus[j], ports.minus[j])}
        touched += sorted(nodes | {node})
        related_first.append(len(related))
        touched_first.append(len(touched))
        diodes.append(network.placed[legs.path].item.R_d)
        clamps += [node] if node not in clamps else []
        lead += [(place, b, poles.index(j), rate) for place, j, rate in driven if j in poles]
    bridges = len(network.legs)

    return {
        "leg_first": _integers(leg_first),
        "leg_lo": _integers(found["lo"]),
        "leg_hi": _integers(found["hi"]),
        "leg_lead": _integers(found["lead"]),
        "leg_wait": _integers(found["wait"]),
        "leg_sampled": _integers(found["sampled"]),
        "leg_rate": np.array(found["rate"], dtype=float),
        "bridge_port": _integers(found["port"], bridges, 2),
        "bridge_node": _integers(found["node"]),
        "bridge_weight": np.array(found["weight"], dtype=float),
        "bridge_s": _integers(found["s"], bridges, 2),
        "bridge_meter": _integers(found["meter"]),
        "related_first": _integers(related_first),
        "related": _integers(related),
        "touched_first": _integers(touched_first),
        "touched": _integers(touched),
        "clamp_node": _integers(clamps),
        "bridge_clamp": _integers(clamps.index(node) for node in found["node"]),
        "bridge_r": np.array(diodes, dtype=float),
        "lead_state": _integers(k for k, *_ in lead),
        "lead_bridge": _integers(b for _, b, _, _ in lead),
        "lead_axis": _integers(axis for _, _, axis, _ in lead),
        "lead_rate": np.array([rate for *_, rate in lead], dtype=float),
    }


class _Sparse:
    """Matrices of all linear elements as sparse rows, and what changes in them with the position of contacts.

    An entry that is zero in every position is left out.
    """

    PARTS = ("m", "n", "b", "c", "d", "w")

    def __init__(self) -> None:
        self.values: dict[str, list[float]] = {part: [] for part in self.PARTS}
        self.rows: dict[str, list[int]] = {"m": [0], "n": [0], "c": [0]}
        self.columns: dict[str, list[int]] = {part: [] for part in "mnc"}
        self.entries: dict[str, list[tuple[int, int]]] = {"b": [], "d": []}
        self.switched: list[tuple[int, int, list[tuple[str, int]], np.ndarray]] = []

    def add(
        self,
        blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
        state: int,
        port: int,
        sources: list[int],
        selector: int | None,
    ) -> None:
        """Add one element, its matrices in each position; `state` and `port` are the numbers of its first ones."""
        n, m = blocks[0][0].shape[0], blocks[0][4].shape[0]
        slots: list[tuple[str, int]] = []
        columns: list[list[float]] = []

        def entry(part: str, numbers: list[float], *, always: bool = False) -> bool:
            if not always and not any(numbers):
                return False
            slots.append((part, len(self.values[part])))
            self.values[part].append(numbers[0])
            columns.append(numbers)
            return True

        def rows(part: str, which: int, height: int, first: int, width: int, offset: int) -> None:
            for r in range(height):
                for c in range(first, first + width):
                    if entry(part, [float(block[which][r, c]) for block in blocks]):
                        self.columns[part].append(offset + c - first)
                self.rows[part].append(len(self.columns[part]))

        rows("m", 0, n, 0, n, state)
        rows("n", 1, n, 0, m, port)
        rows("c", 2, m, 0, n, state)
        for part, which, height, offset in (("b", 1, n, state), ("d", 3, m, port)):
            for r in range(height):
                for c, source in enumerate(sources):
                    if entry(part, [float(block[which][r, m + c]) for block in blocks]):
                        self.entries[part].append((offset + r, source))
        for r in range(m):
            for c in range(m):
                entry("w", [float(block[4][r, c]) for block in blocks], always=True)
        if selector is not None:
            self.switched.append((selector, len(blocks), slots, np.array(columns).T.ravel()))

    def arrays(self) -> dict[str, np.ndarray]:
        """Fields of `NetworkPlan`."""
        starts = self.starts()

        found = {f"{part}_row": _integers(self.rows[part]) for part in "mnc"}
        found |= {f"{part}_col": _integers(self.columns[part]) for part in "mnc"}
        for part in "bd":
            found[f"{part}_row"] = _integers(r for r, _ in self.entries[part])
            found[f"{part}_source"] = _integers(s for _, s in self.entries[part])
        flat = [len(numbers) for *_, numbers in self.switched]
        lengths = [len(slots) for _, _, slots, _ in self.switched]
        return found | {
            "linear_values": np.array([v for part in self.PARTS for v in self.values[part]]),
            "part_start": _integers(starts[part] for part in self.PARTS),
            "element_variant": _integers(s for s, *_ in self.switched),
            "element_positions": _integers(k for _, k, *_ in self.switched),
            "slot_start": _integers(np.cumsum([0, *lengths])),
            "slot": _integers(starts[part] + k for _, _, slots, _ in self.switched for part, k in slots),
            "position_start": _integers(np.cumsum([0, *flat])[:-1]),
            "position_values": np.concatenate([numbers for *_, numbers in self.switched] or [np.zeros(0)]),
        }

    def starts(self) -> dict[str, int]:
        """Where each part starts in the concatenation."""
        lengths = [len(self.values[part]) for part in self.PARTS]
        return dict(zip(self.PARTS, [0, *np.cumsum(lengths)[:-1].tolist()], strict=True))
