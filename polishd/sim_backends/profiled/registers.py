"""A profile's registers, as a Modbus slave has them."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from polishd.sim_backends.profiled.machine import ProfileDeviceModel
from polishd.sim_backends.profiled.sheet import SimDeviceProfile

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4
CODES = {"range": ILLEGAL_VALUE, "fault": DEVICE_FAILURE}
TABLES = {1: "coil", 2: "discrete", 3: "holding", 4: "input", 5: "coil", 6: "holding", 15: "coil", 16: "holding"}
FORMAT = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}
WORDS = {"u32": 2, "i32": 2, "f32": 2}


@dataclass(slots=True)
class ProfileRegisters:
    """Answers requests by what the machine is, and turns writes into its orders."""

    sheet: SimDeviceProfile
    machine: ProfileDeviceModel
    stored: dict[str, float] = field(default_factory=dict)
    """What was written last, by register."""

    def answer(self, pdu: bytes) -> bytes:
        """The answer to a request PDU."""
        self.machine.heard()
        function = pdu[0]
        if function in {1, 2, 3, 4} and len(pdu) == 5:
            result = self._read(function, *struct.unpack(">HH", pdu[1:]))
        elif function in {5, 6} and len(pdu) == 5:
            address, value = struct.unpack(">HH", pdu[1:])
            result = self._write(TABLES[function], address, [value != 0 if function == 5 else value]) or pdu
        elif function in {15, 16} and len(pdu) == 6 + pdu[5]:
            address, count = struct.unpack(">HH", pdu[1:5])
            many = _bits(pdu[6:], count) if function == 15 else list(struct.unpack(f">{count}H", pdu[6:]))
            result = self._write(TABLES[function], address, many) or pdu[:5]
        else:
            result = ILLEGAL_FUNCTION
        return bytes([function | 0x80, result]) if isinstance(result, int) else result

    @property
    def _map(self) -> Mapping[str, Mapping[str, Any]]:
        registers: Mapping[str, Mapping[str, Any]] = self.sheet.raw["registers"]
        return registers

    def _read(self, function: int, address: int, count: int) -> bytes | int:
        table = self._cells(TABLES[function])
        values = [table.get(address + at) for at in range(count)]
        if not 1 <= count <= self.sheet.raw["modbus"].get("most", 125) or None in values:
            return ILLEGAL_ADDRESS
        words = [value or 0 for value in values]
        if function > 2:
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
        packed = sum(bool(word) << at for at, word in enumerate(words)).to_bytes(-(-count // 8), "little")
        return bytes([function, len(packed)]) + packed

    def _cells(self, table: str) -> dict[int, int]:
        """Word (or bit) by address."""
        machine = self.machine
        said = self.stored | self.sheet.words(machine.values(), machine.state(), silent=machine.watchdog_fault())
        cells: dict[int, int] = {}
        for name, register in self._map.items():
            if register.get("table", "holding") == table:
                for at, word in enumerate(self._words(register, said.get(name, 0))):
                    cells[register["address"] + at] = word
        return cells

    def _words(self, register: Mapping[str, Any], value: float | str) -> list[int]:
        kind = register.get("type", "u16")
        if kind == "bit":
            return [int(bool(value))]
        if kind == "text":
            size = 2 * register.get("words", 1)
            data = str(value).encode()[:size].ljust(size, b"\0")
        else:
            number = float(value)
            data = struct.pack(FORMAT[kind], number if kind == "f32" else round(number))
        words = list(struct.unpack(f">{len(data) // 2}H", data))
        return words[::-1] if self._low_first(register) and kind != "text" else words

    def _write(self, table: str, address: int, values: list[int]) -> int:
        """0, or the exception code of the first refusal."""
        while values:
            found = [
                (name, register)
                for name, register in self._map.items()
                if (register.get("table", "holding"), register["address"]) == (table, address)
            ]
            if not found or len(values) < (size := WORDS.get(found[0][1].get("type", ""), 1)):
                return ILLEGAL_ADDRESS
            code = self._store(*found[0], values[:size])
            if code:
                return code
            values, address = values[size:], address + size
        return 0

    def _store(self, name: str, register: Mapping[str, Any], words: list[int]) -> int:
        kind = register.get("type", "u16")
        if kind == "bit":
            number = float(words[0])
        else:
            ordered = words[::-1] if self._low_first(register) else words
            data = struct.pack(f">{len(ordered)}H", *ordered)
            number = float(struct.unpack(FORMAT[kind], data)[0])
        before = self.stored.get(name)
        self.stored[name] = number
        order = self.sheet.written(name, self.stored)
        refusal = self.machine.order(*order) if order else self._foreign(name)
        if refusal and before is not None:
            self.stored[name] = before
        if order and order[0] == "beat":
            self.stored["beat_echo"] = number
        return CODES[refusal] if refusal else 0

    def _foreign(self, name: str) -> str:
        """A value that makes no order whole: fine where an order has it, where it is 0, or where no order writes."""
        steps = [step for _, all_steps in self.sheet.orders() for step in all_steps]
        values = [step.split("=")[1].strip() for step in steps if step.split("=")[0].strip() == name]
        known = not values or self.stored[name] == 0.0
        known = known or any(
            value in {"asked", "count"} or float(int(value, 0)) == self.stored[name] for value in values
        )
        return "" if known else "range"

    def _low_first(self, register: Mapping[str, Any]) -> bool:
        order = register.get("word_order", self.sheet.raw["modbus"].get("word_order", "high_first"))
        return bool(order == "low_first")


def _bits(data: bytes, count: int) -> list[int]:
    whole = int.from_bytes(data, "little")
    return [whole >> at & 1 for at in range(count)]
