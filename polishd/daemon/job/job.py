"""Job: one part, one recipe, the estimates of the process, and the records of each cycle."""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from typing import Any, NamedTuple

from polishd.config.process_sections import LIMITS_OF_PROCESS
from polishd.daemon.contact.stall_removal import excess_map
from polishd.daemon.job import initial_estimates
from polishd.daemon.job.run_folder_writer import RunFolderWriter
from polishd.daemon.job.tool_sequence import ToolSequence, program_turn_of, tool_of
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord, MapRecord, PassRecord
from polishd.daemon.runtime.compute import Compute
from polishd.daemon.runtime.installed import installed_at_start, installed_now, require_same
from polishd.model import events
from polishd.model.devices import RobotProgress
from polishd.model.errors import PlanRefused, RemovalCheckStop, SafetyStop
from polishd.model.estimates import Diagnosis, Finding, FindingLimits, PassIndicators, PassSeries
from polishd.model.events import Event
from polishd.model.program import Envelope, Plan, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.acceptance import forecast_of
from polishd.pipeline.decisions import Decision, decide, small_gain_finding
from polishd.pipeline.disk_space import require_room
from polishd.pipeline.plan_figures import plan_figures
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import (
    ExecutedPass,
    LearnResult,
    MeasureResult,
    PlanResult,
    SolveResult,
    figures,
    made_ripple,
    record_of,
    tolerated_nm,
)
from polishd.pipeline.run_folder import RunFolder
from polishd.process.identification.findings import extend_series, findings
from polishd.process.metrology.conditioning import Masks
from polishd.process.metrology.resampling import Registration
from polishd.process.removal.contact import relative_removal
from polishd.process.removal.excess import ExcessMap
from polishd.process.robot.motion import executed_s

# Entries of a summary, one a cycle.


def cycle_entries(journal: Journal, *, several_tools: bool) -> list[dict[str, Any]]:
    """Return one entry a measurement. Values of the pass after it are None where there was none."""
    passes = {record.cycle: record for record in journal.passes}
    take_turns = any(program_turn_of(record.facts) for record in passes.values())
    return [
        _entry(journal, record, passes.get(record.cycle), several_tools=several_tools, take_turns=take_turns)
        for record in journal.history
    ]


def _entry(
    journal: Journal, measured: MapRecord, run: PassRecord | None, *, several_tools: bool, take_turns: bool
) -> dict[str, Any]:
    tool = {"tool": None if run is None else tool_of(run.facts)}
    turn = None if run is None else program_turn_of(run.facts)
    program = {"program": None if turn is None else turn.name}
    return {
        **figures(measured.stats, None if run is None else run.facts),
        "how": None if run is None else run.how or "begun",
        **(tool if several_tools else {}),
        **(program if take_turns else {}),
        "executed_s": None if run is None else journal.contact_s(run.cycle),
        "uncertain": None if run is None else [[a, end - 1] for a, end in journal.uncertain(run.cycle)],
        "found": [] if run is None else [one["what"] for one in run.facts.get("findings", ())],
        "notes": measured.stats.get("notes", []),
    }


# Statistics of passes over cycles, jobs and restarts. The indicators of each pass are in its row of the journal.

PROCESS = ("process.", "compliance.", "kinematics.", "roles.")
"""Sections of the config that define the process: rates of another process are not comparable."""
FAR_BACK = 8
"""Number of passes that are searched for the last one with indicators."""


def watch(journal: Journal, cycle: int, shown: PassIndicators, limits: FindingLimits) -> tuple[Finding, ...]:
    """Record the indicators of that cycle's pass, and return the findings that were not reported before.

    A pass is examined again where the cell was held after it and measures again: the operator knows its findings then.
    """
    (record,) = (one for one in journal.passes if one.cycle == cycle)
    earlier = [
        record_of(PassIndicators, one.facts["shown"])
        for one in journal.passes
        if one.cycle < cycle and "shown" in one.facts
    ]
    series = extend_series(_series(journal, cycle), shown)
    found = findings(series, [*earlier, shown], limits)
    reported = record.facts.get("findings", ())
    if any(one.stops == "cell" for one in found):
        series = PassSeries(series.process)  # the operator checks the tool: its new state is the reference
    new = tuple(one for one in found if one.kind not in {each["kind"] for each in reported})
    all_found = [*reported, *map(asdict, new)]
    journal.add_facts(cycle, {"shown": asdict(shown), "series": asdict(series), "findings": all_found})
    return new


