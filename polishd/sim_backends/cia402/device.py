"""The process of the drive, as a spindle or as an actuator, and the drive as a CANopen node.

The node has boot, heartbeats both ways, emergencies and objects. It is pure: the caller passes wall times.
"""

from __future__ import annotations

import asyncio
import math
import signal
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from polishd.config.simulator_devices import SimActuatorSection, SimSpindleSection
from polishd.config.simulator_faults import FaultSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.can import CanWire, Frame
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime
from polishd.sim_backends.common.voice_coil import COIL_FAULTS, CoilDynamics, VoiceCoil

# The drive's object dictionary and its SDO server (CiA 301): expedited transfers, checked as a drive does.

U8, U16, U32, I8, I16, I32 = "<B", "<H", "<I", "<b", "<h", "<i"

UNKNOWN_COMMAND, READ_ONLY, NO_OBJECT, NO_SUB, WRONG_LENGTH, RANGE, DEVICE_STATE = (
    0x05040001,
    0x06010002,
    0x06020000,
    0x06090011,
    0x06070010,
    0x06090030,
    0x08000022,
)
_SDO = struct.Struct("<BHB4s")

Key = tuple[int, int]
"""(index, sub)."""

# (index, sub): (type, writable, value at power-up)
OBJECTS: dict[Key, tuple[str, bool, int]] = {
    (0x1000, 0): (U32, False, 0x00020192),
    (0x1001, 0): (U8, False, 0),
    (0x1016, 0): (U8, False, 1),
    (0x1016, 1): (U32, True, 0),
    (0x1017, 0): (U16, True, 0),
    (0x1018, 0): (U8, False, 4),
    (0x1018, 1): (U32, False, 0x506F),
    (0x1018, 2): (U32, False, 0x0402),
    (0x1018, 3): (U32, False, 0x00010002),
    (0x1018, 4): (U32, False, 4020),
    (0x6007, 0): (I16, True, 1),
    (0x603F, 0): (U16, False, 0),
    (0x6040, 0): (U16, True, 0),
    (0x6041, 0): (U16, False, 0),
    (0x605A, 0): (I16, True, 2),
    (0x6060, 0): (I8, True, 0),
    (0x6061, 0): (I8, False, 0),
    (0x6064, 0): (I32, False, 0),
    (0x606C, 0): (I32, False, 0),
    (0x6071, 0): (I16, True, 0),
    (0x6072, 0): (U16, True, 1500),
    (0x6077, 0): (I16, False, 0),
    (0x607A, 0): (I32, True, 0),
    (0x6080, 0): (U32, True, 6000),
    (0x6081, 0): (U32, True, 1000),
    (0x6083, 0): (U32, True, 10000),
    (0x6084, 0): (U32, True, 10000),
    (0x6085, 0): (U32, True, 50000),
    (0x6087, 0): (U32, True, 1000),
    (0x60FF, 0): (I32, True, 0),
    (0x6502, 0): (U32, False, 0b1101),
}
RANGES = {(0x6007, 0): (0, 3), (0x605A, 0): (0, 6), (0x6060, 0): (0, 4), (0x6071, 0): (-1500, 1500)}
"""Values that may be written, where the type holds more."""


