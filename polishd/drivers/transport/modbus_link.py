"""Modbus link that checks each answer. The only file that imports pymodbus."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu import bit_message as bit
from pymodbus.pdu import register_message as word

from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.streams import SerialStream, TcpStream, drop_stale, open_stream
from polishd.model.devices import RegisterTable
from polishd.model.errors import DeviceRefused, LinkError, ProtocolError

# A link whose answers have no number: a late one could be taken for the next request's.

OPEN_S = 1.0


class UnnumberedLink:
    """Link with unnumbered answers. The caller sends one request at a time.

    After silence or an invalid answer the link is closed. It is reopened, which drops received bytes, only when no
    answer can be due.
    """

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """``silence_s`` is the longest wait for an answer; on a serial line a late one may follow for as long again."""
        self._address = address
        self._silence_s = silence_s
        self._stream: TcpStream | SerialStream | None = None
        self._due_until = 0.0

    @property
    def connected(self) -> bool:
        """False before ``connect``, and once answers can no longer be trusted."""
        return self._stream is not None and self._stream.alive

    async def connect(self) -> None:
        """Open the link; waits until no late answer to an earlier request can arrive."""
        await self.disconnect()
        if isinstance(self._address, SerialLine):
            await asyncio.sleep(max(self._due_until - time.monotonic(), 0.0))
        self._stream = await open_stream(self._address, OPEN_S)

    async def disconnect(self) -> None:
        """Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def distrust(self) -> None:
        """Close the link, so that no late bytes are taken for an answer."""
        self._due_until = time.monotonic() + 2 * self._silence_s
        await self.disconnect()


READS: dict[RegisterTable, tuple[type[ModbusPDU], type[ModbusPDU]]] = {
    "coil": (bit.ReadCoilsRequest, bit.ReadCoilsResponse),
    "discrete": (bit.ReadDiscreteInputsRequest, bit.ReadDiscreteInputsResponse),
    "holding": (word.ReadHoldingRegistersRequest, word.ReadHoldingRegistersResponse),
    "input": (word.ReadInputRegistersRequest, word.ReadInputRegistersResponse),
}
REFUSALS = {
    1: "function not supported",
    2: "address not known",
    3: "value out of range",
    4: "the device failed to execute it",
    6: "busy",
}
LOOKS, NOT_THERE = (1, 2, 3, 4), (1, 2)
"""Read functions, and exception codes for missing registers: most often it is another device."""
ECHO = 5
"""Length of the answer to a write, bytes: function, address, value or count."""
BITS = ("coil", "discrete")
GATEWAY = (10, 11)
"""Exception codes of a gateway for a silent device."""


