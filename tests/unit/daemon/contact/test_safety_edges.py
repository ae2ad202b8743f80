"""Rare exits from contact: the commands to each device, and the error that is raised."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from polishd.daemon.cell import time_limits
from polishd.daemon.contact.safety import contact, reraise_after_safe, run_to_completion
from polishd.model.devices import ActuatorTimes, RobotTimes
from polishd.model.errors import DeviceFault, LinkError
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_safety import LIMITS, Twins, forever, polish_for, until, unused_record


@pytest.mark.parametrize("silent", [False, True])
async def test_an_idle_robot_that_does_not_say_whether_it_moves_counts_as_moving(
    silent: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It is stopped once every tool has let go: one that stands loses nothing by that."""
    twins = Twins()
    twins.right.actuator.acts.fails["make_safe"] = LinkError("gone")
    robot = twins.right.robot
    if silent:
        monkeypatch.setattr(time_limits, "ANSWERS_S", 0.02)
        robot.times = RobotTimes(silence_s=0.02)
        robot.acts.hangs.add("progress")
    else:
        robot.acts.fails["progress"] = LinkError("cut")
    assert await twins.right_robot_stops_s() >= ActuatorTimes().alone_s - 0.1
    assert "robot.right does not report whether it moves" in caplog.text


async def test_what_is_cancelled_from_within_is_reported_at_once() -> None:
    """It is no order of ours that came meanwhile."""

    async def ends_itself() -> None:
        raise asyncio.CancelledError("from within")

    with pytest.raises(asyncio.CancelledError):
        await run_to_completion(ends_itself())


async def test_an_error_of_what_must_not_be_cut_short_counts_more_than_an_order_that_came_meanwhile() -> None:
    go_on = asyncio.Event()

    async def fails() -> None:
        await go_on.wait()
        raise LinkError("gone")

    task = asyncio.ensure_future(run_to_completion(fails()))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.sleep(0)
    assert not task.done()
    go_on.set()
    with pytest.raises(LinkError, match="gone"):
        await task


async def test_an_error_that_comes_in_the_same_moment_as_an_order_counts_more() -> None:
    go_on = asyncio.Event()

    async def fails() -> None:
        await go_on.wait()
        raise LinkError("gone")

    task = asyncio.ensure_future(run_to_completion(fails()))
    for _ in range(3):
        await asyncio.sleep(0)
    go_on.set()
    task.cancel()
    with pytest.raises(LinkError, match="gone"):
        await task


@pytest.mark.parametrize("at", ["spindle.set_speed 1000", "spindle.set_speed 0"])
async def test_an_order_does_not_take_the_place_of_a_spindle_that_refuses(at: str) -> None:
    """Before anything is watched, and after nothing is any more."""
    fake = FakeCell()

    def refuses() -> None:
        if fake.events[-1] == at:
            fake.spindle.acts.fails["set_speed"] = DeviceFault("spindle: jammed")

    fake.spindle.acts.before["set_speed"] = refuses
    task = asyncio.ensure_future(polish_for(fake, 0.1))
    fake.robot.acts.before["make_safe"] = task.cancel
    with pytest.raises(DeviceFault, match="spindle: jammed"):
        await task


async def test_an_actuator_that_fell_silent_is_not_waited_for_before_the_robot_lifts() -> None:
    fake, answers = FakeCell(), asyncio.Event()
    fake.actuator.times = ActuatorTimes(silence_s=0.02)

    async def safe() -> None:
        try:
            await answers.wait()
        finally:
            fake.events.append("answered, or given up")

    fake.actuator.make_safe = safe  # type: ignore[method-assign]
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.actuator.silent = True
    await until(fake, "robot.make_safe")
    assert fake.events[3:] == ["spindle.make_safe", "robot.lift 15", "robot.make_safe"]
    answers.set()
    with pytest.raises(LinkError, match="actuator: no sample"):
        await task


async def test_a_lift_of_the_normal_end_may_fail_and_the_tool_is_lifted_all_the_same() -> None:
    fake, touch = FakeCell(), unused_record()
    fake.actuator.acts.fails["retract"] = LinkError("cut")
    with pytest.raises(LinkError, match="cut"):
        async with contact(fake.cell, LIMITS, touch):
            pass
    assert fake.events[-4:] == ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]
    assert touch.off_s <= fake.clock.at_s


