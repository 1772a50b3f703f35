"""How continuous components are stepped: Heun's rule over all that read each other, woven as calls around the network.

docs/theory/nodal.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.woven_lines import for_all, gather_lines, pass_to, where_due
from shipgrid.model.component import STAGES, ComponentType, type_of
from shipgrid.model.kernel import argument_names
from shipgrid.model.network import Placed
from shipgrid.model.ops import wrap


@dataclass
class Coupled:
    """Continuous types that read each other, by themselves or over types without states.

    Attributes
    ----------
    types : list of TypeLayout
    between : list of TypeLayout
        Types without states in between.
    """

    types: list[TypeLayout]
    between: list[TypeLayout]


class Continuous:
    """Calls that integrate the continuous components of a plant side by side: Heun's rule over all of them at once.

    What they read of each other is taken where they are: at the step's start for the first rates, where these lead for
    the second ones. What the network reads of a component that runs in every step is half-way there, and stands for the
    mean of the step; the network's own smooth quantities are carried on to there from the step before. So a chain of
    components is of second order as each of them is, and so is a loop through the network, but for a direct path from
    something that jumps (the voltage of a node without capacitance), which is that of the step's start. A component
    with a clock of its own is moved on once for its whole period, and seen as it was until then.

    Types that nothing couples are moved on one after the other, which costs less and gives the same; so are those of
    which all else that they are coupled with is not due in a step.

    Parameters
    ----------
    plan : Plan
    ordered : list of TypeLayout
        All types in the order of `type_order`.
    imported, function : callable
        Of `weave`.
    """

    def __init__(
        self,
        plan: Plan,
        ordered: list[TypeLayout],
        imported: Callable[[Any, str], str],
        function: Callable[..., str],
    ):
        self.due = {t.kind.key: k for k, t in enumerate(plan.layout.types)}
        self.imported, self.function = imported, function
        self.made: dict[str, str] = {}
        stages = sorted(ordered, key=lambda t: STAGES.index(t.kind.stage))
        self.groups, self.itself = coupled_types(plan, stages)
        self.to_network = _read_by_network(plan)
        self.every = {t.kind.key for t in stages if all(p.clock is None for p in _placed(plan, t))}

    def has(self, t: TypeLayout) -> bool:
        """Whether a type is one of them."""
        return _is_continuous(t)

    def begin(self) -> list[str]:
        """Calls before the network is stepped."""
        lines = []
        for group in self.groups:
            types = group.types
            together = [*self._rates(types, "0.0"), *self._moves(types, "0.5")]
            together += self._outputs([t for t in self._with_outputs(group) if t.kind.key in self.to_network], "0.5")
            alone = {t.kind.key: self._begin_alone(t) for t in types}
            lines += self._together_or_alone(group, together, "begin", alone)
        return lines

    def end(self) -> list[str]:
        """Calls after that."""
        lines = []
        for group in self.groups:
            types, seen = group.types, self._with_outputs(group)
            finish = {t.kind.key: self._once(f"finish_{t.kind.key}", self._finish(t)) for t in types}
            last = [t for t in seen if _is_continuous(t) or t.kind.stage == "advance"]
            together = [*self._moves(types, "1.0"), *self._outputs(seen, "0.0"), *self._rates(types, "1.0")]
            together += [*self._calls(types, finish), *self._outputs(last, "0.0")]
            alone = {t.kind.key: self._end_alone(t) for t in types}
            lines += self._together_or_alone(group, together, "end", alone)
        return lines

    def _with_outputs(self, group: Coupled) -> list[TypeLayout]:
        both = [t for t in (*group.types, *group.between) if "outputs" in t.kind.kernels]
        return sorted(both, key=lambda t: STAGES.index(t.kind.stage))

    def _together_or_alone(
        self, group: Coupled, together: list[str], name: str, alone: Mapping[str, list[str]]
    ) -> list[str]:
        """What is done in a step with all of a group, or with those alone that run when nothing else is due."""
        single = len(group.types) == 1 and not group.between and not self.itself & {group.types[0].kind.key}
        if single:
            return self._calls(group.types, self._alone(group.types, name, alone))
        every = [t for t in group.types if t.kind.key in self.every]
        seldom = [t for t in (*group.types, *group.between) if t not in every]
        if len(every) != 1 or self.itself & {every[0].kind.key} or any(t.kind.key in self.every for t in seldom):
            return together
        due = " or ".join(f"due[{self.due[t.kind.key]}] != 0" for t in seldom)
        rest = self._alone(every, name, alone).values()
        return [f"if {due}:", *(f"    {line}" for line in together), "else:", *(f"    {line}" for line in rest)]

    def _alone(self, types: list[TypeLayout], name: str, alone: Mapping[str, list[str]]) -> dict[str, str]:
        return {t.kind.key: self._once(f"{name}_{t.kind.key}", alone[t.kind.key], "t") for t in types}

    def _begin_alone(self, t: TypeLayout) -> list[str]:
        evaluate = self._evaluate(t, "0.5") if t.kind.key in self.to_network and "outputs" in t.kind.kernels else []
        return self._for_each(t, [*self._rate(t, "t"), *self._move(t, self._dt(t, "0.5"), keep=True), *evaluate])

    def _end_alone(self, t: TypeLayout) -> list[str]:
        evaluate = self._evaluate(t, "0.0") if "outputs" in t.kind.kernels else []
        period = "h" if t.kind.key in self.every else "clock_period[c]"
        moved = [*self._move(t, self._dt(t, "1.0")), *self._rate(t, f"t + {period}")]
        return self._for_each(t, [*moved, *self._correct(t, f"0.5 * {period}"), *evaluate])

    def _dt(self, t: TypeLayout, share: str) -> str:
        """Time by which a share of a component's period moves it on, half-way only if its period is the step."""
        if t.kind.key in self.every:
            return f"{share} * h"
        only = "" if share == "1.0" else " if clock_inc[c] == clock_den[c] else 0.0"
        return f"({share} * clock_period[c]{only})"

    def _for_each(self, t: TypeLayout, lines: list[str]) -> list[str]:
        return (for_all if t.kind.key in self.every else where_due)(t.kind.key, lines)

    def _rates(self, types: list[TypeLayout], late: str) -> list[str]:
        """Rates of types, at the start of what they are moved by, or at its end."""
        calls = {}
        for t in types:
            body = where_due(t.kind.key, self._rate(t, "t + late * clock_period[c]"))
            calls[t.kind.key] = re.sub(r"\blate\b", late, self._once(f"rates_{t.kind.key}", body, "t", "late"))
        return self._calls(types, calls)

    def _moves(self, types: list[TypeLayout], share: str) -> list[str]:
        """Types moved on with their first rates: half-way for the network to see, then the whole way."""
        which, keep = ("on", False) if share == "1.0" else ("half", True)
        made = {}
        for t in types:
            body = where_due(t.kind.key, self._move(t, self._dt(t, share), keep=keep))
            made[t.kind.key] = self._once(f"move_{t.kind.key}_{which}", body)
        return self._calls(types, made)

    def _outputs(self, types: list[TypeLayout], ahead: str) -> list[str]:
        """Outputs, what is smooth in the network carried on by a share of the last step."""
        made = {}
        for t in types:
            name = f"outputs_{t.kind.key}{'_half' if ahead != '0.0' else ''}"
            made[t.kind.key] = self._once(name, where_due(t.kind.key, self._evaluate(t, ahead)), "t")
        return self._calls(types, made)

    def _finish(self, t: TypeLayout) -> list[str]:
        return where_due(t.kind.key, self._correct(t, "0.5 * clock_period[c]"))

    # lines for one instance

    def _rate(self, t: TypeLayout, time: str) -> list[str]:
        kernel, key = t.kind.kernels["derivatives"], t.kind.key
        name = self.imported(kernel, f"{key}_derivatives")
        return [*gather_lines(key, "now"), f"{name}({pass_to(kernel, key, dx=f'{key}_c[i]', t=time)})"]

    def _move(self, t: TypeLayout, dt: str, *, keep: bool = False) -> list[str]:
        key = t.kind.key
        kept = [f"    {key}_af[i, j] = {key}_xf[i, j]", f"    {key}_bf[i, j] = {key}_cf[i, j]"] if keep else []
        return [
            f"for j in range({key}_xf.shape[1]):",
            *kept,
            f"    {key}_xf[i, j] = {key}_af[i, j] + {dt} * {key}_bf[i, j]",
            *self._limit(t),
        ]

    def _correct(self, t: TypeLayout, dt: str) -> list[str]:
        key = t.kind.key
        rates = f"({key}_bf[i, j] + {key}_cf[i, j])"
        return [
            f"for j in range({key}_xf.shape[1]):",
            f"    {key}_xf[i, j] = {key}_af[i, j] + {dt} * {rates}",
            *self._limit(t),
        ]

    def _evaluate(self, t: TypeLayout, ahead: str) -> list[str]:
        kernel, key = t.kind.kernels["outputs"], t.kind.key
        gather: list[str] = []
        if "u" in argument_names(kernel) and ahead == "0.0":
            gather = gather_lines(key, "now")
        elif "u" in argument_names(kernel):
            part = ahead if key in self.every else f"{ahead} if clock_inc[c] == clock_den[c] else 0.0"
            gather = [f"part = {part}", *gather_lines(key, "ahead", self.imported(wrap, "wrap"))]
        return [*gather, f"{self.imported(kernel, f'{key}_outputs')}({pass_to(kernel, key)})"]

    def _limit(self, t: TypeLayout) -> list[str]:
        kernel, key = t.kind.kernels.get("limit"), t.kind.key
        return [] if kernel is None else [f"{self.imported(kernel, f'{key}_limit')}({pass_to(kernel, key)})"]

    def _calls(self, types: list[TypeLayout], call: Mapping[str, str]) -> list[str]:
        return [line for t in types for line in (f"if due[{self.due[t.kind.key]}] != 0:", f"    {call[t.kind.key]}")]

    def _once(self, name: str, body: list[str], *given: str) -> str:
        """Call of a function that is made when it is first asked for."""
        if name not in self.made:
            self.made[name] = self.function(name, body, *given)
        return self.made[name]


