"""Interrupted pass: which blocks were executed, which are uncertain; none of them is run again."""

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
"""Longest time to read back the executed blocks from the robot."""


@dataclass(frozen=True, slots=True)
class _Account:
    """A pass in the journal, and how far the tool can have moved since the last record."""

    record: PassRecord
    blocks: JournalBlocks
    least_s: FloatArray
    """(n,) shortest time of each block; empty without a stored plan."""
    late_s: float
    """Longest delay of the robot's report of a block."""

    @classmethod
    def of(cls, journal: Journal, record: PassRecord, late_s: float) -> _Account:
        """Read the plan and the blocks of the pass; call it in a thread."""
        least_s = np.zeros(0)
        if record.plan:
            plan, least_s = journal.arrays.get(record.plan), np.zeros(record.blocks)
            # at full speed: a machine may take longer than programmed, never less
            least_s[plan["block"]] = np.minimum(plan["asked_s"], plan["expected_s"])
        return cls(record, journal.executed(record.cycle), least_s, late_s)

    @property
    def last_seq(self) -> int:
        """The last recorded block; -1 for none."""
        return int(self.blocks.seq[-1]) if self.blocks.seq.size else -1

    @property
    def next_touched(self) -> int:
        """The first block after the last recorded one in which the tool may have touched."""
        return max(self.last_seq + 1, self.record.contact_from)

    @property
    def ended_off(self) -> bool:
        """Whether the tool was off the part in the last recorded block of contact."""
        return self.last_seq >= self.record.contact_from and self.blocks.touched[-1] == 0

    def tail(self, within_s: float | None) -> tuple[int, int]:
        """Return the range of blocks after the last record that the tool may have reached within that wall time.

        Assumes the larger of the programmed and the observed speed; all remaining blocks if the speed is unknown.
        """
        first, end = self.next_touched, self.record.contact_to
        if within_s is not None and self.least_s.size:
            planned_s = float(self.least_s[self.blocks.seq[self._reported][1:]].sum())
            speed = self._pace(planned_s)
            if speed is not None:
                end = min(end, last_reachable_block(self.least_s, first - 1, within_s * max(speed, 1.0)))
        return first, max(first, end)

    def unseen_s(self) -> float:
        """Return the longest process time of the robot in contact after the last record."""
        reported, within_s = self._reported, self.record.reach_s
        ends_s = self.blocks.end_s[reported]
        speed = self._pace(float(ends_s[-1] - ends_s[0])) if reported.any() else None
        return math.inf if within_s is None or speed is None else within_s * max(speed, 1.0)

    @property
    def _reported(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        return np.isfinite(self.blocks.told_s)

    def _pace(self, process_s: float) -> float | None:
        at_s = self.blocks.told_s[self._reported]
        return clock_rate(process_s, float(at_s[-1] - at_s[0]), self.late_s) if at_s.size else None


async def mark_interrupted(
    cell: Cell, journal: Journal, cycle: int, touch: ContactRecord, robot: RobotProgress | None
) -> None:
    """Journal the blocks that the tool may have touched after the last reported one, when contact was left early.

    ``robot`` is its progress after that, None if it does not answer.
    """
    (record,) = [found for found in journal.passes if found.cycle == cycle]
    account = await asyncio.to_thread(_Account.of, journal, record, cell.limits.robot.silence_s)
    first = account.next_touched
    landed = not touch.ran or first >= record.contact_to  # on a landing point only a lift moves the robot
    if not touch.taken_off if landed else touch.up:
        journal.mark_uncertain(cycle, first, first)
    elif landed or (robot is not None and robot.state != "running" and robot.executed <= first):
        journal.mark_uncertain(cycle, first, first + 1)  # the robot stands in this one
    else:
        within_s = touch.off_s - touch.reported_s + account.late_s
        journal.mark_uncertain(cycle, *account.tail(within_s if math.isfinite(within_s) else None))


async def settle_interrupted_pass(cell: Cell, journal: Journal) -> str:
    """Close a pass that was begun and not ended, with the executed blocks that the robot still has.

    Return a message for the operator, empty if no pass was interrupted. A block is uncertain if it is unknown whether
    the tool was on the part. Uncertain blocks count as executed once and are not run again; the next map shows what
    they removed.
    """
    journal.flush()
    record = journal.unfinished()
    if record is None:
        return ""
    cycle = record.cycle
    account = await asyncio.to_thread(_Account.of, journal, record, cell.limits.robot.silence_s)
    remembered = await _read_back(cell, record, journal.tally(cycle).last_seq + 1)
    if remembered is not None:
        await asyncio.to_thread(_take_over, journal, account, *remembered)  # these may be 100,000 blocks
    elif record.uncertain is None:
        first = account.next_touched
        journal.mark_uncertain(cycle, *((first, first) if account.ended_off else account.tail(record.reach_s)))
    journal.end_pass(cycle, "interrupted")
    blocks = ", ".join(f"{first} to {end - 1}" for first, end in journal.uncertain(cycle))
    estimated = "" if remembered is not None else " (estimated: the robot has no record of this pass)"
    uncertain = f"uncertain: blocks {blocks}{estimated}" if blocks else "no block is uncertain"
    done = f"{journal.tally(cycle).done} of {record.blocks} blocks are recorded as executed"
    return f"pass {cycle} was interrupted: {done}; {uncertain}. None of them is run again"


def _take_over(journal: Journal, account: _Account, robot: RobotProgress, executed: list[ExecutedBlock]) -> None:
    """Journal the blocks that the robot reports; the tool is off once the actuator's watchdog must have lifted it."""
    record, unseen_s = account.record, account.unseen_s()
    end = record.contact_to if record.uncertain is None else record.uncertain[1]
    since_s = account.blocks.end_s[-1] if account.blocks.seq.size else 0.0  # without blocks unseen_s is infinite

    def off(seq: int, start_s: float) -> bool:
        return account.ended_off or not record.contact_from <= seq < end or start_s - since_s > unseen_s

    records = [BlockRecord(block, False if off(block.seq, block.start_s) else None) for block in executed]
    journal.reconcile(record.cycle, records)
    first = max(account.last_seq, executed[-1].seq if executed else -1) + 1
    if off(first, executed[-1].end_s if executed else since_s):
        journal.mark_uncertain(record.cycle, first, first)
    elif robot.state != "running":
        journal.mark_uncertain(record.cycle, first, first + 1)  # the robot stands in this one
    else:
        journal.mark_uncertain(record.cycle, first, max(first, min(end, account.tail(record.reach_s)[1])))


async def _read_back(cell: Cell, record: PassRecord, from_seq: int) -> tuple[RobotProgress, list[ExecutedBlock]] | None:
    """Return the robot's progress and the blocks that it executed from there on; None if the robot was restarted.

    Without a ``boot_id`` a restart cannot be excluded: the driver does not know the blocks that ran without a link, and
    a block that is not reported may have been executed.
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
                async with aclosing(cell.robot.executed(from_seq)) as executed:  # type: ignore[type-var]
                    async for block in executed:
                        blocks.append(block)
                        if block.seq >= progress.executed - 1:
                            break
            return progress, blocks
    except (DeviceError, TimeoutError):
        return None
