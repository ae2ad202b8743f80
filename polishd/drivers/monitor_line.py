"""Monitor of the cell's signals on numbered lines. ProtocolError for an answer that the protocol does not have."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceStatus, DeviceType, Monitor, MonitorTimes, ProtocolError, Signal
from polishd.config.fields import ConfigSection
from polishd.drivers.transport.address import SerialLine, Tcp, line_address
from polishd.drivers.transport.lines import ReadOnlyLineDevice

_STATES = {"ON": True, "OFF": False, "?": None}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}", re.ASCII)
_NUMBER = re.compile(r"[+-]?\d{1,9}(\.\d{1,6})?", re.ASCII)


def listed(number: int, body: str) -> str:
    """Parse the answer to ``LS?,number``: the name of that signal; empty after the last one."""
    start, name = body[: len(f"LS,{number}")], body.removeprefix(f"LS,{number}")
    if start != f"LS,{number}" or not (name == "" or (name[0] == "," and _NAME.fullmatch(name[1:]))):
        raise ProtocolError(f"no answer to LS?,{number}: {body!r}")
    return name[1:]


def parse_value(name: str, body: str) -> float | bool | None:
    """Parse the answer to ``V?,name``: a number, a state, or None if the box has no value."""
    text = body.removeprefix(f"V,{name},")
    if text == body or not (text in _STATES or _NUMBER.fullmatch(text)):
        raise ProtocolError(f"no answer to V?,{name}: {body!r}")
    return _STATES[text] if text in _STATES else float(text)


# A Monitor on numbered lines: the driver polls its signals one after the other.

PERIOD_S = 0.1
"""Pause between two polls of all signals."""
MOST_SIGNALS = 200


class MonitorLine(ReadOnlyLineDevice):
    """An input box with named inputs."""

    def __init__(self, address: SerialLine | Tcp, times: MonitorTimes | None = None) -> None:
        self._times = times or MonitorTimes()
        super().__init__(address, self._times.silence_s)

    @property
    def times(self) -> MonitorTimes:
        """See Monitor."""
        return self._times

    async def status(self) -> DeviceStatus:
        """See Device. It is always safe."""
        names = await self._names()
        return DeviceStatus(ready=True, safe=True, state="watching", detail=", ".join(names))

    async def signals(self) -> AsyncIterator[Signal]:
        """See Monitor."""
        names = await self._names()
        while True:
            begun_s = time.monotonic()
            for name in names:
                value = parse_value(name, await self.ask(f"V?,{name}"))
                yield Signal(time.monotonic(), name, value)
            await asyncio.sleep(max(begun_s + PERIOD_S - time.monotonic(), 0.0))

    async def _names(self) -> list[str]:
        names = list[str]()
        while len(names) < MOST_SIGNALS and (name := listed(len(names), await self.ask(f"LS?,{len(names)}"))):
            names.append(name)
        return names


# Monitors of the cell's signals: the device type ``monitor_line``.


class MonitorLineOptions(ConfigSection):
    """Keys of ``[monitor]`` with ``type = "monitor_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = MonitorTimes().silence_s
    """Longest time without an answer; then the signals are unknown."""


def _build(options: MonitorLineOptions, context: DeviceContext) -> Monitor:
    address = line_address(options.address, context.base_dir, "a monitor")
    return MonitorLine(address, MonitorTimes(options.silence_s))


DEVICE_TYPES = [
    DeviceType("monitor_line", "monitor", MonitorLineOptions, _build, simulated_by="monitor", substitute={})
]
