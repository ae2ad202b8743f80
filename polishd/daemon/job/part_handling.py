"""Beside polishing: the part is cleaned, measured until it has settled, its pad conditioned, and its seat proved.

All of it happens out of contact, but for the touch-off. There the tool rests on the part with at most 1 N and a spindle
that stands: what does not slide removes nothing, whatever it presses (Preston: pressure times speed). It is contact all
the same, watched and left like any other (``safety.contact``).
"""

from __future__ import annotations

import asyncio
import os
import signal
from asyncio.subprocess import Process
from collections.abc import Callable, Mapping, Sequence
from contextlib import aclosing, suppress
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.readiness import before_contact, require_robot
from polishd.daemon.contact.contact_record import ContactRecord, ForceCheck
from polishd.daemon.contact.safety import ContactLimits, contact, in_band
from polishd.daemon.contact.streaming import Stream, streaming
from polishd.daemon.job.job import Job
from polishd.daemon.job.map_wait import next_map
from polishd.daemon.job.tool_sequence import mounted
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model import events
from polishd.model.errors import (
    DeviceError,
    DeviceRefused,
    HandlingError,
    PartNotSettled,
    RemovalCheckStop,
    SeatNotLeft,
    SignalFault,
    WrongSeat,
)
from polishd.model.estimates import Diagnosis
from polishd.model.events import Event, PlanApproved, PlanAwaitingApproval
from polishd.model.part_handling import HandlingStep, PartSeat, SettleRule, TouchOff
from polishd.model.program import Plan
from polishd.model.states import CyclePhase
from polishd.pipeline import part_handling, steps
from polishd.pipeline.part_handling import seat_of
from polishd.pipeline.records import MeasureResult
from polishd.process.identification import residual_diagnosis

# A command of the user's, as a step of the recipe: run in a process group of its own, ended in time.

MOST_SAID = 400
"""Characters of its last line."""


async def run_command(name: str, step: HandlingStep, environment: Mapping[str, str]) -> None:
    """Run it to its end; HandlingError where it cannot be started, fails, or takes too long.

    Whatever ends the wait before its end, the command and all that it started are killed.
    """
    process = await _started(name, step, environment)
    done = False
    try:
        async with asyncio.timeout(step.timeout_s):
            said, _ = await process.communicate()
        done = True
    except TimeoutError:
        raise HandlingError(
            f"{name}: {step.command[0]} was not done after {step.timeout_s:g} s (part_handling.{name}.timeout_s), "
            "and was killed; see to it, then polishd resume runs it again"
        ) from None
    finally:
        if not done:
            await _kill(process)
    if process.returncode:
        last = said.decode(errors="replace").strip().rpartition("\n")[2][-MOST_SAID:]
        raise HandlingError(
            f"{name}: {step.command[0]} ended with {process.returncode}: {last or 'it said nothing'}; see to it, then "
            "polishd resume runs it again"
        )


async def _started(name: str, step: HandlingStep, environment: Mapping[str, str]) -> Process:
    starting = asyncio.ensure_future(
        asyncio.create_subprocess_exec(
            *step.command,
            cwd=step.folder,
            env={**os.environ, **environment},
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            start_new_session=True,
        )
    )
    try:
        return await asyncio.shield(starting)
    except (OSError, ValueError) as error:
        raise HandlingError(
            f"{name}: {step.command[0]}: cannot be run: {error}; mend part_handling.{name}.command"
        ) from error
    except asyncio.CancelledError:
        await asyncio.wait({starting})  # it may run already, and asyncio by itself would kill nothing that it started
        if starting.exception() is None:
            await _kill(starting.result())
        raise


