"""The buses before a plant that stands still: what is malformed, false or out of range is counted and never obeyed."""

from __future__ import annotations

import pickle
import random
import socket
import struct
import time

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException

import shipgrid as sg
from realtime.test_desk import Hand, ferry  # noqa: F401
from shipgrid.assembly.workspace import new_workspace
from shipgrid.realtime import modbus, registers, udp
from shipgrid.realtime.desk import MODBUS, NO_TOKEN, OBEYED, OUT_OF_RANGE, REFUSED, UNKNOWN
from shipgrid.realtime.gateway import arguments_of_plan
from shipgrid.realtime.modbus import ModbusServer
from shipgrid.realtime.udp import ANSWER, COMMAND, COMMANDS, HEAD, MEASUREMENTS, UdpServer, packet
from shipgrid.scenarios.case import build
from shipgrid.scenarios.session import Run

TOKEN = 0x0123_4567_89AB_CDEF
HOST = "127.0.0.1"


class Bus:
    """A UDP server that is served by hand, and a controller."""

    def __init__(self, ferry):  # noqa: F811
        self.hand = Hand(ferry)
        self.server = UdpServer(self.hand.desk, (HOST, 0), TOKEN)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(10.0)
        self.socket.connect(self.server.address)
        self.names = list(self.hand.desk.commands)

    def send(self, *data):
        """Send packets and have all of them read."""
        read = self.hand.desk.counted["packets"]
        for one in data:
            self.socket.send(one)
            while self.hand.desk.counted["packets"] == read:
                self.server.serve(0.1)
            read += 1

    def commands(self, *asked, sequence=1, session=7, token=TOKEN, step=0):
        body = b"".join(COMMAND.pack(self.names.index(path), value) for path, value in asked)
        return packet(COMMANDS, session, sequence, token, step, 0.0, len(asked), body)

    def heard(self, kind):
        while True:
            data = self.socket.recv(65535)
            if data[5] == kind:
                return HEAD.unpack_from(data), data[HEAD.size :]

    @property
    def obeyed(self):
        return int(self.hand.plant.arrays["inbox_count"][0])


@pytest.fixture
def bus(ferry):  # noqa: F811
    made = Bus(ferry)
    yield made
    made.socket.close()
    made.server.socket.close()


def test_a_controller_gets_answers_and_measurements(bus):
    bus.send(bus.commands(("bess_for.i_ref", 30.0), ("bess_for.i_ref", 1e9), sequence=5))
    head, codes = bus.heard(ANSWER)
    assert (head[5], list(codes)) == (5, [OBEYED, OUT_OF_RANGE])
    time.sleep(udp.PERIOD)
    bus.server.serve(0.0)
    head, body = bus.heard(MEASUREMENTS)
    assert head[3] == len(bus.hand.desk.signals) == len(body) // 8
    assert np.array_equal(np.frombuffer(body), bus.hand.desk.measured())


def test_a_thousand_malformed_packets_are_counted_and_none_is_obeyed(bus):
    dice = random.Random(5)
    good = bus.commands(("bess_for.i_ref", 30.0), ("propulsion_for.speed_ref", 1.0))
    bad = []
    while len(bad) < 1000:
        data = bytearray(good)
        what = dice.randrange(5)
        if what == 0:
            data = bytearray(dice.randbytes(dice.randrange(200)))
        elif what == 1:
            data = data[: dice.randrange(len(data))]
        elif what == 2:
            data += dice.randbytes(dice.randrange(1, 50))
        elif what == 3:
            data[dice.randrange(6)] ^= 1 << dice.randrange(8)  # magic, version, kind
        else:
            data[6:8] = struct.pack("<H", dice.choice([0, 1, 3, 64, 65, 65535]))
        bad.append(bytes(data))
    bus.send(*bad)
    counted = bus.hand.desk.counted
    assert (counted["packets"], counted["packets malformed"], bus.obeyed) == (1000, 1000, 0)
    assert bus.server.peer is None
    bus.send(good)
    assert bus.obeyed == 2


def test_wrong_tokens_are_counted_and_learn_nothing(bus):
    tokens = [0, TOKEN + 1, TOKEN ^ 1 << 63, 2**64 - 1, int.from_bytes(TOKEN.to_bytes(8, "little"), "big")]
    bus.send(*(bus.commands(("bess_for.i_ref", 30.0), token=token) for token in tokens))
    assert (bus.hand.desk.counted["packets with a wrong token"], bus.obeyed, bus.server.peer) == (5, 0, None)
    bus.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        bus.socket.recv(100)


