"""Part handling: clean, measure until the part has settled, condition the pad, change the tool, check the seat.

Only the touch-off is in contact. The tool rests on the part with at most 1 N and the spindle stands still, so that it
removes nothing (Preston: pressure times speed). The daemon monitors and leaves this contact like any other
(``safety.contact``).
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
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.force_check import ForceCheck
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
from polishd.model.events import Event, PlanApproved
from polishd.model.part_handling import HandlingStep, PartSeat, SettleRule, TouchOff
from polishd.model.program import Plan
from polishd.model.states import CyclePhase
from polishd.pipeline import part_handling, steps
from polishd.pipeline.part_handling import seat_of
from polishd.pipeline.records import MeasureResult
from polishd.process.identification import residual_diagnosis

# A command of the user as a step of the recipe: it runs in a new process group and has a time limit.

MAX_OUTPUT_CHARS = 400
"""Of the last line of its output, in a message."""


async def run_command(name: str, step: HandlingStep, environment: Mapping[str, str]) -> None:
    """Run a command to its end; HandlingError where it cannot be started, fails, or takes too long.

    Where the wait ends first, the command and all processes that it started are killed.
    """
    process = await _started(name, step, environment)
    done = False
    try:
        async with asyncio.timeout(step.timeout_s):
            output, _ = await process.communicate()
        done = True
    except TimeoutError:
        raise HandlingError(
            f"{name}: {step.command[0]} did not end within {step.timeout_s:g} s (part_handling.{name}.timeout_s) "
            "and was killed. Correct the cause, then run polishd resume: it repeats the command"
        ) from None
    finally:
        if not done:
            await _kill(process)
    if process.returncode:
        last = output.decode(errors="replace").strip().rpartition("\n")[2][-MAX_OUTPUT_CHARS:]
        raise HandlingError(
            f"{name}: {step.command[0]} ended with exit code {process.returncode}: {last or 'no output'}. Correct the "
            "cause, then run polishd resume: it repeats the command"
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
            f"{name}: {step.command[0]} cannot be started: {error}. Correct part_handling.{name}.command"
        ) from error
    except asyncio.CancelledError:
        await asyncio.wait({starting})  # it may run already, and asyncio does not kill the processes that it started
        if starting.exception() is None:
            await _kill(starting.result())
        raise


async def _kill(process: Process) -> None:
    """Kill it and all processes that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    await process.wait()


FORCE_BAND = 0.25
"""Of the touch-off: at 0.8 N at most 1 N acts."""
READINGS = 5
"""Number of position readings in the mean: 0.25 s."""


