"""Ports of devices as typing protocols. A simulated device uses the real driver with another address."""

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

# Time of the daemon: monotonic wall time.


class Clock(Protocol):
    """A monotonic clock with sleep."""

    def now_s(self) -> float:
        """Return the time of a monotonic clock, s."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Wait for that time."""
        ...


# Ordered stream of bytes: TCP, serial line or pseudo-terminal.


class ByteStream(Protocol):
    """Byte stream. Reads and writes raise LinkError if the link is dead; one message may take several reads."""

    async def read(self, at_most: int, within_s: float) -> bytes:
        """Read at least one byte; LinkError after ``within_s`` seconds of silence or at end of file."""
        ...

    async def write(self, data: bytes) -> None:
        """Write all bytes, or raise LinkError."""
        ...

    async def close(self) -> None:
        """Close the stream; idempotent."""
        ...


# The devices of a cell.


@runtime_checkable
class Device(Protocol):
    """Common methods of all devices."""

    async def open(self) -> None:
        """Connect and send a request. Causes no motion and changes no output. An open device is reconnected.

        Time: a few answers, ``times.silence_s`` each.
        Errors: LinkError without an answer; DeviceBusy if it still serves another client; DeviceClaimed if another
        program on this computer has its address (nothing was sent). For a device with roles or leases, ``open``
        confirms that this client may write.
        Cancelled: the device is closed.
        """
        ...

    async def close(self) -> None:
        """Disconnect; idempotent. The device's watchdog then makes it safe.

        Time: at once.
        Errors: none; other waiting calls get LinkError.
        Cancelled: the device may still be open; call ``close`` again.
        """
        ...

    async def identify(self) -> DeviceIdentity:
        """Return the identity of the device.

        Time: one answer.
        Errors: LinkError, ProtocolError.
        Cancelled: no effect.
        """
        ...

    async def status(self) -> DeviceStatus:
        """Request and return the device's present state, never an earlier one.

        Time: one answer.
        Errors: LinkError as soon as the link is dead, or silent for ``times.silence_s``; ProtocolError.
        Cancelled: no effect: the late answer is not taken for the next call's.
        """
        ...

    async def make_safe(self) -> None:
        """Stop all force and motion: robot held, force 0 and retracted, spindle stopped.

        Clears the fault of the device's watchdog. Allowed in any state, and by several callers at the same time. A
        closed device is opened for the call and closed again, unless another program has claimed its address. The
        daemon calls it only for devices that it has opened. Returns when the device confirms the state, never without
        confirmation. It overtakes all other calls.

        Time: the action's time in ``times``, and a few answers.
        Errors: LinkError if it cannot be confirmed; DeviceFault if the device reports that it failed.
        Cancelled: the action continues.
        """
        ...


