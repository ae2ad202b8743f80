"""Mischief on a link: late, lost and damaged frames, deterministic by seed, in the order they were sent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import Faults


@dataclass(slots=True)
class Mischief:
    """Decides what becomes of each frame."""

    faults: Faults
    rng: np.random.Generator

    @property
    def idle(self) -> bool:
        """Whether nothing ever happens to a frame."""
        f = self.faults
        return not (f.jitter_s or (f.late_rate and f.late_s) or f.drop_rate or f.garble_rate)

    def treat(self, frame: bytes) -> tuple[float, bytes]:
        """(delay before it is sent, what is sent; empty = lost)."""
        luck = self.rng.random(5)
        f = self.faults
        delay = f.jitter_s * luck[0] + (f.late_s if luck[1] < f.late_rate else 0.0)
        if luck[2] < f.drop_rate:
            return delay, b""
        if luck[3] < f.garble_rate and frame:
            damaged = bytearray(frame)
            damaged[int(luck[4] * len(frame))] ^= 1 << int(luck[0] * 8)
            frame = bytes(damaged)
        return delay, frame


@dataclass(eq=False, slots=True)
class Outlet:
    """Sends frames in order with mischief and, where ``byte_s`` is above 0, at the pace of a serial line."""

    write: Callable[[bytes], None]
    mischief: Mischief
    byte_s: float = 0.0
    chunk: int = 16
    backlog: Callable[[], int] = lambda: 0
    """Bytes that the other end has not taken yet."""
    on_closed: Callable[[], None] = lambda: None
    """Told when nobody is at the other end any more."""
    closed: bool = False
    _queue: asyncio.Queue[tuple[float, bytes]] = field(default_factory=asyncio.Queue)

    def send(self, frame: bytes, delay_s: float = 0.0) -> None:
        """Send after a delay; never waits."""
        if self.closed:
            return
        if self.mischief.idle and not self.byte_s and not delay_s and self._queue.empty():
            self.write(frame)
        else:
            self._queue.put_nowait((delay_s, frame))

    async def run(self) -> None:
        """Work off the queue, for ever."""
        loop = asyncio.get_running_loop()
        while True:
            wait, frame = await self._queue.get()
            delay, frame = self.mischief.treat(frame)
            free = loop.time() + wait + delay
            for start in range(0, len(frame), self.chunk):
                part = frame[start : start + self.chunk]
                free += len(part) * self.byte_s
                if free > loop.time():
                    await asyncio.sleep(free - loop.time())
                self.write(part)