@dataclass(slots=True)
class Objects:
    """The values of one drive. The drive may change all of them, a client the writable ones."""

    on_write: Callable[[Key, int], int] = lambda _key, _value: 0
    """Called before a client's value is stored; an abort code refuses the value."""
    values: dict[Key, int] = field(default_factory=lambda: {key: value for key, (_, _, value) in OBJECTS.items()})

    def __getitem__(self, index: int) -> int:
        return self.values[index, 0]

    def __setitem__(self, index: int, value: int) -> None:
        self.values[index, 0] = value

    def serve(self, request: bytes) -> bytes | None:
        """Answer a client's eight bytes; None: no answer is due."""
        specifier, index, sub, data = _SDO.unpack(request)
        key = (index, sub)
        if specifier == 0x80:
            return None
        if specifier >> 5 not in {1, 2}:
            return self._abort(key, UNKNOWN_COMMAND)
        if key not in self.values:
            return self._abort(key, NO_SUB if any(index == known for known, _ in self.values) else NO_OBJECT)
        if specifier == 0x40:
            return self._read(key)
        return self._write(key, specifier, data)

    def _read(self, key: Key) -> bytes:
        data = struct.pack(OBJECTS[key][0], self.values[key])
        return _SDO.pack(0x43 | (4 - len(data)) << 2, *key, data.ljust(4, b"\0"))

    def _write(self, key: Key, specifier: int, data: bytes) -> bytes:
        kind, writable, _ = OBJECTS[key]
        size = struct.calcsize(kind)
        if not writable:
            return self._abort(key, READ_ONLY)
        if specifier != 0x23 | (4 - size) << 2:
            return self._abort(key, WRONG_LENGTH)
        (value,) = struct.unpack(kind, data[:size])
        low, high = RANGES.get(key, (value, value))
        code = self.on_write(key, value) if low <= value <= high else RANGE
        if code:
            return self._abort(key, code)
        self.values[key] = value
        return _SDO.pack(0x60, *key, bytes(4))

    def _abort(self, key: Key, code: int) -> bytes:
        return _SDO.pack(0x80, *key, struct.pack("<I", code))


# The power stage's state machine (CiA 402), by its numbered transitions. Pure.

DISABLED, READY, ON, ENABLED, QUICK_STOP, REACTION, FAULT = range(7)
STATUS = (0x250, 0x231, 0x233, 0x237, 0x217, 0x21F, 0x218)
"""Low bits of the status word in each state, with voltage and remote; quick stop shows in bit 5."""


@dataclass(slots=True)
class Power:
    """Follow control words and events."""

    state: int = DISABLED
    control: int = 0
    quick_stop_option: int = 2

    @property
    def status(self) -> int:
        """State bits of the status word."""
        return STATUS[self.state]

    @property
    def live(self) -> bool:
        """The motor has current."""
        return self.state in {ENABLED, QUICK_STOP, REACTION}

    def command(self, word: int) -> None:
        """Apply a control word. A word that is no command in this state changes nothing."""
        rises = word & ~self.control
        self.control = word
        if self.state == FAULT:
            if rises & 0x80:
                self.state = DISABLED
        elif self.state != REACTION:
            self.state = self._next(word)

    def fault(self) -> None:
        """React to a fault: stop, then enter the fault state."""
        if self.state != FAULT:
            self.state = REACTION if self.live else FAULT

    def stands(self) -> None:
        """React to the standstill of the motor."""
        if self.state == REACTION:
            self.state = FAULT
        elif self.state == QUICK_STOP and self.quick_stop_option <= 4:
            self.state = DISABLED

    def _next(self, word: int) -> int:
        if not word & 0x02:
            return DISABLED
        if not word & 0x04:
            stops = self.state in {ENABLED, QUICK_STOP} and self.quick_stop_option != 0
            return QUICK_STOP if stops else DISABLED
        low = word & 0x0F
        if self.state == QUICK_STOP:
            return ENABLED if low == 0x0F and self.quick_stop_option > 4 else QUICK_STOP
        if low == 0x06:  # shut down
            return READY
        if low == 0x07:  # switch on, or disable operation
            return self.state if self.state == DISABLED else ON
        if low == 0x0F:  # enable; from READY by way of ON, within one command as CiA 402 allows
            return ENABLED if self.state in {READY, ON, ENABLED} else self.state
        return self.state


BOOTING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
SILENCE, BUS_OFF_OVER, OVER_CURRENT = 0x8130, 0x8140, 0x2310
COMMUNICATION_BITS, DRIVE_BITS = 0x11, 0x03
"""Bit of the error register."""
RESET_NODE, RESET_COMMUNICATION = 0x81, 0x82
COMMUNICATION_END = 0x2000
"""Objects below this index belong to the communication."""
FAULT_RESET = 0x80
BOOT_S = 0.3


