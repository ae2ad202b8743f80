"""Where a controller's variables are in Modbus, and how they are packed there. Sans-IO."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, cast

from polishd.api import ConfigError
from polishd.config.controller_profile import Kind, Value, Variable

Table = Literal["coil", "discrete", "holding", "input"]
BITS: tuple[Table, ...] = ("coil", "discrete")
_FORMS: dict[Kind, str] = {
    "bool": ">H", "int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float": ">f", "double": ">d",
}  # fmt: skip
MOST = {"coil": 2000, "discrete": 2000, "holding": 125, "input": 125}
"""What one request may read."""


@dataclass(frozen=True, slots=True)
class ModbusAddress:
    """A variable's registers, or its bit."""

    table: Table
    address: int
    kind: Kind
    little: bool
    """The word of least weight comes first."""

    @property
    def count(self) -> int:
        """Registers, or bits."""
        return 1 if self.table in BITS else struct.calcsize(_FORMS[self.kind]) // 2

    def value(self, words: Sequence[int]) -> Value:
        """What stands in its registers."""
        if self.table in BITS:
            return bool(words[0])
        ordered = reversed(words) if self.little else words
        found: Value = struct.unpack(_FORMS[self.kind], struct.pack(f">{self.count}H", *ordered))[0]
        return bool(found) if self.kind == "bool" else found

    def words(self, value: Value) -> list[int]:
        """Its registers with that value."""
        if self.table in BITS:
            return [int(bool(value))]
        words = list(struct.unpack(f">{self.count}H", struct.pack(_FORMS[self.kind], value)))
        return words[::-1] if self.little else words


def place(name: str, variable: Variable, *, little: bool) -> ModbusAddress:
    """Where a variable is. ConfigError where the profile's address is none, or its type has no place there."""
    table, _, number = variable.address.partition(":")
    if table not in MOST or not number.isdecimal() or int(number) > 65535:
        raise ConfigError(
            f"variables.{name}.address {variable.address!r}: write holding:40, input:7, coil:3 or discrete:0 (from 0)"
        )
    if variable.type == "string" or (table in BITS and variable.type != "bool"):
        raise ConfigError(f"variables.{name}.type {variable.type!r}: has no place among the {table}s of Modbus")
    return ModbusAddress(cast("Table", table), int(number), variable.type, little)


def spans(places: Mapping[str, ModbusAddress]) -> dict[Table, tuple[int, int]]:
    """(first, count) of each table that holds any of them: each is read in one request, so that it is of one moment.

    ConfigError where one request cannot.
    """
    found: dict[Table, tuple[int, int]] = {}
    for table in sorted({place.table for place in places.values()}):
        own = [place for place in places.values() if place.table == table]
        first = min(place.address for place in own)
        count = max(place.address + place.count for place in own) - first
        if count > MOST[table]:
            raise ConfigError(
                f"variables: {table}s {first} to {first + count - 1} are more than the {MOST[table]} of one request: "
                "have the controller put them nearer together"
            )
        found[table] = (first, count)
    return found
