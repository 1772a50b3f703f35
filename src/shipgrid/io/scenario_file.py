"""A scenario file read and checked against a ship: a start, a time-line of commands, requirements.

Commands, their units and ranges, and the signals that requirements speak of, are those of the ship's equipment.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shipgrid.analysis.requirements import FIGURES, MEASURES, PAIRS, RULES, SOFTENED, Requirement
from shipgrid.automation.modes import MODES
from shipgrid.automation.power_management import RULES as PLANT_RULES
from shipgrid.equipment.declaration import Command, fields_of_kind
from shipgrid.equipment.ship import Catalogue, Ship
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.quantities import parse_quantity, show_quantity
from shipgrid.io.ship_file import check_head, load_ship, open_document, read_ship
from shipgrid.io.timeline_file import Event, TimelineReader
from shipgrid.io.yaml_lines import Document, Listing, Node, Place, Problems, Scalar, Section, replaced
from shipgrid.model.component import Bounds, unit_of
from shipgrid.names import nearest, refusal
from shipgrid.scenarios.conditions import ConditionalEntry

STATES = ("moored", "cold")
"""States a scenario may start from: alongside with what is then on, found from the equations; or all off."""

SHORTEST_STEP, LONGEST_STEP = 1e-6, 1e-3
"""Range of the step [s]: below, rounding of the currents' differences shows; above, no control loop is sampled."""

SHIP_KEYS = ("ship", "buses", "equipment", "hull")
"""First steps of the paths that lead into a ship file; all others lead into a scenario."""


@dataclass(frozen=True)
class Scenario:
    """A story to run with a ship.

    Attributes
    ----------
    name, description : str
        Name; a sentence.
    duration : float
        Length [s].
    step : float or None
        Step it asks for [s].
    start_state : str
        One of `STATES`.
    closed : tuple of str
        Tie breakers that are closed at the start.
    start_set : mapping of str to float
        Commands with a value of their own at the start, by path, SI.
    start_soc : mapping of str to float
        State of charge of batteries at the start, by name, where it is not the ship's.
    events : tuple of Event
        The commands of the time-line that have a time, in its order; those of one instant in the order of the file.
    entries : tuple of ConditionalEntry
        The entries of the time-line that wait for a condition or for another entry, in the order of the file.
    named_times : mapping of str to float
        Times [s] of the entries that have a time and a name, by name.
    requirements : tuple of Requirement
        What the run must meet.
    rules : tuple of object
        Rules of power management that are in force (`automation/power_management.py`).
    document : Document
        The file it was read from, with the changes made since.
    """

    name: str
    description: str
    duration: float
    step: float | None
    start_state: str
    closed: tuple[str, ...]
    start_set: Mapping[str, float]
    start_soc: Mapping[str, float]
    events: tuple[Event, ...]
    entries: tuple[ConditionalEntry, ...]
    named_times: Mapping[str, float]
    requirements: tuple[Requirement, ...]
    rules: tuple[Any, ...]
    document: Document

    def __repr__(self) -> str:
        return f"<Scenario {self.name}: {self.duration:g} s, {len(self.requirements)} requirements>"

    @property
    def text(self) -> str:
        """The file it was read from, changes included."""
        return self.document.text()

    def for_ship(self, ship: Ship) -> Scenario:
        """The same scenario checked against another ship.

        Raises
        ------
        InputErrors
            If it does not fit that ship.
        """
        return read_scenario(self.document, ship.catalogue).checked()

    def ship_at_start(self, ship: Ship) -> Ship:
        """A ship with its batteries charged as the scenario asks for."""
        for name, soc in self.start_soc.items():
            ship = ship.replace(f"equipment.{name}.soc_0", repr(soc))
        return ship

    def start_commands(self, ship: Ship) -> dict[str, float]:
        """Every command of a ship with its value at the start, by path, SI."""
        fitted = self.for_ship(ship)
        values = {}
        for path, command in ship.commands.items():
            moored = command.default if command.moored is None else command.moored
            values[path] = moored if self.start_state == "moored" else command.default
        values |= {f"{name}.close": float(name in self.closed) for name in ship.catalogue.breakers}
        return {**values, **fitted.start_set}

    def replace(self, path: str, value: str, ship: Ship) -> Scenario:
        """A variant with one value of the file changed: `scenario.replace("duration", "60 s", ship)`.

        Raises
        ------
        InputErrors
            If the variant is not a valid scenario for that ship.
        """
        document = replaced(self.document, path, str(value), f"replace {path}")
        return read_scenario(document, ship.catalogue).checked()


