"""The computing steps of a cycle: plain functions on arrays, run in the compute worker (so they pickle)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from polishd.hookspecs import RemovalAnswer, RemovalRequest
from polishd.model.beliefs import MapPixels, PassEvidence
from polishd.model.cause import Diagnosis
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ComputeError
from polishd.model.limits import Envelope
from polishd.model.program import Plan, Program, Segments
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process import conditioning, gate, metrics, motion, naming
from polishd.process.alignment import alignment_notes
from polishd.process.conditioning import Masks
from polishd.process.dwell.validation import negligible, without_traces
from polishd.process.forecast import pooled, unexplained
from polishd.process.leftover import leftover
from polishd.process.paths.wrist import tool_axes
from polishd.process.registration.record import Registration
from polishd.process.registration.register import register
from polishd.process.removal_fit import MOST_DRIFT_NM
from polishd.process.tolerance import judge, notes_of
from polishd.recipe import accepting, figuring, forecasting
from polishd.recipe.files import read_program_bytes
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import CENTRED, EstimatesInUse, ExecutedPass, LearnResult, MeasureResult, SolveResult
from polishd.recipe.showing import pass_indicators
from polishd.recipe.staying import CachedEffect

ALIKE = 0.2
"""Share of a map's sample by which the part may lie elsewhere in the next one, the samples being taken for the same."""
TOUCH_MISS_MM = 3.0
"""So far off where it should the spot may act in a pass as programmed: to find that out is what it is made for."""


def read_program(recipe: Recipe, path: Path) -> Program:
    """Read the job's program; ProgramError names file and line."""
    return recipe.format.read(read_program_bytes(path), path.name)


def initial_estimates(recipe: Recipe) -> EstimatesInUse:
    """What is believed before anything was polished."""
    return EstimatesInUse(recipe.model.beliefs, recipe.envelope.block_overhead_s)


def condition(
    recipe: Recipe, surface: SurfaceMap, masks: Masks | None = None, last: Registration | None = None
) -> MeasureResult:
    """Bring a map onto the process grid and state its figures; BadMap where it cannot be trusted.

    ``masks`` and ``last`` are of earlier maps of the part: its frozen masks, and where it lay in the last one.
    """
    profiled = figuring.map_on_part(surface, recipe.instrument, recipe.system)
    lies = CENTRED
    if recipe.instrument is not None:
        lies = register(profiled, recipe.instrument, recipe.outline, last)
    clean, spikes = figuring.of_part(profiled, recipe.spike_mads, recipe.nominal, lies)
    part = conditioning.condition(
        clean,
        outline=recipe.outline,
        edge_mm=recipe.part.edge_mm,
        grid_mm=recipe.grid_mm,
        masks=masks,
        removal=recipe.part.alignment,
        registration=lies,
    )
    figure, clear = figuring.figure_of(clean, part.grid, part.metric_mask, lies, recipe.part.alignment)
    stats = metrics.surface_stats(
        figure,
        clear,
        clean.grid.pitch_mm,
        lsf_period_mm=recipe.job.lsf_period_mm,
        band_period_mm=recipe.job.tolerance_period_mm or None,
    )
    height = np.where(part.solve_mask, part.height_nm, 0.0)
    repeats = None if recipe.instrument is None else recipe.instrument.repeatability_nm
    judged = judge(recipe.lines, figure, clear, clean.grid.pitch_mm, repeats)
    judged = accepting.bounded(recipe, judged, figure, clear, clean.grid.pitch_mm)
    wanted = min((line.limit for line in recipe.lines if line.unit == "nm"), default=0.0)
    notes = (*alignment_notes(clean.height_nm, clear, recipe.part.alignment, wanted), *notes_of(judged))
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
    """The measurement of a surface that a pass is expected to leave, (ny, nx) on the process grid: nobody's map."""
    stats = metrics.surface_stats(
        residual_nm,
        before.metric_mask,
        before.grid.pitch_mm,
        lsf_period_mm=recipe.job.lsf_period_mm,
        band_period_mm=recipe.job.tolerance_period_mm or None,
    )
    height = np.where(before.solve_mask & np.isfinite(residual_nm), residual_nm, 0.0)
    return replace(before, height_nm=height, stats=stats, sha256="", notes=(), judged=(), spikes=0)


