"""Variables over Modbus TCP. The only file of this driver that imports pymodbus."""

from __future__ import annotations

import struct
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, cast

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu import bit_message as bit
from pymodbus.pdu import register_message as word

from polishd.api import ConfigError, DeviceIdentity, LinkError, ProtocolError
from polishd.config.controller_profile import Kind, Value, Variable, VariablesTable
from polishd.drivers.plc_robot.variables import VariableSnapshot, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import cancellable
from polishd.drivers.transport.claims import claim_address
from polishd.util.address_claims import Claim

# Modbus addresses of a controller's variables, and their encoding. Sans-IO.

Table = Literal["coil", "discrete", "holding", "input"]
BITS: tuple[Table, ...] = ("coil", "discrete")
_FORMS: dict[Kind, str] = {
    "bool": ">H", "int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float": ">f", "double": ">d",
}  # fmt: skip
MOST = {"coil": 2000, "discrete": 2000, "holding": 125, "input": 125}
"""Most registers or bits of one read request."""


@dataclass(frozen=True, slots=True)
class ModbusAddress:
    """Registers of a variable, or its bit."""

    table: Table
    address: int
    kind: Kind
    little: bool
    """Whether the least significant word is first."""

    @property
    def count(self) -> int:
        """Number of registers or bits."""
        return 1 if self.table in BITS else struct.calcsize(_FORMS[self.kind]) // 2

    def value(self, words: Sequence[int]) -> Value:
        """Return the value in these registers."""
        if self.table in BITS:
            return bool(words[0])
        ordered = reversed(words) if self.little else words
        found: Value = struct.unpack(_FORMS[self.kind], struct.pack(f">{self.count}H", *ordered))[0]
        return bool(found) if self.kind == "bool" else found

    def words(self, value: Value) -> list[int]:
        """Return the registers for a value."""
        if self.table in BITS:
            return [int(bool(value))]
        words = list(struct.unpack(f">{self.count}H", struct.pack(_FORMS[self.kind], value)))
        return words[::-1] if self.little else words


def place(name: str, variable: Variable, *, little: bool) -> ModbusAddress:
    """Return a variable's address. ConfigError if the profile's address is invalid or does not fit its type."""
    table, _, number = variable.address.partition(":")
    if table not in MOST or not number.isdecimal() or int(number) > 65535:
        raise ConfigError(
            f"variables.{name}.address {variable.address!r}: write holding:40, input:7, coil:3 or discrete:0 (from 0)"
        )
    if variable.type == "string" or (table in BITS and variable.type != "bool"):
        raise ConfigError(f"variables.{name}.type {variable.type!r}: does not fit in {table}s of Modbus")
    return ModbusAddress(cast("Table", table), int(number), variable.type, little)


def spans(places: Mapping[str, ModbusAddress]) -> dict[Table, tuple[int, int]]:
    """Return (first, count) of each table. Each table is read in one request, so that its values are consistent.

    ConfigError if one request is not enough.
    """
    found: dict[Table, tuple[int, int]] = {}
    for table in sorted({place.table for place in places.values()}):
        own = [place for place in places.values() if place.table == table]
        first = min(place.address for place in own)
        count = max(place.address + place.count for place in own) - first
        if count > MOST[table]:
            raise ConfigError(
                f"variables: {table}s {first} to {first + count - 1} exceed the limit of {MOST[table]} of one request. "
                "Place them closer together in the controller."
            )
        found[table] = (first, count)
    return found


WRITE_COIL, WRITE_REGISTERS = 5, 16
READS: tuple[type[ModbusPDU], ...] = (
    bit.ReadCoilsResponse,
    bit.ReadDiscreteInputsResponse,
    word.ReadHoldingRegistersResponse,
    word.ReadInputRegistersResponse,
)


class Modbus:
    """Variables of one unit. A table is read in one request; values are written one after the other."""

    def __init__(
        self, address: Tcp, table: VariablesTable, silence_s: float, *, unit: int = 1, little: bool = False
    ) -> None:
        """ConfigError for an invalid address in the profile."""
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
        """See Variables. Modbus reports no identity."""
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
                raise ProtocolError(f"{self._name}: variable {name} is a {one.table}, which is read-only")
            if not echoed:
                raise ProtocolError(
                    f"{self._name}: the write of {name} received the answer of another write. Check the server."
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
        # bits arrive in whole bytes
        if len(words) != (-(-count // 8) * 8 if table in BITS else count):
            raise ProtocolError(f"{self._name}: {len(words)} of {count} {table}s received. Check the server.")
        return words[:count]

    async def _answer(self, request: Callable[[], Awaitable[ModbusPDU]], function: int, what: str) -> ModbusPDU:
        """Return the checked answer: pymodbus accepts any function code, and the number 0, which no request has.

        If the link is lost, pymodbus raises at the call, before there is anything to await.
        """
        try:
            answer = await cancellable(request())
        except (ModbusException, OSError) as error:
            await self.close()
            raise LinkError(f"{self._name}: does not answer: {error}") from error
        if answer.isError():
            raise ProtocolError(f"{self._name}: refuses to {what}: {answer}. Check the addresses in the profile.")
        if answer.function_code != function or not answer.transaction_id:
            said = f"function {answer.function_code}, number {answer.transaction_id}"
            raise ProtocolError(f"{self._name}: the request to {what} received the answer {said}. Check the server.")
        return answer


def _value(name: str, one: ModbusAddress, words: list[int], first: int) -> Value:
    at = one.address - first
    return of_kind(one.kind, one.value(words[at : at + one.count]), name)


def _strict(response: type[ModbusPDU]) -> type[ModbusPDU]:
    """Return an answer class that is empty if its length is wrong: pymodbus accepts a short answer."""

    class Strict(response):  # type: ignore[misc, valid-type]
        def decode(self, data: bytes) -> None:
            if data and data[0] == len(data) - 1:
                super().decode(data)

    return Strict
