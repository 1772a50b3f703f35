"""Live runs with a gateway: a controller that is killed and started again, abuse that changes nothing, a gateway that
is killed. The ship keeps sailing; what time it is on the wall is never asked."""

from __future__ import annotations

import csv
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from scenarios.killed_runs import case, simulate, started
from scenarios.test_resume import recorded, same
from shipgrid.errors import RealTimeError
from shipgrid.realtime.executive import Executive
from shipgrid.realtime.gateway import Gateway
from shipgrid.realtime.registers import registers
from shipgrid.realtime.udp import COMMAND, COMMANDS, packet
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import REGISTERS, foreign
from shipgrid.scenarios.outside import read_outside

CONTROLLER = Path(__file__).parents[2] / "examples" / "controllers" / "power_management.py"
TOKEN = 0x0123_4567_89AB_CDEF
ANYWHERE = ("127.0.0.1", 0)
HURRY = 1000.0
FIND_START = simulation.start

LOW = """\
schema: 1
scenario: low batteries
description: nobody starts a genset but a controller
duration: 600 s
step: 70 us
start: {state: moored, closed: [dc_tie], soc: {bess_for: 40 %, bess_aft: 40 %}}
timeline:
  - {at: 0.1 s, set: {propulsion_for.speed_ref: 3 kn, propulsion_aft.speed_ref: 3 kn}}
"""


class Attached:
    """A gateway, and a hand that does something while the ship sails; what goes wrong in the hand fails the test."""

    def __init__(self, gateway, act):
        self.gateway, self.act, self.wrong = gateway, act, None

    def __call__(self, shared, run):
        end = self.gateway.start(shared, run)
        self.shared, self.run = shared, run

        def hand():
            try:
                self.act(self)
            except BaseException as wrong:
                self.wrong = wrong

        thread = threading.Thread(target=hand)
        thread.start()

        def detach():
            thread.join()
            return end()

        return detach

    @property
    def steps(self):
        return int(self.run.work.pace.pacer[0].steps)

    def sail(self, steps):
        """Until so many more steps are done."""
        first = self.steps
        self.wait(lambda: self.steps >= first + steps)

    def command(self, path):
        return float(self.run.work.sig[self.run.plan.layout.index[f"command:{path}"]])

    @staticmethod
    def wait(until, most=120.0):
        end = time.monotonic() + most
        while not until():
            assert time.monotonic() < end, "it never came"
            time.sleep(2e-3)


def controller(attached, *words):
    host, port = attached.gateway.listening["udp"]
    list_ = attached.run.folder / REGISTERS
    words = (sys.executable, str(CONTROLLER), f"{host}:{port}", "--registers", str(list_), *words)
    return subprocess.Popen(words, env={**os.environ, "SHIPGRID_TOKEN": f"{TOKEN:016x}"}, stdout=subprocess.DEVNULL)


def test_the_ship_keeps_sailing_while_its_controller_is_killed_and_started_again(tmp_path):
    executive = Executive(HURRY)

    def act(attached):
        first = controller(attached, "--below", "0.45", "--until", "0.9")
        try:
            attached.wait(lambda: attached.command("bess_aft.i_ref") == -128.0)  # the genset is connected
        finally:
            first.kill()
            first.wait()
        attached.sail(5_000)
        assert attached.command("bess_aft.i_ref") == -128.0 and attached.command("genset_for.on") == 1.0  # held
        second = controller(attached, "--below", "0.2", "--until", "0.3")  # the genset is not needed, it finds
        try:
            attached.wait(lambda: attached.command("genset_for.on") == 0.0)
        finally:
            second.kill()
            second.wait()
        attached.sail(1_000)
        executive.stop()

    executive.attached = attached = Attached(Gateway(udp=ANYWHERE, token=TOKEN), act)
    results = simulate(tmp_path / "run", made_of=case(scenario=LOW), waveforms=[], live=executive)
    assert attached.wrong is None, attached.wrong
    assert results.summary["interrupted"]
    given = [(c.path, c.value, c.origin) for c in read_outside(tmp_path / "run" / "commands.csv", case()[0].commands)]
    turns = [("genset_for.on", 1.0, "UDP"), ("bess_for.i_ref", -128.0, "UDP")]
    turns += [("bess_for.i_ref", 40.0, "UDP"), ("genset_for.on", 0.0, "UDP")]
    places = [len(given) - 1 - given[::-1].index(turn) for turn in turns]
    assert places == sorted(places)
    assert {origin for _, _, origin in given} == {"UDP"}
    found = results.summary["realtime"]["gateway"]
    assert (found["sessions"], found["failure"]) == (2, "")
    assert "set to -128 A, by UDP" in [event.text for event in results.events]
    with (tmp_path / "run" / REGISTERS).open() as file:
        lines = list(csv.DictReader(file))
    ship = case()[0]
    assert [line["name"] for line in lines] == [line.name for line in registers(ship.signals, ship.commands)]
    assert foreign(tmp_path / "run") == []


