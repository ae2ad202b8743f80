"""The primary client interface: scripts go up as text, and what the controller has to complain of comes back."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

from polishd.api import ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.streams import open_stream

CONNECT_S = 0.8
PRIMARY_PACKET_BYTES = 1 << 20
BYTES_S, PIECE = 1e6, 1 << 16
"""A slow controller takes so many bytes a second."""
QUIET_S = 5.0
"""It tells its state ten times a second."""
_HEAD = struct.Struct(">iB")
_MESSAGE = struct.Struct(">QbB")
_WHERE = struct.Struct(">ii")
ROBOT_MESSAGE, RUNTIME_EXCEPTION = 20, 10


@dataclass(frozen=True, slots=True)
class ControllerMessage:
    """Why a script does not run."""

    line: int
    """1-based, of the script; 0 where it does not say."""
    text: str


class MessageReader:
    """Cuts the stream into messages and keeps the complaints."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[ControllerMessage]:
        """The complaints in what is complete. ProtocolError where a length cannot be."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if not _HEAD.size <= size <= PRIMARY_PACKET_BYTES:
                raise ProtocolError(f"primary interface: a message of {size} bytes")
            if len(self._bytes) < size:
                return
            payload = bytes(self._bytes[_HEAD.size : size])
            del self._bytes[:size]
            if kind == ROBOT_MESSAGE and (found := _complaint(payload)) is not None:
                yield found


def _complaint(payload: bytes) -> ControllerMessage | None:
    if len(payload) < _MESSAGE.size + _WHERE.size or _MESSAGE.unpack_from(payload)[2] != RUNTIME_EXCEPTION:
        return None
    line, _column = _WHERE.unpack_from(payload, _MESSAGE.size)
    text = payload[_MESSAGE.size + _WHERE.size :].decode("utf-8", "replace").strip("\0 \r\n")
    return ControllerMessage(max(line, 0), text)


class ScriptUpload(Background):
    """One script on its way; as a context it is sent, and listened to for complaints."""

    def __init__(self, address: Tcp, script: bytes) -> None:
        super().__init__(str(address))
        self._address = address
        self._script = script
        self.complaint: ControllerMessage | None = None
        """The first one."""

    async def __aenter__(self) -> Self:
        await self.start(self._run, CONNECT_S + len(self._script) / BYTES_S)
        return self

    async def __aexit__(self, *_error: object) -> None:
        await self.stop()

    async def _run(self, ready: Ready) -> None:
        stream = await open_stream(self._address, CONNECT_S)
        try:
            for at in range(0, len(self._script), PIECE):
                await stream.write(self._script[at : at + PIECE])
            ready()
            reader = MessageReader()
            while True:
                for complaint in reader.feed(await stream.read(1 << 16, QUIET_S)):
                    self.complaint = self.complaint or complaint
        finally:
            await stream.close()
