"""The device side of numbered lines: the framing of docs/protocols/loader.md, for devices that only answer."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from polishd.config.simulator import SimLineSection
from polishd.sim_backends.common.framing import MAX_LINE, body, line
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire

Answer = Callable[[str], str]
"""Returns the answer to a request."""


class LineDeviceModel(Protocol):
    """The machine behind the line."""

    def step(self, now_s: float) -> None:
        """Advance to the present."""
        ...


@dataclass(slots=True)
class NumberedSlave:
    """Answer each intact line by one line."""

    answer: Answer
    _buffer: bytes = b""

    def feed(self, data: bytes) -> Iterable[bytes]:
        """Return the answer to each whole request."""
        self._buffer += data
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            number, _, request = (body(raw.rstrip(b"\r")) or "").partition(",")
            if number.isdigit() and int(number) <= 65535:
                yield line(f"{number},{self.answer(request)}")
        self._buffer = self._buffer[-MAX_LINE:]


async def serve(
    runtime: SimRuntime, config: SimLineSection, machine: LineDeviceModel, answer: Answer, tick_s: float
) -> None:
    """Answer for the machine until cancelled. It is advanced before each answer and every ``tick_s``."""

    def receiver(outlet: FaultyLink) -> Feed:
        slave = NumberedSlave(answer)

        def feed(data: bytes) -> None:
            machine.step(time.monotonic())
            for reply in slave.feed(data):
                outlet.send(reply)

        return feed

    wire = SimWire(runtime, receiver)
    wire.ready(await wire.open_line(config))
    while True:
        machine.step(time.monotonic())
        await asyncio.sleep(tick_s)
