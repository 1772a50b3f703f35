"""Cuts a plant into parts that need nothing of each other within a step.

The user names buses, in groups, or asks for a number of parts. Whatever joins buses of two groups is cut: in its place
stands a stub line (`solvers/stub_lines.py`). An element can be cut at a terminal whose current is that of an
inductance: a cable, or the grid side of a filter. Everything else goes with the buses of its item.

What a part reads of another is handed over between two steps. So a sampled controller sees what it sees in the uncut
plant; what another part's controller computes within the same step it sees a step later. A contact in an element that
is cut moves at both ends at once, and a step later too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from shipgrid.assembly.line_end import LineEnd, inductance, state_behind
from shipgrid.errors import TopologyError
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.network import Network
from shipgrid.model.placed import Placed
from shipgrid.solvers.companion import state_space

SURPLUS = 0.05
"""Largest capacitance of a line, over that of the better of its ends, at which a plant is cut without being told to."""


@dataclass
class Part(Network):
    """What one part of a plant has of its network.

    Attributes
    ----------
    ends : list of LineEnd
    foreign : list of str
        Paths of the signals of other parts that it reads.
    """

    ends: list[LineEnd] = field(default_factory=list, init=False)
    foreign: list[str] = field(default_factory=list, init=False)


@dataclass(frozen=True)
class Surplus:
    """What a stub line has that the inductance it stands for has not.

    Attributes
    ----------
    path : str
        Of the element, of a three-phase one without its axis.
    parts : (str, str)
        Which parts it joins.
    L, C : float
        Inductance [H], and the capacitance that a delay of one step gives the line [F].
    share : float
        That capacitance over that of the better of its ends; inf where neither has any.
    """

    path: str
    parts: tuple[str, str]
    L: float
    C: float
    share: float


@dataclass(frozen=True)
class Partition:
    """A plant in parts.

    Attributes
    ----------
    buses : dict of str to tuple of str
        Every bus of each part, by the part's name.
    parts : list of Part
    lines : list of Surplus
    """

    buses: dict[str, tuple[str, ...]]
    parts: list[Part]
    lines: list[Surplus]


def divide(network: Network, groups: Mapping[str, Sequence[str]], h: float) -> Partition:
    """Cut a network between groups of its buses.

    Parameters
    ----------
    network : Network
    groups : mapping of str to sequence of str
        Names of buses by the name of a part. Buses that are not named go with those they are joined to.
    h : float
        Step [s].

    Returns
    -------
    Partition

    Raises
    ------
    TopologyError
        If a bus does not exist or is named twice, a bus that is not named lies between two parts, or an element between
        two parts cannot be cut.
    """
    names = list(groups)
    for name in names:
        if isinstance(groups[name], str) or not groups[name]:
            raise TopologyError(f"{network.name}: part '{name}' is {groups[name]!r}, expected names of buses")
    part_of = _parts_of_nodes(network, groups)
    parts = [Part(f"{network.name}, part {name}", network.fidelity) for name in names]
    owner: dict[str, int] = {}
    lines: dict[str, Surplus] = {}
    for placed in network.placed.values():
        if not placed.ports:
            continue
        cut = _cut(network, placed, part_of)
        owner[placed.path] = cut[0]
        if len(cut) == 1:
            continue
        near, far, terminal = cut
        ends = [LineEnd(placed, terminal, side, inductance(placed, terminal)) for side in (True, False)]
        for part, end in zip((near, far), ends, strict=True):
            parts[part].ends.append(end)
        path = placed.path.removesuffix(".alpha").removesuffix(".beta")
        L, C, C_end = ends[0].L, h**2 / ends[0].L, _capacitance(network, placed, terminal)
        lines[path] = Surplus(path, (names[near], names[far]), L, C, C / C_end if C_end else math.inf)
    _follow(network, part_of, owner)
    for name, bus in network.buses.items():
        parts[part_of[bus.nodes[0]]].buses[name] = bus
    for part in parts:
        nodes = {node for bus in part.buses.values() for node in bus.nodes}
        part.capacitances.update({n: c for n, c in network.capacitances.items() if n in nodes})
        part.conductances.update({n: g for n, g in network.conductances.items() if n in nodes})
        part.shunts += [shunt for shunt in network.shunts if shunt[0] in nodes]
    for path, placed in network.placed.items():
        parts[owner[path]].placed[path] = placed
    for path, legs in network.legs.items():
        parts[owner[path]].legs[path] = legs
    _hand_out_commands(network, owner, parts)
    for part in parts:
        part.foreign += _foreign(network, part)
    buses = {name: tuple(part.buses) for name, part in zip(names, parts, strict=True)}
    return Partition(buses, parts, list(lines.values()))


def propose(network: Network, count: int, h: float) -> dict[str, tuple[str, ...]]:
    """Groups of buses for a number of parts, or as many as there can be: what `divide` takes.

    Cut at every place where the surplus capacitance of a line is small, the plant falls into pieces; the lightest piece
    is joined to its lightest neighbour until there are no more than asked for. A part has the name of its first bus.

    Parameters
    ----------
    network : Network
    count : int
        Largest number of parts.
    h : float
        Step [s].
    """
    pieces = _Sets(node for bus in network.buses.values() for node in bus.nodes)
    for bus in network.buses.values():
        pieces.join(bus.nodes)
    between: list[tuple[str, str]] = []
    for placed in network.placed.values():
        ends = _easy_cut(network, placed, h)
        if ends is None:
            pieces.join(_nodes(placed))
        else:
            between.append(ends)
    bus_of = {node: name for name, bus in network.buses.items() for node in bus.nodes}
    weight = dict.fromkeys(bus_of, 0)
    for placed in network.placed.values():
        for node in _nodes(placed)[:1]:
            weight[pieces.of(node)] += 1
    order = {node: k for k, node in enumerate(bus_of)}
    while len({pieces.of(node) for node in bus_of}) > max(1, count):
        pairs = {frozenset((pieces.of(a), pieces.of(b))) for a, b in between if pieces.of(a) != pieces.of(b)}
        if not pairs:  # islands that nothing joins
            roots = sorted({pieces.of(node) for node in bus_of}, key=lambda root: (weight[root], order[root]))
            pairs = {frozenset(roots[:2])}
        lightest = min(pairs, key=lambda pair: (sorted(weight[n] for n in pair), sorted(order[n] for n in pair)))
        total = sum(weight[node] for node in lightest)
        pieces.join(sorted(lightest, key=order.__getitem__))
        weight[pieces.of(next(iter(lightest)))] = total
    found: dict[str, list[str]] = {}
    for name, bus in network.buses.items():
        found.setdefault(pieces.of(bus.nodes[0]), []).append(name)
    return {names[0]: tuple(names) for names in found.values()}


def _nodes(placed: Placed) -> list[str]:
    """Nodes an element meets, a converter's DC node among them."""
    ends = (node for binding in placed.ports.values() for node in (binding.plus, binding.minus))
    return list(dict.fromkeys(node for node in ends if node is not None))