def _is_continuous(t: TypeLayout) -> bool:
    return "derivatives" in t.kind.kernels and not t.kind.terminals


def _placed(plan: Plan, t: TypeLayout) -> list[Placed]:
    """All instances of a type in a plant, also where the plan itself has none since it is cut."""
    return [placed for placed in plan.network.placed.values() if type_of(placed.item) is t.kind]


def _without_states(kind: ComponentType) -> bool:
    """Whether all that a signal component does is to compute outputs from its inputs."""
    return set(kind.kernels) & {"outputs", "update", "modulate", "derivatives"} == {"outputs"} and not kind.terminals


def _chain(plan: Plan, first: Iterable[Placed]) -> tuple[set[str], set[str]]:
    """Keys of the continuous types that components read, and of the types without states in between."""
    placed_of = plan.network.placed
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
            if "derivatives" in kind.kernels and not kind.terminals:
                continuous.add(kind.key)
            elif _without_states(kind):
                between.add(kind.key)
                asked.append(placed_of[owner])
    return continuous, between


def _read_by_network(plan: Plan) -> set[str]:
    """Keys of the types whose outputs elements read, by themselves or over types without states."""
    elements = [placed for placed in plan.network.placed.values() if type_of(placed.item).terminals]
    _, between = _chain(plan, elements)
    readers = [*elements, *(p for p in plan.network.placed.values() if type_of(p.item).key in between)]
    owners = {
        owner_of(source, plan.network.placed)
        for placed in readers
        for source in placed.inputs.values()
        if source not in plan.layout.states
    }
    return {type_of(plan.network.placed[owner].item).key for owner in owners if owner}


