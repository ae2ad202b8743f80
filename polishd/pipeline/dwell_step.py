"""The computing step that solves the dwell: problem, solver, delivered times, and cross-check."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from polishd.config.cell_sections import DwellSection
from polishd.hookspecs import RemovalAnswer
from polishd.model.dwell import AS_PROGRAMMED, DwellSolution, OptimalityCertificate, Start, WarmStart
from polishd.model.errors import ComputeError, PlanRefused, ProgramError
from polishd.model.program import Envelope, Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.pipeline import precheck
from polishd.pipeline.recipe import CpuLimit, Recipe
from polishd.pipeline.records import EstimatesInUse, MeasureResult, SolveResult
from polishd.pipeline.steps import CachedEffect, effect_of, envelope_of, initial_estimates
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.lower_bound import prove_lower_bound
from polishd.process.dwell.problem import DwellProblem, TimeLimit, negligible_share
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.dwell.residual_curve import CurvePoint as Chosen
from polishd.process.dwell.residual_curve import Row, Solve, price_curve, solve_to_target, solve_within_budget
from polishd.process.metrology.edge_extension import extend_surface
from polishd.process.metrology.spectra import band_rms
from polishd.process.metrology.tolerance import unreachable_lines
from polishd.process.removal.combined_effect import combine_effects, split_by_tool
from polishd.process.removal.effect import Effect
from polishd.process.removal.transfer_function import correctable_surface
from polishd.process.robot import motion

# Extended heights at the unmeasured rim of the part, so that the dwell there is determined.

EXTENDED_WEIGHT = 0.01
"""Weight of an extended sample relative to a measured one: it holds the rim and does not affect the data."""
LEAST_SAMPLES = 3.0
"""The extension's cut-off spans this many samples at least."""


class FilledSurface(NamedTuple):
    """A surface to solve for: measured heights, and extended heights at the part's unmeasured rim."""

    height_nm: FloatArray
    mask: BoolArray
    weight: FloatArray | None


def fill_rim(recipe: Recipe, measured: MeasureResult, answer: RemovalAnswer) -> FilledSurface:
    """Extend heights with a small weight to the part's samples without data: the dwell there is undetermined otherwise.

    Beyond the part no height is needed, and each would cost time.
    """
    mask, pitch = measured.solve_mask, measured.grid.pitch_mm
    gap = recipe.outline.contains(*measured.grid.axes_mm) & ~mask
    if recipe.dwell.extension == "none" or not gap.any():
        return FilledSurface(measured.height_nm, mask, None)
    reach = max(float(scipy.ndimage.distance_transform_edt(~mask)[gap].max()) * pitch, pitch)
    own = 0.0 if answer.transfer is None else answer.transfer.cutoff_period_mm
    cutoff = max(own, LEAST_SAMPLES * pitch)
    wider = extend_surface(measured.height_nm, mask, pitch, reach, recipe.dwell.extension, cutoff_period_mm=cutoff)
    whole = mask | (wider.mask & gap)
    return FilledSurface(np.where(whole, wider.height_nm, 0.0), whole, np.where(mask, 1.0, EXTENDED_WEIGHT))


# A tool's share of a solve step: one tool alone, or several tools in one problem.


class ToolProblem(NamedTuple):
    """A tool's recipe, program, and estimates (None: the initial ones)."""

    recipe: Recipe
    program: Program
    believed: EstimatesInUse | None = None


class DwellBounds(NamedTuple):
    """Time that the machine can give each timed point, (n,) s."""

    lower_s: FloatArray
    upper_s: FloatArray

    def raised(self, least_s: FloatArray) -> DwellBounds:
        """Raise the lower bound to this time, and the upper bound to the lower one."""
        lower = np.maximum(self.lower_s, least_s)
        return DwellBounds(lower, np.maximum(self.upper_s, lower))


class SolveRound(NamedTuple):
    """A solved problem, and the times that the machine delivers."""

    problem: DwellProblem
    dwell: DwellSolution
    asked_s: FloatArray
    expected_s: FloatArray


