"""The computing steps of a cycle: plain functions on arrays, run in the compute worker (so they pickle)."""

from __future__ import annotations

import uuid
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy

from polishd.hookspecs import RemovalAnswer, RemovalRequest
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ComputeError
from polishd.model.estimates import Diagnosis, Estimate, MapPixels, PassEvidence, PassIndicators
from polishd.model.instrument import Instrument
from polishd.model.program import Envelope, Plan, Program, Segments
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.pipeline import acceptance
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import CENTRED, EstimatesInUse, ExecutedPass, LearnResult, MeasureResult, SolveResult
from polishd.pipeline.run_folder import read_program_bytes
from polishd.process.dwell.problem import negligible_share, without_traces
from polishd.process.frames import rotation_from_rpy_deg
from polishd.process.identification import removal_check, residual_diagnosis
from polishd.process.identification.findings import (
    WearIndicators,
    half_width_mm,
    pool_unexplained,
    traces,
    unexplained_share,
)
from polishd.process.identification.removal_check import RemovalCheckResult
from polishd.process.identification.removal_fit import MOST_DRIFT_NM
from polishd.process.identification.residual_diagnosis import fit_residual
from polishd.process.metrology import conditioning
from polishd.process.metrology.absolute_test import SystemMap
from polishd.process.metrology.conditioning import Masks, clean_map
from polishd.process.metrology.instrument import apply_profile
from polishd.process.metrology.registration import register
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.spectra import surface_stats
from polishd.process.metrology.statistics import Removal, remove_terms
from polishd.process.metrology.tolerance import alignment_notes, judge_lines, subtract_nominal, tolerance_notes
from polishd.process.removal.effect import Effect
from polishd.process.removal.ripple import NO_RIPPLE, Ripple
from polishd.process.removal.transfer_function import SpotTransferFunction, correctable_surface
from polishd.process.robot import motion
from polishd.process.toolpath.apertures import tool_axes

# Large effects stay in the process that made them.


class CachedEffect:
    """An Effect that pickles as its name; the process that made it finds it again by that name, once."""

    _left: ClassVar[dict[str, Effect]] = {}
    """The last one whose name was sent: of the plan that is being made."""

    def __init__(self, effect: Effect | None, grid: Grid, name: str = "") -> None:
        self._effect = effect
        self.grid = grid
        self._name = name or uuid.uuid4().hex

    @property
    def here(self) -> bool:
        """Whether this process has it."""
        return self._effect is not None

    @property
    def n(self) -> int:
        """Number of timed points."""
        return self._own().n

    @property
    def negligible(self) -> float:
        """Share of the strongest removal below which removal counts as zero."""
        return negligible_share(self._own())

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        return self._own().removal_nm(time_s)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        return self._own().adjoint(weight)

    def __reduce__(self) -> tuple[object, ...]:
        if self._effect is not None:
            CachedEffect._left = {self._name: self._effect}
        return _by_name, (self._name, self.grid)

    def _own(self) -> Effect:
        if self._effect is None:
            raise ComputeError("the effect is in the process that solved with it, and this is another one")
        return self._effect


def _by_name(name: str, grid: Grid) -> CachedEffect:
    return CachedEffect(CachedEffect._left.pop(name, None), grid, name)


# The surface of the figures: a map on its own samples over the clear aperture, without alignment terms.

ROUNDING = 1e-3
"""Tolerance of a share of samples: files keep a pitch in seven digits, and the last digit must not move a rim."""


def map_on_part(surface: SurfaceMap, instrument: Instrument | None, system: SystemMap | None) -> SurfaceMap:
    """The map in the part's frame, less the instrument's own error where that is known; MapError as `apply_profile`."""
    lying = apply_profile(surface, instrument)
    return lying if system is None else system.off(lying)


