"""Fake CAN adapters with a drive on their bus: slcan and socketcand."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable
from typing import Protocol

from tests.fakes.wires import Peer


class Drive(Protocol):
    """Node on the bus."""

    send: Callable[[int, bytes], None]

    def on_frame(self, identifier: int, data: bytes) -> None:
        """Receive a frame from the bus."""


class BeatingNode:
    """Node that sends its heartbeat and answers nothing."""

    def __init__(self, node: int = 5) -> None:
        self.send: Callable[[int, bytes], None] = lambda identifier, data: None
        self._node = node
        self._timer = asyncio.get_running_loop().call_later(0.1, self._tick)

    def stop(self) -> None:
        """Switch the node off."""
        self._timer.cancel()

    def on_frame(self, identifier: int, data: bytes) -> None:
        """Receive a frame from the bus."""

    def _tick(self) -> None:
        self.send(0x700 + self._node, b"\x05")
        self._timer = asyncio.get_running_loop().call_later(0.1, self._tick)


class SlcanPeer(Peer):
    """Drive behind a serial adapter (slcan)."""

    def __init__(self, drive: Drive) -> None:
        super().__init__()
        self.drive = drive
        self.adapter: list[bytes] = []
        self._bytes = b""
        drive.send = lambda identifier, data: self.send(f"t{identifier:03x}{len(data)}{data.hex()}\r".encode())

    def on_bytes(self, data: bytes) -> None:
        *lines, self._bytes = (self._bytes + data).split(b"\r")
        for line in lines:
            if line[:1] == b"t":
                size = int(line[4:5])
                self.drive.on_frame(int(line[1:4], 16), bytes.fromhex(line[5 : 5 + 2 * size].decode()))
            else:
                self.adapter.append(line)


class SocketcandPeer(Peer):
    """Drive behind a socketcand server."""

    def __init__(self, drive: Drive) -> None:
        super().__init__()
        self.drive = drive
        self.greeting = b"< hi >"
        self._raw = False
        self._bytes = ""
        drive.send = self._frame

    def on_connect(self) -> None:
        self._raw, self._bytes = False, ""
        self.write(self.greeting)

    def on_bytes(self, data: bytes) -> None:
        self._bytes += data.decode()
        while match := re.match(r"\s*< (\w+) ?([^>]*)>", self._bytes):
            self._bytes = self._bytes[match.end() :]
            verb, rest = match.groups()
            if verb == "send":
                identifier, _, *octets = rest.split()
                self.drive.on_frame(int(identifier, 16), bytes(int(octet, 16) for octet in octets))
            else:
                self._raw = verb == "rawmode"
                self.write(b"< ok >")

    def _frame(self, identifier: int, data: bytes) -> None:
        if self._raw:
            self.send(f"< frame {identifier:03X} {time.time():.6f} {data.hex().upper()} >".encode())
