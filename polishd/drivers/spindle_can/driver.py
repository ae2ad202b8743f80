"""The bonnet spindle behind a drive on CAN."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator

from polishd.api import (
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    ProtocolError,
    SpeedSample,
    SpindleTimes,
)
from polishd.drivers.spindle_can import codec
from polishd.drivers.spindle_can.codec import DriveState
from polishd.drivers.spindle_can.link import DriveLink
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress

TOLERANCE = 0.02


class SpindleCan:
    """A Spindle on CAN. A lost link stays lost until ``open``; nothing but ``make_safe`` connects by itself.

    The command is repeated only as long as somebody iterates ``samples`` or waits in ``set_speed``, and for a second
    after; then the drive hears nothing more and stops by itself.
    """

    def __init__(
        self, address: SlcanAddress | SocketcandAddress, times: SpindleTimes | None = None, *, node: int = 5
    ) -> None:
        self._address = address
        self._times = times or SpindleTimes()
        self._node = node
        self._link: DriveLink | None = None
        self._max_rpm = 0
        self._opening = asyncio.Lock()
        """A serial adapter is open once only."""

    @property
    def times(self) -> SpindleTimes:
        """See Spindle."""
        return self._times

    async def open(self) -> None:
        """See Device. LinkError unless the drive itself is heard."""
        async with self._opening:
            await self.close()
            link = DriveLink(self._address, self._node, self._times.silence_s)
            await link.open()
            try:
                self._max_rpm = min(await link.upload(codec.MAXIMUM_SPEED), codec.MAX_RPM)
            except BaseException:
                await link.close()
                raise
            self._link = link

    async def close(self) -> None:
        """See Device."""
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    async def identify(self) -> DeviceIdentity:
        """See Device. Vendor, product and revision are the CiA 301 numbers."""
        link = self._open_link()
        vendor, product, revision, serial, boots = [
            await link.upload(what)
            for what in (
                codec.VENDOR_ID,
                codec.PRODUCT_CODE,
                codec.REVISION,
                codec.SERIAL_NUMBER,
                codec.BOOT_COUNT,
            )
        ]
        return DeviceIdentity(
            f"0x{vendor:08x}", f"0x{product:08x}", str(serial), f"0x{revision:08x}", boot_id=str(boots)
        )

    async def status(self) -> DeviceStatus:
        """See Device. Safe means stopped."""
        status = self._open_link().status
        ready = status.state is not DriveState.FAULT and not status.fault
        safe = _stands(status)
        return DeviceStatus(ready=ready, safe=safe, state=status.state.name.lower(), detail=_faults(status.fault))

    async def make_safe(self) -> None:
        """See Device. Stops, and sees that it has stopped; where the link is down it connects once for that."""
        if self._link is not None and self._link.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                return await self._stop(self._link)
        async with self._opening:
            if self._link is not None:
                await self._link.close()
            link = DriveLink(self._address, self._node, self._times.silence_s)
            await link.open()
            try:
                await self._stop(link)
            finally:
                await link.close()

    async def set_speed(self, rpm: float) -> None:
        """See Spindle. DeviceRefused outside the drive's range."""
        link = self._open_link()
        if not (math.isfinite(rpm) and abs(rpm) <= self._max_rpm):
            raise DeviceRefused(f"{link.name}: {rpm} rpm is outside the drive's {self._max_rpm} rpm")
        if round(rpm) == 0:
            return await self._stop(link)
        if not link.running:
            link.command(run=False, rpm=0)  # clears the fault of an earlier silence
        link.command(run=True, rpm=round(rpm))
        await self._reach(link, round(rpm))
        return None

    async def samples(self) -> AsyncIterator[SpeedSample]:
        """See Spindle. The latest, where the caller is slower than the drive."""
        link = self._open_link()
        while True:
            link.renew_lease()
            await link.next_status()
            link.renew_lease()
            status = link.status
            yield SpeedSample(time.monotonic(), status.rpm, float(link.rpm), status.fault)

    async def _reach(self, link: DriveLink, rpm: int) -> None:
        within_s = self._times.spin_s

        def settled() -> bool:
            link.renew_lease()
            if link.rpm != rpm:
                return True
            return link.answered and (_at(link.status, rpm) or link.status.fault != 0)

        reached = await link.until(settled, within_s)
        if link.rpm != rpm:
            raise DeviceRefused(f"{link.name}: was commanded to {link.rpm} rpm on the way to {rpm} rpm")
        if link.status.fault:
            error = DeviceRefused if link.status.fault == 2 else DeviceFault
            raise error(
                f"{link.name}: fault {link.status.fault} ({_faults(link.status.fault)}) on the way to {rpm} rpm"
            )
        if not reached:
            raise DeviceFault(f"{link.name}: {rpm} rpm not reached, {link.status.rpm} rpm after {within_s:.1f} s")

    async def _stop(self, link: DriveLink) -> None:
        within_s = self._times.spin_s
        link.command(run=False, rpm=0)
        if not await link.until(lambda: link.answered and _stands(link.status), within_s):
            raise DeviceFault(f"{link.name}: still at {link.status.rpm} rpm {within_s:.1f} s after the stop command")
        link.rest()

    def _open_link(self) -> DriveLink:
        if self._link is None:
            raise LinkError(f"{self._address} node {self._node}: is not open")
        self._link.check()
        return self._link


def _at(status: codec.DriveStatus, rpm: int) -> bool:
    return status.state is DriveState.AT_SPEED and abs(status.rpm - rpm) <= TOLERANCE * abs(rpm)


def _stands(status: codec.DriveStatus) -> bool:
    return status.state is DriveState.STOPPED or (status.state is DriveState.FAULT and abs(status.rpm) < 1.0)


def _faults(fault: int) -> str:
    return ", ".join(text for bit, text in codec.FAULTS.items() if fault & bit)