def of_part(
    lying: SurfaceMap, spike_threshold_mad: float, nominal: SurfaceMap | None, lies: Registration
) -> tuple[SurfaceMap, int]:
    """Remove spikes and the nominal form from a map; return it with the number of spikes."""
    clean, spikes = clean_map(lying, spike_threshold_mad)
    return (clean if nominal is None else subtract_nominal(clean, nominal, lies)), spikes


def figure_of(
    clean: SurfaceMap, grid: Grid, metric_mask: BoolArray, lies: Registration, alignment: Removal
) -> tuple[FloatArray, BoolArray]:
    """Return the judged heights and their samples.

    Args:
        clean: the map as ``of_part`` gives it.
        grid: the process grid, on which the clear aperture is frozen.
        metric_mask: (ny, nx) on it: the clear aperture.
        lies: where the part lies in the map.
        alignment: terms that are alignment, not figure.

    Returns:
        (rows, columns) of the map itself: height in nm less the alignment, NaN outside the aperture; and the clear
        aperture there.
    """
    clear = on_map(clean, grid, metric_mask, lies)
    return remove_terms(clean.height_nm, clear, alignment), clear


def on_map(surface: SurfaceMap, grid: Grid, mask: BoolArray, lies: Registration) -> BoolArray:
    """The frozen clear aperture on the map's own pixels: figures are stated there, where the raster's ripple shows."""
    x, y = lies.on_part_mm(surface.grid)
    places = [(grid.y_mm[0] - y) / grid.pitch_mm, (x - grid.x_mm[0]) / grid.pitch_mm]
    # the two grids may lie half a sample apart: the nearest one would move the rim by that much
    share = scipy.ndimage.map_coordinates(mask.astype(np.float64), places, order=1)
    return np.asarray(share >= 0.5 - ROUNDING, dtype=np.bool_) & surface.valid


# Indicators of the process after a pass, from the data of the learning step.


def pass_indicators(
    done: ExecutedPass, answer: RemovalAnswer, predicted_nm: FloatArray, verdict: RemovalCheckResult, rate: float
) -> PassIndicators:
    """Indicators of a pass that passed the removal check.

    Args:
        done: the pass.
        answer: of the removal model with the estimates before the pass.
        predicted_nm: (ny, nx) removal that it predicts for the executed times; also beside the clear aperture.
        verdict: of the removal check.
        rate: the estimated removal rate before the pass.
    """
    grid, mask = done.before.grid, done.before.metric_mask
    seen = WearIndicators()
    if verdict.tells_rate and answer.transfer is not None:
        late = answer.removal_nm(done.acted_s * _lateness(done.executed_s))
        spot_mm = half_width_mm(answer.transfer)
        measured = done.before.height_nm - done.after.height_nm
        seen = traces(predicted_nm, late, measured, mask, pitch_mm=grid.pitch_mm, spot_mm=spot_mm)
    return PassIndicators(
        before_nm=float(done.before.height_nm[mask].std()),
        predicted_nm=done.predicted_rms_nm,
        after_nm=float(done.after.height_nm[mask].std()),
        within_reach_nm=_within_reach_nm(done.after, mask, grid, answer.transfer),
        contact_s=float(done.executed_s.sum()),
        rate=Estimate(rate * verdict.rate, rate * verdict.rate_sigma) if verdict.tells_rate else None,
        fade=_told(seen.fade, seen.fade_sigma),
        width=_told(seen.width, seen.width_sigma),
        expected_nm=None if done.forecast is None else (done.forecast.low_nm, done.forecast.high_nm),
        seen_nm=done.after.stats.rms_nm,
    )


def _lateness(time_s: FloatArray) -> FloatArray:
    """(n,) position of each point in the pass's time, from -1/2 at its start to 1/2 at its end."""
    total = float(time_s.sum())
    return np.asarray((np.cumsum(time_s) - time_s / 2) / total - 0.5 if total > 0 else time_s, dtype=np.float64)


