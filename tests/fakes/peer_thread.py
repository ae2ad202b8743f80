"""Serve peers on wires from a loop in a thread, for tests of commands that run their own loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from polishd.drivers.transport.address import SerialLine
from tests.fakes.uart import sampled
from tests.fakes.wires import Peer, PtyWire, TcpWire

T = TypeVar("T")


class Served:
    """Wires that are served until ``close``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self._wires: list[PtyWire | TcpWire] = []

    def close(self) -> None:
        """Cut all wires and stop the thread."""
        for wire in self._wires:
            self.do(wire.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def do(self, work: Callable[[], Awaitable[T]]) -> T:
        """Run a coroutine in the loop of the wires and return its result."""

        async def done() -> T:
            return await work()

        return asyncio.run_coroutine_threadsafe(done(), self._loop).result()

    def serial(self, make: Callable[[], Peer], sent: SerialLine, true: SerialLine) -> Path:
        """Open a port whose device has the settings ``true`` and the computer ``sent``; return its path."""

        async def opened() -> PtyWire:
            peer = make()
            if sent != true:
                answer = peer.on_bytes
                peer.on_bytes = lambda data: answer(sampled(data, sent, true, drops_broken=True))  # type: ignore[method-assign]
                peer.filter = lambda data: [sampled(data, true, sent, drops_broken=False)]
            return PtyWire(peer, self._folder / f"port{len(self._wires)}")

        self._wires.append(wire := self.do(opened))
        return wire.path

    def tcp(self, make: Callable[[], Peer]) -> int:
        """Open a TCP port on loopback and return it."""

        async def opened() -> TcpWire:
            return await TcpWire(make()).start()

        self._wires.append(wire := self.do(opened))
        return wire.port
