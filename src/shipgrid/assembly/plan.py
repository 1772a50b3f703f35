"""From network to plan: everything the machine needs to run a plant, as arrays.

`Plan` never changes during a run; `Workspace` holds everything that does. One plan serves many workspaces.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from shipgrid.assembly.contacts import energy_of_contacts
from shipgrid.assembly.layout import NORTON_FIELDS, ZERO, Layout, TypeLayout, by_type, lay_out, united
from shipgrid.assembly.network_plan import network_plan
from shipgrid.assembly.partition import Part, Partition, divide
from shipgrid.assembly.plausible import largest_plausible
from shipgrid.assembly.schedule import Schedule, schedule_of, type_order
from shipgrid.assembly.stiff import means_of_steps, stiff_storage
from shipgrid.assembly.unit_text import LEDGERS
from shipgrid.errors import ParameterError, TopologyError
from shipgrid.model.component import POSITION, ComponentType, fields_of, type_of
from shipgrid.model.kernel import in_one_piece
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Placed, Sampled
from shipgrid.model.public_signals import PublicSignal, Waveform
from shipgrid.model.records import names_of, size_of
from shipgrid.solvers.conduction import MEANS
from shipgrid.solvers.nodal import NetworkPlan, NetworkWork
from shipgrid.solvers.pacing import PaceWork, no_pace

BOOKKEEPING_PERIOD = 1e-3
"""Period [s] of the energy audit, the limiter log and the event log: fine against everything they integrate or time."""


class StepPlan(NamedTuple):
    """What the core reads beside the network: clocks, recorder, audit."""

    h: float
    clock_inc: np.ndarray
    clock_den: np.ndarray
    clock_period: np.ndarray
    due_start: np.ndarray  # (clocks + 1,) first entry of `due_condition` of each clock
    due_condition: np.ndarray  # conditions of `Schedule` that change when it strikes
    due_value: np.ndarray  # what they are then
    due_idle: np.ndarray  # (conditions,) what each is while no clock strikes
    kept: np.ndarray  # places of the measured network quantities that are looked back at from the next step
    links: np.ndarray  # (n, 3) between two steps of a plant in parts: place, and the two whose difference it takes
    recorded: np.ndarray  # (signals,) places of the signals of the group `plant`, then of `slow`
    n_plant: int
    record_every: int
    slow_every: int
    audit_every: int
    shunt_node: np.ndarray  # places of the voltages of nodes with shunts, which are the last entries of `energy`
    shunt_g: np.ndarray  # conductance, times 3/2 for one axis of a three-phase bus
    n_energy: int
    # what is charged within a step (`nodal.finish_step`): number and entry of `energy`, factor s of the energy s x^2
    stiff_node: np.ndarray  # (2, nodes)
    stiff_node_s: np.ndarray
    stiff_state: np.ndarray  # (2, states of elements)
    stiff_state_s: np.ndarray
    limiters: np.ndarray
    watched: np.ndarray
    wave_source: np.ndarray  # places of the signals kept at every step of a waveform window
    tables: np.ndarray
    audited_from: int  # place of the first signal that this plan looks after
    absurd: np.ndarray  # (signals looked after,) magnitude of each beyond which the run has diverged
    # energy of the states that a position of a contact puts to zero: sum of s x_a x_b
    drop_first: np.ndarray  # (switched elements,) first row of each, one row a position
    drop_row: np.ndarray
    drop_a: np.ndarray
    drop_b: np.ndarray
    drop_s: np.ndarray
    drop_ledger: np.ndarray  # (switched elements,) where in `energy` it is booked


class StepWork(NamedTuple):
    """What the core writes beside the signals."""

    due: np.ndarray  # (conditions,) 1 where the calls under this condition are made in this step
    booked: np.ndarray  # (1,) 1 if the audit is due after the coming step
    clock_phase: np.ndarray
    clock_before: np.ndarray  # fraction of the last step at which the clock's instant fell, or -1
    clock_ahead: np.ndarray  # the same for the coming step
    previous: np.ndarray  # the flat vector at the last step's start
    lead: np.ndarray  # what a signal sampled inside the last step lies beside its chord; see `conduction.lead_samples`
    delays: np.ndarray
    rows: np.ndarray  # (2,) rows filled in each group
    plant_rows: np.ndarray  # (4, rows, signals): values, and lows, highs, means since the row before
    slow_rows: np.ndarray
    interval: np.ndarray  # (signals, 3): low, high and sum since the last row
    wave_row: np.ndarray  # (1,) rows of waveform windows since they were emptied; outside of one, -1 minus that
    wave_rows: np.ndarray  # (rows, signals)
    energy: np.ndarray
    stage_power: np.ndarray  # mean power over the step of each entry of `energy` that is of the network [W]
    exchanged: np.ndarray  # (1,) sum of what sources gave or took, each audit by its magnitude [J]
    limiter_time: np.ndarray  # (limiters, 3): seconds active, first time, times it came on
    limiter_was: np.ndarray
    watched_was: np.ndarray
    event_step: np.ndarray
    event_which: np.ndarray
    event_value: np.ndarray
    event_count: np.ndarray


@dataclass(frozen=True, eq=False)
class Plan:
    """A plant ready to run at one step length.

    Attributes
    ----------
    network : Network
        What it was made from.
    h : float
        Step [s].
    layout : Layout
        Names of the flat vector.
    net : NetworkPlan
    step : StepPlan
    gathers : dict
        Per component type: where its instances' inputs come from.
    clock_of : dict
        Per component type: each instance's clock.
    periods : ndarray
        Period [s] of each clock.
    energy_items : list of (str, str)
        Path and ledger (`losses`, `supplied`, `consumed`) of each entry of the energy audit.
    groups : dict of str to list of str
        Recorded public signals by group.
    delay_lines : dict of str to (int, int)
        First cell and number of cells of each delay line, by the path of its component.
    schedule : Schedule
        Calls of a step.
    parts : tuple of Plan
        Of a plant that is cut: what has its components and nodes. The plan itself keeps the books then, and its
        layout has the signals of all parts.
    partition : Partition or None
        How it is cut.
    """

    network: Network
    h: float
    layout: Layout
    net: NetworkPlan
    step: StepPlan
    gathers: dict[str, dict[str, np.ndarray]]
    clock_of: dict[str, np.ndarray]
    periods: np.ndarray
    energy_items: list[tuple[str, str]]
    groups: dict[str, list[str]]
    limiter_paths: list[str]
    delay_lines: dict[str, tuple[int, int]]
    schedule: Schedule
    parts: tuple[Plan, ...] = ()
    partition: Partition | None = None

    @property
    def pieces(self) -> tuple[Plan, ...]:
        """The plans that have components and nodes: the parts, or this one."""
        return self.parts or (self,)

    @property
    def kinds(self) -> list[ComponentType]:
        """Component types in use, in the order of the flat vector."""
        return [t.kind for t in self.layout.types]

    @property
    def ordered_types(self) -> list[TypeLayout]:
        """Types in an order in which each runs after those of its own stage whose outputs it reads."""
        by_key = {t.kind.key: t for t in self.layout.types}
        return [by_key[kind.key] for kind in type_order(self.network, self.kinds, self.layout.states)]

    def refuse_parts(self) -> None:
        """Stop whoever would see an empty plant, since the components of a plant in parts are in those.

        Raises
        ------
        TopologyError
            If this is one.
        """
        if self.parts:
            raise TopologyError(f"{self.network.name} is cut into parts, expected the plant in one piece")

    @property
    def record_period(self) -> dict[str, float]:
        """Sampling period [s] of each recorder group."""
        return {"plant": self.step.record_every * self.h, "slow": self.step.slow_every * self.h}


@dataclass
class Workspace:
    """One run of a plan: the flat vector and everything else that moves.

    `n` is the number of steps done; time is `n * plan.h`.
    """

    plan: Plan
    n: int
    sig: np.ndarray
    net: NetworkWork
    step: StepWork
    pace: PaceWork
    parts: tuple[Workspace, ...] = ()

    @property
    def pieces(self) -> tuple[Workspace, ...]:
        """Those of the plans that have components and nodes; they share the flat vector."""
        return self.parts or (self,)

    @property
    def exchanged(self) -> float:
        """Energy [J] that sources gave or took, each audit by its magnitude."""
        return float(sum(piece.step.exchanged[0] for piece in (*self.parts, self)))

    @property
    def energy(self) -> np.ndarray:
        """Energy [J] of each of `Plan.energy_items`."""
        return np.concatenate([part.step.energy for part in (*self.parts, self)])

    def forget_notes(self) -> None:
        """Take back what the solver has noted of the nodes and bridges of its own, for a run that begins here."""
        self.net.stranded_first[:] = self.net.stranded_last[:] = 0
        self.net.rested[:] = 0

    def snapshot(self) -> Workspace:
        """An independent copy."""
        shared = {id(plan): plan for plan in (self.plan, *self.plan.parts)}  # a plan never changes
        found = copy.deepcopy(self, shared)
        _separate(found)
        return found


CHUNK_ROWS = 512
WAVE_ROWS = 1024
"""Steps of a waveform window between two visits of the runner."""
EVENTS = 4096


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
    clocks = _Clocks(step)
    clock_of, gathers = {}, {}
    for t in layout.types:
        # clocks first: a delay line's length depends on them
        clock_of[t.kind.key] = _places(clocks.number(p) for p in t.placed)
    delay_lines = _lay_delay_lines(layout, clocks, clock_of)
    for t in layout.types:
        if not t.kind.linear:
            gathers[t.kind.key] = _gather(layout, t)
    net = network_plan(network, layout, step)
    net = net._replace(**means_of_steps(network, layout, net, step))
    _own_leads(layout, net, clock_of, gathers)
    gathers["network"] = _gather_sources(layout)
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
    on_clock = [{key for key, of_type in clock_of.items() if c in of_type} for c in range(len(clocks.periods))]
    due = [[k for k, (_, types) in enumerate(schedule.conditions) if types & on] for on in on_clock]
    plan = StepPlan(
        h=step,
        clock_inc=_places(c[0] for c in clocks.ratios),
        clock_den=_places(c[1] for c in clocks.ratios),
        clock_period=np.array(clocks.periods),
        due_start=np.cumsum([0, *(len(struck) for struck in due)]),
        due_condition=_places(k for struck in due for k in struck),
        due_value=_places(int(not schedule.conditions[k][0]) for struck in due for k in struck),
        due_idle=_places(int(idle) for idle, _ in schedule.conditions),
        kept=_places(sorted(_looked_back_at(layout, gathers, clock_of, clocks))),
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


def _looked_back_at(
    layout: Layout, gathers: dict[str, dict[str, np.ndarray]], clock_of: dict[str, np.ndarray], clocks: _Clocks
) -> set[int]:
    """Places of measured quantities that are read between two steps, or carried on from the step before."""
    found = {ZERO}
    for t in layout.types:
        gather = gathers.get(t.kind.key)
        if gather is None:
            continue
        start = gather["measured_start"]
        for k in range(len(t.placed)):
            inc, den = clocks.ratios[clock_of[t.kind.key][k]]
            first = start[k] if inc not in (1, den) else gather["measured_smooth"][k]
            if inc not in (1, den) or ("derivatives" in t.kind.kernels and inc == den):
                found |= set(gather["measured"][first : start[k + 1], 1].tolist())
    return found


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


def new_workspace(plan: Plan) -> Workspace:
    """A workspace at time zero, everything at its declared initial value."""
    sig = plan.layout.initial.copy()
    work = _workspace(plan, sig)
    work.parts = tuple(_workspace(part, sig) for part in plan.parts)
    _separate(work)
    return work


def _separate(work: Workspace) -> None:
    """Give what each part writes cache lines of its own: each is written by a core of its own."""
    for part in work.parts:
        part.net = NetworkWork(**in_one_piece(part.net._asdict()))
        part.step = StepWork(**in_one_piece(part.step._asdict()))


def _workspace(plan: Plan, sig: np.ndarray) -> Workspace:
    """A workspace on a flat vector."""
    n, signals, n_plant = plan.net.n_nodes, len(plan.step.recorded), plan.step.n_plant
    states, ports, bridges = len(plan.net.state_signal), len(plan.net.port_plus), len(plan.net.bridge_port)
    net = NetworkWork(
        values=np.concatenate([plan.net.linear_values, np.zeros(4 * len(plan.net.machine_w) + 1)]),
        position=np.zeros(len(plan.net.element_variant), dtype=np.int64),
        x_start=np.zeros(states),
        x_stage=np.zeros(states),
        x=np.zeros(states),
        z=np.zeros(states),
        history=np.zeros(ports),
        coefficient=np.zeros(ports),
        port_voltage=np.zeros(ports),
        first_port=np.zeros((2, len(plan.net.mean_port))),
        first_node=np.zeros(len(plan.net.mean_node)),
        Y_linear=np.zeros((n + 1) * (n + 1)),
        Y=np.zeros((n + 1) * (n + 1)),
        rhs=np.zeros(n + 1),
        v=np.zeros(n + 1),
        v_start=np.zeros(n + 1),
        v_stage=np.zeros(n + 1),
        stranded_first=np.zeros(n, dtype=np.int64),
        stranded_last=np.zeros(n, dtype=np.int64),
        rested=np.zeros((len(plan.net.bridge_port), 3), dtype=np.int64),
        norton=np.zeros((len(plan.net.machine_w), len(NORTON_FIELDS))),
        leg_state=np.zeros(len(plan.net.leg_lo), dtype=np.int64),
        leg_s=np.zeros(len(plan.net.leg_lo)),
        bridge_i0=np.full((bridges, 2), np.nan),  # there is no step before the first
        bridge_mean=np.zeros((bridges, MEANS)),
        constraint=np.zeros((bridges, 3)),
        gamma=np.zeros((bridges, 3)),
        inverse=np.zeros((bridges, 4)),
        target=np.zeros((bridges, 2)),
        left=np.zeros((2, n + 1)),
        right=np.zeros((bridges, 2, n + 1)),
        clamp=np.zeros(len(plan.net.clamp_node), dtype=np.int64),
        stage_share=np.zeros(2),
        conduct=np.zeros(4, dtype=np.int64),
        moved=np.zeros(1, dtype=np.int64),
    )
    step = StepWork(
        due=np.zeros(len(plan.schedule.conditions), dtype=np.int64),
        booked=np.full(1, plan.step.audit_every == 1, dtype=np.int64),
        clock_phase=np.zeros(len(plan.periods), dtype=np.int64),
        clock_before=np.full(len(plan.periods), -1.0),
        clock_ahead=np.ones(len(plan.periods)),  # an instant at time zero: every controller starts with a sample
        previous=sig.copy(),
        lead=np.zeros(len(sig)),
        delays=np.zeros(max([1, *(first + length for first, length in plan.delay_lines.values())])),
        rows=np.zeros(2, dtype=np.int64),
        plant_rows=np.zeros((4, CHUNK_ROWS, n_plant)),
        slow_rows=np.zeros((4, CHUNK_ROWS, signals - n_plant)),
        interval=np.tile([np.inf, -np.inf, 0.0], (signals, 1)),
        wave_row=np.full(1, -1, dtype=np.int64),
        wave_rows=np.zeros((WAVE_ROWS, len(plan.step.wave_source))),
        energy=np.zeros(plan.step.n_energy),
        stage_power=np.zeros(plan.step.n_energy),
        exchanged=np.zeros(1),
        limiter_time=np.zeros((len(plan.step.limiters), 3)),
        limiter_was=np.zeros(len(plan.step.limiters)),
        watched_was=sig[plan.step.watched],
        event_step=np.zeros(EVENTS, dtype=np.int64),
        event_which=np.zeros(EVENTS, dtype=np.int64),
        event_value=np.zeros(EVENTS),
        event_count=np.zeros(1, dtype=np.int64),
    )
    return Workspace(plan, 0, sig, net, step, no_pace())


def terms_of(public: PublicSignal | Waveform) -> tuple[tuple[str, float], ...]:
    """What a public quantity is the weighted sum of: paths, and what each is multiplied by."""
    return public.terms if isinstance(public, Waveform) else ((public.source, 1.0),)


def axis_weight(node: str) -> float:
    """What energy at a node counts: 3/2 for one axis of a three-phase bus (amplitude-invariant), 1 for a DC bus."""
    return 1.5 if node.endswith((".v_alpha", ".v_beta")) else 1.0


class _Clocks:
    """Clocks as integer arithmetic: each step adds `inc`, an instant falls where the sum passes `den`."""

    def __init__(self, step: float):
        self.h = step
        self.ratios: list[tuple[int, int]] = []
        self.periods: list[float] = []

    def number(self, placed: Placed) -> int:
        clock = placed.clock
        if clock is None:
            inc, den, period = 1, 1, self.h
        elif isinstance(clock, Every):
            den = max(1, round(clock.seconds / self.h))
            inc, period = 1, den * self.h
        else:
            assert isinstance(clock, Sampled)
            # the nearest ratios of whole numbers: 3/100000 s also for a step computed as 30 * 1e-6
            ratio = Fraction(clock.hertz).limit_denominator(10**6) * Fraction(self.h).limit_denominator(10**9)
            if ratio > 1:
                raise ParameterError(
                    f"step = {self.h:g} s is too long for {placed.path}, which is sampled at {clock.hertz:g} Hz: "
                    f"expected at most {1.0 / clock.hertz:g} s"
                )
            inc, den, period = ratio.numerator, ratio.denominator, 1.0 / clock.hertz if ratio < 1 else self.h
        if (inc, den) not in self.ratios:
            self.ratios.append((inc, den))
            self.periods.append(period)
        return self.ratios.index((inc, den))


def _lay_delay_lines(layout: Layout, clocks: _Clocks, clock_of: dict[str, np.ndarray]) -> dict[str, tuple[int, int]]:
    """Give each delay line its cells, first and number by path; the derived constant `line` becomes the first."""
    found: dict[str, tuple[int, int]] = {}
    cells = 0
    for t in layout.types:
        if not (t.placed and hasattr(t.kind.cls, "delay_length")):
            continue
        width = len(t.parameters) // len(t.placed)
        column = width - len(names_of(t.kind.derived)) + names_of(t.kind.derived).index("line")
        for k, placed in enumerate(t.placed):
            t.parameters[k * width + column] = cells
            length = placed.item.delay_length(clocks.periods[clock_of[t.kind.key][k]])
            found[placed.path] = cells, length
            cells += length
    return found


def _source(layout: Layout, placed: Placed, name: str, declared: Any) -> int | float:
    given = placed.inputs.get(name)
    path = f"{placed.path}.{name}"
    if isinstance(given, str):
        return layout.place(given, path)
    if given is not None:
        layout.initial[layout.slots["u", path]] = float(given)
    elif declared.signal.required:
        raise TopologyError(f"{path} ({declared.signal.description}) is connected to nothing")
    return float("nan")


def _gather(layout: Layout, t: Any) -> dict[str, np.ndarray]:
    """Lists of (to, from) for every instance: all of it, and measured network quantities apart from everything else.

    Of those first what may jump, then what is smooth, then the angles.
    """
    measured: list[tuple[int, int]] = []
    latest: list[tuple[int, int]] = []
    m_start, l_start, m_smooth, m_turn = [0], [0], [], []
    now: list[tuple[int, int]] = []
    n_start = [0]
    ends = {terminal.v for terminal in t.kind.terminals}
    for placed in t.placed:
        known = set(names_of(t.kind.input)) if t.nu else set()
        unknown = set(placed.inputs) - known
        if unknown:
            what = f"{placed.path} ({t.kind.name}) has no inputs {sorted(unknown)}, it has {sorted(known)}"
            raise TopologyError(what)
        for declared in fields_of(t.kind.input) if t.nu else []:
            if declared.name in ends:
                continue
            source = _source(layout, placed, declared.name, declared)
            if isinstance(source, float):
                continue
            to = layout.slots["u", f"{placed.path}.{declared.name}"]
            (measured if source in layout.network_signals else latest).append((to, source))
        own = sorted(measured[m_start[-1] :], key=lambda pair: (pair[1] in layout.angles, pair[1] in layout.smooth))
        measured[m_start[-1] :] = own
        turning = [source in layout.angles for _, source in own]
        smooth = [source in layout.smooth and source not in layout.angles for _, source in own]
        m_smooth.append(len(measured) - sum(turning) - sum(smooth))
        m_turn.append(len(measured) - sum(turning))
        m_start.append(len(measured))
        now += latest[l_start[-1] :] + own
        n_start.append(len(now))
        l_start.append(len(latest))
    return {
        "now_start": np.array(n_start, dtype=np.int64),
        "now": np.array(now, dtype=np.int64).reshape(-1, 2),
        "measured_start": np.array(m_start, dtype=np.int64),
        "measured_smooth": np.array(m_smooth, dtype=np.int64),
        "measured_turn": np.array(m_turn, dtype=np.int64),
        "measured": np.array(measured, dtype=np.int64).reshape(-1, 2),
        "latest_start": np.array(l_start, dtype=np.int64),
        "latest": np.array(latest, dtype=np.int64).reshape(-1, 2),
    }


def _own_leads(
    layout: Layout, net: NetworkPlan, clock_of: dict[str, np.ndarray], gathers: dict[str, dict[str, np.ndarray]]
) -> None:
    """Which lead belongs to each measured signal: its own, if the bridge's modulator has the reader's clock, else none.

    A modulator gives the lead for the instants of its own clock (`conduction.lead_samples`); at a step's end there is
    none, and between the instants of two clocks the chord has to do.
    """
    clock = {
        layout.index[f"{placed.path}.{name}"]: int(clock_of[t.kind.key][k])
        for t in layout.types
        if "modulate" in t.kind.kernels
        for k, placed in enumerate(t.placed)
        for name in names_of(t.kind.output)
    }
    leg_of = {int(state): int(net.leg_first[b]) for state, b in zip(net.lead_state, net.lead_bridge, strict=True)}
    leads = {state: clock.get(int(net.leg_lead[leg]), -1) for state, leg in leg_of.items()}
    for t in layout.types:
        gather = gathers.get(t.kind.key)
        if gather is None:
            continue
        start, found = gather["measured_start"], np.full(len(gather["measured"]), ZERO, dtype=np.int64)
        for k in range(len(t.placed)):
            for j in range(start[k], start[k + 1]):
                source = int(gather["measured"][j, 1])
                if leads.get(source) == clock_of[t.kind.key][k]:
                    found[j] = source
        gather["measured_lead"] = found


def _gather_sources(layout: Layout) -> dict[str, np.ndarray]:
    pairs = []
    for t in layout.types:
        if not t.kind.linear:
            continue
        ends = {terminal.v for terminal in t.kind.terminals}
        for placed in t.placed:
            unknown = set(placed.inputs) - set(names_of(t.kind.input))
            if unknown:
                raise TopologyError(f"{placed.path} ({t.kind.name}) has no inputs {sorted(unknown)}")
            for declared in fields_of(t.kind.input):
                if declared.name in ends:
                    continue
                if declared.name == POSITION:
                    if placed.variant:
                        to = layout.slots["u", f"{placed.path}.{POSITION}"]
                        pairs.append((to, layout.place(placed.variant, placed.path)))
                    continue
                source = _source(layout, placed, declared.name, declared)
                if not isinstance(source, float):
                    pairs.append((layout.slots["u", f"{placed.path}.{declared.name}"], source))
    return {"latest": np.array(pairs, dtype=np.int64).reshape(-1, 2)}
