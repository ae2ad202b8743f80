"""The spindle drive's process."""

from __future__ import annotations

import asyncio
import signal
import time

from polishd.sim_backends.faults import Outlet
from polishd.sim_backends.profiled.inverter import main as inverter
from polishd.sim_backends.runtime import Runtime
from polishd.sim_backends.spindle.buses import Slcan, Socketcand
from polishd.sim_backends.spindle.drive import Drive
from polishd.sim_backends.wire import Feed, Wire

TICK_S = 0.01
ADAPTER_BAUD = 1_000_000
"""Of the slcan adapter's serial side."""
VENDOR_ID, PRODUCT, REVISION, SERIAL = 0x506F, 0x0101, 0x00010000, 12345


async def main(runtime: Runtime) -> None:
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
    runtime.button(signal.SIGUSR1, drive.fail)
    hosts: list[tuple[Slcan | Socketcand, Outlet]] = []

    def connected(outlet: Outlet) -> Feed:
        host = (Slcan if config.kind == "slcan" else Socketcand)(drive.on_frame)
        hosts.append((host, outlet))
        outlet.on_closed = lambda: hosts.remove((host, outlet))

        def feed(data: bytes) -> None:
            if answer := host.feed(data):
                outlet.send(answer)

        return feed

    wire = Wire(runtime, config.faults, connected)
    if config.kind == "slcan":
        wire.open_pty(ADAPTER_BAUD)
        wire.ready(f"slcan:{runtime.start.state / runtime.name}?bitrate=500000")
    else:
        wire.ready(f"socketcand://{await wire.open_tcp(config.port, Socketcand.greeting)}/can0")
    await _tick(runtime, drive, hosts)
    return None


async def _tick(runtime: Runtime, drive: Drive, hosts: list[tuple[Slcan | Socketcand, Outlet]]) -> None:
    while True:
        frames = drive.step(time.monotonic())
        for host, outlet in hosts if frames else []:
            # each hears the bus once it has opened it: before that, a client waits for an answer
            for frame in frames:
                if heard := host.send([frame]):
                    outlet.send(heard)
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)
