"""A job: one part, one recipe, what is believed of the process, and what each cycle leaves behind."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, NamedTuple

from polishd.daemon.compute import Compute
from polishd.daemon.journal import Journal
from polishd.daemon.journal_records import MapRecord, PassRecord
from polishd.daemon.safety import ContactLimits
from polishd.model import events
from polishd.model.devices import Executed, RobotProgress
from polishd.model.errors import ConfigError, GateStop, PlanRefused
from polishd.model.events import Event
from polishd.model.limits import Envelope
from polishd.model.program import Plan, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.conditioning import Masks
from polishd.process.executed import executed_s
from polishd.process.registration.record import Registration
from polishd.recipe import dwell_step, steps
from polishd.recipe.encoding import table
from polishd.recipe.folder import RunFolder
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import Believed, Measured, Pass, Planned, Solved, Taught, figures, tolerated_nm

DIVERGED_RATIO, DIVERGED_NM = 1.3, 1.0
"""A surface that is worse than the best one so far by this ratio, and by more than noise and ripple, ends the job."""
PROGRESS_BLOCKS = 50
"""Blocks between two progress events; between them nobody else has a turn on the event loop."""

log = logging.getLogger(__name__)


class Stored(NamedTuple):
    """Names in the array store: of a plan's arrays, and of what the next solve can start from."""

    plan: str = ""
    start: str = ""


