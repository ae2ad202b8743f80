"""Bad wire between a client and a robot, which drops, damages and repeats frames of the robot link, both ways."""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from tests.fakes.robot import BLOCKS


class Wire:
    """Proxy that drops and damages a share of all frames, repeats some with blocks, cuts connections, and can stall."""

    def __init__(self, port: int, seed: int, *, drop: float, damage: float, repeat: float, cut_every: int) -> None:
        self._target = port
        self._chance = random.Random(seed)
        self._drop, self._damage, self._repeat, self._cut_every = drop, damage, repeat, cut_every
        self.port = 0
        self.flows = asyncio.Event()
        self.flows.set()
        self.frames = self.dropped = self.damaged = self.repeated = self.cuts = 0

    async def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Forward frames both ways until either end has closed."""
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
        except OSError:
            writer.transport.abort()
            return
        ways = [asyncio.ensure_future(self._pump(*way)) for way in ((reader, far_writer), (far_reader, writer))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            for end in (writer, far_writer):
                end.transport.abort()

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = await source.readexactly(8)
                frame = head + await source.readexactly(int.from_bytes(head[4:], "big") + 4)
                await self.flows.wait()
                self.frames += 1
                if self._cut_every and self.frames % self._cut_every == 0:
                    self.cuts += 1
                    return
                sink.write(self._treated(frame))
                await sink.drain()

    def _treated(self, frame: bytes) -> bytes:
        luck = self._chance.random()
        if luck < self._drop:
            self.dropped += 1
            return b""
        if luck < self._drop + self._damage:
            self.damaged += 1
            broken = bytearray(frame)
            broken[self._chance.randrange(len(broken))] ^= 1 << self._chance.randrange(8)
            return bytes(broken)
        if frame[2] == BLOCKS and luck > 1.0 - self._repeat:
            self.repeated += 1
            return frame + frame
        return frame

    async def stall(self, seconds: float, every_s: float) -> None:
        """Block all frames repeatedly for a time."""
        while True:
            await asyncio.sleep(every_s - seconds)
            self.flows.clear()
            await asyncio.sleep(seconds)
            self.flows.set()


@asynccontextmanager
async def wire(
    port: int, seed: int = 1, *, drop: float = 0.0, damage: float = 0.0, repeat: float = 0.0, cut_every: int = 0
) -> AsyncIterator[Wire]:
    """Run a wire to that port for the duration of the block."""
    link = Wire(port, seed, drop=drop, damage=damage, repeat=repeat, cut_every=cut_every)
    server = await asyncio.start_server(link.connected, "127.0.0.1", 0)
    link.port = server.sockets[0].getsockname()[1]
    try:
        yield link
    finally:
        server.close()