class PartHandling:
    """Steps of part handling. A checked seat stays valid until a step may have moved the part or the tool."""

    def __init__(self, cell: Cell, job: Job, journal: Journal) -> None:
        self._cell = cell
        self._job = job
        self._journal = journal
        self._seated = False

    async def clean(self, cycle: int) -> None:
        """Run the step between a pass and the next measurement. HandlingError where the operator has to do it."""
        await self._step(cycle, CyclePhase.CLEAN, self._job.recipe.part_handling.clean)

    async def settled(self, cycle: int, surface: MeasureResult) -> MeasureResult:
        """Measure until two maps in a row agree, and return the last one. PartNotSettled where none agree."""
        settle = self._job.recipe.part_handling.settle
        if settle is None:
            return surface
        async with self._journal.phase(cycle, CyclePhase.SETTLE):
            return await self._repeated(cycle, surface, settle)

    async def remeasure(self, cycle: int, surface: MeasureResult) -> tuple[MeasureResult, tuple[Diagnosis, ...]]:
        """Measure until two maps agree or do not come closer; return the last one, and the changes between the maps.

        The pass did not cause these changes. Where they exceed the tolerance: RemovalCheckStop for a mount that deforms
        the part differently each time, PartNotSettled for a part that still settles.
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
                notes = [one.words for one in moves] or [f"measured again: {maps} maps, the last two agree"]
                values = {"change_nm": changes[-1], "limit_nm": residual_diagnosis.LEAST_NM}
                job.publish(events.MapRepeated(cycle=cycle, maps=maps, notes=notes, **values))
                content = {"settled": not moves, **values, "change_nm": changes, "notes": notes}
                await job.writer.leave(cycle, "again.json", content)
                if not residual_diagnosis.is_settling(moves, last):
                    break
            if restless := steps.harmful_changes(job.recipe, moves):
                settling = all(one.cause == "settling" for one in restless)
                raise (PartNotSettled if settling else RemovalCheckStop)("; ".join(one.words for one in restless))
        return surface, residual_diagnosis.largest_of_each_cause(seen)

    async def ready(self, cycle: int) -> None:
        """Prepare tool, pad and seat for a pass; the links are up. HandlingError, WrongSeat: nothing was polished."""
        await self._change(cycle)
        await self._step(cycle, CyclePhase.CONDITION, self._job.recipe.part_handling.condition)
        touch_off = self._job.recipe.touch_off
        if touch_off is None or (self._seated and not touch_off.each_pass):
            return
        await before_contact(self._cell, self._job.publish, cycle)  # conditioning may have taken minutes
        async with self._journal.phase(cycle, CyclePhase.TOUCH_OFF):
            await self._touch_off(cycle, touch_off)
        self._seated = True

    async def _change(self, cycle: int) -> None:
        """Mount the current tool where another one, or an unknown one, is on the spindle; the touch-off follows.

        An operator who resumes has mounted it. A command that failed is repeated.
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
                request = f"mount the tool {tool!r}" + (f": {step.operator}" if step.operator else "")
                raise HandlingError(f"{CyclePhase.CHANGE}: {request}. Then run polishd resume")
            job.publish(events.ToolMounted(cycle=cycle, tool=tool, notes=[f"the tool {tool!r} is mounted"]))
            self._journal.flush()
        self._seated = False

    def _names(self, phase: CyclePhase, cycle: int) -> dict[str, str]:
        """Return the environment variables of a command."""
        part = {"POLISHD_PART": self._job.recipe.part.id, "POLISHD_JOB": self._job.recipe.job.id}
        return {"POLISHD_STEP": phase.value, **part, "POLISHD_CYCLE": str(cycle)}

    async def _step(self, cycle: int, phase: CyclePhase, step: HandlingStep | None) -> None:
        """Run a step between passes, once. An operator who resumes has done it; a command that failed is repeated."""
        job = self._job
        if step is None or not self._journal.passes or (cycle, phase) in job.handled:
            return
        async with self._journal.phase(cycle, phase):
            if step.operator:
                job.handled.add((cycle, phase))
                raise HandlingError(f"{phase}: {step.operator}. Then run polishd resume")
            await run_command(phase.value, step, self._names(phase, cycle))
            job.handled.add((cycle, phase))

    async def _repeated(self, cycle: int, surface: MeasureResult, settle: SettleRule) -> MeasureResult:
        job, limit_nm, changes = self._job, settle.limit_nm, list[float]()
        while len(changes) < settle.max_maps - 1:
            later = await self._another(cycle, len(changes), settle.wait_s)
            changes.append(await job.compute(steps.map_change_nm, job.recipe, surface, later))
            maps, agree = len(changes) + 1, changes[-1] <= limit_nm
            notes = [f"{'settled' if agree else 'not settled'}: {maps} maps, the last two {changes[-1]:.2f} nm apart"]
            values = {"change_nm": changes[-1], "limit_nm": limit_nm}
            job.publish(events.MapRepeated(cycle=cycle, maps=maps, notes=notes, **values))
            content = {"settled": agree, **values, "change_nm": changes, "notes": notes}
            await job.writer.leave(cycle, "settling.json", content)
            if agree:
                return later
            surface = later
        raise PartNotSettled(
            f"the part does not settle: it changed by {', '.join(f'{one:.2f}' for one in changes)} nm from map to map, "
            f"the limit is {limit_nm:.2f} nm (noise of the instrument). Look for a cause that warms or moves the part, "
            "or increase part_handling.settle.wait_s or maps"
        )

    async def _another(self, cycle: int, number: int, wait_s: float) -> MeasureResult:
        """Return a later map of the same cycle; the run folder keeps the one before under that number."""
        await self._cell.clock.sleep(wait_s)
        await self._job.writer.set_aside(cycle, number)
        surface = await next_map(self._cell, self._job.publish, cycle, self._journal.last_map_id)
        return await self._job.measured(cycle, surface)

    async def _touch_off(self, cycle: int, touch_off: TouchOff) -> None:
        job = self._job
        nominal_mm = touch_off.position_mm or self._cell.limits.actuator.stroke_mm / 2
        plans = await job.compute(part_handling.plans, job.recipe, touch_off)
        part_handling.require_allowed(job.recipe, plans, job.check_plan)
        contact_mm = [await self._contact_mm(touch_off, point, plan, nominal_mm) for point, plan in enumerate(plans)]
        seat = seat_of(touch_off, nominal_mm - np.array(contact_mm))
        facts, notes = facts_of(touch_off, seat), [] if seat.is_level else [f"the part sits {seat}"]
        job.publish(events.PartTouchedOff(cycle=cycle, seat=seat, max_offset_mm=touch_off.max_offset_mm, notes=notes))
        await job.writer.leave(cycle, "touch_off.json", {**facts, "notes": notes})
        if seat.worst_mm > touch_off.max_offset_mm:
            raise WrongSeat(_wrong(touch_off, seat))

    async def _contact_mm(self, touch_off: TouchOff, point: int, plan: Plan, nominal_mm: float) -> float:
        """Return the actuator's position in contact with the part at that point, mm."""
        cell, job = self._cell, self._job
        deepest_mm = nominal_mm + float(touch_off.reach_mm[point])
        limits = replace(
            job.tools.now.contact,
            force_n=touch_off.force_n,
            rpm=0.0,
            force_band=FORCE_BAND,
            deepest_mm=deepest_mm,
            force_max_n=touch_off.force_max_n,
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
            except WrongSeat as error:
                message, stays = _no_part(touch_off, point, str(error)), await self._stays(stream)
                if stays:
                    raise SeatNotLeft(f"{message}. The robot still stands at that point: {stays}") from error
                raise WrongSeat(message) from error
            await stream.retreat()
        return position_mm

    async def _position_mm(self, limits: ContactLimits, forces: ForceCheck) -> float:
        """Return the mean position of readings at the set force. Without that force the monitor ends the contact."""
        found: list[float] = []
        async with aclosing(self._cell.actuator.samples()) as samples:  # type: ignore[type-var]
            async for sample in samples:
                if sample.position_mm is None:
                    raise DeviceRefused(
                        "the actuator reports no position, which a touch-off needs. Remove [touch_off], or use another "
                        "actuator"
                    )
                if in_band(sample, limits) and (self._cell.force_sensor is None or forces.sensor_fits):
                    found.append(sample.position_mm)
                if len(found) == READINGS:
                    break
        return float(np.mean(found))

    async def _stays(self, stream: Stream) -> str:
        """Retreat the robot where the tool is confirmed to be up. Return why it stays; empty where it retreated."""
        if self._cell.unsafe:
            return "; ".join(self._cell.unsafe)
        try:
            await stream.retreat()
        except DeviceError as late:
            return str(late)
        return ""


def _no_block(_: Sequence[BlockRecord]) -> None:
    """The robot stands in contact: it executes no block."""


def facts_of(touch_off: TouchOff, seat: PartSeat) -> dict[str, object]:
    """Return the record of a touch-off in the run folder."""
    return {
        "seat": asdict(seat),
        "points_mm": touch_off.points_mm[:, :2].round(3).tolist(),
        "max_offset_mm": touch_off.max_offset_mm,
        "force_n": touch_off.force_n,
    }


def _wrong(touch_off: TouchOff, seat: PartSeat) -> str:
    offsets = "; ".join(
        f"{abs(off):.2f} mm too {'high' if off > 0 else 'low'} at x {x:.1f}, y {y:.1f} mm"
        for off, (x, y, _) in zip(seat.off_mm, touch_off.points_mm.tolist(), strict=True)
    )
    return (
        f"the part sits {seat} ({offsets}): up to {seat.worst_mm:.2f} mm off, at most {touch_off.max_offset_mm:g} mm "
        "(touch_off.max_offset_mm); nothing was polished. Clean the seat and seat the part again, or correct "
        "part.origin_mm, part.rotation_rpy_deg or touch_off.position_mm"
    )


def _no_part(touch_off: TouchOff, point: int, cause: str) -> str:
    x, y, _ = touch_off.points_mm[point].tolist()
    return (
        f"no part was found at x {x:.1f}, y {y:.1f} mm down to {touch_off.max_offset_mm:g} mm below its nominal height "
        f"({cause}): it is missing, or sits too low; nothing was polished. Seat the part, or correct part.origin_mm or "
        "touch_off.position_mm"
    )


# Confirmation before motion: a plan may run (``job.approve``), and the cell is clear (``on_start``).

FIRST_VALUE_S = 5.0
"""Longest wait for the first value of a signal, such as after its monitor connects again."""
LOOK_S = 0.1


async def until_approved(cell: Cell, job: Job, cycle: int, plan: Plan) -> None:
    """Wait until an operator approves this plan, where the job requires it. Nothing moves; commands end the wait."""
    if not job.recipe.job.approve:
        return
    job.publish(job.approval_request(cycle, plan))
    await cell.approval.until_given(plan.program.sha256)


async def approve(cell: Cell, publish: Callable[[Event], None], program_sha256: str, by: str = "") -> Mapping[str, Any]:
    """Approve this plan. DeviceRefused where it is not the waiting one, or the cell is not clear."""
    try:
        await require_clear(cell)
    except SignalFault as error:
        raise DeviceRefused(f"approve is refused: {error}") from error
    cell.approval.give(program_sha256)
    publish(PlanApproved(program_sha256=program_sha256, by=by))
    return {"approved": program_sha256}


async def require_clear(cell: Cell) -> None:
    """SignalFault where a signal does not have the value that a command to move requires (``on_start``)."""
    with suppress(TimeoutError):
        async with asyncio.timeout(FIRST_VALUE_S):
            while cell.signals.unknown_on_start():  # noqa: ASYNC110 - signals are heard, not asked
                await asyncio.sleep(LOOK_S)
    if wrong := cell.signals.wrong_on_start():
        raise SignalFault(f"{'; '.join(wrong)} at the start of motion. Make sure that no person is in the cell")