def test_what_is_no_number_or_out_of_range_is_not_obeyed(bus):
    values = [np.nan, np.inf, -np.inf, 1e308, -193.0, 192.0000001]
    bus.send(*(bus.commands(("bess_for.i_ref", value), sequence=k + 1) for k, value in enumerate(values)))
    beyond = struct.pack("<Hd", 60_000, 1.0)
    bus.send(packet(COMMANDS, 7, 99, TOKEN, 2**64 - 1, np.nan, 1, beyond))
    assert bus.obeyed == 0
    assert bus.hand.desk.counted["commands out of range"] == len(values)
    assert bus.hand.desk.counted["commands no such command"] == 1


def test_a_step_that_nobody_has_seen_is_not_believed(bus):
    bus.send(bus.commands(("bess_for.i_ref", 30.0), step=2**64 - 1))
    assert bus.obeyed == 1 and bus.hand.plant.take()[0][3] == 0


def test_passed_sequences_and_passed_sessions_are_late(bus):
    bus.send(
        bus.commands(("bess_for.i_ref", 1.0), sequence=4),
        bus.commands(("bess_for.i_ref", 2.0), sequence=4),
        bus.commands(("bess_for.i_ref", 3.0), sequence=3),
        bus.commands(("bess_for.i_ref", 4.0), sequence=7),
        bus.commands(("bess_for.i_ref", 5.0), sequence=1, session=8),  # started anew
        bus.commands(("bess_for.i_ref", 6.0), sequence=8),  # the old one, held up on its way
    )
    counted = bus.hand.desk.counted
    assert (counted["packets late or twice"], counted["packets missed"], counted["sessions"]) == (3, 2, 2)
    assert [value for _, value, _, _ in bus.hand.plant.take()] == [1.0, 4.0, 5.0]


def test_a_flood_keeps_neither_measurements_nor_the_watch_waiting(bus):
    bus.send(bus.commands(sequence=1))
    for _ in range(200):
        bus.socket.send(b"flood")
    time.sleep(udp.PERIOD)
    before = bus.server.sequence
    bus.server.serve(0.0)  # comes back after a burst, with more to read
    assert bus.hand.desk.counted["packets malformed"] == udp.BURST
    assert bus.server.sequence == before + 1


@pytest.fixture
def field(ferry):  # noqa: F811
    """A Modbus server, and the plant behind it, which takes commands by itself."""
    hand = Hand(ferry)
    server = ModbusServer(hand.desk, (HOST, 0), TOKEN)
    clients = []

    def client(token=None):
        made = ModbusTcpClient(HOST, port=server.address[1], timeout=10.0, retries=0)
        assert made.connect()
        clients.append(made)
        if token is not None:
            assert not write(made, registers.TOKEN, struct.pack(">Q", token)).isError()
        return made

    hand.client, hand.server = client, server
    yield hand
    for one in clients:
        one.close()
    server.close()


def write(client, address, data):
    return client.write_registers(address, list(struct.unpack(f">{len(data) // 2}H", data)))


def address(hand, path):
    return registers.FIRST_COMMAND + 2 * list(hand.desk.commands).index(path)


def set_to(hand, client, path, *values):
    return write(client, address(hand, path), struct.pack(f">{len(values)}f", *values))


def answer(client):
    return client.read_holding_registers(registers.ANSWER, count=1).registers[0]


def test_registers_have_what_the_list_says(field):
    client = field.client()
    field.plant.sig[field.desk.sources] = np.arange(len(field.desk.signals)) * 0.1
    field.plant.take()
    lines = list(registers.registers(dict.fromkeys(field.desk.signals, next(iter(field.desk.commands.values()))), {}))
    for line in lines:
        if line.what == "measurement":
            words = client.read_input_registers(line.address, count=2).registers
            assert struct.unpack(">f", struct.pack(">2H", *words))[0] == np.float32(0.1 * line.udp), line
    head = client.read_input_registers(0, count=8).registers
    assert struct.unpack(">Qd", struct.pack(">8H", *head)) == (field.plant.steps, field.plant.steps * field.desk.h)
    words = client.read_holding_registers(address(field, "bess_for.mode"), count=2).registers
    assert struct.unpack(">f", struct.pack(">2H", *words)) == (1.0,)
    beyond = registers.FIRST_SIGNAL + 2 * len(field.desk.signals)
    assert client.read_input_registers(beyond, count=1).exception_code == 2


def test_a_command_is_obeyed_once_the_token_is_written(field):
    client = field.client()
    assert set_to(field, client, "bess_for.i_ref", 30.0).exception_code == 7
    assert answer(client) == NO_TOKEN
    assert write(client, registers.TOKEN, struct.pack(">Q", TOKEN + 1)).exception_code == 3
    assert set_to(field, client, "bess_for.i_ref", 30.0).exception_code == 7
    assert not write(client, registers.TOKEN, struct.pack(">Q", TOKEN)).isError()
    assert client.read_holding_registers(registers.TOKEN, count=4).registers == [0, 0, 0, 0]
    assert not set_to(field, client, "bess_for.i_ref", 30.0).isError()
    assert answer(client) == OBEYED
    ((_, value, origin, _),) = field.plant.take()
    assert (value, origin) == (30.0, MODBUS)
    assert set_to(field, field.client(), "bess_for.i_ref", 40.0).exception_code == 7  # another connection has none
    counted = field.desk.counted
    assert (counted["Modbus wrong tokens"], counted["Modbus writes without a token"]) == (1, 3)