@dataclass(frozen=True)
class ScenarioReading:
    """What came of reading a scenario file: a scenario if it has no mistakes."""

    scenario: Scenario | None
    problems: Problems

    def checked(self) -> Scenario:
        """The scenario.

        Raises
        ------
        InputErrors
            With all its mistakes, if it has any.
        """
        self.problems.raise_if_any()
        assert self.scenario is not None
        return self.scenario


def load_scenario(
    name_or_path: str | Path | Mapping[str, Any] = "mission",
    ship: Ship | None = None,
    overrides: Iterable[tuple[str, str]] = (),
) -> Scenario:
    """Read a scenario, a bundled one by name or a file by path, for a ship (the ferry if left out).

    Parameters
    ----------
    name_or_path : str, Path or mapping
        Name of a bundled scenario, or a path that ends in `.yaml` or `.yml`; or a mapping that says what a file would:
        `{"scenario": "short", "duration": "60 s", "timeline": [{"at": "5 s", "set": {"dc_tie.close": False}}]}`.
    ship : Ship, optional
        The ship it is checked against.
    overrides : iterable of (path, value)
        Entries to change before it is checked, as `--set` does.

    Raises
    ------
    InputErrors
        With every mistake in it.
    """
    ship = ship or load_ship()
    return read_scenario(open_document("scenario", name_or_path), ship.catalogue, overrides).checked()


def load_case(
    ship: str | Path, scenario: str | Path, overrides: Iterable[tuple[str, str]] = ()
) -> tuple[Ship, Scenario]:
    """Read a ship and a scenario for it, so that the mistakes of both come in one go.

    Parameters
    ----------
    ship, scenario : str or Path
        Names of bundled ones, or paths.
    overrides : iterable of (path, value)
        Changes to either file; the first step of a path tells which (`SHIP_KEYS`).

    Raises
    ------
    InputErrors
        With every mistake in both.
    """
    return read_case(open_document("ship", ship), open_document("scenario", scenario), overrides)


def read_case(
    ship_document: Document, scenario_document: Document, overrides: Iterable[tuple[str, str]] = ()
) -> tuple[Ship, Scenario]:
    """A ship and a scenario for it, from documents; see `load_case`.

    Parameters
    ----------
    ship_document, scenario_document : Document
    overrides : iterable of (path, value)
        Changes to either.

    Raises
    ------
    InputErrors
        With every mistake in both.
    """
    pairs = list(overrides)
    for_ship = [pair for pair in pairs if pair[0].split(".")[0] in SHIP_KEYS]
    for_scenario = [pair for pair in pairs if pair not in for_ship]
    ship_reading = read_ship(ship_document, for_ship)
    # Where not a single item could be read, every command would be unknown: that would be noise.
    readable = bool(ship_reading.catalogue.signals) or ship_reading.ship is not None
    reading = read_scenario(scenario_document, ship_reading.catalogue if readable else None, for_scenario)
    problems = ship_reading.problems.lines() + reading.problems.lines()
    if problems:
        raise InputErrors(problems)
    return ship_reading.checked(), reading.checked()


def read_scenario(
    document: Document, catalogue: Catalogue | None, overrides: Iterable[tuple[str, str]] = ()
) -> ScenarioReading:
    """Check a scenario document against what a ship offers (None: all that can be checked without one)."""
    for path, value in overrides:
        document = replaced(document, path, value, f"--set {path}={value}")
    return _ScenarioReader(document, catalogue).read()


