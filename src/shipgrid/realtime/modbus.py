"""Modbus TCP: measurements as input registers, commands as holding registers (`registers.py` has the list).

Numbers of several registers are big-endian, high word first: a float32 has two registers, its sign and exponent in the
one with the lower address. Values are SI, or the code of a word. Holding registers of commands show what is in force.

A connection writes the token (64 bits, four registers in one request) before it is obeyed. A command is written whole,
by function 16 or 23; several that lie side by side are obeyed together or not at all. What is not obeyed is answered by
an exception, and said by the register `answer`:

    2 illegal address          no such register, or half of a command
    3 illegal value            out of range, not a number, wrong token
    6 device busy              too many commands at once
    7 negative acknowledge     refused by the interlocks, or no token

Functions 3, 4, 6, 16 and 23 are served. A request is sent when the last one has been answered. A write of a connection
that has the token is a sign of life of the controller; a read is none.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import struct
import threading
from contextvars import ContextVar
from typing import Any, cast

import numpy as np
from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from shipgrid.realtime.desk import BUSY, MODBUS, NO_TOKEN, OBEYED, OUT_OF_RANGE, REFUSED, UNKNOWN, Desk
from shipgrid.realtime.registers import (
    ANSWER,
    FIRST_COMMAND,
    FIRST_SIGNAL,
    FLOAT,
    HEARTBEAT,
    NO_ANSWER,
    TOKEN,
    WIDE,
)

FUNCTIONS = (3, 4, 6, 16, 23)
READ_INPUT = 4
HEAD = struct.Struct(">HHHBB")
"""Of a request: transaction, protocol (0), bytes that follow, unit, function."""
LENGTHS = range(2, 255)
MOST = 16
"""Connections at a time; a newer one takes the place of the oldest that has not given the token."""
UNREAD = 65_536
"""Answers that nobody reads, beyond which a connection is closed [bytes]."""
EXCEPTIONS = {
    OBEYED: None,
    UNKNOWN: ExcCodes.ILLEGAL_ADDRESS,
    OUT_OF_RANGE: ExcCodes.ILLEGAL_VALUE,
    REFUSED: ExcCodes.NEGATIVE_ACKNOWLEDGE,
    BUSY: ExcCodes.DEVICE_BUSY,
    NO_TOKEN: ExcCodes.NEGATIVE_ACKNOWLEDGE,
}

SPEAKING: ContextVar[Connection] = ContextVar("SPEAKING")
"""Whose request is being answered."""


class Connection(ServerRequestHandler):
    """One connection: whether it has given the token, the answer to its last command, the step it has read last."""

    def __init__(self, owner: Server):
        super().__init__(owner, None, None, None)
        self.owner = owner
        self.trusted, self.answer, self.step = False, NO_ANSWER, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Somebody has come."""
        super().connection_made(transport)
        self.owner.admit(self)

    def callback_data(self, data: bytes, addr: tuple | None = None) -> int:
        """Look at the head of what has come before the library does; bytes used."""
        counted = self.owner.desk.counted
        if len(data) < HEAD.size:
            return 0
        transaction, protocol, length, unit, function = HEAD.unpack_from(data)
        if protocol != 0 or length not in LENGTHS:
            counted["Modbus requests malformed"] += 1
            self.close()
            return len(data)
        if len(data) < 6 + length:
            return 0
        counted["Modbus requests"] += 1
        if self.transport.get_write_buffer_size() > UNREAD:  # type: ignore[attr-defined]
            counted["Modbus connections closed, answers unread"] += 1
            self.close()
            return len(data)
        if function not in FUNCTIONS:
            refused = ExceptionResponse(function & 0x7F, ExcCodes.ILLEGAL_FUNCTION, unit, transaction)
            self.server_send(refused, addr)
            return len(data)
        if len(data) > 6 + length:
            counted["Modbus requests before the answer to the last"] += 1
        return super().callback_data(data, addr)

    async def handle_request(self) -> None:
        """Answer a request."""
        SPEAKING.set(self)
        await super().handle_request()

    def server_send(self, pdu: Any, addr: tuple | None) -> None:
        """Send an answer."""
        if isinstance(pdu, ExceptionResponse):
            self.owner.desk.counted[f"Modbus exceptions {pdu.exception_code}"] += 1
        super().server_send(pdu, addr)


