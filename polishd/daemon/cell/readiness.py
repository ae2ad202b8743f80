"""Monitors of a cell, each read by a separate task at all times, and the readiness of all devices before contact."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from typing import cast

from polishd.config.toml_loader import join_words
from polishd.daemon.cell.cell import OPEN_S, Cell
from polishd.daemon.cell.device_polling import running_beside
from polishd.daemon.contact.progress import low_override
from polishd.interfaces import Monitor
from polishd.model.devices import DeviceStatus, SignalLimits, port_of
from polishd.model.errors import DeviceFault, LinkError, SignalFault
from polishd.model.events import Event, SignalOutOfRange

log = logging.getLogger(__name__)

LOOK_S = 0.1
"""Interval of the checks."""
STEP_S = 0.2
"""Longest interval that counts between two checks: a daemon that was stalled reads the signals first."""
UNKNOWN_S = 5.0
"""Shortest wait before contact: a monitor whose link was just opened again has sent nothing yet."""
AGAIN_S = 1.0
"""Interval of the attempts to read a monitor that does not answer."""


@asynccontextmanager
async def monitoring_signals(cell: Cell, on_alarm: Callable[[SignalLimits, str], None]) -> AsyncIterator[None]:
    """Read all monitors inside this block; ``on_alarm`` gets each signal outside its limits, once per contact."""
    reads = {f"read {name}": _read(cell, name) for name in cell.at("monitor")}
    async with running_beside({**reads, "check signals": _check(cell, on_alarm)}):
        yield


async def until_ready(cell: Cell, publish: Callable[[Event], None], cycle: int) -> None:
    """Wait until all signals are within their limits before contact; SignalFault after their longest wait."""
    begun_s, published = cell.clock.now_s(), set[str]()
    while wrong := cell.signals.not_ready():
        waited_s = cell.clock.now_s() - begun_s
        if late := [problem for limits, problem in wrong.items() if waited_s >= _wait_s(cell, limits)]:
            raise SignalFault(f"before contact {'; '.join(late)}. Correct it; nothing was moved")
        for limits, problem in wrong.items():
            if limits.name not in published:
                published.add(limits.name)
                what = f"{problem} before contact; the daemon waits for up to {limits.wait_s:g} s"
                publish(SignalOutOfRange(cycle=cycle, signal=limits.name, what=what, action="wait"))
        await cell.clock.sleep(LOOK_S)


def _wait_s(cell: Cell, limits: SignalLimits) -> float:
    """Return the longest wait for a signal before contact; an unknown signal gets the time that its monitor needs."""
    if cell.signals.value(limits) is not None:
        return limits.wait_s
    return max(limits.wait_s, UNKNOWN_S, AGAIN_S + cast(Monitor, cell.devices[limits.monitor]).times.silence_s)


async def report_once(cell: Cell, name: str) -> None:
    """Read each signal of that monitor once; DeviceFault if a watched signal is missing."""
    monitor = cast(Monitor, cell.devices[name])
    wanted = {limits.signal for limits in cell.signals.limits if limits.monitor == name}
    received, within_s = set[str](), max(OPEN_S, monitor.times.silence_s)
    try:
        async with asyncio.timeout(within_s), aclosing(monitor.signals()) as signals:  # type: ignore[type-var]
            async for signal in signals:
                if signal.name in received:
                    break
                received.add(signal.name)
                cell.signals.update(name, signal)
    except TimeoutError:
        raise LinkError(f"{name}: did not report all its signals within {within_s:g} s") from None
    if missing := wanted - received:
        raise DeviceFault(f"{name}: has no signal {join_words(missing)}; it has {join_words(received)}")


async def _read(cell: Cell, name: str) -> None:
    """Read the signals of that monitor for ever; other code opens a lost link again, out of contact."""
    lost = False
    while True:
        try:
            async for signal in cast(Monitor, cell.devices[name]).signals():
                lost = False
                cell.mark_answered(name)
                cell.signals.update(name, signal)
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: its signals are unknown then
            if not lost:
                log.warning("%s sends no signals: %s", name, error)
            lost = True
        await asyncio.sleep(AGAIN_S)


async def _check(cell: Cell, on_alarm: Callable[[SignalLimits, str], None]) -> None:
    looked_s = time.monotonic()
    while True:
        await asyncio.sleep(LOOK_S)
        now_s = time.monotonic()
        passed_s, looked_s = min(now_s - looked_s, STEP_S), now_s
        for limits, problem in cell.signals.pass_by(passed_s, in_contact=cell.pressing):
            cell.emergency = cell.emergency or limits.action == "estop"
            on_alarm(limits, problem)


# Conditions for contact: links open, devices ready, signals within their limits.


async def before_contact(cell: Cell, publish: Callable[[Event], None], cycle: int) -> None:
    """Open lost links again and require that all devices of the job are ready, except the robot, which comes later.

    DeviceFault with the status of each device that is not ready; LinkError; SignalFault.
    """
    found = {name: await cell.restored(name) for name in cell.devices}
    for name, status in found.items():
        if not status.ready and cell.uses(name) and port_of(name) != "robot":
            found[name] = await cell.cleared(name)
    _require({name: status for name, status in found.items() if cell.uses(name) and port_of(name) != "robot"})
    await until_ready(cell, publish, cycle)


async def require_robot(cell: Cell, least_override: float) -> None:
    """Require that the job's robot is ready, after it received its program, which may clear an alarm.

    DeviceFault if it is not ready or reports a speed override below ``least_override``.
    """
    name = cell.used["robot"]
    _require({name: await cell.read_status(name)})
    if problem := low_override(await cell.robot.progress(), least_override):
        raise DeviceFault(f"{problem}; no pass was begun")


def _require(found: dict[str, DeviceStatus]) -> None:
    problems = [
        f"{name} is not ready: {': '.join(filter(None, (status.state, status.detail)))}"
        for name, status in found.items()
        if not status.ready
    ]
    if problems:
        raise DeviceFault(f"{'; '.join(problems)}. Correct it; no pass was begun")
