"""The computing step that solves the dwell: problem, solver, what the machine delivers, and a second opinion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from polishd.config.sections import DwellSection
from polishd.hookspecs import RemovalAnswer
from polishd.model.dwell import AS_PROGRAMMED, Certificate, DwellSolution, KeptStart, Start
from polishd.model.errors import ComputeError, ProgramError
from polishd.model.limits import Envelope
from polishd.model.program import Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.process import motion
from polishd.process.dwell.budget import to_target, within_budget
from polishd.process.dwell.certificate import certified
from polishd.process.dwell.curve import Row, Solve, price_curve
from polishd.process.dwell.curve import Solved as Chosen
from polishd.process.dwell.limit import TimeLimit
from polishd.process.dwell.problem import ROUGH, DwellProblem
from polishd.process.dwell.setup import choose_piston_nm, regularisation_from_rho
from polishd.process.dwell.validation import negligible
from polishd.process.edge.correctable import correctable
from polishd.process.edge.extension import extend
from polishd.process.tolerance import out_of_reach
from polishd.recipe import foresight
from polishd.recipe.limit import Limit
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import Believed, Measured, Solved
from polishd.recipe.staying import Staying
from polishd.recipe.steps import believed_at_first, effect_of, envelope_of

LEAST_COVERAGE = 0.9
"""A program that works less of the clear aperture than this is taken for another part's."""
LEAST_ON_PART = 0.5
"""So is one that mostly works beside it."""
ENVELOPE_ROUNDS = 2
"""Re-solves with what acceleration delivers as the lower bound."""
EXTENDED_WEIGHT = 0.01
"""What an extended sample counts beside a measured one: enough to hold the rim, too little to cost the data."""
LEAST_SAMPLES = 3.0
"""The extension's cut-off spans this many samples at least."""
CROSS_CHECK_GAP = 1e-3
"""Most by which an independent solver may be better."""
LAST_SHARE = 0.25
"""Of the step's time, what no round may touch: the last solve goes on with it where it was not done."""
DEADLINE = "deadline"
"""What a certificate says of a solver whose time was over."""
KILL_RATIO, KILL_SPARE_S = 2.0, 60.0
"""The worker is killed this much later: it may have two threads, and no solver looks at the time always."""


def limit(recipe: Recipe) -> Limit:
    """When the compute worker is killed over `solve`, which keeps to ``dwell.within_s`` where its plugins do."""
    return Limit(KILL_RATIO * recipe.dwell.within_s + KILL_SPARE_S, f"dwell.within_s ({recipe.dwell.within_s:g} s)")


def solve(
    recipe: Recipe,
    program: Program,
    measured: Measured,
    believed: Believed | None = None,
    warm: KeptStart | None = None,
) -> Solved:
    """Dwell for the removal that the measured surface wants, within what the machine can deliver.

    What acceleration delivers late becomes the lower bound of the next round, so that the optimum knows of it.
    ``believed`` is what the cycles have taught, None before the first; ``warm`` is what was kept of the last one's
    solution. All of it together, removal model, rounds, choice, cross-check and curve, has ``dwell.within_s`` of CPU
    time: each solve is given what is left. Only the last must be a good one.
    """
    time_limit = TimeLimit(recipe.dwell.within_s)
    foresight.require_path_time(recipe, program)
    believed = believed or believed_at_first(recipe)
    envelope = envelope_of(recipe, program, believed)
    answer = effect_of(recipe, program, measured.grid, believed)
    if recipe.dwell.choose == AS_PROGRAMMED:
        return _Step(recipe, program, measured, answer, envelope, time_limit).as_programmed(believed)
    _require_coverage(program, answer, measured)
    bounds = Bounds(motion.least_time_s(program, envelope), motion.most_time_s(program, envelope))
    foresight.require_removal_time(recipe, measured, answer, bounds.lower_s)
    step = _Step(recipe, program, measured, answer, envelope, time_limit)
    found = step.round(bounds, warm, LAST_SHARE, rough=True)
    for _ in range(ENVELOPE_ROUNDS):
        late = found.expected_s > found.dwell.time_s * 1.001 + 1e-4
        if not late.any():
            break
        bounds = bounds.raised(np.where(late, found.expected_s, 0.0))
        found = step.round(bounds, found.dwell, LAST_SHARE, rough=True)
    if found.dwell.certificate.stopped in {DEADLINE, ROUGH}:
        longer = step.round(bounds, found.dwell)
        found = min(found, longer, key=lambda round_: round_.dwell.certificate.objective)
    dwell = step.cross_checked(found.problem, step.timed(found.dwell))
    dwell, curve = step.with_curve(found.problem, step.noted(dwell))
    answer = replace(answer, effect=Staying(answer.effect, measured.grid))
    return Solved(dwell, answer, found.asked_s, found.expected_s, believed, curve)


