"""The link that is looked at all the time."""

from __future__ import annotations

import time
from pathlib import Path

from polishd.drivers.plc_robot.driver import PlcPoller
from polishd.drivers.plc_robot.program_tracker import ControllerReport
from tests.fakes.handover import PROFILE, Direct, FakePlc
from tests.patience import SOON_S


async def test_a_clock_that_stands_between_two_looks_is_no_pace_of_nothing(tmp_path: Path) -> None:
    """A busy controller renews it at every third look: what a dwell may last longer is counted in its seconds."""
    fake = FakePlc(tmp_path)
    began_s = time.monotonic()
    looks, paces = 0, []

    async def look(_: ControllerReport) -> None:
        nonlocal looks
        looks += 1
        if looks % 3 == 0:
            fake.plc.shown["clock"] = 4.0 * (time.monotonic() - began_s)
        paces.append(following.pace)

    following = PlcPoller("it", lambda: Direct(fake), PROFILE, look)
    fake.plc.shown["clock"] = 0.0
    await following.open()
    assert await following.until(lambda: looks >= 30, SOON_S)
    await following.close()
    assert min(paces[5:]) > 0.0
