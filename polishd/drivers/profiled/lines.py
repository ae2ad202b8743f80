"""A profile's requests and answers on lines of text."""

from __future__ import annotations

import re
from collections.abc import Sequence

from polishd.api import DeviceRefused, ProtocolError
from polishd.config.device_profile import DeviceProfile
from polishd.config.device_tables import LinesTable
from polishd.drivers.profiled import codec
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.line_link import LineLink
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.numbered import NumberedLines


class LineWire:
    """A Wire over lines of text."""

    def __init__(
        self, profile: DeviceProfile, address: Tcp | SerialLine, silence_s: float, *, pole_pairs: int = 1
    ) -> None:
        """An answer comes within ``silence_s``."""
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
        for step in getattr(self.profile.orders, name):
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
