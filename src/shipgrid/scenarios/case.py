"""What a run is made of: a ship at one step length and fidelity, as a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.plan import Plan
from shipgrid.automation.power_management import equip
from shipgrid.errors import ParameterError
from shipgrid.model.network import FIDELITIES, Network
from shipgrid.scenarios.events import seconds
from shipgrid.scenarios.parts import Groups

DEFAULT_STEP, SHORTEST_STEP, LONGEST_STEP = 30e-6, 1e-6, 1e-3
"""Step lengths [s]."""


def step_of(scenario: Any, fidelity: str, step: float | None = None) -> float:
    """Step [s] of a run: the one asked for, or the scenario's own (averaged only), or `DEFAULT_STEP`.

    Parameters
    ----------
    scenario : Scenario
    fidelity : {"averaged", "switching"}
    step : float, optional
        What is asked for [s].

    Raises
    ------
    ParameterError
        If there is no such fidelity, or the step is outside `SHORTEST_STEP` .. `LONGEST_STEP`.
    """
    if fidelity not in FIDELITIES:
        raise ParameterError(f"there is no fidelity '{fidelity}', expected one of {', '.join(FIDELITIES)}")
    of_scenario = scenario.step if fidelity == "averaged" else None
    h = seconds("step", next(h for h in (step, of_scenario, DEFAULT_STEP) if h is not None))
    if not SHORTEST_STEP <= h <= LONGEST_STEP:
        raise ParameterError(f"step = {h!r} s, expected {SHORTEST_STEP:g} s to {LONGEST_STEP:g} s")
    return h


def build(
    ship: Any, step: float, fidelity: str = "averaged", rules: Sequence[Any] = (), parts: Groups | None = None
) -> Plan:
    """Network and plan of a ship at one step length.

    Parameters
    ----------
    ship : Ship
    step : float
        Step [s].
    fidelity : {"averaged", "switching"}
        Detail of the converters.
    rules : sequence of object
        Rules of power management in force.
    parts : mapping of str to sequence of str, optional
        Names of buses by part, where the plant is cut (`assembly/partition.py`).
    """
    network = Network(ship.name, fidelity)
    ship.build(network)
    equip(network, ship, rules)
    return assemble(network, step, parts=parts)
