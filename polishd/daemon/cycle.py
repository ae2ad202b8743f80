"""The cycle: measure, learn, solve, plan, run; in time order from top to bottom."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from functools import partial

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.readiness import before_contact, require_robot
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.progress import ProgressLimits
from polishd.daemon.contact.safety import contact, reraise_after_safe
from polishd.daemon.contact.streaming import Stream, recording, streaming
from polishd.daemon.job.job import Job
from polishd.daemon.job.map_wait import next_map
from polishd.daemon.job.part_handling import PartHandling, until_approved
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import PlanRefused, ToolStop
from polishd.model.program import Plan
from polishd.model.states import CyclePhase, Outcome
from polishd.pipeline.decisions import Accept, AnotherPass, Diverge, PassesUsed, Stalled, ToolWorn, passes_used
from polishd.pipeline.dwell_step import require_certificate
from polishd.process.removal.excess import ExcessMap


async def polish(cell: Cell, job: Job, journal: Journal) -> Outcome:
    """Run cycles until the part is in tolerance, all passes are used, or a pass improves too little or harms.

    Returns with the tool lifted and the robot standing still. Raises PolishdError, with the cell equally safe, if a
    map, a plan, a device or a computation is refused.
    """
    handling = PartHandling(cell, job, journal)
    for cycle in journal.remaining(job.last_cycle + 1):  # one measurement more than passes
        await handling.clean(cycle)
        async with journal.phase(cycle, CyclePhase.MEASURE):
            surface = await job.measured(cycle, await next_map(cell, job.publish, cycle, journal.last_map_id))
        surface = await handling.settled(cycle, surface)
        async with journal.phase(cycle, CyclePhase.LEARN):
            doubted = await job.learn(cycle, surface)  # first: a map that fails the removal check is not used
        if doubted:  # its low orders may not come from the pass
            surface, again = await handling.remeasure(cycle, surface)
            async with journal.phase(cycle, CyclePhase.LEARN):
                await job.learn(cycle, surface, again)
        job.tools.take()  # of several tools
        match job.decide(cycle, surface):
            case ToolWorn(why):
                raise ToolStop(why)
            case Accept() | Diverge() | Stalled() | PassesUsed() as decision:
                return decision.outcome
            case AnotherPass():
                pass
        async with journal.phase(cycle, CyclePhase.SOLVE):
            solved = await job.solve(cycle, surface)
            require_certificate(solved.dwell.certificate, job.recipe)
        async with journal.phase(cycle, CyclePhase.PLAN):
            plan = await job.plan(cycle, surface, solved)
            await job.refuse_unsafe(plan)
        if job.pass_not_worthwhile(cycle):
            return Outcome.STALLED
        await until_approved(cell, job, cycle, plan)
        await before_contact(cell, job.publish, cycle)
        await handling.ready(cycle)  # tool, pad and seat: no force on a part that is not seated correctly
        await before_contact(cell, job.publish, cycle)  # the steps between may have taken minutes
        excess = await job.excess(plan)
        async with journal.phase(cycle, CyclePhase.RUN), _fed(cell, job, plan, excess) as stream:
            await require_robot(cell, job.tools.now.contact.least_override)
            await job.begin_pass(cycle, plan, await cell.robot.progress(), cell.limits.unseen_s)
            # the next cycle uses the executed blocks, not the planned ones
            touch = ContactRecord(partial(job.executed, cycle), cell.limits.robot.silence_s)
            try:
                async with recording(cell, journal, cycle, touch) as recorder:
                    await stream.approach()
                    with short_collections():
                        async with contact(cell, job.tools.now.contact, touch):
                            await recorder.follow(stream)
                await stream.retreat()
            except BaseException as error:
                with reraise_after_safe(error):
                    await job.cut_off(cycle)
                raise
            await job.end_pass(cycle)
    return passes_used(job.recipe).outcome


def _fed(cell: Cell, job: Job, plan: Plan, excess: ExcessMap) -> AbstractAsyncContextManager[Stream]:
    """Stream the plan to the robot; its progress goes to the cell's live values."""
    limits = job.tools.now.contact
    held = cell.limits.held_motion(plan.program.encoding, plan.expected_time_s)
    if held is not None and not held.holds:
        raise PlanRefused(
            f"{held.what} take only {held.seconds:.3f} s; {held.least_s:.3f} s are needed to lift the tool. "
            "Increase machine.least_point_s; nothing was moved."
        )
    return streaming(
        plan,
        cell.robot,
        cell.clock,
        job.stream_ahead_s,
        least_s=cell.limits.buffer_s,
        on_progress=cell.robot_reported,
        ended=cell.ended,
        limits=ProgressLimits.of(
            cell.limits, limits.least_override, limits.no_progress_s, knows_overhead=job.knows_overhead
        ),
        excess=excess,
    )


_in_contact: set[object] = set()
"""A token for each pass of this process: all its cells share one garbage collector."""


@contextmanager
def short_collections() -> Iterator[None]:
    """Exclude the present objects from garbage collection inside: with a plan of 100,000 blocks one would take 50 ms.

    Garbage that exists already is frozen as well and is collected when the job ends.
    """
    this = object()
    _in_contact.add(this)
    gc.freeze()
    try:
        yield
    finally:
        _in_contact.discard(this)
        if not _in_contact:
            gc.unfreeze()
