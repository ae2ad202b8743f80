"""Frames of the spindle drive: identifiers and data, both ways. Sans-IO; frames that are not the drive's are None."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    LinkError,
    ProtocolError,
    SpeedSample,
    Spindle,
    SpindleTimes,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress, can_address
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.can_bus import CanBus, CanFrame, NodesHeard, open_bus

COMMAND, STATUS, HEARTBEAT, SDO_REQUEST, SDO_ANSWER = 0x200, 0x180, 0x700, 0x600, 0x580
OPERATIONAL, BOOT = 0x05, 0x00
MAX_RPM = 0x7FFF
FAULTS = {1: "command silence", 2: "over-speed request", 4: "drive"}

_COMMAND = struct.Struct("<BBh4x")
_STATUS = struct.Struct("<BBiBx")
_SDO = struct.Struct("<BHBI")
_UPLOAD, _EXPEDITED, _ABORT = 0x40, 0x43, 0x80


class DriveState(IntEnum):
    """What the drive is doing."""

    STOPPED = 0
    RAMPING = 1
    AT_SPEED = 2
    FAULT = 3


@dataclass(frozen=True, slots=True)
class DriveObject:
    """An entry of the drive's object dictionary."""

    index: int
    sub: int


VENDOR_ID = DriveObject(0x1018, 1)
PRODUCT_CODE = DriveObject(0x1018, 2)
REVISION = DriveObject(0x1018, 3)
SERIAL_NUMBER = DriveObject(0x1018, 4)
BOOT_COUNT = DriveObject(0x2000, 0)
MAXIMUM_SPEED = DriveObject(0x6080, 0)


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """Process data of the drive; ``counter`` is that of the last command it took."""

    state: DriveState
    counter: int
    rpm: float
    fault: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Sign of life; ``boot`` once after power-up."""

    boot: bool


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """The value of an object, or the drive's abort code."""

    what: DriveObject
    value: int
    aborted: bool


def encode_command(node: int, *, run: bool, counter: int, rpm: int) -> CanFrame:
    """Run at a speed, or stop."""
    return CanFrame(COMMAND + node, _COMMAND.pack(run, counter, rpm))


def encode_upload(node: int, what: DriveObject) -> CanFrame:
    """Ask for an object."""
    return CanFrame(SDO_REQUEST + node, _SDO.pack(_UPLOAD, what.index, what.sub, 0))


def decode(node: int, frame: CanFrame) -> DriveStatus | Heartbeat | SdoAnswer | None:
    """What that node said; None for other nodes, and for data that the protocol does not have."""
    identifier, data = frame
    if identifier == STATUS + node and len(data) == _STATUS.size:
        state, counter, tenths, fault = _STATUS.unpack(data)
        known = state in tuple(DriveState)
        return DriveStatus(DriveState(state), counter, tenths / 10.0, fault) if known else None
    if identifier == HEARTBEAT + node and data in (bytes([BOOT]), bytes([OPERATIONAL])):
        return Heartbeat(boot=data[0] == BOOT)
    if identifier == SDO_ANSWER + node and len(data) == _SDO.size:
        specifier, index, sub, value = _SDO.unpack(data)
        if specifier in (_EXPEDITED, _ABORT):
            return SdoAnswer(DriveObject(index, sub), value, aborted=specifier == _ABORT)
    return None


# One connection to the drive: its heartbeat is timed, its commands are repeated, its objects are read.

OPEN_S = 1.0
REPEAT_S = 0.1
LEASE_S = 1.0
"""So long after somebody last cared, commands are repeated no more."""
SDO_S = 3.0
"""For an object that is read. Whether the drive lives is told by its heartbeat, and sooner."""


