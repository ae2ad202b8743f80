"""Contact, and every way out of it.

The tool is lifted before motion stops: one that stands while it presses digs a pit, at the paper's process 160 nm a
second under 12 N, and still 33 under 0.1 N. So force goes off and the tool up at once, the spindle stops beside that,
and motion goes on along the program until the lift is confirmed. Where the actuator does not confirm it, the robot
takes the tool away, and where it cannot, motion goes on until the actuator has let go by itself.
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
from polishd.daemon.contact.contact_record import ContactRecord, ForceCheck, verdict
from polishd.daemon.runtime.memory import RESERVE
from polishd.interfaces import ForceActuator, Robot
from polishd.model.devices import ForceSample, SensedForce, SpeedSample
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, SafetyStop, WrongSeat
from polishd.util.wire_recording import record_sent

# The independent force sensor in contact: tared before, watched meanwhile, and asked once more where both disagreed.

T = TypeVar("T")

log = logging.getLogger(__name__)


async def tare(cell: Cell, max_difference_n: float) -> None:
    """Nothing touches: the sensor reads 0. DeviceFault where that has moved by more than ``max_difference_n``."""
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
                    f"at most {max_difference_n:g} N (force_sensor.max_difference_n): "
                    f"look at the sensor, its cable and what hangs on it"
                )
            await sensor.tare()
    except TimeoutError:
        raise LinkError(f"{name}: was not tared within {sensor.times.tare_s + ANSWERS_S:g} s") from None
    cell.hears(name)
    cell.tared.add(name)


async def watch_sensor(cell: Cell, forces: ForceCheck, touch: ContactRecord, landed: asyncio.Event) -> None:
    """Judge each of its readings, until that raises; a silence is a fault."""
    sensor = cell.force_sensor
    if sensor is None:
        return

    def judge(reading: SensedForce) -> None:
        cell.hears(cell.used["force_sensor"])
        cell.live.sensed = reading
        touch.sensed(reading)
        _require_sound(reading)
        if not touch.left:
            forces.sensor(reading.at_s, reading.force_n, landed=landed.is_set())

    await read_samples(sensor.samples(), judge, "force sensor", sensor.times.silence_s)


async def watch_force_signals(cell: Cell, forces: ForceCheck, touch: ContactRecord) -> None:
    """Judge each value of the monitors' signals that measure the force, until that raises."""
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
    """The error; where two forces disagreed, and the tool is up since, with what both read there."""
    sensor = cell.force_sensor
    if not isinstance(error, ForcesApart) or sensor is None or cell.unsafe:
        return error
    try:
        async with asyncio.timeout(sensor.times.delay_s + ANSWERS_S):
            await asyncio.sleep(sensor.times.delay_s)  # what it reads now may be from before the lift
            told, sensed = await _next(cell.actuator.samples()), await _next(sensor.samples())
    except Exception as late:  # noqa: BLE001 - a plugin may raise anything: what ended contact is told all the same
        log.warning("actuator and force sensor are not both asked again: %s", late)
        return error
    return ForcesApart(f"{error}; {verdict(told.force_n, sensed.force_n, max_difference_n)}")


def _require_sound(reading: SensedForce) -> None:
    if reading.fault:
        raise DeviceFault(f"force sensor: fault bits {reading.fault:#06x}; look at it and at its cable")


async def _next(samples: AsyncIterator[T]) -> T:
    async with aclosing(samples) as readings:  # type: ignore[type-var]
        async for reading in readings:
            return reading
    raise LinkError("its samples ended")


STILL_RPM = 5.0
"""A spindle told to rest may read so much."""
LOOK_S = 0.05
"""Between two looks at what others do meanwhile."""


@dataclass(frozen=True, slots=True)
class ContactLimits:
    """What is watched while the tool presses on the part."""

    force_n: float
    rpm: float
    force_band: float
    """Relative; outside it for longer than ``alarm_delay_s`` is a safety stop."""
    alarm_delay_s: float
    deepest_mm: float = math.inf
    """The tool is lifted where it is farther out than that, whether it touches or not."""
    apart_n: float = math.inf
    """How far the words of actuator and force sensor may be apart; farther for ``apart_s`` is a safety stop."""
    apart_s: float = 0.5
    force_max_n: float = math.inf
    """One reading above it, of whichever device, is a safety stop, also while the tool lands."""
    force_max_key: str = "process.force_max_n"
    """Dotted config key that changes it."""
    least_override: float = 0.0
    """Of the robot's speed, where it can be read."""
    no_progress_s: float | None = None
    """Beyond a block's expected time, until the robot counts as standing; None: by the age of its reports."""
    excess_nm: float | None = None
    """Most that slow motion may remove beyond the plan at any place; None: by tolerance and plan."""


@dataclass(slots=True)
class _Watch:
    """One contact, as its watchers see it."""

    limits: ContactLimits
    touch: ContactRecord
    forces: ForceCheck
    landed: asyncio.Event = field(default_factory=asyncio.Event)
    silent: bool = False
    """The actuator does not answer any more."""


