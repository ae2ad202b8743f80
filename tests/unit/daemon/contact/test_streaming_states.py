"""A robot that has to run and reports another state: each state that means standstill ends the pass."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import get_args

import pytest

from polishd.daemon.contact.streaming import STANDS, WATCH_S
from polishd.model.devices import RobotProgress, RobotState
from polishd.model.errors import SafetyStop
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_streaming_stream import small_plan, time_passes, whole_pass

STANDING = [state for state in get_args(RobotState) if state != "running"]


@pytest.mark.parametrize("state", STANDING)
async def test_each_state_but_running_is_a_stand_in_contact(state: RobotState) -> None:
    assert set(STANDING) == {"idle", "held", "done", "fault"}
    fake = FakeCell()
    plain = fake.robot.progress

    async def progress() -> RobotProgress:
        said = await plain()
        return replace(said, state=state) if fake.robot.stands else said

    fake.robot.progress = progress  # type: ignore[method-assign]
    fake.robot.acts.before["resume"] = lambda: setattr(fake.robot, "stands", fake.robot.done >= 3)
    task = asyncio.ensure_future(whole_pass(fake, small_plan()))
    await time_passes(fake, 5.0, task)
    if not task.done():
        task.cancel()
        pytest.fail(f"a robot that is {state} goes on unseen")
    with pytest.raises(SafetyStop, match=rf"stands at block 3 of 18 \({state}: fake\)"):
        await task
    assert fake.clock.at_s < 0.3 + (STANDS + 3) * WATCH_S