def _within_reach_nm(
    after: MeasureResult, mask: BoolArray, grid: Grid, spot: SpotTransferFunction | None
) -> float | None:
    if spot is None:
        return None
    found = correctable_surface(after.height_nm, mask, grid.pitch_mm, spot)
    return found.within_reach_rms_nm if found.resolved else found.rms_nm


def _told(value: float, sigma: float) -> Estimate | None:
    return Estimate(value, sigma) if np.isfinite(sigma) else None


ALIKE = 0.2
"""Largest shift of the part between two maps, as a share of a sample, for which their samples count as the same."""
TOUCH_MISS_MM = 3.0
"""Largest error of the spot's position in a pass as programmed; the pass serves to measure this error."""


def read_program(recipe: Recipe, path: Path) -> Program:
    """Read the job's program; ProgramError names file and line."""
    return recipe.format.read_file(path, read_program_bytes(path))


def initial_estimates(recipe: Recipe) -> EstimatesInUse:
    """Estimates before the first pass."""
    return EstimatesInUse(recipe.model.beliefs, recipe.envelope.block_overhead_s)


def condition(
    recipe: Recipe,
    surface: SurfaceMap,
    masks: Masks | None = None,
    last: Registration | None = None,
    ripple: Ripple = NO_RIPPLE,
) -> MeasureResult:
    """Bring a map onto the process grid and state its figures; MapError where it cannot be trusted.

    ``masks`` and ``last`` come from earlier maps of the part: its frozen masks, and its last registration. ``ripple``
    is the forecast of all passes that were made: what the map does not show of it counts in the tolerance lines.
    """
    profiled = map_on_part(surface, recipe.instrument, recipe.system)
    lies = CENTRED
    if recipe.instrument is not None:
        lies = register(profiled, recipe.instrument, recipe.outline, last)
    clean, spikes = of_part(profiled, recipe.spike_threshold_mad, recipe.nominal, lies)
    part = conditioning.condition(
        clean,
        outline=recipe.outline,
        edge_mm=recipe.part.edge_mm,
        grid_mm=recipe.grid_mm,
        masks=masks,
        removal=recipe.part.alignment,
        registration=lies,
    )
    figure, clear = figure_of(clean, part.grid, part.metric_mask, lies, recipe.part.alignment)
    stats = surface_stats(
        figure,
        clear,
        clean.grid.pitch_mm,
        lsf_period_mm=recipe.job.lsf_period_mm,
        band_period_mm=recipe.job.tolerance_period_mm or None,
    )
    height = np.where(part.solve_mask, part.height_nm, 0.0)
    repeats = None if recipe.instrument is None else recipe.instrument.repeatability_nm
    judged = judge_lines(recipe.lines, figure, clear, clean.grid.pitch_mm, repeats, ripple=ripple)
    judged = acceptance.bounded(recipe, judged, figure, clear, clean.grid.pitch_mm)
    wanted = min((line.limit for line in recipe.lines if line.unit == "nm"), default=0.0)
    notes = (*alignment_notes(clean.height_nm, clear, recipe.part.alignment, wanted), *tolerance_notes(judged))
    return MeasureResult(
        part.grid,
        height,
        part.solve_mask,
        part.metric_mask,
        stats,
        surface.sha256,
        lies,
        spikes,
        notes,
        judged,
        clean.grid,
        "" if recipe.system is None else recipe.system.surface.sha256,
    )


def expected_removal(recipe: Recipe, before: MeasureResult, residual_nm: FloatArray) -> MeasureResult:
    """Measurement of the surface expected after a pass, (ny, nx) on the process grid; it belongs to no map."""
    stats = surface_stats(
        residual_nm,
        before.metric_mask,
        before.grid.pitch_mm,
        lsf_period_mm=recipe.job.lsf_period_mm,
        band_period_mm=recipe.job.tolerance_period_mm or None,
    )
    height = np.where(before.solve_mask & np.isfinite(residual_nm), residual_nm, 0.0)
    return replace(before, height_nm=height, stats=stats, sha256="", notes=(), judged=(), spikes=0)


