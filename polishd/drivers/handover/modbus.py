"""Variables over Modbus TCP. The only file of this driver that knows pymodbus."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping
from functools import partial

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu import bit_message as bit
from pymodbus.pdu import register_message as word

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.config.controller_profile import Value, VariablesTable
from polishd.drivers.handover.registers import BITS, ModbusAddress, Table, place, spans
from polishd.drivers.handover.variables import VariableSnapshot, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import cancellable
from polishd.drivers.transport.claims import claim_address
from polishd.ports.address_claims import Claim

WRITE_COIL, WRITE_REGISTERS = 5, 16
READS: tuple[type[ModbusPDU], ...] = (
    bit.ReadCoilsResponse,
    bit.ReadDiscreteInputsResponse,
    word.ReadHoldingRegistersResponse,
    word.ReadInputRegistersResponse,
)


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
        self._claimed = Claim()

    async def open(self) -> None:
        """See Variables."""
        await self.close()
        self._claimed = await claim_address(self._address)
        client = AsyncModbusTcpClient(
            self._address.host, port=self._address.port, timeout=self._silence_s, retries=0, reconnect_delay=0
        )
        for response in READS:
            client.register(_strict(response))
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
        self._claimed.release()

    async def identify(self) -> DeviceIdentity:
        """See Variables. Modbus tells nothing of that."""
        await self.read()
        return DeviceIdentity("", "Modbus", self._name, "unknown")

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        asked_s = time.monotonic()
        found = {table: await self._read(table, *span) for table, span in self._spans.items()}
        now_s = (asked_s + time.monotonic()) / 2
        values = {name: _value(name, one, found[one.table], self._spans[one.table][0]) for name, one in self._places()}
        return VariableSnapshot(now_s, values)

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables."""
        for name, value in values.items():
            one = self._written[name]
            words = one.words(of_kind(one.kind, value, name))
            client = self._session()
            if one.table == "coil":
                order = partial(client.write_coil, one.address, bool(words[0]), device_id=self._unit)
                answer = await self._answer(order, WRITE_COIL, f"write {name}")
                echoed = (answer.address, answer.bits[:1]) == (one.address, [bool(words[0])])
            elif one.table == "holding":
                order = partial(client.write_registers, one.address, words, device_id=self._unit)
                answer = await self._answer(order, WRITE_REGISTERS, f"write {name}")
                echoed = (answer.address, answer.count) == (one.address, len(words))
            else:
                raise ProtocolError(f"{self._name}: variable {name} is a {one.table}, which nobody can write")
            if not echoed:
                raise ProtocolError(
                    f"{self._name}: the write of {name} was answered by that of another: see the server"
                )

    def _places(self) -> list[tuple[str, ModbusAddress]]:
        return list(self._watched.items())

    def _session(self) -> AsyncModbusTcpClient:
        if self._client is None:
            raise LinkError(f"{self._name}: is not open")
        return self._client

    async def _read(self, table: Table, first: int, count: int) -> list[int]:
        client = self._session()
        function, read = {
            "coil": (1, client.read_coils),
            "discrete": (2, client.read_discrete_inputs),
            "holding": (3, client.read_holding_registers),
            "input": (4, client.read_input_registers),
        }[table]
        request = partial(read, first, count=count, device_id=self._unit)
        answer = await self._answer(request, function, f"read {table}s from {first}")
        words = [int(one) for one in (answer.bits if table in BITS else answer.registers)]
        # bits come in whole bytes
        if len(words) != (-(-count // 8) * 8 if table in BITS else count):
            raise ProtocolError(f"{self._name}: {count} {table}s were asked for, {len(words)} came: see the server")
        return words[:count]

    async def _answer(self, request: Callable[[], Awaitable[ModbusPDU]], function: int, what: str) -> ModbusPDU:
        """The answer. pymodbus takes one of any function, and one whose number is 0, which no request of its has.

        Where the link is gone it raises as it is asked, before there is anything to wait for.
        """
        try:
            answer = await cancellable(request())
        except (ModbusException, OSError) as error:
            await self.close()
            raise LinkError(f"{self._name}: answers no more: {error}") from error
        if answer.isError():
            raise ProtocolError(f"{self._name}: refuses to {what}: {answer}: look at the addresses in the profile")
        if answer.function_code != function or not answer.transaction_id:
            said = f"function {answer.function_code}, number {answer.transaction_id}"
            raise ProtocolError(
                f"{self._name}: to {what} was answered by {said}, which is no answer to it: see the server"
            )
        return answer


def _value(name: str, one: ModbusAddress, words: list[int], first: int) -> Value:
    at = one.address - first
    return of_kind(one.kind, one.value(words[at : at + one.count]), name)


def _strict(response: type[ModbusPDU]) -> type[ModbusPDU]:
    """An answer that is empty where its length is not what it says: pymodbus takes what is there."""

    class Strict(response):  # type: ignore[misc, valid-type]
        def decode(self, data: bytes) -> None:
            if data and data[0] == len(data) - 1:
                super().decode(data)

    return Strict
