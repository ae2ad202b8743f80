"""A Loader on numbered lines: an order begins a change, and what the loader says of itself tells its end."""

from __future__ import annotations

import asyncio
import time

from polishd.api import DeviceFault, DeviceRefused, DeviceStatus, LoaderTimes, WrongPart
from polishd.drivers.loader_line import codec
from polishd.drivers.loader_line.codec import LoaderReading, LoaderState
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.line_device import ANSWERS_S, LineDevice

LOOK_S = 0.2
"""Between two looks at a loader that moves; they feed its watchdog, too."""


class LoaderLine(LineDevice):
    """A part loader. One that moves and hears nothing more stops by itself."""

    def __init__(self, address: SerialLine | Tcp, times: LoaderTimes | None = None) -> None:
        self._times = times or LoaderTimes()
        super().__init__(address, self._times.silence_s)
        self._stops = 0

    @property
    def times(self) -> LoaderTimes:
        """See Loader."""
        return self._times

    async def _look(self) -> LoaderReading:
        """What it says of itself."""
        return codec.status(await self.ask("ST?"))

    async def status(self) -> DeviceStatus:
        """See Device. Safe means that it stands."""
        reading = await self._look()
        return DeviceStatus(
            ready=reading.state is not LoaderState.FAULT,
            safe=reading.state is not LoaderState.MOVING,
            state=reading.state.name.lower(),
            detail=reading.faults,
        )

    async def make_safe(self) -> None:
        """See Device. Stops it, and reads back that it stands; a link lost over it is opened again once."""
        self._stops += 1
        await self._rest(self._stop, self._times.stop_s + ANSWERS_S, "could not confirm that the loader stands")

    async def loaded(self) -> str | None:
        """See Loader."""
        return (await self._look()).seat

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
            raise WrongPart(f"{self.name}: the loader has no part {part_id!r}; put it in") from refusal

    async def _change(self, request: str) -> None:
        stops, deadline, over = self._stops, time.monotonic() + self._times.change_s, f"over {request}"
        self._require_sound(await self._look(), over)
        await self._order(request)
        while (reading := await self._look()).state is not LoaderState.IDLE:
            self._require_sound(reading, over)
            if reading.state is LoaderState.STOPPED or self._stops != stops:
                raise DeviceRefused(f"{self.name}: was stopped {over}")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self.name}: not done after {self._times.change_s:g} s {over}; look at it")
            await asyncio.sleep(LOOK_S)

    def _require_sound(self, reading: LoaderReading, over: str) -> None:
        if reading.state is LoaderState.FAULT:
            what = f"{self.name}: fault {reading.fault} ({reading.faults}) {over}"
            raise DeviceFault(f"{what}; look what it holds, clear it, and reset it at the loader")

    async def _stop(self) -> None:
        await self._order("STOP")
        while True:
            if (await self._look()).state is not LoaderState.MOVING:
                return
            await asyncio.sleep(LOOK_S)
