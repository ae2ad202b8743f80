"""The longest stall of the daemon's loop in contact: devices without a request for half a second take the force off.

A stall is the time from one look of the loop at what is ready to its next, less what the machine kept from this
process: time that its threads could run and another process did (``/proc/self/task/*/schedstat``), and time that its
host did not run a virtual machine (``steal`` in ``/proc/stat``). So a busy machine makes no stalls, but waiting for a
lock, for the disk, or for Python's own lock does.
"""

from __future__ import annotations

import asyncio
import functools
import os
import sqlite3
import threading
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.cell.cell import Cell, MonotonicClock
from polishd.daemon.job_runner import JobRunner
from polishd.daemon.job_source import SingleJob
from polishd.daemon.journal.checksums import register_checksum
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.runtime.events import EventBus
from polishd.daemon.runtime.process import logging_to
from polishd.daemon.socket import client
from polishd.daemon.socket.server import serving
from polishd.model.devices import ActuatorTimes, ExecutedBlock, ForceSample, SpeedSample, SpindleTimes
from polishd.model.program import Plan, Segment
from polishd.model.states import Outcome
from polishd.pipeline.decisions import AnotherPass, passes_used
from polishd.pipeline.records import SolveResult
from tests.fakes.devices import FakeActuator, FakeCell, FakeMetrology, FakeRobot, FakeSpindle
from tests.time_limits import waits
from tests.unit.daemon.small_job import small_job, small_map

SCHEDSTAT = Path("/proc/self/schedstat")
STAT, STEAL = Path("/proc/stat"), 8
"""The first line sums all processors: a name, then times by kind, in ticks (proc_stat(5))."""
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
EARLIER_PASSES, EARLIER_BLOCKS = 4, 100_000
BLOCKS = 60_000
LUMP, LUMP_S = 2000, 0.1
BLOCK_S = LUMP_S / LUMP
FSYNC_S = 0.3
STALL_S = 0.05

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(not SCHEDSTAT.exists(), reason="the kernel does not report how long threads waited"),
]


class SlowDisk:
    """Connections whose commits take that long, once the disk is slow."""

    def __init__(self) -> None:
        self.slow = False
        self.commits = 0

    def connect(self, path: Path) -> sqlite3.Connection:
        disk = self

        class Connection(sqlite3.Connection):
            def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
                if sql == "COMMIT" and disk.slow:
                    disk.commits += 1
                    time.sleep(FSYNC_S)
                return super().execute(sql, *values)

        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, factory=Connection)
        register_checksum(connection)
        return connection


class Watch:
    """Times each turn of the running loop while ``on``."""

    def __init__(self) -> None:
        self.on = False
        self.turns = 0
        self.longest_s = 0.0
        self._turn: tuple[float, float] | None = None
        selector: Any = asyncio.get_running_loop()._selector  # type: ignore[attr-defined]
        self._select = selector.select
        selector.select = self._watched

    def _watched(self, timeout: float | None = None) -> Any:
        ended = time.monotonic()
        if self._turn is not None:
            kept, began = self._turn
            self.longest_s = max(self.longest_s, ended - began - (kept_s() - kept))
            self.turns += 1
        found = self._select(timeout)
        self._turn = (kept_s(), time.monotonic()) if self.on else None  # in this order: asking is no part of the turn
        return found


def kept_s() -> float:
    """How long threads of this process could have run and did not get a processor, or the machine was not run."""
    processors = (line.split() for line in STAT.read_text().splitlines() if line.startswith("cpu"))
    stolen = next(int(times[STEAL]) for times in processors)
    return sum(waits().values()) / 1e9 + stolen / TICKS_PER_S


class LumpyRobot(FakeRobot):
    """Reports its executed blocks in lumps of 2,000."""

    @property
    def buffer_s(self) -> float:
        return (len(self.loaded) - self.done) * BLOCK_S

    async def send(self, segments: Sequence[Segment]) -> None:
        self.loaded += segments
        self._changed.set()
        await asyncio.sleep(0)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        while True:
            while self._is_held() or self.done >= len(self.loaded):
                self._changed.clear()
                await self._changed.wait()
            await asyncio.sleep(LUMP_S)
            until = len(self.loaded) if self.until is None else min(len(self.loaded), self.until)
            for seq in range(self.done, min(self.done + LUMP, until)):
                self.done = seq + 1
                yield ExecutedBlock(seq, seq * BLOCK_S, self.done * BLOCK_S)


class PacedActuator(FakeActuator):
    """Reads itself fifty times a second; while it presses the disk is slow and the loop is watched."""

    watch: Watch
    disk: SlowDisk

    def _watched(self, on: bool) -> None:
        self.watch.on = self.disk.slow = on

    async def set_force(self, force_n: float) -> None:
        await super().set_force(force_n)
        self._watched(force_n > 0)

    async def make_safe(self) -> None:
        self._watched(False)
        await super().make_safe()

    async def samples(self) -> AsyncIterator[ForceSample]:
        while True:
            yield ForceSample(time.monotonic(), self.force_n, self.force_n, self.force_n > 0, self.retracted)
            await asyncio.sleep(0.02)