class SimAxis(Protocol):
    """The axis that the drive moves."""

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        """Advance to the present: apply the set points, write the actual values, report standstill."""
        ...


@dataclass(slots=True)
class Node:
    """One drive on the bus. ``on_frame`` takes a frame of the bus; ``step`` returns the frames that the drive sends."""

    node: int
    axis: SimAxis
    report: Callable[..., None]
    """Write to the event log: (event, at_s)."""
    now_s: float
    objects: Objects = field(default_factory=Objects)
    power: Power = field(default_factory=Power)
    state: int = PRE_OPERATIONAL
    hung: bool = False
    """The firmware has died: the drive continues as it is, sends nothing and watches nothing."""
    _delivered: dict[Key, int] = field(default_factory=dict)
    """Values of the objects at power-up."""
    _dark_until_s: float = 0.0
    """Until then the drive has no power, or is off the bus."""
    _was_off: bool = False
    _out: list[Frame] = field(default_factory=list)
    _beat_s: float = 0.0
    _heartbeat_s: float | None = None
    """Last heartbeat of the watched controller; None: none yet, and nothing is watched."""
    _silent: bool = False
    _estranged: bool = False
    """In fault after a lost heartbeat: a fault reset works only after a communication reset, as with some drives."""

    def __post_init__(self) -> None:
        """Power up."""
        self.objects.on_write = self._written
        self._delivered = dict(self.objects.values)
        self._booted()

    def on_frame(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame; return the answers."""
        if self.hung or self.now_s < self._dark_until_s:
            return []
        if identifier == 0x600 + self.node and len(data) == 8 and self.state != STOPPED:
            answer = self.objects.serve(data)
            return [(0x580 + self.node, answer)] if answer else []
        if identifier == 0x000 and len(data) == 2 and data[1] in {0, self.node}:
            self._manage(data[0])
        elif identifier == 0x700 + self._watched and identifier != 0x700:
            self._heard()
        return []

    def step(self, now_s: float) -> list[Frame]:
        """Advance the drive to the present; return the frames that are due."""
        self.now_s = max(now_s, self.now_s)
        was = self.power.state
        self.axis.step(self.now_s, self.objects, self.power)
        if self.power.state == FAULT != was:
            self.report("drive_fault", self.now_s)
        self._show()
        if not self.hung:
            self._watch()
        if self.hung or self.now_s < self._dark_until_s:
            self._out.clear()
            return []
        if self.state == BOOTING:
            self._booted()
        elif self._was_off:
            self._emergency(BUS_OFF_OVER)
        self._was_off = False
        frames = [*self._out, *self._heartbeat()]
        self._out.clear()
        return frames

    def fail(self, code: int = OVER_CURRENT) -> None:
        """Raise the drive's fault."""
        self.objects[0x603F] = code
        self.objects[0x1001] |= DRIVE_BITS
        self._emergency(code)
        self.power.fault()

    def reboot(self) -> None:
        """Lose power for a while, and all settings with it; the drive comes up with its factory values."""
        self.objects.values.update(self._delivered)
        self.power = Power()
        self._heartbeat_s, self._silent, self._estranged = None, False, False
        self.state, self._dark_until_s = BOOTING, self.now_s + BOOT_S

    def bus_off(self, for_s: float) -> None:
        """Go bus-off after too many errors: the drive receives and sends nothing for a while, then reports it."""
        self._dark_until_s, self._was_off = self.now_s + for_s, True

    @property
    def _watched(self) -> int:
        return self.objects.values[0x1016, 1] >> 16 & 0x7F

    def _manage(self, command: int) -> None:
        if command == RESET_NODE:
            self.reboot()
        elif command == RESET_COMMUNICATION:
            kept = {key: value for key, value in self._delivered.items() if key[0] < COMMUNICATION_END}
            self.objects.values.update(kept)
            self._heartbeat_s, self._silent, self._estranged = None, False, False
            self._booted()
        self.state = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}.get(command, self.state)

    def _booted(self) -> None:
        self.state, self._beat_s = PRE_OPERATIONAL, self.now_s
        self._out.insert(0, (0x700 + self.node, b"\x00"))

    def _written(self, key: Key, value: int) -> int:
        if key == (0x60FF, 0) and abs(value) > 10 * self.objects[0x6080]:
            return RANGE
        if key == (0x6060, 0) and value not in {0, 1, 3, 4}:
            return RANGE
        if key == (0x6060, 0) and self.power.state in {QUICK_STOP, REACTION}:
            return DEVICE_STATE
        if key == (0x6040, 0) and value & FAULT_RESET and self._estranged:
            return 0  # taken, and ignored
        if key == (0x6060, 0):
            self.objects[0x6061] = value
        elif key == (0x605A, 0):
            self.power.quick_stop_option = value
        elif key == (0x1016, 1):
            self._heartbeat_s, self._silent = None, False
        elif key == (0x6040, 0):
            self._command(value)
        return 0

    def _command(self, word: int) -> None:
        was = self.power.state
        self.power.command(word)
        if was == FAULT != self.power.state:
            self.objects[0x603F] = 0
            self.objects[0x1001] = COMMUNICATION_BITS if self._silent else 0
            self._emergency(0)
        self._show()

    def _heard(self) -> None:
        self._heartbeat_s = self.now_s
        if self._silent:
            self._silent = False
            if self.power.state != FAULT:
                self.objects[0x1001] = self.objects[0x603F] = 0
                self._emergency(0)

    def _watch(self) -> None:
        within_s = (self.objects.values[0x1016, 1] & 0xFFFF) / 1000.0
        if self._silent or self._heartbeat_s is None or not within_s or self.now_s - self._heartbeat_s <= within_s:
            return
        self._silent = self._estranged = True
        self.report("watchdog", self.now_s)
        self.objects[0x1001] |= COMMUNICATION_BITS
        self.objects[0x603F] = SILENCE
        self._emergency(SILENCE)
        self.state = PRE_OPERATIONAL
        if self.power.state == ENABLED:
            self._abandoned(self.objects[0x6007])

    def _abandoned(self, option: int) -> None:
        """React to a lost heartbeat as configured."""
        if option == 1:
            self.power.fault()
        elif option == 2:
            self.power.command(0x00)
        elif option == 3:
            self.power.command(0x02)

    def _show(self) -> None:
        reached = self.objects[0x6041] & 0x1400
        self.objects[0x6041] = self.power.status | reached

    def _emergency(self, code: int) -> None:
        self._out.append((0x080 + self.node, struct.pack("<HB5x", code, self.objects[0x1001])))

    def _heartbeat(self) -> Iterator[Frame]:
        every_s = self.objects[0x1017] / 1000.0
        if every_s and self.now_s - self._beat_s >= every_s:
            self._beat_s = self.now_s
            yield 0x700 + self.node, bytes([self.state])


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
        if power.state == ENABLED and objects[0x6061] == VELOCITY_MODE:
            goal = objects[0x60FF] * RPM
            return goal, objects[0x6083 if abs(goal) > abs(self._demand) else 0x6084] * RPM
        if power.live:
            return 0.0, objects[0x6085] * RPM
        return 0.0, COAST_RPM_S

    def _report_motion(self, power: Power, reached: bool) -> None:
        event = "spindle_ramping"
        if power.state == FAULT:
            event = "spindle_fault"
        elif self.rpm == 0.0 and self._demand == 0.0:
            event = "spindle_stopped"
        elif reached and power.state == ENABLED:
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
        if power.state in {QUICK_STOP, REACTION}:
            power.stands()
        objects[0x6064] = round(coil.position_um)
        objects[0x6077] = self._torque(objects, power)

    def _pressed_n(self, objects: Objects, power: Power) -> float:
        """Force on the part; negative: lifted. Also in profile position, which here leads only to the rest."""
        if power.state == ENABLED and objects[0x6061] == TORQUE_MODE:
            return round(objects[0x6071] * N_PER_PERMILLE - BALANCE_N, 9)
        return -BALANCE_N

    def _torque(self, objects: Objects, power: Power) -> int:
        if power.state != ENABLED:
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
