"""Commands that a live run was given from outside while it ran: a file of lines `step,path,value,origin`."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

COMMANDS = "commands.csv"
"""Name of that file in the folder of the run."""


class Outside(NamedTuple):
    """A command from outside: the number of steps done before it, path, value and whose it is."""

    step: int
    path: str
    value: float
    origin: str


def read_outside(path: Path) -> list[Outside]:
    """Commands that a live run was given while it ran, in their order.

    Parameters
    ----------
    path : Path
        Its `commands.csv`.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is damaged.
    """
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1].splitlines()  # of a killed run the last line may be half
    given = [Outside(int(step), name, float(value), origin) for step, name, value, origin in csv.reader(whole)]
    return sorted(dict.fromkeys(given), key=lambda command: command.step)


def as_lines(commands: Iterable[Outside]) -> str:
    """Text of such a file."""
    return "".join(f"{step},{path},{value!r},{origin}\n" for step, path, value, origin in commands)