class Server(ModbusTcpServer):
    """The library's server, with connections of ours, and not too many of them."""

    def __init__(self, desk: Desk, token: int, address: tuple[str, int]):
        self.desk, self.token = desk, token.to_bytes(8, "big")
        self.names, self.bounds = list(desk.commands), [(c.low, c.high) for c in desk.commands.values()]
        nothing = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
        sizes = FIRST_COMMAND + FLOAT * len(self.names), FIRST_SIGNAL + FLOAT * len(desk.signals)
        holding, inputs = ([SimData(0, count=size, datatype=DataType.REGISTERS)] for size in sizes)
        device = SimDevice(id=0, simdata=(nothing, nothing, holding, inputs), action=self.access)
        super().__init__(device, address=address)

    def callback_new_connection(self) -> Connection:
        """Make a connection."""
        return Connection(self)

    def admit(self, connection: Connection) -> None:
        """Let a connection in, or close one if there are too many."""
        self.desk.counted["Modbus connections"] += 1
        present = list(self.active_connections.values())
        if len(present) > MOST:
            self.desk.counted["Modbus connections closed, too many"] += 1
            strangers = (one for one in present if isinstance(one, Connection) and not one.trusted)
            next(strangers, connection).close()

    async def access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Fill registers before they are read, and take what is written."""
        connection = SPEAKING.get()
        with self.desk.busy:
            connection.step = max(0, self.desk.look())
            if values is not None:
                return EXCEPTIONS[self._written(connection, address, cast(list[int], values))]
            if function == READ_INPUT:
                registers[:FIRST_SIGNAL] = struct.unpack(
                    ">8H", struct.pack(">Qd", connection.step, connection.step * self.desk.h)
                )
                _put(registers, FIRST_SIGNAL, self.desk.measured())
            else:
                registers[ANSWER] = connection.answer
                _put(registers, FIRST_COMMAND, self.desk.commanded())
        return None

    def _written(self, connection: Connection, address: int, values: list[int]) -> int:
        """Take what is written; what became of it, as a code of `desk.ANSWERS`."""
        counted, words = self.desk.counted, struct.pack(f">{len(values)}H", *values)
        if address == TOKEN and len(values) == WIDE:
            values[:] = [0] * WIDE  # nobody reads it
            connection.trusted = secrets.compare_digest(words, self.token)
            counted["Modbus wrong tokens"] += not connection.trusted
            if connection.trusted:
                self.desk.heard(MODBUS)
            return OBEYED if connection.trusted else OUT_OF_RANGE
        if not connection.trusted:
            counted["Modbus writes without a token"] += 1
            connection.answer = NO_TOKEN
            return NO_TOKEN
        self.desk.heard(MODBUS)
        if address == HEARTBEAT and len(values) == 1:
            return OBEYED
        first, half = divmod(address - FIRST_COMMAND, FLOAT)
        if first < 0 or half or len(values) % FLOAT:
            counted["Modbus writes of no command"] += 1
            connection.answer = UNKNOWN
            return UNKNOWN
        asked = [self._command(first + k, value) for k, (value,) in enumerate(struct.iter_unpack(">f", words))]
        connection.answer = max(self.desk.command(asked, MODBUS, connection.step, whole=True))
        return connection.answer

    def _command(self, number: int, value: float) -> tuple[str, float]:
        """Path and value; the float32 nearest to an end of the range is that end."""
        for end in self.bounds[number]:
            if value == np.float32(end):
                value = end
        return self.names[number], value


def _put(registers: list[int], first: int, values: np.ndarray) -> None:
    with np.errstate(over="ignore"):
        words = values.astype(">f4").view(">u2").tolist()
    registers[first : first + len(words)] = words


class ModbusServer:
    """A server in a thread of its own; it listens once it is made.

    Parameters
    ----------
    desk : Desk
    address : (str, int)
        Where to listen.
    token : int
        Without which nobody is obeyed.

    Raises
    ------
    OSError
        If the address cannot be listened on.
    """

    def __init__(self, desk: Desk, address: tuple[str, int], token: int):
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what goes wrong is counted
        self.desk, self.loop = desk, asyncio.new_event_loop()
        self.loop.set_exception_handler(self._failed)
        threading.Thread(target=self.loop.run_forever, name="shipgrid-modbus", daemon=True).start()
        self.server = asyncio.run_coroutine_threadsafe(self._listen(address, token), self.loop).result()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: with the port that it was given for 0."""
        listening: Any = self.server.transport
        return listening.sockets[0].getsockname()[:2]

    def close(self) -> None:
        """Close all connections, and listen no more."""
        asyncio.run_coroutine_threadsafe(self.server.shutdown(), self.loop).result()
        self.loop.call_soon_threadsafe(self.loop.stop)

    async def _listen(self, address: tuple[str, int], token: int) -> Server:
        server = Server(self.desk, token, address)
        try:
            await server.serve_forever(background=True)
        except RuntimeError as wrong:
            raise OSError(f"{address[0]} port {address[1]}: {wrong}") from wrong
        return server

    def _failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self.desk.counted["Modbus failures"] += 1