@asynccontextmanager
async def contact(cell: Cell, limits: ContactLimits, touch: ContactRecord) -> AsyncIterator[ForceCheck]:
    """The tool presses and spins inside this block, watched; whatever ends the block, contact ends first.

    Enter it with the robot standing at a landing point off the part, tool retracted. Both are watched from the moment
    that they are switched on: landing takes seconds, and a spindle or an actuator that nobody feeds stops by itself.
    ``touch`` hears all samples, and when the tool is ordered off and is off. Yields what the words on the force say.
    """
    sensor = cell.force_sensor
    watch = _Watch(limits, touch, _force_check(limits, 0.0 if sensor is None else sensor.times.delay_s))
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
            # Still watched: the tool is off before the watchers, or a fault while leaving would go unseen.
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
        if not isinstance(error, asyncio.CancelledError):  # an order, or what has ended beside
            cell.breaks(error)
        with reraise_after_safe(error):
            await make_safe(cell, touch, silent=watch.silent)
        raise
    finally:
        cell.pressing = False


@contextlib.contextmanager
def reraise_after_safe(error: BaseException) -> Iterator[None]:
    """An order that comes while contact is left takes the place of nothing but another order."""
    try:
        yield
    except asyncio.CancelledError:
        if isinstance(error, asyncio.CancelledError):
            raise


async def leave_contact(cell: Cell) -> None:
    """Force off, tool lifted. Motion is not touched: the caller knows that the robot stands off the part or goes on."""
    await cell.actuator.set_force(0.0)
    await cell.actuator.retract()


async def make_safe(cell: Cell, touch: ContactRecord | None = None, *, silent: bool = False) -> None:
    """Tool lifted and spindle off side by side, and the robot stopped once the lift is confirmed; whatever fails.

    All devices that this process has opened are asked, and no others: another program may be in contact with those.
    With the ``touch`` of a contact that is left: where the job's actuator does not
    lift, its robot takes the tool away; ``silent``: it is known not to answer, so the robot does that at once.
    ``cell.emergency``: motion stops at once, whatever the part costs.

    Runs to its end even if the caller is cancelled meanwhile; failures are logged and kept in ``cell.unsafe``.
    """
    await run_to_completion(_Leaving(cell, touch, silent=silent).run())


async def run_to_completion(work: Coroutine[Any, Any, None]) -> None:
    """What must not be cut short by an order, or by a second signal: that is told when it is over."""
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


class _Leaving:
    """One way to safety: what was asked of the devices, and who did not confirm."""

    def __init__(self, cell: Cell, touch: ContactRecord | None, *, silent: bool) -> None:
        self._cell = cell
        self._touch = touch
        self._silent = silent
        self._failures: dict[str, str] = {}
        self._lifted_mm = 0.0
        """By the job's robot."""

    async def run(self) -> None:
        """Steps that do not depend on each other run side by side."""
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
        """Which tool an idle robot may hold is not known: it waits for all."""
        used = self._cell.used
        pressing = self._touch if robot == used["robot"] else None
        its_own = lifts if pressing is None else {used["actuator"]: lifts[used["actuator"]]}
        async with asyncio.TaskGroup() as group:
            lifted = group.create_task(self._until_lifted(robot, its_own, pressing))
            while not self._cell.emergency and not lifted.done():  # which may be declared meanwhile
                await asyncio.wait({lifted}, timeout=LOOK_S)
            lifted.cancel()
        await self._step(robot)

    async def _until_lifted(
        self, robot: str, lifts: Mapping[str, asyncio.Task[bool]], pressing: ContactRecord | None
    ) -> None:
        """Motion goes on meanwhile, along the program; off the part, where the actuator does not lift.

        An idle robot may hold a tool whose actuator was not opened: that one counts as not lifted.
        """
        cell, begun_s = self._cell, self._cell.clock.now_s()
        tools = list(lifts) if pressing is not None else cell.at("actuator")
        if lifts and (pressing is None or not self._silent):
            await asyncio.wait(lifts.values())  # which cancels none of them, should this be
        if _all_lifted(tools, lifts):
            return
        if pressing is not None and await self._lifted_by_robot(pressing):
            return
        if pressing is not None or await self._moves(robot):
            let_go_s = begun_s + max(cast(ForceActuator, cell.devices[name]).times.alone_s for name in tools)
            while cell.clock.now_s() < let_go_s and not _all_lifted(tools, lifts):
                await cell.clock.sleep(LOOK_S)

    async def _lifted_by_robot(self, touch: ContactRecord) -> bool:
        """Whether the robot took the tool off the part."""
        limits = self._cell.limits
        touch.lifts(self._cell.clock.now_s())
        try:
            await with_deadline(safe_within_s(limits.robot), self._cell.robot.lift(limits.lift_mm))
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: then motion goes on
            log.warning(
                "the robot does not lift the tool off (%s): motion goes on until the actuator has let go", error
            )
            return False
        self._lifted_mm = limits.lift_mm
        touch.off(self._cell.clock.now_s())
        return True

    async def _moves(self, name: str) -> bool:
        robot = cast(Robot, self._cell.devices[name])
        try:
            return (await with_deadline(robot.times.silence_s, robot.progress())).state == "running"
        except Exception as error:  # noqa: BLE001 - as above: it is asked to stop next
            log.warning("%s does not say whether it moves, and counts as moving: %s", name, error)
            return True

    async def _step(self, name: str) -> bool:
        """Whether the device confirmed."""
        device, begun_s = self._cell.devices[name], self._cell.clock.now_s()
        within_s = safe_within_s(getattr(device, "times", None))
        try:
            with record_sent(name):
                await with_deadline(within_s, device.make_safe())
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: the others are asked all the same
            self._failures[name] = str(error) or f"no answer within {within_s:g} s"
            log.error("make_safe: %s did not confirm (%s); its own watchdog takes over", name, self._failures[name])
            unheard = name == self._cell.used["actuator"] and isinstance(error, LinkError | TimeoutError)
            if unheard and self._cell.limits.actuator.unpowered == "lifts":
                self._off(begun_s + self._cell.limits.actuator.alone_s)  # whatever of this reached it says the same
            return False
        self._cell.hears(name)
        if name == self._cell.used["actuator"]:
            self._off(self._cell.clock.now_s())
        return True

    def _off(self, at_s: float) -> None:
        if self._touch is not None:
            self._touch.off(at_s)


