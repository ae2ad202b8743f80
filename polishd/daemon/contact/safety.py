"""Contact, and every way out of it.

The tool is lifted before motion stops: a tool that stands while it presses digs a pit, with the paper's process 160
nm/s at 12 N and still 33 nm/s at 0.1 N. So force off and retract come first, the spindle stops at the same time, and
motion goes on along the program until the lift is confirmed. If the actuator does not confirm the lift, the robot lifts
the tool; if the robot cannot, motion goes on until the actuator's watchdog has lifted it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import AsyncIterator, Coroutine, Iterable, Iterator, Mapping
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import read_samples, root_cause, with_deadline
from polishd.daemon.cell.time_limits import ANSWERS_S, safe_within_s
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.force_check import ForceCheck, verdict
from polishd.daemon.runtime.memory import RESERVE
from polishd.interfaces import ForceActuator, Robot
from polishd.model.devices import SPEED_BAND, ForceSample, SensedForce, SpeedSample
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, SafetyStop, WrongSeat
from polishd.util.wire_recording import record_sent

# The independent force sensor: tared before contact, watched in contact, read once more if both forces disagreed.

T = TypeVar("T")

log = logging.getLogger(__name__)


async def tare(cell: Cell, max_difference_n: float) -> None:
    """Tare the sensor with the tool up; DeviceFault if its zero has moved by more than ``max_difference_n``."""
    sensor, name = cell.force_sensor, cell.used.get("force_sensor", "")
    if sensor is None:
        return
    try:
        async with asyncio.timeout(sensor.times.tare_s + ANSWERS_S):
            reading = await _next(sensor.samples())
            _require_sound(reading)
            if name in cell.tared and not abs(reading.force_n) <= max_difference_n:
                raise DeviceFault(
                    f"{name}: reads {reading.force_n:.2f} N with the tool up, and was 0 there before the last contact; "
                    f"at most {max_difference_n:g} N (force_sensor.max_difference_n). "
                    f"Check the sensor, its cable and the load on it"
                )
            await sensor.tare()
    except TimeoutError:
        raise LinkError(f"{name}: was not tared within {sensor.times.tare_s + ANSWERS_S:g} s") from None
    cell.mark_answered(name)
    cell.tared.add(name)


async def watch_sensor(cell: Cell, forces: ForceCheck, touch: ContactRecord, landed: asyncio.Event) -> None:
    """Check each reading of the force sensor until a check raises; silence is a fault."""
    sensor = cell.force_sensor
    if sensor is None:
        return

    def judge(reading: SensedForce) -> None:
        cell.mark_answered(cell.used["force_sensor"])
        cell.live.sensed = reading
        touch.sensed(reading)
        _require_sound(reading)
        if not touch.left:
            forces.sensor(reading.at_s, reading.force_n, landed=landed.is_set())

    await read_samples(sensor.samples(), judge, "force sensor", sensor.times.silence_s)


async def watch_force_signals(cell: Cell, forces: ForceCheck, touch: ContactRecord) -> None:
    """Check each value of the monitors' force signals until a check raises."""
    broken: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def judge(name: str, force_n: float) -> None:
        if touch.left or broken.done():
            return
        try:
            forces.monitor(name, cell.clock.now_s(), force_n)
        except SafetyStop as stop:
            broken.set_exception(stop)

    cell.signals.on_force = judge
    try:
        await broken
    finally:
        cell.signals.on_force = lambda _name, _force_n: None


async def diagnose_force_disagreement(cell: Cell, error: BaseException, max_difference_n: float) -> BaseException:
    """Return the error; if two forces disagreed and the tool is up now, with the readings of both."""
    sensor = cell.force_sensor
    if not isinstance(error, ForcesApart) or sensor is None or cell.unsafe:
        return error
    try:
        async with asyncio.timeout(sensor.times.delay_s + ANSWERS_S):
            await asyncio.sleep(sensor.times.delay_s)  # its readings may still be from before the lift
            force, sensed = await _next(cell.actuator.samples()), await _next(sensor.samples())
    except Exception as late:  # noqa: BLE001 - a plugin may raise anything: the error that ended contact comes first
        log.warning("actuator and force sensor could not be read again: %s", late)
        return error
    return ForcesApart(f"{error}; {verdict(force.force_n, sensed.force_n, max_difference_n)}")