@runtime_checkable
class Robot(Device, Protocol):
    """Robot: executes the numbered blocks of one program, in order, each once."""

    @property
    def times(self) -> RobotTimes:
        """Time limits of its actions."""
        ...

    async def prepare(self, plan: Plan) -> None:
        """Announce a program: hash, number of blocks. Drops the program before. The robot stays held.

        Time: a few answers.
        Errors: DeviceRefused while it runs; LinkError.
        Cancelled: the old program may be dropped; call ``prepare`` again.
        """
        ...

    async def send(self, segments: Sequence[Segment]) -> None:
        """Send blocks, in order, each a single line; waits for credit; returns when the robot has *accepted* them.

        Blocks that it has already accepted may be repeated, and are omitted.

        Time: until the robot's buffer has room: as long as the blocks before take.
        Errors: DeviceRefused for blocks out of order, and for one that the robot cannot read (by name); LinkError.
        Cancelled: some blocks may be accepted: ``progress`` reports how many.
        """
        ...

    async def progress(self) -> RobotProgress:
        """Return the robot's last report, at most a few tens of ms old.

        Time: at once.
        Errors: LinkError if the link is silent.
        Cancelled: no effect.
        """
        ...

    def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """Yield blocks as they are *executed*, in order, each once, from ``from_seq``.

        Several callers may iterate, also later. Ends when the program is done or dropped; survives a reconnect.

        Time: each within tens of ms of its end.
        Errors: LinkError if the link is lost.
        Cancelled: no effect; iterate again from any block.
        """
        ...

    async def hold(self) -> None:
        """Decelerate along the path and stop; returns when the robot stands still. Sent blocks are kept.

        Time: ``times.stop_s``.
        Errors: LinkError; DeviceFault if it does not stop.
        Cancelled: the robot still stops.
        """
        ...

    async def resume(self, until: int | None = None) -> None:
        """Start or continue; ``until``: stop after executing blocks with seq < until. Returns at once.

        Time: one answer.
        Errors: DeviceRefused without a program, or after ``lift``; LinkError.
        Cancelled: the robot may have started.
        """
        ...

    async def lift(self, distance_mm: float) -> None:
        """Leave the path along the tool's axis, off the part, by ``distance_mm``; returns at standstill.

        Used if the actuator does not lift: blended into the motion, so that the tool never stands still on the part.
        The program cannot be continued.

        Time: ``times.stop_s``.
        Errors: DeviceRefused, at once and without stopping, if the machine cannot lift; LinkError.
        Cancelled: the motion continues.
        """
        ...

    @property
    def buffer_s(self) -> float:
        """Wall seconds of motion ahead of the tool, by the robot's last report."""
        ...


@runtime_checkable
class ForceActuator(Device, Protocol):
    """Force actuator: presses the bonnet on the part. Its watchdog takes the force off and retracts."""

    @property
    def times(self) -> ActuatorTimes:
        """Time limits of its actions."""
        ...

    async def set_force(self, force_n: float) -> None:
        """Regulate to that force; lands first if retracted. 0 takes the force off and stays extended.

        Returns in contact; with 0 at once, and a retracted tool stays retracted.

        Time: one answer in contact; ``times.landing_s`` from retracted.
        Errors: DeviceRefused for a force below 0 or above the limit, NaN, after a watchdog trip, and if ``retract``
        overtook it; DeviceFault if there is no contact in time; LinkError. A link that was lost while the tool may be
        off its rest is not reopened before ``open``.
        Cancelled: the command stays in effect, and the tool may land: ``retract`` ends it.
        """
        ...

    def samples(self) -> AsyncIterator[ForceSample]:
        """Yield readings at the driver's rate while they are iterated; iterating feeds the watchdog.

        Each is read after the one before it was taken: readings are not buffered. A touch-off needs their
        ``position_mm``. Several callers may iterate, during all other calls.

        Time: a few in each ``times.watchdog_s``.
        Errors: LinkError as soon as the link is dead or silent. A fault of the device is a sample, not an error.
        Cancelled: no effect; without any iteration the watchdog trips.
        """
        ...

    async def retract(self) -> None:
        """Force 0, lift the tool; returns when it is off the part. Overtakes ``set_force``; leaves the set point at 0.

        Time: ``times.release_s`` and ``times.retract_s``.
        Errors: DeviceFault if it does not lift; LinkError.
        Cancelled: the tool still lifts.
        """
        ...


@runtime_checkable
class ForceSensor(Device, Protocol):
    """Force sensor: measures the force between tool and part, independently of the actuator. Exerts no force."""

    @property
    def times(self) -> SensorTimes:
        """Time limits of its actions."""
        ...

    async def tare(self) -> None:
        """Set the present reading to 0; returns when that is done. Called only while the tool does not touch the part.

        Time: ``times.tare_s``.
        Errors: DeviceRefused during another tare, or if it cannot be tared; DeviceFault; LinkError.
        Cancelled: the sensor may be tared or not; the next call tares it again.
        """
        ...

    def samples(self) -> AsyncIterator[SensedForce]:
        """Yield readings at the sensor's rate while they are iterated, each once.

        Time: several in each ``times.silence_s``, each at most ``times.delay_s`` old.
        Errors: LinkError as soon as the link is dead or silent. A fault of the sensor is a sample, not an error.
        Cancelled: no effect.
        """
        ...