def _require_coverage(program: Program, answer: RemovalAnswer, measured: Measured) -> None:
    """ProgramError unless the path works nearly all of the clear aperture, and mostly the part."""
    right = "program of this part, and are program.offset_mm and program.rotation_deg right?"
    none = negligible(answer.effect)
    on_part = float(_touched(answer.effect.adjoint(measured.solve_mask.astype(np.float64)), none).mean())
    if on_part < LEAST_ON_PART:
        touch = f"only {on_part:.0%} of its timed points touch the part"
        raise ProgramError(f"{program.name}: {touch}: is it the {right}")
    share = float(_touched(answer.removal_nm(np.ones(program.n)), none)[measured.metric_mask].mean())
    if share < LEAST_COVERAGE:
        raise ProgramError(f"{program.name}: the path reaches {share:.0%} of the clear aperture; is it the {right}")


def _touched(removal: FloatArray, none: float) -> BoolArray:
    """Where there is more than that share of the strongest."""
    return np.asarray(removal > none * np.abs(removal).max(initial=0.0))


class Bounds(NamedTuple):
    """Time that the machine can give each timed point, (n,) s."""

    lower_s: FloatArray
    upper_s: FloatArray

    def raised(self, least_s: FloatArray) -> Bounds:
        """The lower one at least this, the upper one never below it."""
        lower = np.maximum(self.lower_s, least_s)
        return Bounds(lower, np.maximum(self.upper_s, lower))


class Round(NamedTuple):
    """A solved problem, and what the machine makes of it."""

    problem: DwellProblem
    dwell: DwellSolution
    asked_s: FloatArray
    expected_s: FloatArray


