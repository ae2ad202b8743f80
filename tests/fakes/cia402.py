"""Run the simulated CiA 402 drive in the test's loop behind a fake adapter; tests can change its frames."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from polishd.api import ActuatorTimes, SpindleTimes
from polishd.drivers.cia402.actuator import ActuatorScale, Cia402Actuator
from polishd.drivers.cia402.drive import CanNodeAddress
from polishd.drivers.cia402.protocol import read_dictionary
from polishd.drivers.cia402.spindle import Cia402Spindle, SpindleScale
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.sim_backends.cia402 import device as stage
from polishd.sim_backends.cia402.device import Motor, Node, Objects, Power, SimAxis

EDS = Path(__file__).resolve().parents[2] / "examples" / "drive.eds"
NODE, CONTROLLER = 5, 0x45
TICK_S = 0.01
MOVE_S = 0.06
TOUCH_MM = 5.0
BALANCE_N = 2.0
N_PER_PERMILLE = 0.05

Frame = tuple[int, bytes]


class FakeCoil:
    """Voice coil that presses with the commanded force at once; a spring of 2 N lifts it."""

    def __init__(self) -> None:
        self.position_mm = 0.0
        self.net_n = -BALANCE_N
        self.touch_mm = TOUCH_MM
        self.stuck = False
        self.modes: list[int] = []
        self._at = time.monotonic()

    @property
    def force_n(self) -> float:
        """Force on the part."""
        return max(self.net_n, 0.0) if self.position_mm >= self.touch_mm else 0.0

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        torque = objects[0x6071] if power.state == stage.ENABLED and objects[0x6061] == 4 else 0
        self.net_n = round(torque * N_PER_PERMILLE - BALANCE_N, 9)
        way_mm = 0.0 if self.stuck else TOUCH_MM * (now_s - self._at) / MOVE_S
        self._at = now_s
        if self.net_n > 0.0:
            self.position_mm = min(self.position_mm + way_mm, self.touch_mm)
        elif self.net_n < 0.0:
            self.position_mm = max(self.position_mm - way_mm, 0.0)
        objects[0x6064] = round(1000 * self.position_mm)
        objects[0x6077] = torque
        if power.live and self.modes[-1:] != [objects[0x6061]]:
            self.modes.append(objects[0x6061])
        if power.state in {stage.QUICK_STOP, stage.REACTION}:
            power.stands()


class SimDrive:
    """Node with its own clock. ``treat`` returns the frames to send instead of each frame."""

    def __init__(self, axis: SimAxis) -> None:
        self.send: Callable[[int, bytes], None] = lambda identifier, data: None
        self.treat: Callable[[Frame], Iterable[Frame]] = lambda frame: [frame]
        self.instead: dict[bytes, bytes] = {}
        """Answers to SDO requests with these first bytes, instead of those of the drive."""
        self.beats = 0
        """Number of heartbeats of the controller."""
        self.received: list[Frame] = []
        self.events: list[str] = []
        self.node = Node(NODE, axis, lambda name, at_s, **_: self.events.append(name), time.monotonic())
        self._timer = asyncio.get_running_loop().call_later(TICK_S, self._tick)

    def stop(self) -> None:
        """Switch the node off."""
        self._timer.cancel()

    def on_frame(self, identifier: int, data: bytes) -> None:
        """Receive a frame from the bus."""
        self.beats += identifier == 0x700 + CONTROLLER
        if identifier != 0x700 + CONTROLLER:
            self.received.append((identifier, data))
        for begin, answer in self.instead.items():
            if identifier == 0x600 + NODE and data.startswith(begin):
                return self._say([(0x580 + NODE, answer)])
        self._say(self.node.on_frame(identifier, data))
        self._say(self.node.step(time.monotonic()))
        return None

    def written(self, index: int) -> list[int]:
        """Return the values that were written to an object so far."""
        key = index.to_bytes(2, "little")
        writes = [data for ident, data in self.received if ident == 0x600 + NODE and data[0] >> 5 == 1]
        return [int.from_bytes(data[4:], "little") for data in writes if data[1:3] == key]

    def _tick(self) -> None:
        self._say(self.node.step(time.monotonic()))
        self._timer = asyncio.get_running_loop().call_later(TICK_S, self._tick)

    def _say(self, frames: list[Frame]) -> None:
        for frame in frames:
            for treated in self.treat(frame):
                self.send(*treated)


def sim_motor() -> tuple[SimDrive, Motor]:
    """Return the drive of a spindle."""
    motor = Motor(np.random.default_rng(4), lambda *_, **__: None, time.monotonic())
    return SimDrive(motor), motor


def sim_coil() -> tuple[SimDrive, FakeCoil]:
    """Return the drive of a voice coil."""
    coil = FakeCoil()
    return SimDrive(coil), coil


def place(bus: SlcanAddress | SocketcandAddress, silence_s: float, watchdog_s: float) -> CanNodeAddress:
    """Return the address of that drive."""
    return CanNodeAddress(bus, NODE, CONTROLLER, silence_s, watchdog_s)


def cia402_spindle(bus: SlcanAddress | SocketcandAddress, times: SpindleTimes, eds: Path = EDS) -> Cia402Spindle:
    """Return the driver of that drive."""
    scale = SpindleScale(
        0.1, max_rpm=6500.0, acceleration_rpm_s=20_000.0, deceleration_rpm_s=20_000.0, quick_stop_rpm_s=20_000.0
    )
    return Cia402Spindle(place(bus, times.silence_s, times.watchdog_s), read_dictionary(eds, NODE), scale, times)


def cia402_actuator(bus: SlcanAddress | SocketcandAddress, times: ActuatorTimes, **scale: object) -> Cia402Actuator:
    """Return the driver of that drive."""
    scaled = ActuatorScale(N_PER_PERMILLE, 0.001, balance_n=BALANCE_N, travel_mm_s=5.0, **scale)
    return Cia402Actuator(place(bus, times.silence_s, times.watchdog_s), read_dictionary(EDS, NODE), scaled, times)