def _require_sound(reading: SensedForce) -> None:
    if reading.fault:
        raise DeviceFault(f"force sensor: fault bits {reading.fault:#06x}. Check the sensor and its cable")


async def _next(samples: AsyncIterator[T]) -> T:
    async with aclosing(samples) as readings:  # type: ignore[type-var]
        async for reading in readings:
            return reading
    raise LinkError("its samples ended")


STILL_RPM = 5.0
"""Largest speed reading of a spindle at rest."""
LOOK_S = 0.05
"""Polling interval of the steps of other devices."""


@dataclass(frozen=True, slots=True)
class ContactLimits:
    """Limits in contact."""

    force_n: float
    rpm: float
    force_band: float
    """Relative band; a safety stop if the force is outside it for longer than ``alarm_delay_s``."""
    alarm_delay_s: float
    deepest_mm: float = math.inf
    """Largest extension of the tool, in contact or not."""
    apart_n: float = math.inf
    """Largest difference of actuator and force sensor; a safety stop if it is larger for ``apart_s``."""
    apart_s: float = 0.5
    force_max_n: float = math.inf
    """A single reading of any device above it is a safety stop, also while the tool lands."""
    force_max_key: str = "process.force_max_n"
    """Dotted config key of that limit."""
    least_override: float = 0.0
    """Lowest speed override of the robot, if it can be read."""
    no_progress_s: float | None = None
    """Time beyond a block's expected time until a standstill is assumed; None: by the age of the reports."""
    excess_nm: float | None = None
    """Largest excess removal at any point; None: from tolerance and plan."""


@dataclass(slots=True)
class _ContactMonitor:
    """State of one contact, shared by its monitoring tasks."""

    limits: ContactLimits
    touch: ContactRecord
    forces: ForceCheck
    landed: asyncio.Event = field(default_factory=asyncio.Event)
    silent: bool = False
    """The actuator has stopped answering."""


@asynccontextmanager
async def contact(cell: Cell, limits: ContactLimits, touch: ContactRecord) -> AsyncIterator[ForceCheck]:
    """Press and spin the tool inside this block and monitor it; every exit from the block leaves contact first.

    Enter it with the robot standing at a landing point off the part, tool retracted. Spindle and actuator are monitored
    from the moment that they are switched on: landing takes seconds, and their watchdogs stop them without heartbeats.
    ``touch`` records all samples, and the times of the retract command and of the lift. Yields the force check.
    """
    sensor = cell.force_sensor
    watch = _ContactMonitor(limits, touch, _force_check(limits, 0.0 if sensor is None else sensor.times.delay_s))
    RESERVE.take()
    cell.pressing, cell.leaving = True, ""
    try:
        await tare(cell, limits.apart_n)
        await cell.spindle.set_speed(limits.rpm)
        async with asyncio.TaskGroup() as group:
            watchers = [
                group.create_task(_watch_speed(cell, watch), name="watch spindle"),
                group.create_task(_watch_force(cell, watch), name="watch force"),
                group.create_task(watch_sensor(cell, watch.forces, touch, watch.landed), name="watch force sensor"),
                group.create_task(watch_force_signals(cell, watch.forces, touch), name="watch force signals"),
            ]
            for watcher in watchers:
                watcher.add_done_callback(cell.ended)
            await _land(cell, watch)
            yield watch.forces
            touch.leave()
            # Monitor until the tool is off, or a fault while leaving contact would be missed.
            await leave_contact(cell)
            touch.off(cell.clock.now_s())
            for watcher in watchers:
                watcher.cancel()
        await cell.spindle.set_speed(0.0)
    except BaseExceptionGroup as errors:
        error = root_cause(errors)
        cell.breaks(error)
        with reraise_after_safe(errors):
            await make_safe(cell, touch, silent=watch.silent)
            error = await diagnose_force_disagreement(cell, error, limits.apart_n)
        raise error from errors
    except BaseException as error:
        if not isinstance(error, asyncio.CancelledError):  # a command, or another task that has ended
            cell.breaks(error)
        with reraise_after_safe(error):
            await make_safe(cell, touch, silent=watch.silent)
        raise
    finally:
        cell.pressing = False


