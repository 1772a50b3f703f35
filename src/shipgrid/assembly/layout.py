"""Who owns which slice of the flat vectors, and which number every name stands for.

The flat vector `sig` holds, in this order: the constants 0 and 1, the commands, the node voltages, and for each
component type in use the states, inputs and outputs of all its instances. Of a plant in parts (`partition.py`) each
part has a stretch of it; what it reads of others, and its ends of stub lines, come after its node voltages.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from shipgrid.assembly.line_end import SIGNALS
from shipgrid.assembly.partition import Part
from shipgrid.errors import TopologyError
from shipgrid.model.component import ComponentType, fields_of, type_of
from shipgrid.model.network import Network
from shipgrid.model.placed import Placed
from shipgrid.model.records import initial_of, names_of, parameter_values, size_of
from shipgrid.names import nearest

ZERO, ONE = 0, 1
GAP = 16
"""Unused places between what two cores write: they share no cache line."""
NORTON_FIELDS = ("g_aa", "g_ab", "g_ba", "g_bb", "h_a", "h_b", "speed", "angle", "cos", "sin")
"""What a machine's `stamp` gives: conductances [S] and currents [A] of its Norton equivalent; and what its `advance`
takes over, speed, angle, its cosine and sine at the end of the stage."""


@dataclass
class TypeLayout:
    """All instances of one component type, and where their records lie."""

    kind: ComponentType
    placed: list[Placed]
    x: int = 0
    u: int = 0
    y: int = 0
    nx: int = 0
    nu: int = 0
    ny: int = 0
    parameters: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(eq=False)
class Layout:
    """The flat vector by name.

    Attributes
    ----------
    index : dict of str to int
        Place of every signal.
    unit, description : dict of str to str
        Unit and meaning of every signal.
    network_signals : set of int
        Places of node voltages, element states and port quantities: what a sampled controller measures between steps.
    angles : set of int
        Places of the states that rotate: between -pi and pi, and the same after a whole turn.
    smooth : set of int
        Places of what does not jump in the network: states of elements, voltages of nodes with capacitance.
    """

    size: int
    index: dict[str, int]
    unit: dict[str, str]
    description: dict[str, str]
    initial: np.ndarray
    types: list[TypeLayout]
    nodes: list[str]
    network_signals: set[int]
    angles: set[int]
    smooth: set[int]
    states: set[str]
    slots: dict[tuple[str, str], int]  # place of a field by kind of record ("x", "u", "y") and path
    tables: np.ndarray
    first: int  # place of the first signal of this stretch

    def place(self, path: str, asker: str) -> int:
        """Place of a signal in the flat vector.

        Raises
        ------
        TopologyError
            If there is none of that name; says who asked, and the nearest name.
        """
        if path in self.index:
            return self.index[path]
        raise TopologyError(f"{asker} reads '{path}', which does not exist{nearest(path, self.index)}")


def lay_out(network: Network, before: Layout | None = None, kinds: Iterable[ComponentType] = ()) -> Layout:
    """Give every signal of a network its place.

    Parameters
    ----------
    network : Network
    before : Layout, optional
        Of a part that has its stretch of the flat vector before this one.
    kinds : iterable of ComponentType
        Types that are laid out even where there is no instance of them.
    """
    index: dict[str, int] = {"": ZERO}
    unit: dict[str, str] = {}
    description: dict[str, str] = {}
    initial: list[float] = [0.0, 1.0] if before is None else [*before.initial, *[0.0] * GAP]
    beginning = 0 if before is None else len(initial)
    for command, value in network.commands.items():
        index[f"command:{command}"] = len(initial)
        initial.append(value)
    nodes = [node for bus in network.buses.values() for node in bus.nodes]
    network_signals, smooth = set(), set()
    for node in nodes:
        index[node] = len(initial)
        unit[node], description[node] = "V", "node voltage"
        network_signals.add(len(initial))
        if network.capacitances.get(node, 0.0) > 0.0:
            smooth.add(len(initial))
        initial.append(0.0)

    if isinstance(network, Part):
        initial.extend([0.0] * GAP)
        for path in network.foreign:
            index[path] = len(initial)
            initial.append(0.0)
        for name, meaning in SIGNALS.items():
            if name == "wave":  # up to here somebody else writes, between two steps
                initial.extend([0.0] * GAP)
            for end in network.ends:
                index[f"{end.name}.{name}"] = len(initial)
                unit[f"{end.name}.{name}"], description[f"{end.name}.{name}"] = meaning
                initial.append(0.0)

    types = by_type(network, kinds)
    states: set[str] = set()
    angles: set[int] = set()
    slots: dict[tuple[str, str], int] = {}
    tables: list[np.ndarray] = []
    for t in types:
        kind = t.kind
        t.nx, t.nu, t.ny = size_of(kind.state), size_of(kind.input), size_of(kind.output)
        for part, record, width in (("x", kind.state, t.nx), ("u", kind.input, t.nu), ("y", kind.output, t.ny)):
            setattr(t, part, len(initial))
            if not width:
                continue
            names = names_of(record)
            declared = {f.name: f for f in fields_of(record)}
            for placed in t.placed:
                values = initial_of(record)
                for name, value in placed.initial.items() if part == "x" else ():
                    if name not in names:
                        raise TopologyError(f"{placed.path} ({kind.name}) has no state '{name}', it has {names}")
                    values[names.index(name)] = value
                for k, name in enumerate(names):
                    path = f"{placed.path}.{name}"
                    slots[part, path] = len(initial) + k
                    if part == "x" and kind.terminals:
                        network_signals.add(len(initial) + k)
                        smooth.add(len(initial) + k)
                    if part == "x" and declared[name].signal.rotates:
                        angles.add(len(initial) + k)
                    if part == "u" and path in index:
                        continue  # of signals of one name an output is meant, else a state, else an input
                    index[path] = len(initial) + k
                    unit[path] = declared[name].unit
                    description[path] = declared[name].signal.description
                    states.discard(path)
                    if part == "x":
                        states.add(path)
                ends = {terminal.v for terminal in kind.terminals} | {terminal.i for terminal in kind.terminals}
                network_signals.update(len(initial) + k for k, name in enumerate(names) if name in ends)
                initial.extend(values)
        rows = [parameter_values(placed.item, tables) for placed in t.placed]
        t.parameters = np.concatenate(rows) if rows else np.zeros(0)
    # offsets into `tables` are positions in the concatenation, so the order above is the pool's order
    pool = np.concatenate(tables) if tables else np.zeros(1)
    return Layout(
        len(initial),
        index,
        unit,
        description,
        np.array(initial),
        types,
        nodes,
        network_signals,
        angles,
        smooth,
        states,
        slots,
        pool,
        beginning,
    )


def by_type(network: Network, kinds: Iterable[ComponentType] = ()) -> list[TypeLayout]:
    """Components of a network by their types, in the order of the flat vector, without their places in it.

    Parameters
    ----------
    network : Network
    kinds : iterable of ComponentType
        Types that are in the list even where there is no instance of them.
    """
    grouped: dict[str, TypeLayout] = {kind.key: TypeLayout(kind, []) for kind in kinds}
    for placed in network.placed.values():
        kind = type_of(placed.item)
        grouped.setdefault(kind.key, TypeLayout(kind, [])).placed.append(placed)
    return [grouped[key] for key in sorted(grouped)]


def united(parts: Sequence[tuple[Part, Layout]], kinds: Iterable[ComponentType]) -> Layout:
    """The flat vector of a plant in parts by name: the signals of all of them, and no component or node of its own."""
    whole = lay_out(Network(""), None, kinds)
    last = parts[-1][1]
    whole.size, whole.first, whole.initial = last.size, last.size, last.initial.copy()
    for part, layout in parts:
        own = {path: place for path, place in layout.index.items() if path not in part.foreign}
        whole.index |= own
        whole.unit |= layout.unit
        whole.description |= layout.description
        whole.network_signals |= layout.network_signals
        whole.angles |= layout.angles
        whole.smooth |= layout.smooth
        whole.states |= layout.states
        whole.slots |= layout.slots
    return whole
