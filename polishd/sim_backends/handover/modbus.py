"""The PLC's variables over Modbus TCP: bits and registers, a request at a time."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from polishd.sim_backends.faults.outlet import Outlet
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

    def connected(self, outlet: Outlet) -> Feed:
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
        if function not in {1, 2, 4, 5, 16}:
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        if len(pdu) < 5:
            return bytes([function | 0x80, ILLEGAL_VALUE])
        address, number = struct.unpack_from(">HH", pdu, 1)
        said = {1: self._bits, 2: self._bits, 4: self._registers}.get(function)
        if said is not None:
            found = said(function, address, number)
            return bytes([function | 0x80, ILLEGAL_ADDRESS]) if found is None else bytes([function, len(found)]) + found
        taken = self._coil(address, number) if function == 5 else self._heartbeat(address, number, pdu[6:])
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
            int(shown["feed_override"]),
        )
        found = table[2 * address : 2 * (address + count)]
        return found if count and len(found) == 2 * count else None

    def _coil(self, address: int, value: int) -> bool:
        if address >= len(COILS) or value not in {0, 0xFF00}:
            return False
        self.plc.inputs[COILS[address]] = value == 0xFF00
        return True

    def _heartbeat(self, address: int, count: int, data: bytes) -> bool:
        if (address, count, len(data)) != (0, 1, 2):
            return False
        (self.plc.inputs["heartbeat"],) = struct.unpack(">H", data)
        return True
