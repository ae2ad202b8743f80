"""After an interrupted pass: what was done, what the tool may have touched unseen, and that none of it is run again."""

from __future__ import annotations

import asyncio
import math
from contextlib import aclosing
from dataclasses import dataclass

import numpy as np

from polishd.daemon.cell.cell import Cell
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord, JournalBlocks, PassRecord
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import DeviceError
from polishd.model.surface import FloatArray
from polishd.process.robot.motion import clock_rate, last_reachable_block

ASK_S = 3.0
"""Longest that asking the robot for what it remembers may take."""


@dataclass(frozen=True, slots=True)
class _Account:
    """A pass as the journal has it, and how far the tool can have come since."""

    record: PassRecord
    blocks: JournalBlocks
    least_s: FloatArray
    """(n,) least time of each block; empty where no plan is kept."""
    late_s: float
    """The robot tells of a block that much later, at most."""

    @classmethod
    def of(cls, journal: Journal, record: PassRecord, late_s: float) -> _Account:
        """Reads the pass's plan and blocks: call in a thread."""
        least_s = np.zeros(0)
        if record.plan:
            plan, least_s = journal.arrays.get(record.plan), np.zeros(record.blocks)
            # at full speed: a machine may take longer than what was written, and no less
            least_s[plan["block"]] = np.minimum(plan["asked_s"], plan["expected_s"])
        return cls(record, journal.executed(record.cycle), least_s, late_s)

    @property
    def last_seq(self) -> int:
        """The last block that is recorded; -1 for none."""
        return int(self.blocks.seq[-1]) if self.blocks.seq.size else -1

    @property
    def next_touched(self) -> int:
        """The first block after it that the tool may have touched, if any."""
        return max(self.last_seq + 1, self.record.contact_from)

    @property
    def ended_off(self) -> bool:
        """In contact, the tool is known to have been off the part in the last block that is recorded."""
        return self.last_seq >= self.record.contact_from and self.blocks.touched[-1] == 0

    def tail(self, within_s: float | None) -> tuple[int, int]:
        """Blocks after the last record that the tool may have reached in so much time of the wall, the program run on.

        At least as fast as the program says, and as it was run so far. All that is left where nothing tells how fast.
        """
        first, end = self.next_touched, self.record.contact_to
        if within_s is not None and self.least_s.size:
            told = self._told
            planned_s = float(self.least_s[self.blocks.seq[told][1:]].sum())
            speed = self._pace(planned_s)
            if speed is not None:
                end = min(end, last_reachable_block(self.least_s, first - 1, within_s * max(speed, 1.0)))
        return first, max(first, end)

    def unseen_s(self) -> float:
        """The robot's process time that can have passed in contact after the last record."""
        told, within_s = self._told, self.record.reach_s
        ends_s = self.blocks.end_s[told]
        speed = self._pace(float(ends_s[-1] - ends_s[0])) if told.any() else None
        return math.inf if within_s is None or speed is None else within_s * max(speed, 1.0)

    @property
    def _told(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        return np.isfinite(self.blocks.told_s)

    def _pace(self, process_s: float) -> float | None:
        told_s = self.blocks.told_s[self._told]
        return clock_rate(process_s, float(told_s[-1] - told_s[0]), self.late_s) if told_s.size else None


async def mark_interrupted(
    cell: Cell, journal: Journal, cycle: int, touch: ContactRecord, robot: RobotProgress | None
) -> None:
    """Contact was left before its end: journal what the tool may have touched after the last block that was told.

    ``robot`` is its word after that, None where it has none any more.
    """
    (record,) = [found for found in journal.passes if found.cycle == cycle]
    account = await asyncio.to_thread(_Account.of, journal, record, cell.limits.robot.silence_s)
    first = account.next_touched
    landed = not touch.ran or first >= record.contact_to  # it stood on a landing point: only a lift moves it there
    if not touch.taken_off if landed else touch.up:
        journal.mark_uncertain(cycle, first, first)
    elif landed or (robot is not None and robot.state != "running" and robot.executed <= first):
        journal.mark_uncertain(cycle, first, first + 1)  # it stands in this one
    else:
        within_s = touch.off_s - touch.told_s + account.late_s
        journal.mark_uncertain(cycle, *account.tail(within_s if math.isfinite(within_s) else None))


async def settle_interrupted_pass(cell: Cell, journal: Journal) -> str:
    """Close the pass that was begun and never ended, with the robot's own account where it still has one.

    Returns what a person should know, empty where nothing was interrupted. Blocks of which nobody knows whether the
    tool was on the part are uncertain. They count as done once and are not run again; the next measurement is the
    ground truth.
    """
    journal.flush()
    record = journal.unfinished()
    if record is None:
        return ""
    cycle = record.cycle
    account = await asyncio.to_thread(_Account.of, journal, record, cell.limits.robot.silence_s)
    told = await _remembered(cell, record, journal.tally(cycle).last_seq + 1)
    if told is not None:
        await asyncio.to_thread(_take_over, journal, account, *told)  # it may be the whole rest of a program
    elif record.uncertain is None:
        first = account.next_touched
        journal.mark_uncertain(cycle, *((first, first) if account.ended_off else account.tail(record.reach_s)))
    journal.end_pass(cycle, "interrupted")
    blocks = ", ".join(f"{first} to {end - 1}" for first, end in journal.uncertain(cycle))
    forgotten = "" if told is not None else " (as far as the tool can have come: the robot does not remember)"
    uncertain = f"uncertain: blocks {blocks}{forgotten}" if blocks else "no block is uncertain"
    done = f"{journal.tally(cycle).done} of {record.blocks} blocks are recorded as executed"
    return f"pass {cycle} was interrupted: {done}; {uncertain}. None of them is run again"


def _take_over(journal: Journal, account: _Account, robot: RobotProgress, told: list[ExecutedBlock]) -> None:
    """Journal what the robot remembers; the tool is off once its actuator must have let go."""
    record, unseen_s = account.record, account.unseen_s()
    end = record.contact_to if record.uncertain is None else record.uncertain[1]
    since_s = account.blocks.end_s[-1] if account.blocks.seq.size else 0.0  # nothing told: unseen_s has no end

    def off(seq: int, start_s: float) -> bool:
        return account.ended_off or not record.contact_from <= seq < end or start_s - since_s > unseen_s

    records = [BlockRecord(block, False if off(block.seq, block.start_s) else None) for block in told]
    journal.reconcile(record.cycle, records)
    first = max(account.last_seq, told[-1].seq if told else -1) + 1
    if off(first, told[-1].end_s if told else since_s):
        journal.mark_uncertain(record.cycle, first, first)
    elif robot.state != "running":
        journal.mark_uncertain(record.cycle, first, first + 1)  # it stands in this one
    else:
        journal.mark_uncertain(record.cycle, first, max(first, min(end, account.tail(record.reach_s)[1])))


async def _remembered(
    cell: Cell, record: PassRecord, from_seq: int
) -> tuple[RobotProgress, list[ExecutedBlock]] | None:
    """The robot's word, and the blocks that it executed from there on; None if it is not the same robot run.

    Without a ``boot_id`` nobody can tell whether it is: what such a robot ran while no link was up its driver cannot
    know, and what it does not tell is not taken as not executed.
    """
    if not record.boot_id:
        return None
    try:
        async with asyncio.timeout(ASK_S):
            progress = await cell.robot.progress()
            if progress.boot_id != record.boot_id or progress.program_sha256 != record.program_sha256:
                return None
            blocks: list[ExecutedBlock] = []
            if progress.executed > from_seq:
                async with aclosing(cell.robot.executed(from_seq)) as told:  # type: ignore[type-var]
                    async for block in told:
                        blocks.append(block)
                        if block.seq >= progress.executed - 1:
                            break
            return progress, blocks
    except (DeviceError, TimeoutError):
        return None
