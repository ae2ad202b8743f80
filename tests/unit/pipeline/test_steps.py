"""The computing steps on a small part: frames, coverage, overhead, certificates, and what is read back."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from polishd.hookspecs import DwellSolver, ProgramFormat, RemovalModel
from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError, MapError, ProgramError
from polishd.model.instrument import Instrument
from polishd.model.process import ComplianceOptions, MeasuredTif, Optic, Placement
from polishd.model.program import Program
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.acceptance import forecast_of
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse, ExecutedPass, MeasureResult, SolveResult, made_ripple
from polishd.plugins import dwell_solvers
from polishd.plugins.plan_checks import polishd_check_plan
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import format_of
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.frames import dips_deg, surface_normals
from polishd.process.metrology.statistics import fit_terms, remove_terms
from polishd.process.removal.ripple import Ripple
from polishd.process.robot import motion
from tests.rs274 import RS274
from tests.unit.daemon.small_job import (
    APERTURE_MM,
    at_rate,
    gaussian_effect,
    pointwise_effect,
    small_map,
    small_program,
    small_recipe,
    small_text,
)
from tests.unit.process.gaussian import rough

HOME = Placement((0.0, 0.0, 0.0), np.eye(3))


@pytest.fixture(scope="module")
def program() -> Program:
    return small_program()


@pytest.fixture(scope="module")
def measured() -> MeasureResult:
    return steps.condition(small_recipe(), small_map())


@pytest.fixture(scope="module")
def solved(program: Program, measured: MeasureResult) -> SolveResult:
    return dwell_step.solve(small_recipe(), program, measured)


def dwelling(text: bytes = b"") -> bytes:
    """A program whose points dwell, 1 mm from one another."""
    lines = [b"G1 X%d F600\nG4 P0.5\n" % x for x in range(-14, 15)]
    return text or b"G21 G90 G94\nG0 X-20 Y0 Z5\nG0 Z0\n" + b"".join(lines) + b"G0 Z5\nM2\n"


# frames


def test_in_part_frame_turns_first_and_moves_then(program: Program) -> None:
    recipe = small_recipe(rotation_deg=90.0, offset_mm=(1.0, 2.0, 3.0))
    tilted = replace(program, axis=np.tile([0.6, 0.0, 0.8], (program.n, 1)))
    part = steps.in_part_frame(recipe, tilted)
    x, y, z = program.end_mm.T
    assert part.end_mm == pytest.approx(np.column_stack([1 - y, 2 + x, 3 + z]))
    assert part.start_mm[0] == pytest.approx([1 - program.start_mm[0, 1], 2 + program.start_mm[0, 0], 3])
    assert part.axis[0] == pytest.approx([0.0, 0.6, 0.8]), "an axis is turned, not moved"
    assert part.text == program.text
    assert (program.frame, part.frame) == ("program", "part")
    assert steps.in_part_frame(recipe, part) is part, "it is not turned twice"


def test_no_rotation_and_no_offset_change_nothing(program: Program) -> None:
    assert np.array_equal(steps.in_part_frame(small_recipe(), program).end_mm, program.end_mm)


def test_effect_lies_where_the_part_frame_says(program: Program, measured: MeasureResult) -> None:
    """A program that covers the upper half of the part, turned by 180 degrees, works the lower half."""
    upper = program.end_mm[:, 1] > 4
    time = upper.astype(float)
    plain = steps.effect_of(small_recipe(), program, measured.grid).effect.removal_nm(time)
    turned = small_recipe(rotation_deg=180.0)
    other = steps.effect_of(turned, program, measured.grid).effect.removal_nm(time)
    above = measured.grid.y_mm[:, None] + 0 * measured.grid.x_mm > 0
    assert plain[above].sum() > 50 * plain[~above].sum()
    assert other[~above].sum() > 50 * other[above].sum()


def test_effect_follows_the_rate(program: Program, measured: MeasureResult) -> None:
    one, two = (
        steps.effect_of(small_recipe(), program, measured.grid, at_rate(rate)).effect.removal_nm(program.time_s)
        for rate in (1.0, 1.2)
    )
    assert two.max() == pytest.approx(1.2 * one.max())


def test_a_program_without_an_axis_is_dipped_inward(program: Program) -> None:
    dipped = small_recipe(process=replace(small_recipe().process, dip_deg=15.0))
    axis = steps.executed_surface(dipped, program).axis
    assert axis[:, 2] == pytest.approx(np.cos(np.radians(15.0)))
    stated = replace(program, axis=np.tile([0.6, 0.0, 0.8], (program.n, 1)))
    assert np.array_equal(steps.executed_surface(dipped, stated).axis, stated.axis)
    assert np.array_equal(steps.executed_surface(small_recipe(), program).axis, program.axis), "no dip, no tilt"


# measure


def test_condition_states_figures_and_freezes_masks(measured: MeasureResult) -> None:
    assert measured.stats.rms_nm == pytest.approx(20.0, rel=0.3)
    assert measured.stats.band_rms_nm is None
    assert np.isfinite(measured.height_nm).all()
    assert abs(measured.height_nm[measured.metric_mask].mean()) < 1e-6
    radius = measured.grid.radius_mm()
    assert radius[measured.metric_mask].max() <= APERTURE_MM / 2 - 2
    again = steps.condition(small_recipe(), small_map(seed=1), measured.masks)
    assert np.array_equal(again.solve_mask, measured.solve_mask)


def test_condition_refuses_masks_of_another_grid(measured: MeasureResult) -> None:
    with pytest.raises(MapError, match="masks"):
        steps.condition(small_recipe(grid_mm=2.0), small_map(), measured.masks)


def test_a_band_is_stated_where_the_tolerance_has_one() -> None:
    stats = steps.condition(small_recipe(tolerance_period_mm=12.0), small_map()).stats
    assert stats.band_rms_nm is not None
    assert 0 < stats.band_rms_nm < stats.rms_nm


def test_tilt_is_figure_unless_it_is_alignment() -> None:
    surface = small_map()
    tilted = surface.with_height(surface.height_nm + 10.0 * surface.grid.x_mm)
    assert steps.condition(small_recipe(alignment="piston"), tilted).stats.rms_nm > 40
    levelled = steps.condition(small_recipe(), tilted)
    assert np.ptp(levelled.height_nm) < 200
    plain = steps.condition(small_recipe(), surface)
    assert levelled.stats.rms_nm == pytest.approx(plain.stats.rms_nm, rel=1e-6), "the figure has no alignment in it"


def test_power_may_be_alignment_too(program: Program, measured: MeasureResult, solved: SolveResult) -> None:
    recipe = small_recipe(alignment="power")
    surface = small_map()
    bowl = surface.with_height(surface.height_nm + 3.0 * surface.grid.radius_mm() ** 2)
    found, plain = (steps.condition(recipe, map_) for map_ in (bowl, surface))
    assert found.stats.rms_nm == pytest.approx(plain.stats.rms_nm, rel=1e-6)
    plan = steps.rewrite(recipe, program, solved, "p.rnc")
    lost = 2.0 * measured.grid.radius_mm() ** 2  # the next alignment hides or shows as much
    after = replace(measured, height_nm=measured.height_nm - 0.9 * plan.predicted_removal_nm + lost)
    taught = steps.learn(
        recipe, program, ExecutedPass(measured, after, solved.asked_s, plan.expected_time_s), EstimatesInUse()
    )
    assert not taught.verdict.stop
    assert taught.believed.rate == pytest.approx(0.9, abs=0.01)


def test_spikes_and_the_nominal_form_are_taken_off() -> None:
    surface = small_map()
    form = surface.with_height(40.0 * np.sin(surface.grid.x_mm / 3.0)[None, :] * np.ones(surface.grid.shape))
    spiked = surface.height_nm + form.height_nm
    spiked[surface.grid.ny // 2, surface.grid.nx // 2] += 1e5
    recipe = small_recipe(nominal=form, spike_threshold_mad=50.0)
    found = steps.condition(recipe, surface.with_height(spiked))
    assert found.spikes == 1
    plain = steps.condition(small_recipe(), surface)
    assert found.stats.rms_nm == pytest.approx(plain.stats.rms_nm, rel=0.01)
    assert steps.condition(small_recipe(), surface.with_height(spiked)).stats.rms_nm > 10 * plain.stats.rms_nm


# solve


def test_solve_makes_the_surface_flat(solved: SolveResult) -> None:
    certificate = solved.dwell.certificate
    assert certificate.kkt_residual <= 1e-4
    assert certificate.predicted_rms_nm < 2.0
    assert certificate.cross_check is certificate.cross_check_gap is None


# pointwise: the static problem, divided by gamma

POINTWISE = RemovalModel("pointwise", pointwise_effect)


def test_pointwise_is_the_static_dwell_divided_by_gamma_within_the_real_bounds(
    program: Program, measured: MeasureResult
) -> None:
    recipe = small_recipe(model=POINTWISE, envelope=replace(small_recipe().envelope, accel_mm_s2=1e9))
    solved = dwell_step.solve(recipe, program, measured)
    gamma, dwell = solved.answer.gamma, solved.dwell
    least = program.length_mm / recipe.envelope.max_feed_mm_s
    np.testing.assert_allclose(dwell.lower_s, least, rtol=1e-5)
    assert (dwell.time_s >= dwell.lower_s * (1 - 1e-12)).all()
    assert (dwell.time_s <= dwell.upper_s * (1 + 1e-12)).all()
    assert (np.abs(dwell.time_s / dwell.lower_s - 1) < 1e-6).any(), "the bound is met somewhere"
    static = solved.answer.effect.removal_nm(dwell.time_s * gamma)
    np.testing.assert_allclose(dwell.removal_nm, static, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(solved.answer.removal_nm(dwell.time_s), static, rtol=1e-12)
    assert dwell.certificate.dwell_total_s == pytest.approx(dwell.time_s.sum())


def test_pointwise_asks_for_the_same_flat_surface_in_more_time(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    pointwise = dwell_step.solve(small_recipe(model=POINTWISE), program, measured)
    assert pointwise.dwell.certificate.predicted_rms_nm < 1.5 * solved.dwell.certificate.predicted_rms_nm
    more = pointwise.dwell.certificate.dwell_total_s / solved.dwell.certificate.dwell_total_s
    assert 1.1 < more < 1.4


def test_what_was_planned_and_learned_pointwise_knows_of_the_division(
    program: Program, measured: MeasureResult
) -> None:
    recipe = small_recipe(model=POINTWISE)
    solved = dwell_step.solve(recipe, program, measured)
    plan = steps.rewrite(recipe, program, solved, "p.rnc")
    np.testing.assert_allclose(plan.predicted_removal_nm, solved.answer.removal_nm(plan.expected_time_s), rtol=1e-12)
    after = replace(measured, height_nm=measured.height_nm - 0.93 * plan.predicted_removal_nm)
    done = ExecutedPass(measured, after, solved.asked_s, plan.expected_time_s)
    assert steps.learn(recipe, program, done, EstimatesInUse()).believed.rate == pytest.approx(0.93, rel=1e-3)


def test_the_physics_of_the_recipe_reaches_the_removal_model(program: Program, measured: MeasureResult) -> None:
    asked: list[object] = []

    def ask(request: object) -> object:
        asked.append(request)
        return gaussian_effect(request)  # type: ignore[arg-type]

    options = ComplianceOptions(projection="normal", dip_direction="fixed")
    tif = MeasuredTif(np.ones((3, 3)), 0.1)
    recipe = small_recipe(model=RemovalModel("asked", ask), options=options, optic=Optic(800.0), tif=tif)  # type: ignore[arg-type]
    steps.effect_of(recipe, program, measured.grid)
    (request,) = asked
    assert (request.options, request.optic, request.tif) == (options, Optic(800.0), tif)  # type: ignore[attr-defined]


def test_a_program_without_an_axis_is_dipped_as_the_cell_dips(program: Program) -> None:
    process = replace(small_recipe().process, dip_deg=15.0)
    fixed = ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=40.0)
    part = steps.executed_surface(small_recipe(process=process, options=fixed, optic=Optic(500.0)), program)
    normal = surface_normals(HOME, part.end_mm, Optic(500.0))
    assert dips_deg(part.axis, normal) == pytest.approx(15.0)
    middle = np.argmin(np.hypot(*part.end_mm[:, :2].T))
    assert np.degrees(np.arctan2(part.axis[middle, 1], part.axis[middle, 0])) == pytest.approx(40.0, abs=1.0)


def test_a_path_that_covers_half_the_part_is_refused(measured: MeasureResult) -> None:
    with pytest.raises(ProgramError, match=r"small\.rnc: the path reaches \d+% of the clear aperture"):
        dwell_step.solve(small_recipe(), small_program(3.0), measured)


def test_a_program_in_another_frame_is_refused(program: Program, measured: MeasureResult) -> None:
    away = small_recipe(offset_mm=(15.0, 0.0, 0.0))
    with pytest.raises(ProgramError, match="offset_mm"):
        dwell_step.solve(away, program, measured)


def test_the_overhead_is_taken_off_what_is_asked(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    overhead = 0.02
    late = dwell_step.solve(small_recipe(), program, measured, EstimatesInUse(block_overhead_s=overhead))
    assert late.asked_s == pytest.approx(np.maximum(late.dwell.time_s - overhead, 0.0))
    assert (late.dwell.lower_s >= overhead).all(), "no block is done sooner"
    assert (late.expected_s >= overhead).all()
    assert solved.asked_s == pytest.approx(solved.dwell.time_s), "without overhead what is wanted is asked"


def test_what_acceleration_delivers_is_known_to_the_optimum(
    program: Program, measured: MeasureResult, solved: SolveResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dwell_step, "ENVELOPE_ROUNDS", 0)
    naive = dwell_step.solve(small_recipe(), program, measured)
    wrong, known = (float(np.maximum(s.expected_s - s.dwell.time_s, 0).sum()) for s in (naive, solved))
    assert known < 0.8 * wrong
    assert solved.expected_s.sum() == pytest.approx(solved.dwell.time_s.sum(), rel=0.01)


def test_beliefs_come_before_the_data_sheet(program: Program, measured: MeasureResult) -> None:
    recipe = small_recipe(envelope=replace(small_recipe().envelope, block_overhead_s=0.05))
    stated = dwell_step.solve(recipe, program, measured)
    learned = dwell_step.solve(recipe, program, measured, EstimatesInUse(block_overhead_s=0.01))
    assert stated.dwell.lower_s.min() >= 0.05 > learned.dwell.lower_s.min() >= 0.01


# the cross-check


def checked(recipe: Recipe, program: Program, measured: MeasureResult) -> DwellSolution:
    return dwell_step.solve(recipe, program, measured).dwell


def test_an_independent_solver_agrees(program: Program, measured: MeasureResult) -> None:
    recipe = small_recipe(cross_check=DwellSolver("qp", dwell_solvers.solve_qp), cross_check_above=0.0)
    certificate = checked(recipe, program, measured).certificate
    assert certificate.cross_check == "qp"
    assert certificate.cross_check_gap == pytest.approx(0.0, abs=1e-3)


def test_the_gap_says_by_how_much_the_other_is_better(program: Program, measured: MeasureResult) -> None:
    def better(problem: DwellProblem, within_s: float) -> DwellSolution:
        found = newton_cg.solve(problem, within_s)
        return replace(found, certificate=replace(found.certificate, objective=found.certificate.objective / 1.25))

    certificate = checked(
        small_recipe(cross_check=DwellSolver("better", better), cross_check_above=0.0), program, measured
    ).certificate
    assert certificate.cross_check == "better"
    assert certificate.cross_check_gap == pytest.approx(0.25)


@pytest.mark.full
def test_no_operator_is_asked_about_what_is_proved(program: Program, measured: MeasureResult) -> None:
    def never(problem: DwellProblem, within_s: float) -> DwellSolution:
        raise AssertionError("was asked")

    proved = checked(small_recipe(cross_check=DwellSolver("never", never)), program, measured).certificate
    assert proved.gap is not None
    assert 0.0 <= proved.gap <= 1e-4
    assert proved.cross_check is None
    sharper = small_recipe(cross_check=DwellSolver("never", never), cross_check_above=proved.gap / 2)
    more = checked(sharper, program, measured).certificate
    assert more.cross_check is None
    assert more.gap is not None
    assert more.gap <= proved.gap / 2
    doubtful = small_recipe(cross_check=DwellSolver("qp", dwell_solvers.solve_qp), cross_check_above=1e-13)
    assert checked(doubtful, program, measured).certificate.cross_check == "qp"


def test_a_cross_check_that_fails_is_noted(program: Program, measured: MeasureResult) -> None:
    def fails(problem: DwellProblem, within_s: float) -> DwellSolution:
        raise ComputeError("out of time")

    certificate = checked(
        small_recipe(cross_check=DwellSolver("slow", fails), cross_check_above=0.0), program, measured
    ).certificate
    assert certificate.cross_check is certificate.cross_check_gap is None
    assert certificate.notes[-1] == "cross-check by slow failed: out of time"


# rewrite


def test_rewrite_reads_back(program: Program, solved: SolveResult) -> None:
    plan = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    assert plan.program.time_s == pytest.approx(solved.asked_s, rel=0.02, abs=0.01)
    assert plan.program.sha256 != program.sha256
    assert (plan.approach_blocks, plan.contact_blocks) == (program.block[0], program.block[-1] + 1)
    assert [segment.text for segment in plan.segments] == plan.program.text.split(b"\n")
    assert [segment.seq for segment in plan.segments] == list(range(len(plan.segments)))
    assert plan.predicted_removal_nm == pytest.approx(solved.answer.effect.removal_nm(plan.expected_time_s))


def test_segments_have_no_line_ends(measured: MeasureResult) -> None:
    program = RS274.read(small_text().replace(b"\n", b"\r\n"), "dos.rnc")
    solved = dwell_step.solve(small_recipe(), program, measured)
    plan = steps.rewrite(small_recipe(), program, solved, "dos.rnc")
    assert not any(segment.text.endswith((b"\r", b"\n")) for segment in plan.segments)


@pytest.mark.parametrize("change", [b"X0.5", b"drop"])
def test_a_rewritten_program_with_another_path_is_not_sent(
    program: Program, solved: SolveResult, change: bytes
) -> None:
    def rewrite(original: Program, time_s: np.ndarray) -> bytes:
        lines = RS274.rewrite(original, time_s).split(b"\n")
        where = int(original.block[7])
        lines[where : where + 1] = [] if change == b"drop" else [b"G1 X0.5 F900"]
        return b"\n".join(lines)

    recipe = small_recipe(format=ProgramFormat("bad", RS274.read, rewrite))
    with pytest.raises(ComputeError, match="does not read back as the same path"):
        steps.rewrite(recipe, program, solved, "small.rnc")


def test_the_moves_of_a_dwelling_program_take_time(tmp_path: Path) -> None:
    path = tmp_path / "dwell.rnc"
    path.write_bytes(dwelling())
    program = steps.read_program(small_recipe(), path)
    assert program.encoding == "dwell"
    assert program.travel_mm[1:] == pytest.approx(1.0)
    assert program.travel_mm[0] == 0.0, "the first move is the approach"
    assert not program.length_mm.any(), "a dwell acts where its move ends"


# what forbids to run


def test_landing_beside_the_part_is_fine(program: Program, solved: SolveResult) -> None:
    assert steps.violations(small_recipe(), steps.rewrite(small_recipe(), program, solved, "small.rnc")) == []


def test_landing_on_the_part_is_named(program: Program, solved: SolveResult) -> None:
    plan = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    starts, ends = steps.violations(small_recipe(aperture_mm=60.0), plan)
    first, last = program.line[0], program.line[-1]
    assert starts.startswith(f"small.rnc:{first}: contact starts at ")
    assert ends.startswith(f"small.rnc:{last}: contact ends at ")
    assert "digs a pit" in ends


def test_the_landing_is_judged_in_the_parts_frame(program: Program, solved: SolveResult) -> None:
    plan = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    x, y = program.start_mm[0, :2]
    (only,) = steps.violations(small_recipe(offset_mm=(-float(x), -float(y), 0.0)), plan)
    assert "starts at 0.00, 0.00 mm" in only.replace("-0.00", "0.00")


def test_a_program_without_an_axis_cannot_be_run(program: Program, solved: SolveResult) -> None:
    plan = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    (only,) = steps.violations(small_recipe(process=replace(small_recipe().process, dip_deg=15.0)), plan)
    assert "states no tool axis" in only


# learn


def polished(before: MeasureResult, removal_nm: np.ndarray) -> MeasureResult:
    return replace(before, height_nm=before.height_nm - removal_nm)


def removed(program: Program, measured: MeasureResult, solved: SolveResult, rate: float) -> np.ndarray:
    return rate * steps.effect_of(small_recipe(), program, measured.grid).effect.removal_nm(solved.expected_s)


@pytest.mark.parametrize(("believed", "true"), [(1.0, 0.9), (0.9, 0.95), (1.0, 1.3)])
def test_learn_the_rate(
    program: Program, measured: MeasureResult, solved: SolveResult, believed: float, true: float
) -> None:
    after = polished(measured, removed(program, measured, solved, true))
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    taught = steps.learn(small_recipe(), program, done, at_rate(believed))
    assert taught.believed.rate == pytest.approx(true, rel=1e-3), "relative to the model, not to the last belief"
    assert taught.verdict.stop == ""
    assert taught.found is not None
    assert taught.found["rate"] == pytest.approx(true / believed, rel=1e-3)
    assert taught.believed.removal.rate.sigma == pytest.approx(believed * taught.found["rate_sigma"])


def test_learn_the_overhead(program: Program, measured: MeasureResult, solved: SolveResult) -> None:
    after = polished(measured, removed(program, measured, solved, 1.0))
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s + 0.007)
    believed = steps.learn(small_recipe(), program, done, EstimatesInUse()).believed
    assert believed.block_overhead_s == pytest.approx(0.007, rel=0.05)


def test_a_map_is_judged_with_the_ripple_of_the_passes_that_were_made(measured: MeasureResult) -> None:
    line = {
        "direction": "across",
        "period_mm": 0.9,
        "amplitude_nm": 1.4,
        "rms_nm": 1.0,
        "rms_high_nm": 1.3,
        "on_grid": 0.0,
    }
    other = {**line, "period_mm": 0.45, "rms_nm": 0.5}
    apart = {**line, "cause": "line_error", "rms_nm": 0.0, "rms_high_nm": 0.3}
    passes = [
        {"forecast": {"ripple": {"lines": [line, apart]}}},
        {},
        {"forecast": {"ripple": {"lines": [line, other, apart]}}},
    ]
    ripple = made_ripple(passes)
    assert [(one.period_mm, one.rms_nm) for one in ripple.lines] == [(0.9, 2.0), (0.9, 0.0), (0.45, 0.5)]
    assert ripple.lines[1].rms_high_nm == pytest.approx(0.3 * 2**0.5), "lines are out of place anew in each pass"
    recipe = small_recipe()
    (plain,), (rippled,) = (steps.condition(recipe, small_map(), ripple=own).judged for own in (Ripple(), ripple))
    assert plain.with_ripple is None
    assert rippled.value == plain.value
    pitch = measured.map_grid.pitch_mm if measured.map_grid else np.nan
    hidden = sum(one.rms_nm**2 * (1 - one.kept(pitch)) for one in ripple.lines)
    assert rippled.with_ripple == pytest.approx(np.hypot(plain.value, hidden**0.5))


def test_what_a_pass_leaves_finer_than_the_grid_is_expected_of_the_next(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    """A ripple between tracks: the map's own samples show it, the process grid does not."""
    recipe, removal = small_recipe(), removed(program, measured, solved, 1.0)
    flat = polished(measured, removal)
    grid_nm = float(remove_terms(flat.height_nm, flat.metric_mask, "tilt")[flat.metric_mask].std())
    plan = steps.rewrite(recipe, program, solved, "again")
    rippled, smooth = (replace(flat, stats=replace(flat.stats, rms_nm=float(np.hypot(grid_nm, f)))) for f in (1.5, 0.0))
    forecasts = []
    for after in (rippled, smooth):
        done = ExecutedPass(
            replace(measured, stats=replace(measured.stats, rms_nm=0.0)), after, solved.asked_s, solved.expected_s
        )
        believed = steps.learn(recipe, program, done, EstimatesInUse()).believed
        forecasts.append((believed.ripple, forecast_of(recipe, after, plan, believed, None)))
    removed_nm = float(np.sqrt(np.mean(removal[measured.metric_mask] ** 2)))
    assert forecasts[0][0] == pytest.approx(1.5 / removed_nm, rel=0.02)
    assert forecasts[1][0] == 0.0
    assert forecasts[0][1].low_nm > 1.5 - 0.05
    assert forecasts[1][1].low_nm < forecasts[0][1].low_nm


