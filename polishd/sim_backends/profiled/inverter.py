"""The process of a spindle that speaks what a profile says."""

from __future__ import annotations

import asyncio
import time

from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.profiled.machine import Inverter
from polishd.sim_backends.profiled.sheet import SimDeviceProfile
from polishd.sim_backends.profiled.slave import by_profile
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.wire import Feed, SimWire

TICK_S = 0.01


async def main(runtime: SimRuntime) -> None:
    """The device coroutine."""
    whole, speed = runtime.start.config, runtime.start.speed
    config = whole.spindle
    sheet = SimDeviceProfile.read(whole.resolve(config.profile), config.pole_pairs)
    drive = Inverter(
        report=runtime.link.event,
        now_s=time.monotonic(),
        max_rpm=float(config.max_rpm),
        ramp_rpm_s=1000.0 / config.spin_s * speed,
        stop_rpm_s=1000.0 / config.stop_s * speed,
        watchdog_s=config.watchdog_s,
        identity={"vendor": "polishd", "model": "simulated inverter", "boot": str(runtime.boot_count)},
    )
    runtime.script.suffer = drive.suffer
    tcp = config.kind == "profile_tcp"
    line = sheet.raw.get("serial", {})
    baud, parity = int(line.get("baud", 115200)), str(line.get("parity", "none"))
    byte_s = 0.0 if tcp else 10.0 / baud

    unit = int(sheet.raw.get("modbus", {}).get("unit", 1)) if config.unit is None else config.unit

    def connected(outlet: FaultyLink) -> Feed:
        slave = by_profile(sheet, drive, unit, tcp=tcp)

        def feed(data: bytes) -> None:
            now = time.monotonic()
            drive.step(now)
            for size, answer in slave.feed(data, now):
                outlet.send(answer, size * byte_s)

        return feed

    wire = SimWire(runtime, connected)
    if tcp:
        wire.ready(f"tcp://{await wire.open_tcp(config.port)}")
    else:
        wire.open_pty(baud)
        wire.ready(f"serial:{runtime.start.state / runtime.name}?baud={baud}&parity={parity}")
    await _tick(runtime, drive)


async def _tick(runtime: SimRuntime, drive: Inverter) -> None:
    while True:
        drive.step(time.monotonic())
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)
