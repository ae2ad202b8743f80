"""Ways out of contact that few cells ever see: what is asked of whom, and which error is told."""

from __future__ import annotations

import asyncio

import pytest

from polishd.daemon import time_limits
from polishd.daemon.safety import make_safe, to_its_end
from polishd.model.errors import LinkError
from polishd.model.times import RobotTimes
from tests.unit.daemon.test_safety import Twins


@pytest.mark.parametrize("silent", [False, True])
async def test_an_idle_robot_that_does_not_say_whether_it_moves_is_stopped_at_once(
    silent: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Waiting for every tool to let go is for one that is known to run."""
    twins = Twins()
    twins.right.actuator.acts.fails["make_safe"] = LinkError("gone")
    robot = twins.right.robot
    if silent:
        monkeypatch.setattr(time_limits, "ANSWERS_S", 0.02)
        robot.times = RobotTimes(silence_s=0.02)
        robot.acts.hangs.add("progress")
    else:
        robot.acts.fails["progress"] = LinkError("cut")
    await make_safe(twins.cell)
    assert "robot.right.make_safe" in twins.safe(), "without any time of the cell's clock"
    assert "robot.right does not say whether it moves" in caplog.text


async def test_what_is_cancelled_from_within_is_told_at_once() -> None:
    """It is no order of ours that came meanwhile."""

    async def ends_itself() -> None:
        raise asyncio.CancelledError("from within")

    with pytest.raises(asyncio.CancelledError):
        await to_its_end(ends_itself())


async def test_an_error_of_what_must_not_be_cut_short_counts_more_than_an_order_that_came_meanwhile() -> None:
    go_on = asyncio.Event()

    async def fails() -> None:
        await go_on.wait()
        raise LinkError("gone")

    task = asyncio.ensure_future(to_its_end(fails()))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.sleep(0)
    assert not task.done()
    go_on.set()
    with pytest.raises(LinkError, match="gone"):
        await task
