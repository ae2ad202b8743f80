"""Links of a profile's device: lines of text, or Modbus registers."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.config.device_profile import DeviceProfile, LinesTable, ModbusTable, Write, write_of
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.codec import Values
from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.lines import NumberedLines
from polishd.drivers.transport.modbus_link import ModbusLink, UnnumberedLink
from polishd.drivers.transport.streams import drop_stale


class ModbusWire:
    """A ProfileTransport over Modbus."""

    def __init__(
        self,
        profile: DeviceProfile,
        address: Tcp | SerialLine,
        silence_s: float,
        *,
        unit: int | None = None,
        pole_pairs: int = 1,
    ) -> None:
        """``silence_s`` is the longest time to wait for an answer."""
        self.profile = profile
        self._table = profile.modbus or ModbusTable()
        refusals = {int(code): why for code, why in self._table.error_replies.items()}
        given = self._table.unit if unit is None else unit
        self._link = ModbusLink(address, given, silence_s, self._table.pause_s, refusals)
        self._pole_pairs = pole_pairs
        self._count = 0
        self._counted = False
        self.name = self._link.name

    @property
    def connected(self) -> bool:
        """See Wire."""
        return self._link.connected

    async def connect(self) -> None:
        """See Wire."""
        await self.disconnect()
        await self._link.connect()

    async def disconnect(self) -> None:
        """See Wire."""
        self._counted = False
        await self._link.disconnect()

    async def read(self, names: Sequence[str]) -> Values:
        """See ProfileTransport. The echo of our heartbeat distinguishes a fresh answer from a stale one."""
        words = {
            block: await self._link.read(block.table, block.address, block.count)
            for block in codec.blocks(self.profile.registers, names, self._table.max_registers)
        }
        found = Values()
        try:
            for block, raw in words.items():
                found |= codec.values_of(self.profile, block, raw, self._pole_pairs)
            found = codec.signed(self.profile, found)
        except ProtocolError as error:
            raise ProtocolError(f"{self.name}: {error}; see word order, scale and whether it is this device") from None
        echo = found.get("beat_echo")
        if self._counted and echo is not None and echo != self._count:
            await self.disconnect()
            raise ProtocolError(f"{self.name}: heartbeat echo {echo}, but {self._count} was written last")
        return found

    async def order(self, name: str, asked: float = 0.0) -> None:
        """See Wire."""
        for step in getattr(self.profile.commands, name):
            await self._write(write_of(step), asked)

    async def _write(self, write: Write, asked: float) -> None:
        register = self.profile.registers[write.register]
        counts = write.value == "count"
        if counts:
            self._count = (self._count + 1) & 0xFFFF
        try:
            if write.value == "asked":
                words = codec.words_for(register, write.register, asked, self._table.word_order, self._pole_pairs)
            else:
                words = codec.pack(register, self._count if counts else float(write.value), self._table.word_order)
        except DeviceRefused as error:
            raise DeviceRefused(f"{self.name}: {error}") from None
        many = register.write_many or len(words) > 1
        await self._link.write(register.table, register.address, words, many=many)
        self._counted = self._counted or counts


class LineLink(UnnumberedLink):
    """Link on lines: one request, one answer."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float, ending: bytes, answer_ending: bytes) -> None:
        """See UnnumberedLink; ``ending`` and ``answer_ending`` end requests and answers."""
        super().__init__(address, silence_s)
        self.name = str(address)
        """For messages."""
        self._ending, self._answer_ending = ending, answer_ending
        self._rest = b""

    async def connect(self) -> None:
        """See UnnumberedLink."""
        await super().connect()
        self._rest = b""

    async def tell(self, request: str) -> None:
        """Send a request that has no answer."""
        if self._stream is None:
            raise LinkError(f"{self.name}: is not open")
        try:
            await self._stream.write(request.encode("ascii") + self._ending)
        except LinkError:
            await self.disconnect()
            raise

    async def ask(self, request: str) -> str:
        """Return the answer's line without its ending. LinkError if none arrives in time."""
        await self._drop_stale()
        await self.tell(request)
        deadline = time.monotonic() + self._silence_s
        self._due_until = deadline + self._silence_s
        try:
            line = await self._line(deadline)
        except LinkError as error:
            await self.disconnect()
            if time.monotonic() < deadline:  # the connection itself is lost
                raise
            raise LinkError(f"{self.name}: {self._unanswered(request)}") from error
        self._due_until = 0.0
        return line.decode("latin-1")

    async def _drop_stale(self) -> None:
        """Drop bytes that arrived before the request."""
        self._rest = b""
        if self._stream is not None:
            await drop_stale(self._stream)

    async def _line(self, deadline: float) -> bytes:
        stream = self._stream
        while stream is not None:
            line, end, rest = self._rest.partition(self._answer_ending)
            if end:
                self._rest = rest
                if line := line.strip(b"\r\n"):
                    return line
                continue
            if len(self._rest) > LONGEST:
                raise LinkError(f"{self.name}: {len(self._rest)} bytes without the end of a line")
            self._rest += await stream.read(512, max(deadline - time.monotonic(), 0.0))
        raise LinkError(f"{self.name}: is not open")

    def _unanswered(self, request: str) -> str:
        """Most likely cause of a missing or garbled answer."""
        if not self._rest:
            how = "line ending of requests"
            return f"no answer to {request!r} {silent(self._address, self._silence_s, how)}"
        return f"{request!r}: {garbled(self._address, self._rest, self._silence_s, 'lines.answer_ending')}"


