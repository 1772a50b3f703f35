"""Commands that a live run was given from outside while it ran: a file of lines `step,path,value,origin`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from shipgrid.errors import InputErrors


class Outside(NamedTuple):
    """A command from outside: the number of steps done before it, path, value and whose it is."""

    step: int
    path: str
    value: float
    origin: str


def in_range(command: Any, value: float) -> bool:
    """Whether a command of a ship takes a value (SI; the code of a word); nothing takes what is not a number."""
    return command.low <= value <= command.high and (command.words is None or value in command.words.values())


def read_outside(path: Path, commands: Mapping[str, Any], *, torn: bool = False) -> list[Outside]:
    """Commands that a live run was given while it ran, in their order.

    Parameters
    ----------
    path : Path
        Its `commands.csv`.
    commands : mapping of str to Command
        What the ship takes, by path.
    torn : bool
        Whether the last line may be half: of a run that was killed.

    Raises
    ------
    OSError
        If it cannot be read.
    InputErrors
        With every line that is none, or no command that the ship would take.
    """
    lines = path.read_text(errors="replace").split("\n")
    found, problems = [], []
    for number, line in enumerate(lines[:-1] if torn else lines, 1):
        if not line.strip():
            continue
        try:
            step, name, value, origin = line.split(",")
            given = Outside(int(step), name, float(value), origin)
        except ValueError:
            problems.append(f"{path}:{number}: is no command, expected step,path,value,origin")
            continue
        command = commands.get(name)
        if command is None:
            problems.append(f"{path}:{number}: {name}: the ship has no such command")
        elif not in_range(command, given.value):
            problems.append(f"{path}:{number}: {name}: {value} is out of range, expected {range_text(command)}")
        elif given.step < 0:
            problems.append(f"{path}:{number}: {name}: step {step} is before the start, expected 0 or more")
        found.append(given)
    if problems:
        raise InputErrors(problems)
    return sorted(found, key=lambda command: command.step)


def range_text(command: Any) -> str:
    """The numbers that a command takes, in words."""
    if command.words is not None:
        return " or ".join(f"{code:g} ({word})" for word, code in command.words.items())
    unit = "" if command.unit == "1" else f" {command.unit}"
    return f"{command.low:g} .. {command.high:g}{unit} ({command.description})"


def merged_commands(*lists: Iterable[Outside]) -> list[Outside]:
    """Commands of several lists in order of their steps; what stands in an earlier list too is there once."""
    found: list[Outside] = []
    for commands in lists:
        known = set(found)
        found += [command for command in commands if command not in known]
    return sorted(found, key=lambda command: command.step)


def as_lines(commands: Iterable[Outside]) -> str:
    """Text of such a file."""
    return "".join(f"{step},{path},{value!r},{origin}\n" for step, path, value, origin in commands)
