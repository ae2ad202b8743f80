"""Streaming over bad wires, checked with the robot's motion, not with its reports."""

from __future__ import annotations

import asyncio
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from polishd.api import ExecutedBlock, LinkError, Plan
from polishd.daemon.contact.progress import ProgressLimits
from polishd.daemon.contact.streaming import CHUNK as DAEMON_CHUNK
from polishd.daemon.contact.streaming import streaming
from polishd.drivers.robot_link import driver as link_driver
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from polishd.sim_backends.common import framing as f
from tests.fakes.proxy import wire
from tests.programs import plan_of
from tests.system.witness_rig import Witness, witnessed_robot

pytestmark = pytest.mark.system

SEQ, WALL0, WALL1, DT, X, Y = range(6)
CHUNK = 250
LOOKAHEAD_S = 1.5


def zigzag(blocks: int, step_mm: float, feed_mm_min: float, approach: int = 0) -> Plan:
    """Return a plan of moves to and fro along x with different lengths: the position identifies the block."""
    x = np.cumsum(np.where(np.arange(blocks) // 100 % 2, -step_mm, step_mm) * (1 + np.arange(blocks) % 7 / 50))
    lines = [f"G1 X{at:.4f} F{feed_mm_min:g}".encode() for at in x]
    lines[0] = b"G21 G90 G94 Y0 Z5 A15 C0 " + lines[0].replace(b"G1", b"G0")
    return plan_of(lines, approach)


def require_executed_once_and_in_order(witness: Witness, plan: Plan) -> None:
    """Require that the tool moved along each block once, from start to end, and nowhere else."""
    moved, ends = witness.moved, [float(segment.text.split(b"X")[1].split()[0]) for segment in plan.segments]
    seq = moved[:, SEQ].astype(int)
    assert np.all(np.diff(seq) >= 0), "in order"
    assert np.array_equal(np.unique(seq), np.arange(len(ends))), "all of them"
    low, high = np.minimum([0.0, *ends[:-1]], ends)[seq], np.maximum([0.0, *ends[:-1]], ends)[seq]
    assert np.all((low - 1e-9 <= moved[:, X]) & (moved[:, X] <= high + 1e-9)), "each where it belongs"
    forward = np.sign(np.diff([0.0, *ends]))[seq]
    again = (np.diff(seq) == 0) & (np.diff(moved[:, X]) * forward[1:] < 0)
    assert not again.any(), "none of them twice"
    assert np.all(moved[1:, WALL0] >= moved[:-1, WALL1] - 1e-9)


async def send_on(robot: RobotLink, plan: Plan) -> None:
    accepted = (await robot.progress()).accepted
    for first in range(accepted, len(plan.segments), CHUNK):
        await robot.send(plan.segments[first : first + CHUNK])


async def keep_running(robot: RobotLink, plan: Plan) -> None:
    """Resume motion wherever the robot is held with enough blocks ahead."""
    while (progress := await robot.progress()).state != "done":
        enough = min(len(plan.segments), progress.executed + 2 * CHUNK)
        if progress.state == "held" and progress.accepted >= enough:
            await robot.resume()
        await asyncio.sleep(0.02)


async def follow(robot: RobotLink, seen: list[ExecutedBlock]) -> None:
    async for one in robot.executed(len(seen)):
        seen.append(one)  # noqa: PERF401


async def carry_through(robot: RobotLink, plan: Plan) -> list[ExecutedBlock]:
    """Run the plan; reconnect after each loss of the link and continue from the robot's state. Return the blocks."""
    seen: list[ExecutedBlock] = []
    lost = 0
    while len(seen) < len(plan.segments):
        try:
            await robot.open()
            if (await robot.progress()).program_sha256 != plan.program.sha256:
                await robot.prepare(plan)
            async with asyncio.TaskGroup() as group:
                for work in (send_on(robot, plan), keep_running(robot, plan), follow(robot, seen)):
                    group.create_task(work)
        except* LinkError:
            lost += 1
    return seen


async def campaign(
    folder: Path, blocks: int, cut_every: int, seed: int
) -> tuple[Witness, Plan, list[ExecutedBlock], int]:
    plan = zigzag(blocks, 0.1, 600.0)
    async with (
        witnessed_robot(folder, speed=25.0) as witness,
        wire(witness.port, seed, drop=0.001, damage=0.001, repeat=0.002, cut_every=cut_every) as bad,
    ):
        robot = RobotLink(Tcp("127.0.0.1", bad.port))
        begin = time.perf_counter()
        try:
            seen = await carry_through(robot, plan)
        finally:
            await robot.close()
        print(
            f"{blocks} blocks in {time.perf_counter() - begin:.1f} s: {bad.frames} frames, {bad.dropped} dropped, "
            f"{bad.damaged} damaged, {bad.repeated} repeated, {bad.cuts} disconnects, "
            f"{len(witness.of('motion_started'))} starts"
        )
        assert bad.dropped >= blocks // 2000
        assert bad.damaged >= blocks // 2000
        assert bad.repeated >= blocks // 2000
    return witness, plan, seen, bad.cuts


@pytest.mark.full
@pytest.mark.parametrize(
    ("blocks", "disconnects"),
    [(2_000, 5), pytest.param(20_000, 50, marks=[pytest.mark.slow, pytest.mark.timeout(180)])],
)
async def test_each_block_is_executed_once_and_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blocks: int, disconnects: int
) -> None:
    monkeypatch.setattr(link_driver, "MAX_BLOCKS", 1)  # a block a frame: faults for each of them
    witness, plan, seen, cuts = await campaign(tmp_path, blocks, 18 * blocks // (10 * disconnects), seed=3)
    assert cuts >= disconnects
    assert len(witness.of("program_loaded")) == 1
    require_executed_once_and_in_order(witness, plan)
    assert [one.seq for one in seen] == list(range(blocks))
    assert all(a.end_s <= b.start_s + 1e-9 for a, b in pairwise(seen))


async def pester(port: int, end: asyncio.Event) -> int:
    """Connect repeatedly in a wrong role, send forbidden frames, read nothing and disconnect."""
    visits = 0
    while not end.is_set():
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        hello = {"protocol": 1, "role": ("reader", "writer")[visits % 2], "client": "pest", "executed_from": 0}
        writer.write(f.pack_json(f.HELLO, hello))
        load = {"program_sha256": "00", "blocks_sha256": "00", "blocks": 1, "approach_blocks": 0}
        for kind, message in ((f.LOAD, load), (f.RESUME, {"until": 1, "stops": 0}), (f.ABORT, {}), (f.PING, {})):
            writer.write(f.pack_json(kind, message))
        writer.write(f.pack_blocks(0, [b"G0 X99"]) + b"PL\x03" + bytes(visits % 50) + f.pack(f.STATUS))
        await reader.readexactly(8)
        writer.transport.abort()
        visits += 1
    return visits


@pytest.mark.full
async def test_monitors_that_come_and_go_do_not_disturb_the_job(tmp_path: Path) -> None:
    plan = zigzag(2_000, 0.1, 600.0)
    async with witnessed_robot(tmp_path, speed=15.0) as witness:
        robot, end = RobotLink(Tcp("127.0.0.1", witness.port)), asyncio.Event()
        await robot.open()
        await robot.prepare(plan)
        await robot.send(plan.segments)
        pests = [asyncio.create_task(pester(witness.port, end)) for _ in range(3)]
        await robot.resume()
        seen = [one.seq async for one in robot.executed()]
        end.set()
        assert sum(await asyncio.gather(*pests)) > 20
        assert (await robot.progress()).state == "done"
        await robot.close()
    assert seen == list(range(2_000))
    assert (len(witness.of("program_loaded")), len(witness.of("motion_started"))) == (1, 1)
    require_executed_once_and_in_order(witness, plan)


@pytest.mark.full
@pytest.mark.parametrize("blocks", [300, pytest.param(1500, marks=pytest.mark.slow)])
async def test_a_robot_of_50_blocks_a_second_does_not_starve_when_the_link_stalls(tmp_path: Path, blocks: int) -> None:
    """The link is silent for one second in two, and the daemon streams with 1.5 s of look-ahead."""
    plan = zigzag(blocks, 0.15, 600.0, approach=3)
    async with witnessed_robot(tmp_path, speed=1.0, watchdog_s=4.0) as witness, wire(witness.port) as bad:
        robot = RobotLink(Tcp("127.0.0.1", bad.port))
        await robot.open()
        stalls = asyncio.create_task(bad.stall(1.0, every_s=2.0))
        seen, most_s = [], 0.0
        try:
            # No report for a second is no progress for a second: a cell with such a link would set robot.no_progress_s.
            patient = ProgressLimits(late_s=3.0)
            async with streaming(
                plan, robot, Wall(), stream_ahead_s=LOOKAHEAD_S, least_s=LOOKAHEAD_S / 4, limits=patient
            ) as stream:
                await stream.approach()
                async for one in stream.polish():
                    seen.append(one.seq)
                    most_s = max(most_s, robot.buffer_s)
        finally:
            stalls.cancel()
            await robot.close()
    require_executed_once_and_in_order(witness, plan)
    assert seen == list(range(3, blocks))
    assert most_s <= 2 * LOOKAHEAD_S + DAEMON_CHUNK / 50.0 + 0.2, "it was streamed, not loaded"
    moved = witness.moved
    contact = moved[moved[:, SEQ] >= 3]
    rate = (blocks - 3) / contact[:, DT].sum()
    assert rate == pytest.approx(50.0, rel=0.1)
    assert np.abs(contact[1:, WALL0] - contact[:-1, WALL1]).max() < 1e-6, "no pause between blocks, nor inside one"


class Wall:
    """Return the wall time."""

    now_s = staticmethod(time.monotonic)
    sleep = staticmethod(asyncio.sleep)
