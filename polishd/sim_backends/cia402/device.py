"""The process of the drive, as a spindle or as an actuator."""

from __future__ import annotations

import asyncio
import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import FaultSection, SimActuatorSection, SimSpindleSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.cia402 import node as stage
from polishd.sim_backends.cia402.node import Node, Objects, Power
from polishd.sim_backends.common.can import CanWire
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime
from polishd.sim_backends.common.voice_coil import COIL_FAULTS, CoilDynamics, VoiceCoil

# A spindle motor behind the drive: profile velocity with ramps, and a rotor that follows with a short lag.

RPM = 0.1
"""Size of a unit of velocity."""
COAST_RPM_S = 200.0
LAG_S = 0.02
NOISE_RPM = 0.2
STILL_RPM = 0.5
VELOCITY_MODE = 3
REACHED = 0x400


@dataclass(slots=True)
class Motor:
    """Speed of the rotor."""

    rng: np.random.Generator
    report: Callable[..., None]
    now_s: float
    speed: float = 1.0
    """Process seconds per wall second."""
    rpm: float = 0.0
    way: int = 1
    """-1: two phases are exchanged, and the rotor turns the other way round. The encoder measures that direction."""
    jammed: bool = False
    """A mechanical load holds the rotor at its speed."""
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since the samples were last taken."""
    _demand: float = 0.0
    _reported: str = "spindle_stopped"

    def __post_init__(self) -> None:
        """True at standstill."""
        self.samples.append((self.now_s, 0.0))

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Exchange two phases, or restore them."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        """See Axis."""
        goal, slope = self._wanted(objects, power)
        elapsed_s, before = max(now_s - self.now_s, 0.0), self.rpm
        room = slope * self.speed * elapsed_s
        self._demand += min(max(goal - self._demand, -room), room)
        if not self.jammed:
            self.rpm += (self._demand - self.rpm) * -math.expm1(-elapsed_s * max(self.speed, 1.0) / LAG_S)
        if self._demand == 0.0 and abs(self.rpm) < STILL_RPM:
            self.rpm = 0.0
            power.stands()
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = now_s
        noise = NOISE_RPM * float(self.rng.standard_normal()) if self.rpm else 0.0
        objects[0x606C] = round((self.way * self.rpm + noise) / RPM)
        reached = abs(self.rpm - goal) <= max(0.01 * abs(goal), STILL_RPM)
        objects[0x6041] = objects[0x6041] & ~REACHED | (REACHED if reached else 0)
        self._report_motion(power, reached)

    def _wanted(self, objects: Objects, power: Power) -> tuple[float, float]:
        """(rpm, rpm/s)."""
        if power.state == stage.ENABLED and objects[0x6061] == VELOCITY_MODE:
            goal = objects[0x60FF] * RPM
            return goal, objects[0x6083 if abs(goal) > abs(self._demand) else 0x6084] * RPM
        if power.live:
            return 0.0, objects[0x6085] * RPM
        return 0.0, COAST_RPM_S

    def _report_motion(self, power: Power, reached: bool) -> None:
        event = "spindle_ramping"
        if power.state == stage.FAULT:
            event = "spindle_fault"
        elif self.rpm == 0.0 and self._demand == 0.0:
            event = "spindle_stopped"
        elif reached and power.state == stage.ENABLED:
            event = "spindle_at_speed"
        if event != self._reported:
            self._reported = event
            self.report(event, self.now_s, rpm=round(self.rpm, 1))


# A voice coil behind the drive: profile torque presses it out against its spring; without current the spring lifts it.

N_PER_PERMILLE = 0.05
BALANCE_N = 2.0
"""Force with which the spring lifts."""
MOST_N = 50.0
TORQUE_MODE = 4


@dataclass(slots=True)
class DrivenCoil:
    """The mechanics of the coil, driven by current instead of by commands."""

    coil: VoiceCoil

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        """See Axis."""
        coil = self.coil
        coil.feed(0)  # the drive's watchdog replaces the coil's
        pressed_n = self._pressed_n(objects, power)
        if pressed_n > 0.0 or (pressed_n == 0.0 and coil.engaged):
            coil.set_force(min(pressed_n, MOST_N))
            coil.engage()
        else:
            coil.retract()
        coil.step(now_s)
        if power.state in {stage.QUICK_STOP, stage.REACTION}:
            power.stands()
        objects[0x6064] = round(coil.position_um)
        objects[0x6077] = self._torque(objects, power)

    def _pressed_n(self, objects: Objects, power: Power) -> float:
        """Force on the part; negative: lifted. Also in profile position, which here leads only to the rest."""
        if power.state == stage.ENABLED and objects[0x6061] == TORQUE_MODE:
            return round(objects[0x6071] * N_PER_PERMILLE - BALANCE_N, 9)
        return -BALANCE_N

    def _torque(self, objects: Objects, power: Power) -> int:
        if power.state != stage.ENABLED:
            return 0
        on_part = self.coil.engaged and self.coil.force_n > 0.0
        return round((self.coil.measured_n + BALANCE_N) / N_PER_PERMILLE) if on_part else objects[0x6071]


TICK_S = 0.005
MARK_S = 0.02


async def spindle(runtime: SimRuntime) -> None:
    """Run the device as a spindle."""
    config, now_s = runtime.start.config.spindle, time.monotonic()
    rng = stream(runtime.start.seed, "motor")
    motor = Motor(rng, runtime.link.event, now_s, runtime.start.speed)
    runtime.script.suffer = motor.suffer
    objects = Objects()
    objects[0x6080] = config.max_rpm
    drive = Node(config.node, motor, runtime.link.event, now_s, objects)
    await _serve(runtime, drive, motor, CanWire(runtime, config.kind, config.port, drive.on_frame))


async def actuator(runtime: SimRuntime) -> None:
    """Run the device as a voice coil."""
    config, now_s, speed = runtime.start.config.actuator, time.monotonic(), runtime.start.speed
    coil = VoiceCoil(
        rng=stream(runtime.start.seed, "coil"),
        report=runtime.link.event,
        now_s=now_s,
        pace=CoilDynamics(config.land_s / speed, config.lift_s / speed, config.stick_share, config.resting_force_n),
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


CAN_LINKS = {"slcan": {"": "slcan"}, "socketcand": {"": "socketcand"}}
SIM_DEVICES = [
    SimDevice(
        name="cia402",
        device="spindle",
        section=SimSpindleSection,
        links=CAN_LINKS,
        main=spindle,
        faults=("reverse",),
    ),
    SimDevice(
        name="cia402",
        device="actuator",
        section=SimActuatorSection,
        links=CAN_LINKS,
        main=actuator,
        faults=COIL_FAULTS,
    ),
]
