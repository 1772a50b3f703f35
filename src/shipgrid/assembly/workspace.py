"""What moves while a plan is run: the flat vector, and what the solver and the books keep from step to step."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shipgrid.assembly.layout import NORTON_FIELDS
from shipgrid.assembly.plan import Plan
from shipgrid.model.kernel import in_one_piece
from shipgrid.solvers.conduction import MEANS
from shipgrid.solvers.nodal import NetworkWork
from shipgrid.solvers.pacing import PaceWork, no_pace

CHUNK_ROWS = 512
"""Recorded rows of a group between two visits of the runner."""
WAVE_ROWS = 1024
"""Steps of a waveform window between two visits of the runner."""
EVENTS = 4096
"""Most events between two visits of the runner."""


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


@dataclass(repr=False)
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

    def __repr__(self) -> str:
        return f"<Workspace of {self.plan.network.name} at {self.n * self.plan.h:g} s>"

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


def new_workspace(plan: Plan) -> Workspace:
    """A workspace at time zero, everything at its declared initial value.

    Parameters
    ----------
    plan : Plan
    """
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
