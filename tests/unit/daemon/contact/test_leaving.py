"""What is known of the tool while contact is left: from when on it is off, who said so, and who lifted it."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from polishd.daemon.cell import time_limits
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.safety import ContactLimits, contact, make_safe
from polishd.model.devices import ActuatorTimes, RobotTimes
from polishd.model.errors import DeviceFault, LinkError
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_safety import LIMITS, Twins

ALONE_S = ActuatorTimes().alone_s


class Cause(Exception):
    """What ends contact."""


async def cut_off(fake: FakeCell, touch: ContactRecord, limits: ContactLimits = LIMITS) -> float:
    """In contact, and then not; when it was left, by the fake clock, which goes on."""
    left_s: list[float] = []

    async def press() -> None:
        async with contact(fake.cell, limits, touch):
            assert fake.cell.pressing
            left_s.append(fake.clock.at_s)
            raise Cause

    task = asyncio.ensure_future(press())
    while not task.done():
        if left_s and not fake.of("lifted"):
            fake.clock.advance(0.01)
        await asyncio.sleep(0)
    with pytest.raises(Cause):
        await task
    assert not fake.cell.pressing
    return left_s[0]


def unused_record() -> ContactRecord:
    return ContactRecord(lambda records: None, 1.5)


async def test_at_the_normal_end_the_tool_is_off_once_the_lift_is_confirmed() -> None:
    fake, touch = FakeCell(), unused_record()
    async with contact(fake.cell, LIMITS, touch):
        assert fake.cell.pressing
        assert not touch.left
        begun_s = fake.clock.at_s
        assert fake.spindle.rpm == LIMITS.rpm
    assert touch.left
    assert begun_s + fake.actuator.lifting_s <= touch.off_s <= fake.clock.at_s
    assert not fake.cell.pressing
    assert fake.spindle.rpm == 0.0
    assert fake.actuator.retracted


async def test_an_actuator_that_confirms_says_when_the_tool_was_off() -> None:
    fake, touch = FakeCell(), unused_record()
    left_s = await cut_off(fake, touch)
    assert touch.left
    assert left_s + fake.actuator.lifting_s <= touch.off_s <= fake.clock.at_s
    assert not touch.taken_off
    assert set(fake.cell.answered_s) == {"actuator", "robot", "spindle"}


@pytest.mark.parametrize("error", [LinkError("gone"), TimeoutError()])
async def test_one_that_cannot_be_asked_has_let_go_by_itself_after_its_own_time(error: Exception) -> None:
    """The robot cannot lift either: the actuator's watchdog lifts, whatever command arrived last."""
    fake, touch = FakeCell(), unused_record()
    fake.robot.lifts = False
    fake.actuator.acts.fails["make_safe"] = error
    left_s = await cut_off(fake, touch)
    assert touch.off_s == pytest.approx(left_s + ALONE_S, abs=0.1)
    assert fake.events[-1] == "robot.make_safe"
    assert fake.cell.unsafe == (f"actuator: {str(error) or 'no answer within 8.2 s'}",)


async def test_contact_is_unknown_for_an_actuator_that_answers_and_does_not_lift() -> None:
    """The actuator receives requests, so that its watchdog does not act."""
    fake, touch = FakeCell(), unused_record()
    fake.robot.lifts = False
    fake.actuator.acts.fails["make_safe"] = DeviceFault("jammed")
    await cut_off(fake, touch)
    assert touch.off_s == math.inf
    assert fake.cell.unsafe == ("actuator: jammed",)


async def test_a_robot_that_lifts_says_when_the_tool_was_off() -> None:
    fake, touch = FakeCell(), unused_record()
    fake.actuator.acts.fails["make_safe"] = DeviceFault("jammed")
    left_s = await cut_off(fake, touch)
    assert touch.taken_off or touch.off_s == touch._lifts_s
    assert left_s <= touch.off_s <= fake.clock.at_s
    assert fake.of("robot.lift") == ["robot.lift 15"]


async def test_a_robot_that_does_not_answer_when_it_should_lift_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time_limits, "ANSWERS_S", 0.02)
    fake, touch = FakeCell(), unused_record()
    fake.robot.times = RobotTimes(stop_s=0.0)
    fake.robot.acts.hangs.add("lift")
    fake.actuator.acts.fails["make_safe"] = DeviceFault("jammed")
    left_s = await cut_off(fake, touch)
    assert fake.clock.at_s - left_s >= ALONE_S - 0.1, "motion goes on until the actuator must have let go"
    assert fake.events[-1] == "robot.make_safe"
    assert "actuator: jammed" in fake.cell.unsafe