class PacedSpindle(FakeSpindle):
    """Reads itself fifty times a second."""

    async def samples(self) -> AsyncIterator[SpeedSample]:
        while True:
            yield SpeedSample(time.monotonic(), self.rpm, self.rpm)
            await asyncio.sleep(0.02)


class Asker(threading.Thread):
    """A person's program that asks for the status ten times a second."""

    def __init__(self, state_dir: Path) -> None:
        super().__init__(name="asker", daemon=True)
        self.state_dir = state_dir
        self.answers: list[dict[str, Any]] = []
        self.enough = threading.Event()

    def run(self) -> None:
        while not self.enough.wait(0.1):
            self.answers.append(client.request(self.state_dir, "status", 10.0))


def long_history(journal: Journal) -> None:
    """Passes that ended, as the journal keeps them; each follows the map of its cycle."""
    facts = {"predicted_rms_nm": 1.0, "dwell_s": 9.0, "rate": 1.0, "block_overhead_s": 0.0}
    (cycle,) = {record.cycle for record in journal.history} - {record.cycle for record in journal.passes}
    facts["certificate"] = {}
    journal.begin_pass(cycle, "sha", "boot-0", EARLIER_BLOCKS, facts=facts)
    for seq in range(EARLIER_BLOCKS):
        journal.record_executed(cycle, [BlockRecord(ExecutedBlock(seq, seq * 0.1, seq * 0.1 + 0.1), True)])
    journal.end_pass(cycle, "done")


async def with_long_plan(plan_of: Any, cycle: int, surface: Any, solved: SolveResult) -> Plan:
    """The job's own plan with the blocks of a long one."""
    plan: Plan = await plan_of(cycle, surface, solved)
    segments = tuple(Segment(seq, b"G1 X0") for seq in range(BLOCKS))
    return replace(plan, segments=segments, approach_blocks=10, contact_blocks=BLOCKS - 10)


async def learn_nothing(cycle: int, surface: Any) -> None:
    """The earlier passes were never planned."""


async def test_the_loop_is_never_held_for_long_in_contact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, fake = SlowDisk(), FakeCell()
    robot, metrology = LumpyRobot(fake.events, fake.clock), FakeMetrology(fake.events, fake.clock)
    actuator = PacedActuator(fake.events, fake.clock)
    actuator.disk, actuator.watch = disk, Watch()
    metrology.maps = [small_map(seed=seed) for seed in (7, 8)]
    spindle = PacedSpindle(fake.events, fake.clock)
    # stalls are judged here: a busy machine makes silence, too
    actuator.times, spindle.times = ActuatorTimes(silence_s=60.0), SpindleTimes(silence_s=60.0)
    devices = {"actuator": actuator, "robot": robot, "spindle": spindle, "metrology": metrology}
    cell = Cell(devices, {name: name for name in devices}, MonotonicClock())
    with (
        logging_to(tmp_path),
        Journal.open(tmp_path, job="small", part_id="P-1", connect=disk.connect) as journal,
    ):
        bus = EventBus(lambda event: None, sinks=(journal.record_event,))
        job = small_job(tmp_path, journal, publish=bus.publish, max_cycles=EARLIER_PASSES + 1)
        for cycle in range(EARLIER_PASSES):
            await job.measured(cycle, small_map(seed=cycle))
            long_history(journal)
        monkeypatch.setattr(job, "learn", learn_nothing)
        # The maps are of no one part: nothing of them ends the job before its last pass.
        monkeypatch.setattr(
            job,
            "decide",
            lambda cycle, _: AnotherPass() if cycle <= EARLIER_PASSES else passes_used(job.recipe),
        )
        monkeypatch.setattr(job, "plan", functools.partial(with_long_plan, job.plan))
        jobs = SingleJob(journal, job.folder, job)
        requests = QueueRequests(None, None, jobs.queue)  # type: ignore[arg-type]
        daemon, asker = JobRunner(cell, jobs, requests, bus), Asker(tmp_path)
        async with serving(tmp_path, daemon.handlers, bus):
            asker.start()
            try:
                outcome = await daemon.run()
            finally:
                asker.enough.set()
                await asyncio.to_thread(asker.join)
        await bus.close()
        assert outcome is Outcome.CYCLES_USED
        executed = journal.executed(EARLIER_PASSES)
        assert executed.seq.tolist() == list(range(10, BLOCKS - 10))
        assert journal.contact_s(EARLIER_PASSES) == pytest.approx(np.sum(executed.duration_s[executed.contact]))
    in_contact = [answer for answer in asker.answers if answer["phase"] == "run"]
    assert len(in_contact) >= 10
    assert [round(entry["executed_s"]) for entry in in_contact[-1]["cycles"][:EARLIER_PASSES]] == [10_000] * 4
    assert disk.commits >= 5, "the disk was slow while the tool pressed"
    assert actuator.watch.turns > 100
    assert actuator.watch.longest_s < STALL_S