@contextlib.contextmanager
def reraise_after_safe(error: BaseException) -> Iterator[None]:
    """Suppress a cancellation while contact is left, unless ``error`` is a cancellation as well."""
    try:
        yield
    except asyncio.CancelledError:
        if isinstance(error, asyncio.CancelledError):
            raise


async def leave_contact(cell: Cell) -> None:
    """Switch the force off and lift the tool. The robot is not stopped: it stands off the part or goes on."""
    await cell.actuator.set_force(0.0)
    await cell.actuator.retract()


async def make_safe(cell: Cell, touch: ContactRecord | None = None, *, silent: bool = False) -> None:
    """Lift the tool and stop the spindle at the same time, then stop the robot once the lift is confirmed.

    Applies to all devices that this process has opened and to no others, which another program may use in contact.
    ``touch`` is the record of a contact that is left: if the job's actuator does not lift, its robot lifts the tool.
    With ``silent`` the actuator is known not to answer, so the robot lifts at once. With ``cell.emergency`` motion
    stops at once, even if that damages the part.

    Runs to its end even if the caller is cancelled meanwhile; failures are logged and kept in ``cell.unsafe``.
    """
    await run_to_completion(_ContactExit(cell, touch, silent=silent).run())


async def run_to_completion(work: Coroutine[Any, Any, None]) -> None:
    """Run work that no command or second signal may cancel; a cancellation is raised after its end."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError as error:
            cancelled = error  # finish first: a second signal must not leave the tool on the part
    task.result()
    if cancelled is not None:
        raise cancelled


class _ContactExit:
    """One exit to the safe state: commands to the devices, and the devices that did not confirm."""

    def __init__(self, cell: Cell, touch: ContactRecord | None, *, silent: bool) -> None:
        self._cell = cell
        self._touch = touch
        self._silent = silent
        self._failures: dict[str, str] = {}
        self._lifted_mm = 0.0
        """Lift by the job's robot."""

    async def run(self) -> None:
        """Run independent steps at the same time."""
        cell, tool = self._cell, self._cell.used["actuator"]
        if self._touch is not None:
            self._touch.leave()
        actuators, robots = ([name for name in cell.at(port) if name in cell.opened] for port in ("actuator", "robot"))
        async with asyncio.TaskGroup() as group:
            for name in cell.acting:
                if name in cell.opened and name not in {*actuators, *robots}:
                    group.create_task(self._step(name))
            lifts = {name: group.create_task(self._step(name)) for name in actuators}
            for name in robots:
                group.create_task(self._stop_motion(name, lifts))
        if tool in self._failures and self._lifted_mm:
            self._failures[tool] += f"; the robot has lifted the tool off the part by {self._lifted_mm:g} mm"
        cell.unsafe = tuple(f"{name}: {self._failures[name]}" for name in cell.devices if name in self._failures)

    async def _stop_motion(self, robot: str, lifts: Mapping[str, asyncio.Task[bool]]) -> None:
        """Stop that robot after the lift. It is unknown which tool an idle robot holds, so it waits for all."""
        used = self._cell.used
        pressing = self._touch if robot == used["robot"] else None
        its_own = lifts if pressing is None else {used["actuator"]: lifts[used["actuator"]]}
        async with asyncio.TaskGroup() as group:
            lifted = group.create_task(self._until_lifted(robot, its_own, pressing))
            while not self._cell.emergency and not lifted.done():  # an emergency may be declared meanwhile
                await asyncio.wait({lifted}, timeout=LOOK_S)
            lifted.cancel()
        await self._step(robot)

    async def _until_lifted(
        self, robot: str, lifts: Mapping[str, asyncio.Task[bool]], pressing: ContactRecord | None
    ) -> None:
        """Wait until the tool is off the part, by its actuator, by the robot or by the actuator's watchdog.

        An idle robot may hold a tool whose actuator was not opened: that tool counts as not lifted.
        """
        cell, begun_s = self._cell, self._cell.clock.now_s()
        tools = list(lifts) if pressing is not None else cell.at("actuator")
        if lifts and (pressing is None or not self._silent):
            await asyncio.wait(lifts.values())  # a cancellation of this wait cancels none of them
        if _all_lifted(tools, lifts):
            return
        if pressing is not None and await self._lifted_by_robot(pressing):
            return
        if pressing is not None or await self._moves(robot):
            released_s = begun_s + max(cast(ForceActuator, cell.devices[name]).times.alone_s for name in tools)
            while cell.clock.now_s() < released_s and not _all_lifted(tools, lifts):
                await cell.clock.sleep(LOOK_S)

    async def _lifted_by_robot(self, touch: ContactRecord) -> bool:
        """Return whether the robot has lifted the tool off the part."""
        limits = self._cell.limits
        touch.lifts(self._cell.clock.now_s())
        try:
            await with_deadline(safe_within_s(limits.robot), self._cell.robot.lift(limits.lift_mm))
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: motion goes on then
            log.warning(
                "the robot does not lift the tool (%s): motion goes on until the actuator's watchdog lifts it",
                error,
            )
            return False
        self._lifted_mm = limits.lift_mm
        touch.off(self._cell.clock.now_s())
        return True

    async def _moves(self, name: str) -> bool:
        robot = cast(Robot, self._cell.devices[name])
        try:
            return (await with_deadline(robot.times.silence_s, robot.progress())).state == "running"
        except Exception as error:  # noqa: BLE001 - as above: it is stopped next
            log.warning("%s does not report whether it moves, and counts as moving: %s", name, error)
            return True

    async def _step(self, name: str) -> bool:
        """Make the device safe; return whether it confirmed."""
        device, begun_s = self._cell.devices[name], self._cell.clock.now_s()
        within_s = safe_within_s(getattr(device, "times", None))
        try:
            with record_sent(name):
                await with_deadline(within_s, device.make_safe())
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: the other devices still have to be made safe
            self._failures[name] = str(error) or f"no answer within {within_s:g} s"
            log.error("make_safe: %s did not confirm (%s); its own watchdog takes over", name, self._failures[name])
            unconfirmed = name == self._cell.used["actuator"] and isinstance(error, LinkError | TimeoutError)
            if unconfirmed and self._cell.limits.actuator.unpowered == "lifts":
                self._off(begun_s + self._cell.limits.actuator.alone_s)  # its watchdog lifts it in any case
            return False
        self._cell.mark_answered(name)
        if name == self._cell.used["actuator"]:
            self._off(self._cell.clock.now_s())
        return True

    def _off(self, at_s: float) -> None:
        if self._touch is not None:
            self._touch.off(at_s)