async def test_no_other_device_says_anything_of_the_tool() -> None:
    twins, touch = Twins(), unused_record()
    twins.right.actuator.acts.fails["make_safe"] = LinkError("gone")
    gate = asyncio.Event()

    async def never() -> None:
        await gate.wait()
        raise DeviceFault("jammed")

    twins.left.actuator.make_safe = never  # type: ignore[method-assign]
    twins.left.robot.lifts = False
    leaving = asyncio.ensure_future(make_safe(twins.cell, touch))
    for _ in range(50):
        await asyncio.sleep(0)
    assert touch.left
    assert "spindle.left" in twins.cell.answered_s
    assert touch.off_s == math.inf
    gate.set()
    while not leaving.done():
        twins.left.clock.advance(0.05)
        await asyncio.sleep(0)
    assert touch.off_s == math.inf
    assert "actuator.left" not in twins.cell.answered_s
    assert twins.cell.unsafe == ("actuator.left: jammed", "actuator.right: gone")


async def test_a_robot_waits_for_an_actuator_that_is_not_known_to_be_silent() -> None:
    """It is commanded to lift and may be slow: no other device lifts meanwhile."""
    fake, touch = FakeCell(), unused_record()
    fake.actuator.retracted = False
    await make_safe(fake.cell, touch)
    assert fake.events == ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]


async def test_one_that_is_known_to_be_silent_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, touch, answers = FakeCell(), unused_record(), asyncio.Event()
    monkeypatch.setattr(fake.actuator, "make_safe", answers.wait)
    leaving = asyncio.ensure_future(make_safe(fake.cell, touch, silent=True))
    while "robot.make_safe" not in fake.events:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert fake.events == ["spindle.make_safe", "robot.lift 15", "robot.make_safe"]
    assert not leaving.done(), "it has its time"
    answers.set()
    await leaving
    assert fake.cell.unsafe == ()


async def test_a_robot_that_holds_no_tool_of_the_job_waits_for_the_slowest_of_all() -> None:
    twins = Twins()
    for fake, watchdog_s in ((twins.left, 1.0), (twins.right, 9.0)):
        fake.actuator.times = ActuatorTimes(watchdog_s=watchdog_s)
        fake.actuator.acts.fails["make_safe"] = LinkError("gone")
    twins.right.robot.until = None  # it runs
    stopped: dict[str, float] = {}
    for side, fake in (("left", twins.left), ("right", twins.right)):
        fake.robot.acts.before["make_safe"] = lambda side=side: stopped.update({side: twins.left.clock.at_s})
    task = asyncio.ensure_future(make_safe(twins.cell))
    while not task.done():
        twins.left.clock.advance(0.05)
        for _ in range(5):
            await asyncio.sleep(0)
    await task
    assert stopped["left"] < 1.0, "it stands"
    assert stopped["right"] >= ActuatorTimes(watchdog_s=9.0).alone_s - 0.1


@pytest.mark.parametrize("given", [None, "touch"])
async def test_without_a_contact_nothing_is_said_of_one(given: str | None) -> None:
    fake: Any = FakeCell()
    touch = unused_record() if given else None
    await make_safe(fake.cell, touch)
    assert fake.cell.unsafe == ()
    assert touch is None or (touch.left and touch.off_s < math.inf)


async def test_a_robot_that_holds_another_tool_waits_for_it_though_the_jobs_actuator_is_silent() -> None:
    twins, answers = Twins(), asyncio.Event()
    for fake in (twins.left, twins.right):
        fake.actuator.make_safe = answers.wait  # type: ignore[method-assign, assignment]
    leaving = asyncio.ensure_future(make_safe(twins.cell, unused_record(), silent=True))
    while "robot.left.make_safe" not in twins.left.events:  # noqa: ASYNC110
        await asyncio.sleep(0)
    for _ in range(20):
        await asyncio.sleep(0)
    assert "robot.right.make_safe" not in twins.left.events
    answers.set()
    await leaving
    assert twins.safe()[-1] == "robot.right.make_safe"


async def test_a_lift_that_is_confirmed_after_all_ends_the_waiting_for_it() -> None:
    fake, touch, answers = FakeCell(), unused_record(), asyncio.Event()
    fake.robot.lifts = False
    fake.actuator.make_safe = answers.wait  # type: ignore[method-assign, assignment]
    leaving = asyncio.ensure_future(make_safe(fake.cell, touch, silent=True))
    while fake.clock.at_s < 1.0:
        fake.clock.advance(0.05)
        for _ in range(5):
            await asyncio.sleep(0)
    assert fake.events == ["spindle.make_safe", "robot.lift 15"]
    answers.set()
    while not leaving.done() and fake.clock.at_s < ALONE_S:
        fake.clock.advance(0.05)
        for _ in range(5):
            await asyncio.sleep(0)
    await leaving
    assert fake.clock.at_s < 1.3
    assert touch.off_s < 1.3
