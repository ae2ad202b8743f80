"""A job: one part, one recipe, what is believed of the process, and what each cycle leaves behind."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from polishd.daemon.compute import Compute
from polishd.daemon.journal import Journal
from polishd.daemon.journal_records import MapRecord, PassRecord
from polishd.daemon.safety import ContactLimits
from polishd.model import events
from polishd.model.devices import Executed, RobotProgress
from polishd.model.dwell import KeptStart
from polishd.model.errors import ConfigError, GateStop, PlanRefused
from polishd.model.events import Event
from polishd.model.limits import Envelope
from polishd.model.program import Plan, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.executed import executed_s
from polishd.process.registration.record import Registration
from polishd.recipe import dwell_step, steps
from polishd.recipe.folder import RunFolder
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import plan_arrays, save_plan, save_surface, save_verdict, surface_arrays
from polishd.recipe.steps import Beliefs, Measured, Solved, Taught

DIVERGED_RATIO, DIVERGED_NM = 1.3, 1.0
"""A surface that is worse than the best one so far by this ratio, and by more than noise and ripple, ends the job."""
PROGRESS_BLOCKS = 50
"""Blocks between two progress events; between them nobody else has a turn on the event loop."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan as the journal names it, and what the next cycle needs of it."""

    plan: str
    """Names in the array store: all its arrays, and what the next solve can start from."""
    start: str
    certificate: Mapping[str, Any]
    asked_s: FloatArray
    """(n,) time that it wrote into the program."""
    kept: KeptStart


