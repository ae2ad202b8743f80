"""The simulated spindle drive: behaviour, CAN frames, slcan and socketcand."""

from __future__ import annotations

import asyncio
import signal
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from polishd.config.simulator import FaultSection, SimSpindleSection
from polishd.sim_backends.common.can import CanWire, Frame
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.profile_device.device import main as inverter

# The spindle drive: behaviour and CAN frames (docs/protocols/spindle_can.md). Pure; wall times are handed in.

STOPPED, RAMPING, AT_SPEED, FAULT = range(4)
SILENCE, OVER_SPEED, DRIVE = 1, 2, 4
STATUS_S, HEARTBEAT_S = 0.05, 0.1
UNKNOWN_OBJECT = 0x06020000


@dataclass(slots=True)
class Drive:
    """One drive on the bus. ``on_frame`` hears the bus; ``step`` gives what the drive sends."""

    node: int
    max_rpm: int
    objects: dict[tuple[int, int], int]
    """Object dictionary: (index, sub) -> u32."""
    report: Callable[..., None]
    now_s: float
    ramp_rpm_s: float = 2000.0
    """To speed, wall time."""
    stop_rpm_s: float = 2000.0
    """To rest: its quick stop."""
    watchdog_s: float = 1.0
    way: int = 1
    """-1: two phases are exchanged, so that the rotor turns the other way round. The encoder sees it."""
    rpm: float = 0.0
    target_rpm: float = 0.0
    fault: int = 0
    counter: int = 0
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since they were last taken."""
    _heard_s: float = 0.0
    _status_s: float = 0.0
    _heartbeat_s: float = 0.0
    _booted: bool = False
    _said: int = STOPPED

    def __post_init__(self) -> None:
        """Power up stopped."""
        self._status_s = self._heartbeat_s = self.now_s
        self.samples.append((self.now_s, 0.0))

    @property
    def state(self) -> int:
        """The state number of the protocol."""
        if self.fault:
            return FAULT
        if self.rpm == self.target_rpm:
            return AT_SPEED if self.rpm else STOPPED
        return RAMPING

    def on_frame(self, identifier: int, data: bytes) -> list[Frame]:
        """Hear a frame; the answers to it."""
        if identifier == 0x200 + self.node and len(data) == 8:
            self._command(*struct.unpack_from("<BBh", data))
        elif identifier == 0x600 + self.node and len(data) == 8:
            return [(0x580 + self.node, self._upload(data))]
        return []

    def step(self, now_s: float) -> list[Frame]:
        """Bring the drive to the present; the frames that are due."""
        if self.target_rpm and now_s - self._heard_s > self.watchdog_s:
            self.target_rpm, self.fault = 0.0, self.fault | SILENCE
            self.report("watchdog", now_s)
        slope = self.ramp_rpm_s if abs(self.target_rpm) > abs(self.rpm) else self.stop_rpm_s
        before, room = self.rpm, slope * max(now_s - self.now_s, 0.0)
        self.rpm += min(max(self.target_rpm - self.rpm, -room), room)
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = max(now_s, self.now_s)
        if self.state != self._said:
            self._said = self.state
            self.report(("spindle_stopped", "spindle_ramping", "spindle_at_speed", "spindle_fault")[self.state], now_s)
        return list(self._due())

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Two phases are exchanged, or put right."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def fail(self) -> None:
        """The drive's own fault: it stops, and runs no more."""
        self.fault, self.target_rpm = self.fault | DRIVE, 0.0

    def status(self) -> Frame:
        """The status frame."""
        data = struct.pack("<BBiBB", self.state, self.counter, round(self.way * self.rpm * 10), self.fault, 0)
        return 0x180 + self.node, data

    def _due(self) -> Iterator[Frame]:
        if not self._booted:
            self._booted = True
            yield 0x700 + self.node, b"\x00"
        if self.now_s - self._status_s >= STATUS_S:
            self._status_s = self.now_s
            yield self.status()
        if self.now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = self.now_s
            yield 0x700 + self.node, b"\x05"

    def _command(self, control: int, counter: int, rpm: int) -> None:
        self._heard_s, self.counter = self.now_s, counter
        if control == 0:
            self.fault &= ~(SILENCE | OVER_SPEED)
            self.target_rpm = 0.0
        elif abs(rpm) > self.max_rpm:
            self.fault |= OVER_SPEED
        elif not self.fault & ~OVER_SPEED:
            self.fault &= ~OVER_SPEED
            self.target_rpm = float(rpm)

    def _upload(self, data: bytes) -> bytes:
        _, index, sub = struct.unpack_from("<BHB", data)
        value = self.objects.get((index, sub))
        if data[0] != 0x40 or value is None:
            return struct.pack("<BHBI", 0x80, index, sub, UNKNOWN_OBJECT)
        return struct.pack("<BHBI", 0x43, index, sub, value)


# The spindle drive's process.

TICK_S = 0.01
VENDOR_ID, PRODUCT, REVISION, SERIAL = 0x506F, 0x0101, 0x00010000, 12345


async def main(runtime: SimRuntime) -> None:
    """The device coroutine."""
    if runtime.start.config.spindle.kind in {"profile", "profile_tcp"}:
        return await inverter(runtime)
    config, speed = runtime.start.config.spindle, runtime.start.speed
    identity = enumerate((VENDOR_ID, PRODUCT, REVISION, SERIAL), start=1)
    objects = {(0x1018, sub): value for sub, value in identity}
    objects.update({(0x2000, 0): runtime.boot_count, (0x6080, 0): config.max_rpm})
    drive = Drive(
        node=config.node,
        max_rpm=config.max_rpm,
        objects=objects,
        report=lambda name, at_s: runtime.link.event(name, at_s, rpm=round(drive.rpm, 1)),
        now_s=time.monotonic(),
        ramp_rpm_s=1000.0 / config.spin_s * speed,
        stop_rpm_s=1000.0 / config.stop_s * speed,
        watchdog_s=config.watchdog_s,
    )
    runtime.script.suffer = drive.suffer
    runtime.button(signal.SIGUSR1, drive.fail)
    wire = CanWire(runtime, config.kind, config.port, drive.on_frame)
    await wire.open()
    while True:
        wire.say(drive.step(time.monotonic()))
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)


SIM_DEVICES = [
    SimDevice(
        name="spindle_can",
        device="spindle",
        section=SimSpindleSection,
        links={"slcan": {"": "slcan"}, "socketcand": {"": "socketcand"}},
        main=main,
        faults=("reverse",),
        drive="spindle_can",
    )
]