@dataclass(frozen=True, slots=True)
class ToolSubproblem:
    """A tool's problem with its effect."""

    recipe: Recipe
    program: Program
    believed: EstimatesInUse
    answer: RemovalAnswer
    envelope: Envelope

    def least_s(self) -> FloatArray:
        """(n,) least time: of the motion, and `machine.least_point_s`."""
        return np.maximum(motion.least_time_s(self.program, self.envelope), self.envelope.least_point_s)

    def most_s(self) -> FloatArray:
        """(n,) longest time of the motion."""
        return motion.most_time_s(self.program, self.envelope)

    def divide_by(self) -> FloatArray:
        """(n,) divisor of the correction "pointwise", otherwise 1."""
        return np.ones(self.program.n) if self.answer.divide_by is None else self.answer.divide_by


def tool_subproblem(turn: ToolProblem, measured: MeasureResult) -> ToolSubproblem:
    """Build the subproblem of a tool for a measured surface."""
    believed = turn.believed or initial_estimates(turn.recipe)
    answer = effect_of(turn.recipe, turn.program, measured.grid, believed)
    return ToolSubproblem(turn.recipe, turn.program, believed, answer, envelope_of(turn.recipe, turn.program, believed))


def single_tool(
    found: SolveRound, removal_nm: FloatArray, left_nm: FloatArray, own: tuple[FloatArray, FloatArray, FloatArray]
) -> DwellSolution:
    """Extract one tool's solution from that of several tools: times, bounds, removal and residual."""
    time_s, lower_s, upper_s = own
    clear, grid = found.problem.metric_mask, found.problem.effect.grid
    residual = left_nm - left_nm[clear].mean()
    period, inside = found.problem.band_period_mm, residual[clear]
    certificate = replace(
        found.dwell.certificate,
        predicted_rms_nm=float(inside.std()),
        predicted_pv_nm=float(np.ptp(inside)),
        predicted_band_rms_nm=None if period is None else band_rms(residual, clear, grid.pitch_mm, period),
        dwell_total_s=float(time_s.sum()),
        at_lower=int(np.count_nonzero(time_s <= lower_s)),
        at_upper=int(np.count_nonzero(time_s >= upper_s)),
    )
    return DwellSolution(time_s, removal_nm, residual, certificate, lower_s, upper_s)


def add_certificate(dwell: DwellSolution, **changes: Any) -> DwellSolution:
    """Return the solution with changed fields of its certificate."""
    return replace(dwell, certificate=replace(dwell.certificate, **changes))


def add_note(dwell: DwellSolution, note: str) -> DwellSolution:
    """Return the solution with one more note in its certificate."""
    return add_certificate(dwell, notes=(*dwell.certificate.notes, note))


LEAST_COVERAGE = 0.9
"""A program that covers a smaller share of the clear aperture counts as another part's."""
LEAST_ON_PART = 0.5
"""A program with a smaller share of its points on the part counts as another part's."""
FEED_TIMED = ("feed", "inverse", "time")
"""Encodings whose times are moves: a change of feed takes the machine time."""
ENVELOPE_ROUNDS = 2
"""Number of re-solves with the times that acceleration delivers as the lower bound."""
NEARLY = 0.99
"""Share of a longest time from which it counts as taken in full."""
CROSS_CHECK_GAP = 1e-3
"""Largest relative advantage of an independent solver."""
CEILING = 0.1
"""Share of the points that take their longest time, from which that is worth a note."""
FLOOR = 0.5
"""Share of the mean removal from which that of the machine's shortest times is worth a note."""
LAST_SHARE = 0.25
"""Share of the step's time that is reserved for an unfinished last solve."""
PROOF_SHARE = 0.5
"""Share of the remaining time for a proof before the cross-check."""
DEADLINE = "deadline"
"""Stop reason of a solver whose time was over."""
KILL_RATIO, KILL_SPARE_S = 2.0, 60.0
"""Factor and margin before the worker is killed: it may have two threads, and solvers check the time late."""


