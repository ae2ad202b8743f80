"""The PLC's variables over ADS: AMS/TCP frames, symbols by name, and sums of reads and writes."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.handover.plc import Plc, Value
from polishd.sim_backends.wire import Feed

TCP_PORT = 48898
AMS_PORT = 851
PREFIX = "GVL_polishd."
NAME = b"polishd sim PLC"
_TCP = struct.Struct("<HI")
_AMS = struct.Struct("<6sH6sHHHIII")
_SYMBOL = struct.Struct("<IIIIIIHHH")
DEVICE_INFO, READ, WRITE, STATE, READ_WRITE = 1, 2, 3, 4, 9
INFO_BY_NAME, SUM_READ, SUM_WRITE, DATA = 0xF009, 0xF080, 0xF081, 0x4040
OK, NO_SERVICE, NO_GROUP, BAD_SIZE, NO_SYMBOL = 0, 0x701, 0x702, 0x705, 0x710
RESPONSE = 0x0005
STRING_BYTES = 256
ADS_TYPES: dict[str, tuple[str, int, str]] = {
    "bool": ("BOOL", 33, "?"),
    "uint16": ("UINT", 18, "<H"),
    "uint32": ("UDINT", 19, "<I"),
    "double": ("LREAL", 5, "<d"),
    "string": (f"STRING({STRING_BYTES - 1})", 30, ""),
}
"""Name in the PLC, number of the type, how it is packed."""
KINDS = {
    "start": "bool", "hold": "bool", "reset": "bool", "load": "bool", "program": "string", "heartbeat": "uint32",
    "state": "uint16", "line": "uint32", "line_began": "double", "state_began": "double", "clock": "double",
    "loaded": "string", "feed_override": "double", "feed_hold": "bool", "in_motion": "bool", "alarm": "uint32",
    "alarm_text": "string", "controller_heartbeat": "uint32", "session": "string",
}  # fmt: skip
_NAMES = list(KINDS)


@dataclass(slots=True)
class AdsServer:
    """Answers on any number of connections."""

    plc: Plc

    def connected(self, outlet: FaultyLink) -> Feed:
        """What takes the bytes of a client."""
        rest = b""

        def feed(data: bytes) -> None:
            nonlocal rest
            rest += data
            while len(rest) >= _TCP.size:
                _, length = _TCP.unpack_from(rest)
                if len(rest) < _TCP.size + length:
                    return
                frame, rest = rest[_TCP.size : _TCP.size + length], rest[_TCP.size + length :]
                if len(frame) >= _AMS.size:
                    outlet.send(self._answer(frame))

        return feed

    def _answer(self, frame: bytes) -> bytes:
        target, target_port, source, source_port, command, _, _, _, invoke = _AMS.unpack_from(frame)
        body = self._command(command, frame[_AMS.size :])
        head = _AMS.pack(source, source_port, target, target_port, command, RESPONSE, len(body), 0, invoke)
        return _TCP.pack(0, len(head) + len(body)) + head + body

    def _command(self, command: int, data: bytes) -> bytes:
        if command == DEVICE_INFO:
            return struct.pack("<IBBH16s", OK, 3, 1, 4024, NAME)
        if command == STATE:
            return struct.pack("<IHH", OK, 5, 0)
        if command == READ and len(data) == 12:
            return _with_length(*self._read(*struct.unpack("<III", data)))
        if command == WRITE and len(data) >= 12:
            group, offset, _ = struct.unpack_from("<III", data)
            return struct.pack("<I", self._write(group, offset, data[12:]))
        if command == READ_WRITE and len(data) >= 16:
            group, offset, _, _ = struct.unpack_from("<IIII", data)
            return _with_length(*self._read_write(group, offset, data[16:]))
        return struct.pack("<I", NO_SERVICE)

    def _read_write(self, group: int, offset: int, data: bytes) -> tuple[int, bytes]:
        if group == INFO_BY_NAME:
            return self._symbol(data.rstrip(b"\0").decode("utf-8", "replace"))
        if group == SUM_READ:
            asked = list(struct.iter_unpack("<III", data[: 12 * offset]))
            found = [self._read(*one) for one in asked]
            errors = struct.pack(f"<{len(found)}I", *(error for error, _ in found))
            sized = (value.ljust(size, b"\0") for (_, value), (_, _, size) in zip(found, asked, strict=True))
            return OK, errors + b"".join(sized)
        if group == SUM_WRITE:
            asked = list(struct.iter_unpack("<III", data[: 12 * offset]))
            at, said = 12 * offset, b""
            for one_group, one_offset, size in asked:
                said += struct.pack("<I", self._write(one_group, one_offset, data[at : at + size]))
                at += size
            return OK, said
        return NO_GROUP, b""

    def _symbol(self, symbol: str) -> tuple[int, bytes]:
        name = symbol.removeprefix(PREFIX)
        if not symbol.startswith(PREFIX) or name not in KINDS:
            return NO_SYMBOL, b""
        plc_type, number, _ = ADS_TYPES[KINDS[name]]
        texts = b"".join(text.encode() + b"\0" for text in (symbol, plc_type, ""))
        at = _NAMES.index(name) * STRING_BYTES
        lengths = (len(symbol), len(plc_type), 0)
        return OK, _SYMBOL.pack(_SYMBOL.size + len(texts), DATA, at, _size(name), number, 0, *lengths) + texts

    def _read(self, group: int, offset: int, size: int) -> tuple[int, bytes]:
        name = _at(group, offset)
        if not name:
            return NO_GROUP, b""
        if size != _size(name):
            return BAD_SIZE, b""
        value = self.plc.inputs[name] if name in self.plc.inputs else self.plc.shown[name]
        return OK, _packed(name, value)

    def _write(self, group: int, offset: int, data: bytes) -> int:
        name = _at(group, offset)
        if name not in self.plc.inputs:
            return NO_GROUP
        if len(data) != _size(name):
            return BAD_SIZE
        self.plc.inputs[name] = _unpacked(name, data)
        return OK


def _at(group: int, offset: int) -> str:
    number, within = divmod(offset, STRING_BYTES)
    return _NAMES[number] if group == DATA and not within and number < len(_NAMES) else ""


def _size(name: str) -> int:
    form = ADS_TYPES[KINDS[name]][2]
    return struct.calcsize(form) if form else STRING_BYTES


def _packed(name: str, value: Value) -> bytes:
    form = ADS_TYPES[KINDS[name]][2]
    if not form:
        return str(value).encode()[: STRING_BYTES - 1].ljust(STRING_BYTES, b"\0")
    return struct.pack(form, value)


def _unpacked(name: str, data: bytes) -> Value:
    form = ADS_TYPES[KINDS[name]][2]
    if not form:
        return data.partition(b"\0")[0].decode("utf-8", "replace")
    value: Value = struct.unpack(form, data)[0]
    return value


def _with_length(error: int, data: bytes) -> bytes:
    return struct.pack("<II", error, len(data)) + data