def test_what_is_not_obeyed_is_an_exception_and_a_count(field):
    client, path = field.client(TOKEN), "bess_for.i_ref"
    for value in (np.nan, np.inf, 193.0, -1e30):
        assert set_to(field, client, path, value).exception_code == 3
    assert answer(client) == OUT_OF_RANGE
    assert client.write_register(address(field, path), 0x4000).exception_code == 2  # half a float
    assert write(client, address(field, path) + 1, bytes(4)).exception_code == 2
    assert answer(client) == UNKNOWN
    assert client.write_register(registers.ANSWER, 1).exception_code == 2
    assert write(client, registers.FIRST_COMMAND + 2 * len(field.desk.commands), bytes(4)).exception_code == 2
    assert client.write_coil(0, True).exception_code == client.read_coils(0, count=1).exception_code == 1
    assert not set_to(field, client, "bess_for.mode", 2.0).isError()
    assert set_to(field, client, "bess_aft.mode", 2.0).exception_code == 7
    assert answer(client) == REFUSED
    assert len(field.plant.take()) == 1
    counted = field.desk.counted
    assert (counted["commands out of range"], counted["commands refused by the interlocks"]) == (4, 1)
    assert {k: counted[f"Modbus exceptions {k}"] for k in (1, 2, 3, 7)} == {1: 2, 2: 4, 3: 4, 7: 1}


def test_commands_side_by_side_are_obeyed_together_or_not_at_all(field):
    client = field.client(TOKEN)
    both = "genset_for.speed_ref"  # then genset_for.v_ref
    assert set_to(field, client, both, 1.02, 9.0).exception_code == 3
    assert field.plant.take() == []
    assert not set_to(field, client, both, 0.95, 1.1).isError()  # the ends of their ranges, as a float32 has them
    assert [value for _, value, _, _ in field.plant.take()] == [0.95, 1.1]


def test_a_heartbeat_is_a_sign_of_life(field):
    client = field.client(TOKEN)
    field.now += 3.0
    assert not client.write_register(registers.HEARTBEAT, 1).isError()
    assert field.desk.controllers[MODBUS].heard == field.now


def test_rubbish_and_floods_of_connections_are_counted_and_leave_the_server_well(field):
    dice = random.Random(6)
    trusted = field.client(TOKEN)
    rubbish = [dice.randbytes(dice.randrange(8, 260)) for _ in range(50)] + [b"\0\1\0\7\0\6\1\3\0\0\0\1"] * 50
    for data in rubbish:
        with socket.create_connection(field.server.address) as one:
            one.sendall(data)
            assert one.recv(1) == b""  # shut out
    held = [socket.create_connection(field.server.address) for _ in range(3 * modbus.MOST)]
    for _ in range(200):  # it hears of them when it comes to them
        if field.desk.counted["Modbus connections"] == 101 + len(held):
            break
        time.sleep(0.01)
    assert field.desk.counted["Modbus connections"] == 101 + len(held)
    assert len(field.server.server.active_connections) <= modbus.MOST
    assert field.desk.counted["Modbus connections closed, too many"] >= 2 * modbus.MOST
    assert field.desk.counted["Modbus requests malformed"] == 100
    assert not set_to(field, trusted, "bess_for.i_ref", 30.0).isError()
    assert len(field.plant.take()) == 1
    for one in held:
        one.close()


def test_one_who_reads_no_answers_is_shut_out(field, monkeypatch):
    client = field.client(TOKEN)
    monkeypatch.setattr(modbus, "UNREAD", -1)  # as if so many answers lay there
    with pytest.raises((ConnectionException, ModbusIOException)):
        set_to(field, client, "bess_for.i_ref", 30.0)
    assert field.desk.counted["Modbus connections closed, answers unread"] == 1
    assert field.plant.take() == []


def test_nothing_listens_where_it_was_not_asked_to(field, bus):
    for address in (field.server.address, bus.server.address):
        assert address[0] == HOST


@pytest.mark.parametrize("parts", [None, "ship"])
def test_the_process_of_the_gateway_has_the_plan_of_the_run(parts):
    """Of a plant in parts the flat vector is another one."""
    case = sg.Case("ferry", "mission", fidelity="switching", parts=parts)
    plan = case.plan()
    run = Run(plan, new_workspace(plan), ship=case.ship, rules=case.scenario.rules)
    there = build(**pickle.loads(pickle.dumps(arguments_of_plan(run))))
    assert there.layout.index == plan.layout.index
    assert there.layout.size == plan.layout.size