class ModbusLink(UnnumberedLink):
    """Modbus RTU, whose answers have no number, or Modbus TCP, which is handled in the same way."""

    def __init__(
        self,
        address: Tcp | SerialLine,
        unit: int,
        silence_s: float,
        pause_s: float = 0.0,
        refusals: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        """See UnnumberedLink. ``pause_s``: silence before a request; ``refusals``: texts of exception codes."""
        super().__init__(address, silence_s)
        self.name = f"{address} unit {unit}"
        self._unit = unit
        self._refusals = {**REFUSALS, **refusals}
        serial = isinstance(address, SerialLine)
        self._framer = (FramerRTU if serial else FramerSocket)(DecodePDU(False))
        # the standard's three and a half bytes, and its minimum for fast lines
        self._pause_s = pause_s + (max(3.5 * address.byte_s, 0.00175) if isinstance(address, SerialLine) else 0.0)
        self._number = 0
        self._heard = 0.0

    async def read(self, table: RegisterTable, address: int, count: int) -> list[int]:
        """Read words, or bits as 0 and 1."""
        answer = await self._ask(*_read(table, address, count))
        found = [int(one) for one in answer.bits or answer.registers]
        # bits arrive in whole bytes
        if len(found) != (-(-count // 8) * 8 if table in BITS else count):
            raise await self._nonsense(f"read of {count} from {table} {address}", answer)
        return found[:count]

    async def write(self, table: RegisterTable, address: int, values: Sequence[int], *, many: bool) -> None:
        """Write holding registers or coils; ``many`` selects the function that writes several."""
        request, response = _write(table, address, values, many=many)
        answer = await self._ask(request, response)
        echoed = (answer.address, answer.count) == (address, len(values)) if many else _same(answer, request)
        if not echoed:
            raise await self._nonsense(f"write of {list(values)} to {table} {address}", answer)

    async def _ask(self, request: ModbusPDU, response: ModbusPDU) -> ModbusPDU:
        """Return the answer of the request's kind, not yet compared with the request."""
        self._number = self._number % 0xFFFF + 1
        request.transaction_id, request.dev_id = self._number, self._unit
        body = await self._body(self._framer.buildFrame(request))
        if body[0] == request.function_code | 0x80 and len(body) == 2:
            raise self._refused(request.function_code, body[1])
        try:
            if body[0] != request.function_code:
                raise ValueError(f"function {body[0]}")
            if len(body) != (2 + body[1] if request.function_code in LOOKS else ECHO):
                raise ValueError(f"{len(body)} bytes")  # pymodbus accepts a short answer
            response.decode(body[1:])
        except (ModbusException, ValueError, IndexError, struct.error):
            await self.distrust()
            said = f"function {request.function_code} was answered by {body.hex(' ')}"
            raise ProtocolError(f"{self.name}: {said}, which is no answer to it") from None
        return response

    async def _body(self, request: bytes) -> bytes:
        """Return function code and data of the answer's frame."""
        if self._stream is None:
            raise LinkError(f"{self.name}: is not open")
        await asyncio.sleep(max(self._heard + self._pause_s - time.monotonic(), 0.0))
        await drop_stale(self._stream)
        came, deadline = b"", time.monotonic() + self._silence_s
        self._due_until = deadline + self._silence_s
        try:
            await self._stream.write(request)
            while (body := self._cut(came)) is None:
                came += await self._stream.read(512, max(deadline - time.monotonic(), 0.0))
                self._heard = time.monotonic()
        except LinkError as error:
            await self.disconnect()
            raise self._unanswered(came, error, in_time=time.monotonic() < deadline) from error
        except ProtocolError:
            await self.disconnect()
            raise
        self._due_until = 0.0
        return body

    def _cut(self, came: bytes) -> bytes | None:
        """Return the body of our answer if the received bytes contain it."""
        at, due = 0, 0 if isinstance(self._framer, FramerRTU) else self._number
        while at < len(came):
            if isinstance(self._framer, FramerSocket) and came[at + 2 : at + 4].strip(b"\0"):
                raise ProtocolError(f"{self.name}: the answer is not Modbus TCP: {came[:16].hex(' ')}")
            used, unit, number, body = self._framer.decode(came[at:])
            if not used or not body:
                return None
            at += used
            if unit == self._unit and number == due:
                return body
        return None

    def _unanswered(self, came: bytes, error: LinkError, *, in_time: bool) -> LinkError:
        """Describe a missing or garbled answer with its likely cause."""
        if in_time:  # the connection itself is lost
            return error
        if not came:
            return LinkError(f"{self.name}: no answer {silent(self._address, self._silence_s, 'unit number')}")
        return LinkError(f"{self.name}: {garbled(self._address, came, self._silence_s)}")

    def _refused(self, function: int, code: int) -> DeviceRefused | LinkError:
        if code in GATEWAY:
            return LinkError(
                f"{self.name}: the gateway answers, its unit {self._unit} does not; see power, wires, unit"
            )
        why = f"{self.name}: exception {code}, {self._refusals.get(code, 'unknown reason')}"
        return DeviceRefused(f"{why}; is it another device?" if function in LOOKS and code in NOT_THERE else why)

    async def _nonsense(self, what: str, answer: ModbusPDU) -> ProtocolError:
        await self.distrust()
        said = answer.registers or answer.bits or f"{answer.count} at {answer.address}"
        return ProtocolError(f"{self.name}: the {what} was answered by {said}")


def read_frame(unit: int, table: RegisterTable, address: int, count: int) -> bytes:
    """Return the request on a serial line, as manuals print it."""
    return _frame(unit, _read(table, address, count)[0])


def write_frame(unit: int, table: RegisterTable, address: int, values: Sequence[int], *, many: bool) -> bytes:
    """Return the request on a serial line, as manuals print it."""
    return _frame(unit, _write(table, address, values, many=many)[0])


def _frame(unit: int, request: ModbusPDU) -> bytes:
    request.dev_id = unit
    return FramerRTU(DecodePDU(False)).buildFrame(request)


def _read(table: RegisterTable, address: int, count: int) -> tuple[ModbusPDU, ModbusPDU]:
    """Return the request, and an empty answer."""
    request, response = READS[table]
    return request(address=address, count=count), response()


def _write(table: RegisterTable, address: int, values: Sequence[int], *, many: bool) -> tuple[ModbusPDU, ModbusPDU]:
    """Return the request, and an empty answer."""
    bits = [bool(value) for value in values]
    if table == "coil":
        if many:
            return bit.WriteMultipleCoilsRequest(address=address, bits=bits), bit.WriteMultipleCoilsResponse()
        return bit.WriteSingleCoilRequest(address=address, bits=bits), bit.WriteSingleCoilResponse()
    if many:
        several = word.WriteMultipleRegistersRequest(address=address, registers=values)
        return several, word.WriteMultipleRegistersResponse()
    return word.WriteSingleRegisterRequest(address=address, registers=values), word.WriteSingleRegisterResponse()


def _same(answer: ModbusPDU, request: ModbusPDU) -> bool:
    """Whether the answer to a single write is its echo."""
    echo = (answer.address, list(answer.registers), list(answer.bits))
    return echo == (request.address, list(request.registers), list(request.bits))