class DriveLink(Background):
    """From opening the bus to its end; never opened again."""

    def __init__(self, address: SlcanAddress | SocketcandAddress, node: int, silence_s: float) -> None:
        """``silence_s`` of heartbeats, or of process data, is the link's end."""
        super().__init__(f"{address} node {node}")
        self._address = address
        self._node = node
        self._silence_s = silence_s
        self._sdo = asyncio.Lock()
        self._uploads: dict[DriveObject, asyncio.Future[SdoAnswer]] = {}
        self._bus: CanBus | None = None
        self._heard = NodesHeard()
        self._status: DriveStatus | None = None
        self._status_at = self._beat_at = -1.0
        self._beating = False
        self._restarted = False
        self._counter = self._first_counter = 0
        self._repeating = False
        self._lease_until = 0.0
        self.answered = False
        """The drive's last word is about the present command, not about an earlier one."""
        self.running = False
        """The last command was to run."""
        self.rpm = 0
        """Set point of the last command."""

    @property
    def status(self) -> DriveStatus:
        """The drive's last word; LinkError once the link is down."""
        self.check()
        if self._status is None:
            raise LinkError(f"{self.name}: has said nothing yet")
        return self._status

    async def open(self) -> None:
        """Open the bus and wait until the drive's heartbeat and process data are heard."""
        self._bus = await open_bus(self._address, self._node)
        try:
            await self.start(self._run, OPEN_S)
            # so that no answer to the last connection's commands is taken for one to ours
            self._counter = self.status.counter
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Leave the bus; idempotent."""
        await self.stop()
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    async def next_status(self) -> None:
        """Wait for the next process data."""
        heard = self._status_at
        await self.until(lambda: self._status_at != heard)

    def command(self, *, run: bool, rpm: int) -> None:
        """Command now, and again every 100 ms while somebody cares."""
        self.check()
        self.running, self.rpm = run, rpm
        self._repeating = True
        self.answered = False
        self._first_counter = (self._counter + 1) % 256
        self.renew_lease()
        self._send_command()

    def rest(self) -> None:
        """Repeat the command no more: the drive stands."""
        self._repeating = False

    def renew_lease(self) -> None:
        """Somebody cares."""
        self._lease_until = time.monotonic() + LEASE_S

    async def upload(self, what: DriveObject) -> int:
        """Read an object of the drive."""
        async with self._sdo:
            self.check()
            self._uploads[what] = asyncio.get_running_loop().create_future()
            try:
                self._send(encode_upload(self._node, what))
                answer = await self.result(self._uploads[what], SDO_S)
            finally:
                self._uploads.pop(what).cancel()
        if answer.aborted:
            raise ProtocolError(
                f"{self.name}: object {what.index:#06x} sub {what.sub} aborted with {answer.value:#010x}"
            )
        return answer.value

    def _unanswered(self, within_s: float) -> str:
        said = super()._unanswered(within_s)
        heard = self._status is not None and self._beating
        return said if heard else f"{said}; {self._heard.without(self._node, self._address)}"

    async def _run(self, ready: Ready) -> None:
        if self._bus is None:
            return
        async with asyncio.TaskGroup() as group:
            group.create_task(self._bus.receive(self._on_frame))
            group.create_task(self._watch(ready))
            group.create_task(self._repeat())

    async def _watch(self, ready: Ready) -> None:
        """Ready once the drive is heard; LinkError when it falls silent, DeviceFault when it starts anew."""
        while not (self._status is not None and self._beating):
            await self.news()
        ready()
        while True:
            await asyncio.wait({self.news()}, timeout=self._silence_s / 4)
            if self._restarted:
                raise DeviceFault(f"{self.name}: the drive was started anew")
            for what, at in (("heartbeat", self._beat_at), ("process data", self._status_at)):
                if time.monotonic() > at + self._silence_s:
                    raise LinkError(f"{self.name}: no {what} for {self._silence_s:g} s")

    async def _repeat(self) -> None:
        while True:
            await asyncio.sleep(REPEAT_S)
            if self._repeating and time.monotonic() < self._lease_until:
                self._send_command()

    def _send_command(self) -> None:
        self._counter = (self._counter + 1) % 256
        self._send(encode_command(self._node, run=self.running, counter=self._counter, rpm=self.rpm))

    def _send(self, frame: CanFrame) -> None:
        if self._bus is not None:
            self._bus.send(frame)

    def _on_frame(self, frame: CanFrame) -> None:
        self._heard.add(frame)
        message = decode(self._node, frame)
        now = time.monotonic()
        if isinstance(message, DriveStatus):
            self._status, self._status_at = message, now
            since = (message.counter - self._first_counter) % 256
            self.answered = self.answered or since <= (self._counter - self._first_counter) % 256
        elif isinstance(message, Heartbeat):
            self._restarted = self._restarted or (message.boot and self._beating)
            self._beating, self._beat_at = True, now
        elif isinstance(message, SdoAnswer):
            waiting = self._uploads.get(message.what)
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
        else:
            return
        self.fire()


# The bonnet spindle behind a drive on CAN.

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
                self._max_rpm = min(await link.upload(MAXIMUM_SPEED), MAX_RPM)
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
                VENDOR_ID,
                PRODUCT_CODE,
                REVISION,
                SERIAL_NUMBER,
                BOOT_COUNT,
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


def _at(status: DriveStatus, rpm: int) -> bool:
    return status.state is DriveState.AT_SPEED and abs(status.rpm - rpm) <= TOLERANCE * abs(rpm)


def _stands(status: DriveStatus) -> bool:
    return status.state is DriveState.STOPPED or (status.state is DriveState.FAULT and abs(status.rpm) < 1.0)


def _faults(fault: int) -> str:
    return ", ".join(text for bit, text in FAULTS.items() if fault & bit)


# The bonnet spindle: the device type ``spindle_can``.

_TIMES = SpindleTimes()


class SpindleCanOptions(ConfigSection):
    """Keys of ``[spindle]`` with ``type = "spindle_can"``."""

    address: str
    """``slcan:PATH?bitrate=500000`` or ``socketcand://host:port/channel``."""
    node: Annotated[int, Field(ge=1, le=127)] = 5
    """CANopen node number. [1]"""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _TIMES.silence_s
    """No heartbeat or process data for so long: the link is lost. They come every 100 and 50 ms."""
    watchdog_s: Annotated[float, Field(ge=0.5, le=60.0)] = _TIMES.watchdog_s
    """The drive's own: so long without a command it stops. Commands come every 100 ms."""
    spin_s: Annotated[float, Field(gt=0.0, le=120.0)] = _TIMES.spin_s
    """Longest from standstill to any speed, or back."""


def _build(options: SpindleCanOptions, context: DeviceContext) -> Spindle:
    address = can_address(options.address, context.base_dir, "spindle_can")
    times = SpindleTimes(silence_s=options.silence_s, watchdog_s=options.watchdog_s, spin_s=options.spin_s)
    return SpindleCan(address, times, node=options.node)


DEVICE_TYPES = [
    DeviceType(
        "spindle_can",
        "spindle",
        SpindleCanOptions,
        _build,
        simulated_by="spindle_can",
        substitute={"silence_s": 1.5},
        usual_address="slcan:/dev/ttyACM0?bitrate=500000",
    )
]
