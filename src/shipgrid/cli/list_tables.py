"""What `shipgrid list` shows: tables made from the declarations."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from shipgrid.cli.table import table
from shipgrid.equipment.declaration import EQUIPMENT, Command, default_of, fields_of_kind, is_required
from shipgrid.errors import InputErrors
from shipgrid.io.quantities import show_quantity
from shipgrid.io.scenario_file import load_scenario
from shipgrid.io.ship_file import bundled, load_ship
from shipgrid.model.component import load_all, parameters_of, unit_of
from shipgrid.realtime.registers import registers as made_of
from shipgrid.realtime.registers import write_registers


def ships() -> None:
    """Bundled ships."""
    rows = []
    for name in bundled("ship"):
        ship = load_ship(name)
        rows.append((name, f"{len(ship.buses)} buses", f"{len(ship.equipment)} items", _described(ship)))
    table("Ships", ("name", "buses", "equipment", "description"), rows)


def scenarios() -> None:
    """Bundled scenarios."""
    rows = []
    for name in bundled("scenario"):
        try:
            scenario = load_scenario(name)
            rows.append((name, f"{scenario.duration:g} s", scenario.description))
        except InputErrors as wrong:
            rows.append((name, "", f"has mistakes: {wrong.problems[0]}"))
    table("Scenarios", ("name", "duration", "description"), rows)


def equipment() -> None:
    """Equipment kinds and what a ship file may say about them."""
    load_all()
    for kind in EQUIPMENT.values():
        title = f"{kind.kind}: {_first_line(kind.cls)}"
        table(title, ("key", "default", "range", "meaning", "source"), _keys(kind.cls, ""))


def components() -> None:
    """Components: one device, one controller each, with its parameters."""
    rows = []
    for name, kind in sorted(load_all().items()):
        sort = "network" if kind.terminals else kind.stage
        parameters = ", ".join(f"{p} [{unit}]" for p, unit, _, _ in parameters_of(kind.cls))
        module = kind.cls.__module__.removeprefix("shipgrid.")
        rows.append((name, module, sort, _first_line(kind.cls), parameters))
    table("Components", ("name", "module", "stage", "what it is", "parameters"), rows)


def signals() -> None:
    """Public signals of the ferry."""
    ship = load_ship()
    rows = [(path, signal.unit, signal.group, signal.description) for path, signal in sorted(ship.signals.items())]
    table("Signals of the ferry", ("signal", "unit", "group", "meaning"), rows)


def commands() -> None:
    """Commands of the ferry."""
    ship = load_ship()
    rows = []
    for path, command in ship.commands.items():
        moored = command.default if command.moored is None else command.moored
        refusals = "; ".join(command.refusals.values())
        shown = _takes(command), _shown(command, command.default), _shown(command, moored)
        rows.append((path, *shown, command.description, refusals))
    table("Commands of the ferry", ("command", "takes", "default", "moored", "meaning", "refused if"), rows)


def registers(name: str, *, csv: bool) -> None:
    """What field buses show of a ship and take.

    Parameters
    ----------
    name : str
        Of the ship, or its file.
    csv : bool
        As comma-separated values, for programs.
    """
    ship = load_ship(name)
    if csv:
        write_registers(sys.stdout, ship.signals, ship.commands)
        return
    for table_, what in (("input", "show"), ("holding", "take")):
        rows = [
            (line.name, "" if line.udp is None else str(line.udp), str(line.address), *line[5:])
            for line in made_of(ship.signals, ship.commands)
            if line.table == table_
        ]
        heads = ("name", "UDP number", "Modbus address", "registers", "unit", "takes", "meaning")
        table(f"{table_.capitalize()} registers of {ship.name}: what they {what}", heads, map(_texts, rows))


def _texts(row: Iterable[object]) -> list[str]:
    return [str(cell) for cell in row]


def _takes(command: Command) -> str:
    if command.words is not None:
        return " or ".join(command.words)
    return f"{command.low:g} .. {show_quantity(command.high, command.unit)}"


def _shown(command: Command, value: float) -> str:
    if command.words is not None:
        return {code: word for word, code in command.words.items()}[value]
    return show_quantity(value, command.unit)


def _keys(cls: type, prefix: str) -> list[tuple[str, str, str, str, str]]:
    rows = []
    for key, (field, hint) in fields_of_kind(cls).items():
        name = prefix + key
        if "block" in field.metadata:
            rows += _keys(field.metadata["block"], f"{name}.")
            continue
        bounds = field.metadata.get("bounds")
        unit = unit_of(hint) or "1"
        default = "required" if is_required(field) else _default(default_of(field), unit)
        limits = field.metadata.get("choice") or field.metadata.get("reference") or ()
        if "curve" in field.metadata:
            limits = (*limits, "[[{}, {}], ...]".format(*field.metadata["curve"]))
        span = (str(bounds) + ("" if unit == "1" else f" {unit}")) if bounds else " or ".join(limits)
        meaning = bounds.description if bounds else field.metadata.get("description", "")
        rows.append((name, default, span, meaning, bounds.source if bounds else ""))
    return rows


def _default(value: Any, unit: str) -> str:
    return show_quantity(value, unit) if isinstance(value, (int, float)) else str(value)


def _first_line(cls: type) -> str:
    return (cls.__doc__ or "").strip().splitlines()[0]


def _described(ship: Any) -> str:
    node = ship.document.root.get("description")
    return getattr(node, "text", "")