@runtime_checkable
class Spindle(Device, Protocol):
    """Spindle: turns the bonnet."""

    @property
    def times(self) -> SpindleTimes:
        """Time limits of its actions."""
        ...

    async def set_speed(self, rpm: float) -> None:
        """Set the speed; returns when it is reached within 2 % (0: at standstill). A negative speed reverses.

        Time: ``times.spin_s``.
        Errors: DeviceRefused for a speed above the limit, NaN, or if ``make_safe`` overtook it; DeviceFault; LinkError.
        Cancelled: the command stays in effect, and the spindle may accelerate: ``make_safe`` ends it.
        """
        ...

    def samples(self) -> AsyncIterator[SpeedSample]:
        """Yield readings as the drive sends them; iterating feeds its watchdog.

        Time: several in each ``times.watchdog_s``.
        Errors: LinkError as soon as the link is dead or silent. A fault of the drive is a sample, not an error.
        Cancelled: no effect; without any iteration the drive stops.
        """
        ...


@runtime_checkable
class Metrology(Device, Protocol):
    """Metrology: provides surface maps."""

    async def next_map(self, after: str | None) -> SurfaceMap:
        """Request (if the instrument supports it) and wait for the next trusted map of this part.

        ``after`` is the sha256 of the last accepted map; the same content is never returned twice. A refused file is
        quarantined with its reason, and the call continues to wait.

        Time: as long as the instrument, or its operator, takes.
        Errors: SurfaceError if another request cannot help; DeviceError.
        Cancelled: no effect; the next call returns a map that arrives meanwhile.
        """
        ...


@runtime_checkable
class RefusesMaps(Protocol):
    """Metrology that reports each refused map. Optional: without it the daemon gets refused maps only at the end."""

    def on_refusal(self, listener: Callable[[MapRefusal], None] | None) -> None:
        """Call ``listener`` in the event loop, inside ``next_map``, for each refused map from now on; None: stop.

        Time: at once.
        Errors: none; ``next_map`` raises the errors of the listener.
        """
        ...


@runtime_checkable
class PartLoader(Device, Protocol):
    """Part loader: changes the part on the cell's seat, one part at a time.

    The daemon moves it only while every tool is up and every robot stands still, and moves nothing else until it has
    returned. ``make_safe`` stops it; ``unload`` or ``load`` continues from there.
    """

    @property
    def times(self) -> LoaderTimes:
        """Time limits of its actions."""
        ...

    async def loaded(self) -> str | None:
        """Return the id of the part on the seat, as the loader reports; None: the seat is empty.

        Time: one answer.
        Errors: LinkError, ProtocolError.
        Cancelled: no effect.
        """
        ...

    async def unload(self) -> None:
        """Take the part off the seat; returns when the loader is clear of the cell. An empty seat is no error.

        Time: ``times.change_s``.
        Errors: DeviceRefused if ``make_safe`` stopped it; DeviceFault; LinkError.
        Cancelled: the loader continues: ``make_safe`` stops it.
        """
        ...

    async def load(self, part_id: str) -> None:
        """Load that part on the empty seat, or leave it there; returns when the loader is clear of the cell.

        Time: ``times.change_s``.
        Errors: WrongPart if it has no such part; DeviceRefused if another part is on the seat, or ``make_safe``
        stopped it; DeviceFault; LinkError.
        Cancelled: the loader continues: ``make_safe`` stops it.
        """
        ...


@runtime_checkable
class Monitor(Device, Protocol):
    """Monitor: reads named signals of the cell: slurry flow, a pressure, a guard. Changes nothing."""

    @property
    def times(self) -> MonitorTimes:
        """Time limits of its answers."""
        ...

    def signals(self) -> AsyncIterator[Signal]:
        """Yield all its signals in turn, repeatedly, while they are iterated.

        Time: all of them within ``times.silence_s``.
        Errors: LinkError as soon as the link is dead or silent.
        Cancelled: no effect.
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