@dataclass
class Job:
    """What the cycle asks and tells; see ``cycle.polish`` for the order in which it does."""

    recipe: Recipe
    program: Program
    _: KW_ONLY
    journal: Journal
    folder: RunFolder
    compute: Compute
    publish: Callable[[Event], None]
    check_plan: Callable[[Plan, Envelope], Sequence[str]]
    contact: ContactLimits
    max_cycles: int
    lookahead_s: float
    _believed: Believed = field(init=False)
    _surfaces: dict[int, Measured] = field(init=False, default_factory=dict)
    _planned: dict[int, Planned] = field(init=False, default_factory=dict)
    _stored: Stored = field(init=False, default=Stored())
    _masks: Masks | None = field(init=False, default=None)
    _lay: Registration | None = field(init=False, default=None)
    """Where the part lay in the last map."""
    _blocks: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._believed = steps.believed_at_first(self.recipe)

    async def load(self) -> None:
        """Take up what an earlier run of the daemon knew: masks, beliefs, last surface and last plan.

        ConfigError where the store has lost something that the journal names.
        """
        history, passes = self.journal.history, self.journal.passes
        if not history:
            return
        self._masks, self._lay = self._measured(history[0]).masks, self._measured(history[-1]).registration
        if passes:
            record = passes[-1]
            planned = self._plan_of(record)
            self._surfaces = {found.cycle: self._measured(found) for found in history if found.cycle == record.cycle}
            self._planned, self._believed = {record.cycle: planned}, planned.believed
        await self._for_people(self._remake)

    @property
    def last_cycle(self) -> int:
        """The cycle that only measures: passes that were interrupted do not count as passes."""
        return self.max_cycles + sum(record.how == "interrupted" for record in self.journal.passes)

    # measure

    async def measured(self, cycle: int, surface: SurfaceMap) -> Measured:
        """The map on the process grid; journalled and kept in the run folder."""
        measured = await self.compute(steps.condition, self.recipe, surface, self._masks, self._lay)
        files = await asyncio.to_thread(measured.files)
        arrays = await asyncio.to_thread(self.journal.arrays.put, files["surface.npz"])
        facts = {**measured.facts(), "run_dir": str(self.folder.path)}
        self.journal.record_map(cycle, surface.sha256, surface.path or "", facts, arrays)
        self._masks, self._lay = measured.masks, measured.registration
        folder = self.folder.cycle(cycle)
        await self._for_people(folder.map_file, surface)
        await self._for_people(folder.write, files)
        await self._for_people(self._remake)
        stats, notes = measured.stats, list(measured.notes)
        told = {"spikes": measured.spikes, "run_dir": facts["run_dir"]}
        self.publish(events.Measured(cycle=cycle, stats=stats, notes=notes, **told))
        return measured

    def accepts(self, surface: Measured) -> bool:
        """Whether the figure is in tolerance, over the periods that the tolerance is for."""
        return surface.figure_nm <= self.recipe.job.tolerance_nm

    def diverges(self, surface: Measured) -> bool:
        """Whether the surface is clearly worse than it has been."""
        torn = [record.cycle for record in self.journal.passes if record.how != "done"]
        since = max(torn, default=-1)  # a pass that was torn off leaves a step, which is nobody's divergence
        earlier = [tolerated_nm(record.stats) for record in self.journal.history[:-1] if record.cycle > since]
        if not earlier:
            return False
        best = min(earlier)
        return surface.figure_nm > max(DIVERGED_RATIO * best, best + DIVERGED_NM)

    # learn, solve, plan

    async def learn(self, cycle: int, surface: Measured) -> None:
        """Compare what the last pass removed with what its executed dwell should have; not after an interruption."""
        before = self._surfaces.get(cycle - 1)  # after a hold a cycle is measured, and learned from, again
        self._surfaces[cycle] = surface
        done = [record for record in self.journal.passes if record.cycle == cycle - 1 and record.how == "done"]
        if before is None or not done:
            return
        executed = await asyncio.to_thread(self.executed_s, cycle - 1)
        last = Pass(before, surface, self._planned[cycle - 1].asked_s, executed)
        taught: Taught = await self.compute(steps.learn, self.recipe, self.program, last, self._believed)
        folder = self.folder.cycle(cycle)
        await self._for_people(folder.write, await asyncio.to_thread(taught.files))
        if taught.verdict.stop:
            self.publish(events.GateStopped(cycle=cycle, stop=taught.verdict.stop, cycle_dir=str(folder.path)))
            raise GateStop(f"{taught.verdict.stop} (see {folder.path / 'gate.png'})")
        self._believed = taught.believed
        self.publish(events.Learned(cycle=cycle, notes=taught.notes, beliefs=self._believed.facts()))

    async def solve(self, cycle: int, surface: Measured) -> Solved:
        """Dwell with a certificate, kept in the run folder whether it will be used or not."""
        solved = await self.compute(
            dwell_step.solve,
            self.recipe,
            self.program,
            surface,
            self._believed,
            self._planned[cycle - 1].kept if cycle - 1 in self._planned else None,
            within_s=dwell_step.limit(self.recipe),
        )
        await self._for_people(self.folder.cycle(cycle).write, solved.files())
        self.publish(events.Solved(cycle=cycle, certificate=solved.dwell.certificate))
        return solved

    async def plan(self, cycle: int, solved: Solved) -> Plan:
        """The rewritten program; what the next cycle needs of it is kept for the journal, the rest for people."""
        plan = await self.compute(steps.rewrite, self.recipe, self.program, solved, self.program.name)
        planned = Planned.of(plan, solved, steps.in_part_frame(self.recipe, plan.program))
        files, store = await asyncio.to_thread(planned.files), self.journal.arrays
        names = [await asyncio.to_thread(store.put, arrays) for arrays in (files["plan.npz"], planned.start())]
        self._stored = Stored(*names)
        self._planned[cycle] = planned
        await self._for_people(self.folder.cycle(cycle).write, {"program.rnc": plan.program.text, **files})
        return plan

    def refuse_unsafe(self, plan: Plan) -> None:
        """PlanRefused with every violation that a check found."""
        found = [*steps.violations(self.recipe, plan), *self.check_plan(plan, self.recipe.envelope)]
        if found:
            raise PlanRefused("the plan was refused, nothing moved:\n" + "\n".join(f"  {line}" for line in found))

    # run

    async def begin_pass(self, cycle: int, plan: Plan, robot: RobotProgress) -> None:
        """The intent, durable before anything moves."""
        planned = self._planned[cycle]
        self._planned = {cycle: planned}  # what came before is of no more use
        self._blocks = 0
        self.journal.begin_pass(
            cycle,
            plan.program.sha256,
            robot.boot_id,
            len(plan.segments),
            contact=(plan.approach_blocks, plan.contact_blocks),
            facts=planned.facts(),
            **self._stored._asdict(),
        )
        self.publish(events.PassBegun(cycle=cycle, blocks=plan.contact_blocks, dwell_s=plan.total_s))

    async def executed(self, cycle: int, block: Executed) -> None:
        """One block was executed in contact. Where many are told at once, others have their turns meanwhile."""
        self.journal.executed_segment(cycle, block, contact=True)
        self._blocks += 1
        if self._blocks % PROGRESS_BLOCKS == 0:
            self.publish(events.Progress(cycle=cycle, block=block.seq + 1))
            await asyncio.sleep(0)

    async def end_pass(self, cycle: int) -> None:
        """The pass is over, tool lifted, robot at rest."""
        self.journal.end_pass(cycle, "done")
        await self._for_people(self._save_executed, cycle)
        self.publish(events.PassEnded(cycle=cycle, executed_s=self.journal.contact_s(cycle)))

    def executed_s(self, cycle: int) -> FloatArray:
        """(n,) process time that each timed point really had in that cycle's pass, s; 0 where it was not run."""
        blocks = self.journal.executed(cycle)
        return executed_s(self.program.block, blocks.seq[blocks.contact], blocks.duration_s[blocks.contact])

    def names(self) -> dict[str, str]:
        """Of job and part."""
        return {"job": self.recipe.job.id, "part": self.recipe.part.id}

    def cycles(self) -> list[dict[str, Any]]:
        """One entry a measurement; what belongs to the pass after it is None where there was none."""
        passes = {record.cycle: record for record in self.journal.passes}
        return [self._entry(record, passes.get(record.cycle)) for record in self.journal.history]

    def _entry(self, measured: MapRecord, run: PassRecord | None) -> dict[str, Any]:
        return {
            **figures(measured.stats, None if run is None else run.facts),
            "how": None if run is None else run.how or "begun",
            "executed_s": None if run is None else self.journal.contact_s(run.cycle),
            "notes": measured.stats.get("notes", []),
        }

    def summary(self) -> dict[str, Any]:
        """The job's part of ``summary.json``."""
        return {**self.recipe.facts(), "cycles": self.cycles()}

    def _measured(self, record: MapRecord) -> Measured:
        instrument = self.recipe.instrument
        by = "none" if instrument is None else instrument.register_by
        return Measured.load(self.journal.arrays.get(record.arrays), {"sha256": record.sha256, **record.stats}, by)

    def _plan_of(self, record: PassRecord) -> Planned:
        get = self.journal.arrays.get
        return Planned.load(get(record.plan), get(record.start), record.facts, self.recipe.model.beliefs)

    async def _for_people(self, write: Callable[..., None], *arguments: Any) -> None:
        """Write to the run folder beside the event loop. What people cannot be left does not end a job."""
        try:
            await asyncio.to_thread(write, *arguments)
        except (OSError, ConfigError) as error:
            log.error("the run folder cannot be written: %s; the job goes on without", error)

    def _save_executed(self, cycle: int) -> None:
        blocks = self.journal.executed(cycle)
        columns = {"seq": blocks.seq, "start_s": blocks.start_s, "end_s": blocks.end_s, "contact": blocks.contact}
        self.folder.cycle(cycle).bytes("executed.csv", table(columns))

    def _remake(self) -> None:
        """Make anew what the report draws from, where somebody deleted it."""
        store = self.journal.arrays
        for found in self.journal.history:
            folder = self.folder.cycle(found.cycle)
            if not folder.holds("surface.npz"):
                folder.bytes("surface.npz", store.content(found.arrays))
        for record in self.journal.passes:
            folder = self.folder.cycle(record.cycle)
            if not folder.holds("plan.npz"):
                folder.bytes("plan.npz", store.content(record.plan))
                folder.json("certificate.json", record.facts["certificate"])
            if record.how == "done" and not folder.holds("executed.csv"):
                self._save_executed(record.cycle)