@pytest.mark.parametrize("true", [0.75, 1.25])
def test_a_rate_far_from_the_model_is_a_reason_to_stop(
    program: Program, measured: MeasureResult, solved: SolveResult, true: float
) -> None:
    after = polished(measured, removed(program, measured, solved, true))
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    taught = steps.learn(small_recipe(max_rate_change=0.2), program, done, EstimatesInUse())
    assert f"removal is {true:g} +- " in taught.verdict.stop
    assert "limits.max_rate_change" in taught.verdict.stop
    assert taught.found is None


def test_a_flipped_map_stops_at_the_gate_and_teaches_nothing(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    after = polished(measured, removed(program, measured, solved, 1.0)[:, ::-1])
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    taught = steps.learn(small_recipe(), program, done, at_rate(0.9))
    assert "flipped left-right" in taught.verdict.stop
    assert taught.found is None
    assert taught.believed == at_rate(0.9)


@pytest.mark.parametrize("alignment", ["piston", "tilt", "power"])
@pytest.mark.parametrize("true", [0.4, 1.6])
def test_nothing_is_learned_from_what_the_gate_cannot_tell(
    program: Program, measured: MeasureResult, alignment: str, true: float
) -> None:
    """A pass that removed a wedge: the next set-up's tilt is as large, and says nothing of the rate."""
    recipe = small_recipe(alignment=alignment)
    time_s = 0.5 + 0.4 * program.end_mm[:, 0] / APERTURE_MM
    wedge = steps.effect_of(recipe, program, measured.grid).effect.removal_nm(time_s)
    plane = fit_terms(wedge, measured.metric_mask, "tilt")
    after = polished(measured, true * plane + wedge - plane)
    taught = steps.learn(recipe, program, ExecutedPass(measured, after, time_s, time_s + 0.007), at_rate(0.9))
    assert "scaled" in taught.verdict.undecidable
    assert taught.believed.rate == 0.9
    assert taught.believed.block_overhead_s > 0, "what the machine took is known all the same"
    assert "rate" in taught.notes[0]


def test_a_fitted_rate_that_the_gate_could_not_have_refused_is_reported_and_not_taken(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    weak = 0.15 * solved.expected_s
    removal = steps.effect_of(small_recipe(), program, measured.grid).effect.removal_nm(weak)
    ripple = rough(measured.grid, 0.6 * removal[measured.metric_mask].std(), seed=3, cut_mm=6)
    done = ExecutedPass(measured, polished(measured, 1.4 * removal + ripple), weak, weak)
    taught = steps.learn(small_recipe(), program, done, EstimatesInUse())
    assert taught.verdict.stop == ""
    assert "scaled" in taught.verdict.undecidable
    assert taught.found is not None
    assert taught.found["measured_rate"] > 1 + 2 * taught.found["rate_sigma"], (
        "the learning step alone would have accepted it"
    )
    assert taught.believed.rate == 1.0
    assert "cannot show a wrong rate" in taught.notes[0]


def test_a_rate_just_beyond_what_is_allowed_is_cut_and_said(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    ripple = rough(measured.grid, 0.05 * measured.stats.rms_nm, seed=3, cut_mm=6)
    after = polished(measured, removed(program, measured, solved, 1.205) + ripple)
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    taught = steps.learn(small_recipe(max_rate_change=0.2), program, done, EstimatesInUse())
    assert taught.verdict.stop == ""
    assert taught.believed.rate == 1.2
    assert "limited to 1.200 by limits.max_rate_change" in taught.notes[-1]


# registration


def test_a_part_that_lies_off_the_centre_is_conditioned_as_if_it_did_not() -> None:
    surface = small_map()
    n = surface.height_nm.shape[0]
    wide = np.full((n + 12, n + 12), np.nan)
    wide[6 : 6 + n, 6 : 6 + n] = surface.height_nm
    instrument = Instrument("bench", register_by="aperture", aperture_mm=APERTURE_MM + 1.0)
    recipe = small_recipe(instrument=instrument)
    straight = steps.condition(recipe, surface.with_height(wide))
    moved = steps.condition(recipe, surface.with_height(np.roll(wide, (-3, 2), (0, 1))))
    assert moved.registration.shift_mm == pytest.approx((1.0, 1.5), abs=0.05)
    plain = steps.condition(small_recipe(), surface)
    assert moved.stats.rms_nm == pytest.approx(plain.stats.rms_nm, rel=0.02)
    inside = moved.metric_mask & plain.metric_mask
    assert np.abs((moved.height_nm - straight.height_nm)[inside]).max() < 1.0
    with pytest.raises(MapError, match="last map"):
        steps.condition(recipe, surface.with_height(np.roll(wide, (-3, 2), (0, 1))), None, straight.registration)


def test_a_profile_is_applied_before_anything_else() -> None:
    surface = small_map()
    turned = surface.with_height(-np.rot90(surface.height_nm, -1)[:, ::-1])
    plain = steps.condition(small_recipe(), surface)
    instrument = Instrument("bench", mirror=True, rotation_deg=90, sign=-1)
    seen = steps.condition(small_recipe(instrument=instrument), turned)
    np.testing.assert_allclose(seen.height_nm, plain.height_nm, atol=1e-9)
    assert seen.stats.rms_nm == pytest.approx(plain.stats.rms_nm)


def test_everything_pickles(solved: SolveResult, measured: MeasureResult) -> None:
    """The worker is another process."""
    for value in (small_recipe(), solved, measured, EstimatesInUse()):
        assert type(pickle.loads(pickle.dumps(value))) is type(value)


def test_as_programmed_no_time_is_changed() -> None:
    recipe, program = small_recipe(objective="as_programmed"), small_program()
    measured = steps.condition(recipe, small_map())
    solved = dwell_step.solve(recipe, program, measured)
    plan = steps.rewrite(recipe, program, solved, "small.rnc")
    assert plan.program.time_s == pytest.approx(program.time_s, rel=1e-6)
    certificate = solved.dwell.certificate
    dwell_step.require_certificate(certificate, recipe)
    assert (certificate.solver, certificate.kkt_residual, certificate.cross_check) == ("as_programmed", 0.0, None)
    expected = motion.delivered_time_s(program, program.time_s, steps.envelope_of(recipe, program))
    assert solved.expected_s == pytest.approx(expected)
    left = measured.height_nm - solved.answer.removal_nm(expected)
    clear = measured.metric_mask
    assert certificate.predicted_rms_nm == pytest.approx(float(left[clear].std()), rel=1e-6)


@pytest.mark.full
def test_low_orders_are_doubted_before_anything_is_learned(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    """A rim that stands 12 nm higher, from the pass or thermal: later maps decide, and then the rate is learned."""
    warm = 12.0 * (measured.grid.radius_mm() / 12.0) ** 2
    after = polished(measured, removed(program, measured, solved, 0.95) - warm)
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    first = steps.learn(small_recipe(), program, done, EstimatesInUse())
    assert first.doubted
    assert (first.believed, first.found) == (EstimatesInUse(), None)
    assert [(one.cause, one.again) for one in first.named] == [("settling", True)]
    stays = steps.learn(small_recipe(), program, replace(done, again=()), EstimatesInUse())
    assert not stays.doubted
    assert [one.cause for one in stays.named] == ["field"]
    cooled = polished(measured, removed(program, measured, solved, 0.95))
    seen = steps.map_changes(small_recipe(), after, cooled)
    settled = steps.learn(small_recipe(), program, replace(done, after=cooled, again=seen), EstimatesInUse())
    assert [one.cause for one in settled.named] == ["settling"]
    assert settled.believed.rate == pytest.approx(0.95, rel=1e-3)
    assert "warm still" in settled.notes[0]
    assert steps.harmful_changes(small_recipe(tolerance_nm=2.0), seen) == seen
    assert steps.harmful_changes(small_recipe(tolerance_nm=20.0), seen) == ()


@pytest.mark.one_of_each
@pytest.mark.parametrize("language", ["rapid", "krl", "fanuc-tp", "urscript", "inform", "val3", "heidenhain"])
def test_a_plan_in_a_robot_language_keeps_to_its_speeds_and_times(language: str) -> None:
    profile = cast(LanguageProfile, dialect(language))
    assert profile.move_time is not None
    coarse = profile.move_time.model_copy(update={"least_mm_s": 4.0, "greatest_mm_s": 30.0, "quantum_s": 0.002})
    form = format_of(profile.model_copy(update={"move_time": coarse}))
    path = small_program()
    points = np.vstack([path.start_mm[:1], path.end_mm])
    axis = np.vstack([path.axis[:1], path.axis])
    assert form.make is not None
    program = form.read(form.make(points, axis, 600.0, "small"), "small")
    recipe = small_recipe(format=form)
    measured = steps.condition(recipe, small_map())
    limits = steps.envelope_of(recipe, program)
    assert (limits.min_feed_mm_s, limits.max_feed_mm_s) == (
        max(4.0, recipe.envelope.min_feed_mm_s), min(30.0, recipe.envelope.max_feed_mm_s),
    )  # fmt: skip
    solved = dwell_step.solve(recipe, program, measured)
    plan = steps.rewrite(recipe, program, solved, "small")
    asked_mm_s = plan.program.length_mm / plan.program.time_s
    assert 3.9 <= asked_mm_s.min() < 6.0
    assert asked_mm_s.max() <= 30.3
    np.testing.assert_allclose(plan.program.time_s, solved.asked_s, rtol=0.011, atol=0.002)
    assert plan.program.time_s.sum() == pytest.approx(solved.asked_s.sum(), abs=0.01)
    assert list(polishd_check_plan(plan, recipe.envelope)) == []


def test_a_language_and_a_machine_without_a_common_speed_are_refused() -> None:
    form = format_of(dialect("krl"))
    path = small_program()
    assert form.make is not None
    program = form.read(form.make(path.end_mm, path.axis, 600.0, "small"), "small")
    assert program.timing is not None
    slow = replace(program, timing=replace(program.timing, greatest_mm_s=1e-3, least_mm_s=1e-4))
    with pytest.raises(ComputeError, match=r"krl states 0\.0001 to 0\.001 mm/s, the machine runs"):
        steps.envelope_of(small_recipe(), slow)


def test_lines_between_lines_count_by_their_phase_unless_another_tool_made_them() -> None:
    line = {"direction": "across", "period_mm": 0.9, "amplitude_nm": 1.4, "rms_nm": 1.0, "rms_high_nm": 1.3}
    line |= {"on_grid": 0.0, "azimuth_deg": 30.0, "phase": 0.25}
    between = {**line, "phase": 0.75}
    passes = [{"forecast": {"ripple": {"lines": [one]}}} for one in (line, between)]
    assert made_ripple(passes).rms_nm == pytest.approx(0.0, abs=1e-9)
    tools = [{**one, "tool": tool} for one, tool in zip(passes, ("wide", "narrow"), strict=True)]
    assert made_ripple(tools).rms_nm == pytest.approx(2.0)