@dataclass(frozen=True)
class _Step:
    """What all solves of one step have in common."""

    recipe: Recipe
    program: Program
    measured: Measured
    answer: RemovalAnswer
    envelope: Envelope
    time_limit: TimeLimit

    @property
    def dwell(self) -> DwellSection:
        return self.recipe.dwell

    def round(self, bounds: Bounds, warm: Start | None, reserve: float = 0.0, *, rough: bool = False) -> Round:
        """Solve within these bounds; where one solve does it, ``reserve`` of the step's time is left for later.

        ``rough``: where one solve does it, that may be a rough one; its certificate tells.
        """
        problem, divide_by = self.problem(bounds, warm), self.answer.divide_by
        if self.dwell.choose == "least":
            within_s = max(self.time_limit.left_s - reserve * self.dwell.within_s, 0.0)
            found = self.recipe.solver.solve(replace(problem, rough=rough), within_s)
        else:
            chosen = self.chosen(problem)
            problem, found = chosen.problem, chosen.solution
        dwell = found if divide_by is None else _in_machine_time(found, divide_by)
        envelope, dwells = self.envelope, self.program.encoding == "dwell"
        unasked = motion.least_time_s(self.program, envelope) if dwells else envelope.block_overhead_s
        asked = np.maximum(dwell.time_s - unasked, 0.0)
        return Round(problem, dwell, asked, motion.delivered_time_s(self.program, asked, envelope))

    def as_programmed(self, believed: Believed) -> Solved:
        """No solve: the program's own times, and what the machine makes of them."""
        asked = self.program.time_s
        expected = motion.delivered_time_s(self.program, asked, self.envelope)
        problem = self.problem(Bounds(expected, expected), None)
        how: dict[str, Any] = {"solver": AS_PROGRAMMED, "iterations": 0, "stopped": "as programmed"}
        dwell = certified(problem, expected, seconds=self.time_limit.cpu_s, **how)
        answer = replace(self.answer, effect=Staying(self.answer.effect, self.measured.grid))
        return Solved(dwell, answer, asked, expected, believed)

    def problem(self, bounds: Bounds, warm: Start | None) -> DwellProblem:
        """The solver's; of "pointwise" the static problem, bounded so that the quotient keeps its bounds."""
        measured, answer, surface = self.measured, self.answer, self.surface
        piston = choose_piston_nm(measured.height_nm, measured.metric_mask, answer.removal_nm(bounds.lower_s))
        scale = 1.0 if answer.divide_by is None else answer.divide_by
        return DwellProblem(
            effect=answer.effect,
            target_nm=np.where(surface.mask, surface.height_nm + piston, 0.0),
            solve_mask=surface.mask,
            weight=surface.weight,
            metric_mask=measured.metric_mask,
            lower_s=bounds.lower_s * scale,
            upper_s=bounds.upper_s * scale,
            regularisation=self.regularisation,
            band_period_mm=self.recipe.job.lsf_period_mm,
            warm=None if warm is None else KeptStart(warm.time_s * scale, warm.state),
        )

    @cached_property
    def regularisation(self) -> float:
        return regularisation_from_rho(self.answer.effect, self.measured.solve_mask, self.dwell.regularisation)

    @cached_property
    def surface(self) -> Whole:
        return _with_rim(self.recipe, self.measured, self.answer)

    def chosen(self, problem: DwellProblem) -> Chosen:
        """The point of the residual-against-time curve that the recipe's rule takes."""
        solve, divide_by = self.searching(f'choose = "{self.dwell.choose}"'), self.answer.divide_by
        match self.dwell.choose:
            case "knee":
                return price_curve(problem, solve).knee()
            case "target":
                return to_target(problem, self.dwell.target_nm or 0.0, solve)
            case _:
                # "pointwise" takes so much longer than it solves
                static = 1.0 if divide_by is None else float(divide_by.mean())
                return within_budget(problem, (self.dwell.budget_s or math.inf) * static, solve)

    def searching(self, what: str) -> Solve:
        """The recipe's solver for what needs many solves. One that was cut short would mislead it: a ComputeError."""
        recipe, done = self.recipe, 0

        def solve(problem: DwellProblem) -> DwellSolution:
            nonlocal done
            found = recipe.solver.solve(problem, self.time_limit.left_s)
            certificate = found.certificate
            if certificate.stopped == DEADLINE and certificate.kkt_residual > recipe.dwell.kkt_tolerance:
                raise ComputeError(
                    f"{what} takes many solves, and its time was over after {done}: {self.time_limit} were used, and "
                    f"the next solve's KKT residual was {certificate.kkt_residual:.2e} after {certificate.iterations} "
                    f"iterations. Give it more time (dwell.within_s is {recipe.dwell.within_s:g} s)"
                )
            done += 1
            return found

        return solve

    def timed(self, dwell: DwellSolution) -> DwellSolution:
        """The same solution; where its time was over, its certificate says what the whole step had used by then."""
        certificate = dwell.certificate
        if certificate.stopped != DEADLINE:
            return dwell
        used = f"{DEADLINE} after {certificate.iterations} iterations, {self.time_limit} for the whole solve step"
        return _certified(dwell, stopped=used)

    def cross_checked(self, problem: DwellProblem, dwell: DwellSolution) -> DwellSolution:
        """The same solution with an independent solver's word on it, where its own proof is not enough."""
        other, certificate = self.recipe.cross_check, dwell.certificate
        if other is None or (certificate.gap is not None and certificate.gap <= self.dwell.cross_check_above):
            return dwell
        try:
            theirs = other.solve(problem, self.time_limit.left_s).certificate
        except ComputeError as error:
            return _with_note(dwell, f"cross-check by {other.name} failed: {error}")
        if theirs.stopped == DEADLINE and theirs.objective > certificate.objective:  # which says nothing of ours
            return _with_note(dwell, f"cross-check by {other.name} was not done in what was left of dwell.within_s")
        gap = (certificate.objective - theirs.objective) / max(theirs.objective, 1e-12)
        return _certified(dwell, cross_check=other.name, cross_check_gap=gap)

    def noted(self, dwell: DwellSolution) -> DwellSolution:
        """The same solution; its certificate says what of the surface is out of the spot's reach."""
        measured, spot = self.measured, self.answer.transfer
        if spot is None:
            return dwell
        found = correctable(measured.height_nm, measured.metric_mask, measured.grid.pitch_mm, spot)
        if not found.resolved:
            return dwell
        left = f"{found.beyond_reach_rms_nm:.2f} nm RMS of the surface has periods below {spot.cutoff_period_mm:.2f} mm"
        dwell = _with_note(dwell, f"{left}: no dwell with this spot removes it")
        on_grid = measured.height_nm, measured.metric_mask, measured.grid.pitch_mm
        for line in out_of_reach(self.recipe.lines, *on_grid, spot.cutoff_period_mm):
            dwell = _with_note(dwell, f"that alone has {line}: this spot cannot bring the part into tolerance")
        return dwell

    def with_curve(self, problem: DwellProblem, dwell: DwellSolution) -> tuple[DwellSolution, tuple[Row, ...]]:
        """The curve of residual against time where it is asked for; a plan is not refused for want of it."""
        if not self.dwell.curve:
            return dwell, ()
        try:
            return dwell, tuple(price_curve(problem, self.searching("curve")).rows())
        except ComputeError as error:
            return _with_note(dwell, f"no curve of residual against time: {error}"), ()


