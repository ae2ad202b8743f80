"""A person's word before motion: that a plan may run (``job.approve``), and that the cell is clear (``on_order``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from polishd.daemon.cell import Cell
from polishd.daemon.job import Job
from polishd.model.errors import DeviceRefused, SignalFault
from polishd.model.events import Event, PlanApproved, PlanAwaitingApproval
from polishd.model.program import Plan

TOLD_S = 5.0
"""For so long a signal is waited for that nobody has told yet: its monitor's link was just opened again, say."""
LOOK_S = 0.1


async def until_approved(cell: Cell, job: Job, cycle: int, plan: Plan, left_nm: float) -> None:
    """Where the job wants it: a person has said that this plan may run. Nothing moves before; orders end the wait.

    ``left_nm``: RMS that it is to leave.
    """
    if not job.recipe.job.approve:
        return
    job.publish(
        PlanAwaitingApproval(
            cycle=cycle, program_sha256=plan.program.sha256, predicted_rms_nm=left_nm, dwell_s=plan.total_s
        )
    )
    await cell.approval.until_given(plan.program.sha256)


async def approve(cell: Cell, publish: Callable[[Event], None], program_sha256: str, by: str = "") -> Mapping[str, Any]:
    """Say that this plan may run. DeviceRefused where it is not what waits, or the cell is not clear."""
    try:
        await require_clear(cell)
    except SignalFault as error:
        raise DeviceRefused(f"approve is refused: {error}") from error
    cell.approval.give(program_sha256)
    publish(PlanApproved(program_sha256=program_sha256, by=by))
    return {"approved": program_sha256}


async def require_clear(cell: Cell) -> None:
    """SignalFault where a signal is not what it must be when a person orders motion (``on_order``)."""
    with suppress(TimeoutError):
        async with asyncio.timeout(TOLD_S):
            while cell.signals.untold_on_order():  # noqa: ASYNC110 - signals are heard, not asked
                await asyncio.sleep(LOOK_S)
    if wrong := cell.signals.wrong_on_order():
        raise SignalFault(f"{'; '.join(wrong)} when motion is ordered: see that nobody is in the cell's reach")
