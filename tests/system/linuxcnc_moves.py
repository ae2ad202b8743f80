"""Drive LinuxCNC without a daemon, from inside the cell's network: ``python -m tests.system.linuxcnc_moves PORT DIR``.

Prints, as JSON, what happened.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from polishd.api import DeviceRefused, Robot
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.transport.address import Tcp
from tests.programs import plan_of

START, CORNER, DWELL, END = 3, 7, 8, 10
BLOCKS = [b"G21 G90 G94 G61", b"G0 X0 Y0 Z50 A-10 C20", b"(land)"]
BLOCKS += [b"G1 X%d A%d C%d F300" % (x, -10 - x, 20 + 2 * x) for x in (2, 4, 6, 8)]
BLOCKS += [b"G91 G1 Y4 C2 F1200", b"G4 P2", b"G1 Y1", b"G90 G1 X0", b"M2"]
"""Moves of all five axes. The first moves and the dwell take longer than the hold takes to arrive."""


async def until(robot: Robot, executed: int) -> None:
    """Wait until the robot has executed that number of blocks."""
    async for one in robot.executed():
        if one.seq >= executed - 1:
            return


async def main(port: int, folder: Path) -> dict[str, Any]:
    """Stop, resume, hold in motion and in a dwell, abort, and send a command that is refused; return the results."""
    robot = LinuxCnc(Tcp("127.0.0.1", port), folder, controller_dir="/mnt/nc")
    said: dict[str, Any] = {}
    await robot.open()
    said["before"] = (await robot.status()).state
    plan = replace(plan_of(BLOCKS, approach_blocks=START), contact_blocks=END)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume(until=START)
    await until(robot, START)
    said["stop"] = await _at(robot)
    await robot.resume(until=END)
    await until(robot, START + 1)
    began = time.monotonic()
    await robot.hold()
    said["hold_s"] = time.monotonic() - began
    said["held"] = await _at(robot)
    await robot.resume(until=END)
    await until(robot, CORNER)
    await asyncio.sleep(1.0)  # the move takes 0.24 s, the dwell 2 s; LinuxCNC does not report where one ends
    await robot.hold()
    said["in_dwell"] = await _at(robot)
    await robot.resume(until=END)
    await until(robot, END)
    said["end_of_contact"] = await _at(robot)
    said["dwell_s"] = [one.end_s - one.start_s async for one in _first(robot, END) if one.seq == DWELL]
    await robot.resume()
    await until(robot, len(BLOCKS))
    said["done"] = (await robot.progress()).state
    await _abort_and_refuse(robot, said)
    await robot.close()
    return said


async def _abort_and_refuse(robot: LinuxCnc, said: dict[str, Any]) -> None:
    plan = plan_of(BLOCKS)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume()
    await until(robot, START)
    await robot.close()  # what a lost link leaves behind
    began = time.monotonic()
    await robot.make_safe()
    said["abort_s"] = time.monotonic() - began
    await robot.open()
    said["after"] = [(await robot.status()).safe, (await robot.progress()).detail]
    bad = plan_of([b"G21", b"G1 X1 ?", b"M2"])
    await robot.prepare(bad)
    try:
        await robot.send(bad.segments)
    except DeviceRefused as error:
        said["refused"] = str(error)


async def _first(robot: Robot, count: int) -> Any:
    async for one in robot.executed():
        yield one
        if one.seq == count - 1:
            return


async def _at(robot: LinuxCnc) -> list[Any]:
    await asyncio.sleep(0.1)
    progress = await robot.progress()
    return [progress.state, progress.executed, (await robot.status()).safe]


if __name__ == "__main__":
    print(json.dumps(asyncio.run(main(int(sys.argv[1]), Path(sys.argv[2])))))
