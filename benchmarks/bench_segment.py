"""Program of a segment of an extremely large telescope, two million blocks, through the simulated robot controller.

The program is rewritten, streamed by the daemon's code over the real link, executed by the simulated controller in its
own process at 150 times the wall's pace, and journaled. Hash and blocks must be those of the plan. The memory of the
daemon's side is the peak of its process in the stream beyond what it used before. By name only.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.bench_size import SEGMENT
from benchmarks.harness import Progress, Row, memory_bytes, reset_peak
from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.daemon.cell.cell import MonotonicClock
from polishd.daemon.contact.progress import ProgressLimits
from polishd.daemon.contact.streaming import streaming
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from polishd.model.devices import ExecutedBlock
from polishd.model.outline import hexagon
from polishd.model.program import Plan, Program, Segments
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.process.toolpath.apertures import over_outline
from polishd.process.toolpath.paths import raster

SPEED = 150.0
FEED_MM_MIN = 1500.0
FASTER = 0.9, 1.6
"""Range of the factor on each block's time in the rewritten program: the dwell changes over the part."""
AHEAD_S, LEAST_S = 1.0, 0.2
"""Look-ahead and least motion in the robot, wall time; its window of 16,384 blocks lasts 3.5 s."""
TURN = 200
"""Blocks in one record of the journal."""
SIM = """
[plant]
aperture_mm = 100.0
origin_mm = [1000.0, 700.0, 2085.0]
[kinematics]
type = "hybrid"
workspace_radius_mm = 2500.0
stroke_mm = [100.0, 10000.0]
[robot]
port = 0
corner_deg = 180.0
x_mm = [-900.0, 900.0]
y_mm = [-900.0, 900.0]
"""


def rows(progress: Progress) -> Iterator[Row]:
    """Time and memory of each part for a block; RuntimeError where the hash or a block differs."""
    progress("segment: rewrite, stream, execute, journal")
    found = json.loads(subprocess.run([sys.executable, "-m", __name__], stdout=subprocess.PIPE, check=True).stdout)
    name = f"segment: {found['blocks']} blocks"
    yield Row(f"{name}, rewritten and read back", found["rewrite_us"], {}, "us/block")
    yield Row(f"{name}, streamed, executed and journaled", found["stream_us"], {}, "us/block")
    yield Row(f"{name}, memory of the daemon's side during the stream", found["stream_mb"], {}, "MB")
    yield Row(f"{name}, memory of the robot's process", found["robot_mb"], {}, "MB")
    yield Row(f"{name}, greatest difference of a block's time", found["worst_ms"], {}, "ms")


def program_text() -> bytes:
    """Return a raster over the segment with a feed in each block, five axes."""
    points = raster(over_outline(hexagon(SEGMENT.diameter_mm * np.sqrt(3) / 2)), SEGMENT.step_mm, SEGMENT.step_mm)
    return b"".join(
        [
            b"G21 G90 G94\nG0 X%.4f Y%.4f Z5.0000 A0 C0\n" % tuple(points[0, :2]),
            *(
                b"N%d G1 X%.4f Y%.4f Z0.0000 A0.000 C0.000 F%.1f\n" % (number, x, y, FEED_MM_MIN)
                for number, (x, y) in enumerate(points[:, :2].tolist())
            ),
            b"G1 Z5.0000 F600.0\nM2\n",
        ]
    )


def rewritten() -> Program:
    """Return the program with changed times, read back from its text."""
    spoken = dialect("rs274")
    program = formats.read(spoken, program_text(), "segment.rnc")
    phase = np.linspace(0.0, 400.0, program.n)
    least, most = FASTER
    times_s = program.time_s * (least + (most - least) * (0.5 + 0.5 * np.sin(phase)))
    text = formats.rewrite(spoken, program, times_s)
    return formats.read(spoken, text, "segment.rnc")


async def polished(plan: Plan, address: Tcp, journal: Journal) -> None:
    """Stream the plan as the daemon does, and journal what the robot reports."""
    robot = RobotLink(address, client="benchmark")
    await robot.open()
    try:
        limits = ProgressLimits(late_s=60.0, start_s=60.0)
        async with streaming(plan, robot, MonotonicClock(), AHEAD_S, least_s=LEAST_S, limits=limits) as stream:
            await stream.approach()
            turn: list[BlockRecord] = []
            async for block in stream.polish():
                turn.append(record(block))
                if len(turn) == TURN:
                    journal.record_executed(0, turn)
                    turn = []
            journal.record_executed(0, turn)
            await stream.retreat()
    finally:
        await robot.close()
    journal.flush()


def record(block: ExecutedBlock) -> BlockRecord:
    """Return the journal's record of an executed block."""
    return BlockRecord(block, True, 12.0, 1000.0, block.start_s, block.end_s)


def measured(folder: Path) -> dict[str, float]:
    """Run everything; RuntimeError where what was executed is not what was planned."""
    begin_s = time.perf_counter()
    program = rewritten()
    rewrite_s = time.perf_counter() - begin_s
    first, last = int(program.block[0]), int(program.block[-1]) + 1
    plan = Plan(program, first, last, program.time_s, np.ones((2, 2)), Segments(program.text))
    config, state = folder / "sim.toml", folder / "sim"
    config.write_text(SIM)
    (folder / "state").mkdir()
    journal = Journal.open(folder / "state", job="segment", part_id="ELT")
    journal.begin_pass(0, program.sha256, "boot", len(plan.segments), reach_s=1.0)
    before = reset_peak()
    with simulated_cell(config, ["--state", str(state), "--speed", f"{SPEED:g}"], folder / "sim.stderr"):
        host, port = json.loads((state / "endpoints.json").read_text())["robot"].removeprefix("tcp://").split(":")
        begin_s = time.perf_counter()
        asyncio.run(polished(plan, Tcp(host, int(port)), journal))
        stream_s = time.perf_counter() - begin_s
        stream_mb = (memory_bytes("VmHWM") - before) / 1e6
        robot = json.loads((state / "pids.json").read_text())["robot"]
        robot_mb = memory_bytes("VmHWM", robot) / 1e6
    executed = journal.executed(0)
    journal.close()
    require_equal(program, executed.seq, plan)
    worst_s = np.abs(
        (executed.end_s - executed.start_s)[np.searchsorted(executed.seq, program.block)] - program.time_s
    ).max()
    events = [json.loads(line) for line in (state / "sim.log").read_text().splitlines()]
    loaded = [event["sha256"] for event in events if event["event"] == "program_loaded"]
    if loaded != [program.sha256] or program.sha256 != hashlib.sha256(program.text).hexdigest():
        raise RuntimeError(f"the robot loaded {loaded}, planned was {program.sha256}")
    return {
        "blocks": program.n,
        "rewrite_us": rewrite_s / program.n * 1e6,
        "stream_us": stream_s / program.n * 1e6,
        "stream_mb": stream_mb,
        "robot_mb": robot_mb,
        "worst_ms": 1e3 * float(worst_s),
    }


def require_equal(program: Program, seq: np.ndarray, plan: Plan) -> None:
    """RuntimeError where the journal has other blocks than the plan."""
    wanted = np.arange(plan.approach_blocks, plan.contact_blocks)
    if not np.array_equal(seq, wanted):
        raise RuntimeError(f"{seq.size} of {wanted.size} blocks of {program.name} are journaled")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        print(json.dumps(measured(Path(scratch))))
