"""Where a run begins: at rest under the commands of its scenario, with everything off, or at given values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from shipgrid.analysis.settling import carried_over, run_to_rest
from shipgrid.assembly.hand_over import fill_delay_lines, places_to_start, set_time, settle, taken_over
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.names import nearest
from shipgrid.scenarios.case import build

if TYPE_CHECKING:
    from shipgrid.analysis.steady_state import OperatingPoint


def start(plan: Plan, ship: Any, scenario: Any) -> tuple[Workspace, float]:
    """Workspace at the start a scenario asks for, and the drift left in it.

    Parameters
    ----------
    plan : Plan
    ship : Ship
    scenario : Scenario

    Returns
    -------
    work : Workspace
    drift : float
        Of an operating point; 0 for a cold start.
    """
    commands = scenario.start_commands(ship)
    if scenario.start_state == "moored":
        if plan.network.fidelity == "averaged" and not plan.parts:
            return run_to_rest(plan, commands)
        mean = build(ship, plan.h, rules=scenario.rules)
        work, drift = run_to_rest(mean, commands)
        return carried_over(mean, work, plan), drift
    work = new_workspace(plan)
    for path, value in commands.items():
        work.sig[plan.layout.place(f"command:{path}", "start")] = value
    settle_outputs(plan, work)
    return work, 0.0


LOGS = (
    *("rows", "plant_rows", "slow_rows", "interval", "energy", "exchanged", "limiter_time"),
    *("event_step", "event_which", "event_value", "event_count"),
)
"""What of a workspace belongs to one run and not to its state."""


def begin_at(
    plan: Plan, start: Workspace | OperatingPoint | Mapping[str, float] | None, begin: float | None = None
) -> Workspace:
    """A workspace of a plan, its own, at a start.

    Parameters
    ----------
    plan : Plan
    start : Workspace, OperatingPoint or mapping of str to float, optional
        A state of this plan or one to be handed over; or values [SI] by path, everything else at its initial value.
    begin : float, optional
        Time [s] of a start that is given by values; 0 if left out.

    Raises
    ------
    InputErrors
        All values that cannot be set; currents that have no path.
    TopologyError
        If the start is of a network with other buses, elements or connections.
    ParameterError
        If `begin` is given beside a start that has a time.
    """
    if not isinstance(start, Workspace | Mapping | None):
        start = start.workspace()  # an operating point
    if isinstance(start, Workspace):
        if begin is not None:
            raise ParameterError(f"begin = {begin:g} s, expected none: the start has its own time")
        copied, empty = taken_over(start, plan), new_workspace(plan)
        copied.plan = plan
        copied.step = copied.step._replace(**{name: getattr(empty.step, name) for name in LOGS})
        copied.forget_notes()
        return copied
    work = new_workspace(plan)
    known = places_to_start(plan)
    wrong = []
    for path, value in (start or {}).items():
        if path in known and math.isfinite(value):
            work.sig[known[path]] = value
            continue
        hint = nearest(path, known) if path not in known else ""
        wrong.append(f"start: '{path}' = {value!r} is no value of a state, bus voltage or command{hint}")
    if begin is not None and not (math.isfinite(begin) and begin >= 0.0):
        wrong.append(f"begin = {begin!r} s, expected a time from 0 on")
    wrong = wrong or settle(plan, work)
    if wrong:
        raise InputErrors(wrong)
    if start:
        fill_delay_lines(plan, work)
        settle(plan, work)
    if begin is not None:
        set_time(plan, work, begin)
    return work