def coupled_types(plan: Plan, ordered: list[TypeLayout]) -> tuple[list[Coupled], set[str]]:
    """Continuous types in groups, no two of which read each other; and keys of those that read themselves directly."""
    types = [t for t in ordered if _is_continuous(t)]
    read = {t.kind.key: _chain(plan, _placed(plan, t)) for t in types}
    groups: list[set[str]] = []
    for key, (continuous, _) in read.items():
        met = [group for group in groups if group & ({key} | continuous)]
        groups = [group for group in groups if group not in met] + [set.union({key}, continuous, *met)]
    found = []
    for group in groups:
        between = set.union(*(read[key][1] for key in group))
        found.append(Coupled([t for t in types if t.kind.key in group], [t for t in ordered if t.kind.key in between]))
    owners = {
        key: {owner_of(source, plan.network.placed) for source in sources} for key, sources in _sources(plan).items()
    }
    kinds = {path: type_of(placed.item).key for path, placed in plan.network.placed.items()}
    return found, {key for key in read if any(kinds.get(owner or "") == key for owner in owners[key])}


def _sources(plan: Plan) -> dict[str, list[object]]:
    """What the components of each type read, by the type's key."""
    found: dict[str, list[object]] = {}
    for placed in plan.network.placed.values():
        found.setdefault(type_of(placed.item).key, []).extend(placed.inputs.values())
    return found


def owner_of(source: object, placed_of: Mapping[str, Any]) -> str | None:
    """Path of the component that a signal is of."""
    if not isinstance(source, str):
        return None
    parts = source.split(".")
    return next((o for k in range(len(parts) - 1, 0, -1) if (o := ".".join(parts[:k])) in placed_of), None)