def limit(recipe: Recipe) -> CpuLimit:
    """CPU limit of the compute worker during `solve`; a plugin that respects ``dwell.cpu_limit_s`` never reaches it."""
    return CpuLimit(
        KILL_RATIO * recipe.dwell.cpu_limit_s + KILL_SPARE_S, f"dwell.cpu_limit_s ({recipe.dwell.cpu_limit_s:g} s)"
    )


def solve(
    recipe: Recipe,
    program: Program,
    measured: MeasureResult,
    believed: EstimatesInUse | None = None,
    warm: WarmStart | None = None,
) -> SolveResult:
    """Solve the dwell for the measured surface in a cell with one tool; see `solve_tools`."""
    return solve_tools((ToolProblem(recipe, program, believed),), measured, warm)[0]


def solve_first(turns: Sequence[ToolProblem], measured: MeasureResult, warm: WarmStart | None = None) -> SolveResult:
    """Solve for all tools and return the first one's dwell; see `solve_tools`."""
    return solve_tools(turns, measured, warm)[0]


def solve_tools(
    turns: Sequence[ToolProblem], measured: MeasureResult, warm: WarmStart | None = None
) -> tuple[SolveResult, ...]:
    """Solve the dwell of each tool for the measured surface, within the times that the machine can deliver.

    All tools share one problem, so that a later tool removes the residual of an earlier one. Their recipes differ only
    in tool and program. Times that acceleration delivers late become the lower bound of the next round, so that the
    optimum includes them. ``warm`` is the record of the last solution. Removal models, rounds, choice, cross-check and
    curve combine_effects have ``dwell.cpu_limit_s`` of CPU time; each solve gets the remaining time.
    """
    try:
        return _solve_tools(turns, measured, warm)
    except PlanRefused as error:
        raise PlanRefused(precheck.doubt_of_heights(measured, turns[0].recipe) + str(error)) from None


def _solve_tools(
    turns: Sequence[ToolProblem], measured: MeasureResult, warm: WarmStart | None
) -> tuple[SolveResult, ...]:
    recipe = turns[0].recipe
    time_limit = TimeLimit(recipe.dwell.cpu_limit_s)
    for turn in turns:
        precheck.require_path_time(turn.recipe, turn.program)
    legs = tuple(tool_subproblem(turn, measured) for turn in turns)
    step = _Step(recipe, legs, measured, time_limit)
    if recipe.dwell.objective == AS_PROGRAMMED:
        return (step.as_programmed(),)
    for leg in legs:
        _require_coverage(leg.program, leg.answer, measured)
    bounds = DwellBounds(step.of_legs(ToolSubproblem.least_s), step.of_legs(ToolSubproblem.most_s))
    if len(legs) == 1:
        precheck.require_removal_time(recipe, measured, legs[0].answer, bounds.lower_s)
    found = step.round(bounds, warm, LAST_SHARE)
    if recipe.dwell.feed_change and any(leg.program.encoding in FEED_TIMED for leg in legs):
        step = replace(step, feed_change=step.feed_change_rows(found))
        found = step.round(bounds, found.dwell, LAST_SHARE)
    for _ in range(ENVELOPE_ROUNDS):
        late = found.expected_s > found.dwell.time_s * 1.001 + 1e-4
        if not late.any():
            break
        bounds = bounds.raised(np.where(late, found.expected_s, 0.0))
        found = step.round(bounds, found.dwell, LAST_SHARE)
    if found.dwell.certificate.stopped == DEADLINE:
        longer = step.round(bounds, found.dwell)
        found = min(found, longer, key=lambda round_: round_.dwell.certificate.objective)
    dwell = step.cross_checked(found.problem, step.timed(found.dwell))
    dwell, curve = step.with_curve(found.problem, step.noted(dwell))
    return step.turns(found._replace(dwell=dwell), curve)


def _require_coverage(program: Program, answer: RemovalAnswer, measured: MeasureResult) -> None:
    """ProgramError unless the path covers nearly all of the clear aperture and is mostly on the part."""
    right = "program of this part, and are program.offset_mm and program.rotation_deg right?"
    none = negligible_share(answer.effect)
    on_part = float(_touched(answer.effect.adjoint(measured.solve_mask.astype(np.float64)), none).mean())
    if on_part < LEAST_ON_PART:
        touch = f"only {on_part:.0%} of its timed points touch the part"
        raise ProgramError(f"{program.name}: {touch}: is it the {right}")
    share = float(_touched(answer.removal_nm(np.ones(program.n)), none)[measured.metric_mask].mean())
    if share < LEAST_COVERAGE:
        raise ProgramError(f"{program.name}: the path reaches {share:.0%} of the clear aperture; is it the {right}")