def _all_lifted(tools: Iterable[str], lifts: Mapping[str, asyncio.Task[bool]]) -> bool:
    """Whether each of these actuators has been asked and has confirmed."""
    return all(name in lifts and lifts[name].done() and lifts[name].result() for name in tools)


async def _land(cell: Cell, watch: _Watch) -> None:
    limits, landing_s = watch.limits, cell.limits.actuator.landing_s
    try:
        async with asyncio.timeout(landing_s + limits.alarm_delay_s):
            await cell.actuator.set_force(limits.force_n)
            await watch.landed.wait()
    except TimeoutError:
        raise SafetyStop(
            f"the tool did not land: no force within {limits.force_band:.0%} of {limits.force_n:g} N after "
            f"{landing_s:g} s (actuator.landing_s){_last_words(cell)}; check the landing point's height and the "
            "actuator's stroke"
        ) from None


def _last_words(cell: Cell) -> str:
    """What the devices read last."""
    force, sensed = cell.live.force, cell.live.sensed
    said = (
        []
        if force is None
        else [f"the actuator reads {force.force_n:.2f} N, {'on' if force.in_contact else 'off'} the part"]
    )
    said += [] if sensed is None or cell.force_sensor is None else [f"the force sensor {sensed.force_n:.2f} N"]
    return "".join(f"; {one}" for one in said)


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


async def _watch_force(cell: Cell, watch: _Watch) -> None:
    limits, good_at = watch.limits, 0.0
    stroke_mm = cell.limits.actuator.stroke_mm

    def judge(sample: ForceSample) -> None:
        nonlocal good_at
        cell.hears(cell.used["actuator"])
        cell.live.force = sample
        watch.touch.force(sample)
        if sample.fault:
            raise DeviceFault(f"actuator: fault bits {sample.fault:#06x} while in contact")
        if sample.position_mm is not None and sample.position_mm > limits.deepest_mm:
            raise WrongSeat(f"the tool is {sample.position_mm:.2f} mm out of its rest, at most {limits.deepest_mm:.2f}")
        if sample.in_contact and sample.position_mm is not None and sample.position_mm > stroke_mm:
            raise SafetyStop(
                f"the actuator reads contact {sample.position_mm:.2f} mm out of its rest, and its stroke is "
                f"{stroke_mm:g} mm (actuator.stroke_mm): it may press against its own end stop, and a robot that lifts "
                "the tool would not lift it off. Check the part, and the stroke"
            )
        if watch.touch.left:  # by our word only: an actuator that lifts by itself has lost its force
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
    """Whether the tool presses as it should."""
    return sample.in_contact and abs(sample.force_n - limits.force_n) <= limits.force_band * limits.force_n


async def _watch_speed(cell: Cell, watch: _Watch) -> None:
    limits = watch.limits
    good_at: float | None = None

    def judge(sample: SpeedSample) -> None:
        nonlocal good_at
        cell.hears(cell.used["spindle"])
        cell.live.speed = sample
        watch.touch.speed(sample)
        if sample.fault:
            raise DeviceFault(f"spindle: fault {sample.fault} while in contact")
        if good_at is None or abs(sample.rpm - limits.rpm) <= max(0.05 * abs(limits.rpm), STILL_RPM):
            good_at = sample.at_s
        elif sample.at_s - good_at > limits.alarm_delay_s:
            raise SafetyStop(
                f"spindle at {sample.rpm:.0f} rpm instead of {limits.rpm:g} for more than {limits.alarm_delay_s:g} s"
            )

    await read_samples(cell.spindle.samples(), judge, "spindle", cell.limits.spindle.silence_s)