def _series(journal: Journal, cycle: int) -> PassSeries:
    """Return the series up to the pass before, of any job; a new one where that pass had another process."""
    process = _process(journal.terms)
    last = next((facts["series"] for facts in journal.passes_before(cycle, FAR_BACK) if "series" in facts), None)
    if last is None or last["process"] != process:
        return PassSeries(process)
    return record_of(PassSeries, last)


def _process(terms: Mapping[str, Any] | None) -> str:
    """Return the id of the process in a job's terms."""
    known = (terms or {}).items()
    own = {key: value for key, value in known if key.startswith(PROCESS) and key not in LIMITS_OF_PROCESS}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()[:16]


PROGRESS_BLOCKS = 50
"""Blocks between two progress events."""

log = logging.getLogger(__name__)


class StoredArrays(NamedTuple):
    """Names in the array store: of the arrays of a plan, and of the start of the next solution."""

    plan: str = ""
    start: str = ""


@dataclass
class Job:
    """Steps of a cycle and their records; ``cycle.polish`` calls them in order."""

    tools: ToolSequence
    _: KW_ONLY
    journal: Journal
    folder: RunFolder
    compute: Compute
    publish: Callable[[Event], None]
    check_plan: Callable[[Plan, Envelope], Sequence[str]]
    max_cycles: int
    stream_ahead_s: float
    findings: tuple[Finding, ...] = field(init=False, default=())
    """New findings of the last pass."""
    _initial_notes: tuple[str, ...] = field(init=False, default=())
    """Notes on the source of the initial estimates."""
    _surfaces: dict[int, MeasureResult] = field(init=False, default_factory=dict)
    _planned: dict[int, PlanResult] = field(init=False, default_factory=dict)
    _stored: StoredArrays = field(init=False, default=StoredArrays())
    _masks: Masks | None = field(init=False, default=None)
    _lay: Registration | None = field(init=False, default=None)
    """Position of the part in the last map."""
    _blocks: int = field(init=False, default=0)
    handled: set[tuple[int, str]] = field(init=False, default_factory=set)
    """Cycles and steps of part handling that were done, or that the daemon requested from the operator."""

    writer: RunFolderWriter = field(init=False)
    """Writer of its run folder."""

    def __post_init__(self) -> None:
        self.writer = RunFolderWriter(self.folder, self.journal)

    @property
    def recipe(self) -> Recipe:
        """Recipe of the current tool."""
        return self.tools.now.recipe

    @property
    def program(self) -> Program:
        """Part program of the next pass, or of the pass under way."""
        return self.tools.now.program

    @property
    def tool(self) -> str:
        """Name of the current tool; empty where the cell has one tool."""
        return self.tools.now.tool

    async def load(self) -> None:
        """Load the state of an earlier run of the daemon: masks, estimates, last surface and last plan.

        Before the first pass, load the estimates of the last job of its series. ConfigError where a file that the
        journal names is missing from the store.
        """
        history, passes = self.journal.history, self.journal.passes
        self._initial_notes = await self.tools.load()
        if not history:
            return
        self._masks, self._lay = self._measured(history[0]).masks, self._measured(history[-1]).registration
        if passes:
            record = passes[-1]
            self.tools.take_of(record)
            planned = self._plan_of(record)
            self._surfaces = {found.cycle: self._measured(found) for found in history if found.cycle == record.cycle}
            self._planned = {record.cycle: planned}
            self.tools.update_estimates(planned.believed)
        await self.writer.remake()

    @property
    def last_cycle(self) -> int:
        """The cycle that only measures. Interrupted passes do not count."""
        return self.max_cycles + sum(record.how == "interrupted" for record in self.journal.passes)

    # measure

    async def measured(self, cycle: int, surface: SurfaceMap) -> MeasureResult:
        """Return the map on the process grid, and write it to the journal and the run folder."""
        made = made_ripple([record.facts for record in self.journal.passes])
        measured = await self.compute(steps.condition, self.recipe, surface, self._masks, self._lay, made)
        if not self.journal.passes:
            measured = replace(measured, notes=(*measured.notes, *self._initial_notes))
        files = await asyncio.to_thread(measured.files)
        arrays = await asyncio.to_thread(self.journal.arrays.put, files["surface.npz"])
        facts = {**measured.facts(), "run_dir": str(self.folder.path)}
        self.journal.record_map(cycle, surface.sha256, surface.path or "", facts, arrays)
        self._masks, self._lay = measured.masks, measured.registration
        folder = self.folder.cycle(cycle)
        await self.writer.keep(folder.map_file, surface)
        await self.writer.keep(folder.write, files)
        await self.writer.remake()
        stats, notes = measured.stats, list(measured.notes)
        values = {"spikes": measured.spikes, "judged": facts["judged"], "run_dir": facts["run_dir"]}
        self.publish(events.MapMeasured(cycle=cycle, stats=stats, notes=notes, **values))
        return measured

    # learn, solve, plan

    async def learn(self, cycle: int, surface: MeasureResult, again: tuple[Diagnosis, ...] | None = None) -> bool:
        """Compare the removal of the last complete pass with its prediction, and update the estimates.

        Return True where only another map can decide (`LearnResult.doubted`): the estimates do not change.
        ``again``: causes that such maps showed. RemovalCheckStop where the removal does not agree with the plan.
        """
        self.findings = ()
        before = self._surfaces.get(cycle - 1)  # after a hold the daemon measures the cycle again
        self._surfaces[cycle] = surface
        done = [record for record in self.journal.passes if record.cycle == cycle - 1 and record.how == "done"]
        if before is None or not done:
            return False
        self.tools.take_of(done[0])  # after a hold the next tool may be the current one
        times = await asyncio.to_thread(self._at_points, cycle - 1)
        planned = self._planned[cycle - 1]
        expected_nm = planned.certificate.predicted_rms_nm
        last = ExecutedPass(before, surface, planned.asked_s, *times, expected_nm, planned.forecast, again)
        taught: LearnResult = await self.compute(steps.learn, self.recipe, self.program, last, self.tools.estimates)
        if taught.doubted:
            return True
        folder = self.folder.cycle(cycle)
        await self.writer.keep(folder.write, await asyncio.to_thread(taught.files))
        if taught.verdict.stop:
            self.publish(events.RemovalCheckFailed(cycle=cycle, stop=taught.verdict.stop, cycle_dir=str(folder.path)))
            raise RemovalCheckStop(f"{taught.verdict.stop} (see {folder.path / 'gate.png'})")
        self.tools.update_estimates(taught.believed)
        self.journal.add_facts(cycle - 1, initial_estimates.facts(self.tools.terms, taught.believed))
        self.publish(events.EstimatesUpdated(cycle=cycle, notes=taught.notes, beliefs=taught.believed.facts()))
        if taught.shown is not None:
            self.findings = watch(self.journal, cycle - 1, taught.shown, self.recipe.finding)
            for found in self.findings:
                self.publish(events.FindingReported(cycle=cycle, kind=found.kind, what=found.what, stops=found.stops))
        return False

    def decide(self, cycle: int, surface: MeasureResult) -> Decision:
        """Decide what follows that cycle's measurement, after the update of the estimates."""
        torn = [record.cycle for record in self.journal.passes if record.how != "done"]
        since = max(torn, default=-1)  # an interrupted pass leaves a step on the surface, which is no divergence
        earlier = [tolerated_nm(record.stats) for record in self.journal.history[:-1] if record.cycle > since]
        return decide(self.recipe, earlier, surface, self.findings, self.last_cycle - cycle)

    async def solve(self, cycle: int, surface: MeasureResult) -> SolveResult:
        """Return the dwell with its certificate, and write it to the run folder."""
        last = self._planned.get(cycle - 1)
        turn = self.tools.now.turn
        # a warm start is of points and tool; with another program the solver starts anew
        warm = last.kept if last is not None and (last.tool, last.program) == (self.tool, turn) else None
        within = {"within_s": dwell_step.limit(self.recipe)}
        solved = await self.compute(dwell_step.solve_first, self.tools.to_solve(), surface, warm, **within)
        await self.writer.keep(self.folder.cycle(cycle).write, solved.files())
        self.publish(events.DwellSolved(cycle=cycle, certificate=solved.dwell.certificate))
        return solved

    async def plan(self, cycle: int, surface: MeasureResult, solved: SolveResult) -> Plan:
        """Return the rewritten program. Arrays for the next cycle go to the store, files to the run folder."""
        plan = await self.compute(steps.rewrite, self.recipe, self.program, solved, self.program.name)
        expected = await self.compute(forecast_of, self.recipe, surface, plan, solved.believed, solved.answer.acting)
        part, turn = steps.in_part_frame(self.recipe, plan.program), self.tools.now.turn
        planned = PlanResult.of(plan, solved, part, expected, self.tool, program=turn)
        figures = await asyncio.to_thread(plan_figures, self.recipe, surface, solved, plan, planned)
        planned = replace(planned, figures=figures.facts())
        files, store = await asyncio.to_thread(planned.files), self.journal.arrays
        names = [await asyncio.to_thread(store.put, arrays) for arrays in (files["plan.npz"], planned.start())]
        self._stored = StoredArrays(*names)
        self._planned[cycle] = planned
        await self.writer.keep(self.folder.cycle(cycle).write, {"program.rnc": plan.program.text, **files})
        return plan

    def approval_request(self, cycle: int, plan: Plan) -> events.PlanAwaitingApproval:
        """Return the event of a plan that waits, with its figures: the journal states what an operator approves."""
        planned = self._planned[cycle]
        return events.PlanAwaitingApproval(
            cycle=cycle,
            program_sha256=plan.program.sha256,
            program=_turn_name(planned),
            predicted_rms_nm=planned.predicted_rms_nm,
            dwell_s=plan.total_s,
            figures=planned.figures,
            plan=self._stored.plan,
        )

    def pass_not_worthwhile(self, cycle: int) -> bool:
        """Return whether the planned pass will hardly improve the surface, so that the job does not make it.

        False for a tool that other tools follow: their passes remove the rest.
        """
        if self.tools.left:
            return False
        if found := small_gain_finding(self.recipe, self._planned[cycle].forecast):
            self.publish(events.FindingReported(cycle=cycle, kind=found.kind, what=found.what, stops=found.stops))
        return found is not None

    async def refuse_unsafe(self, plan: Plan) -> None:
        """PlanRefused with every violation; HostFault where a disk is full or installed software changed."""
        await asyncio.to_thread(_refuse_unsafe, self, plan)  # checks read every block, and a disk may hang

    # run

    async def excess(self, plan: Plan) -> ExcessMap:
        """Return the limits of removal beyond that plan, for the robot's progress in contact."""
        turn = self.tools.now
        return await asyncio.to_thread(excess_map, turn.recipe, plan, turn.contact.excess_nm)

    @property
    def knows_overhead(self) -> bool:
        """The overhead of a block is an estimate from a pass, not the configured value."""
        return self.tools.estimates.block_overhead_s != self.recipe.envelope.block_overhead_s

    async def begin_pass(self, cycle: int, plan: Plan, robot: RobotProgress, reach_s: float) -> None:
        """Record the begin of the pass, durable before any motion. ``reach_s``: as of ``PassRecord``."""
        planned = self._planned[cycle]
        self._planned = {cycle: planned}  # earlier plans are not needed any more
        self._blocks = 0
        self.journal.begin_pass(
            cycle,
            plan.program.sha256,
            robot.boot_id,
            len(plan.segments),
            contact=(plan.approach_blocks, plan.contact_blocks),
            facts=planned.facts(),
            **self._stored._asdict(),
            reach_s=reach_s,
        )
        values = {"blocks": plan.contact_blocks, "dwell_s": plan.total_s, "forecast": planned.facts()["forecast"]}
        self.publish(events.PassStarted(cycle=cycle, tool=self.tool, program=_turn_name(planned), **values))

    def executed(self, cycle: int, records: Sequence[BlockRecord]) -> None:
        """Record blocks that the robot executed while the tool was on the part, or may have been."""
        self.journal.record_executed(cycle, records)
        before, self._blocks = self._blocks, self._blocks + len(records)
        if self._blocks // PROGRESS_BLOCKS > before // PROGRESS_BLOCKS:
            self.publish(events.PassProgressed(cycle=cycle, block=records[-1].block.seq + 1))

    async def end_pass(self, cycle: int) -> None:
        """Record the end of the pass: the tool is lifted and the robot at rest."""
        self.journal.end_pass(cycle, "done")
        await self.writer.executed(cycle)
        self.publish(events.PassEnded(cycle=cycle, executed_s=self.journal.contact_s(cycle)))

    async def cut_off(self, cycle: int) -> None:
        """Write ``executed.csv`` of an interrupted pass, unless the journal is lost."""
        with suppress(SafetyStop):
            await self.writer.executed(cycle)

    def executed_s(self, cycle: int) -> FloatArray:
        """(n,) executed process time of each timed point in that cycle's pass, s; 0 where it was not executed."""
        return self._at_points(cycle)[0]

    def _at_points(self, cycle: int) -> tuple[FloatArray, FloatArray]:
        """(n,) the same, s; and (n,) the same, weighted by the measured force and speed, s."""
        record = next((one for one in self.journal.passes if one.cycle == cycle), None)
        turn = self.tools.now if record is None else self.tools.of(record)
        planned = self._planned.get(cycle) or (self._plan_of(record) if record is not None and record.plan else None)
        blocks = self.journal.executed(cycle)
        # new times may have brought new lines: what ran are the blocks of the plan, not of the program before it
        point = turn.program.block if planned is None else planned.block
        run, seconds = blocks.possible, blocks.duration_s
        acting = seconds * relative_removal(turn.recipe.process, blocks.acting_n, blocks.rpm)
        return executed_s(point, blocks.seq[run], seconds[run]), executed_s(point, blocks.seq[run], acting[run])

    def names(self) -> dict[str, str]:
        """Return the ids of job and part."""
        return {"job": self.recipe.job.id, "part": self.recipe.part.id}

    def cycles(self) -> list[dict[str, Any]]:
        """Return one entry a measurement. Values of the pass after it are None where there was none."""
        return cycle_entries(self.journal, several_tools=bool(self.tool))

    def summary(self) -> dict[str, Any]:
        """Return the job's part of ``summary.json``."""
        return {**self.recipe.facts(), "cycles": self.cycles(), "phase_times_s": self.journal.phase_times_s()}

    def _measured(self, record: MapRecord) -> MeasureResult:
        instrument = self.recipe.instrument
        by = "none" if instrument is None else instrument.register_by
        return MeasureResult.load(self.journal.arrays.get(record.arrays), {"sha256": record.sha256, **record.stats}, by)

    def _plan_of(self, record: PassRecord) -> PlanResult:
        get = self.journal.arrays.get
        return PlanResult.load(get(record.plan), get(record.start), record.facts, self.recipe.model.beliefs)


def _turn_name(planned: PlanResult) -> str:
    return "" if planned.program is None else planned.program.name


def _refuse_unsafe(job: Job, plan: Plan) -> None:
    require_same(installed_at_start(), installed_now())
    found = [*steps.violations(job.recipe, plan), *job.check_plan(plan, job.recipe.envelope)]
    if found:
        raise PlanRefused("the plan was refused, nothing moved:\n" + "\n".join(f"  {line}" for line in found))
    require_room(job.journal.store.path.parent, job.folder.path, len(plan.segments), job.journal.done)