async def _kill(process: Process) -> None:
    """With all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    await process.wait()


FORCE_BAND = 0.25
"""Of the touch-off: with 0.8 N no more than 1 N acts."""
READINGS = 5
"""Of the position, whose mean counts: 0.25 s."""


class PartHandling:
    """What one who polishes does besides. A seat once proved stays so until somebody may have touched the part."""

    def __init__(self, cell: Cell, job: Job, journal: Journal) -> None:
        self._cell = cell
        self._job = job
        self._journal = journal
        self._seated = False

    async def clean(self, cycle: int) -> None:
        """What comes between a pass and the next measurement. HandlingError where a person is to do it."""
        await self._step(cycle, CyclePhase.CLEAN, self._job.recipe.part_handling.clean)

    async def settled(self, cycle: int, surface: MeasureResult) -> MeasureResult:
        """The measurement that counts: maps are taken until two in a row agree. NotSettled where none do."""
        settle = self._job.recipe.part_handling.settle
        if settle is None:
            return surface
        async with self._journal.phase(cycle, CyclePhase.SETTLE):
            return await self._repeated(cycle, surface, settle)

    async def told_apart(self, cycle: int, surface: MeasureResult) -> tuple[MeasureResult, tuple[Diagnosis, ...]]:
        """Maps until two agree, or do not come nearer: the last one, and what changed, which is none of the pass.

        Where that is more than the tolerance bears: GateStop for a mount that prints through otherwise each time,
        NotSettled for a part that does not come to rest.
        """
        job, settle = self._job, self._job.recipe.part_handling.settle
        wait_s, earlier = (residual_diagnosis.WAIT_S, 0) if settle is None else (settle.wait_s, settle.max_maps)
        seen, moves, changes = list[Diagnosis](), tuple[Diagnosis, ...](), list[float]()
        async with self._journal.phase(cycle, CyclePhase.SETTLE):
            for maps in range(2, residual_diagnosis.MAPS + 2):
                later = await self._another(cycle, earlier + maps - 2, wait_s)
                last, moves = moves, await job.compute(steps.map_changes, job.recipe, surface, later)
                seen, surface = [*seen, *moves], later
                changes.append(max((one.size for one in moves), default=0.0))
                notes = [one.words for one in moves] or [f"measured again: {maps} maps, and the last two agree"]
                told = {"change_nm": changes[-1], "limit_nm": residual_diagnosis.LEAST_NM}
                job.publish(events.MapRepeated(cycle=cycle, maps=maps, notes=notes, **told))
                kept = {"settled": not moves, **told, "change_nm": changes, "notes": notes}
                await job.people.leave(cycle, "again.json", kept)
                if not residual_diagnosis.is_settling(moves, last):
                    break
            if restless := steps.harmful_changes(job.recipe, moves):
                settling = all(one.cause == "settling" for one in restless)
                raise (PartNotSettled if settling else RemovalCheckStop)("; ".join(one.words for one in restless))
        return surface, residual_diagnosis.largest_of_each_cause(seen)

    async def ready(self, cycle: int) -> None:
        """Tool, pad and seat, before a pass; the links are up. HandlingError, WrongSeat: nothing was polished."""
        await self._change(cycle)
        await self._step(cycle, CyclePhase.CONDITION, self._job.recipe.part_handling.condition)
        asked = self._job.recipe.touch_off
        if asked is None or (self._seated and not asked.each_pass):
            return
        await before_contact(self._cell, self._job.publish, cycle)  # conditioning may have taken minutes
        async with self._journal.phase(cycle, CyclePhase.TOUCH_OFF):
            await self._touch_off(cycle, asked)
        self._seated = True

    async def _change(self, cycle: int) -> None:
        """The tool whose turn it is comes onto the spindle, where it is not known to be there: then it is proved anew.

        Who resumes has mounted it; a command that failed is run again.
        """
        job, tool = self._job, self._job.tool
        if not tool or await asyncio.to_thread(mounted, self._journal) == tool:
            return
        step = job.recipe.part_handling.change
        async with self._journal.phase(cycle, CyclePhase.CHANGE):
            if step.command:
                await run_command(
                    CyclePhase.CHANGE.value, step, {**self._names(CyclePhase.CHANGE, cycle), "POLISHD_TOOL": tool}
                )
            elif (cycle, CyclePhase.CHANGE) not in job.handled:
                job.handled.add((cycle, CyclePhase.CHANGE))
                asked = f"mount the tool {tool!r}" + (f": {step.operator}" if step.operator else "")
                raise HandlingError(f"{CyclePhase.CHANGE}: {asked}; that done: polishd resume")
            job.publish(events.ToolMounted(cycle=cycle, tool=tool, notes=[f"the tool {tool!r} is mounted"]))
            self._journal.flush()
        self._seated = False

    def _names(self, phase: CyclePhase, cycle: int) -> dict[str, str]:
        """What a command hears in its environment."""
        part = {"POLISHD_PART": self._job.recipe.part.id, "POLISHD_JOB": self._job.recipe.job.id}
        return {"POLISHD_STEP": phase.value, **part, "POLISHD_CYCLE": str(cycle)}

    async def _step(self, cycle: int, phase: CyclePhase, step: HandlingStep | None) -> None:
        """Between passes only, and once: a person who resumes has done it, a command that failed is run again."""
        job = self._job
        if step is None or not self._journal.passes or (cycle, phase) in job.handled:
            return
        async with self._journal.phase(cycle, phase):
            if step.operator:
                job.handled.add((cycle, phase))
                raise HandlingError(f"{phase}: {step.operator}; that done: polishd resume")
            await run_command(phase.value, step, self._names(phase, cycle))
            job.handled.add((cycle, phase))

    async def _repeated(self, cycle: int, surface: MeasureResult, settle: SettleRule) -> MeasureResult:
        job, limit_nm, changes = self._job, settle.limit_nm, list[float]()
        while len(changes) < settle.max_maps - 1:
            later = await self._another(cycle, len(changes), settle.wait_s)
            changes.append(await job.compute(steps.map_change_nm, job.recipe, surface, later))
            maps, agree = len(changes) + 1, changes[-1] <= limit_nm
            notes = [f"{'settled' if agree else 'not settled'}: {maps} maps, the last two {changes[-1]:.2f} nm apart"]
            told = {"change_nm": changes[-1], "limit_nm": limit_nm}
            job.publish(events.MapRepeated(cycle=cycle, maps=maps, notes=notes, **told))
            await job.people.leave(
                cycle, "settling.json", {"settled": agree, **told, "change_nm": changes, "notes": notes}
            )
            if agree:
                return later
            surface = later
        raise PartNotSettled(
            f"the part does not settle: from map to map it changed by {', '.join(f'{one:.2f}' for one in changes)} nm; "
            f"{limit_nm:.2f} nm are the instrument's noise. To do: look for what warms or moves it; or give it more "
            "time, part_handling.settle.wait_s or maps"
        )

    async def _another(self, cycle: int, number: int, wait_s: float) -> MeasureResult:
        """A later map of the same cycle; the one before is set aside for people, under that number."""
        await self._cell.clock.sleep(wait_s)
        await self._job.people.set_aside(cycle, number)
        surface = await next_map(self._cell, self._job.publish, cycle, self._journal.last_map_id)
        return await self._job.measured(cycle, surface)

    async def _touch_off(self, cycle: int, asked: TouchOff) -> None:
        job = self._job
        meets_mm = asked.position_mm or self._cell.limits.actuator.stroke_mm / 2
        plans = await job.compute(part_handling.plans, job.recipe, asked)
        part_handling.require_allowed(job.recipe, plans, job.check_plan)
        met_mm = [await self._met(asked, place, plan, meets_mm) for place, plan in enumerate(plans)]
        seat = seat_of(asked, meets_mm - np.array(met_mm))
        facts, notes = facts_of(asked, seat), [] if seat.is_level else [f"the part sits {seat}"]
        job.publish(events.PartTouchedOff(cycle=cycle, seat=seat, max_offset_mm=asked.max_offset_mm, notes=notes))
        await job.people.leave(cycle, "touch_off.json", {**facts, "notes": notes})
        if seat.worst_mm > asked.max_offset_mm:
            raise WrongSeat(_wrong(asked, seat))

    async def _met(self, asked: TouchOff, place: int, plan: Plan, meets_mm: float) -> float:
        """The actuator's position, mm, where the tool met the part at that place."""
        cell, job = self._cell, self._job
        deepest_mm = meets_mm + float(asked.reach_mm[place])
        limits = replace(
            job.tools.now.contact,
            force_n=asked.force_n,
            rpm=0.0,
            force_band=FORCE_BAND,
            deepest_mm=deepest_mm,
            force_max_n=asked.force_max_n,
            force_max_key="touch_off.force_max_n",
        )
        least_s, ended = cell.limits.buffer_s, cell.ended
        feed = streaming(plan, cell.robot, cell.clock, job.stream_ahead_s, least_s=least_s, ended=ended)
        async with feed as stream:
            await require_robot(cell, limits.least_override)
            await stream.approach()
            try:
                async with contact(cell, limits, ContactRecord(_no_block, cell.limits.robot.silence_s)) as forces:
                    position_mm = await self._position_mm(limits, forces)
            except WrongSeat as nothing:
                said, stays = _nothing(asked, place, str(nothing)), await self._stays(stream)
                if stays:
                    raise SeatNotLeft(f"{said}. The robot stands at that place still: {stays}") from nothing
                raise WrongSeat(said) from nothing
            await stream.retreat()
        return position_mm

    async def _position_mm(self, limits: ContactLimits, forces: ForceCheck) -> float:
        """Of readings under the force asked for only; where that does not act, the watch ends the contact."""
        found: list[float] = []
        async with aclosing(self._cell.actuator.samples()) as samples:  # type: ignore[type-var]
            async for sample in samples:
                if sample.position_mm is None:
                    raise DeviceRefused(
                        "the actuator tells no position, and a touch-off needs one: leave [touch_off] out, or take "
                        "another actuator"
                    )
                if in_band(sample, limits) and (self._cell.force_sensor is None or forces.sensor_fits):
                    found.append(sample.position_mm)
                if len(found) == READINGS:
                    break
        return float(np.mean(found))

    async def _stays(self, stream: Stream) -> str:
        """The robot leaves the place too, where the tool is known to be up; why it does not, empty where it has."""
        if self._cell.unsafe:
            return "; ".join(self._cell.unsafe)
        try:
            await stream.retreat()
        except DeviceError as late:
            return str(late)
        return ""


