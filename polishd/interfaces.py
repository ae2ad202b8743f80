"""What a device is, as typing protocols. Real and simulated devices are the same driver with another address."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from typing import Protocol, runtime_checkable

from polishd.model.devices import (
    ActuatorTimes,
    DeviceIdentity,
    DeviceStatus,
    ExecutedBlock,
    ForceSample,
    LoaderTimes,
    MapRefusal,
    MonitorTimes,
    RobotProgress,
    RobotTimes,
    SensedForce,
    SensorTimes,
    Signal,
    SpeedSample,
    SpindleTimes,
)
from polishd.model.program import Plan, Segment
from polishd.model.surface import SurfaceMap

# Time as the daemon sees it: wall time, monotonic.


class Clock(Protocol):
    """A monotonic clock that can be waited on."""

    def now_s(self) -> float:
        """Seconds on a monotonic clock."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Wait that long."""
        ...


# An ordered stream of bytes: TCP, serial line or pseudo-terminal.


class ByteStream(Protocol):
    """Reads and writes raise LinkError when the link is dead; a message is never assumed to be one read."""

    async def read(self, at_most: int, within_s: float) -> bytes:
        """At least one byte, or LinkError after ``within_s`` seconds of silence or at end of file."""
        ...

    async def write(self, data: bytes) -> None:
        """Hand over all bytes, or LinkError."""
        ...

    async def close(self) -> None:
        """Idempotent."""
        ...


# The devices of a cell.


@runtime_checkable
class Device(Protocol):
    """What all devices can do."""

    async def open(self) -> None:
        """Connect, and ask it something. Moves nothing, changes no output. An open device is connected anew.

        Time: a few answers, ``times.silence_s`` each.
        Errors: LinkError where nobody answers; DeviceBusy where it still serves another client; DeviceClaimed where
        another program on this computer has its address, and nothing was sent. A device that gives roles or leases
        proves here that this client may write.
        Cancelled: it is closed.
        """
        ...

    async def close(self) -> None:
        """Disconnect; idempotent. The device falls to safe by itself when it hears nothing.

        Time: at once.
        Errors: none; whoever still waits in another call gets LinkError.
        Cancelled: it may be open still; ``close`` again.
        """
        ...

    async def identify(self) -> DeviceIdentity:
        """Who is there.

        Time: an answer.
        Errors: LinkError, ProtocolError.
        Cancelled: nothing is left behind.
        """
        ...

    async def status(self) -> DeviceStatus:
        """Its own word on its state, asked for now: never what it said before.

        Time: an answer.
        Errors: LinkError as soon as the link is dead, or silent for ``times.silence_s``; ProtocolError.
        Cancelled: nothing is left behind: its answer is not taken for that to the next call.
        """
        ...

    async def make_safe(self) -> None:
        """Exert nothing, move nothing: robot held, force 0 and retracted, spindle stopped.

        Clears what the device's watchdog left. In any state, by many at once; a device that is not open is opened for
        it, and closed again, unless another program has claimed its address. The daemon asks only devices that it has
        opened. Returns when the device says that it is so: it never says yes without proof. It overtakes
        all other calls.

        Time: what the action takes by ``times``, and a few answers.
        Errors: LinkError where it cannot be confirmed; DeviceFault where the device says that it cannot.
        Cancelled: what was ordered goes on.
        """
        ...


