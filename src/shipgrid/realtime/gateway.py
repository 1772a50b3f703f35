"""The gateway: a process beside the one that runs the plant, by which field buses reach it.

It builds the same plan of the same ship, sees what the plant publishes in shared memory, and puts commands there. The
loop that runs the plant never waits for it. It ends when its standard input does.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import pickle
import secrets
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shipgrid.errors import ParameterError, RealTimeError
from shipgrid.realtime.desk import LOST, Desk
from shipgrid.realtime.registers import write_registers
from shipgrid.realtime.shared import SharedArrays
from shipgrid.realtime.udp import UdpServer
from shipgrid.scenarios.case import build
from shipgrid.scenarios.output_folder import REGISTERS
from shipgrid.scenarios.session import Run

WATCH = 5e-3
"""Time [s] between two looks at controllers and at the standard input."""
SWITCH = 2e-4
"""Longest time [s] that one bus keeps the other waiting."""


@dataclass
class Gateway:
    """What is served, and where.

    Parameters
    ----------
    udp, modbus : (str, int), optional
        Address of a host, in numbers, and port; none if left out.
    lost : {"hold", "safe", "local"}
        What is done about the commands of a lost controller (`realtime/desk.py`).
    timeout : float
        Silence [s] after which a controller is lost.
    token : int
        64 bits, without which nobody is heard; drawn if left out.

    Attributes
    ----------
    listening : dict
        Addresses, by bus, once it is started.
    process : Popen
        The gateway's, then.

    Raises
    ------
    ParameterError
        If any of it is none.
    """

    udp: tuple[str, int] | None = None
    modbus: tuple[str, int] | None = None
    lost: str = "hold"
    timeout: float = 0.5
    token: int = field(default_factory=lambda: secrets.randbits(64))
    listening: dict[str, list[Any]] = field(default_factory=dict, init=False)
    process: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.lost not in LOST:
            raise ParameterError(f"nothing is done by the name '{self.lost}', expected {', '.join(LOST)}")
        if not 0.0 < self.timeout < float("inf"):
            raise ParameterError(f"timeout = {self.timeout!r} s is not a positive time")
        if not 0 <= self.token < 2**64:
            raise ParameterError("the token is no number of 64 bits")
        for bus, address in (("udp", self.udp), ("modbus", self.modbus)):
            try:
                if address is not None and not (ipaddress.ip_address(address[0]) and 0 <= address[1] < 65536):
                    raise ValueError
            except ValueError:
                expected = "expected such as ('127.0.0.1', 5005)"
                raise ParameterError(f"{bus} = {address!r} is no address and port, {expected}") from None

    def start(self, shared: SharedArrays, run: Run) -> Callable[[], dict[str, Any]]:
        """Start the process; it listens when this returns. What is returned ends it, and has what it counted.

        Raises
        ------
        RealTimeError
            If it cannot listen there.
        """
        plan = run.plan
        told: dict[str, Any] = {"memory": str(shared.path), "plan": arguments_of_plan(run)}
        told |= {
            "udp": self.udp,
            "modbus": self.modbus,
            "token": self.token,
            "lost": self.lost,
            "timeout": self.timeout,
        }
        if run.folder is not None:
            with (run.folder / REGISTERS).open("w", newline="") as file:
                write_registers(file, plan.network.published, run.ship.commands)
        self.process = process = subprocess.Popen(
            [sys.executable, "-m", "shipgrid.realtime.gateway"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the other process
        )
        assert process.stdin is not None and process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(pickle.dumps(told))
            process.stdin.flush()
        said = json.loads(process.stdout.readline() or '{"problem": "the gateway did not start"}')
        if "problem" in said:
            process.communicate()
            raise RealTimeError(said["problem"])
        self.listening = said
        ending = threading.Event()

        def look_after() -> None:
            process.wait()
            if not ending.is_set():
                pacer = run.work.pace.pacer[0]
                t = (int(pacer.steps) + first) * plan.h
                run.events.append((t, plan.network.name, f"the gateway died ({process.returncode}): commands are held"))

        first = run.work.n
        threading.Thread(target=look_after, name="shipgrid-gateway", daemon=True).start()

        def end() -> dict[str, Any]:
            ending.set()
            counted, _ = process.communicate()
            failure = "" if process.returncode == 0 else f"the gateway died ({process.returncode})"
            found = {"listening": self.listening, "on_loss": self.lost, "failure": failure}
            return {"gateway": found | json.loads(counted or "{}")}

        return end


def arguments_of_plan(run: Run) -> dict[str, Any]:
    """What another process calls `build` with, to have the plan of a run.

    Parameters
    ----------
    run : Run
    """
    plan = run.plan
    parts = dict(plan.partition.buses) if plan.partition else None
    options = {"step": plan.h, "fidelity": plan.network.fidelity, "rules": run.rules, "parts": parts}
    return {"ship": run.ship, **options}


def main() -> None:
    """Read what to serve from the standard input, serve until that ends, and say what was counted."""
    told = pickle.load(sys.stdin.buffer)
    plan = build(**told["plan"])
    desk = Desk(told["plan"]["ship"], plan, SharedArrays(Path(told["memory"])), told["lost"], told["timeout"])
    sys.setswitchinterval(SWITCH)
    udp = modbus = None
    try:
        if told["udp"]:
            udp = UdpServer(desk, told["udp"], told["token"])
        if told["modbus"]:
            from shipgrid.realtime.modbus import ModbusServer  # needs a package that not everybody has

            modbus = ModbusServer(desk, told["modbus"], told["token"])
    except OSError as wrong:
        print(json.dumps({"problem": f"the gateway cannot listen: {wrong}"}), flush=True)
        return
    except ImportError as wrong:
        print(json.dumps({"problem": f"Modbus needs pymodbus, pip install 'shipgrid[io]': {wrong}"}), flush=True)
        return
    buses = {"udp": udp, "modbus": modbus}
    print(json.dumps({name: bus.address for name, bus in buses.items() if bus is not None}), flush=True)
    watched = time.monotonic()
    while True:
        if udp is not None:
            udp.serve(WATCH)
        else:
            time.sleep(WATCH)
        if time.monotonic() - watched >= WATCH:
            watched = time.monotonic()
            with desk.busy:
                desk.look()
                desk.watch()
            if select.select([sys.stdin], [], [], 0.0)[0]:
                break
    if modbus is not None:
        modbus.close()
    print(json.dumps(dict(desk.counted)), flush=True)


if __name__ == "__main__":
    main()
