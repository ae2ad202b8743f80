"""Shared fixtures of the robot link's tests."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from tests.fakes.robot import FakeRobot
from tests.programs import plan_of

Pair = tuple[RobotLink, FakeRobot]
PLAN = plan_of([b"G1 X%d F60" % at for at in range(200)])


@pytest.fixture
async def pair() -> AsyncIterator[Pair]:
    """Run an open driver with its fake robot."""
    fake = await FakeRobot().start()
    robot = RobotLink(Tcp("127.0.0.1", fake.port), client="test")
    await robot.open()
    yield robot, fake
    await robot.close()
    await fake.close()