def map_change_nm(recipe: Recipe, before: MeasureResult, after: MeasureResult) -> float:
    """RMS in the clear aperture of what changed from one measurement to the next, without its alignment."""
    changed = metrics.without(after.height_nm - before.height_nm, before.metric_mask, _unknown(recipe))
    return float(np.sqrt(np.mean(changed[before.metric_mask] ** 2)))


def map_changes(recipe: Recipe, before: MeasureResult, after: MeasureResult) -> tuple[Diagnosis, ...]:
    """What a measurement and a later one name, with no pass between."""
    grid, mask = before.grid, before.metric_mask
    lost_nm = before.height_nm - after.height_nm
    return naming.diagnose_change(leftover(lost_nm, mask, grid.pitch_mm, removal=_unknown(recipe)))


def harmful_changes(recipe: Recipe, moves: tuple[Diagnosis, ...]) -> tuple[Diagnosis, ...]:
    """Of what goes on changing from map to map that which the tolerance does not bear."""
    wanted = min((line.limit for line in recipe.lines if line.unit == "nm"), default=MOST_DRIFT_NM)
    return naming.harmful(moves, wanted)


def in_part_frame(recipe: Recipe, program: Program) -> Program:
    """The same program with its points and axes in the part's frame; one that is there already stays."""
    if program.frame == "part":
        return program
    turn = scipy.spatial.transform.Rotation.from_euler("z", recipe.program.rotation_deg, degrees=True)
    offset = np.asarray(recipe.program.offset_mm)
    return replace(
        program,
        start_mm=turn.apply(program.start_mm) + offset,
        end_mm=turn.apply(program.end_mm) + offset,
        axis=turn.apply(program.axis),
        frame="part",
    )


def executed_surface(recipe: Recipe, program: Program) -> Program:
    """The program in the part's frame, with the tool's axis: where it states none, the way the cell dips.

    ``run`` refuses a program that states none (``violations``), since the robot would not know.
    """
    part = in_part_frame(recipe, program)
    if _states_no_axis(recipe, program):
        dip_deg = recipe.process.dip_deg
        part = replace(part, axis=tool_axes(part.end_mm, recipe.optic, dip_deg, recipe.options, recipe.placement))
    return part


def _states_no_axis(recipe: Recipe, program: Program) -> bool:
    return recipe.process.dip_deg > 0 and bool(np.all(program.axis == (0.0, 0.0, 1.0)))


def effect_of(recipe: Recipe, program: Program, grid: Grid, believed: EstimatesInUse | None = None) -> RemovalAnswer:
    """Compliance, gamma and effect along the program, on the process grid, by what is believed: None before a pass."""
    return recipe.model.effect(request_of(recipe, program, grid, believed or initial_estimates(recipe)))


def request_of(recipe: Recipe, program: Program, grid: Grid, believed: EstimatesInUse) -> RemovalRequest:
    """What a removal model is asked for a program."""
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
        rim=recipe.outline if recipe.part.rim == "free" else None,
        beliefs=believed.removal,
    )


def learn(recipe: Recipe, program: Program, done: ExecutedPass, believed: EstimatesInUse) -> LearnResult:
    """Compare predicted with measured removal of the last pass.

    Nothing is learned from it where the gate stops, nor where another map must tell first (`Taught.doubted`).
    """
    grid, mask = done.before.grid, done.before.metric_mask
    request = request_of(recipe, program, grid, believed)
    answer = recipe.model.effect(request)
    predicted = answer.removal_nm(done.acted_s)
    measured = done.before.height_nm - done.after.height_nm
    low, high = 1 - recipe.max_rate_change, 1 + recipe.max_rate_change
    allowed = (low / believed.rate, high / believed.rate)
    miss = TOUCH_MISS_MM if recipe.dwell.choose == AS_PROGRAMMED else gate.MAX_SHIFT_MM
    unknown = _unknown(recipe)
    verdict = gate.judge(predicted, measured, mask, grid.pitch_mm, allowed, removal=unknown, most_shift_mm=miss)
    left = leftover(measured, mask, grid.pitch_mm, predicted, removal=unknown)
    removed_nm = float(np.sqrt(np.mean(predicted[mask] ** 2)))
    named = naming.diagnose_pass(verdict, left, removed_nm, done.again, miss)
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
        must_tell=recipe.dwell.choose == AS_PROGRAMMED,
    )
    lesson = recipe.model.learn(request, evidence)
    if lesson.stop:
        stopped = replace(verdict, stop=lesson.stop)
        return replace(taught, verdict=stopped, notes=lesson.notes)
    envelope = envelope_of(recipe, program, believed)
    overhead = motion.learn_overhead_s(program, done.asked_s, done.executed_s, envelope)
    shown = pass_indicators(done, answer, predicted, verdict, believed.rate)
    rest, ripple = None, believed.ripple
    if recipe.dwell.choose != AS_PROGRAMMED:  # of narrow tracks both are what the grid does not resolve
        rest = unexplained(predicted, measured, mask, forecasting.noise_nm(recipe, done.after))
        ripple = forecasting.ripple(recipe, done.before, done.after, removed_nm)
    learned = EstimatesInUse(lesson.beliefs, overhead, pooled(believed.unexplained, rest), ripple)
    notes = (*(one.words for one in taught.named), *lesson.notes)
    return replace(taught, believed=learned, found=lesson.found, notes=notes, shown=shown)


