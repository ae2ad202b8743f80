"""A cell: its devices behind their ports, and the clock. It knows nothing of a job."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from polishd.daemon.time_limits import TimeLimits
from polishd.model.devices import Identity
from polishd.model.errors import LinkError
from polishd.ports.clock import Clock
from polishd.ports.devices import Device, ForceActuator, Metrology, Robot, Spindle

OPEN_S = 15.0
"""Longest that opening and identifying one device may take."""


class MonotonicClock:
    """The daemon's clock: wall time."""

    def now_s(self) -> float:
        """Seconds on the event loop's monotonic clock."""
        return asyncio.get_running_loop().time()

    async def sleep(self, seconds: float) -> None:
        """Wait that long."""
        await asyncio.sleep(seconds)


@dataclass(slots=True)
class Cell:
    """Devices of one cell. ``unsafe`` lists devices that did not confirm being safe when last asked."""

    robot: Robot
    actuator: ForceActuator
    spindle: Spindle
    metrology: Metrology
    clock: Clock
    unsafe: tuple[str, ...] = field(default=())
    emergency: bool = False
    """Motion is to stop at once, whatever the part costs: somebody asked for it."""

    @property
    def limits(self) -> TimeLimits:
        """How long things may take, as its devices state it."""
        return TimeLimits(self.actuator.times, self.robot.times, self.spindle.times)

    @property
    def devices(self) -> Mapping[str, Device]:
        """By port, in the order in which they are opened and made safe."""
        return {
            "actuator": self.actuator,
            "robot": self.robot,
            "spindle": self.spindle,
            "metrology": self.metrology,
        }

    async def open(self) -> dict[str, Identity]:
        """Open and identify all devices; on the first failure close what was opened and raise."""
        identities = {}
        try:
            for name, device in self.devices.items():
                async with _answering(name):
                    await device.open()
                    identities[name] = await device.identify()
        except BaseException:
            await self.close()
            raise
        return identities

    async def restore_links(self) -> None:
        """Open again what was lost meanwhile, and leave it safe. Only out of contact: nothing is retried in it."""
        for name, device in self.devices.items():
            try:
                async with _answering(name):
                    await device.status()
            except LinkError:
                async with _answering(name):
                    await device.close()
                    await device.open()
                    await device.make_safe()

    async def close(self) -> None:
        """Close all devices, whatever one of them says."""
        errors = []
        for device in self.devices.values():
            try:
                await device.close()
            except Exception as error:  # noqa: BLE001 - the others must be closed too; raised below
                errors.append(error)
        if errors:
            raise errors[0]


@asynccontextmanager
async def _answering(name: str) -> AsyncIterator[None]:
    try:
        async with asyncio.timeout(OPEN_S):
            yield
    except TimeoutError:
        raise LinkError(f"{name}: no answer within {OPEN_S:g} s; is it on, and connected?") from None
