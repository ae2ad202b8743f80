"""A Loader on numbered lines: an order begins a change, and what the loader says of itself tells its end."""

from __future__ import annotations

import asyncio
import contextlib
import time

from polishd.api import (
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    Identity,
    LinkError,
    LoaderTimes,
    ProtocolError,
    WrongPart,
)
from polishd.drivers.loader_line import codec
from polishd.drivers.loader_line.codec import Reading, State
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.numbered import NumberedLines, identity

LOOK_S = 0.2
"""Between two looks at a loader that moves; they feed its watchdog, too."""
ANSWERS_S = 2.0
"""Beyond the stop itself: a link that is lost over it is opened again once."""


class LoaderLine:
    """A part loader. A link that is lost stays so until ``open``; only ``make_safe`` tries to reach it again."""

    def __init__(self, address: SerialLine | Tcp, times: LoaderTimes | None = None) -> None:
        self._times = times or LoaderTimes()
        self._lines = NumberedLines(address, self._times.silence_s)
        self._turn = asyncio.Lock()
        self._stops = 0

    @property
    def times(self) -> LoaderTimes:
        """See Loader."""
        return self._times

    async def open(self) -> None:
        """See Device."""
        await self._lines.connect()
        try:
            await self._read()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device. A loader that moves and hears nothing more stops by itself."""
        await self._lines.disconnect()

    async def identify(self) -> Identity:
        """See Device."""
        return identity(await self._ask("ID?"))

    async def status(self) -> DeviceStatus:
        """See Device. Safe means that it stands."""
        reading = await self._read()
        return DeviceStatus(
            ready=reading.state is not State.FAULT,
            safe=reading.state is not State.MOVING,
            state=reading.state.name.lower(),
            detail=reading.faults,
        )

    async def make_safe(self) -> None:
        """See Device. Stops it, and reads back that it stands; a link lost over it is opened again once."""
        self._stops += 1
        opened = self._lines.connected
        try:
            async with asyncio.timeout(self._times.stop_s + ANSWERS_S):
                if opened:
                    with contextlib.suppress(LinkError, ProtocolError):
                        return await self._stop()
                await self._lines.connect()
                return await self._stop()
        except TimeoutError:
            raise LinkError(f"{self._lines.name}: could not confirm that the loader stands") from None
        finally:
            if not opened:
                await self.close()

    async def loaded(self) -> str | None:
        """See Loader."""
        return (await self._read()).seat

    async def unload(self) -> None:
        """See Loader."""
        await self._change("UL")

    async def load(self, part_id: str) -> None:
        """See Loader."""
        try:
            await self._change(codec.load(part_id))
        except DeviceRefused as refusal:
            if "refused: part" not in str(refusal):
                raise
            raise WrongPart(f"{self._lines.name}: the loader has no part {part_id!r}; put it in") from refusal

    async def _change(self, request: str) -> None:
        stops, deadline, over = self._stops, time.monotonic() + self._times.change_s, f"over {request}"
        self._require_sound(await self._read(), over)
        await self._order(request)
        while (reading := await self._read()).state is not State.IDLE:
            self._require_sound(reading, over)
            if reading.state is State.STOPPED or self._stops != stops:
                raise DeviceRefused(f"{self._lines.name}: was stopped {over}")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._lines.name}: not done after {self._times.change_s:g} s {over}; look at it")
            await asyncio.sleep(LOOK_S)

    def _require_sound(self, reading: Reading, over: str) -> None:
        if reading.state is State.FAULT:
            what = f"{self._lines.name}: fault {reading.fault} ({reading.faults}) {over}"
            raise DeviceFault(f"{what}; look what it holds, clear it, and reset it at the loader")

    async def _stop(self) -> None:
        await self._order("STOP")
        while True:
            if (await self._read()).state is not State.MOVING:
                return
            await asyncio.sleep(LOOK_S)

    async def _order(self, request: str) -> None:
        answer = await self._ask(request)
        if answer != "OK":
            raise ProtocolError(f"{self._lines.name}: {request} was answered by {answer!r}")

    async def _read(self) -> Reading:
        return codec.status(await self._ask("ST?"))

    async def _ask(self, request: str) -> str:
        async with self._turn:
            return await self._lines.ask(request)