def map_change_nm(recipe: Recipe, before: MeasureResult, after: MeasureResult) -> float:
    """RMS change in the clear aperture between two measurements, without alignment."""
    changed = remove_terms(after.height_nm - before.height_nm, before.metric_mask, _unknown(recipe))
    return float(np.sqrt(np.mean(changed[before.metric_mask] ** 2)))


def map_changes(recipe: Recipe, before: MeasureResult, after: MeasureResult) -> tuple[Diagnosis, ...]:
    """Diagnose the change between two measurements without a pass in between."""
    grid, mask = before.grid, before.metric_mask
    lost_nm = before.height_nm - after.height_nm
    return residual_diagnosis.diagnose_change(fit_residual(lost_nm, mask, grid.pitch_mm, removal=_unknown(recipe)))


def harmful_changes(recipe: Recipe, moves: tuple[Diagnosis, ...]) -> tuple[Diagnosis, ...]:
    """Select the continuing changes between maps that exceed the tolerance."""
    wanted = min((line.limit for line in recipe.lines if line.unit == "nm"), default=MOST_DRIFT_NM)
    return residual_diagnosis.limiting_change(moves, wanted)


def in_part_frame(recipe: Recipe, program: Program) -> Program:
    """Transform a program's points and axes into the part's frame, unless they are there already."""
    if program.frame == "part":
        return program
    turn = rotation_from_rpy_deg(0.0, 0.0, recipe.program.rotation_deg).T
    offset = np.asarray(recipe.program.offset_mm)
    return replace(
        program,
        start_mm=program.start_mm @ turn + offset,
        end_mm=program.end_mm @ turn + offset,
        axis=program.axis @ turn,
        frame="part",
    )


def executed_surface(recipe: Recipe, program: Program) -> Program:
    """The program in the part's frame with the tool's axis; without one in the program, the cell's dip is used.

    ``run`` refuses a program without an axis (``violations``), since the robot would not dip the tool.
    """
    part = in_part_frame(recipe, program)
    if _states_no_axis(recipe, program):
        dip_deg = recipe.process.dip_deg
        part = replace(part, axis=tool_axes(part.end_mm, recipe.optic, dip_deg, recipe.options, recipe.placement))
    return part


def _states_no_axis(recipe: Recipe, program: Program) -> bool:
    return recipe.process.dip_deg > 0 and bool(np.all(program.axis == (0.0, 0.0, 1.0)))


def effect_of(recipe: Recipe, program: Program, grid: Grid, believed: EstimatesInUse | None = None) -> RemovalAnswer:
    """Compliance, gamma and effect along the program on the process grid; ``believed`` is None before a pass."""
    return recipe.model.effect(request_of(recipe, program, grid, believed or initial_estimates(recipe)))


def request_of(recipe: Recipe, program: Program, grid: Grid, believed: EstimatesInUse) -> RemovalRequest:
    """Request to a removal model for a program."""
    return RemovalRequest(
        program=executed_surface(recipe, program),
        grid=grid,
        process=recipe.process,
        robot=recipe.robot,
        placement=recipe.placement,
        correction=recipe.correction,
        rate=believed.rate,
        options=recipe.options,
        optic=recipe.optic,
        tif=recipe.tif,
        rim=recipe.outline if recipe.part.free_edge else None,
        beliefs=believed.removal,
    )