def _pixels(before: MeasureResult, after: MeasureResult) -> MapPixels | None:
    """Of both maps, where the part lay alike in both."""
    grid, lies, was = after.map_grid, after.registration, before.registration
    if grid is None or before.map_grid != grid:
        return None
    turned_mm = np.radians(abs(lies.rotation_deg - was.rotation_deg)) * grid.pitch_mm * max(grid.shape) / 2
    if lies.drift_mm(was) + turned_mm > ALIKE * grid.pitch_mm:
        return None
    return MapPixels(grid, lies.rotation_deg, lies.shift_mm)


def _unknown(recipe: Recipe) -> metrics.Removal:
    """Of the change from one map to the next: the part is set up anew for each, even where tilt is figure."""
    return "power" if recipe.part.alignment == "power" else "tilt"


def _change_noise_nm(recipe: Recipe) -> float | None:
    """Of the change from one map to the next, a sample; None where nothing is known of the instrument's."""
    one = None if recipe.instrument is None else recipe.instrument.repeatability_nm
    return None if one is None else 2**0.5 * one


def rewrite(recipe: Recipe, program: Program, solved: SolveResult, name: str) -> Plan:
    """The rewritten program, read back from its own bytes, with what it is expected to do."""
    text = recipe.format.rewrite(program, solved.asked_s)
    rewritten = recipe.format.read(text, name)
    if rewritten.n != program.n or not np.array_equal(rewritten.end_mm, program.end_mm):
        raise ComputeError(f"{name}: the rewritten program does not read back as the same path; nothing was sent")
    expected = motion.delivered_time_s(rewritten, rewritten.time_s, envelope_of(recipe, program, solved.believed))
    answer = solved.answer
    if isinstance(answer.effect, CachedEffect) and not answer.effect.here:  # the worker that solved is no more
        answer = effect_of(recipe, program, answer.effect.grid, solved.believed)
    effect = answer.effect
    share = effect.negligible if isinstance(effect, CachedEffect) else negligible(effect)
    return Plan(
        program=rewritten,
        approach_blocks=int(rewritten.block[0]),
        contact_blocks=int(rewritten.block[-1]) + 1,
        expected_time_s=expected,
        predicted_removal_nm=without_traces(answer.removal_nm(expected), share),
        segments=Segments(rewritten.text),
    )


def envelope_of(recipe: Recipe, program: Program, believed: EstimatesInUse | None = None) -> Envelope:
    """The machine's limits with the overhead that was learned; moves to a dwell run at the program's own feed."""
    envelope = recipe.envelope
    if believed is not None and believed.block_overhead_s:
        envelope = replace(envelope, block_overhead_s=believed.block_overhead_s)
    feed = program.max_feed_mm_min / 60
    if program.encoding == "dwell" and 0 < feed < envelope.max_feed_mm_s:
        envelope = replace(envelope, max_feed_mm_s=feed)
    return envelope


def violations(recipe: Recipe, plan: Plan) -> list[str]:
    """What forbids to run a plan: no tool axis, or landing points on the part.

    The tool stands still at a landing point while the force comes and goes.
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
    """The grid that surfaces are brought to: the aperture and a margin, centred on the part."""
    return conditioning.process_grid(recipe.outline, recipe.grid_mm)
