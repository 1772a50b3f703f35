"""Which component types run when within a step: lists of calls of their units, walked through by the core.

Types run stage by stage; within a stage each after those whose outputs it reads. Continuous components are integrated
side by side by Heun's rule: what they read of each other is taken where they are, at the step's start for the first
rates, where these lead for the second ones. What the network reads of a component that runs in every step is half-way
there, and stands for the mean of the step; the network's own smooth quantities are carried on to there from the step
before. So a chain of components is of second order as each of them is, and so is a loop through the network, but for a
direct path from something that jumps (the voltage of a node without capacitance), which is that of the step's start. A
component with a clock of its own is moved on once for its whole period, and seen as it was until then.

Types that nothing couples are moved on one after the other, which costs less and gives the same; so are those of which
all else that they are coupled with is not due in a step. docs/theory/nodal.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

from shipgrid.assembly.unit_text import LEDGERS, is_continuous, operations
from shipgrid.errors import TopologyError
from shipgrid.model.component import STAGES, ComponentType, type_of
from shipgrid.model.network import Network
from shipgrid.model.placed import Delayed, Placed

WALKS = (
    "before",  # the network is stepped
    "begin",
    "first_stamp",
    "advance",  # in both stages
    "book_first_stage",
    "second_stamp",
    "book_second_stage",
    "finish",
    "after",  # the network has been stepped
    "book",
)
"""Lists of calls, in the order of a step."""


@dataclass(frozen=True)
class Call:
    """A call of a unit in one of the lists.

    Attributes
    ----------
    type : str
        Key of the component type.
    operation : str
        One of `unit_text.OPERATIONS`.
    condition : int
        Number of the condition of `Schedule.conditions` under which it is made.
    """

    type: str
    operation: str
    condition: int


@dataclass
class Schedule:
    """The calls of a step.

    Attributes
    ----------
    walks : dict of str to list of Call
        By the names in `WALKS`.
    conditions : list of (bool, frozenset of str)
        Value of each condition in a step in which no clock of these types strikes; it is the other one if one does.
    """

    walks: dict[str, list[Call]] = field(default_factory=lambda: {walk: [] for walk in WALKS})
    conditions: list[tuple[bool, frozenset[str]]] = field(default_factory=list)

    def condition(self, types: Iterable[str], idle: bool = False) -> int:
        """Number of the condition that a clock of these types strikes; with `idle` that none does."""
        condition = idle, frozenset(types)
        if condition not in self.conditions:
            self.conditions.append(condition)
        return self.conditions.index(condition)

    def add(self, walk: str, kind: ComponentType, *offered: str, condition: int | None = None) -> None:
        """Add calls of a type; where no condition is given, when one of its clocks strikes."""
        number = self.condition([kind.key]) if condition is None else condition
        self.walks[walk] += [Call(kind.key, operation, number) for operation in offered]


def schedule_of(network: Network, kinds: Sequence[ComponentType], states: Set[str]) -> Schedule:
    """The calls of a step of a plant.

    Parameters
    ----------
    network : Network
        The whole plant, also where it is cut into parts.
    kinds : sequence of ComponentType
        All that it has, in the order of the flat vector.
    states : set of str
        Paths of its states.

    Raises
    ------
    TopologyError
        If types wait for each other within a stage.
    """
    ordered = type_order(network, kinds, states)
    made = Schedule()
    always = made.condition([], idle=True)
    continuous = _Continuous(network, sorted(ordered, key=lambda kind: STAGES.index(kind.stage)), states, made)
    for stage in STAGES:
        walk = "after" if STAGES.index(stage) > STAGES.index("network") else "before"
        if stage == "network":
            continuous.begin()
            for kind in (kind for kind in kinds if kind.stamped):
                for operation in ("begin", "first_stamp", "advance", "second_stamp", "finish"):
                    made.add(operation, kind, operation, condition=always)
            continuous.end()
            continue
        for kind in (kind for kind in ordered if kind.stage == stage):
            if is_continuous(kind):  # one of an earlier stage is read there, with the states that it has
                made.add(walk, kind, *(["outputs"] if stage != "advance" and "outputs" in kind.kernels else []))
            elif "modulate" in kind.kernels:
                made.add(walk, kind, "modulate", condition=always if stage == "modulate" else None)
            elif "run" in operations(kind):
                made.add(walk, kind, "run")
    for kind in (kind for kind in kinds if any(ledger in kind.kernels for ledger in LEDGERS)):
        for operation in ("book_first_stage", "book_second_stage", "book"):
            if operation in operations(kind):
                made.add(operation, kind, operation, condition=always)
    return made


@dataclass
class Coupled:
    """Continuous types that read each other, by themselves or over types without states.

    Attributes
    ----------
    types : list of ComponentType
    between : list of ComponentType
        Types without states in between.
    """

    types: list[ComponentType]
    between: list[ComponentType]


class _Continuous:
    """Calls that integrate the continuous components of a plant."""

    def __init__(self, network: Network, ordered: Sequence[ComponentType], states: Set[str], made: Schedule):
        self.made = made
        self.groups, self.itself = coupled_types(network, ordered)
        self.to_network = _read_by_network(network, states)
        kinds = {kind.key: [p for p in network.placed.values() if type_of(p.item) is kind] for kind in ordered}
        self.every = {key for key, placed in kinds.items() if all(p.clock is None for p in placed)}

    def begin(self) -> None:
        """Before the network is stepped."""
        for group in self.groups:
            seen = [kind for kind in self._with_outputs(group) if kind.key in self.to_network]
            together = [(kind, "first_rates") for kind in group.types]
            together += [(kind, "move_half") for kind in group.types]
            together += [(kind, "outputs_ahead") for kind in seen]
            alone = {k.key: ["begin_alone", *(["outputs_ahead"] if k in seen else [])] for k in group.types}
            self._together_or_alone("before", group, together, alone)

    def end(self) -> None:
        """After that."""
        for group in self.groups:
            types, seen = group.types, self._with_outputs(group)
            last = [kind for kind in seen if is_continuous(kind) or kind.stage == "advance"]
            together = [(kind, "move") for kind in types]
            together += [(kind, "outputs") for kind in seen]
            together += [(kind, "last_rates") for kind in types]
            together += [(kind, "correct") for kind in types]
            together += [(kind, "outputs") for kind in last]
            self._together_or_alone("after", group, together, {kind.key: ["end_alone"] for kind in types})

    def _with_outputs(self, group: Coupled) -> list[ComponentType]:
        both = [kind for kind in (*group.types, *group.between) if "outputs" in kind.kernels]
        return sorted(both, key=lambda kind: STAGES.index(kind.stage))

    def _together_or_alone(
        self,
        walk: str,
        group: Coupled,
        together: Sequence[tuple[ComponentType, str]],
        alone: Mapping[str, Sequence[str]],
    ) -> None:
        """What is done in a step with all of a group, or with those alone that run when nothing else is due."""
        first = group.types[0]
        if len(group.types) == 1 and not group.between and first.key not in self.itself:
            self.made.add(walk, first, *alone[first.key])
            return
        every = [kind for kind in group.types if kind.key in self.every]
        seldom = [kind for kind in (*group.types, *group.between) if kind not in every]
        single = len(every) == 1 and every[0].key not in self.itself and not any(k.key in self.every for k in seldom)
        due = self.made.condition(kind.key for kind in seldom) if single else None
        for kind, operation in together:
            self.made.add(walk, kind, operation, condition=due if kind in every else None)
        if single:
            idle = self.made.condition((kind.key for kind in seldom), idle=True)
            self.made.add(walk, every[0], *alone[every[0].key], condition=idle)


def _without_states(kind: ComponentType) -> bool:
    """Whether all that a signal component does is to compute outputs from its inputs."""
    return set(kind.kernels) & {"outputs", "update", "modulate", "derivatives"} == {"outputs"} and not kind.terminals


def _chain(network: Network, first: Iterable[Placed]) -> tuple[set[str], set[str]]:
    """Keys of the continuous types that components read, and of the types without states in between."""
    placed_of = network.placed
    continuous: set[str] = set()
    between: set[str] = set()
    asked, seen = list(first), set()
    while asked:
        for source in asked.pop().inputs.values():
            owner = owner_of(source, placed_of)
            if owner is None or owner in seen:
                continue
            seen.add(owner)
            kind = type_of(placed_of[owner].item)
            if is_continuous(kind):
                continuous.add(kind.key)
            elif _without_states(kind):
                between.add(kind.key)
                asked.append(placed_of[owner])
    return continuous, between


def _read_by_network(network: Network, states: Set[str]) -> set[str]:
    """Keys of the types whose outputs elements read, by themselves or over types without states."""
    elements = [placed for placed in network.placed.values() if type_of(placed.item).terminals]
    _, between = _chain(network, elements)
    readers = [*elements, *(p for p in network.placed.values() if type_of(p.item).key in between)]
    owners = {
        owner_of(source, network.placed)
        for placed in readers
        for source in placed.inputs.values()
        if source not in states
    }
    return {type_of(network.placed[owner].item).key for owner in owners if owner}


def coupled_types(network: Network, ordered: Sequence[ComponentType]) -> tuple[list[Coupled], set[str]]:
    """Continuous types in groups, no two of which read each other; and keys of those that read themselves directly."""
    types = [kind for kind in ordered if is_continuous(kind)]
    placed_of: dict[str, list[Placed]] = {}
    for placed in network.placed.values():
        placed_of.setdefault(type_of(placed.item).key, []).append(placed)
    read = {kind.key: _chain(network, placed_of.get(kind.key, [])) for kind in types}
    groups: list[set[str]] = []
    for key, (continuous, _) in read.items():
        met = [group for group in groups if group & ({key} | continuous)]
        groups = [group for group in groups if group not in met] + [set.union({key}, continuous, *met)]
    found = []
    for group in groups:
        between = set.union(*(read[key][1] for key in group))
        found.append(Coupled([k for k in types if k.key in group], [k for k in ordered if k.key in between]))
    kinds = {path: type_of(placed.item).key for path, placed in network.placed.items()}
    itself = set()
    for key in read:
        owners = {owner_of(source, network.placed) for p in placed_of.get(key, []) for source in p.inputs.values()}
        if any(kinds.get(owner or "") == key for owner in owners):
            itself.add(key)
    return found, itself


def type_order(network: Network, kinds: Sequence[ComponentType], states: Set[str]) -> list[ComponentType]:
    """Types in an order in which each runs after those of its own stage whose outputs it reads.

    Raises
    ------
    TopologyError
        If some wait for each other.
    """
    by_key = {kind.key: kind for kind in kinds}
    needs: dict[str, set[str]] = {key: set() for key in by_key}
    for placed in network.placed.values():
        kind = type_of(placed.item)
        for source in placed.inputs.values():
            if not isinstance(source, str) or isinstance(source, Delayed) or source in states:
                continue
            owner = owner_of(source, network.placed)
            if owner is None:
                continue
            key = type_of(network.placed[owner].item).key
            if key != kind.key and by_key[key].stage == kind.stage:
                needs[kind.key].add(key)
    done: list[str] = []
    left = sorted(needs)
    while left:
        ready = [key for key in left if needs[key] <= set(done)]
        if not ready:
            loop = ", ".join(by_key[key].name for key in left)
            raise TopologyError(
                f"{network.name}: within one step these wait for each other: {loop}; "
                "one of them has to read a state, run in another stage, or read a `Delayed` signal"
            )
        done += ready
        left = [key for key in left if key not in ready]
    return [by_key[key] for key in done]


def owner_of(source: object, placed_of: Mapping[str, Any]) -> str | None:
    """Path of the component that a signal is of."""
    if not isinstance(source, str):
        return None
    parts = source.split(".")
    return next((o for k in range(len(parts) - 1, 0, -1) if (o := ".".join(parts[:k])) in placed_of), None)