class Whole(NamedTuple):
    """A surface to solve for: what was measured, and what stands for the part's rim where nothing was."""

    height_nm: FloatArray
    mask: BoolArray
    weight: FloatArray | None


def _with_rim(recipe: Recipe, measured: Measured, answer: RemovalAnswer) -> Whole:
    """The part's samples without data get extended heights at a small weight: else the dwell there is nobody's.

    Only as far as the part goes: beyond it nothing has to be right, and asking for it costs time.
    """
    mask, pitch = measured.solve_mask, measured.grid.pitch_mm
    gap = recipe.outline.contains(*measured.grid.axes_mm) & ~mask
    if recipe.dwell.extension == "none" or not gap.any():
        return Whole(measured.height_nm, mask, None)
    reach = max(float(ndimage.distance_transform_edt(~mask)[gap].max()) * pitch, pitch)
    own = 0.0 if answer.transfer is None else answer.transfer.cutoff_period_mm
    cutoff = max(own, LEAST_SAMPLES * pitch)
    wider = extend(measured.height_nm, mask, pitch, reach, recipe.dwell.extension, cutoff_period_mm=cutoff)
    whole = mask | (wider.mask & gap)
    return Whole(np.where(whole, wider.height_nm, 0.0), whole, np.where(mask, 1.0, EXTENDED_WEIGHT))


def _certified(dwell: DwellSolution, **changes: Any) -> DwellSolution:
    return replace(dwell, certificate=replace(dwell.certificate, **changes))


def _with_note(dwell: DwellSolution, note: str) -> DwellSolution:
    return _certified(dwell, notes=(*dwell.certificate.notes, note))


def _in_machine_time(dwell: DwellSolution, divide_by: FloatArray) -> DwellSolution:
    """The correction "pointwise" (paper ref. 17): the dwell of the static problem, divided point by point."""
    time_s, lower_s, upper_s = (t / divide_by for t in (dwell.time_s, dwell.lower_s, dwell.upper_s))
    divided = replace(dwell, time_s=time_s, lower_s=lower_s, upper_s=upper_s)
    return _certified(divided, dwell_total_s=float(time_s.sum()))


def require_certificate(certificate: Certificate, recipe: Recipe) -> None:
    """ComputeError unless the dwell is optimal as far as asked, within its bounds, and nobody found a better one."""
    wrong = []
    if not certificate.kkt_residual <= recipe.dwell.kkt_tolerance:
        wrong.append(f"KKT residual {certificate.kkt_residual:.2e} is above {recipe.dwell.kkt_tolerance:.2e}")
    if not certificate.bound_violation_s <= 1e-9:
        wrong.append(f"a bound is violated by {certificate.bound_violation_s:.2e} s")
    if certificate.cross_check_gap is not None and not certificate.cross_check_gap <= CROSS_CHECK_GAP:
        wrong.append(f"{certificate.cross_check} found an objective that is {certificate.cross_check_gap:.2e} lower")
    if wrong:
        raise ComputeError(
            f"the dwell of {certificate.solver} has no valid certificate ({'; '.join(wrong)}; it stopped: "
            f"{certificate.stopped}); nothing was sent. Give it more time (dwell.within_s) or another dwell.solver"
        )
