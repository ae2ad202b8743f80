"""After an interrupted pass: what was done, what is uncertain, and that none of it is run again."""

from __future__ import annotations

import asyncio
from contextlib import aclosing

from polishd.daemon.cell import Cell
from polishd.daemon.journal import Journal
from polishd.model.devices import Executed
from polishd.model.errors import DeviceError

ASK_S = 3.0
"""Longest that asking the robot for what it remembers may take."""


async def settle(cell: Cell, journal: Journal) -> str:
    """Close the pass that was begun and never ended, with the robot's own account where it still has one.

    Returns what a person should know, empty where nothing was interrupted. Blocks that the robot executed without the
    daemon's record are uncertain: whether the tool was on the part is not known. They count as done once and are not
    run again; the next measurement is the ground truth.
    """
    journal.flush()
    interrupted = journal.unfinished()
    if interrupted is None:
        return ""
    tally, end = journal.tally(interrupted.cycle), interrupted.blocks - 1
    begin = tally.last_seq + 1
    remembered = await _remembered(cell, interrupted.program_sha256, interrupted.boot_id, begin)
    if remembered is None:
        uncertain = f"{begin} to {end} (the robot has forgotten them)"
    else:
        journal.reconcile(interrupted.cycle, remembered)
        uncertain = f"{begin} to {min(begin + len(remembered), end)}"
    journal.end_pass(interrupted.cycle, "interrupted")
    return (
        f"pass {interrupted.cycle} was interrupted: {tally.done} of {interrupted.blocks} blocks are recorded as "
        f"executed in contact; uncertain: blocks {uncertain}. None of them is run again"
    )


async def _remembered(cell: Cell, program_sha256: str, boot_id: str, from_seq: int) -> list[Executed] | None:
    """Blocks that the robot says it executed from there on, or None if it is not the same robot run."""
    try:
        async with asyncio.timeout(ASK_S):
            progress = await cell.robot.progress()
            if progress.boot_id != boot_id or progress.program_sha256 != program_sha256:
                return None
            blocks: list[Executed] = []
            if progress.executed > from_seq:
                async with aclosing(cell.robot.executed(from_seq)) as told:  # type: ignore[type-var]
                    async for block in told:
                        blocks.append(block)
                        if block.seq >= progress.executed - 1:
                            break
            return blocks
    except (DeviceError, TimeoutError):
        return None