def _all_lifted(tools: Iterable[str], lifts: Mapping[str, asyncio.Task[bool]]) -> bool:
    """Return whether each of these actuators was commanded to lift and has confirmed."""
    return all(name in lifts and lifts[name].done() and lifts[name].result() for name in tools)


async def _land(cell: Cell, watch: _ContactMonitor) -> None:
    limits, landing_s = watch.limits, cell.limits.actuator.landing_s
    try:
        async with asyncio.timeout(landing_s + limits.alarm_delay_s):
            await cell.actuator.set_force(limits.force_n)
            await watch.landed.wait()
    except TimeoutError:
        raise SafetyStop(
            f"the tool did not land: no force within {limits.force_band:.0%} of {limits.force_n:g} N after "
            f"{landing_s:g} s (actuator.landing_s){_latest_readings(cell)}. Check the landing point's height and the "
            "actuator's stroke"
        ) from None


def _latest_readings(cell: Cell) -> str:
    force, sensed = cell.live.force, cell.live.sensed
    readings = (
        []
        if force is None
        else [f"the actuator reads {force.force_n:.2f} N, {'on' if force.in_contact else 'off'} the part"]
    )
    readings += [] if sensed is None or cell.force_sensor is None else [f"the force sensor {sensed.force_n:.2f} N"]
    return "".join(f"; {one}" for one in readings)