class Job:
    """What the cycle asks and tells; see ``cycle.polish`` for the order in which it does."""

    def __init__(
        self,
        recipe: Recipe,
        program: Program,
        *,
        journal: Journal,
        folder: RunFolder,
        compute: Compute,
        publish: Callable[[Event], None],
        check_plan: Callable[[Plan, Envelope], Sequence[str]],
        contact: ContactLimits,
        max_cycles: int,
        lookahead_s: float,
    ) -> None:
        self.recipe = recipe
        self.contact = contact
        self.max_cycles = max_cycles
        self.lookahead_s = lookahead_s
        self._program = program
        self._journal = journal
        self._folder = folder
        self._compute = compute
        self._publish = publish
        self._check_plan = check_plan
        self._beliefs = Beliefs(block_overhead_s=recipe.envelope.block_overhead_s)
        self._surfaces: dict[int, Measured] = {}
        self._planned: dict[int, Planned] = {}
        self._masks: tuple[Any, Any] | None = None
        self._lay: Registration | None = None
        """Where the part lay in the last map."""
        self._blocks = 0

    async def load(self) -> None:
        """Take up what an earlier run of the daemon knew: masks, beliefs, last surface and last plan.

        ConfigError where the store has lost something that the journal names.
        """
        history, passes = self._journal.history, self._journal.passes
        if not history:
            return
        first, last = self._measured(history[0]), self._measured(history[-1])
        self._masks, self._lay = (first.solve_mask, first.metric_mask), last.registration
        if passes:
            record = passes[-1]
            self._surfaces = {found.cycle: self._measured(found) for found in history if found.cycle == record.cycle}
            self._planned = {record.cycle: self._plan_of(record)}
            self._beliefs = Beliefs(float(record.facts["rate"]), float(record.facts["block_overhead_s"]))
        await self._for_people(self._remake)

    @property
    def last_cycle(self) -> int:
        """The cycle that only measures: passes that were interrupted do not count as passes."""
        return self.max_cycles + sum(record.how == "interrupted" for record in self._journal.passes)

    # measure

    async def measured(self, cycle: int, surface: SurfaceMap) -> Measured:
        """The map on the process grid; journalled and kept in the run folder."""
        measured = await self._compute(steps.condition, self.recipe, surface, self._masks, self._lay)
        arrays = await asyncio.to_thread(self._journal.arrays.put, surface_arrays(measured))
        notes, run_dir = list(measured.notes), str(self._folder.path)
        told = events.Measured(cycle=cycle, stats=measured.stats, spikes=measured.spikes, notes=notes, run_dir=run_dir)
        self._journal.record_map(cycle, surface.sha256, surface.path or "", told.data, arrays)
        self._masks, self._lay = (measured.solve_mask, measured.metric_mask), measured.registration
        await self._for_people(save_surface, self._folder.cycle(cycle), surface, measured)
        await self._for_people(self._remake)
        self._publish(told)
        return measured

    def accepts(self, surface: Measured) -> bool:
        """Whether the figure is in tolerance, over the periods that the tolerance is for."""
        return _figure(asdict(surface.stats)) <= self.recipe.tolerance_nm

    def diverges(self, surface: Measured) -> bool:
        """Whether the surface is clearly worse than it has been."""
        torn = [record.cycle for record in self._journal.passes if record.how != "done"]
        since = max(torn, default=-1)  # a pass that was torn off leaves a step, which is nobody's divergence
        earlier = [_figure(record.stats) for record in self._journal.history[:-1] if record.cycle > since]
        if not earlier:
            return False
        best = min(earlier)
        return _figure(asdict(surface.stats)) > max(DIVERGED_RATIO * best, best + DIVERGED_NM)

    # learn, solve, plan

    async def learn(self, cycle: int, surface: Measured) -> None:
        """Compare what the last pass removed with what its executed dwell should have; not after an interruption."""
        before = self._surfaces.get(cycle - 1)  # after a hold a cycle is measured, and learned from, again
        self._surfaces[cycle] = surface
        done = [record for record in self._journal.passes if record.cycle == cycle - 1 and record.how == "done"]
        if before is None or not done:
            return
        executed = await asyncio.to_thread(self.executed_s, cycle - 1)
        times = (self._planned[cycle - 1].asked_s, executed)
        taught: Taught = await self._compute(
            steps.learn, self.recipe, self._program, (before, surface), times, self._beliefs
        )
        folder = self._folder.cycle(cycle)
        await self._for_people(save_verdict, folder, taught.verdict, surface)
        if taught.learned is None:
            self._publish(events.GateStopped(cycle=cycle, stop=taught.verdict.stop, cycle_dir=str(folder.path)))
            raise GateStop(f"{taught.verdict.stop} (see {folder.path / 'gate.png'})")
        self._beliefs = taught.beliefs
        learned = {"beliefs": asdict(self._beliefs), **asdict(taught.learned)}
        await self._for_people(folder.json, "learned.json", learned)
        beliefs = asdict(self._beliefs)
        self._publish(events.Learned(cycle=cycle, notes=beliefs.pop("notes"), beliefs=beliefs))

    async def solve(self, cycle: int, surface: Measured) -> Solved:
        """Dwell with a certificate, kept in the run folder whether it will be used or not."""
        solved = await self._compute(
            dwell_step.solve,
            self.recipe,
            self._program,
            surface,
            self._beliefs,
            self._planned[cycle - 1].kept if cycle - 1 in self._planned else None,
            within_s=dwell_step.limit(self.recipe),
        )
        await self._for_people(self._folder.cycle(cycle).json, "certificate.json", solved.dwell.certificate)
        self._publish(events.Solved(cycle=cycle, certificate=solved.dwell.certificate))
        return solved

    async def plan(self, cycle: int, solved: Solved) -> Plan:
        """The rewritten program; what the next cycle needs of it is kept for the journal, the rest for people."""
        plan = await self._compute(steps.rewrite, self.recipe, self._program, solved, self._program.name)
        store, dwell = self._journal.arrays, solved.dwell
        self._planned[cycle] = Planned(
            plan=await asyncio.to_thread(store.put, plan_arrays(self.recipe, plan, solved)),
            start=await asyncio.to_thread(store.put, {"time_s": dwell.time_s, **dwell.state}),
            certificate=asdict(dwell.certificate),
            asked_s=solved.asked_s,
            kept=KeptStart(dwell.time_s, dwell.state),
        )
        await self._for_people(save_plan, self._folder.cycle(cycle), self.recipe, plan, solved)
        return plan

    def refuse_unsafe(self, plan: Plan) -> None:
        """PlanRefused with every violation that a check found."""
        found = [*steps.violations(self.recipe, plan), *self._check_plan(plan, self.recipe.envelope)]
        if found:
            raise PlanRefused("the plan was refused, nothing moved:\n" + "\n".join(f"  {line}" for line in found))

    # run

    async def begin_pass(self, cycle: int, plan: Plan, robot: RobotProgress) -> None:
        """The intent, durable before anything moves."""
        planned = self._planned[cycle]
        self._planned = {cycle: planned}  # what came before is of no more use
        facts = {
            "certificate": planned.certificate,
            "predicted_rms_nm": planned.certificate["predicted_rms_nm"],
            "dwell_s": plan.total_s,
            "rate": self._beliefs.rate,
            "block_overhead_s": self._beliefs.block_overhead_s,
        }
        self._blocks = 0
        self._journal.begin_pass(
            cycle,
            plan.program.sha256,
            robot.boot_id,
            len(plan.segments),
            contact=(plan.approach_blocks, plan.contact_blocks),
            facts=facts,
            plan=planned.plan,
            start=planned.start,
        )
        self._publish(events.PassBegun(cycle=cycle, blocks=plan.contact_blocks, dwell_s=plan.total_s))

    async def executed(self, cycle: int, block: Executed) -> None:
        """One block was executed in contact. Where many are told at once, others have their turns meanwhile."""
        self._journal.executed_segment(cycle, block, contact=True)
        self._blocks += 1
        if self._blocks % PROGRESS_BLOCKS == 0:
            self._publish(events.Progress(cycle=cycle, block=block.seq + 1))
            await asyncio.sleep(0)

    async def end_pass(self, cycle: int) -> None:
        """The pass is over, tool lifted, robot at rest."""
        self._journal.end_pass(cycle, "done")
        await self._for_people(self._save_executed, cycle)
        self._publish(events.PassEnded(cycle=cycle, executed_s=self._journal.contact_s(cycle)))

    def executed_s(self, cycle: int) -> FloatArray:
        """(n,) process time that each timed point really had in that cycle's pass, s; 0 where it was not run."""
        blocks = self._journal.executed(cycle)
        return executed_s(self._program.block, blocks.seq[blocks.contact], blocks.duration_s[blocks.contact])

    def cycles(self) -> list[dict[str, Any]]:
        """One entry a measurement; what belongs to the pass after it is None where there was none."""
        passes = {record.cycle: record for record in self._journal.passes}
        return [
            {
                **{key: record.stats[key] for key in ("rms_nm", "pv_nm", "lsf_rms_nm", "band_rms_nm")},
                "how": (passes[record.cycle].how or "begun") if record.cycle in passes else None,
                **{key: _fact(passes.get(record.cycle), key) for key in ("predicted_rms_nm", "dwell_s", "rate")},
                "executed_s": self._journal.contact_s(record.cycle) if record.cycle in passes else None,
                "notes": record.stats.get("notes", []),
            }
            for record in self._journal.history
        ]

    def summary(self) -> dict[str, Any]:
        """The job's part of ``summary.json``."""
        return {
            "part_id": self.recipe.part_id,
            "correction": self.recipe.correction,
            "tolerance_nm": self.recipe.tolerance_nm,
            "tolerance_period_mm": self.recipe.tolerance_period_mm,
            "lsf_period_mm": self.recipe.lsf_period_mm,
            "cycles": self.cycles(),
        }

    def _measured(self, record: MapRecord) -> Measured:
        return steps.load_measured(self.recipe, self._journal.arrays.get(record.arrays), record.sha256)

    def _plan_of(self, record: PassRecord) -> Planned:
        store = self._journal.arrays
        start = store.get(record.start)
        kept = KeptStart(start.pop("time_s"), start)
        return Planned(record.plan, record.start, record.facts["certificate"], store.get(record.plan)["asked_s"], kept)

    async def _for_people(self, write: Callable[..., None], *arguments: Any) -> None:
        """Write to the run folder beside the event loop. What people cannot be left does not end a job."""
        try:
            await asyncio.to_thread(write, *arguments)
        except (OSError, ConfigError) as error:
            log.error("the run folder cannot be written: %s; the job goes on without", error)

    def _save_executed(self, cycle: int) -> None:
        blocks = self._journal.executed(cycle)
        columns = {"seq": blocks.seq, "start_s": blocks.start_s, "end_s": blocks.end_s, "contact": blocks.contact}
        self._folder.cycle(cycle).table("executed.csv", columns)

    def _remake(self) -> None:
        """Make anew what the report draws from, where somebody deleted it."""
        store = self._journal.arrays
        for found in self._journal.history:
            folder = self._folder.cycle(found.cycle)
            if not folder.holds("surface.npz"):
                folder.bytes("surface.npz", store.content(found.arrays))
        for record in self._journal.passes:
            folder = self._folder.cycle(record.cycle)
            if not folder.holds("plan.npz"):
                folder.bytes("plan.npz", store.content(record.plan))
                folder.json("certificate.json", record.facts["certificate"])
            if record.how == "done" and not folder.holds("executed.csv"):
                self._save_executed(record.cycle)


def _figure(stats: Mapping[str, Any]) -> float:
    band = stats["band_rms_nm"]
    return float(stats["rms_nm"] if band is None else band)


def _fact(record: Any, key: str) -> float | None:
    return None if record is None else float(record.facts[key])
