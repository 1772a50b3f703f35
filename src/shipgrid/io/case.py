"""What one run is asked for, checked: a ship, a scenario, fidelity, step, and changes of either file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.automation.interlocks import Interlocks
from shipgrid.automation.power_management import operator_of
from shipgrid.equipment.ship import Ship
from shipgrid.io.scenario_file import Scenario, read_case
from shipgrid.io.ship_file import open_document
from shipgrid.scenarios.case import DEFAULT_STEP, build, step_of
from shipgrid.scenarios.conclude import command_text
from shipgrid.scenarios.parts import Groups, parts_wanted
from shipgrid.scenarios.session import Run
from shipgrid.scenarios.start import start
from shipgrid.scenarios.timeline import Timeline

if TYPE_CHECKING:
    from shipgrid.scenarios.results import Results


@dataclass(frozen=True)
class Case:
    """A ship with a scenario at one fidelity and step, checked; it can be pickled, and writes nothing by itself.

    Parameters
    ----------
    ship : Ship, str, Path or mapping
        A ship, the name of a bundled one, a file by path, or a mapping that says what a file would.
    scenario : Scenario, str, Path or mapping
        Likewise.
    fidelity : {"averaged", "switching"}
        Detail of the converters.
    step : float, optional
        Step [s]; the scenario's own (averaged only), or 30 us.
    overrides : mapping of str to str
        Changes to either file, as `--set` makes them: `{"equipment.bess_for.capacity": "160 Ah"}`.
    parts : str, int or mapping, optional
        What the plant is cut into: "ship" as its file says, a number of parts, or buses by the name of a part.

    Raises
    ------
    InputErrors
        With every mistake in both files.
    ParameterError
        If there is no such fidelity, or the step is out of range.
    """

    ship: Ship
    scenario: Scenario
    fidelity: str = "averaged"
    step: float = DEFAULT_STEP
    overrides: Mapping[str, str] = field(default_factory=dict)
    parts: Groups | None = None

    def __init__(
        self,
        ship: Ship | str | Path | Mapping[str, Any] = "ferry",
        scenario: Scenario | str | Path | Mapping[str, Any] = "mission",
        fidelity: str = "averaged",
        step: float | None = None,
        overrides: Mapping[str, str] | None = None,
        parts: str | int | Groups | None = None,
    ) -> None:
        documents = [
            made.document if isinstance(made, Ship | Scenario) else open_document(what, made)
            for what, made in (("ship", ship), ("scenario", scenario))
        ]
        changed = dict(overrides or {})
        found_ship, found_scenario = read_case(documents[0], documents[1], changed.items())
        object.__setattr__(self, "ship", found_scenario.ship_at_start(found_ship))
        object.__setattr__(self, "scenario", found_scenario)
        object.__setattr__(self, "fidelity", fidelity)
        h = step_of(found_scenario, fidelity, step)
        object.__setattr__(self, "step", h)
        object.__setattr__(self, "overrides", changed)
        object.__setattr__(self, "parts", parts_wanted(self.ship, parts, h))

    def __repr__(self) -> str:
        return f"<Case {self.ship.name}, {self.scenario.name}: {self.fidelity}, {1e6 * self.step:g} us>"

    def plan(self) -> Plan:
        """Its plan: made anew by each call."""
        return build(self.ship, self.step, self.fidelity, self.scenario.rules, self.parts)

    def start(self, plan: Plan) -> tuple[Workspace, float]:
        """Where it begins, and the drift [1/s] that is left there.

        Raises
        ------
        SteadyStateError
            If the start state that the scenario asks for does not exist.
        """
        return start(plan, self.ship, self.scenario)

    def timeline(self, run: Run) -> Timeline:
        """Who commands a run of it: the scenario's time-line, through the interlocks; rules of power management."""
        ship, scenario, plan = self.ship, self.scenario, run.plan
        return Timeline(
            plan,
            run.work,
            run.events,
            scenario.events,
            partial(command_text, ship),
            interlocks=Interlocks(ship, plan),
            operator=operator_of(scenario.rules, ship, plan),
            entries=scenario.entries,
            named_times=scenario.named_times,
        )

    def simulate(self, **options: Any) -> Results:
        """Run it to its end and write an output folder.

        Parameters
        ----------
        **options
            Of `simulate`: `until`, `out`, `report`, `waveforms` and so on.
        """
        from shipgrid.scenarios.simulate import simulate

        made: dict[str, Any] = {"fidelity": self.fidelity, "step": self.step, "overrides": self.overrides}
        return simulate(self.ship, self.scenario, parts=self.parts, **made, **options)
