"""What a plant is to the core: a plan, which never changes during a run. One plan serves many workspaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shipgrid.assembly.layout import Layout, TypeLayout
from shipgrid.assembly.partition import Partition
from shipgrid.assembly.schedule import Schedule, type_order
from shipgrid.errors import TopologyError
from shipgrid.model.component import ComponentType
from shipgrid.model.network import Network
from shipgrid.solvers.nodal import NetworkPlan


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


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        return f"<Plan of {self.network.name}: {1e6 * self.h:g} us, {self.layout.size} signals>"

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