@runtime_checkable
class Robot(Device, Protocol):
    """Executes numbered blocks of one program, in order, each once."""

    @property
    def times(self) -> RobotTimes:
        """How long its actions may take."""
        ...

    async def prepare(self, plan: Plan) -> None:
        """Announce a program: hash, number of blocks. Drops what was loaded before. The robot stays held.

        Time: a few answers.
        Errors: DeviceRefused while it runs; LinkError.
        Cancelled: the old program may be gone; prepare again.
        """
        ...

    async def send(self, segments: Sequence[Segment]) -> None:
        """Hand over blocks, in order, each a single line; waits for credit; returns when the robot has *accepted* them.

        Those that it has accepted already may come again, and are left away.

        Time: until there is room: as long as the blocks before take.
        Errors: DeviceRefused for blocks out of turn, and for one that the robot cannot read (by name); LinkError.
        Cancelled: some may have been accepted: ``progress`` says how many.
        """
        ...

    async def progress(self) -> RobotProgress:
        """The robot's own last word, at most a few tens of ms old.

        Time: at once.
        Errors: LinkError when the link is silent.
        Cancelled: nothing is left behind.
        """
        ...

    def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """Blocks as they are *executed*, in order, each once, from ``from_seq``.

        For several at once, also after the fact. Ends when the program is done or dropped; survives a reconnect.

        Time: each within tens of ms of its end.
        Errors: LinkError when the link is lost.
        Cancelled: nothing is left behind; iterate again from any block.
        """
        ...

    async def hold(self) -> None:
        """Decelerate along the path and stop; returns when the robot stands still. What was sent stays.

        Time: ``times.stop_s``.
        Errors: LinkError; DeviceFault where it does not come to stand.
        Cancelled: it stops all the same.
        """
        ...

    async def resume(self, until: int | None = None) -> None:
        """Start or go on; ``until``: come to a stop after executing blocks with seq < until. Returns at once.

        Time: an answer.
        Errors: DeviceRefused without a program, or after ``lift``; LinkError.
        Cancelled: it may have started.
        """
        ...

    async def lift(self, distance_mm: float) -> None:
        """Leave the path along the tool's axis, off the part, by so much; returns when the robot stands there.

        The way out where the actuator does not lift: blended into the motion, so that the tool never stands. The
        program cannot be gone on with.

        Time: ``times.stop_s``.
        Errors: DeviceRefused, at once and without stopping, where the machine cannot; LinkError.
        Cancelled: it goes on.
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
        """Regulate to that force; from retracted, lands first. 0 takes the force off and stays extended.

        Returns in contact; with 0 at once, and a tool that is retracted stays so.

        Time: an answer in contact; ``times.landing_s`` from retracted.
        Errors: DeviceRefused for less than 0, more than it may, NaN, after its watchdog ran out, and where ``retract``
        overtook it; DeviceFault where there is no contact in time; LinkError. A link that was lost while the tool
        may be off its rest is not taken up again before ``open``.
        Cancelled: the order stands, and it may be landing: ``retract`` ends it.
        """
        ...

    def samples(self) -> AsyncIterator[ForceSample]:
        """Readings at the driver's rate, for as long as they are iterated; iterating feeds the watchdog.

        Each was read after the one before it was taken: none waits for its taker. A touch-off needs their
        ``position_mm``. Several may iterate, beside all other calls.

        Time: a few in each ``times.watchdog_s``.
        Errors: LinkError as soon as the link is dead or silent. A fault of the device is a sample, not an error.
        Cancelled: nothing is left behind; where nobody iterates any more, the watchdog runs out.
        """
        ...

    async def retract(self) -> None:
        """Force 0, lift the tool; returns when it is off the part. Overtakes ``set_force``; leaves the set point at 0.

        Time: ``times.release_s`` and ``times.retract_s``.
        Errors: DeviceFault where it does not lift; LinkError.
        Cancelled: it lifts all the same.
        """
        ...


@runtime_checkable
class ForceSensor(Device, Protocol):
    """Measures the force between tool and part, independently of the actuator. Exerts nothing."""

    @property
    def times(self) -> SensorTimes:
        """How long its actions may take."""
        ...

    async def tare(self) -> None:
        """What it reads now is 0 from now on; returns when it is. Asked for only while nothing touches the part.

        Time: ``times.tare_s``.
        Errors: DeviceRefused while another tare is under way, or where it cannot be tared; DeviceFault; LinkError.
        Cancelled: it may be tared or not; the next call tares it anew.
        """
        ...

    def samples(self) -> AsyncIterator[SensedForce]:
        """Readings at the sensor's rate, for as long as they are iterated; none is given twice.

        Time: several in each ``times.silence_s``, each ``times.delay_s`` old at most.
        Errors: LinkError as soon as the link is dead or silent. A fault of the sensor is a sample, not an error.
        Cancelled: nothing is left behind.
        """
        ...


@runtime_checkable
class Spindle(Device, Protocol):
    """Spins the bonnet."""

    @property
    def times(self) -> SpindleTimes:
        """How long its actions may take."""
        ...

    async def set_speed(self, rpm: float) -> None:
        """Returns when the speed is reached within 2 % (or stopped, for 0); a negative one turns the other way.

        Time: ``times.spin_s``.
        Errors: DeviceRefused for more than it may, NaN, and where ``make_safe`` overtook it; DeviceFault; LinkError.
        Cancelled: the order stands, and it may be spinning up: ``make_safe`` ends it.
        """
        ...

    def samples(self) -> AsyncIterator[SpeedSample]:
        """Readings as the drive sends them; iterating keeps its command alive.

        Time: several in each ``times.watchdog_s``.
        Errors: LinkError as soon as the link is dead or silent. A fault of the drive is a sample, not an error.
        Cancelled: nothing is left behind; where nobody iterates any more, the drive stops by itself.
        """
        ...


@runtime_checkable
class Metrology(Device, Protocol):
    """Gives surface maps."""

    async def next_map(self, after: str | None) -> SurfaceMap:
        """Ask for (where the instrument can be asked) and wait for the next trusted map of this part.

        ``after`` is the sha256 of the last map taken; the same content is never given twice. A refused file is
        quarantined with its reason and waiting goes on.

        Time: as long as the instrument, or its operator, takes.
        Errors: SurfaceError when asking again cannot help; DeviceError.
        Cancelled: nothing is left behind; a map that comes meanwhile is given to the next call.
        """
        ...


@runtime_checkable
class RefusesMaps(Protocol):
    """Metrology that reports each map that it refuses. Optional: without it the daemon knows of none before the end."""

    def on_refusal(self, listener: Callable[[MapRefusal], None] | None) -> None:
        """Call ``listener`` for each refused map from now on, in the event loop, inside ``next_map``; None: no longer.

        Time: at once.
        Errors: none; what the listener raises comes out of ``next_map``.
        """
        ...


@runtime_checkable
class PartLoader(Device, Protocol):
    """Changes parts: one is on the cell's seat, the others are with it. Carries one at a time.

    It is asked to move only while every tool is up and every robot stands, and nothing else moves until it has
    returned. ``make_safe`` stops it where it is; ``unload`` or ``load`` goes on from there.
    """

    @property
    def times(self) -> LoaderTimes:
        """How long its actions may take."""
        ...

    async def loaded(self) -> str | None:
        """The id of the part on the seat, by its own word; None: the seat is empty.

        Time: an answer.
        Errors: LinkError, ProtocolError.
        Cancelled: nothing is left behind.
        """
        ...

    async def unload(self) -> None:
        """Take the part off the seat; returns when the loader is clear of the cell. An empty seat is no error.

        Time: ``times.change_s``.
        Errors: DeviceRefused where ``make_safe`` stopped it; DeviceFault; LinkError.
        Cancelled: it goes on moving: ``make_safe`` stops it.
        """
        ...

    async def load(self, part_id: str) -> None:
        """Put that part on the empty seat, or leave it there; returns when the loader is clear of the cell.

        Time: ``times.change_s``.
        Errors: WrongPart where it has no such part; DeviceRefused where another one is on the seat, or ``make_safe``
        stopped it; DeviceFault; LinkError.
        Cancelled: it goes on moving: ``make_safe`` stops it.
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
        """All its signals in turn, again and again, for as long as they are iterated.

        Time: all of them within ``times.silence_s``.
        Errors: LinkError as soon as the link is dead or silent.
        Cancelled: nothing is left behind.
        """
        ...


__all__ = [
    "ByteStream",
    "Clock",
    "Device",
    "ForceActuator",
    "ForceSensor",
    "Metrology",
    "Monitor",
    "PartLoader",
    "Robot",
    "Spindle",
]