def _capacitance(network: Network, placed: Placed, terminal: str) -> float:
    """The larger capacitance at the two ends of an inductance: of its nodes, or behind the terminal in its element."""
    kind, space = type_of(placed.item), state_space(placed.item)
    row = state_behind(space, [t.name for t in kind.terminals].index(terminal))
    fields = fields_of(kind.state)
    inside = [] if row is None else [
        1.0 / abs(space.A[k, row]) for k in range(len(space.A)) if fields[k].unit == "V" and space.A[k, row] != 0.0
    ]  # fmt: skip
    found = [network.capacitances.get(node, 0.0) for b in placed.ports.values() if b.coefficient is None
             for node in (b.plus, b.minus) if node]  # fmt: skip
    return max([0.0, *found, *inside])


class _Sets:
    """Disjoint sets of names."""

    def __init__(self, names: Iterable[str]):
        self.up = {name: name for name in names}

    def of(self, name: str) -> str:
        """Which set a name is in."""
        while self.up[name] != name:
            name = self.up[name]
        return name

    def join(self, names: Sequence[str]) -> None:
        """Make one set of those that the names are in; it is called after the first."""
        for name in names[1:]:
            self.up[self.of(name)] = self.of(names[0])


def _parts_of_nodes(network: Network, groups: Mapping[str, Iterable[str]]) -> dict[str, int]:
    """Part of every node."""
    named: dict[str, int] = {}
    for k, (group, buses) in enumerate(groups.items()):
        for bus in buses:
            for node in network.bus(bus).nodes:
                if named.setdefault(node, k) != k:
                    raise TopologyError(f"{network.name}: bus '{bus}' is in two parts, '{group}' is the second")
    sets = _Sets(node for bus in network.buses.values() for node in bus.nodes)
    for bus in network.buses.values():
        sets.join(bus.nodes)
    for placed in network.placed.values():
        nodes = _nodes(placed)
        if len({named[node] for node in nodes if node in named}) < 2:
            sets.join(nodes)
    found: dict[str, int] = {}
    for node, k in named.items():
        if found.setdefault(sets.of(node), k) != k:
            inside = _between(network, named, {n for n in sets.up if sets.of(n) == sets.of(node)})
            a, b = (list(groups)[p] for p in sorted({found[sets.of(node)], k}))
            raise TopologyError(
                f"{network.name}: {' and '.join(inside)} between the parts '{a}' and '{b}', expected in one of them"
            )
    return {node: found.get(sets.of(node), 0) for node in sets.up}


def _between(network: Network, named: Mapping[str, int], nodes: set[str]) -> list[str]:
    """Buses without a part on the way from one part to another: what hangs on one side only is left out."""
    bus_of = {node: name for name, bus in network.buses.items() for node in bus.nodes}
    met = [{bus_of[node] for node in _nodes(placed) if node in nodes} for placed in network.placed.values()]
    mine = {bus_of[node] for node in named}
    left = {bus_of[node] for node in nodes}
    while True:
        beside = {n: set().union(*(group for group in met if n in group)) & left - {n} for n in left}
        ends = {n for n in left - mine if len(beside[n]) < 2}
        if not ends:
            break
        left -= ends
    return [name for name in network.buses if name in left - mine]


