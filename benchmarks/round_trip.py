"""How long a controller's answer takes beside a live run: measurement -> UDP controller -> command, and a Modbus write.

    python benchmarks/round_trip.py [SECONDS]

UDP, in steps: from the step that was measured to the one that obeys the answer, as the run itself has them. The
controller answers every packet of measurements at once, with a set point that changes each time. Where the machine has
fewer free cores than processes the loop stands still while they work, and fewer steps pass than time; so the controller
takes the time from measurements to answer as well. Modbus: from request to answer, when the command lies in the box.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from pymodbus.client import ModbusTcpClient

import shipgrid as sg
from shipgrid.realtime.desk import UDP
from shipgrid.realtime.executive import Executive
from shipgrid.realtime.gateway import Gateway
from shipgrid.realtime.registers import FIRST_COMMAND, TOKEN
from shipgrid.realtime.udp import ANSWER, COMMAND, COMMANDS, HEAD, MEASUREMENTS, packet

H = 30e-6
SHARES = (50, 90, 99)
PATHS = ("propulsion_for.speed_ref", "bess_for.i_ref")
"""One that the interlocks do not judge, and one that they do."""


def percentiles(times_s: list[float]) -> dict[str, float]:
    found = {f"p{share}_us": round(1e6 * float(np.percentile(times_s, share)), 1) for share in SHARES}
    return {"count": len(times_s), **found}


class Trips:
    """Measures while the ship sails, then stops the run."""

    def __init__(self, seconds: float):
        self.seconds, self.found = seconds, {}
        self.gateway = Gateway(udp=("127.0.0.1", 0), modbus=("127.0.0.1", 0))
        self.executive = Executive(attached=self.attached)

    def attached(self, shared, run):
        """Begin with the run."""
        end = self.gateway.start(shared, run)
        self.arrays, self.names = shared.arrays, list(run.ship.commands)

        def measure():
            try:
                time.sleep(1.0)
                for path in PATHS:
                    self.found[f"UDP, {path}"] = self.udp(path)
                self.found["Modbus write"] = self.modbus()
            finally:
                self.executive.stop()

        hand = threading.Thread(target=measure)
        hand.start()
        return lambda: (hand.join(), end())[1]

    def udp(self, path: str) -> dict[str, dict[str, float]]:
        """Let a process of its own answer, and look at what the loop has taken."""
        taken = int(self.arrays["applied_count"][0])
        host, port = self.gateway.listening["udp"]
        number, words = str(self.names.index(path)), (host, str(port), str(self.gateway.token))
        child = subprocess.Popen(
            [sys.executable, __file__, "--answer", *words, number, str(self.seconds)], stdout=subprocess.PIPE
        )
        steps, end = [], time.monotonic() + self.seconds + 3.0
        while time.monotonic() < end:
            applied, count = self.arrays["applied"], int(self.arrays["applied_count"][0])
            for k in range(taken, count):
                entry = applied[k % len(applied)]
                if entry.origin == UDP and entry.measured > 0:
                    steps.append(int(entry.step) - int(entry.measured))
            taken = count
            time.sleep(0.05)
        said, _ = child.communicate()
        return {"steps": percentiles([H * n for n in steps]), "on the wire": json.loads(said)}

    def modbus(self) -> dict[str, float]:
        """Write one command again and again."""
        host, port = self.gateway.listening["modbus"]
        address, times, end = FIRST_COMMAND + 2 * self.names.index(PATHS[0]), [], time.monotonic() + self.seconds
        with ModbusTcpClient(host, port=port) as client:
            client.write_registers(TOKEN, list(struct.unpack(">4H", self.gateway.token.to_bytes(8, "big"))))
            while time.monotonic() < end:
                words = struct.unpack(">2H", struct.pack(">f", 1e-3 * (len(times) % 100)))
                begun = time.perf_counter()
                wrong = client.write_registers(address, list(words)).isError()
                times.append(time.perf_counter() - begun)
                if wrong:
                    raise RuntimeError("a write was not obeyed")
                time.sleep(1e-3)
        return percentiles(times)


def answer(host: str, port: str, token: str, number: str, seconds: str) -> None:
    """Be the controller."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.connect((host, int(port)))
        one.settimeout(1.0)
        times, begun, sequence = [], 0.0, 1
        end, session = time.monotonic() + float(seconds), os.getpid()
        one.send(packet(COMMANDS, session, sequence, int(token), 0, 0.0, 0, b""))
        while time.monotonic() < end:
            data = one.recv(65535)
            if data[5] == ANSWER and begun:
                times.append(time.perf_counter() - begun)
            if data[5] == MEASUREMENTS:
                begun = time.perf_counter()
                sequence += 1
                step = HEAD.unpack_from(data)[7]
                body = COMMAND.pack(int(number), 1e-3 * (sequence % 100))
                one.send(packet(COMMANDS, session, sequence, int(token), step, 0.0, 1, body))
    print(json.dumps(percentiles(times)))


def main() -> None:
    trips = Trips(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0)
    with tempfile.TemporaryDirectory() as folder:
        run = sg.simulate(
            sg.load_ship("ferry"),
            sg.load_scenario("mission"),
            step=H,
            out=Path(folder) / "run",
            report=False,
            live=trips.executive,
        )
        realtime = run.summary["realtime"]
        run.close()
    print(json.dumps(trips.found, indent=2))
    print(realtime["verdict"])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--answer"]:
        answer(*sys.argv[2:])
    else:
        main()
