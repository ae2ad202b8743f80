"""Link of a profile's device on Modbus registers."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceRefused, ProtocolError
from polishd.config.device_profile import DeviceProfile, ModbusTable, Write, write_of
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.codec import Values
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.modbus_link import ModbusLink


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