class _ScenarioReader:
    def __init__(self, document: Document, catalogue: Catalogue | None):
        self.document = document
        self.catalogue = catalogue or Catalogue({}, {}, (), frozenset())
        self.blind = catalogue is None
        self.problems = Problems(list(document.problems.found))
        self.duration = math.inf

    def read(self) -> ScenarioReading:
        root = self.document.root
        if not root.entries:
            return ScenarioReading(None, self.problems)
        keys = ("schema", "scenario", "description", "duration", "step", "start", "rules", "timeline", "requirements")
        check_head(root, self.problems, keys)
        name = self.text(root, "scenario", "", "the name of the scenario")
        if name is not None and (wrong := refusal(name)):
            self.problems.add(root.entries["scenario"].place, "scenario", wrong)
        duration = self.time(root, "duration", "", required=True)
        if duration == 0.0:
            self.problems.add(root.entries["duration"].place, "duration", "nothing lasts 0 s, expected more")
        elif duration is not None:
            self.duration = duration
        step = self.step(root)
        state, closed, chosen, soc = self.start(root)
        rules = self.rules(root)
        events, entries, named_times = TimelineReader(self).read(root)
        requirements = self.requirements(root)
        if self.problems or self.blind:
            return ScenarioReading(None, self.problems)
        assert name is not None
        node = root.get("description")
        description = node.text if isinstance(node, Scalar) else ""
        scenario = Scenario(
            name,
            description,
            self.duration,
            step,
            state,
            closed,
            chosen,
            soc,
            events,
            entries,
            named_times,
            requirements,
            rules,
            self.document,
        )
        return ScenarioReading(scenario, self.problems)

    def step(self, root: Section) -> float | None:
        node = root.get("step")
        if node is None:
            return None
        value = self.quantity(node, "s", "step")
        if value is not None and not SHORTEST_STEP <= value <= LONGEST_STEP:
            self.problems.add(node.place, "step", f"is out of range, expected {step_range()}")
        return value

    # Entries of a section

    def known(self, section: Section, path: str, keys: tuple[str, ...]) -> None:
        for key, _ in section:
            if key not in keys:
                self.problems.add(section.keys[key], f"{path}.{key}", f"no such key{nearest(key, keys)}")

    def text(self, section: Section, key: str, path: str, what: str) -> str | None:
        inside = f"{path}.{key}" if path else key
        node = section.get(key)
        if node is None:
            self.problems.add(section.place, inside, f"missing, expected {what}")
        elif not isinstance(node, Scalar) or node.empty:
            self.problems.add(node.place, inside, f"is not one value, expected {what}")
        else:
            return node.text
        return None

    def quantity(self, node: Node, unit: str, path: str) -> float | None:
        if not isinstance(node, Scalar):
            self.problems.add(node.place, path, f"is not one value, expected a quantity in {unit}")
            return None
        try:
            return parse_quantity(node.text, unit)
        except ParameterError as wrong:
            self.problems.add(node.place, path, str(wrong))
        return None

    def time(self, section: Section, key: str, path: str, *, required: bool = False) -> float | None:
        """A time within the scenario, or None."""
        inside = f"{path}.{key}" if path else key
        node = section.get(key)
        if node is None:
            if required:
                self.problems.add(section.place, inside, "missing, expected a time, such as '600 s'")
            return None
        value = self.quantity(node, "s", inside)
        if value is None:
            return None
        assert isinstance(node, Scalar)
        if value < 0.0:
            self.problems.add(node.place, inside, f"{node.text} is before the start, expected 0 s or later")
            return None
        if value > self.duration:
            end = show_quantity(self.duration, "s")
            self.problems.add(node.place, inside, f"{node.text} is after the end, expected at most {end} (duration)")
            return None
        return value

    def listing(self, root: Section, key: str, example: str) -> tuple[tuple[str, Section], ...]:
        node = root.get(key)
        if node is None or (isinstance(node, Scalar) and node.empty):
            return ()
        if not isinstance(node, Listing):
            self.problems.add(node.place, key, f"is not a list, expected entries such as '- {example}'")
            return ()
        found = []
        for k, item in enumerate(node.items):
            if isinstance(item, Section):
                found.append((f"{key}.{k}", item))
            else:
                self.problems.add(item.place, f"{key}.{k}", f"is not a mapping, expected {example}")
        return tuple(found)

    # Start

    def start(self, root: Section) -> tuple[str, tuple[str, ...], dict[str, float], dict[str, float]]:
        node = root.get("start")
        if not isinstance(node, Section):
            what = "missing" if node is None else "is not a mapping"
            place = root.place if node is None else node.place
            self.problems.add(place, "start", f"{what}, expected {{state: {' or '.join(STATES)}, ...}}")
            return "", (), {}, {}
        self.known(node, "start", ("state", "closed", "soc", "set"))
        state = self.text(node, "state", "start", " or ".join(STATES))
        if state is not None and state not in STATES:
            place = node.entries["state"].place
            self.problems.add(place, "start.state", f"no state '{state}', expected {' or '.join(STATES)}")
        chosen = {path: value for path, value, _ in self.commands(node.get("set"), "start.set")}
        return state or "", self.closed(node), chosen, self.soc(node)

    def soc(self, section: Section) -> dict[str, float]:
        """State of charge of the batteries that a start names."""
        node = section.get("soc")
        if node is None:
            return {}
        if not isinstance(node, Section):
            self.problems.add(node.place, "start.soc", "is not a mapping, expected {bess_for: 40 %, ...}")
            return {}
        batteries, found = self.catalogue.items("bess"), {}
        for name, value in node:
            path = f"start.soc.{name}"
            if name in batteries:
                bounds = fields_of_kind(type(batteries[name]))["soc_0"][0].metadata["bounds"]
                charge = self.bounded(value, "1", bounds, path)
                found |= {} if charge is None else {name: charge}
            elif self.catalogue.equipment:
                self.problems.add(node.keys[name], path, f"no battery '{name}'{nearest(name, batteries)}, expected one")
        return found

    def bounded(self, node: Node, unit: str, bounds: Bounds, path: str) -> float | None:
        """A quantity within its declared range, or None and a problem."""
        value = self.quantity(node, unit, path)
        if value is not None and not bounds.contains(value):
            what = f"{show_quantity(value, unit)} is out of range, expected {bounds} ({bounds.description})"
            self.problems.add(node.place, path, what)
            return None
        return value

    # Rules of power management

    def rules(self, root: Section) -> tuple[Any, ...]:
        node = root.get("rules")
        if node is None or (isinstance(node, Scalar) and node.empty):
            return ()
        if not isinstance(node, Section):
            what = f"is not a mapping, expected rules by name: {', '.join(PLANT_RULES)}"
            self.problems.add(node.place, "rules", what)
            return ()
        found = []
        for name, section in node:
            path = f"rules.{name}"
            if name not in PLANT_RULES:
                what = f"no such rule{nearest(name, PLANT_RULES)}, expected {' or '.join(PLANT_RULES)}"
                self.problems.add(node.keys[name], path, what)
            elif isinstance(section, Section) or section == Scalar("", section.place, True):
                entries = section if isinstance(section, Section) else Section({}, {}, node.keys[name])
                rule = self.plant_rule(PLANT_RULES[name], entries, path)
                found += [] if rule is None else [rule]
            else:
                self.problems.add(section.place, path, "is not a mapping, expected {key: value, ...}")
        return tuple(found)

    def plant_rule(self, cls: type, section: Section, path: str) -> Any:
        """A rule with its values, or None and every problem in it."""
        before = len(self.problems)
        fields = fields_of_kind(cls)
        self.known(section, path, tuple(fields))
        values: dict[str, Any] = {}
        for key, node in section:
            if key not in fields:
                continue
            field, hint = fields[key]
            unit = unit_of(hint)
            if unit is None:
                values[key] = self.text(section, key, path, f"the name of a {field.metadata['reference'][0]}")
            else:
                values[key] = self.bounded(node, unit, field.metadata["bounds"], f"{path}.{key}")
        if len(self.problems) > before:
            return None
        rule = cls(**values)
        if self.catalogue.equipment:
            for key, what in rule.check(self.catalogue):
                place = section.entries[key].place if key in section else section.place
                self.problems.add(place, f"{path}.{key}" if key else path, what)
        return rule

    def closed(self, section: Section) -> tuple[str, ...]:
        node = section.get("closed")
        if node is None:
            return ()
        if not isinstance(node, Listing):
            self.problems.add(node.place, "start.closed", "is not a list, expected names of breakers, [dc_tie]")
            return ()
        names = []
        for k, item in enumerate(node.items):
            name = item.text if isinstance(item, Scalar) else ""
            if not self.unjudged(name) and name not in self.catalogue.breakers:
                hint = nearest(name, self.catalogue.breakers)
                self.problems.add(item.place, f"start.closed.{k}", f"no breaker '{name}'{hint}, expected one")
            else:
                names.append(name)
        return tuple(names)

    # Time-line

    def commands(self, node: Node | None, path: str) -> list[tuple[str, float, Scalar]]:
        """Commands of a `set` with their values."""
        if node is None:
            return []
        if not isinstance(node, Section):
            self.problems.add(node.place, path, "is not a mapping, expected {command: value, ...}")
            return []
        found = []
        for name, value_node in node:
            inside = f"{path}.{name}"
            command = self.catalogue.commands.get(name)
            if command is None:
                if not self.unjudged(name):
                    self.problems.add(node.keys[name], inside, self.no_command(name))
            elif not isinstance(value_node, Scalar) or value_node.empty:
                self.problems.add(value_node.place, inside, f"is not one value, expected {_range(command)}")
            else:
                value = self.command_value(command, value_node, inside)
                if value is not None:
                    found.append((name, value, value_node))
        return found

    def mode(self, section: Section, path: str) -> list[tuple[str, float, Scalar]]:
        """Commands of the operating mode that an entry asks for, if it does."""
        if "mode" not in section:
            return []
        name = self.text(section, "mode", path, f"one of {', '.join(MODES)}")
        if name is None:
            return []
        node = section.entries["mode"]
        if name not in MODES:
            what = f"no mode '{name}'{nearest(name, MODES)}, expected {', '.join(MODES)}"
            self.problems.add(node.place, f"{path}.mode", what)
            return []
        found = []
        for command, text in self.catalogue.modes.get(name, {}).items():
            value = self.command_value(self.catalogue.commands[command], Scalar(text, node.place), f"{path}.mode")
            if value is not None:
                found.append((command, value, Scalar(text, node.place)))
        return found

    def unjudged(self, path: str) -> bool:
        """Whether nothing can be said about a name, because the ship file has a mistake about its owner."""
        return self.blind or path.partition(".")[0] in self.catalogue.unreadable

    def no_command(self, name: str) -> str:
        item, _, short = name.rpartition(".")
        siblings = [path.rpartition(".")[2] for path in self.catalogue.commands if path.rpartition(".")[0] == item]
        if siblings:
            return f"{item} has no command '{short}'{nearest(short, siblings)}, expected one"
        return f"no such command{nearest(name, self.catalogue.commands)}, expected one of `shipgrid list commands`"

    def command_value(self, command: Command, node: Scalar, path: str) -> float | None:
        if command.words is not None:
            if node.text not in command.words:
                self.problems.add(node.place, path, f"'{node.text}' is not a choice, expected {_range(command)}")
                return None
            return command.words[node.text]
        value = self.quantity(node, command.unit, path)
        if value is not None and not command.low <= value <= command.high:
            self.problems.add(node.place, path, f"{node.text} is out of range, expected {_range(command)}")
            return None
        return value

    # Requirements

    def requirements(self, root: Section) -> tuple[Requirement, ...]:
        found: list[Requirement] = []
        places: dict[str, Place] = {}
        keys = ("name", "signal", "minus", *MEASURES, *RULES, "from", "until", "source", "description")
        for path, section in self.listing(root, "requirements", "{name: .., signal: dc_for.v_dc, max: 785 V}"):
            self.known(section, path, keys)
            name = self.text(section, "name", path, "a name")
            if name is not None and name in places:
                what = f"'{name}' is the name of the requirement on line {places[name].line} too, expected another"
                self.problems.add(section.entries["name"].place, f"{path}.name", what)
            elif name is not None:
                places[name] = section.entries["name"].place
            requirement = self.requirement(section, path, name or "")
            if requirement is not None:
                found.append(requirement)
        return tuple(found)

    def requirement(self, section: Section, path: str, name: str) -> Requirement | None:
        before = len(self.problems)
        signal, unit = self.signal(section, "signal", path, FIGURES)
        minus, other = self.signal(section, "minus", path) if "minus" in section else ("", unit)
        if unit is not None and other is not None and other != unit:
            what = f"{minus} is in {other}, {signal} in {unit}, expected the same unit"
            self.problems.add(section.entries["minus"].place, f"{path}.minus", what)
        measure = self.measure(section, path)
        limits = None if unit is None or measure is None else self.limits(section, path, measure, unit)
        rule, allowed = self.rule(section, path, measure)
        start, end = self.window(section, path)
        what = "where the requirement comes from, in a few words"
        source = self.text(section, "source", path, what) if "source" in section else ""
        if len(self.problems) > before or signal is None or measure is None or limits is None:
            return None
        return Requirement(name, signal, measure, *limits, start, end, minus or "", rule, allowed, source or "")

    def signal(
        self, section: Section, key: str, path: str, figures: Mapping[str, str] | None = None
    ) -> tuple[str | None, str | None]:
        """A signal, or one of the figures of a run, with its unit."""
        name = self.text(section, key, path, "the name of a signal")
        if name is None or self.unjudged(name):
            return name, None
        if figures is not None and name in figures:
            return name, figures[name]
        published = self.catalogue.signals.get(name)
        if published is None:
            hint = nearest(name, self.catalogue.signals)
            what = f"no signal '{name}'{hint}, expected one of `shipgrid list signals`"
            self.problems.add(section.entries[key].place, f"{path}.{key}", what)
            return name, None
        return name, published.unit

    def rule(self, section: Section, path: str, measure: str | None) -> tuple[str, float]:
        """The rule in time of a requirement and what it allows [s]; nothing where it has none."""
        given = [rule for rule in RULES if rule in section]
        if not given:
            return "", 0.0
        place = section.entries[given[-1]].place
        if len(given) > 1:
            self.problems.add(place, path, f"has {' and '.join(given)}, expected one of them")
        elif measure is not None and measure not in SOFTENED:
            what = f"does not go with {measure}, expected one of {', '.join(SOFTENED)}"
            self.problems.add(place, f"{path}.{given[0]}", what)
        return given[0], self.time(section, given[0], path) or 0.0

    def measure(self, section: Section, path: str) -> str | None:
        given = [measure for measure in MEASURES if measure in section]
        if len(given) == 1:
            return given[0]
        what = f"has {' and '.join(given)}" if given else "has no limit"
        self.problems.add(section.place, path, f"{what}, expected one of {', '.join(MEASURES)}")
        return None

    def limits(self, section: Section, path: str, measure: str, unit: str) -> tuple[float, float] | None:
        """Lower and upper limit of a measure in SI, or None."""
        node, inside = section.entries[measure], f"{path}.{measure}"
        if measure in PAIRS:
            if not isinstance(node, Listing) or len(node.items) != 2:
                self.problems.add(node.place, inside, "is not a pair, expected [low, high]")
                return None
            low, high = (self.quantity(item, unit, f"{inside}.{k}") for k, item in enumerate(node.items))
            if low is None or high is None:
                return None
            if low >= high:
                self.problems.add(node.place, inside, "the lower limit is not below the upper, expected [low, high]")
            return low, high
        value = self.quantity(node, unit, inside)
        if value is None:
            return None
        if measure == "min":
            return value, math.inf
        return (-math.inf if measure == "max" else 0.0), value

    def window(self, section: Section, path: str) -> tuple[float, float]:
        start, end = self.time(section, "from", path) or 0.0, self.time(section, "until", path)
        if start >= (self.duration if end is None else end):
            key = "from" if end is None else "until"
            place = section.entries[key].place
            what = "the window ends before it begins, expected 'from' before 'until' and before the end"
            self.problems.add(place, f"{path}.{key}", what)
        return start, math.inf if end is None else end


def step_range() -> str:
    """The steps that can be asked for, in words."""
    return f"{show_quantity(SHORTEST_STEP * 1e6, 'us')} .. {show_quantity(LONGEST_STEP * 1e6, 'us')}"


def _range(command: Command) -> str:
    """What a command takes, in words."""
    if command.words is not None:
        return " or ".join(command.words)
    return f"{command.low:g} .. {show_quantity(command.high, command.unit)} ({command.description})"
