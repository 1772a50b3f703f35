"""A controller of the ferry's power plant: a program of its own, that sees and commands the ship by UDP only.

It does what the mission's time-line does about sources, from measurements: it starts a genset when the load or a low
battery asks for one, charges the batteries once the genset is connected, lets the batteries take over when it is needed
no longer, and stops it. Course and speed are the bridge's.

It remembers nothing: what it commands follows from the last measurement, so that it can be killed and started again at
any moment. It sends all its commands ten times a second, which is its sign of life too; repeated ones change nothing.
While nothing is heard from the ship it goes on asking.

    shipgrid list registers --csv > registers.csv
    SHIPGRID_TOKEN=0123456789abcdef shipgrid live mission --udp 127.0.0.1:5005
    SHIPGRID_TOKEN=0123456789abcdef python power_management.py 127.0.0.1:5005 --registers registers.csv

The layout of packets is that of docs/how-to/hardware_in_the_loop.md; only the standard library is needed.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import secrets
import socket
import struct
import sys
import time

HEAD = struct.Struct("<4sBBHIIQQd")
COMMAND = struct.Struct("<Hd")
MAGIC, VERSION = b"SHGR", 1
MEASUREMENTS, COMMANDS, ANSWER = 1, 2, 3
ANSWERS = ("obeyed", "no such command", "out of range", "refused by the interlocks", "too many at once")

PERIOD = 0.1
"""Time [s] between two packets of commands."""
SILENCE = 1.0
"""Time [s] without a measurement after which the ship counts as lost."""
HIGH, LOW = 100e3, 60e3
"""Load [W] above which a genset is started, and below which it may stop: the ferry takes 165 kW at 10 kn, 50 at 6."""
CHARGE, CRUISE = -128.0, 40.0
"""Set points of the batteries [A]: with a genset, and without one under way."""
UNDER_WAY = 5e3
"""Power of the drives [W] above which the ship is under way."""
CONNECTED = 0.1
"""Modulation of a rectifier above which it is connected."""


class Ship:
    """What the ship shows and takes, by name, over UDP."""

    def __init__(self, address: tuple[str, int], token: int, registers: str):
        with open(registers, newline="") as file:
            lines = [line for line in csv.DictReader(file) if line["udp"]]
        self.signals = [line["name"] for line in lines if line["what"] == "measurement"]
        self.numbers = {line["name"]: int(line["udp"]) for line in lines if line["what"] == "command"}
        self.token, self.session, self.sequence = token, secrets.randbits(32), 0
        self.socket = socket.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(address)
        self.plant = self.newest = self.step = 0
        self.sent: dict[int, list[str]] = {}

    def listen(self, seconds: float) -> dict[str, float] | None:
        """The newest measurements, waiting for them at most some time; None if nothing has come."""
        end, found = time.monotonic() + seconds, None
        while found is None and (left := end - time.monotonic()) > 0.0:
            self.socket.settimeout(left)
            try:
                found = self._read(self.socket.recv(65535))
            except TimeoutError:
                break
            except OSError:  # nobody is there yet
                time.sleep(min(PERIOD, left))
        return found

    def _read(self, data: bytes) -> dict[str, float] | None:
        if len(data) < HEAD.size:
            return None
        magic, version, kind, count, session, sequence, _, step, _ = HEAD.unpack_from(data)
        if (magic, version) != (MAGIC, VERSION):
            return None
        if kind == ANSWER and len(data) == HEAD.size + count:
            for name, code in zip(self.sent.pop(sequence, []), data[HEAD.size :], strict=False):
                if code:
                    print(f"{name}: {ANSWERS[code] if code < len(ANSWERS) else code}", flush=True)
            return None
        if kind != MEASUREMENTS or count != len(self.signals) or len(data) != HEAD.size + 8 * count:
            return None
        if session == self.plant and sequence <= self.newest:
            return None  # overtaken on its way
        self.plant, self.newest, self.step = session, sequence, step
        return dict(zip(self.signals, struct.unpack_from(f"<{count}d", data, HEAD.size), strict=True))

    def command(self, commands: dict[str, float]) -> None:
        """Give commands, or a sign of life where there are none."""
        self.sequence += 1
        self.sent = {self.sequence: list(commands)}
        head = HEAD.pack(
            MAGIC, VERSION, COMMANDS, len(commands), self.session, self.sequence, self.token, self.step, 0.0
        )
        body = b"".join(COMMAND.pack(self.numbers[name], value) for name, value in commands.items())
        with contextlib.suppress(OSError):  # nobody is there yet
            self.socket.send(head + body)


def decide(now: dict[str, float], below: float, until: float) -> dict[str, float]:
    """What to command, from measurements alone."""
    sides = ("for", "aft")
    drives = sum(now[f"propulsion_{side}.p_dc"] for side in sides)
    load = drives + sum(now[f"inverter_{side}.p_dc"] for side in sides)
    soc = min(now[f"bess_{side}.soc"] for side in sides)
    running = [side for side in sides if now[f"genset_{side}.on"] > 0.5]
    connected = [side for side in running if now[f"rectifier_{side}.modulation"] > CONNECTED]
    side = running[0] if running else ("for" if now["hull.u_ship"] >= 0.0 else "aft")

    needed = (load > LOW or soc < until) if running else (load > HIGH or soc < below)
    commands = {}
    if needed:
        commands[f"genset_{side}.on"] = 1.0
        current = CHARGE if connected else CRUISE
    else:
        current = CRUISE if running or drives > UNDER_WAY else 0.0
        if running and all(now[f"bess_{end}.i_b"] > 0.0 for end in sides):  # the batteries have taken over
            commands[f"genset_{side}.on"] = 0.0
    return commands | {f"bess_{side}.i_ref": current for side in sides}


def main() -> None:
    """Command the ship until killed."""
    parser = argparse.ArgumentParser(description="Runs the ferry's sources by UDP.")
    parser.add_argument("address", help="HOST:PORT of the gateway")
    parser.add_argument("--registers", default="registers.csv", help="the list of registers")
    parser.add_argument("--below", type=float, default=0.3, help="state of charge that starts a genset")
    parser.add_argument("--until", type=float, default=0.6, help="state of charge up to which it charges")
    asked = parser.parse_args()
    host, _, port = asked.address.rpartition(":")
    try:
        token = int(os.environ["SHIPGRID_TOKEN"], 16)
        ship = Ship((host.strip("[]"), int(port)), token, asked.registers)
    except (KeyError, ValueError, OSError) as wrong:
        sys.exit(f"cannot begin ({wrong!r}): address, --registers and SHIPGRID_TOKEN are needed")
    print("asking", flush=True)
    ship.command({})
    heard, sent, commands, there = time.monotonic(), time.monotonic(), {}, False
    while True:
        measured, now = ship.listen(PERIOD), time.monotonic()
        new = commands
        if measured is not None:
            heard = now
            if not there:
                there = True
                print(f"the ship is there, at step {ship.step}", flush=True)
            new = decide(measured, asked.below, asked.until)
        elif there and now - heard > SILENCE:
            there, new = False, {}
            print("the ship is lost", flush=True)
        for name in new:
            if new[name] != commands.get(name):
                print(f"{name} = {new[name]:g}", flush=True)
        if new != commands or now - sent >= PERIOD:
            ship.command(new)
            sent = now
        commands = new


if __name__ == "__main__":
    main()
