"""Devices of a cell by name, the devices that a job uses, and the clock; independent of the job itself."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict, dataclass, field
from typing import Any, NoReturn, cast

from polishd.config.cell import PORTS
from polishd.daemon.cell.device_polling import LET_GO_S, with_deadline
from polishd.daemon.cell.time_limits import TimeLimits, released_within_s, safe_within_s
from polishd.daemon.runtime.memory import named
from polishd.interfaces import Clock, Device, ForceActuator, ForceSensor, Metrology, Robot, Spindle
from polishd.model.devices import (
    DeviceIdentity,
    DeviceStatus,
    ForceSample,
    MapRefusal,
    RobotProgress,
    SensedForce,
    Signal,
    SignalLimits,
    SpeedSample,
    port_of,
)
from polishd.model.errors import DeviceBusy, DeviceClaimed, DeviceFault, DeviceRefused, LinkError
from polishd.util.address_claims import KeptClaims
from polishd.util.wire_recording import record_sent

# Latest readings of the devices for status displays, kept from the running communication without extra requests.


@dataclass(slots=True)
class LiveValues:
    """Latest readings of the job's devices; None before the first one. Times are of ``time.monotonic``."""

    force: ForceSample | None = None
    speed: SpeedSample | None = None
    sensed: SensedForce | None = None
    robot: RobotProgress | None = None
    robot_s: float = 0.0
    """When the robot reported its progress."""

    def update_robot(self, progress: RobotProgress) -> None:
        """Store the robot's latest progress."""
        self.robot, self.robot_s = progress, time.monotonic()

    def facts(self) -> dict[str, dict[str, Any] | None]:
        """Return each reading with its age, ``age_s``."""
        samples = {"force": self.force, "speed": self.speed, "sensed": self.sensed}
        readings: dict[str, dict[str, Any] | None] = {
            name: None if sample is None else _aged(asdict(sample), sample.at_s) for name, sample in samples.items()
        }
        return {**readings, "robot": None if self.robot is None else _aged(asdict(self.robot), self.robot_s)}


def _aged(facts: dict[str, Any], at_s: float) -> dict[str, Any]:
    """Replace the time, which is valid in this process only, by the age."""
    facts.pop("at_s", None)
    return {**facts, "age_s": round(max(time.monotonic() - at_s, 0.0), 3)}


# Approval of a plan by an operator (``job.approve``).


@dataclass(slots=True)
class Approval:
    """Plan that waits for the approval of an operator."""

    wanted: str = ""
    """Hash of the program; empty if no plan waits."""
    _given: asyncio.Event = field(default_factory=asyncio.Event)

    async def until_given(self, program_sha256: str) -> None:
        """Wait for the approval; after the wait, however it ended, no plan waits."""
        self._given.clear()
        self.wanted = program_sha256
        try:
            await self._given.wait()
        finally:
            self.wanted = ""

    def give(self, program_sha256: str) -> None:
        """Approve that program; DeviceRefused if no plan or another plan waits."""
        if not self.wanted:
            raise DeviceRefused("approve is refused: no plan waits for it")
        if program_sha256 != self.wanted:
            raise DeviceRefused("approve is refused: another plan waits now. Check that plan and approve it")
        self._given.set()


# Signals of the cell's monitors, checked against their limits before contact and in contact.