def learn(recipe: Recipe, program: Program, done: ExecutedPass, believed: EstimatesInUse) -> LearnResult:
    """Compare predicted with measured removal of the last pass, and update the estimates.

    The estimates stay where the removal check stops, or where another map is needed first (`LearnResult.doubted`).
    """
    grid, mask = done.before.grid, done.before.metric_mask
    request = request_of(recipe, program, grid, believed)
    answer = recipe.model.effect(request)
    predicted = answer.removal_nm(done.acted_s)
    measured = done.before.height_nm - done.after.height_nm
    low, high = 1 - recipe.max_rate_change, 1 + recipe.max_rate_change
    allowed = (low / believed.rate, high / believed.rate)
    miss = TOUCH_MISS_MM if recipe.dwell.objective == AS_PROGRAMMED else removal_check.MAX_SHIFT_MM
    unknown = _unknown(recipe)
    verdict = removal_check.check_removal(
        predicted, measured, mask, grid.pitch_mm, allowed, removal=unknown, most_shift_mm=miss
    )
    left = fit_residual(measured, mask, grid.pitch_mm, predicted, removal=unknown)
    removed_nm = float(np.sqrt(np.mean(predicted[mask] ** 2)))
    named = residual_diagnosis.diagnose_pass(verdict, left, removed_nm, done.again, miss)
    taught = LearnResult(believed, verdict, grid, named=named)
    if verdict.stop or taught.doubted:
        return taught
    evidence = PassEvidence(
        beliefs=believed.removal,
        executed_s=done.executed_s,
        predicted_nm=verdict.predicted_nm,
        measured_nm=verdict.measured_nm,
        mask=mask,
        pitch_mm=grid.pitch_mm,
        tells_rate=verdict.tells_rate,
        rates=(low, high),
        acted_s=done.acted_s,
        noise_nm=_change_noise_nm(recipe),
        pixels=_pixels(done.before, done.after),
        most_miss_mm=miss,
        must_tell=recipe.dwell.objective == AS_PROGRAMMED,
    )
    lesson = recipe.model.learn(request, evidence)
    if lesson.stop:
        stopped = replace(verdict, stop=lesson.stop)
        return replace(taught, verdict=stopped, notes=lesson.notes)
    envelope = envelope_of(recipe, program, believed)
    overhead = motion.learn_overhead_s(program, done.asked_s, done.executed_s, envelope)
    shown = pass_indicators(done, answer, predicted, verdict, believed.rate)
    rest, ripple = None, believed.ripple
    if recipe.dwell.objective != AS_PROGRAMMED:  # of narrow tracks both are what the grid does not resolve
        rest = unexplained_share(predicted, measured, mask, acceptance.noise_nm(recipe, done.after))
        ripple = acceptance.ripple(recipe, done.before, done.after, removed_nm)
    learned = EstimatesInUse(lesson.beliefs, overhead, pool_unexplained(believed.unexplained, rest), ripple)
    notes = (*(one.words for one in taught.named), *lesson.notes)
    return replace(taught, believed=learned, found=lesson.found, notes=notes, shown=shown)


def _pixels(before: MeasureResult, after: MeasureResult) -> MapPixels | None:
    """Pixels of both maps where the part has the same registration in both; None otherwise."""
    grid, lies, was = after.map_grid, after.registration, before.registration
    if grid is None or before.map_grid != grid:
        return None
    turned_mm = np.radians(abs(lies.rotation_deg - was.rotation_deg)) * grid.pitch_mm * max(grid.shape) / 2
    if lies.drift_mm(was) + turned_mm > ALIKE * grid.pitch_mm:
        return None
    return MapPixels(grid, lies.rotation_deg, lies.shift_mm)


def _unknown(recipe: Recipe) -> Removal:
    """Terms to remove from the change between two maps: the part is mounted anew for each map."""
    return "power" if recipe.part.alignment == "power" else "tilt"


def _change_noise_nm(recipe: Recipe) -> float | None:
    """Noise of a sample in the change between two maps; None where the instrument's repeatability is unknown."""
    one = None if recipe.instrument is None else recipe.instrument.repeatability_nm
    return None if one is None else 2**0.5 * one


