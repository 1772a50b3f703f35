"""From network to plan: everything the machine needs to run a plant, as arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shipgrid.assembly.clocks import Clocks, lay_delay_lines
from shipgrid.assembly.contacts import energy_of_contacts
from shipgrid.assembly.gathers import gather_inputs, gather_sources, looked_back_at, own_leads
from shipgrid.assembly.layout import ZERO, Layout, by_type, lay_out, united
from shipgrid.assembly.network_plan import network_plan
from shipgrid.assembly.partition import Part, divide
from shipgrid.assembly.plan import Plan, StepPlan
from shipgrid.assembly.plausible import largest_plausible
from shipgrid.assembly.schedule import Schedule, schedule_of
from shipgrid.assembly.stiff import means_of_steps, stiff_storage
from shipgrid.assembly.unit_text import LEDGERS
from shipgrid.errors import ParameterError
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.connections import axis_weight
from shipgrid.model.network import Network
from shipgrid.model.public_signals import terms_of
from shipgrid.model.records import size_of

BOOKKEEPING_PERIOD = 1e-3
"""Period [s] of the energy audit, the limiter log and the event log: fine against everything they integrate or time."""


def assemble(
    network: Network,
    step: float = 30e-6,
    *,
    record: float = 0.1,
    record_slow: float = 1.0,
    audit: float = BOOKKEEPING_PERIOD,
    parts: Mapping[str, Sequence[str]] | None = None,
) -> Plan:
    """Turn a network into a plan.

    Parameters
    ----------
    network : Network
        The plant.
    step : float
        Step length [s].
    record, record_slow : float
        Sampling periods [s] of the recorder groups `plant` and `slow`.
    audit : float
        Period [s] of the bookkeeping: energy audit, limiter and event log, check for absurd values.
    parts : mapping of str to sequence of str, optional
        Names of buses by part: the plant is cut between them, so that each part can have a core of its own.

    Returns
    -------
    Plan

    Raises
    ------
    TopologyError
        If a name does not exist, an input is left open, components wait for each other within a step, or the plant
        cannot be cut there.
    ParameterError
        If the step is too long for a sampled controller.
    """
    if not (isinstance(step, float | int) and math.isfinite(step) and step > 0.0):
        raise ParameterError(f"step = {step!r} is not a positive number of seconds")
    rates = {
        "record_every": max(1, round(record / step)),
        "slow_every": max(1, round(record_slow / step)),
        "audit_every": max(1, round(audit / step)),
    }
    partition = divide(network, parts, step) if parts else None
    if partition is None or len(partition.parts) < 2:
        layout = lay_out(network)
        schedule = schedule_of(network, [t.kind for t in layout.types], layout.states)
        return _plan(network, layout, step, rates, _books(network, layout), schedule)
    kinds = {kind.key: kind for kind in (type_of(placed.item) for placed in network.placed.values())}
    layouts: list[Layout] = []
    for part in partition.parts:
        layouts.append(lay_out(part, layouts[-1] if layouts else None, kinds.values()))
    placed_in = list(zip(partition.parts, layouts, strict=True))
    whole = united(placed_in, kinds.values())
    for part, layout in placed_in:  # what a part reads of another is measured if it is measured there
        for sort in ("network_signals", "angles", "smooth"):
            there = getattr(whole, sort)
            own = {layout.index[path] for path in part.foreign if whole.place(path, part.name) in there}
            getattr(layout, sort).update(own)
    schedule = schedule_of(network, [t.kind for t in whole.types], whole.states)
    plans = tuple(_plan(part, layout, step, rates, NO_BOOKS, schedule) for part, layout in placed_in)
    for layout in layouts:
        whole.initial[layout.first : layout.size] = layout.initial[layout.first :]
    empty = Network(network.name, network.fidelity)
    books = _plan(empty, whole, step, rates, _books(network, whole), schedule)
    return replace(
        books,
        network=network,
        step=books.step._replace(links=_links(placed_in, whole)),
        energy_items=[entry for plan in plans for entry in plan.energy_items] + books.energy_items,
        parts=plans,
        partition=partition,
    )


@dataclass(frozen=True)
class Books:
    """What is recorded and logged of a plant: fields of `StepPlan`, and the names that belong to them."""

    fields: dict[str, Any]
    groups: dict[str, list[str]]
    limiter_paths: list[str]


def _books(network: Network, layout: Layout) -> Books:
    limiter_paths = [
        f"{placed.path}.{f.name}"
        for t in by_type(network)
        for placed in t.placed
        for f in (fields_of(t.kind.output) if size_of(t.kind.output) else [])
        if f.signal.limiter
    ]
    groups: dict[str, list[str]] = {"plant": [], "slow": []}
    for name, public in network.published.items():
        layout.place(public.source, f"public signal {name}")
        groups[public.group].append(name)
    waved = [*network.published.values(), *network.waveforms.values()]
    for wave in waved:
        for source, _ in terms_of(wave):
            layout.place(source, f"waveform {wave.name}")
    fields = {
        "recorded": _places(
            layout.index[network.published[name].source] for names in groups.values() for name in names
        ),
        "limiters": _places(layout.index[path] for path in limiter_paths),
        "watched": _places(layout.place(w.source, w.owner) for w in network.watched),
        "wave_source": np.unique(_places(layout.index[s] for w in waved for s, _ in terms_of(w))),
    }
    return Books(fields, groups, limiter_paths)


def _places(values: Iterable[int]) -> np.ndarray:
    return np.array(list(values), dtype=np.int64)


NO_BOOKS = _books(Network(""), lay_out(Network("")))


def _plan(
    network: Network, layout: Layout, step: float, rates: dict[str, int], books: Books, schedule: Schedule
) -> Plan:
    """The plan of a network whose signals have their places."""
    clocks = Clocks(step)
    clock_of, gathers = {}, {}
    for t in layout.types:
        # clocks first: a delay line's length depends on them
        clock_of[t.kind.key] = _places(clocks.number(p) for p in t.placed)
    delay_lines = lay_delay_lines(layout, clocks, clock_of)
    for t in layout.types:
        if not t.kind.linear:
            gathers[t.kind.key] = gather_inputs(layout, t)
    net = network_plan(network, layout, step)
    net = net._replace(**means_of_steps(network, layout, net, step))
    own_leads(layout, net, clock_of, gathers)
    gathers["network"] = gather_sources(layout)
    energy_items = [
        (placed.path, ledger)
        for t in layout.types
        for ledger in LEDGERS
        if ledger in t.kind.kernels
        for placed in t.placed
    ]
    drops, lost = energy_of_contacts(layout, energy_items, network.ends if isinstance(network, Part) else [])
    energy_items += lost
    weight = {node: axis_weight(node) for node in layout.nodes}
    stiff, lost = stiff_storage(network, layout, net, step, energy_items, weight)
    shunts = [shunt for shunt in network.shunts if shunt[1] > 0.0]
    energy_items += lost + [(path, ledger) for _, _, path, ledger in shunts]
    plan = StepPlan(
        h=step,
        clock_inc=_places(c[0] for c in clocks.ratios),
        clock_den=_places(c[1] for c in clocks.ratios),
        clock_period=np.array(clocks.periods),
        kept=_places(sorted(looked_back_at(layout, gathers, clock_of, clocks))),
        links=np.zeros((0, 3), dtype=np.int64),
        n_plant=len(books.groups["plant"]),
        record_every=rates["record_every"],
        slow_every=rates["slow_every"],
        audit_every=rates["audit_every"],
        shunt_node=_places(layout.index[node] for node, *_ in shunts),
        shunt_g=np.array([siemens * weight[node] for node, siemens, *_ in shunts]),
        n_energy=len(energy_items),
        tables=layout.tables,
        audited_from=layout.first,
        absurd=largest_plausible(layout)[layout.first :],
        **_due(schedule, clock_of, len(clocks.periods)),
        **books.fields,
        **drops,
        **stiff,
    )
    return Plan(
        network,
        step,
        layout,
        net,
        plan,
        gathers,
        clock_of,
        np.array(clocks.periods),
        energy_items,
        books.groups,
        books.limiter_paths,
        delay_lines,
        schedule,
    )


def _due(schedule: Schedule, clock_of: dict[str, np.ndarray], clocks: int) -> dict[str, np.ndarray]:
    """Fields `due_...` of `StepPlan`: which conditions of the schedule a clock changes when it strikes."""
    on_clock = [{key for key, of_type in clock_of.items() if c in of_type} for c in range(clocks)]
    due = [[k for k, (_, types) in enumerate(schedule.conditions) if types & on] for on in on_clock]
    return {
        "due_start": np.cumsum([0, *(len(struck) for struck in due)]),
        "due_condition": _places(k for struck in due for k in struck),
        "due_value": _places(int(not schedule.conditions[k][0]) for struck in due for k in struck),
        "due_idle": _places(int(idle) for idle, _ in schedule.conditions),
    }


def _links(parts: Sequence[tuple[Part, Layout]], whole: Layout) -> np.ndarray:
    """Between two steps: what parts read of each other; what arrives at stub lines; voltages of terminals cut."""
    found = []
    for part, _ in parts:
        for end in part.ends:
            found += [(whole.index[f"{end.name}.in_{k}"], whole.index[f"{end.other}.out_{k}"], ZERO) for k in (1, 2)]
            if end.position:
                found.append((whole.index[f"{end.name}.sent"], whole.index[f"{end.name}.out_1"], ZERO))
                found.append((whole.index[f"{end.name}.before"], whole.index[end.position], ZERO))
                found.append((whole.index[end.position], whole.place(str(end.placed.variant), end.name), ZERO))
            if end.near:
                binding = end.placed.ports[end.terminal]
                terminal = type_of(end.placed.item).terminals[end.column]
                nodes = (whole.index[node] if node else ZERO for node in (binding.plus, binding.minus))
                found.append((whole.slots["u", f"{end.placed.path}.{terminal.v}"], *nodes))
    for part, layout in parts:  # last: what they read may have been handed over itself
        found += [(layout.index[path], whole.index[path], ZERO) for path in part.foreign]
    return np.array(found, dtype=np.int64).reshape(-1, 3)