class Signals:
    """Signals of one cell, possibly none, with their limits."""

    def __init__(self, limits: Sequence[SignalLimits] = (), silence_s: Mapping[str, float] | None = None) -> None:
        """``silence_s``: for each monitor, the longest time without a value of a signal."""
        self.limits = limits
        self._silence_s = silence_s or {}
        self._last: dict[tuple[str, str], Signal] = {}
        self._silent_s: dict[tuple[str, str], float] = {}
        self._bad_s: dict[str, float] = {}
        self._alarmed: set[str] = set()
        """Signals with an alarm in this contact."""
        self.on_force: Callable[[str, float], None] = lambda _name, _force_n: None
        """Callback for each value of a signal that measures the force."""

    def update(self, monitor: str, signal: Signal) -> None:
        """Store a value that a monitor sent."""
        self._last[monitor, signal.name] = signal
        self._silent_s[monitor, signal.name] = 0.0
        for limits in self.limits:
            measured = limits.measures_force and (limits.monitor, limits.signal) == (monitor, signal.name)
            if measured and signal.value is not None:
                self.on_force(limits.name, float(signal.value))

    def pass_by(self, seconds: float, *, in_contact: bool) -> list[tuple[SignalLimits, str]]:
        """Count elapsed time; return each signal newly outside its limits in contact for too long, with a message."""
        for key in self._silent_s:
            self._silent_s[key] += seconds
        if not in_contact:
            self._bad_s, self._alarmed = {}, set()
            return []
        found = []
        for limits in self.limits:
            wrong = self._wrong(limits, in_contact=True)
            bad_s = self._bad_s.get(limits.name, 0.0) + seconds if wrong else 0.0
            self._bad_s[limits.name] = bad_s
            if wrong and bad_s > limits.alarm_delay_s and limits.name not in self._alarmed:
                self._alarmed.add(limits.name)
                found.append((limits, f"{wrong} in contact; it was wrong for more than {limits.alarm_delay_s:g} s"))
        return found

    def not_ready(self) -> dict[SignalLimits, str]:
        """Return the signals outside their limits before contact, each with a message."""
        return {limits: wrong for limits in self.limits if (wrong := self._wrong(limits, in_contact=False))}

    def unknown_on_start(self) -> bool:
        """Return whether a signal with a limit at the start of motion (``on_start``) is unknown."""
        return any(self.value(limits) is None for limits in self.limits if limits.on_start is not None)

    def wrong_on_start(self) -> list[str]:
        """Return a message for each signal outside its limit when an operator starts motion (``on_start``)."""
        found = [
            (limits.name, limits.on_start.broken(self.value(limits), limits.unit))
            for limits in self.limits
            if limits.on_start is not None
        ]
        return [f"{name} {broken}" for name, broken in found if broken]

    def facts(self) -> dict[str, dict[str, Any]]:
        """Return each signal for ``status``; ``wrong`` names the limit that it violates before contact or in it."""
        return {
            limits.name: {
                "value": self.value(limits),
                "text": limits.said(self.value(limits)),
                "wrong": self._wrong(limits, in_contact=False) or self._wrong(limits, in_contact=True),
                "action": limits.action,
            }
            for limits in self.limits
        }

    def value(self, limits: SignalLimits) -> float | bool | None:
        """Return the latest value; None if it is unknown or too old."""
        key = limits.monitor, limits.signal
        if key not in self._last or self._silent_s[key] > self._silence_s.get(limits.monitor, 0.0):
            return None
        return self._last[key].value

    def _wrong(self, limits: SignalLimits, *, in_contact: bool) -> str:
        bounds = limits.in_contact if in_contact else limits.before
        broken = "" if bounds is None else bounds.broken(self.value(limits), limits.unit)
        return f"{limits.name} {broken}" if broken else ""


log = logging.getLogger(__name__)

OPEN_S = 15.0
"""Longest time to open and identify one device."""
LISTEN_S = 10.0
"""Polling interval of idle devices."""
CLOSE_S = 3.0
"""Longest time to close one device; the daemon ends after it in any case."""
BUSY_AGAIN_S = 0.5
"""Interval of the attempts to open a busy device."""

OnWaiting = Callable[[str], Awaitable[None]]
"""Callback, called once with the reason and the limit of a wait."""


class MonotonicClock:
    """The daemon's clock: wall time."""

    def now_s(self) -> float:
        """Seconds on the event loop's monotonic clock."""
        return asyncio.get_running_loop().time()

    async def sleep(self, seconds: float) -> None:
        """Wait that long."""
        await asyncio.sleep(seconds)


