"""The drive's object dictionary and its SDO server (CiA 301): expedited transfers, checked as a drive does."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

U8, U16, U32, I8, I16, I32 = "<B", "<H", "<I", "<b", "<h", "<i"

UNKNOWN_COMMAND, READ_ONLY, NO_OBJECT, NO_SUB, WRONG_LENGTH, RANGE, DEVICE_STATE = (
    0x05040001,
    0x06010002,
    0x06020000,
    0x06090011,
    0x06070010,
    0x06090030,
    0x08000022,
)
_SDO = struct.Struct("<BHB4s")

Key = tuple[int, int]
"""(index, sub)."""

# (index, sub): (type, writable, value at power-up)
OBJECTS: dict[Key, tuple[str, bool, int]] = {
    (0x1000, 0): (U32, False, 0x00020192),
    (0x1001, 0): (U8, False, 0),
    (0x1016, 0): (U8, False, 1),
    (0x1016, 1): (U32, True, 0),
    (0x1017, 0): (U16, True, 0),
    (0x1018, 0): (U8, False, 4),
    (0x1018, 1): (U32, False, 0x506F),
    (0x1018, 2): (U32, False, 0x0402),
    (0x1018, 3): (U32, False, 0x00010002),
    (0x1018, 4): (U32, False, 4020),
    (0x6007, 0): (I16, True, 1),
    (0x603F, 0): (U16, False, 0),
    (0x6040, 0): (U16, True, 0),
    (0x6041, 0): (U16, False, 0),
    (0x605A, 0): (I16, True, 2),
    (0x6060, 0): (I8, True, 0),
    (0x6061, 0): (I8, False, 0),
    (0x6064, 0): (I32, False, 0),
    (0x606C, 0): (I32, False, 0),
    (0x6071, 0): (I16, True, 0),
    (0x6072, 0): (U16, True, 1500),
    (0x6077, 0): (I16, False, 0),
    (0x607A, 0): (I32, True, 0),
    (0x6080, 0): (U32, True, 6000),
    (0x6081, 0): (U32, True, 1000),
    (0x6083, 0): (U32, True, 10000),
    (0x6084, 0): (U32, True, 10000),
    (0x6085, 0): (U32, True, 50000),
    (0x6087, 0): (U32, True, 1000),
    (0x60FF, 0): (I32, True, 0),
    (0x6502, 0): (U32, False, 0b1101),
}
RANGES = {(0x6007, 0): (0, 3), (0x605A, 0): (0, 6), (0x6060, 0): (0, 4), (0x6071, 0): (-1500, 1500)}
"""What may be written, where that is less than the type holds."""


@dataclass(slots=True)
class Objects:
    """The values of one drive; anything in it may change them, a client what is writable."""

    on_write: Callable[[Key, int], int] = lambda _key, _value: 0
    """Told before a client's value is taken; an abort code refuses it."""
    values: dict[Key, int] = field(default_factory=lambda: {key: value for key, (_, _, value) in OBJECTS.items()})

    def __getitem__(self, index: int) -> int:
        return self.values[index, 0]

    def __setitem__(self, index: int, value: int) -> None:
        self.values[index, 0] = value

    def serve(self, request: bytes) -> bytes | None:
        """Answer a client's eight bytes; None: nothing is to be said."""
        specifier, index, sub, data = _SDO.unpack(request)
        key = (index, sub)
        if specifier == 0x80:
            return None
        if specifier >> 5 not in {1, 2}:
            return self._abort(key, UNKNOWN_COMMAND)
        if key not in self.values:
            return self._abort(key, NO_SUB if any(index == known for known, _ in self.values) else NO_OBJECT)
        if specifier == 0x40:
            return self._read(key)
        return self._write(key, specifier, data)

    def _read(self, key: Key) -> bytes:
        data = struct.pack(OBJECTS[key][0], self.values[key])
        return _SDO.pack(0x43 | (4 - len(data)) << 2, *key, data.ljust(4, b"\0"))

    def _write(self, key: Key, specifier: int, data: bytes) -> bytes:
        kind, writable, _ = OBJECTS[key]
        size = struct.calcsize(kind)
        if not writable:
            return self._abort(key, READ_ONLY)
        if specifier != 0x23 | (4 - size) << 2:
            return self._abort(key, WRONG_LENGTH)
        (value,) = struct.unpack(kind, data[:size])
        low, high = RANGES.get(key, (value, value))
        code = self.on_write(key, value) if low <= value <= high else RANGE
        if code:
            return self._abort(key, code)
        self.values[key] = value
        return _SDO.pack(0x60, *key, bytes(4))

    def _abort(self, key: Key, code: int) -> bytes:
        return _SDO.pack(0x80, *key, struct.pack("<I", code))
