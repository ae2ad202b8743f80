"""One fixture a port: the device of every rig, closed; and time limits that hold for all of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from tests.conformance import rigs
from tests.conformance.rigs import ActuatorRig, ForceSensorRig, LoaderRig, MonitorRig, RobotRig, SpindleRig

PROMPT_S = 2.5
"""A dead link is known after so long: less than a second, and room for what else a machine does."""
BOUND_S = 8 * rigs.PATIENT.silence_s
"""No call to a dead device takes longer: four answers, each of which may still come as late again."""


async def seen(condition: Callable[[], bool]) -> None:
    """Look at the machine itself until it is so: pytest's timeout is the limit."""
    while not condition():  # noqa: ASYNC110 -- the machine tells nobody
        await asyncio.sleep(0.01)


@pytest.fixture(params=rigs.ROBOTS, ids=lambda rig: rig.__name__)
async def robot(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[RobotRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(params=rigs.ACTUATORS, ids=lambda rig: rig.__name__)
async def actuator(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[ActuatorRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(params=rigs.SPINDLES, ids=lambda rig: rig.__name__)
async def spindle(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[SpindleRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(params=rigs.LOADERS, ids=lambda rig: rig.__name__)
async def loader(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[LoaderRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(params=rigs.FORCE_SENSORS, ids=lambda rig: rig.__name__)
async def force_sensor(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[ForceSensorRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(params=rigs.MONITORS, ids=lambda rig: rig.__name__)
async def monitor(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[MonitorRig]:
    async with request.param(tmp_path) as rig:
        yield rig


@pytest.fixture(
    params=[*rigs.ROBOTS, *rigs.ACTUATORS, *rigs.SPINDLES, *rigs.LOADERS, *rigs.FORCE_SENSORS, *rigs.MONITORS],
    ids=lambda rig: rig.__name__,
)
async def any_device(
    request: pytest.FixtureRequest, tmp_path: Path
) -> AsyncIterator[RobotRig | ActuatorRig | SpindleRig | LoaderRig | ForceSensorRig | MonitorRig]:
    async with request.param(tmp_path) as rig:
        yield rig