@dataclass(slots=True)
class Cell:
    """Devices of one cell. All are opened, monitored, made safe and closed; a job uses those of its roles."""

    devices: Mapping[str, Device]
    """By name (``robot``, or ``robot.left`` of several), in the order in which they are opened."""
    used: Mapping[str, str]
    """The name of the device that the job uses, by port."""
    clock: Clock
    identities: Mapping[str, DeviceIdentity] = field(default_factory=dict)
    """Identities of the devices since the cell was opened."""
    opened: set[str] = field(default_factory=set)
    """Devices that this process has open: only these are made safe."""
    unsafe: tuple[str, ...] = ()
    """Devices that did not confirm the latest ``make_safe``: ``name: why``."""
    answered_s: dict[str, float] = field(default_factory=dict)
    """When each device last answered, by ``time.monotonic``."""
    signals: Signals = field(default_factory=Signals)
    """Signals of its monitors."""
    live: LiveValues = field(default_factory=LiveValues)
    """Latest readings of the job's devices."""
    approval: Approval = field(default_factory=Approval)
    """Plan that waits for approval."""
    map_refusal: MapRefusal | None = None
    """The latest map that the instrument refused, while the cell waits for another."""
    tared: set[str] = field(default_factory=set)
    """Force sensors whose zero is known, because the load on them has not changed since."""
    pressing: bool = False
    """The tool is on the part, on its way to it, or not yet known to be off again."""
    leaving: str = ""
    """The error that ended contact most recently; empty since the tool went down."""
    on_broken: Callable[[BaseException], None] = field(default=lambda _: None, repr=False)
    """Callback for that error, before any device has confirmed anything."""
    emergency: bool = False
    """Motion has to stop at once, even if that damages the part: an operator or a signal requires it."""
    claims: KeptClaims = field(default_factory=KeptClaims, repr=False)
    """Claims on the devices' addresses, kept while links are lost and opened again."""

    @property
    def robot(self) -> Robot:
        """Robot of the job."""
        return cast(Robot, self.devices[self.used["robot"]])

    @property
    def actuator(self) -> ForceActuator:
        """Force actuator of the job."""
        return cast(ForceActuator, self.devices[self.used["actuator"]])

    @property
    def spindle(self) -> Spindle:
        """Spindle of the job."""
        return cast(Spindle, self.devices[self.used["spindle"]])

    @property
    def force_sensor(self) -> ForceSensor | None:
        """Force sensor of the job, if it has one."""
        return cast(ForceSensor, self.devices[self.used["force_sensor"]]) if "force_sensor" in self.used else None

    @property
    def metrology(self) -> Metrology:
        """Instrument of the job."""
        return cast(Metrology, self.devices[self.used["metrology"]])

    def at(self, port: str) -> list[str]:
        """Return the names of all devices at a port."""
        return [name for name in self.devices if port_of(name) == port]

    def uses(self, name: str) -> bool:
        """Return whether the job uses that device."""
        return name in self.used.values() or not PORTS[port_of(name)].chosen

    @property
    def acting(self) -> list[str]:
        """Names of the devices that press, move or turn."""
        return [name for name in self.devices if PORTS[port_of(name)].acts]

    @property
    def limits(self) -> TimeLimits:
        """Time limits in contact, derived from what the job's devices state."""
        sensor = self.force_sensor
        return TimeLimits(
            self.actuator.times, self.robot.times, self.spindle.times, None if sensor is None else sensor.times
        )

    @property
    def end_s(self) -> float:
        """Longest time from the command to stop until all devices are safe and closed."""
        return 2 * (self.limits.safe_s + LET_GO_S) + CLOSE_S * len(self.devices)

    def mark_answered(self, name: str) -> None:
        """Note that the device has answered."""
        self.answered_s[name] = time.monotonic()

    def ended(self, task: asyncio.Task[None]) -> None:
        """Handle the end of a task that works or monitors while the tool presses (a done callback)."""
        if not task.cancelled() and (error := task.exception()) is not None:
            self.breaks(error)

    def breaks(self, error: BaseException) -> None:
        """Note the error that ends contact; later errors follow from it."""
        error = named(error) if isinstance(error, Exception) else error
        if self.pressing and not self.leaving:
            self.leaving = f"{type(error).__name__}: {error}"
            self.on_broken(error)

    def robot_reported(self, progress: RobotProgress) -> None:
        """Store a progress report of the job's robot."""
        self.mark_answered(self.used["robot"])
        self.live.update_robot(progress)

    async def open(self, on_waiting: OnWaiting | None = None) -> None:
        """Open and identify all devices; on the first failure close the opened ones and raise.

        With ``on_waiting`` a device that still serves a client that is gone is tried again until its watchdog has run
        out.
        """
        try:
            found = {name: await self.open_one(name, on_waiting) for name in self.devices}
        except BaseException as error:
            try:
                await self.close()
            except Exception as late:  # noqa: BLE001 - a plugin may raise anything: the first error is raised
                error.add_note(f"and then: {late}")
            raise
        self.identities = found

    async def open_one(self, name: str, on_waiting: OnWaiting | None = None) -> DeviceIdentity:
        """Open and identify that device; as ``open``, but a failure closes nothing."""
        device = self.devices[name]
        with self.claims.keeping():
            await self._opened(name, device, on_waiting)
        self.opened.add(name)
        async with _answering(name):
            found = await device.identify()
        self.mark_answered(name)
        return found

    async def _opened(self, name: str, device: Device, on_waiting: OnWaiting | None) -> None:
        begun_s, within_s = self.clock.now_s(), released_within_s(getattr(device, "times", None))
        has_reported = False
        while True:
            try:
                async with _answering(name):
                    await device.open()
                return
            except DeviceClaimed:
                raise
            except DeviceBusy as busy:
                if on_waiting is None:
                    raise
                if self.clock.now_s() - begun_s > within_s:
                    why = f"it stayed busy for {within_s:g} s, longer than its watchdog"
                    raise DeviceBusy(f"{busy}; {why}. Stop the program that uses it") from busy
                if not has_reported:
                    await on_waiting(
                        f"{name} still serves its last client; the daemon retries for up to {within_s:g} s"
                    )
                has_reported = True
            await self.clock.sleep(BUSY_AGAIN_S)

    async def exchange(self, name: str, device: Device) -> None:
        """Replace that device by another one; if the cell is open, close the old one and open the new one."""
        before, self.devices = self.devices[name], {**self.devices, name: device}
        if self.identities:
            with self.claims.keeping():
                async with _answering(name):
                    await before.close()
                    await device.open()

    async def restore_links(self) -> None:
        """Open lost links again and make their devices safe. Only out of contact: nothing is retried in contact."""
        for name in self.devices:
            await self.restored(name)

    async def restored(self, name: str) -> DeviceStatus:
        """Return the status of that device; open a lost link again first and make the device safe then."""
        device = self.devices[name]
        try:
            return await self.read_status(name)
        except LinkError:
            with self.claims.keeping():
                async with _answering(name):
                    await device.close()
                    await device.open()
            async with _answering(name, safe_within_s(getattr(device, "times", None))):
                await device.make_safe()
            self.tared.discard(name)
            return await self.read_status(name)

    async def cleared(self, name: str) -> DeviceStatus:
        """Make that device safe, which clears the state after a watchdog, and return its status."""
        device = self.devices[name]
        with suppress(DeviceFault):  # the status of a device that cannot shows why
            async with _answering(name, safe_within_s(getattr(device, "times", None))):
                await device.make_safe()
        return await self.read_status(name)

    async def read_status(self, name: str) -> DeviceStatus:
        """Return the present status of that device; LinkError if it does not answer in time."""
        async with _answering(name):
            found = await self.devices[name].status()
        self.mark_answered(name)
        return found

    async def listen(self) -> NoReturn:
        """Poll each idle device for ever; log a device that does not answer."""
        self.tared.clear()  # an operator may change the tool meanwhile
        while True:
            await self.clock.sleep(LISTEN_S)
            for name in self.devices:
                try:
                    await self.read_status(name)
                except Exception as error:  # noqa: BLE001 - a plugin may raise anything: nothing depends on it here
                    log.info("%s does not answer while idle: %s", name, error)

    async def close(self) -> None:
        """Close all devices, each within ``CLOSE_S``; then raise the first error."""
        errors: list[Exception] = []
        for name, device in self.devices.items():
            try:
                await with_deadline(CLOSE_S, device.close())
            except TimeoutError:
                errors.append(LinkError(f"{name}: was not closed within {CLOSE_S:g} s and is abandoned"))
            except Exception as error:  # noqa: BLE001 - the others must be closed too; raised below
                errors.append(error)
        self.opened.clear()
        self.claims.release()
        if errors:
            raise errors[0]


@asynccontextmanager
async def _answering(name: str, within_s: float | None = None) -> AsyncIterator[None]:
    limit_s = OPEN_S if within_s is None else within_s
    try:
        with record_sent(name):
            async with asyncio.timeout(limit_s):
                yield
    except TimeoutError:
        raise LinkError(f"{name}: no answer within {limit_s:g} s. Check its power and its link") from None
