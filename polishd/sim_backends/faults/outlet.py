"""Frames on their way through a link: late, lost and damaged as the script says, and at the pace of the line."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from polishd.sim_backends.faults.protocols import PROTOCOLS
from polishd.sim_backends.faults.script import FaultScript, FrameAction, LinkDirection


@dataclass(eq=False, slots=True)
class FaultyLink:
    """One direction of one connection. Where ``byte_s`` is above 0, it has the pace of a serial line."""

    write: Callable[[bytes], None]
    script: FaultScript
    way: LinkDirection
    byte_s: float = 0.0
    chunk: int = 16
    backlog: Callable[[], int] = lambda: 0
    """Bytes that the other end has not taken yet."""
    on_closed: Callable[[], None] = lambda: None
    """Told when nobody is at the other end any more."""
    closed: bool = False
    _queue: asyncio.Queue[tuple[float, bytes]] = field(default_factory=asyncio.Queue)
    _under_way: int = 0
    _rest: bytes = b""
    """The begin of a frame."""

    def send(self, data: bytes, delay_s: float = 0.0) -> None:
        """Send after a delay; never waits."""
        if self.closed:
            return
        if not (self.script.troubles or self.byte_s or delay_s or self._under_way or self._rest):
            self.write(data)
        else:
            self._under_way += 1
            self._queue.put_nowait((delay_s, data))

    async def run(self) -> None:
        """Work off the queue, for ever."""
        loop = asyncio.get_running_loop()
        while True:
            wait_s, data = await self._queue.get()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
            for frame in self._frames(data):
                await self._pass(self.script.treat(frame, self.way, loop.time()), loop)
            self._under_way -= 1

    def _frames(self, data: bytes) -> Iterator[bytes]:
        """Whole frames; without a script, what is there."""
        self._rest += data
        while self._rest:
            size = PROTOCOLS[self.way.protocol].cut(self._rest) if self.script.troubles else len(self._rest)
            if not size:
                return
            frame, self._rest = self._rest[:size], self._rest[size:]
            yield frame

    async def _pass(self, fate: FrameAction, loop: asyncio.AbstractEventLoop) -> None:
        free_s = loop.time() + fate.delay_s
        byte_s = max(self.byte_s, fate.byte_s)
        step = 1 if fate.byte_s else self.chunk if byte_s else max(len(fate.data), 1)
        for _ in range(fate.copies):
            if fate.late_s:
                loop.call_later(fate.late_s, self._late, fate.data)
                continue
            for start in range(0, len(fate.data), step):
                part = fate.data[start : start + step]
                free_s += len(part) * byte_s
                if free_s > loop.time():
                    await asyncio.sleep(free_s - loop.time())
                self.write(part)

    def _late(self, data: bytes) -> None:
        if not self.closed:
            self.write(data)
