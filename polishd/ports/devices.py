"""The devices of a cell.

Every driver keeps these rules. ``make_safe`` is idempotent, bounded in time and allowed in any state, also before
``open`` and after ``close``. No driver repeats a write on its own. A lost link raises LinkError at once to whoever
waits. ``times`` says how long its actions may take, from its config, also before ``open``: the daemon's own limits are
derived from that (``daemon.time_limits``).
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import Protocol, runtime_checkable

from polishd.model.devices import (
    DeviceStatus,
    Executed,
    ForceSample,
    Identity,
    RobotProgress,
    SensedForce,
    Signal,
    SpeedSample,
)
from polishd.model.program import Plan, Segment
from polishd.model.surface import SurfaceMap
from polishd.model.times import ActuatorTimes, LoaderTimes, MonitorTimes, RobotTimes, SensorTimes, SpindleTimes


@runtime_checkable
class Device(Protocol):
    """What all devices can do."""

    async def open(self) -> None:
        """Connect. Moves nothing, changes no output. LinkError where nobody answers."""
        ...

    async def close(self) -> None:
        """Disconnect; idempotent. The device falls to safe by itself when it hears nothing."""
        ...

    async def identify(self) -> Identity:
        """Who is there."""
        ...

    async def status(self) -> DeviceStatus:
        """Its own word on its state."""
        ...

    async def make_safe(self) -> None:
        """Exert nothing, move nothing: robot held, force 0 and retracted, spindle stopped."""
        ...


@runtime_checkable
class Robot(Device, Protocol):
    """Executes numbered blocks of one program, in order, each once."""

    @property
    def times(self) -> RobotTimes:
        """How long its actions may take."""
        ...

    async def prepare(self, plan: Plan) -> None:
        """Announce a program: hash, number of blocks. Drops what was loaded before. The robot stays held."""
        ...

    async def send(self, segments: Sequence[Segment]) -> None:
        """Hand over blocks; waits for credit; returns when the robot has *accepted* them."""
        ...

    async def progress(self) -> RobotProgress:
        """The robot's own last word, at most a few tens of ms old. LinkError when the link is silent."""
        ...

    def executed(self, from_seq: int = 0) -> AsyncIterator[Executed]:
        """Blocks as they are *executed*, in order, each once, from ``from_seq``.

        Ends when the program is done or dropped; survives a reconnect without loss. LinkError when the link is lost.
        """
        ...

    async def hold(self) -> None:
        """Decelerate along the path and stop; returns when the robot stands still."""
        ...

    async def resume(self, until: int | None = None) -> None:
        """Start or go on; ``until``: come to a stop after executing blocks with seq < until. Returns at once."""
        ...

    async def lift(self, distance_mm: float) -> None:
        """Leave the path along the tool's axis, off the part, by so much; returns when the robot stands there.

        The way out where the actuator does not lift: blended into the motion, so that the tool never stands. The
        program cannot be gone on with. DeviceRefused where the machine cannot.
        """
        ...

    @property
    def buffer_s(self) -> float:
        """Wall seconds of motion ahead of the tool, by the robot's last word."""
        ...


@runtime_checkable
class ForceActuator(Device, Protocol):
    """Presses the bonnet on the part. Hears nothing for its watchdog time: force off and retract, by itself."""

    @property
    def times(self) -> ActuatorTimes:
        """How long its actions may take."""
        ...

    async def set_force(self, force_n: float) -> None:
        """Regulate to that force; from retracted, lands first. 0 takes the force off and stays extended."""
        ...

    def samples(self) -> AsyncIterator[ForceSample]:
        """Readings at the driver's rate, for as long as they are iterated; iterating feeds the watchdog.

        Each was read after the one before it was taken: none waits for its taker. A touch-off needs their
        ``position_mm``.
        """
        ...

    async def retract(self) -> None:
        """Force 0, lift the tool; returns when it is off the part."""
        ...


@runtime_checkable
class ForceSensor(Device, Protocol):
    """Measures the force between tool and part, independently of the actuator. Exerts nothing."""

    @property
    def times(self) -> SensorTimes:
        """How long its actions may take."""
        ...

    async def tare(self) -> None:
        """What it reads now is 0 from now on; returns when it is. Asked for only while nothing touches the part."""
        ...

    def samples(self) -> AsyncIterator[SensedForce]:
        """Readings at the sensor's rate, for as long as they are iterated; none is given twice."""
        ...


@runtime_checkable
class Spindle(Device, Protocol):
    """Spins the bonnet."""

    @property
    def times(self) -> SpindleTimes:
        """How long its actions may take."""
        ...

    async def set_speed(self, rpm: float) -> None:
        """Returns when the speed is reached within 2 % (or stopped, for 0); DeviceFault or LinkError otherwise."""
        ...

    def samples(self) -> AsyncIterator[SpeedSample]:
        """Readings as the drive sends them; iterating keeps its command alive."""
        ...


@runtime_checkable
class Metrology(Device, Protocol):
    """Gives surface maps."""

    async def next_map(self, after: str | None) -> SurfaceMap:
        """Ask for (where the instrument can be asked) and wait for the next trusted map of this part.

        ``after`` is the sha256 of the last map taken; the same content is never given twice. A refused file is
        quarantined with its reason and waiting goes on; SurfaceError is raised when asking again cannot help.
        """
        ...


@runtime_checkable
class Loader(Device, Protocol):
    """Changes parts: one is on the cell's seat, the others are with it. Carries one at a time.

    It is asked to move only while every tool is up and every robot stands, and nothing else moves until it has
    returned. ``make_safe`` stops it where it is; ``unload`` or ``load`` goes on from there.
    """

    @property
    def times(self) -> LoaderTimes:
        """How long its actions may take."""
        ...

    async def loaded(self) -> str | None:
        """The id of the part on the seat, by its own word; None: the seat is empty."""
        ...

    async def unload(self) -> None:
        """Take the part off the seat; returns when the loader is clear of the cell. An empty seat is no error."""
        ...

    async def load(self, part_id: str) -> None:
        """Put that part on the empty seat, or leave it there; returns when the loader is clear of the cell.

        WrongPart where it has no such part; DeviceRefused where another one is on the seat.
        """
        ...


@runtime_checkable
class Monitor(Device, Protocol):
    """Tells named signals of the cell: slurry flow, a pressure, a guard. Changes nothing."""

    @property
    def times(self) -> MonitorTimes:
        """How long its answers may take."""
        ...

    def signals(self) -> AsyncIterator[Signal]:
        """All its signals in turn, again and again, for as long as they are iterated."""
        ...
