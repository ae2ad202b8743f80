"""Blocks a second over the robot link: the real driver and the simulated robot's own process, over loopback.

Measured is acceptance, in wall time: the robot has checked CRC and sequence, has read each block, found it within its
limits and its reach, and has confirmed it. Its window holds the whole program, and it stands, so that execution limits
nothing. Send-and-wait is the same driver with one block a frame and a wait for its ACCEPTED, in turns with ours.
"""

from __future__ import annotations

import asyncio
import hashlib
import statistics
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.harness import MIN_REPEATS, Progress, Row, running_cell
from polishd.daemon.contact.streaming import CHUNK
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from polishd.model.program import Plan, Program, Segment

BLOCKS = 40_000
ALONE = 4_000
"""Blocks sent one by one."""
SIM = f"""
[plant]
aperture_mm = 40.0
[robot]
port = 0
window = {BLOCKS}
"""


def rows(progress: Progress) -> Iterator[Row]:
    """Microseconds a block: all at once, in the daemon's chunks, and one by one."""
    with running_cell(SIM) as endpoints:
        host, port = endpoints["robot"].removeprefix("tcp://").split(":")
        costs = asyncio.run(measured(Tcp(host, int(port)), progress))
    alone = costs[1]
    for at_once, name in ((BLOCKS, "all at once"), (CHUNK, f"{CHUNK} at once, as the daemon does")):
        yield Row(f"robot link, blocks accepted, {name}", costs[at_once], {"send-and-wait": alone}, "us/block")


async def measured(address: Tcp, progress: Progress) -> dict[int, float]:
    """Blocks handed over at once, and the median cost of a block."""
    plans = {BLOCKS: plan(BLOCKS), CHUNK: plan(BLOCKS), 1: plan(ALONE)}
    taken: dict[int, list[float]] = {at_once: [] for at_once in plans}
    robot = RobotLink(address, client="benchmark")
    await robot.open()
    try:
        for turn in range(1, MIN_REPEATS + 1):
            for at_once, program in plans.items():
                progress(f"streaming: {at_once} at once {turn}/{MIN_REPEATS}")
                taken[at_once].append(await cost_us(robot, program, at_once))
    finally:
        await robot.close()
    return {at_once: statistics.median(costs) for at_once, costs in taken.items()}


async def cost_us(robot: RobotLink, program: Plan, at_once: int) -> float:
    """Wall time from the first block to the acceptance of the last, us a block."""
    await robot.prepare(program)
    segments = program.segments
    begin = time.perf_counter()
    for first in range(0, len(segments), at_once):
        await robot.send(segments[first : first + at_once])
    taken_s = time.perf_counter() - begin
    if (accepted := (await robot.progress()).accepted) != len(segments):
        raise RuntimeError(f"{accepted} of {len(segments)} blocks accepted")
    return taken_s / len(segments) * 1e6


def plan(blocks: int) -> Plan:
    """A raster with five axes and a feed in each block, as a rewritten program has them."""
    x = np.resize(np.concatenate([np.linspace(-15, 15, 301), np.linspace(15, -15, 301)]), blocks)
    y = np.floor(np.arange(blocks) / 301) % 300 * 0.1 - 15
    lines = [
        f"N{k + 1} G1 X{a:.4f} Y{b:.4f} Z0.0000 A15.000 C0.000 F{600 + k % 97}.125".encode()
        for k, (a, b) in enumerate(zip(x, y, strict=True))
    ]
    text = b"\n".join(lines)
    none, points = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    program = Program(
        text, hashlib.sha256(text).hexdigest(), "raster.rnc", "rs274", "feed", line=none, block=none,
        start_mm=points, end_mm=points, axis=points, time_s=np.zeros(0), lines=blocks, max_feed_mm_min=700.0,
    )  # fmt: skip
    segments = tuple(Segment(seq, line) for seq, line in enumerate(lines))
    return Plan(program, 0, blocks, np.zeros(0), np.zeros((1, 1)), segments)
