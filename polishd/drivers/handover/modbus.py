"""Variables over Modbus TCP. The only file of this driver that knows pymodbus."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Mapping

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from polishd.api import Identity, LinkError, ProtocolError
from polishd.config.controller_profile import Value, VariablesTable
from polishd.drivers.handover.registers import BITS, Place, Table, place, spans
from polishd.drivers.handover.variables import Reading, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import cancellable


class Modbus:
    """A Variables of one unit. A table is read in one request; orders are written one after the other."""

    def __init__(
        self, address: Tcp, table: VariablesTable, silence_s: float, *, unit: int = 1, little: bool = False
    ) -> None:
        """ConfigError where an address of the profile is none."""
        self._name = f"{address} unit {unit}"
        self._address, self._unit, self._silence_s = address, unit, silence_s
        self._watched = {name: place(name, point, little=little) for name, point in watched(table).items()}
        self._written = {name: place(name, point, little=little) for name, point in written(table).items()}
        self._spans = spans(self._watched)
        self._client: AsyncModbusTcpClient | None = None

    async def open(self) -> None:
        """See Variables."""
        await self.close()
        client = AsyncModbusTcpClient(
            self._address.host, port=self._address.port, timeout=self._silence_s, retries=0, reconnect_delay=0
        )
        self._client = client
        try:
            if not await cancellable(client.connect()):
                raise LinkError(f"{self._name}: cannot be opened")
            await self.read()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Variables."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    async def identify(self) -> Identity:
        """See Variables. Modbus tells nothing of that."""
        await self.read()
        return Identity("", "Modbus", self._name, "unknown")

    async def read(self) -> Reading:
        """See Variables."""
        asked_s = time.monotonic()
        found = {table: await self._read(table, *span) for table, span in self._spans.items()}
        now_s = (asked_s + time.monotonic()) / 2
        values = {name: _value(name, one, found[one.table], self._spans[one.table][0]) for name, one in self._places()}
        return Reading(now_s, values)

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables."""
        for name, value in values.items():
            one = self._written[name]
            words = one.words(of_kind(one.kind, value, name))
            client = self._session()
            if one.table == "coil":
                await self._answer(
                    client.write_coil(one.address, bool(words[0]), device_id=self._unit), f"write {name}"
                )
            elif one.table == "holding":
                await self._answer(client.write_registers(one.address, words, device_id=self._unit), f"write {name}")
            else:
                raise ProtocolError(f"{self._name}: variable {name} is a {one.table}, which nobody can write")

    def _places(self) -> list[tuple[str, Place]]:
        return list(self._watched.items())

    def _session(self) -> AsyncModbusTcpClient:
        if self._client is None:
            raise LinkError(f"{self._name}: is not open")
        return self._client

    async def _read(self, table: Table, first: int, count: int) -> list[int]:
        client = self._session()
        read = {
            "coil": client.read_coils,
            "discrete": client.read_discrete_inputs,
            "holding": client.read_holding_registers,
            "input": client.read_input_registers,
        }[table]
        answer = await self._answer(read(first, count=count, device_id=self._unit), f"read {table}s from {first}")
        words = [int(bit) for bit in answer.bits[:count]] if table in BITS else list(answer.registers)
        if len(words) != count:
            raise ProtocolError(f"{self._name}: {count} {table}s were asked for, {len(words)} came")
        return words

    async def _answer(self, request: Awaitable[ModbusPDU], what: str) -> ModbusPDU:
        try:
            answer = await cancellable(request)
        except (ModbusException, OSError) as error:
            await self.close()
            raise LinkError(f"{self._name}: answers no more: {error}") from error
        if answer.isError():
            raise ProtocolError(f"{self._name}: refuses to {what}: {answer}: look at the addresses in the profile")
        return answer


def _value(name: str, one: Place, words: list[int], first: int) -> Value:
    at = one.address - first
    return of_kind(one.kind, one.value(words[at : at + one.count]), name)
