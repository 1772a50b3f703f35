"""UDP: one packet of measurements every millisecond, packets of commands back. Everything little-endian.

Head of every packet, 40 bytes:

    4 bytes   magic, "SHGR"
    uint8     version, 1
    uint8     kind: 1 measurements, 2 commands, 3 answer
    uint16    count of what follows the head; of commands at most 64
    uint32    session: drawn at random by whoever sends, anew at each start
    uint32    sequence: counts the packets of a session from 1; of an answer, that of the packet it answers
    uint64    token; 0 in packets from the plant
    uint64    step: steps done when the measurements were taken; in commands, that of the measurements they answer
    float64   time [s]: of those measurements; in commands, ignored

Measurements: `count` float64, the public signals in the order of the list of registers, SI units. Commands: `count` of
(uint16 number of the command in that list, float64 value in SI units or the code of a word); none is a sign of life.
Answer: `count` of uint8, for each command what became of it (`desk.ANSWERS`).

Commands of one packet are judged together: two sources can change places. Packets with a wrong length, magic, version,
kind or token are counted and left without an answer, as are those whose sequence has been passed, and those of a
session that another one has followed. Measurements go to the last address that sent a valid packet, until it falls
silent.
"""

from __future__ import annotations

import secrets
import select
import socket
import struct
import time
from collections import deque

from shipgrid.realtime.desk import UDP, Desk

HEAD = struct.Struct("<4sBBHIIQQd")
COMMAND = struct.Struct("<Hd")
MAGIC, VERSION = b"SHGR", 1
MEASUREMENTS, COMMANDS, ANSWER = 1, 2, 3
PERIOD = 1e-3
"""Time [s] between two packets of measurements."""
MOST = 64
"""Commands in a packet."""
PASSED = 256
"""Sessions that are remembered as over."""
BURST = 32
"""Packets that are read before measurements are sent and controllers looked after again."""


def packet(kind: int, session: int, sequence: int, token: int, step: int, t: float, count: int, body: bytes) -> bytes:
    """A packet.

    Parameters
    ----------
    kind, session, sequence, token, step : int
    t : float
        Time [s].
    count : int
        Of what is in the body.
    body : bytes
    """
    return HEAD.pack(MAGIC, VERSION, kind, count, session, sequence, token, step, t) + body


class UdpServer:
    """Answers one controller at a time.

    Parameters
    ----------
    desk : Desk
    address : (str, int)
        Where to listen.
    token : int
        Without which nobody is heard.

    Raises
    ------
    OSError
        If the address cannot be listened on.
    """

    def __init__(self, desk: Desk, address: tuple[str, int], token: int):
        self.desk, self.token = desk, token
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self.socket = socket.socket(family, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)
        self.session, self.sequence = secrets.randbits(32), 0
        self.peer: tuple | None = None
        self.peer_session, self.peer_sequence = -1, 0
        self.passed: deque[int] = deque(maxlen=PASSED)
        self.due = time.monotonic()
        self.names = list(desk.commands)

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: with the port that it was given for 0."""
        return self.socket.getsockname()[:2]

    def serve(self, wait: float) -> None:
        """Read what has come, waiting at most some time [s] for it, and send measurements if they are due."""
        left = max(0.0, min(wait, self.due - time.monotonic()) if self.peer else wait)
        if select.select([self.socket], [], [], left)[0]:
            for _ in range(BURST):
                try:
                    data, peer = self.socket.recvfrom(65535)
                except BlockingIOError:
                    break
                except OSError:  # an earlier packet was refused by its receiver
                    continue
                self._receive(data, peer)
        now = time.monotonic()
        if self.peer is not None and now >= self.due:
            self._measure()
            self.due = max(self.due + PERIOD, now)

    def _receive(self, data: bytes, peer: tuple) -> None:
        counted = self.desk.counted
        counted["packets"] += 1
        if len(data) < HEAD.size:
            counted["packets malformed"] += 1
            return
        magic, version, kind, count, session, sequence, token, step, _ = HEAD.unpack_from(data)
        right = magic == MAGIC and version == VERSION and kind == COMMANDS and count <= MOST
        if not right or len(data) != HEAD.size + count * COMMAND.size:
            counted["packets malformed"] += 1
            return
        if not secrets.compare_digest(token.to_bytes(8, "little"), self.token.to_bytes(8, "little")):
            counted["packets with a wrong token"] += 1
            return
        if session in self.passed or (session == self.peer_session and sequence <= self.peer_sequence):
            counted["packets late or twice"] += 1
            return
        if session != self.peer_session:
            counted["sessions"] += 1
            self.passed.append(self.peer_session)
            self.peer_session, self.peer_sequence = session, sequence - 1  # what came before it went to nobody
        counted["packets missed"] += sequence - self.peer_sequence - 1
        self.peer_sequence = sequence
        if self.peer is None:
            self.due = time.monotonic()
        self.peer = peer
        asked = []
        for k in range(count):
            number, value = COMMAND.unpack_from(data, HEAD.size + k * COMMAND.size)
            asked.append((self.names[number] if number < len(self.names) else "", value))
        with self.desk.busy:
            self.desk.heard(UDP)
            measured = min(step, max(0, self.desk.look()))  # nobody has seen what has not been yet
            codes = bytes(self.desk.command(asked, UDP, measured)) if asked else b""
        if codes:
            self._send(packet(ANSWER, self.session, sequence, 0, self.desk.step, self._time(), count, codes))

    def _measure(self) -> None:
        with self.desk.busy:
            controller = self.desk.controllers.get(UDP)
            if controller is not None and controller.lost_at < float("inf"):
                self.peer = None  # silent: it will say where it is
                return
            if self.desk.look() < 0:
                return
            values = self.desk.measured().astype("<f8")
        self.sequence += 1
        head = (self.session, self.sequence, 0, self.desk.step, self._time())
        self._send(packet(MEASUREMENTS, *head, len(values), values.tobytes()))

    def _time(self) -> float:
        return self.desk.step * self.desk.h

    def _send(self, data: bytes) -> None:
        try:
            self.socket.sendto(data, self.peer or ())
        except OSError:
            self.desk.counted["packets not sent"] += 1
