"""The drive's process, as a spindle or as an actuator."""

from __future__ import annotations

import asyncio
import signal
import time

from polishd.model.surface import FloatArray
from polishd.sim_backends.actuator.coil import CoilDynamics, VoiceCoil
from polishd.sim_backends.bus import Message
from polishd.sim_backends.can_wire import CanWire
from polishd.sim_backends.cia402.motor import Motor
from polishd.sim_backends.cia402.node import Node
from polishd.sim_backends.cia402.objects import Objects
from polishd.sim_backends.cia402.voice_coil import DrivenCoil
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.truth import stream

TICK_S = 0.005
MARK_S = 0.02


async def spindle(runtime: SimRuntime) -> None:
    """The device coroutine of a spindle."""
    config, now_s = runtime.start.config.spindle, time.monotonic()
    rng = stream(runtime.start.seed, "motor")
    motor = Motor(rng, runtime.link.event, now_s, runtime.start.speed)
    runtime.script.suffer = motor.suffer
    objects = Objects()
    objects[0x6080] = config.max_rpm
    drive = Node(config.node, motor, runtime.link.event, now_s, objects)
    await _serve(runtime, drive, motor, CanWire(runtime, config.kind, config.port, drive.on_frame))


async def actuator(runtime: SimRuntime) -> None:
    """The device coroutine of a voice coil."""
    config, now_s, speed = runtime.start.config.actuator, time.monotonic(), runtime.start.speed
    coil = VoiceCoil(
        rng=stream(runtime.start.seed, "coil"),
        report=runtime.link.event,
        now_s=now_s,
        pace=CoilDynamics(config.land_s / speed, config.lift_s / speed, config.cling, config.rest_n),
        touch_um=runtime.link.welcome.get("touch_um"),
    )

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "touch_um" in message:
            coil.touch_um = message["touch_um"]

    runtime.link.on_message = on_message
    runtime.script.suffer = coil.suffer
    drive = Node(config.node, DrivenCoil(coil), runtime.link.event, now_s)
    await _serve(runtime, drive, coil, CanWire(runtime, config.kind, config.port, drive.on_frame))


async def _serve(runtime: SimRuntime, drive: Node, moved: Motor | VoiceCoil, wire: CanWire) -> None:
    runtime.button(signal.SIGUSR1, drive.fail)
    runtime.button(signal.SIGUSR2, lambda: setattr(drive, "hung", True))
    await wire.open()
    marked_s = 0.0
    while True:
        wire.say(drive.step(time.monotonic()))
        if moved.samples or drive.now_s - marked_s >= MARK_S:
            runtime.link.samples(moved.samples, drive.now_s)
            moved.samples, marked_s = [], drive.now_s
        await asyncio.sleep(TICK_S)
