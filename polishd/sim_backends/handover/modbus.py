"""The PLC's variables over Modbus TCP: bits and registers, a request at a time."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.handover.plc import Plc
from polishd.sim_backends.wire import Feed

_HEAD = struct.Struct(">HHHB")
COILS = ("start", "hold", "reset", "load")
DISCRETES = ("feed_hold", "in_motion")
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
FILE = "polishd.nc"
"""What it loads: a register holds no name."""


@dataclass(slots=True)
class ModbusServer:
    """Answers on any number of connections."""

    plc: Plc

    def connected(self, outlet: FaultyLink) -> Feed:
        """What takes the bytes of a client."""
        self.plc.inputs["program"] = FILE
        rest = b""

        def feed(data: bytes) -> None:
            nonlocal rest
            rest += data
            while len(rest) >= _HEAD.size:
                number, _, length, unit = _HEAD.unpack_from(rest)
                if length < 2 or len(rest) < 6 + length:
                    return
                pdu, rest = rest[_HEAD.size : 6 + length], rest[6 + length :]
                answer = self.answer(pdu)
                outlet.send(_HEAD.pack(number, 0, 1 + len(answer), unit) + answer)

        return feed

    def answer(self, pdu: bytes) -> bytes:
        """The answer to a request PDU."""
        function = pdu[0]
        if function not in {1, 2, 3, 4, 5, 6, 15, 16}:
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        if len(pdu) < 5 or (function > 6 and (len(pdu) < 6 or len(pdu) != 6 + pdu[5])):
            return bytes([function | 0x80, ILLEGAL_VALUE])
        address, number = struct.unpack_from(">HH", pdu, 1)
        if function == 5 and number not in {0, 0xFF00}:
            return bytes([function | 0x80, ILLEGAL_VALUE])
        said = {1: self._bits, 2: self._bits, 3: self._holding, 4: self._registers}.get(function)
        if said is not None:
            found = said(function, address, number)
            return bytes([function | 0x80, ILLEGAL_ADDRESS]) if found is None else bytes([function, len(found)]) + found
        if function in {5, 15}:
            many = [bool(pdu[6 + at // 8] >> at % 8 & 1) for at in range(min(number, 8 * (len(pdu) - 6)))]
            taken = self._coils(address, many if function == 15 else [number == 0xFF00])
        else:
            taken = self._heartbeat(address, pdu[6:] if function == 16 else pdu[3:])
        return pdu[:5] if taken else bytes([function | 0x80, ILLEGAL_ADDRESS])

    def _bits(self, function: int, address: int, count: int) -> bytes | None:
        names = COILS if function == 1 else DISCRETES
        values = self.plc.inputs if function == 1 else self.plc.shown
        if not count or address + count > len(names):
            return None
        return bytes([sum(bool(values[name]) << k for k, name in enumerate(names[address : address + count]))])

    def _registers(self, _function: int, address: int, count: int) -> bytes | None:
        shown = self.plc.shown
        table = struct.pack(
            ">HIHHHdddH",
            shown["state"],
            shown["line"],
            shown["alarm"],
            int(shown["controller_heartbeat"]) & 0xFFFF,
            zlib.crc32(str(shown["session"]).encode()) & 0xFFFF,
            shown["clock"],
            shown["line_began"],
            shown["state_began"],
            round(float(shown["feed_override"])),
        )
        found = table[2 * address : 2 * (address + count)]
        return found if count and len(found) == 2 * count else None

    def _holding(self, _function: int, address: int, count: int) -> bytes | None:
        beat = struct.pack(">H", int(self.plc.inputs["heartbeat"]) & 0xFFFF)
        return beat if (address, count) == (0, 1) else None

    def _coils(self, address: int, values: list[bool]) -> bool:
        names = COILS[address : address + len(values)]
        if not values or len(names) != len(values):
            return False
        self.plc.inputs.update(zip(names, values, strict=True))
        return True

    def _heartbeat(self, address: int, data: bytes) -> bool:
        if address or len(data) != 2:
            return False
        (self.plc.inputs["heartbeat"],) = struct.unpack(">H", data)
        return True