def _cut(network: Network, placed: Placed, part_of: Mapping[str, int]) -> tuple[int] | tuple[int, int, str]:
    """Part of an element; of one between two parts the nearer, the other, and the terminal where it is cut."""
    kind = type_of(placed.item)
    touched = sorted({part_of[node] for node in _nodes(placed)})
    if len(touched) < 2:
        return (touched[0] if touched else 0,)
    at = {name: sorted({part_of[n] for n in (b.plus, b.minus) if n}) for name, b in placed.ports.items()}
    if kind.linear and len(touched) == 2:
        if len(at) == 1:
            ((name, binding),) = placed.ports.items()
            if binding.plus and binding.minus and binding.coefficient is None:
                return part_of[binding.plus], part_of[binding.minus], name
        for name, binding in placed.ports.items():
            rest = {part for other, parts in at.items() if other != name for part in parts}
            if binding.coefficient is None and len(rest) == 1 == len(at[name]) and rest != set(at[name]):
                return rest.pop(), at[name][0], name
    raise TopologyError(
        f"{placed.path} ({kind.name}) joins {len(touched)} parts of {network.name} and cannot be cut: expected a "
        "cable, or the grid side of a filter"
    )


def _easy_cut(network: Network, placed: Placed, h: float) -> tuple[str, str] | None:
    """Two nodes between which an element can be cut at small surplus, or None."""
    kind = type_of(placed.item)
    nodes = _nodes(placed)
    if not kind.linear or len(nodes) != 2 or not kind.state:
        return None
    part_of = {node: k for k, node in enumerate(nodes)}
    try:
        cut = _cut(network, placed, part_of)
        if len(cut) < 3:
            return None
        surplus = h**2 / inductance(placed, cut[2])
    except TopologyError:
        return None
    return (nodes[0], nodes[1]) if surplus <= SURPLUS * _capacitance(network, placed, cut[2]) else None


def _follow(network: Network, part_of: Mapping[str, int], owner: dict[str, int]) -> None:
    """Parts of the components that meet no node: that of their item, or of most of what they are connected with."""
    for path, legs in network.legs.items():
        owner[path] = owner[legs.modulator] = part_of[legs.bus.nodes[0]]
    votes: dict[str, list[int]] = {}
    for path, part in owner.items():
        votes.setdefault(path.split(".")[0], []).append(part)
    for path in network.placed:
        if path not in owner and path.split(".")[0] in votes:
            owner[path] = _most(votes[path.split(".")[0]])
    left = [path for path in network.placed if path not in owner]
    joined: dict[str, list[str]] = {path: [] for path in network.placed}
    for path, placed in network.placed.items():
        for source in _read(placed):
            other = _writer(network, source)
            if other is not None:
                joined[path].append(other)
                joined[other].append(path)
    while left:
        known = {path: [owner[o] for o in joined[path] if o in owner] for path in left}
        first = next((path for path in left if known[path]), left[0])
        item = first.split(".")[0]
        members = [path for path in left if path.split(".")[0] == item]
        part = _most([p for path in members for p in known[path]] or [0])
        owner.update(dict.fromkeys(members, part))
        left = [path for path in left if path not in owner]


def _most(votes: Sequence[int]) -> int:
    return min(set(votes), key=lambda part: (-votes.count(part), part))


def _read(placed: Placed) -> list[str]:
    """Paths of the signals a component reads."""
    found = [source for source in placed.inputs.values() if isinstance(source, str)]
    found += [binding.coefficient for binding in placed.ports.values() if binding.coefficient]
    return [str(path) for path in (*found, *([placed.variant] if placed.variant else []))]


def _writer(network: Network, source: str) -> str | None:
    """The component a signal belongs to; None for commands and node voltages."""
    words = source.split(".")
    return next((p for k in range(len(words) - 1, 0, -1) if (p := ".".join(words[:k])) in network.placed), None)


def _hand_out_commands(network: Network, owner: Mapping[str, int], parts: Sequence[Part]) -> None:
    """Give each command to the part that reads it first."""
    reader: dict[str, int] = {}
    for path, placed in network.placed.items():
        for source in _read(placed):
            if source.startswith("command:"):
                reader.setdefault(source.removeprefix("command:"), owner[path])
    for command, value in network.commands.items():
        parts[reader.get(command, 0)].commands[command] = value


def _foreign(network: Network, part: Part) -> list[str]:
    """Signals of other parts that a part's components read."""
    own = {node for bus in part.buses.values() for node in bus.nodes} | {f"command:{c}" for c in part.commands}
    asked = [source for placed in part.placed.values() for source in _read(placed)]
    found = []
    for source in dict.fromkeys(asked):
        writer = _writer(network, source)
        if source not in own and (writer is None or writer not in part.placed):
            found.append(source)
    return found
