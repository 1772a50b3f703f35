"""The list of registers: numbers in UDP packets and addresses in Modbus, of everything a ship shows and can be told.

It is made of the ship's public signals and commands, in their order. A rule of a scenario may add signals behind them,
so that a live run writes its own list into its folder.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TextIO

from shipgrid.equipment.declaration import Command
from shipgrid.realtime.desk import ANSWERS

STEP, TIME, FIRST_SIGNAL = 0, 4, 8
"""Addresses of input registers."""
TOKEN, ANSWER, HEARTBEAT, FIRST_COMMAND = 0, 4, 5, 8
"""Addresses of holding registers."""
WIDE, FLOAT = 4, 2
"""Registers of a number of 64 bits, and of a float32."""
NO_ANSWER = 65535
"""What the answer is before the first command."""


class Register(NamedTuple):
    """One line of the list."""

    name: str
    what: str  # measurement, command, or what belongs to the bus
    udp: int | None  # its number in packets
    table: str  # of Modbus: input or holding
    address: int
    registers: int  # how many
    unit: str
    takes: str
    meaning: str


def registers(signals: Mapping[str, Any], commands: Mapping[str, Command]) -> Iterator[Register]:
    """The list.

    Parameters
    ----------
    signals : mapping of str to PublicSignal or Published
        By name, with `unit` and `description`.
    commands : mapping of str to Command
        By path.
    """
    answers = ", ".join(f"{code} {text}" for code, text in enumerate(ANSWERS))
    yield Register("step", "bus", None, "input", STEP, WIDE, "1", "uint64", "steps done")
    yield Register("time", "bus", None, "input", TIME, WIDE, "s", "float64", "time")
    for k, (name, signal) in enumerate(signals.items()):
        address = FIRST_SIGNAL + FLOAT * k
        yield Register(name, "measurement", k, "input", address, FLOAT, signal.unit, "float32", signal.description)
    meaning = "of the run; to be written, in one request, before commands are obeyed"
    yield Register("token", "bus", None, "holding", TOKEN, WIDE, "1", "uint64", meaning)
    meaning = f"to the last command of this connection: {answers}, {NO_ANSWER} none yet"
    yield Register("answer", "bus", None, "holding", ANSWER, 1, "1", "read only", meaning)
    yield Register("heartbeat", "bus", None, "holding", HEARTBEAT, 1, "1", "anything", "a sign of life")
    for k, (path, command) in enumerate(commands.items()):
        address = FIRST_COMMAND + FLOAT * k
        yield Register(
            path, "command", k, "holding", address, FLOAT, command.unit, _takes(command), command.description
        )


def write_registers(file: TextIO, signals: Mapping[str, Any], commands: Mapping[str, Command]) -> None:
    """Write the list as comma-separated values, with a line of heads.

    Parameters
    ----------
    file : TextIO
    signals, commands : mapping
        As of `registers`.
    """
    writer = csv.writer(file)
    writer.writerow(Register._fields)
    writer.writerows(registers(signals, commands))


def _takes(command: Command) -> str:
    if command.words is not None:
        return ", ".join(f"{code:g} {word}" for word, code in command.words.items())
    return f"{command.low:.6g} .. {command.high:.6g}"
