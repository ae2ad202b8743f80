"""The stages of a program of many blocks, and the memory that each may take for a block."""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np

from polishd.daemon.contact.streaming import streaming
from polishd.daemon.job.run_folder_writer import RunFolderWriter
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.drivers.robot_link.driver import _hash_of
from polishd.interfaces import Clock, Robot
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.program import Envelope, Plan, Program, Segment, Segments
from polishd.pipeline.run_folder import RunFolder
from polishd.plugins.plan_checks import CHECKS
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.reports.run_reader import _executed

BOUNDS = {
    "read": 200,
    "rewrite": 130,
    "read back": 200,
    "segments": 24,
    "guard": 100,
    "to the worker and back": 360,
    "stream": 24,
    "journal": 24,
    "recovery": 160,
    "executed.csv": 240,
    "report": 128,
    "rapid, read": 200,
    "rapid, rewritten": 200,
    "krl, read": 200,
    "krl, rewritten": 200,
}
"""Most bytes of peak memory that a stage may take for each block (a language: for each line) beside its input.

Its output is included. docs/how-to/programs.md lists them; benchmark and test check them.
"""
FIXED_MB = 40.0
"""Memory of a stage for any number of blocks: pieces of the program's text under way, SQLite's pages."""
TURN = 100
"""Blocks in one report."""
GROUP = 5_000
"""Blocks after which the journal's disk has caught up."""
WRITING = {
    "rapid": (
        "MODULE Polish\n  PROC main()\n",
        "    MoveL [[{:.3f},{:.3f},5.000],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v9,fine,t;\n  WaitTime 0.5;\n",
        "  ENDPROC\nENDMODULE\n",
    ),
    "krl": (
        "DEF polish()\n",
        "  LIN {{X {:.3f}, Y {:.3f}, Z 5.000, A 0.0, B 0.0, C 180.0}}\n  WAIT SEC 0.5\n",
        "END\n",
    ),
}
"""Of each language head, a point's move and dwell, and tail."""
Stage = tuple[str, Callable[[], object]]


def nc_program(blocks: int) -> bytes:
    """A path with a feed in each block."""
    x, y = np.linspace(0, 50, blocks), np.linspace(-40, 40, blocks)
    return b"".join(
        [
            b"G21 G90 G94\nG0 X-60 Y-60 Z5 A0 C0\n",
            *(b"N%d G1 X%.4f Y%.4f Z0.0000 A0.000 C0.000 F600.0\n" % point for point in zip(range(blocks), x, y)),  # noqa: B905
            b"M2\n",
        ]
    )