async def test_landing_has_its_own_time_and_then_the_grace() -> None:
    """A tool that lands just in time may still swing in."""
    fake = FakeCell()
    fake.actuator.times = ActuatorTimes(landing_s=0.001)
    await polish_for(fake, 0.1, replace(LIMITS, alarm_delay_s=60.0))
    assert "robot.make_safe" not in fake.events


async def test_why_contact_is_left_is_reported_before_a_device_has_confirmed() -> None:
    """Seconds may pass until the devices confirm; status has to show the error before."""
    fake, errors = FakeCell(), list[tuple[str, list[str]]]()
    fake.cell.on_broken = lambda error: errors.append((str(error), [*fake.events]))
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    assert fake.cell.leaving == ""
    fake.spindle.ends = True
    with pytest.raises(LinkError, match="samples ended"):
        await task
    ((why, before),) = errors
    assert fake.cell.leaving == f"LinkError: {why}"
    assert "spindle: its samples ended" in why
    assert not [one for one in before if "make_safe" in one]
    fake.spindle.ends = False
    await polish_for(fake)
    assert fake.cell.leaving == "", "of the contact before"


@pytest.mark.parametrize("before", ["landing", "leaving"])
async def test_every_error_over_which_contact_ends_is_reported(before: str) -> None:
    fake, errors = FakeCell(), list[str]()
    fake.cell.on_broken = lambda error: errors.append(str(error))
    if before == "landing":
        fake.spindle.acts.fails["set_speed"] = DeviceFault("spindle: broken")
        with pytest.raises(DeviceFault):
            await polish_for(fake)
        assert errors == ["spindle: broken"]
        return
    with pytest.raises(LinkError):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise LinkError("the robot is gone")
    assert errors == ["the robot is gone"]


async def test_it_is_reported_while_the_pass_has_not_ended_yet() -> None:
    fake, order = FakeCell(), list[str]()
    fake.cell.on_broken = lambda error: order.append("reported")

    async def slow() -> None:
        async with contact(fake.cell, LIMITS, unused_record()):
            fake.events.append("pressing")
            try:
                await asyncio.Event().wait()
            finally:
                await asyncio.sleep(0.01)
                order.append("ended")

    task = asyncio.ensure_future(slow())
    await until(fake, "pressing")
    fake.spindle.ends = True
    with pytest.raises(LinkError, match="samples ended"):
        await task
    assert order == ["reported", "ended"]


async def test_memory_for_the_way_out_is_kept_before_anything_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, taken = FakeCell(), list[list[str]]()

    class Reserve:
        def take(self) -> None:
            taken.append([*fake.events])

    monkeypatch.setattr("polishd.daemon.contact.safety.RESERVE", Reserve())
    await polish_for(fake, 0.1)
    assert taken == [[]]


def test_no_speed_override_is_too_low_where_the_cell_sets_no_limit() -> None:
    assert LIMITS.least_override == 0.0


@pytest.mark.parametrize(("error", "raised"), [(asyncio.CancelledError(), True), (LinkError("gone"), False)])
def test_a_cancellation_takes_the_place_of_a_cancellation_only(error: BaseException, raised: bool) -> None:
    def left() -> None:
        with reraise_after_safe(error):
            raise asyncio.CancelledError

    if raised:
        with pytest.raises(asyncio.CancelledError):
            left()
    else:
        left()


async def test_an_order_is_no_error_over_which_contact_is_left() -> None:
    fake, errors = FakeCell(), list[BaseException]()
    fake.cell.on_broken = errors.append
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert (errors, fake.cell.leaving) == ([], "")


async def test_what_ends_while_nothing_presses_breaks_no_contact() -> None:
    fake, errors = FakeCell(), list[BaseException]()
    fake.cell.on_broken = errors.append

    async def fails() -> None:
        raise LinkError("before it went down")

    task = asyncio.ensure_future(fails())
    task.add_done_callback(fake.cell.ended)
    with pytest.raises(LinkError):
        await task
    assert (errors, fake.cell.leaving) == ([], "")
