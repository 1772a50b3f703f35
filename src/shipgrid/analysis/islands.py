"""Which quantities turn together: the AC islands of a plant, each with a frequency of its own.

Nothing in a plant knows where the alpha axis points. If every space vector of an island is turned by an angle, and
every angle in it moved by the same, all that follows turns along. So an AC plant at rest is one that turns evenly, and
in a frame that turns with it, it stands still:

    dx/dt = f(x) - omega J x        for a pair x = (alpha, beta), J = [[0, -1], [1, 0]]         (1)
    dtheta/dt = f(x) - omega        for an angle                                                (2)

with one unknown omega an island. The instant looked at is the one at which the frame's d axis lies on alpha: there the
pairs are their own d and q components, and every kernel is called as it stands.

Two fields are a pair if their names differ by `alpha` and `beta`. An island holds what shares an AC bus through closed
contacts, the bridges there with their modulators, and the controllers and meters that read its pairs and angles. A
motor behind its own bridge is an island too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.model.component import fields_of
from shipgrid.model.connections import AcBus
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of


@dataclass
class Island:
    """What turns with one frequency.

    Attributes
    ----------
    name : str
        An AC bus of it, or the component whose angle it is.
    pairs : list of (int, int)
        Places of the alpha and beta components of its space vectors: voltages, states, outputs.
    angles : list of int
        Places of the states that are angles in it.
    buses : list of str
        Its AC buses.
    """

    name: str
    pairs: list[tuple[int, int]] = field(default_factory=list)
    angles: list[int] = field(default_factory=list)
    buses: list[str] = field(default_factory=list)


def other_axis(name: str) -> str | None:
    """Name of the beta component that belongs to the alpha component `name`, if it is one.

    Parameters
    ----------
    name : str
        Of a field or signal.
    """
    head, _, last = name.rpartition(".")
    parts = last.split("_")
    if "alpha" not in parts:
        return None
    beta = "_".join("beta" if part == "alpha" else part for part in parts)
    return f"{head}.{beta}" if head else beta


def pairs_of(names: list[str]) -> list[tuple[int, int]]:
    """Positions of the pairs among field names.

    Parameters
    ----------
    names : list of str
    """
    found = []
    for k, name in enumerate(names):
        beta = other_axis(name)
        if beta in names:
            found.append((k, names.index(beta)))
    return found


def axis_twin(path: str) -> str | None:
    """Path of the beta element that belongs to a per-axis element `path.alpha`.

    Parameters
    ----------
    path : str
    """
    return f"{path.removesuffix('.alpha')}.beta" if path.endswith(".alpha") else None


class _Groups:
    """Union and find."""

    def __init__(self) -> None:
        self.parent: dict[str, str] = {}

    def root(self, name: str) -> str:
        self.parent.setdefault(name, name)
        while self.parent[name] != name:
            name = self.parent[name]
        return name

    def join(self, a: str, b: str) -> None:
        self.parent[self.root(b)] = self.root(a)


def find_islands(plan: Plan, alias: np.ndarray, opened: Iterable[str]) -> list[Island]:
    """Islands of a plant.

    Parameters
    ----------
    plan : Plan
    alias : ndarray
        Place of the signal that stands behind each place of the flat vector.
    opened : iterable of str
        Paths of the elements whose contacts are open.

    Returns
    -------
    list of Island
        In the order of their names; what turns with nothing (the position of a delay line) is in none.
    """
    network, layout, groups, cut = plan.network, plan.layout, _Groups(), set(opened)
    bus_of = {node: bus.name for bus in network.buses.values() if isinstance(bus, AcBus) for node in bus.nodes}
    owner: dict[int, str] = {layout.index[node]: f"bus {name}" for node, name in bus_of.items()}
    turning = {f"bus {name}" for name in bus_of.values()}
    placed_in: list[tuple[str, Placed, list[str], list[str], list[int], int, int]] = []
    for t in layout.types:
        states = names_of(t.kind.state)
        outputs = names_of(t.kind.output)
        rotating = [k for k, f in enumerate(fields_of(t.kind.state) if t.nx else ()) if f.signal.rotates]
        for k, placed in enumerate(t.placed):
            key = placed.path
            if t.kind.linear and placed.path.endswith((".alpha", ".beta")):
                key = placed.path.rpartition(".")[0]
                turning.add(key)
            if t.kind.stamped or pairs_of(states) or pairs_of(outputs):
                turning.add(key)
            x, y = t.x + k * t.nx, t.y + k * t.ny
            owner |= dict.fromkeys(range(x, x + t.nx), key) | dict.fromkeys(range(y, y + t.ny), key)
            placed_in.append((key, placed, states, outputs, rotating, x, y))
    for legs in network.legs.values():
        groups.join(legs.path, legs.modulator)
    for t in layout.types:
        names = names_of(t.kind.input)
        for k, placed in enumerate(t.placed):
            key = owner_key(placed.path, bool(t.kind.linear))
            for end in t.kind.terminals:
                binding = placed.ports[end.name]
                for node in (binding.plus, binding.minus):
                    if node in bus_of and placed.path not in cut:
                        groups.join(f"bus {bus_of[node]}", key)
                if binding.coefficient:
                    source = int(alias[layout.place(binding.coefficient, placed.path)])
                    if source in owner and (key in turning or owner[source] in turning):
                        groups.join(owner[source], key)
            if t.kind.linear and key in turning:  # sources of a three-phase element
                ends = {end.v for end in t.kind.terminals}
                for position, name in enumerate(names):
                    source = int(alias[t.u + k * t.nu + position])
                    if name not in ends and owner.get(source) in turning:
                        groups.join(owner[source], key)
            rotates = t.nx and any(f.signal.rotates for f in fields_of(t.kind.state))
            if t.kind.terminals or not (rotates or key in turning):
                continue
            u = t.u + k * t.nu
            pairs = pairs_of(names)
            for position in range(len(names)):
                source = int(alias[u + position])
                is_pair = any(position in pair for pair in pairs)
                if source in owner and (is_pair or _is_angle(plan, source)):
                    groups.join(owner[source], key)
                    turning.add(key)
                    break  # it may look at another island too, as a synchroniser does: its own is the one named first
    return _members(plan, groups, turning, placed_in)


def _members(
    plan: Plan,
    groups: _Groups,
    turning: set[str],
    placed_in: list[tuple[str, Placed, list[str], list[str], list[int], int, int]],
) -> list[Island]:
    """The islands with their pairs, angles and buses, from what is joined with what and which of it turns."""
    network, layout = plan.network, plan.layout
    islands: dict[str, Island] = {}

    def island(key: str) -> Island:
        return islands.setdefault(groups.root(key), Island(key.removeprefix("bus ")))

    for bus in network.buses.values():
        if isinstance(bus, AcBus):
            found = island(f"bus {bus.name}")
            found.buses.append(bus.name)
            found.pairs.append((layout.index[bus.nodes[0]], layout.index[bus.nodes[1]]))
    twins = {placed.path: (x, y) for _, placed, _, _, _, x, y in placed_in}
    for key, placed, states, outputs, rotating, x, y in placed_in:
        if key not in turning:
            continue
        found = island(key)
        beta = axis_twin(placed.path)
        if beta in twins:
            x_b, y_b = twins[beta]
            found.pairs += [(x + k, x_b + k) for k in range(len(states))]
            found.pairs += [(y + k, y_b + k) for k in range(len(outputs))]
        else:
            found.pairs += [(x + a, x + b) for a, b in pairs_of(states)]
            found.pairs += [(y + a, y + b) for a, b in pairs_of(outputs)]
        found.angles += [x + k for k in rotating]
    return sorted(islands.values(), key=lambda i: i.name)


def owner_key(path: str, linear: bool) -> str:
    """Name under which a component stands in an island: both axes of a three-phase element under one.

    Parameters
    ----------
    path : str
        Of the component.
    linear : bool
        Whether it is a linear element: only those have an axis each.
    """
    return path.rpartition(".")[0] if linear and path.endswith((".alpha", ".beta")) else path


def _is_angle(plan: Plan, place: int) -> bool:
    for t in plan.layout.types:
        if t.nx and t.x <= place < t.x + t.nx * len(t.placed):
            return fields_of(t.kind.state)[(place - t.x) % t.nx].signal.rotates
    return False
