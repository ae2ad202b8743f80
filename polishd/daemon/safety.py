"""Contact, and every way out of it.

The order is always the same: force off, tool lifted, and only then motion stops. A tool that stands still
while it presses digs a pit: at the paper's process 160 nm a second.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TypeVar

from polishd.daemon.cell import Cell
from polishd.model.devices import ForceSample, SpeedSample
from polishd.model.errors import DeviceFault, LinkError, PolishdError, SafetyStop

log = logging.getLogger(__name__)

T = TypeVar("T")

LEAVE_S = 3.0
"""Longest that one device may take to become safe, wall time."""
SAMPLE_S = 0.8
"""Longest silence of a watched device in contact, wall time."""


@dataclass(frozen=True, slots=True)
class ContactLimits:
    """What is watched while the tool presses on the part."""

    force_n: float
    rpm: float
    force_band: float
    """Relative; outside it for longer than ``grace_s`` is a safety stop."""
    grace_s: float
    landing_s: float = 5.0
    """Longest that landing may take until the force is in its band."""


@asynccontextmanager
async def contact(cell: Cell, limits: ContactLimits) -> AsyncIterator[None]:
    """The tool presses and spins inside this block, watched; whatever ends the block, contact ends first.

    Enter it with the robot standing at a landing point off the part, tool retracted.
    """
    landed, leaving = asyncio.Event(), asyncio.Event()
    try:
        await cell.spindle.set_speed(limits.rpm)
        await cell.actuator.set_force(limits.force_n)
        async with asyncio.TaskGroup() as group:
            watchers = [
                group.create_task(_watch_force(cell.actuator.samples(), limits, landed, leaving), name="watch force"),
                group.create_task(_watch_speed(cell.spindle.samples(), limits), name="watch spindle"),
            ]
            await _landed(landed, limits)
            yield
            leaving.set()
            # Still watched: the tool is off before the watchers, or a fault while leaving would go unseen.
            await leave_contact(cell)
            for watcher in watchers:
                watcher.cancel()
    except BaseExceptionGroup as errors:
        await make_safe(cell)
        raise most_telling(errors) from errors
    except BaseException:
        await make_safe(cell)
        raise


async def leave_contact(cell: Cell) -> None:
    """Force off, tool lifted. Motion is not touched: the caller knows that the robot stands off the part or goes on."""
    await cell.actuator.set_force(0.0)
    await cell.actuator.retract()


async def make_safe(cell: Cell) -> None:
    """Force off and lifted, then motion, then spindle. All are attempted, in this order, whatever fails.

    Runs to its end even if the caller is cancelled meanwhile; failures are logged and kept in ``cell.unsafe``.
    """
    task = asyncio.ensure_future(_make_safe(cell))
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError as error:
            if task.cancelled():
                raise
            cancelled = error  # finish first: a second signal must not leave the tool on the part
    task.result()
    if cancelled is not None:
        raise cancelled


async def _make_safe(cell: Cell) -> None:
    steps: tuple[tuple[str, Callable[[], Awaitable[None]]], ...] = (
        ("actuator", cell.actuator.make_safe),
        ("robot", cell.robot.make_safe),
        ("spindle", cell.spindle.make_safe),
    )
    failures = []
    for name, step in steps:
        try:
            async with asyncio.timeout(LEAVE_S):
                await step()
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything: ask the next device
            failures.append(f"{name}: {str(error) or type(error).__name__}")
            log.error("make_safe: %s did not confirm (%s); its own watchdog takes over", name, error)
    cell.unsafe = tuple(failures)


async def _landed(landed: asyncio.Event, limits: ContactLimits) -> None:
    try:
        async with asyncio.timeout(limits.landing_s):
            await landed.wait()
    except TimeoutError:
        raise SafetyStop(
            f"the tool did not land: no force within {limits.force_band:.0%} of {limits.force_n:g} N "
            f"after {limits.landing_s:g} s; check the landing point's height and the actuator's stroke"
        ) from None


async def _watch_force(
    samples: AsyncIterator[ForceSample], limits: ContactLimits, landed: asyncio.Event, leaving: asyncio.Event
) -> None:
    good_at = 0.0
    async for sample in within(samples, "actuator"):
        if sample.fault:
            raise DeviceFault(f"actuator: fault bits {sample.fault:#06x} while in contact")
        if leaving.is_set():  # by our word only: an actuator that lifts by itself has lost its force
            continue
        in_band = sample.in_contact and abs(sample.force_n - limits.force_n) <= limits.force_band * limits.force_n
        if in_band:
            good_at = sample.at_s
            landed.set()
        elif landed.is_set() and sample.at_s - good_at > limits.grace_s:
            raise SafetyStop(
                f"force {sample.force_n:.2f} N is outside {limits.force_n:g} N +- {limits.force_band:.0%} "
                f"for more than {limits.grace_s:g} s"
            )


async def _watch_speed(samples: AsyncIterator[SpeedSample], limits: ContactLimits) -> None:
    good_at: float | None = None
    async for sample in within(samples, "spindle"):
        if sample.fault:
            raise DeviceFault(f"spindle: fault {sample.fault} while in contact")
        good_at = sample.at_s if good_at is None else good_at
        if abs(sample.rpm - limits.rpm) <= 0.05 * abs(limits.rpm):
            good_at = sample.at_s
        elif sample.at_s - good_at > limits.grace_s:
            raise SafetyStop(
                f"spindle at {sample.rpm:.0f} rpm instead of {limits.rpm:g} for more than {limits.grace_s:g} s"
            )


async def within(samples: AsyncIterator[T], name: str) -> AsyncIterator[T]:
    """The samples as they come; LinkError after ``SAMPLE_S`` seconds of silence."""
    while True:
        try:
            async with asyncio.timeout(SAMPLE_S):
                sample = await anext(samples)
        except StopAsyncIteration:
            raise LinkError(f"{name}: its samples ended while in contact") from None
        except TimeoutError:
            raise LinkError(f"{name}: no sample for {SAMPLE_S:g} s while in contact") from None
        yield sample


def most_telling(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """The one error of a group that says what to do: ours before others, others before cancellation."""
    flat = list(_flatten(errors))
    for kind in (SafetyStop, PolishdError, Exception):
        for error in flat:
            if isinstance(error, kind):
                return error
    return flat[0]


def _flatten(errors: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    found: list[BaseException] = []
    for error in errors.exceptions:
        found.extend(_flatten(error) if isinstance(error, BaseExceptionGroup) else [error])
    return found
