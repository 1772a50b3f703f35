"""The time-line of a scenario file: commands at a time, and entries that wait for a condition or for another entry."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Protocol

from shipgrid.io.quantities import show_quantity
from shipgrid.io.yaml_lines import Listing, Node, Place, Problems, Scalar, Section
from shipgrid.names import nearest, refusal
from shipgrid.scenarios.conditions import Condition, ConditionalEntry

UNLIMITED = "unlimited"
"""What `times` says of an entry of the time-line that may happen any number of times."""
ENTRY_KEYS = (
    "name",
    "at",
    "when",
    "after",
    "delay",
    "from",
    "until",
    "times",
    "optional",
    "mode",
    "set",
    "description",
)
CONDITION_KEYS = ("signal", "above", "below", "for", "hysteresis")
PLACE = re.compile(r"timeline\.[0-9]+")
"""What an entry without a name is called."""
WITHOUT_A_TIME = ("when", "after", "delay", "from", "until", "times", "optional")
"""Keys of an entry of the time-line that do not go with `at`."""


class Event(NamedTuple):
    """A command given at a time: `path` becomes `value` (SI) at `at` [s]."""

    at: float
    path: str
    value: float


Commands = list[tuple[str, float, Scalar]]
"""Path and value (SI) of commands, and where each is written."""


class Fields(Protocol):
    """What reads the fields of a scenario file and notes what is wrong in them."""

    problems: Problems

    def known(self, section: Section, path: str, keys: tuple[str, ...]) -> None:
        """Note keys that are none of those."""
        ...

    def text(self, section: Section, key: str, path: str, what: str) -> str | None:
        """A text that has to be there."""
        ...

    def quantity(self, node: Node, unit: str, path: str) -> float | None:
        """A quantity in SI."""
        ...

    def time(self, section: Section, key: str, path: str, *, required: bool = False) -> float | None:
        """A time within the scenario [s]."""
        ...

    def listing(self, root: Section, key: str, example: str) -> tuple[tuple[str, Section], ...]:
        """Entries of a list, by path."""
        ...

    def window(self, section: Section, path: str) -> tuple[float, float]:
        """`from` and `until` [s]."""
        ...

    def signal(
        self, section: Section, key: str, path: str, figures: Mapping[str, str] | None = None
    ) -> tuple[str | None, str | None]:
        """A public signal with its unit."""
        ...

    def commands(self, node: Node | None, path: str) -> Commands:
        """Commands of a `set`."""
        ...

    def mode(self, section: Section, path: str) -> Commands:
        """Commands of a `mode`."""
        ...


class TimelineReader:
    """Reads the time-line of a scenario file; what is wrong in it is noted with the problems of the fields.

    Parameters
    ----------
    fields : Fields
    """

    def __init__(self, fields: Fields):
        self.fields, self.problems = fields, fields.problems

    def read(self, root: Section) -> tuple[tuple[Event, ...], tuple[ConditionalEntry, ...], dict[str, float]]:
        """Commands that have a time; entries that wait; times of entries that have a time and a name."""
        events: list[Event] = []
        entries: list[ConditionalEntry] = []
        named_times: dict[str, float] = {}
        given: dict[tuple[float, str], Place] = {}
        sections = self.fields.listing(root, "timeline", "{at: 10 s, set: {propulsion_for.speed_ref: 6 kn}}")
        names = self.entry_names(sections)
        for path, section in sections:
            self.fields.known(section, path, ENTRY_KEYS)
            name = names[path]
            commands = self.entry_commands(section, path, name)
            if "when" in section or "after" in section:
                entries.append(self.conditional(section, path, name, commands, tuple(names.values())))
                continue
            at = self.fields.time(section, "at", path)
            if "at" not in section:
                what = "missing, expected a time, such as '600 s', or 'when' with a condition"
                self.problems.add(section.place, f"{path}.at", what)
            for key in (key for key in WITHOUT_A_TIME if key in section):
                what = "goes with 'when' or 'after', expected one of them in place of 'at'"
                self.problems.add(section.keys[key], f"{path}.{key}", what)
            if at is None:
                continue
            named_times[name] = at
            for command, value, node in commands:
                if (at, command) in given:
                    first = given[at, command].line
                    what = f"is given at {show_quantity(at, 's')} on line {first} too; expected once"
                    self.problems.add(node.place, f"{path}.set.{command}", what)
                given[at, command] = node.place
                events.append(Event(at, command, value))
        self.reachable(dict(sections), names, entries)
        waited_for = {name for entry in entries for name in entry.after}
        named_times = {name: at for name, at in named_times.items() if name in waited_for}
        return tuple(sorted(events, key=lambda event: event.at)), tuple(entries), named_times

    def entry_names(self, sections: Iterable[tuple[str, Section]]) -> dict[str, str]:
        """Name of each entry by its path; the path itself where it has none."""
        names: dict[str, str] = {}
        places: dict[str, Place] = {}
        for path, section in sections:
            name = self.fields.text(section, "name", path, "a name") if "name" in section else None
            if name is not None and (wrong := refusal(name)):
                self.problems.add(section.entries["name"].place, f"{path}.name", wrong)
                name = None
            elif name is not None and PLACE.fullmatch(name):
                what = f"'{name}' is what an entry without a name is called, expected another"
                self.problems.add(section.entries["name"].place, f"{path}.name", what)
                name = None
            elif name is not None and name in places:
                what = f"'{name}' is the name of the entry on line {places[name].line} too, expected another"
                self.problems.add(section.entries["name"].place, f"{path}.name", what)
                name = None
            elif name is not None:
                places[name] = section.entries["name"].place
            names[path] = name or path
        return names

    def entry_commands(self, section: Section, path: str, name: str) -> Commands:
        """Commands of an entry: its own, and those of its mode that it does not give itself."""
        waits = "when" in section or "after" in section
        if "set" not in section and "mode" not in section and not (waits and name != path):
            what = "missing, expected {command: value, ...}"
            what += ", or a name that other entries can wait for (after)" if waits else ""
            self.problems.add(section.place, f"{path}.set", what)
        chosen = self.fields.commands(section.get("set"), f"{path}.set")
        own = {command for command, *_ in chosen}
        return [given for given in self.fields.mode(section, path) if given[0] not in own] + chosen

    def conditional(
        self,
        section: Section,
        path: str,
        name: str,
        commands: Commands,
        names: tuple[str, ...],
    ) -> ConditionalEntry:
        """An entry that waits for a condition, for another entry, or for both."""
        if "at" in section:
            what = "does not go with 'when' or 'after', expected 'from' for a time before which it is not looked at"
            self.problems.add(section.keys["at"], f"{path}.at", what)
        after = self.after(section, path, names)
        if "delay" in section and "after" not in section:
            what = "goes with 'after', the name of the entry that it follows"
            self.problems.add(section.keys["delay"], f"{path}.delay", what)
        times = self.times(section, path)
        conditions = self.conditions(section, path, repeats=times != 1 and "after" not in section)
        return ConditionalEntry(
            name,
            tuple((command, value) for command, value, _ in commands),
            conditions,
            after,
            self.fields.time(section, "delay", path) or 0.0,
            *self.fields.window(section, path),
            times,
            self.choice(section, "optional", path, {"false": False, "true": True}, False),
        )

    def conditions(self, section: Section, path: str, *, repeats: bool) -> tuple[Condition, ...]:
        """The conditions of an entry: one, or a list of which all have to hold."""
        node = section.get("when")
        if node is None:
            return ()
        example = "{signal: bess_for.soc, above: 60 %}"
        if isinstance(node, Section):
            return (self.condition(node, f"{path}.when", repeats=repeats),)
        if not isinstance(node, Listing) or not node.items:
            self.problems.add(node.place, f"{path}.when", f"is no condition, expected {example}, or a list of such")
            return ()
        conditions = []
        for k, item in enumerate(node.items):
            if isinstance(item, Section):
                conditions.append(self.condition(item, f"{path}.when.{k}", repeats=repeats))
            else:
                self.problems.add(item.place, f"{path}.when.{k}", f"is not a mapping, expected {example}")
        return tuple(conditions)

    def condition(self, section: Section, path: str, *, repeats: bool) -> Condition:
        """One condition; what is wrong in it has been noted."""
        self.fields.known(section, path, CONDITION_KEYS)
        signal, unit = self.fields.signal(section, "signal", path)
        limits = {"above": -math.inf, "below": math.inf}
        words = []
        for key in limits:
            node = section.get(key)
            if node is None:
                continue
            words.append(f"{key} {node.text if isinstance(node, Scalar) else ''}")
            value = self.fields.quantity(node, unit, f"{path}.{key}") if unit is not None else None
            limits[key] = limits[key] if value is None else value
        if not words and all(key in CONDITION_KEYS for key, _ in section):
            self.problems.add(section.place, path, "has no limit, expected above or below, with a quantity")
        if not limits["above"] < limits["below"]:
            what = "is not less than 'below', so that it never holds, expected less"
            self.problems.add(section.entries["above"].place, f"{path}.above", what)
        hold = self.fields.time(section, "for", path) or 0.0
        hysteresis = 0.0
        if (node := section.get("hysteresis")) is not None:
            value = self.fields.quantity(node, unit, f"{path}.hysteresis") if unit is not None else None
            if value is not None and value < 0.0:
                self.problems.add(node.place, f"{path}.hysteresis", "is negative, expected 0 or more")
            elif not repeats:
                what = "has an effect only where 'times' is more than 1, and without 'after', expected neither"
                self.problems.add(section.keys["hysteresis"], f"{path}.hysteresis", what)
            hysteresis = value or 0.0
        text = f"{signal} {' and '.join(words)}" + (f" for {hold:g} s" if hold else "")
        return Condition(signal or "", limits["above"], limits["below"], hold, hysteresis, text)

    def after(self, section: Section, path: str, names: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the entries that an entry follows."""
        node = section.get("after")
        if node is None:
            return ()
        items = node.items if isinstance(node, Listing) else (node,)
        if not items:
            self.problems.add(
                node.place, f"{path}.after", "is empty, expected the name of an entry, or a list of names"
            )
        entries = []
        for item in items:
            if not isinstance(item, Scalar) or item.empty:
                self.problems.add(item.place, f"{path}.after", "is no name, expected that of an entry of the time-line")
            elif item.text not in names:
                named = [name for name in names if not name.startswith("timeline.")]
                what = f"no entry '{item.text}'{nearest(item.text, named)}, expected the name of one"
                self.problems.add(item.place, f"{path}.after", what)
            else:
                entries.append(item.text)
        return tuple(entries)

    def times(self, section: Section, path: str) -> int | None:
        """How often an entry may happen; None for any number."""
        node = section.get("times")
        if node is None:
            return 1
        text = node.text if isinstance(node, Scalar) else ""
        if text == UNLIMITED:
            return None
        if not text.isascii() or not text.isdecimal() or int(text) == 0:
            what = f"'{text}' is no number of times, expected a whole number from 1, or {UNLIMITED}"
            self.problems.add(node.place, f"{path}.times", what)
            return 1
        return int(text)

    def choice(self, section: Section, key: str, path: str, words: Mapping[str, Any], default: Any) -> Any:
        """What a word of an entry means, or the default."""
        node = section.get(key)
        if node is None:
            return default
        text = node.text if isinstance(node, Scalar) else ""
        if text not in words:
            what = f"'{text}' is not a choice, expected {' or '.join(words)}"
            self.problems.add(node.place, f"{path}.{key}", what)
        return words.get(text, default)

    def reachable(
        self, sections: Mapping[str, Section], names: Mapping[str, str], entries: Iterable[ConditionalEntry]
    ) -> None:
        """Note the entries that can never happen, because what they follow waits for them or never happens."""
        waiting = {entry.name: entry for entry in entries if entry.after}
        free = [name for name in names.values() if name not in waiting]
        while free:
            free = [name for name, entry in waiting.items() if any(n not in waiting for n in entry.after)]
            for name in free:
                del waiting[name]
        for path, name in names.items():
            if name in waiting:
                what = f"can never happen: what it follows ({', '.join(waiting[name].after)}) waits for it or never "
                what += "happens, expected an entry with a time, or with a condition alone, to begin with"
                self.problems.add(sections[path].keys["after"], f"{path}.after", what)
