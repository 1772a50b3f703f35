"""The gateway: a process beside the one that runs the plant, by which field buses reach it.

It builds the same plan of the same ship, sees what the plant publishes in shared memory, and puts commands there. The
loop that runs the plant never waits for it. It ends when its standard input does.
"""

from __future__ import annotations

import json
import pickle
import secrets
import select
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shipgrid.errors import ParameterError, RealTimeError
from shipgrid.realtime.desk import LOST, Desk
from shipgrid.realtime.shared import SharedArrays
from shipgrid.realtime.udp import UdpServer
from shipgrid.scenarios.runner import Run, build

WATCH = 5e-3
"""Time [s] between two looks at controllers and at the standard input."""


@dataclass
class Gateway:
    """What is served, and where.

    Parameters
    ----------
    udp, modbus : (str, int), optional
        Host and port; none if left out.
    lost : {"hold", "safe", "local"}
        What is done about the commands of a lost controller (`realtime/desk.py`).
    timeout : float
        Silence [s] after which a controller is lost.
    token : int
        64 bits, without which nobody is heard; drawn if left out.
    """

    udp: tuple[str, int] | None = None
    modbus: tuple[str, int] | None = None
    lost: str = "hold"
    timeout: float = 0.5
    token: int = field(default_factory=lambda: secrets.randbits(64))
    listening: dict[str, list[Any]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if self.lost not in LOST:
            raise ParameterError(f"nothing is done by the name '{self.lost}', expected {', '.join(LOST)}")
        if not 0.0 < self.timeout < float("inf"):
            raise ParameterError(f"timeout = {self.timeout!r} s is not a positive time")

    def start(self, shared: SharedArrays, run: Run) -> Callable[[], dict[str, Any]]:
        """Start the process; it listens when this returns. What is returned ends it, and has what it counted.

        Raises
        ------
        RealTimeError
            If it cannot listen there.
        """
        plan = run.plan
        told = {
            "memory": str(shared.path),
            "ship": run.ship,
            "rules": run.rules,
            "step": plan.h,
            "fidelity": plan.network.fidelity,
        }
        told |= {
            "udp": self.udp,
            "modbus": self.modbus,
            "token": self.token,
            "lost": self.lost,
            "timeout": self.timeout,
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "shipgrid.realtime.gateway"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the other process
        )
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(pickle.dumps(told))
        process.stdin.flush()
        said = json.loads(process.stdout.readline() or '{"problem": "the gateway did not start"}')
        if "problem" in said:
            process.communicate()
            raise RealTimeError(said["problem"])
        self.listening = said

        def end() -> dict[str, Any]:
            counted, _ = process.communicate()
            return {"gateway": {"listening": self.listening, "on_loss": self.lost} | json.loads(counted or "{}")}

        return end


def main() -> None:
    """Read what to serve from the standard input, serve until that ends, and say what was counted."""
    told = pickle.load(sys.stdin.buffer)
    plan = build(told["ship"], told["step"], told["fidelity"], told["rules"])
    desk = Desk(told["ship"], plan, SharedArrays(Path(told["memory"])), told["lost"], told["timeout"])
    try:
        udp = UdpServer(desk, told["udp"], told["token"]) if told["udp"] else None
    except OSError as wrong:
        print(json.dumps({"problem": f"the gateway cannot listen: {wrong}"}), flush=True)
        return
    print(json.dumps({"udp": udp.address} if udp else {}), flush=True)
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
    print(json.dumps(dict(desk.counted)), flush=True)


if __name__ == "__main__":
    main()
