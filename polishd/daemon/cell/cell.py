"""A cell: its devices by name, those of them that a job uses, and the clock. It knows nothing of a job."""

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

# What the devices told last, for whoever watches: kept where it is heard anyway, so that nobody is asked for it.


@dataclass(slots=True)
class LiveValues:
    """Of one cell's job; None: nothing was told yet. Times are of ``time.monotonic``."""

    force: ForceSample | None = None
    speed: SpeedSample | None = None
    sensed: SensedForce | None = None
    robot: RobotProgress | None = None
    robot_s: float = 0.0
    """When the robot told that."""

    def robot_told(self, progress: RobotProgress) -> None:
        """The robot's last word."""
        self.robot, self.robot_s = progress, time.monotonic()

    def facts(self) -> dict[str, dict[str, Any] | None]:
        """Each reading with its age, ``age_s``."""
        samples = {"force": self.force, "speed": self.speed, "sensed": self.sensed}
        told: dict[str, dict[str, Any] | None] = {
            name: None if sample is None else _aged(asdict(sample), sample.at_s) for name, sample in samples.items()
        }
        return {**told, "robot": None if self.robot is None else _aged(asdict(self.robot), self.robot_s)}


def _aged(facts: dict[str, Any], at_s: float) -> dict[str, Any]:
    """With the age in the place of a time that means nothing elsewhere."""
    facts.pop("at_s", None)
    return {**facts, "age_s": round(max(time.monotonic() - at_s, 0.0), 3)}


# A person's word that a plan may run (``job.approve``).


@dataclass(slots=True)
class Approval:
    """What waits for a person's word."""

    wanted: str = ""
    """Hash of the program; empty: nothing waits."""
    _given: asyncio.Event = field(default_factory=asyncio.Event)

    async def until_given(self, program_sha256: str) -> None:
        """Wait for it; whatever ends the wait, the plan waits no more."""
        self._given.clear()
        self.wanted = program_sha256
        try:
            await self._given.wait()
        finally:
            self.wanted = ""

    def give(self, program_sha256: str) -> None:
        """DeviceRefused where none waits, or another one: a word is for what its giver has looked at."""
        if not self.wanted:
            raise DeviceRefused("approve is refused: no plan waits for it")
        if program_sha256 != self.wanted:
            raise DeviceRefused("approve is refused: another plan waits now; look at it, and approve that one")
        self._given.set()


# The signals of a cell: what its monitors tell, held against the limits before contact and in it.


class Signals:
    """Of one cell; a cell may have none."""

    def __init__(self, limits: Sequence[SignalLimits] = (), silence_s: Mapping[str, float] | None = None) -> None:
        """``silence_s``: of each monitor, for how long nothing of a signal may be told."""
        self.limits = limits
        self._silence_s = silence_s or {}
        self._last: dict[tuple[str, str], Signal] = {}
        self._silent_s: dict[tuple[str, str], float] = {}
        self._bad_s: dict[str, float] = {}
        self._told: set[str] = set()
        """In this contact."""
        self.on_force: Callable[[str, float], None] = lambda _name, _force_n: None
        """Is given each value of a signal that measures the force, as it comes."""

    def hear(self, monitor: str, signal: Signal) -> None:
        """A monitor has told one."""
        self._last[monitor, signal.name] = signal
        self._silent_s[monitor, signal.name] = 0.0
        for limits in self.limits:
            measured = limits.measures_force and (limits.monitor, limits.signal) == (monitor, signal.name)
            if measured and signal.value is not None:
                self.on_force(limits.name, float(signal.value))

    def pass_by(self, seconds: float, *, in_contact: bool) -> list[tuple[SignalLimits, str]]:
        """So much time has passed: those that have been wrong in contact for too long, and how they are; each once."""
        for heard in self._silent_s:
            self._silent_s[heard] += seconds
        if not in_contact:
            self._bad_s, self._told = {}, set()
            return []
        found = []
        for limits in self.limits:
            wrong = self._wrong(limits, in_contact=True)
            bad_s = self._bad_s.get(limits.name, 0.0) + seconds if wrong else 0.0
            self._bad_s[limits.name] = bad_s
            if wrong and bad_s > limits.alarm_delay_s and limits.name not in self._told:
                self._told.add(limits.name)
                found.append((limits, f"{wrong} in contact, and was not for more than {limits.alarm_delay_s:g} s"))
        return found

    def not_ready(self) -> dict[SignalLimits, str]:
        """Those that are not as they must be before contact, and how they are."""
        return {limits: wrong for limits in self.limits if (wrong := self._wrong(limits, in_contact=False))}

    def untold_on_order(self) -> bool:
        """Whether one is not known that counts when motion is ordered."""
        return any(self.value(limits) is None for limits in self.limits if limits.on_start is not None)

    def wrong_on_order(self) -> list[str]:
        """How those are that are not as they must be when a person orders motion."""
        found = [
            (limits.name, limits.on_start.broken(self.value(limits), limits.unit))
            for limits in self.limits
            if limits.on_start is not None
        ]
        return [f"{name} {broken}" for name, broken in found if broken]

    def facts(self) -> dict[str, dict[str, Any]]:
        """Each with its value, for ``status``: ``wrong`` says how it is not as it must be, before contact or in it."""
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
        """As it was told last; None: it is not known."""
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
"""Longest that opening and identifying one device may take."""
LISTEN_S = 10.0
"""Between two questions to a device of which nothing is wanted."""
CLOSE_S = 3.0
"""Longest that closing one device may take: whatever it does, the daemon ends."""
BUSY_AGAIN_S = 0.5
"""After so long a busy device is asked again."""

