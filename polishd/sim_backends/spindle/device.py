"""The spindle drive's process."""

from __future__ import annotations

import asyncio
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
    config = runtime.start.config.spindle
    identity = enumerate((VENDOR_ID, PRODUCT, REVISION, SERIAL), start=1)
    objects = {(0x1018, sub): value for sub, value in identity}
    objects.update({(0x2000, 0): runtime.boot_count, (0x6080, 0): config.max_rpm})
    drive = Drive(
        node=config.node,
        max_rpm=config.max_rpm,
        objects=objects,
        report=lambda name, at_s: runtime.link.event(name, at_s, rpm=round(drive.rpm, 1)),
        now_s=time.monotonic(),
    )
    hosts: list[Slcan | Socketcand] = []
    wire = Wire(runtime, config.faults, lambda: _feed(config.kind, drive, hosts))
    if config.kind == "slcan":
        wire.open_pty(ADAPTER_BAUD)
        runtime.ready(f"slcan:{runtime.start.state / runtime.name}?bitrate=500000")
    else:
        runtime.ready(f"socketcand://{await wire.open_tcp(config.port, Socketcand.greeting)}/can0")
    runtime.group.create_task(wire.cut_now_and_then())
    runtime.group.create_task(runtime.reboot_later(config.faults.reboot_after_s))
    await _tick(runtime, drive, wire, hosts)


def _feed(kind: str, drive: Drive, hosts: list[Slcan | Socketcand]) -> Feed:
    """The receiver of one connection."""

    def on_frame(identifier: int, data: bytes) -> list[Frame]:
        return drive.on_frame(identifier, data)

    host = Slcan(on_frame) if kind == "slcan" else Socketcand(on_frame)
    hosts.append(host)

    def feed(data: bytes, send: Send) -> None:
        answer = host.feed(data)
        if answer:
            send(answer)

    return feed


async def _tick(runtime: Runtime, drive: Drive, wire: Wire, hosts: list[Slcan | Socketcand]) -> None:
    while True:
        frames = drive.step(time.monotonic())
        # all hosts of one bus speak the same dialect: whoever has opened it hears everything
        speaker = next((host for host in hosts if host.opened), None)
        for frame in frames if speaker is not None else []:
            wire.broadcast(speaker.send([frame]) if speaker is not None else b"")
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)