def rewrite(recipe: Recipe, program: Program, solved: SolveResult, name: str) -> Plan:
    """Rewrite the program, read it back from its bytes, and add its expected times and removal."""
    text = recipe.format.rewrite(program, solved.asked_s)
    rewritten = recipe.format.read_rewritten(program, text, name)
    if rewritten.n != program.n or not np.array_equal(rewritten.end_mm, program.end_mm):
        raise ComputeError(f"{name}: the rewritten program does not read back as the same path; nothing was sent")
    expected = motion.delivered_time_s(rewritten, rewritten.time_s, envelope_of(recipe, program, solved.believed))
    answer = solved.answer
    if isinstance(answer.effect, CachedEffect) and not answer.effect.here:  # the worker that solved has ended
        answer = effect_of(recipe, program, answer.effect.grid, solved.believed)
    effect = answer.effect
    share = effect.negligible if isinstance(effect, CachedEffect) else negligible_share(effect)
    return Plan(
        program=rewritten,
        approach_blocks=int(rewritten.block[0]),
        contact_blocks=int(rewritten.block[-1]) + 1,
        expected_time_s=expected,
        predicted_removal_nm=without_traces(answer.removal_nm(expected), share),
        segments=Segments(rewritten.text),
        grid=effect.grid,
    )


def envelope_of(recipe: Recipe, program: Program, believed: EstimatesInUse | None = None) -> Envelope:
    """The machine's limits with the estimated overhead, inside those of the program's language.

    Moves to a dwell run at the program's own feed. ComputeError where machine and language have no speed in common.
    """
    envelope = recipe.envelope
    if believed is not None and believed.block_overhead_s:
        envelope = replace(envelope, block_overhead_s=believed.block_overhead_s)
    feed = program.max_feed_mm_min / 60
    if program.encoding == "dwell" and 0 < feed < envelope.max_feed_mm_s:
        envelope = replace(envelope, max_feed_mm_s=feed)
    timing = program.timing
    if timing is None:
        return envelope
    least = max(envelope.min_feed_mm_s, timing.least_mm_s)
    greatest = min(envelope.max_feed_mm_s, timing.greatest_mm_s)
    if least >= greatest:
        raise ComputeError(
            f"{program.name}: {program.dialect} states {timing.least_mm_s:g} to {timing.greatest_mm_s:g} mm/s, the "
            f"machine runs {envelope.min_feed_mm_s:g} to {envelope.max_feed_mm_s:g} mm/s. "
            "Correct [machine] of the cell, or move_time of the dialect's profile."
        )
    if program.encoding == "time" and program.length_mm.any():
        # a written time is within one step of the wanted one, which must not make a move faster than the machine
        shortest_mm = float(program.length_mm[program.length_mm > 0.0].min())
        greatest = shortest_mm / (shortest_mm / greatest + timing.resolution_s)
    return replace(envelope, min_feed_mm_s=least, max_feed_mm_s=max(greatest, least))


def violations(recipe: Recipe, plan: Plan) -> list[str]:
    """List the reasons against running a plan: no tool axis, or landing points on the part.

    The tool stands still at a landing point while the force rises and falls.
    """
    program = in_part_frame(recipe, plan.program)
    found = []
    if _states_no_axis(recipe, plan.program):
        found.append(
            f"{program.name}: states no tool axis (A and C words), and the process dips the tool by "
            f"{recipe.process.dip_deg:g} deg: post it with its axis"
        )
    ends = (("starts", program.line[0], program.start_mm[0]), ("ends", program.line[-1], program.end_mm[-1]))
    return found + [
        f"{program.name}:{line}: contact {word} at {point[0]:.2f}, {point[1]:.2f} mm, on the part, {recipe.outline}; a "
        "tool that stands still there digs a pit: lead in from and out to a landing point beside the part"
        for word, line, point in ends
        if recipe.outline.contains(point[0], point[1])
    ]


def process_grid(recipe: Recipe) -> Grid:
    """The grid for all surfaces: the aperture and a margin, centered on the part."""
    return conditioning.process_grid(recipe.outline, recipe.grid_mm)