def language_program(language: str, lines: int) -> bytes:
    """Moves with a dwell each."""
    head, point, tail = WRITING[language]
    x, y = np.linspace(0, 50, lines // 2), np.linspace(-40, 40, lines // 2)
    return "".join([head, *(point.format(*place) for place in zip(x, y, strict=True)), tail]).encode()


def language_stages(language: str, text: bytes) -> Iterator[Stage]:
    """Reading and rewriting."""
    spoken = dialect(language)
    read: list[Program] = []
    yield f"{language}, read", lambda: read.append(formats.read(spoken, text, "long"))
    times = read[0].time_s + 0.1234
    yield f"{language}, rewritten", lambda: formats.rewrite(spoken, read[0], times)


def nc_stages(text: bytes) -> Iterator[Stage]:
    """Stages from the program's text to the robot; run each before the next is requested."""
    spoken, kept = dialect("rs274"), dict[str, Any]()
    few = formats.read(spoken, nc_program(20_000), "compiled")
    formats.rewrite(spoken, few, few.time_s * 1.3)  # on a new machine the compiler would count as the stages' memory
    del few
    yield "read", lambda: kept.update(program=formats.read(spoken, text, "long"))
    times = kept["program"].time_s * 1.3 + 0.01
    yield "rewrite", lambda: kept.update(text=formats.rewrite(spoken, kept["program"], times))
    yield "read back", lambda: kept.update(program=formats.read(spoken, kept.pop("text"), "long"))
    program: Program = kept["program"]
    yield "segments", lambda: kept.update(segments=Segments(program.text))
    block = program.block
    plan = Plan(program, int(block[0]), int(block[-1]) + 1, program.time_s, np.ones((2, 2)), kept.pop("segments"))
    yield "guard", lambda: [list(check(plan, wide())) for check in CHECKS]
    yield "to the worker and back", lambda: pickle.loads(pickle.dumps(plan)).program.n
    yield "stream", lambda: asyncio.run(streamed(plan))


def kept_stages(blocks: int, folder: Path) -> Iterator[Stage]:
    """Stages from the robot's report to the final report; run each before the next is requested."""
    state = folder / "state"
    state.mkdir()
    opened = [Journal.open(state, job="long", part_id="p")]
    opened[0].begin_pass(0, "0" * 64, "boot", blocks, reach_s=1.0)
    yield "journal", lambda: record(opened[0], blocks)
    opened.pop().close()

    def recovered() -> object:
        opened.append(Journal.open(state, job="long", part_id="p"))
        return opened[0].executed(0).seq.size

    yield "recovery", recovered
    opened[0].end_pass(0, "done")
    people = RunFolderWriter(RunFolder(folder / "run"), opened[0])
    yield "executed.csv", lambda: people._executed(0)
    opened[0].copy_to(folder / "run" / "journal.sqlite")
    opened.pop().close()
    yield "report", lambda: _executed(folder / "run" / "cycle-00" / "executed.csv")


def record(journal: Journal, blocks: int) -> None:
    """Blocks as a robot reports them, with all their data."""
    for first in range(0, blocks, TURN):
        reported = range(first, min(first + TURN, blocks))
        journal.record_executed(0, [executed(seq) for seq in reported])
        if first % GROUP == 0:
            journal.flush()  # at the speed of the disk, as in contact
    journal.flush()


def executed(seq: int) -> BlockRecord:
    """A block with the longest possible numbers."""
    begin_s = seq * 0.0123456789
    return BlockRecord(
        ExecutedBlock(seq, begin_s, begin_s + 0.0123456789),
        True,
        12.0123 + seq * 1e-7,
        1000.12345,
        begin_s,
        12.03456789,
    )


class Sink:
    """A robot that accepts all blocks at once and executes only on command."""

    def __init__(self) -> None:
        self.taken = self.blocks = 0
        self.full = asyncio.Event()
        self.buffer_s = 0.0

    async def prepare(self, plan: Plan) -> None:
        self.blocks = len(plan.segments)
        await asyncio.to_thread(_hash_of, plan.segments)

    async def send(self, segments: Sequence[Segment]) -> None:
        assert segments[0].seq == self.taken
        self.taken += len(segments)
        if self.taken == self.blocks:
            self.full.set()

    async def progress(self) -> RobotProgress:
        return RobotProgress("held", "", self.taken, 0, 0.0)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        for seq in range(from_seq, self.taken):
            yield ExecutedBlock(seq, 0.0, 1.0)


async def streamed(plan: Plan) -> int:
    """Send all blocks in the daemon's chunks; return their number."""
    sink = Sink()
    async with AsyncExitStack() as stack:
        robot, clock = cast("Robot", sink), cast("Clock", Still())
        await stack.enter_async_context(streaming(plan, robot, clock, 2.0, least_s=1.0))
        await sink.full.wait()
    return sink.taken


class Still:
    """A clock without long waits."""

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(min(seconds, 0.01))


def wide() -> Envelope:
    """Limits that no point violates."""
    return Envelope(
        x_mm=(-1e6, 1e6), y_mm=(-1e6, 1e6), z_mm=(-1e6, 1e6), max_feed_mm_s=1e9, min_feed_mm_s=0.0, accel_mm_s2=1e9,
        block_overhead_s=0.0, corner_deg=180.0, max_pass_s=1e12, max_removal_nm=1e9,
    )  # fmt: skip
