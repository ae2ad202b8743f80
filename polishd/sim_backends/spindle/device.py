"""The spindle drive's process."""

from __future__ import annotations

import asyncio
import signal
import time

from polishd.sim_backends.runtime import Runtime
from polishd.sim_backends.spindle.buses import Slcan, Socketcand
from polishd.sim_backends.spindle.drive import Drive, Frame
from polishd.sim_backends.wire import Feed, Send, Wire

TICK_S = 0.01
ADAPTER_BAUD = 1_000_000
"""Of the slcan adapter's serial side."""
VENDOR_ID, PRODUCT, REVISION, SERIAL = 0x506F, 0x0101, 0x00010000, 12345


async def main(runtime: Runtime) -> None:
    """The device coroutine."""
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
    hosts: list[tuple[Slcan | Socketcand, Send]] = []
    wire = Wire(runtime, config.faults, lambda: _feed(config.kind, drive, hosts))
    if config.kind == "slcan":
        wire.open_pty(ADAPTER_BAUD)
        runtime.ready(f"slcan:{runtime.start.state / runtime.name}?bitrate=500000")
    else:
        runtime.ready(f"socketcand://{await wire.open_tcp(config.port, Socketcand.greeting)}/can0")
    runtime.group.create_task(wire.cut_now_and_then())
    runtime.group.create_task(runtime.reboot_later(config.faults.reboot_after_s))
    await _tick(runtime, drive, hosts)


def _feed(kind: str, drive: Drive, hosts: list[tuple[Slcan | Socketcand, Send]]) -> Feed:
    """The receiver of one connection."""

    def on_frame(identifier: int, data: bytes) -> list[Frame]:
        return drive.on_frame(identifier, data)

    host = Slcan(on_frame) if kind == "slcan" else Socketcand(on_frame)
    known: list[Send] = []

    def feed(data: bytes, send: Send) -> None:
        if not known:
            known.append(send)
            hosts.append((host, send))
        answer = host.feed(data)
        if answer:
            send(answer)

    return feed


async def _tick(runtime: Runtime, drive: Drive, hosts: list[tuple[Slcan | Socketcand, Send]]) -> None:
    while True:
        frames = drive.step(time.monotonic())
        for host, send in hosts if frames else []:
            # each hears the bus once it has opened it: before that, a client waits for an answer
            for frame in frames:
                if heard := host.send([frame]):
                    send(heard)
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)
