"""The spindle drive's process."""

from __future__ import annotations

import asyncio
import signal
import time

from polishd.sim_backends.can_wire import CanWire
from polishd.sim_backends.profiled.inverter import main as inverter
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.spindle.drive import Drive

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
