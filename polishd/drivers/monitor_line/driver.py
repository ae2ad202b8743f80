"""A Monitor on numbered lines: asked for each of its signals in turn."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from polishd.api import DeviceStatus, MonitorTimes, Signal
from polishd.drivers.monitor_line import codec
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.looking import ReadOnlyLineDevice

PERIOD_S = 0.1
"""Between two rounds of questions."""
MOST_SIGNALS = 200


class MonitorLine(ReadOnlyLineDevice):
    """A box of inputs, which has given each of them a name."""

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
                value = codec.parse_value(name, await self.ask(f"V?,{name}"))
                yield Signal(time.monotonic(), name, value)
            await asyncio.sleep(max(begun_s + PERIOD_S - time.monotonic(), 0.0))

    async def _names(self) -> list[str]:
        names = list[str]()
        while len(names) < MOST_SIGNALS and (name := codec.listed(len(names), await self.ask(f"LS?,{len(names)}"))):
            names.append(name)
        return names