def _force_check(limits: ContactLimits, delay_s: float = 0.0) -> ForceCheck:
    return ForceCheck(
        limits.force_n,
        limits.apart_n,
        limits.apart_s,
        set_band=limits.force_band,
        set_alarm_delay_s=limits.alarm_delay_s,
        most_n=limits.force_max_n,
        most_key=limits.force_max_key,
        delay_s=delay_s,
    )


async def _watch_force(cell: Cell, watch: _ContactMonitor) -> None:
    limits, good_at = watch.limits, 0.0
    stroke_mm = cell.limits.actuator.stroke_mm

    def judge(sample: ForceSample) -> None:
        nonlocal good_at
        cell.mark_answered(cell.used["actuator"])
        cell.live.force = sample
        watch.touch.force(sample)
        if sample.fault:
            raise DeviceFault(f"actuator: fault bits {sample.fault:#06x} while in contact")
        if sample.position_mm is not None and sample.position_mm > limits.deepest_mm:
            raise WrongSeat(f"the tool is extended by {sample.position_mm:.2f} mm, at most {limits.deepest_mm:.2f} mm")
        if sample.in_contact and sample.position_mm is not None and sample.position_mm > stroke_mm:
            raise SafetyStop(
                f"the actuator reports contact at {sample.position_mm:.2f} mm extension, and its stroke is "
                f"{stroke_mm:g} mm (actuator.stroke_mm): it may press against its end stop, where "
                "the robot cannot lift it off the part. Check the part and the stroke"
            )
        if watch.touch.left:  # only after the daemon's command: an actuator that lifts uncommanded is a fault
            return
        watch.forces.actuator(sample.at_s, sample.force_n)
        if in_band(sample, limits):
            good_at = sample.at_s
            if cell.force_sensor is None or watch.forces.sensor_fits:
                watch.landed.set()
        elif watch.landed.is_set() and sample.at_s - good_at > limits.alarm_delay_s:
            raise SafetyStop(
                f"force {sample.force_n:.2f} N is outside {limits.force_n:g} N +- {limits.force_band:.0%} "
                f"for more than {limits.alarm_delay_s:g} s"
            )

    try:
        await read_samples(cell.actuator.samples(), judge, "actuator", cell.limits.reading_s)
    except LinkError:
        watch.silent = True
        raise


def in_band(sample: ForceSample, limits: ContactLimits) -> bool:
    """Return whether the tool is in contact with the force in its band."""
    return sample.in_contact and abs(sample.force_n - limits.force_n) <= limits.force_band * limits.force_n


async def _watch_speed(cell: Cell, watch: _ContactMonitor) -> None:
    limits = watch.limits
    good_at: float | None = None

    def judge(sample: SpeedSample) -> None:
        nonlocal good_at
        cell.mark_answered(cell.used["spindle"])
        cell.live.speed = sample
        watch.touch.speed(sample)
        if sample.fault:
            raise DeviceFault(f"spindle: fault {sample.fault} while in contact")
        if good_at is None or abs(sample.rpm - limits.rpm) <= max(SPEED_BAND * abs(limits.rpm), STILL_RPM):
            good_at = sample.at_s
        elif sample.at_s - good_at > limits.alarm_delay_s:
            raise SafetyStop(
                f"spindle at {sample.rpm:.0f} rpm instead of {limits.rpm:g} for more than {limits.alarm_delay_s:g} s"
            )

    await read_samples(cell.spindle.samples(), judge, "spindle", cell.limits.spindle.silence_s)
