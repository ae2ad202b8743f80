"""Part loader on numbered lines. Raise ProtocolError for an answer that the protocol does not have."""

from __future__ import annotations

import asyncio
import re
import time
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated
from urllib.parse import quote, unquote

from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    LoaderTimes,
    PartLoader,
    ProtocolError,
    WrongPart,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.transport.address import SerialLine, Tcp, line_address
from polishd.drivers.transport.lines import ANSWERS_S, LineDevice

FAULTS = {1: "jammed", 2: "it has dropped a part", 4: "its guard is open", 8: "drive"}
_STATUS = re.compile(r"ST,([0-3]),(\d{1,5}),([\w.~%-]*)", re.ASCII)


class LoaderState(IntEnum):
    """States of the loader, with their numbers on the link."""

    IDLE = 0
    """Clear of the cell."""
    MOVING = 1
    STOPPED = 2
    """During a change: stopped by a command or by its watchdog."""
    FAULT = 3


@dataclass(frozen=True, slots=True)
class LoaderReading:
    """Reading of the loader."""

    state: LoaderState
    fault: int
    seat: str | None
    """The part on the seat; None: the seat is empty."""

    @property
    def faults(self) -> str:
        """Descriptions of the fault bits."""
        return ", ".join(text for bit, text in FAULTS.items() if self.fault & bit)


def load(part_id: str) -> str:
    """Return the request to load a part; the name is percent-encoded."""
    return f"LD,{quote(part_id, safe='')}"


def status(body: str) -> LoaderReading:
    """Parse the answer to ``ST?``."""
    match = _STATUS.fullmatch(body)
    if match is None:
        raise ProtocolError(f"no answer to ST?: {body!r}")
    state, fault, seat = match.groups()
    return LoaderReading(LoaderState(int(state)), int(fault), unquote(seat) or None)


# A PartLoader on numbered lines: a command begins a change, and the driver polls the loader until the change ends.

LOOK_S = 0.2
"""Period of polling while the loader moves; each poll feeds its watchdog."""


class LoaderLine(LineDevice):
    """A part loader. Its watchdog stops it when it moves and receives no more requests."""

    def __init__(self, address: SerialLine | Tcp, times: LoaderTimes | None = None) -> None:
        self._times = times or LoaderTimes()
        super().__init__(address, self._times.silence_s)
        self._stops = 0

    @property
    def times(self) -> LoaderTimes:
        """See Loader."""
        return self._times

    async def _look(self) -> LoaderReading:
        """Poll the loader."""
        return status(await self.ask("ST?"))

    async def status(self) -> DeviceStatus:
        """See Device. Safe means standstill."""
        reading = await self._look()
        return DeviceStatus(
            ready=reading.state is not LoaderState.FAULT,
            safe=reading.state is not LoaderState.MOVING,
            state=reading.state.name.lower(),
            detail=reading.faults,
        )

    async def make_safe(self) -> None:
        """See Device. Stop the loader and confirm standstill; a link that is lost meanwhile is opened again once."""
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
            await self._change(load(part_id))
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
                raise DeviceFault(f"{self.name}: not done after {self._times.change_s:g} s {over}. Check the loader.")
            await asyncio.sleep(LOOK_S)

    def _require_sound(self, reading: LoaderReading, over: str) -> None:
        if reading.state is LoaderState.FAULT:
            what = f"{self.name}: fault {reading.fault} ({reading.faults}) {over}"
            raise DeviceFault(f"{what}. Check which part it holds, clear the fault, and reset it at the loader.")

    async def _stop(self) -> None:
        await self._order("STOP")
        while True:
            if (await self._look()).state is not LoaderState.MOVING:
                return
            await asyncio.sleep(LOOK_S)


# The part loader: the device type ``loader_line``.

_TIMES = LoaderTimes()


class LoaderLineOptions(ConfigSection):
    """Keys of ``[loader]`` with ``type = "loader_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = _TIMES.silence_s
    """Longest time without an answer; then the link is lost."""
    change_s: Annotated[float, Field(gt=0.0, le=3600.0)] = _TIMES.change_s
    """Longest time from the command to unload or load a part until the loader is clear of the cell."""
    stop_s: Annotated[float, Field(gt=0.0, le=120.0)] = _TIMES.stop_s
    """Longest time from the stop command to standstill."""


def _build(options: LoaderLineOptions, context: DeviceContext) -> PartLoader:
    address = line_address(options.address, context.base_dir, "a loader")
    return LoaderLine(address, LoaderTimes(options.silence_s, options.change_s, options.stop_s))


DEVICE_TYPES = [DeviceType("loader_line", "loader", LoaderLineOptions, _build, simulated_by="loader", substitute={})]