def _touched(removal: FloatArray, none: float) -> BoolArray:
    """Samples with more than that share of the strongest removal."""
    return np.asarray(removal > none * np.abs(removal).max(initial=0.0))


@dataclass(frozen=True)
class _Step:
    """Shared data of all solves of one step."""

    recipe: Recipe
    """Recipe of the first tool, for the keys that all tools share."""
    legs: tuple[ToolSubproblem, ...]
    measured: MeasureResult
    time_limit: TimeLimit
    feed_change: scipy.sparse.csr_array | None = None
    """Term of the objective (`DwellProblem.feed_change`)."""

    def feed_change_rows(self, found: SolveRound) -> scipy.sparse.csr_array:
        """(k, n) rows ``w (t_j / l_j - t_i / l_i)`` of blocks that follow each other on feed-timed programs.

        w is such that at this solution the squares sum to `dwell.feed_change` times the mean square of the removal that
        the machine's acceleration takes from it.
        """
        length = self.of_legs(lambda leg: leg.program.length_mm)
        timed = np.concatenate([np.full(leg.program.n, leg.program.encoding in FEED_TIMED) for leg in self.legs])
        ends = np.cumsum([leg.program.n for leg in self.legs])[:-1]
        follows = timed[1:] & timed[:-1] & (length[1:] > 0) & (length[:-1] > 0)
        follows[ends - 1] = False
        first = np.flatnonzero(follows)
        static = 1.0 if self.divide_by is None else self.divide_by
        slowness = 1 / (np.where(length > 0, length, 1.0) * static)
        row = np.arange(first.size)
        entries = np.concatenate([slowness[first + 1], -slowness[first]])
        where = np.concatenate([row, row]), np.concatenate([first + 1, first])
        shape = (first.size, length.size)
        rows = scipy.sparse.csr_array(scipy.sparse.coo_array((entries, where), shape=shape))
        solved = found.dwell.time_s * static
        late = self.effect.removal_nm((found.expected_s - found.dwell.time_s) * static)[self.surface.mask]
        change = rows @ solved
        size = float(change @ change)
        lost = float(np.mean(late**2))
        return rows * (float(np.sqrt(self.dwell.feed_change * lost / size)) if size > 0 else 0.0)

    def of_legs(self, value: Callable[[ToolSubproblem], FloatArray]) -> FloatArray:
        """(n,) values of all points, tool by tool."""
        return np.concatenate([value(leg) for leg in self.legs])

    def each(self, values: FloatArray) -> Iterator[tuple[ToolSubproblem, FloatArray]]:
        """Yield each tool with its values."""
        return zip(self.legs, split_by_tool(values, [leg.program.n for leg in self.legs]), strict=True)

    @cached_property
    def effect(self) -> Effect:
        """Joint effect of all tools."""
        return combine_effects([leg.answer.effect for leg in self.legs])

    @cached_property
    def divide_by(self) -> FloatArray | None:
        """(n,) divisor of the solved dwell; None: no division."""
        none = all(leg.answer.divide_by is None for leg in self.legs)
        return None if none else self.of_legs(ToolSubproblem.divide_by)

    @property
    def finest(self) -> RemovalAnswer:
        """Answer of the tool that corrects the shortest periods."""
        known = [leg.answer for leg in self.legs if leg.answer.transfer is not None]
        if len(known) < len(self.legs):
            return next(leg.answer for leg in self.legs if leg.answer.transfer is None)
        return min(known, key=lambda answer: answer.transfer.cutoff_period_mm if answer.transfer else math.inf)

    @property
    def dwell(self) -> DwellSection:
        return self.recipe.dwell

    def round(self, bounds: DwellBounds, warm: Start | None, reserve: float = 0.0) -> SolveRound:
        """Solve within these bounds; a single solve leaves the share ``reserve`` of the step's time."""
        problem, divide_by = self.problem(bounds, warm), self.divide_by
        if self.dwell.objective == "least":
            within_s = max(self.time_limit.left_s - reserve * self.dwell.cpu_limit_s, 0.0)
            found = self.recipe.solver.solve(problem, within_s)
        else:
            chosen = self.chosen(problem)
            problem, found = chosen.problem, chosen.solution
        dwell = found if divide_by is None else _in_machine_time(found, divide_by)
        asked = np.concatenate(
            [motion.asked_time_s(leg.program, own_s, leg.envelope) for leg, own_s in self.each(dwell.time_s)]
        )
        expected = [motion.delivered_time_s(leg.program, own_s, leg.envelope) for leg, own_s in self.each(asked)]
        return SolveRound(problem, dwell, asked, np.concatenate(expected))

    def as_programmed(self) -> SolveResult:
        """Return the program's own times, and the times that the machine delivers, without a solve."""
        (leg,) = self.legs
        asked = leg.program.time_s
        expected = motion.delivered_time_s(leg.program, asked, leg.envelope)
        problem = self.problem(DwellBounds(expected, expected), None)
        how: dict[str, Any] = {"solver": AS_PROGRAMMED, "iterations": 0, "stopped": "as programmed"}
        dwell = certify_dwell(problem, expected, seconds=self.time_limit.cpu_s, **how)
        return SolveResult(dwell, self.staying(leg), asked, expected, leg.believed)

    def staying(self, leg: ToolSubproblem) -> RemovalAnswer:
        """Answer of the tool, whose effect stays in this process."""
        return replace(leg.answer, effect=CachedEffect(leg.answer.effect, self.measured.grid))

    def turns(self, found: SolveRound, curve: tuple[Row, ...]) -> tuple[SolveResult, ...]:
        """Split the solution into one for each tool."""
        if len(self.legs) == 1:
            (leg,) = self.legs
            return (SolveResult(found.dwell, self.staying(leg), found.asked_s, found.expected_s, leg.believed, curve),)
        own = (found.dwell.time_s, found.dwell.lower_s, found.dwell.upper_s, found.asked_s, found.expected_s)
        parts = zip(self.legs, *([times for _, times in self.each(values)] for values in own), strict=True)
        names = ", ".join(leg.recipe.turn.tool if leg.recipe.turn else "?" for leg in self.legs)
        solved, left = list[SolveResult](), np.where(found.problem.solve_mask, found.problem.target_nm, np.nan)
        for leg, time_s, lower_s, upper_s, asked_s, expected_s in parts:
            removal = leg.answer.removal_nm(time_s)
            left = left - removal
            dwell = single_tool(found, removal, left, (time_s, lower_s, upper_s))
            total = found.dwell.certificate
            joint = f"one problem for {names}: {total.predicted_rms_nm:.2f} nm RMS after the last of them"
            dwell = add_note(dwell, f"{joint}, {total.dwell_total_s:.0f} s of dwell in all")
            solved.append(SolveResult(dwell, self.staying(leg), asked_s, expected_s, leg.believed, curve))
        return tuple(solved)

    def problem(self, bounds: DwellBounds, warm: Start | None) -> DwellProblem:
        """The problem for the solver; for "pointwise" the static problem, with bounds for the quotient."""
        measured, surface = self.measured, self.surface
        scale = 1.0 if self.divide_by is None else self.divide_by
        least = self.effect.removal_nm(bounds.lower_s * scale)
        piston = choose_piston_nm(measured.height_nm, measured.metric_mask, least)
        return DwellProblem(
            effect=self.effect,
            target_nm=np.where(surface.mask, surface.height_nm + piston, 0.0),
            solve_mask=surface.mask,
            weight=surface.weight,
            metric_mask=measured.metric_mask,
            lower_s=bounds.lower_s * scale,
            upper_s=bounds.upper_s * scale,
            regularisation=self.regularisation,
            feed_change=self.feed_change,
            band_period_mm=self.recipe.job.lsf_period_mm,
            warm=None if warm is None else WarmStart(warm.time_s * scale, warm.state),
        )

    @cached_property
    def regularisation(self) -> float:
        return regularisation_from_rho(self.effect, self.measured.solve_mask, self.dwell.regularisation)

    @cached_property
    def surface(self) -> FilledSurface:
        return fill_rim(self.recipe, self.measured, self.finest)

    def chosen(self, problem: DwellProblem) -> Chosen:
        """The point of the residual-against-time curve that the recipe's rule takes."""
        solve, divide_by = self.searching(f'objective = "{self.dwell.objective}"'), self.divide_by
        match self.dwell.objective:
            case "knee":
                return price_curve(problem, solve).knee()
            case "target":
                return solve_to_target(problem, self.dwell.target_nm or 0.0, solve)
            case _:
                # "pointwise" divides the solved times
                static = 1.0 if divide_by is None else float(divide_by.mean())
                return solve_within_budget(problem, (self.dwell.budget_s or math.inf) * static, solve)

    def searching(self, what: str) -> Solve:
        """The recipe's solver for a search with many solves. ComputeError where the time ends a solve early."""
        recipe, done = self.recipe, 0

        def solve(problem: DwellProblem) -> DwellSolution:
            nonlocal done
            found = recipe.solver.solve(problem, self.time_limit.left_s)
            certificate = found.certificate
            if certificate.stopped == DEADLINE and certificate.kkt_residual > recipe.dwell.kkt_tolerance:
                raise ComputeError(
                    f"{what} takes many solves, and its time was over after {done}: {self.time_limit} were used, and "
                    f"the next solve's KKT residual was {certificate.kkt_residual:.2e} after {certificate.iterations} "
                    f"iterations. Give it more time (dwell.cpu_limit_s is {recipe.dwell.cpu_limit_s:g} s)"
                )
            done += 1
            return found

        return solve

    def timed(self, dwell: DwellSolution) -> DwellSolution:
        """Return the solution; at a deadline, its certificate states the time that the whole step used."""
        certificate = dwell.certificate
        if certificate.stopped != DEADLINE:
            return dwell
        used = f"{DEADLINE} after {certificate.iterations} iterations, {self.time_limit} for the whole solve step"
        return add_certificate(dwell, stopped=used)

    def cross_checked(self, problem: DwellProblem, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with the result of an independent solver, where its proof is not sufficient."""
        other, dwell = self.recipe.cross_check, self.prove_lower_bound(problem, dwell)
        certificate = dwell.certificate
        if other is None or (certificate.gap is not None and certificate.gap <= self.dwell.cross_check_above):
            return dwell
        try:
            theirs = other.solve(problem, self.time_limit.left_s).certificate
        except ComputeError as error:
            return add_note(dwell, f"cross-check by {other.name} failed: {error}")
        if theirs.stopped == DEADLINE and theirs.objective > certificate.objective:  # that proves nothing
            return add_note(dwell, f"cross-check by {other.name} was not done in what was left of dwell.cpu_limit_s")
        gap = (certificate.objective - theirs.objective) / max(theirs.objective, 1e-12)
        return add_certificate(dwell, cross_check=other.name, cross_check_gap=gap)

    def prove_lower_bound(self, problem: DwellProblem, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with the best provable gap, where its gap would need a cross-check."""
        enough = self.dwell.cross_check_above
        if enough == 0:  # the cross-check runs always
            return dwell
        static = dwell if self.divide_by is None else replace(dwell, time_s=dwell.time_s * self.divide_by)
        found = prove_lower_bound(problem, static, enough, PROOF_SHARE * self.time_limit.left_s).certificate
        return add_certificate(dwell, gap=found.gap, gap_nm=found.gap_nm)

    def with_floor(self, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with the removal of the shortest times, and a note where it is most of the pass."""
        clear = self.measured.metric_mask
        static = 1.0 if self.divide_by is None else self.divide_by
        floor, whole = (float(self.effect.removal_nm(t * static)[clear].mean()) for t in (dwell.lower_s, dwell.time_s))
        dwell = add_certificate(dwell, floor_nm=floor)
        if not floor > FLOOR * whole:
            return dwell
        note = (
            f"the shortest times of the machine remove {floor:.3g} nm in the mean, of {whole:.3g} nm in all: a faster "
            "machine, longer blocks or a larger line distance remove less"
        )
        return add_note(dwell, note)

    def with_ceiling(self, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with a note for each tool of which many points take their longest time."""
        # a longest time near the shortest one is of acceleration, not of the smallest feed
        held = (dwell.time_s >= dwell.upper_s * NEARLY) & (dwell.lower_s < dwell.upper_s * NEARLY)
        for leg, own in self.each(held.astype(np.float64)):
            share, least = float(own.mean()), leg.envelope.min_feed_mm_s
            if share <= CEILING:
                continue
            key = "machine.min_feed_mm_s" if least <= self.recipe.envelope.min_feed_mm_s else leg.program.dialect
            limit = (
                "limits.max_pass_s" if leg.program.encoding == "dwell" else f"the smallest feed, {least:g} mm/s ({key})"
            )
            dwell = add_note(
                dwell,
                f"{share:.0%} of the points of {leg.program.name} take their longest time, by {limit}: the result is "
                "limited by it. More passes, a smaller least feed or a larger removal rate remove more",
            )
        return dwell

    def with_budget(self, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with a note where its total time is the budget."""
        budget_s, total_s = self.dwell.budget_s, dwell.certificate.dwell_total_s
        if budget_s is None or total_s < NEARLY * budget_s:
            return dwell
        return add_note(dwell, f"the dwell takes all of dwell.budget_s = {budget_s:g} s: the result is limited by it")

    def noted(self, dwell: DwellSolution) -> DwellSolution:
        """Return the solution with notes on its times, and on the periods that the spot cannot correct."""
        dwell = self.with_budget(self.with_ceiling(self.with_floor(dwell)))
        measured, spot = self.measured, self.finest.transfer
        if spot is None:
            return dwell
        found = correctable_surface(measured.height_nm, measured.metric_mask, measured.grid.pitch_mm, spot)
        if not found.resolved:
            return dwell
        left = f"{found.beyond_reach_rms_nm:.2f} nm RMS of the surface has periods below {spot.cutoff_period_mm:.2f} mm"
        dwell = add_certificate(dwell, cutoff_period_mm=spot.cutoff_period_mm)
        dwell = add_note(dwell, f"{left}: no dwell with this spot removes it")
        on_grid = measured.height_nm, measured.metric_mask, measured.grid.pitch_mm
        for line in unreachable_lines(self.recipe.lines, *on_grid, spot.cutoff_period_mm):
            dwell = add_note(dwell, f"that alone has {line}: this spot cannot bring the part into tolerance")
        return dwell

    def with_curve(self, problem: DwellProblem, dwell: DwellSolution) -> tuple[DwellSolution, tuple[Row, ...]]:
        """Add the curve of residual against time on request; a missing curve does not refuse a plan."""
        if not self.dwell.curve:
            return dwell, ()
        try:
            return dwell, tuple(price_curve(problem, self.searching("curve")).rows())
        except ComputeError as error:
            return add_note(dwell, f"no curve of residual against time: {error}"), ()


def _in_machine_time(dwell: DwellSolution, divide_by: FloatArray) -> DwellSolution:
    """The correction "pointwise" (paper ref. 17): the dwell of the static problem, divided point by point."""
    time_s, lower_s, upper_s = (t / divide_by for t in (dwell.time_s, dwell.lower_s, dwell.upper_s))
    divided = replace(dwell, time_s=time_s, lower_s=lower_s, upper_s=upper_s)
    return add_certificate(divided, dwell_total_s=float(time_s.sum()))


def require_certificate(certificate: OptimalityCertificate, recipe: Recipe) -> None:
    """ComputeError unless the dwell is optimal within its tolerance and its bounds, and no better dwell is known."""
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
            f"{certificate.stopped}); nothing was sent. Give it more time (dwell.cpu_limit_s) or another dwell.solver"
        )
