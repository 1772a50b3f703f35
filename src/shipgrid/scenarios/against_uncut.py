"""A plant cut into parts, and the same plant whole, through the same scenario: what error does the cut introduce?

Both start from the state of the whole plant and are given the same commands at the same steps; every public signal is
compared at every step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shipgrid.analysis.settling import carried_over
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.automation.interlocks import Interlocks
from shipgrid.automation.power_management import operator_of
from shipgrid.errors import ParameterError, SolverError
from shipgrid.scenarios.against_reference import Deviation
from shipgrid.scenarios.case import DEFAULT_STEP, build
from shipgrid.scenarios.session import Run, run_until
from shipgrid.scenarios.start import start
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import Window

STRETCH = 4000
"""Steps that both plants make in turn; only so many are kept."""


def against_uncut(
    ship: Any,
    scenario: Any,
    parts: Mapping[str, Sequence[str]],
    until: float,
    *,
    fidelity: str = "averaged",
    step: float | None = None,
) -> list[Deviation]:
    """Run a scenario cut and whole.

    Parameters
    ----------
    ship : Ship
    scenario : Scenario
    parts : mapping of str to sequence of str
        Buses by the name of a part.
    until : float
        End [s].
    fidelity : {"averaged", "switching"}
    step : float, optional
        Step [s]; the scenario's own (averaged only), or 30 us.

    Returns
    -------
    list of Deviation
        Of the cut plant's public signals from the whole one's, the largest relative one first. `size` is the largest
        magnitude of any signal of the unit in the whole plant, 1 for one without a unit.

    Raises
    ------
    ParameterError
        If there is nothing to compare.
    TopologyError
        If the plant cannot be cut so.
    SolverError
        If one of the runs diverges.
    """
    h = step or (scenario.step if fidelity == "averaged" else None) or DEFAULT_STEP
    last = round(until / h)
    if last < 1:
        raise ParameterError(f"until = {until:g} s, expected a step at least")
    ship = scenario.ship_at_start(ship)
    plan = build(ship, h, fidelity, scenario.rules)
    cut = assemble(plan.network, h, parts=parts)
    work, _ = start(plan, ship, scenario)
    sides = [_Side(ship, scenario, plan, work.snapshot()), _Side(ship, scenario, cut, carried_over(plan, work, cut))]
    public = list(plan.network.published.values())
    largest, at, squares, size = (np.zeros(len(public)) for _ in range(4))
    for end in [*range(STRETCH, last, STRETCH), last]:
        (times, whole), (_, parted) = (side.to(end) for side in sides)
        gap = np.abs(parted - whole)
        gap[np.isnan(gap)] = np.inf
        worst = gap.argmax(axis=0)
        now = gap[worst, np.arange(len(public))]
        at = np.where(now > largest, times[worst], at)
        largest = np.maximum(largest, now)
        squares += (gap**2).sum(axis=0)
        size = np.maximum(size, np.abs(whole).max(axis=0))
    of_unit: dict[str, float] = {}
    for p, value in zip(public, size, strict=True):
        of_unit[p.unit] = 1.0 if p.unit == "1" else max(of_unit.get(p.unit, 0.0), float(value))
    rms = np.sqrt(squares / (last + 1))
    found = [
        Deviation(p.name, p.unit, float(largest[k]), float(at[k]), float(rms[k]), of_unit[p.unit])
        for k, p in enumerate(public)
    ]
    return sorted(found, key=lambda d: -d.relative)


class _Side:
    """One of the two plants under way; keeps the public signals of its last stretch."""

    def __init__(self, ship: Any, scenario: Any, plan: Plan, work: Workspace):
        self.run = Run(plan, work)
        operator = operator_of(scenario.rules, ship, plan)
        who = {"interlocks": Interlocks(ship, plan), "operator": operator}
        who |= {"entries": scenario.entries, "named_times": scenario.named_times}
        self.due = Timeline(plan, work, self.run.events, scenario.events, **who)
        self.kept: list[tuple[np.ndarray, np.ndarray]] = []

    def to(self, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Run to a step; times [s] and public signals since the last one."""
        plan, n = self.run.plan, self.run.work.n
        window = Window(n + 1 if n else 0, last, "waveforms")
        self.kept.clear()
        run_until(self.run, self.due, last * plan.h, self, windows=[window])
        if self.run.interrupted:
            raise KeyboardInterrupt
        if self.run.failure:
            raise SolverError(self.run.failure)
        times, rows = zip(*self.kept, strict=True)
        return np.concatenate(times), np.concatenate(rows)[:, : len(plan.network.published)]

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
        mean: np.ndarray | None = None,
    ) -> None:
        """Keep what the window gets."""
        if group == "waveforms":
            self.kept.append((time, value))