# Lines without numbers: one request, one answer. A late answer is never taken for the next request's.

LONGEST = 512
"""Longest answer, bytes."""


class LineWire:
    """A ProfileTransport over lines of text."""

    def __init__(
        self, profile: DeviceProfile, address: Tcp | SerialLine, silence_s: float, *, pole_pairs: int = 1
    ) -> None:
        """``silence_s`` is the longest time to wait for an answer."""
        self.profile = profile
        self._table = profile.lines or LinesTable()
        self._lines: LineLink | NumberedLines
        if self._table.framing == "numbered":
            self._lines = NumberedLines(address, silence_s)
        else:
            endings = self._table.ending.encode("ascii"), self._table.answer_ending.encode("ascii")
            self._lines = LineLink(address, silence_s, *endings)
        self._pole_pairs = pole_pairs
        self._count = 0
        self.name = self._lines.name

    @property
    def connected(self) -> bool:
        """See Wire."""
        return self._lines.connected

    async def connect(self) -> None:
        """See Wire."""
        await self._lines.connect()

    async def disconnect(self) -> None:
        """See Wire."""
        await self._lines.disconnect()

    async def read(self, names: Sequence[str]) -> Values:
        """See Wire."""
        wanted, found = set(names), Values()
        for ask in self.profile.asks.values():
            if wanted & set(ask.groups) - set(found):
                answer = await self._ask(ask.send)
                try:
                    found |= codec.fields_of(self.profile, ask, answer, self._pole_pairs)
                except ProtocolError as error:
                    await self._distrust()
                    raise ProtocolError(f"{self.name}: {error}; is it another device?") from None
        if missing := sorted(wanted - set(found)):
            raise ProtocolError(
                f"{self.name}: no answer says {missing[0]!r}; see asks in profile {self.profile.name!r}"
            )
        try:
            return codec.signed(self.profile, found)
        except ProtocolError as error:
            raise ProtocolError(f"{self.name}: {error}; see scale, and whether it is this device") from None

    async def order(self, name: str, asked: float = 0.0) -> None:
        """See Wire."""
        for step in getattr(self.profile.commands, name):
            if "{count" in step:
                self._count = (self._count + 1) & 0xFFFF
            await self._tell(step.format(asked=asked, count=self._count))

    async def _tell(self, request: str) -> None:
        if not self._table.accepted and isinstance(self._lines, LineLink):
            return await self._lines.tell(request)
        answer = await self._ask(request)
        if re.fullmatch(self._table.accepted, answer) is None:
            await self._distrust()
            raise ProtocolError(f"{self.name}: {request} was answered by {answer!r}; is it another device?")
        return None

    async def _ask(self, request: str) -> str:
        answer = await self._lines.ask(request)
        refusal = re.fullmatch(self._table.refused, answer) if self._table.refused else None
        if refusal is not None:
            raise DeviceRefused(f"{self.name}: {request} was refused: {refusal.groupdict().get('why') or answer}")
        return answer

    async def _distrust(self) -> None:
        """Without numbers, a wrong answer may have been an earlier request's."""
        if isinstance(self._lines, LineLink):
            await self._lines.distrust()