def _no_block(_: Sequence[BlockRecord]) -> None:
    """The robot stands while the tool touches: there is none to record."""


def facts_of(asked: TouchOff, seat: PartSeat) -> dict[str, object]:
    """What the run folder keeps of a touch-off."""
    places = {
        "points_mm": asked.points_mm[:, :2].round(3).tolist(),
        "max_offset_mm": asked.max_offset_mm,
        "force_n": asked.force_n,
    }
    return {"seat": asdict(seat), **places}


def _wrong(asked: TouchOff, seat: PartSeat) -> str:
    met = "; ".join(
        f"{abs(off):.2f} mm too {'high' if off > 0 else 'low'} at x {x:.1f}, y {y:.1f} mm"
        for off, (x, y, _) in zip(seat.off_mm, asked.points_mm.tolist(), strict=True)
    )
    return (
        f"the part sits {seat} ({met}): up to {seat.worst_mm:.2f} mm off, at most {asked.max_offset_mm:g} mm "
        "(touch_off.max_offset_mm). Nothing was polished. To do: clean its seat and seat it again; or mend "
        "part.origin_mm, part.rotation_rpy_deg or touch_off.position_mm"
    )


def _nothing(asked: TouchOff, place: int, said: str) -> str:
    x, y, _ = asked.points_mm[place].tolist()
    return (
        f"no part was found at x {x:.1f}, y {y:.1f} mm down to {asked.max_offset_mm:g} mm below where it should be "
        f"({said}): it is missing, or sits too low. Nothing was polished. To do: seat it; or mend part.origin_mm or "
        "touch_off.position_mm"
    )


# A person's word before motion: that a plan may run (``job.approve``), and that the cell is clear (``on_start``).

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
    """SignalFault where a signal is not what it must be when a person orders motion (``on_start``)."""
    with suppress(TimeoutError):
        async with asyncio.timeout(TOLD_S):
            while cell.signals.untold_on_order():  # noqa: ASYNC110 - signals are heard, not asked
                await asyncio.sleep(LOOK_S)
    if wrong := cell.signals.wrong_on_order():
        raise SignalFault(f"{'; '.join(wrong)} when motion is ordered: see that nobody is in the cell's reach")