@pytest.fixture(scope="module")
def start():
    """The start of the short scenario is found once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", started())
        yield


@pytest.fixture(scope="module")
def alone(start, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "alone"
    simulate(folder)
    return folder


def abuse(attached):
    """Everything that must not be obeyed, on both buses."""
    dice = random.Random(3)
    address = tuple(attached.gateway.listening["udp"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        for k in range(1000):
            one.sendto(dice.randbytes(dice.randrange(300)), address)
            if k % 10 == 0:
                body = COMMAND.pack(dice.randrange(29), 0.0)
                one.sendto(packet(COMMANDS, 1, k + 1, dice.randrange(2**64), 0, 0.0, 1, body), address)
                time.sleep(1e-3)
        bad = b"".join(COMMAND.pack(number, value) for number in range(40) for value in (float("nan"), 1e9))[:640]
        one.sendto(packet(COMMANDS, 1, 1, TOKEN, 0, 0.0, 64, bad), address)
    place = tuple(attached.gateway.listening["modbus"])
    for _ in range(100):
        with socket.create_connection(place) as one:
            one.sendall(dice.randbytes(40))
    held = [socket.create_connection(place) for _ in range(40)]
    with ModbusTcpClient(place[0], port=place[1], timeout=20.0) as client:
        assert client.write_registers(8, [0x3F80, 0]).isError()
        assert client.write_registers(0, [1, 2, 3, 4]).isError()
    for one in held:
        one.close()


def test_abuse_of_the_gateway_changes_no_bit_and_is_counted(alone, tmp_path):
    attached = Attached(Gateway(udp=ANYWHERE, modbus=ANYWHERE, token=TOKEN), abuse)
    results = simulate(tmp_path / "abused", live=Executive(0.5, attached=attached))
    assert attached.wrong is None, attached.wrong
    assert same(tmp_path / "abused", alone)
    assert not (tmp_path / "abused" / "commands.csv").exists()
    found = results.summary["realtime"]["gateway"]
    heard = found["packets malformed"] + found["packets with a wrong token"]
    assert found["packets"] >= heard + 1 and heard > 900  # a system with no time for them drops some
    assert found["commands out of range"] + found["commands no such command"] == 64
    assert (found["Modbus wrong tokens"], found["Modbus writes without a token"]) == (1, 1)
    assert found["Modbus connections"] == 141
    assert "commands obeyed" not in found


@pytest.mark.full
def test_a_commanded_run_at_switching_fidelity_and_its_windows_are_repeated_offline(tmp_path, monkeypatch):
    monkeypatch.setattr(simulation, "start", FIND_START)
    names = list(case()[0].commands)

    def act(attached):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.connect(tuple(attached.gateway.listening["udp"]))
            for sequence, (path, value) in enumerate([("bess_for.i_ref", 30.0), ("genset_for.on", 1.0)], 1):
                attached.sail(7_000)  # 0.2 s
                body = COMMAND.pack(names.index(path), value)
                one.send(packet(COMMANDS, 1, sequence, TOKEN, 0, 0.0, 1, body))
                attached.wait(lambda path=path, value=value: attached.command(path) == value)

    attached = Attached(Gateway(udp=ANYWHERE, token=TOKEN), act)
    how = {"fidelity": "switching", "step": 30e-6, "until": 0.8, "waveforms": [(0.0, 0.05), (0.15, 0.35)]}
    simulate(tmp_path / "live", live=Executive(1.0, attached=attached), **how)
    assert attached.wrong is None, attached.wrong
    given = read_outside(tmp_path / "live" / "commands.csv", case()[0].commands)
    assert [(c.path, c.value, c.origin) for c in given] == [
        ("bess_for.i_ref", 30.0, "UDP"),
        ("genset_for.on", 1.0, "UDP"),
    ]
    assert 0.15 < given[0].step * 30e-6 < 0.35  # within a window
    simulate(tmp_path / "again", outside=given, **how)
    assert same(tmp_path / "live", tmp_path / "again")


def test_a_gateway_that_is_killed_hurts_nobody(alone, tmp_path):
    def act(attached):
        attached.sail(100)
        os.kill(attached.gateway.process.pid, signal.SIGKILL)

    attached = Attached(Gateway(udp=ANYWHERE, modbus=ANYWHERE, token=TOKEN), act)
    results = simulate(tmp_path / "killed", live=Executive(1.0, attached=attached))
    assert attached.wrong is None, attached.wrong
    assert results.summary["realtime"]["gateway"]["failure"] == "the gateway died (-9)"
    assert "the gateway died (-9): commands are held" in recorded(tmp_path / "killed")["events/text"].tolist()
    whole, found = recorded(alone), recorded(tmp_path / "killed")
    assert all((whole[name] == found[name]).all() for name in whole if name.startswith("plant/"))


def test_a_gateway_that_cannot_listen_says_so(start, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
        taken.bind(ANYWHERE)
        taken.listen()
        gateway = Gateway(modbus=taken.getsockname(), token=TOKEN)
        with pytest.raises(RealTimeError, match="the gateway cannot listen"):
            simulate(tmp_path / "run", live=Executive(HURRY, attached=gateway.start))