Waiting = Callable[[str], Awaitable[None]]
"""Is told, once, what is waited for and until when."""


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
    """Devices of one cell. All are opened, watched, made safe and closed; a job uses those of its roles."""

    devices: Mapping[str, Device]
    """By name (``robot``, or ``robot.left`` of several), in the order in which they are opened."""
    used: Mapping[str, str]
    """The name of the device that the job uses, by port."""
    clock: Clock
    identities: Mapping[str, DeviceIdentity] = field(default_factory=dict)
    """Who answered, since the cell was opened."""
    opened: set[str] = field(default_factory=set)
    """Devices that this process has opened and not closed since: only these are made safe."""
    unsafe: tuple[str, ...] = ()
    """Devices that did not confirm being safe when last asked: ``name: why``."""
    heard_s: dict[str, float] = field(default_factory=dict)
    """When each device last answered, by ``time.monotonic``."""
    signals: Signals = field(default_factory=Signals)
    """What its monitors tell."""
    live: LiveValues = field(default_factory=LiveValues)
    """What the job's devices told last."""
    approval: Approval = field(default_factory=Approval)
    """What waits for a person's word."""
    map_refusal: MapRefusal | None = None
    """Last map that the instrument refused, while the cell waits for another."""
    tared: set[str] = field(default_factory=set)
    """Force sensors whose zero is known: what hangs on them has not been changed since."""
    pressing: bool = False
    """The tool is on the part, on its way to it, or not yet known to be off again."""
    leaving: str = ""
    """The error over which contact is left, or was last; empty since the tool went down."""
    on_broken: Callable[[BaseException], None] = field(default=lambda _: None, repr=False)
    """Is told of it, before any device has confirmed anything."""
    emergency: bool = False
    """Motion is to stop at once, whatever the part costs: somebody asked for it."""
    claims: KeptClaims = field(default_factory=KeptClaims, repr=False)
    """On the devices' addresses, kept while links are lost and opened again."""

    @property
    def robot(self) -> Robot:
        """The job's."""
        return cast(Robot, self.devices[self.used["robot"]])

    @property
    def actuator(self) -> ForceActuator:
        """The job's."""
        return cast(ForceActuator, self.devices[self.used["actuator"]])

    @property
    def spindle(self) -> Spindle:
        """The job's."""
        return cast(Spindle, self.devices[self.used["spindle"]])

    @property
    def force_sensor(self) -> ForceSensor | None:
        """The job's, where it has one."""
        return cast(ForceSensor, self.devices[self.used["force_sensor"]]) if "force_sensor" in self.used else None

    @property
    def metrology(self) -> Metrology:
        """The job's."""
        return cast(Metrology, self.devices[self.used["metrology"]])

    def at(self, port: str) -> list[str]:
        """Names of all devices at a port."""
        return [name for name in self.devices if port_of(name) == port]

    def uses(self, name: str) -> bool:
        """Whether the job uses that device."""
        return name in self.used.values() or not PORTS[port_of(name)].chosen

    @property
    def acting(self) -> list[str]:
        """Names of the devices that press, move or turn."""
        return [name for name in self.devices if PORTS[port_of(name)].acts]

    @property
    def limits(self) -> TimeLimits:
        """How long things may take in contact, as the job's devices state it."""
        sensor = self.force_sensor
        return TimeLimits(
            self.actuator.times, self.robot.times, self.spindle.times, None if sensor is None else sensor.times
        )

    @property
    def end_s(self) -> float:
        """Longest from the order to end until all is closed, whatever a device does: contact left, safe once more."""
        return 2 * (self.limits.safe_s + LET_GO_S) + CLOSE_S * len(self.devices)

    def hears(self, name: str) -> None:
        """That device has answered."""
        self.heard_s[name] = time.monotonic()

    def ended(self, task: asyncio.Task[None]) -> None:
        """A done callback of what works or watches while the tool presses."""
        if not task.cancelled() and (error := task.exception()) is not None:
            self.breaks(error)

    def breaks(self, error: BaseException) -> None:
        """Contact is to be left over that error; later ones follow from it."""
        error = named(error) if isinstance(error, Exception) else error
        if self.pressing and not self.leaving:
            self.leaving = f"{type(error).__name__}: {error}"
            self.on_broken(error)

    def robot_told(self, progress: RobotProgress) -> None:
        """The job's robot has said how far it is."""
        self.hears(self.used["robot"])
        self.live.robot_told(progress)

    async def open(self, waiting: Waiting | None = None) -> None:
        """Open and identify all devices; on the first failure close what was opened and raise.

        With ``waiting``, one that still serves a client that is gone is asked again, until it must have let go of it.
        """
        try:
            found = {name: await self.open_one(name, waiting) for name in self.devices}
        except BaseException as error:
            try:
                await self.close()
            except Exception as late:  # noqa: BLE001 - a plugin may raise anything: what did not open is told first
                error.add_note(f"and then: {late}")
            raise
        self.identities = found

    async def open_one(self, name: str, waiting: Waiting | None = None) -> DeviceIdentity:
        """Open that device, and have it say who it is; as ``open``, but nothing is closed where it fails."""
        device = self.devices[name]
        with self.claims.keeping():
            await self._opened(name, device, waiting)
        self.opened.add(name)
        async with _answering(name):
            found = await device.identify()
        self.hears(name)
        return found

    async def _opened(self, name: str, device: Device, waiting: Waiting | None) -> None:
        begun_s, within_s = self.clock.now_s(), released_within_s(getattr(device, "times", None))
        told = False
        while True:
            try:
                async with _answering(name):
                    await device.open()
                return
            except DeviceClaimed:
                raise
            except DeviceBusy as busy:
                if waiting is None:
                    raise
                if self.clock.now_s() - begun_s > within_s:
                    why = f"it stayed so for {within_s:g} s, longer than its own watchdog allows one that is gone"
                    raise DeviceBusy(f"{busy}; {why}: stop the program that has it") from busy
                if not told:
                    await waiting(f"{name} still serves its last client; it is asked again for up to {within_s:g} s")
                told = True
            await self.clock.sleep(BUSY_AGAIN_S)

    async def exchange(self, name: str, device: Device) -> None:
        """Put another device in the place of that one, which is closed; open where the cell is."""
        before, self.devices = self.devices[name], {**self.devices, name: device}
        if self.identities:
            with self.claims.keeping():
                async with _answering(name):
                    await before.close()
                    await device.open()

    async def restore_links(self) -> None:
        """Open again what was lost meanwhile, and leave it safe. Only out of contact: nothing is retried in it."""
        for name in self.devices:
            await self.restored(name)

    async def restored(self, name: str) -> DeviceStatus:
        """That device's own word, its link opened again where it was lost, and the device left safe then."""
        device = self.devices[name]
        try:
            return await self.asked(name)
        except LinkError:
            with self.claims.keeping():
                async with _answering(name):
                    await device.close()
                    await device.open()
            async with _answering(name, safe_within_s(getattr(device, "times", None))):
                await device.make_safe()
            self.tared.discard(name)
            return await self.asked(name)

    async def cleared(self, name: str) -> DeviceStatus:
        """The same, once it was made safe: that takes back what its watchdog left."""
        device = self.devices[name]
        with suppress(DeviceFault):  # one that cannot is not ready, in its own words
            async with _answering(name, safe_within_s(getattr(device, "times", None))):
                await device.make_safe()
        return await self.asked(name)

    async def asked(self, name: str) -> DeviceStatus:
        """That device's own word, asked for now; LinkError where it does not answer in time."""
        async with _answering(name):
            found = await self.devices[name].status()
        self.hears(name)
        return found

    async def listen(self) -> NoReturn:
        """Ask each device for its state now and then, for as long as nobody else does; one that is silent is logged."""
        self.tared.clear()  # a person has the word, and may change the tool
        while True:
            await self.clock.sleep(LISTEN_S)
            for name in self.devices:
                try:
                    await self.asked(name)
                except Exception as error:  # noqa: BLE001 - a plugin may raise anything: here nothing hangs on it
                    log.info("%s does not answer while nothing is asked of it: %s", name, error)

    async def close(self) -> None:
        """Close all devices, whatever one of them says or does: each has ``CLOSE_S``."""
        errors: list[Exception] = []
        for name, device in self.devices.items():
            try:
                await with_deadline(CLOSE_S, device.close())
            except TimeoutError:
                errors.append(LinkError(f"{name}: was not closed within {CLOSE_S:g} s, and is left behind"))
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
        raise LinkError(f"{name}: no answer within {limit_s:g} s; is it on, and connected?") from None
