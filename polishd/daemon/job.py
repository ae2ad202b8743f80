"""A job: one part, one recipe, what is believed of the process, and what each cycle leaves behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from polishd.daemon import dwell_step, steps
from polishd.daemon.compute import Compute
from polishd.daemon.journal import Journal
from polishd.daemon.recipe import Recipe
from polishd.daemon.run_folder import RunFolder
from polishd.daemon.safety import ContactLimits
from polishd.daemon.steps import Beliefs, Measured, Solved, Taught
from polishd.model.cycle import Event
from polishd.model.devices import Executed, RobotProgress
from polishd.model.dwell import Certificate, KeptStart
from polishd.model.errors import ComputeError, PlanRefused
from polishd.model.limits import Envelope
from polishd.model.program import Plan, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.gate import Verdict
from polishd.process.registration.record import Registration

DIVERGED_RATIO, DIVERGED_NM = 1.3, 1.0
"""A surface that is worse than the best one so far by this ratio, and by more than noise and ripple, ends the job."""
START = "start.npz"
"""What a cycle's solution leaves for the next solve to start from."""
PROGRESS_BLOCKS = 50
"""Blocks between two progress events."""


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
        self._masks: tuple[Any, Any] | None = None
        self._lay: Registration | None = None
        """Where the part lay in the last map."""
        self._blocks = 0
        self._restore()

    @property
    def last_cycle(self) -> int:
        """The cycle that only measures: passes that were interrupted do not count as passes."""
        return self.max_cycles + sum(record.how == "interrupted" for record in self._journal.passes)

    # measure

    async def measured(self, cycle: int, surface: SurfaceMap) -> Measured:
        """The map on the process grid; journalled and kept in the run folder."""
        measured = await self._compute(steps.condition, self.recipe, surface, self._masks, self._lay)
        self._masks, self._lay = (measured.solve_mask, measured.metric_mask), measured.registration
        save_surface(self._folder.cycle(cycle), surface, measured)
        stats = {**asdict(measured.stats), "spikes": measured.spikes, "run_dir": str(self._folder.path)}
        self._journal.record_map(cycle, surface.sha256, surface.path or "", stats)
        self._publish(Event("measured", cycle, stats))
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
        asked = self._folder.cycle(cycle - 1).load_arrays("plan.npz")["asked_s"]
        executed = self.executed_s(cycle - 1)
        taught: Taught = await self._compute(
            steps.learn, self.recipe, self._program, (before, surface), (asked, executed), self._beliefs
        )
        folder = self._folder.cycle(cycle)
        save_verdict(folder, taught.verdict, surface)
        if taught.learned is None:
            self._publish(Event("gate_stopped", cycle, {"stop": taught.verdict.stop, "cycle_dir": str(folder.path)}))
            raise ComputeError(f"{taught.verdict.stop} (see {folder.path / 'gate.png'})")
        self._beliefs = taught.beliefs
        folder.json("learned.json", {"beliefs": asdict(self._beliefs), **asdict(taught.learned)})
        self._publish(Event("learned", cycle, asdict(self._beliefs)))

    async def solve(self, cycle: int, surface: Measured) -> Solved:
        """Dwell with a certificate, kept in the run folder whether it will be used or not."""
        solved = await self._compute(
            dwell_step.solve,
            self.recipe,
            self._program,
            surface,
            self._beliefs,
            self._kept_start(cycle - 1),
            within_s=6 * self.recipe.solve_s + 30.0,
        )
        self._folder.cycle(cycle).json("certificate.json", solved.dwell.certificate)
        self._publish(Event("solved", cycle, asdict(solved.dwell.certificate)))
        return solved

    def _kept_start(self, cycle: int) -> KeptStart | None:
        """What an earlier cycle's solution left to start from; None where there is none that fits this program."""
        if cycle < 0 or not (self._folder.cycle(cycle).path / START).exists():
            return None
        arrays = self._folder.cycle(cycle).load_arrays(START)
        time_s = arrays.pop("time_s")
        return KeptStart(time_s, arrays) if time_s.shape == (self._program.n,) else None

    async def plan(self, cycle: int, solved: Solved) -> Plan:
        """The rewritten program, kept in the run folder with what the next solve can start from."""
        plan = await self._compute(steps.rewrite, self.recipe, self._program, solved, self._program.name)
        folder = self._folder.cycle(cycle)
        save_plan(folder, self.recipe, plan, solved)
        folder.arrays(START, {"time_s": solved.dwell.time_s, **solved.dwell.state})
        return plan

    def refuse_unsafe(self, plan: Plan) -> None:
        """PlanRefused with every violation that a check found."""
        found = [*steps.violations(self.recipe, plan), *self._check_plan(plan, self.recipe.envelope)]
        if found:
            raise PlanRefused("the plan was refused, nothing moved:\n" + "\n".join(f"  {line}" for line in found))

    # run

    async def begin_pass(self, cycle: int, plan: Plan, robot: RobotProgress) -> None:
        """The intent, durable before anything moves."""
        certificate = self._folder.cycle(cycle).load_json("certificate.json")
        facts = {
            "predicted_rms_nm": certificate["predicted_rms_nm"],
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
        )
        self._publish(Event("pass_begun", cycle, {"blocks": plan.contact_blocks, "dwell_s": plan.total_s}))

    def executed(self, cycle: int, block: Executed) -> None:
        """One block was executed in contact."""
        self._journal.executed_segment(cycle, block, contact=True)
        self._blocks += 1
        if self._blocks % PROGRESS_BLOCKS == 0:
            self._publish(Event("progress", cycle, {"block": block.seq + 1}))

    def end_pass(self, cycle: int) -> None:
        """The pass is over, tool lifted, robot at rest."""
        self._journal.flush()
        self._journal.end_pass(cycle, "done")
        blocks = self._journal.executed(cycle)
        columns = {"seq": blocks.seq, "start_s": blocks.start_s, "end_s": blocks.end_s, "contact": blocks.contact}
        self._folder.cycle(cycle).table("executed.csv", columns)
        self._publish(Event("pass_ended", cycle, {"executed_s": float(self.executed_s(cycle).sum())}))

    def executed_s(self, cycle: int) -> FloatArray:
        """(n,) process time that each timed point really had in that cycle's pass, s; 0 where it was not run."""
        blocks = self._journal.executed(cycle)
        lines = np.zeros(max(int(blocks.seq.max(initial=-1)), int(self._program.block.max())) + 1)
        np.add.at(lines, blocks.seq[blocks.contact], blocks.duration_s[blocks.contact])
        until = np.cumsum(lines)[self._program.block]  # with what leads to a point: a dwell's own move
        return np.asarray(np.diff(until, prepend=0.0), dtype=np.float64)

    def cycles(self) -> list[dict[str, Any]]:
        """One entry a measurement; what belongs to the pass after it is None where there was none."""
        passes = {record.cycle: record for record in self._journal.passes}
        return [
            {
                **{key: record.stats[key] for key in ("rms_nm", "pv_nm", "lsf_rms_nm", "band_rms_nm")},
                **{key: _fact(passes.get(record.cycle), key) for key in ("predicted_rms_nm", "dwell_s", "rate")},
                "executed_s": float(self.executed_s(record.cycle).sum()) if record.cycle in passes else None,
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

    def _restore(self) -> None:
        """Masks, last surface and beliefs of a job that an earlier run of the daemon began."""
        history = self._journal.history
        if not history:
            return
        first = self._load(history[0].cycle, history[0].sha256)
        self._masks = (first.solve_mask, first.metric_mask)
        self._lay = self._load(history[-1].cycle, history[-1].sha256).registration
        passes = self._journal.passes
        if passes:
            before = [record for record in history if record.cycle == passes[-1].cycle]
            self._surfaces = {record.cycle: self._load(record.cycle, record.sha256) for record in before}
            facts = passes[-1].facts
            self._beliefs = Beliefs(float(facts["rate"]), float(facts["block_overhead_s"]))

    def _load(self, cycle: int, sha256: str) -> Measured:
        return steps.load_measured(self.recipe, self._folder.cycle(cycle).load_arrays("surface.npz"), sha256)


def require_certificate(certificate: Certificate, recipe: Recipe) -> None:
    """ComputeError unless the dwell is optimal as far as asked, within its bounds, and nobody found a better one."""
    wrong = []
    if not certificate.kkt_residual <= recipe.kkt_tolerance:
        wrong.append(f"KKT residual {certificate.kkt_residual:.2e} is above {recipe.kkt_tolerance:.2e}")
    if not certificate.bound_violation_s <= 1e-9:
        wrong.append(f"a bound is violated by {certificate.bound_violation_s:.2e} s")
    if certificate.cross_check_gap is not None and not certificate.cross_check_gap <= recipe.cross_check_gap:
        wrong.append(f"{certificate.cross_check} found an objective that is {certificate.cross_check_gap:.2e} lower")
    if wrong:
        raise ComputeError(
            f"the dwell of {certificate.solver} has no valid certificate ({'; '.join(wrong)}; it stopped: "
            f"{certificate.stopped}); nothing was sent. Give it more time (dwell.within_s) or another dwell.solver"
        )


def save_surface(folder: RunFolder, surface: SurfaceMap, measured: Measured) -> None:
    """The map's own file, and what is made of it on the process grid."""
    if surface.path is not None:
        folder.copy(surface.path, f"map{surface.path.suffix}")
    folder.arrays(
        "surface.npz",
        {
            "height_nm": np.where(measured.solve_mask, measured.height_nm, np.nan),
            "solve_mask": measured.solve_mask,
            "metric_mask": measured.metric_mask,
            "pitch_mm": measured.grid.pitch_mm,
            "lies": np.array([*measured.registration.shift_mm, measured.registration.rotation_deg]),
        },
    )
    folder.json("registration.json", measured.registration)


def save_verdict(folder: RunFolder, verdict: Verdict, surface: Measured) -> None:
    """What the gate found and, where it stops, the maps that it compared: for the picture."""
    plain = {item.name: getattr(verdict, item.name) for item in fields(verdict)}
    maps = {key: value for key, value in plain.items() if isinstance(value, np.ndarray)}
    words = {key: value for key, value in plain.items() if key not in maps}
    folder.json("gate.json", {**words, "best": {**asdict(verdict.best), "name": verdict.best.name}})
    if verdict.stop:
        folder.arrays("gate.npz", {**maps, "metric_mask": surface.metric_mask, "pitch_mm": surface.grid.pitch_mm})


def save_plan(folder: RunFolder, recipe: Recipe, plan: Plan, solved: Solved) -> None:
    """Program, dwell and arrays of a plan, in the part's frame."""
    program = steps.in_part_frame(recipe, plan.program)
    if solved.curve:
        folder.json("curve.json", list(solved.curve))
    folder.bytes("program.rnc", plan.program.text)
    folder.table(
        "dwell.csv",
        {
            "point": np.arange(program.n),
            "line": program.line,
            "x_mm": program.end_mm[:, 0],
            "y_mm": program.end_mm[:, 1],
            "dwell_s": solved.dwell.time_s,
            "asked_s": solved.asked_s,
            "expected_s": plan.expected_time_s,
        },
    )
    folder.arrays(
        "plan.npz",
        {
            "block": plan.program.block,
            "time_s": solved.dwell.time_s,
            "asked_s": solved.asked_s,
            "expected_s": plan.expected_time_s,
            "lower_s": solved.dwell.lower_s,
            "compliance_um_per_n": solved.answer.compliance_um_per_n,
            "gamma": solved.answer.gamma,
            "start_mm": program.start_mm,
            "end_mm": program.end_mm,
            "predicted_removal_nm": plan.predicted_removal_nm,
            "residual_nm": solved.dwell.residual_nm,
            "curve_s": np.array([row["total_s"] for row in solved.curve]),
            "curve_nm": np.array([row["rms_nm"] for row in solved.curve]),
        },
    )


def _figure(stats: Mapping[str, Any]) -> float:
    band = stats["band_rms_nm"]
    return float(stats["rms_nm"] if band is None else band)


def _fact(record: Any, key: str) -> float | None:
    return None if record is None else float(record.facts[key])
