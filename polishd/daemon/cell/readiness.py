"""The monitors of a cell are heard all the time, each by a task of its own; nobody waits for one in contact."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from typing import cast

from polishd.config.toml_loader import join_words
from polishd.daemon.cell.cell import OPEN_S, Cell
from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.contact.progress import low_override
from polishd.interfaces import Monitor
from polishd.model.devices import DeviceStatus, SignalLimits, port_of
from polishd.model.errors import DeviceFault, LinkError, SignalFault
from polishd.model.events import Event, SignalOutOfRange

log = logging.getLogger(__name__)

LOOK_S = 0.1
"""Between two looks."""
STEP_S = 0.2
"""Most that passes between two looks, as it is counted: a daemon that was stalled hears first."""
UNKNOWN_S = 5.0
"""Before contact, at least: a monitor whose link was just opened again has told nothing yet."""
AGAIN_S = 1.0
"""After so long a monitor that does not answer is heard again, if its link is open again."""


@asynccontextmanager
async def monitoring_signals(cell: Cell, tell: Callable[[SignalLimits, str], None]) -> AsyncIterator[None]:
    """Hear all monitors inside this block; ``tell`` is told of each signal that is wrong in contact, once a contact."""
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(_hear(cell, name), name=f"hear {name}") for name in cell.at("monitor")]
            tasks.append(group.create_task(_look(cell, tell), name="look at signals"))
            try:
                yield
            finally:
                for task in tasks:
                    task.cancel()
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors


async def until_ready(cell: Cell, publish: Callable[[Event], None], cycle: int) -> None:
    """All signals are as they must be before contact; SignalFault where that was waited for in vain."""
    begun_s, told = cell.clock.now_s(), set[str]()
    while wrong := cell.signals.not_ready():
        waited_s = cell.clock.now_s() - begun_s
        if late := [said for limits, said in wrong.items() if waited_s >= _wait_s(cell, limits)]:
            raise SignalFault(f"before contact {'; '.join(late)}; see to it: nothing was moved")
        for limits, said in wrong.items():
            if limits.name not in told:
                told.add(limits.name)
                what = f"{said} before contact; it is waited for, for up to {limits.wait_s:g} s"
                publish(SignalOutOfRange(cycle=cycle, signal=limits.name, what=what, action="wait"))
        await cell.clock.sleep(LOOK_S)


def _wait_s(cell: Cell, limits: SignalLimits) -> float:
    """For how long a signal is waited for before contact; one that is not known for as long as its monitor may take."""
    if cell.signals.value(limits) is not None:
        return limits.wait_s
    return max(limits.wait_s, UNKNOWN_S, AGAIN_S + cast(Monitor, cell.devices[limits.monitor]).times.silence_s)


async def report_once(cell: Cell, name: str) -> None:
    """Have that monitor tell each of its signals; DeviceFault where it has not all that are watched."""
    monitor = cast(Monitor, cell.devices[name])
    wanted = {limits.signal for limits in cell.signals.limits if limits.monitor == name}
    told, within_s = set[str](), max(OPEN_S, monitor.times.silence_s)
    try:
        async with asyncio.timeout(within_s), aclosing(monitor.signals()) as signals:  # type: ignore[type-var]
            async for signal in signals:
                if signal.name in told:
                    break
                told.add(signal.name)
                cell.signals.hear(name, signal)
    except TimeoutError:
        raise LinkError(f"{name}: told not all of its signals within {within_s:g} s") from None
    if missing := wanted - told:
        raise DeviceFault(f"{name}: tells no signal {join_words(missing)}; it tells {join_words(told)}")


async def _hear(cell: Cell, name: str) -> None:
    """For as long as it tells; a link that is lost is opened again by others, out of contact."""
    lost = False
    while True:
        try:
            async for signal in cast(Monitor, cell.devices[name]).signals():
                lost = False
                cell.hears(name)
                cell.signals.hear(name, signal)
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: its signals are not known then
            if not lost:
                log.warning("%s tells no signals: %s", name, error)
            lost = True
        await asyncio.sleep(AGAIN_S)


async def _look(cell: Cell, tell: Callable[[SignalLimits, str], None]) -> None:
    looked_s = time.monotonic()
    while True:
        await asyncio.sleep(LOOK_S)
        now_s = time.monotonic()
        passed_s, looked_s = min(now_s - looked_s, STEP_S), now_s
        for limits, said in cell.signals.pass_by(passed_s, in_contact=cell.pressing):
            cell.emergency = cell.emergency or limits.action == "estop"
            tell(limits, said)


# Whether a cell may go into contact: its links are up, its devices say that they may be used, its signals are right.


async def before_contact(cell: Cell, publish: Callable[[Event], None], cycle: int) -> None:
    """Out of contact: lost links are opened again, and all that the job uses is ready; the robot is asked later.

    DeviceFault with the own words of each device that is not; LinkError; SignalFault.
    """
    found = {name: await cell.restored(name) for name in cell.devices}
    for name, status in found.items():
        if not status.ready and cell.uses(name) and port_of(name) != "robot":
            found[name] = await cell.cleared(name)
    _require({name: status for name, status in found.items() if cell.uses(name) and port_of(name) != "robot"})
    await until_ready(cell, publish, cycle)


async def require_robot(cell: Cell, least_override: float) -> None:
    """The job's robot is ready, once it has its program: getting that may take back an alarm. DeviceFault if not.

    It is not where its controller reports a speed override below ``least_override``.
    """
    name = cell.used["robot"]
    _require({name: await cell.asked(name)})
    if words := low_override(await cell.robot.progress(), least_override):
        raise DeviceFault(f"{words}; no pass was begun")


def _require(found: dict[str, DeviceStatus]) -> None:
    if said := [f"{name} is not ready: {_words(status)}" for name, status in found.items() if not status.ready]:
        raise DeviceFault(f"{'; '.join(said)}; see to it: no pass was begun")


def _words(status: DeviceStatus) -> str:
    return f"{status.state}: {status.detail}" if status.detail else status.state
