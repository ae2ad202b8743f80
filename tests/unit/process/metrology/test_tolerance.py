"""The drawing's lines on surfaces whose figures are known in closed form, and maps less the form wanted."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.model.tolerance import LineResult, ToleranceLine, part_holds, worst_line
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.tolerance import (
    irregularity,
    judge_lines,
    lines_below_cutoff,
    subtract_nominal,
    tolerance_notes,
    unreachable_lines,
)
from polishd.process.removal.ripple import Ripple, RippleLine

PITCH = 0.5
GRID = Grid(241, 241, PITCH)
MASK = GRID.radius_mm() <= 50.0


def wave(amplitude_nm: float, period_mm: float) -> FloatArray:
    """A sine along x."""
    x = np.broadcast_to(GRID.x_mm, GRID.shape)
    return np.asarray(amplitude_nm * np.sin(2 * np.pi * x / period_mm), dtype=np.float64)


def value(line: ToleranceLine, height_nm: FloatArray, mask: BoolArray = MASK) -> float:
    (found,) = judge_lines([line], height_nm, mask, PITCH)
    return found.value


BOTH = wave(8.0, 20.0) + wave(3.0, 4.0)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (ToleranceLine("rms", 1.0), np.hypot(8.0, 3.0) / np.sqrt(2)),
        (ToleranceLine("rms", 1.0, above_mm=9.0), 8.0 / np.sqrt(2)),
        (ToleranceLine("rms", 1.0, below_mm=9.0), 3.0 / np.sqrt(2)),
        (ToleranceLine("rms", 1.0, above_mm=3.0, below_mm=9.0), 3.0 / np.sqrt(2)),
        (ToleranceLine("pv", 1.0), np.ptp(wave(8.0, 20.0) + wave(3.0, 4.0))),
        (ToleranceLine("slope_max", 1.0, above_mm=9.0, integration_mm=1.0), 8.0 * 2 * np.pi / 20.0),
        (ToleranceLine("slope_rms", 1.0, above_mm=9.0, integration_mm=1.0), 8.0 * 2 * np.pi / 20.0 / np.sqrt(2)),
    ],
    ids=lambda of: of.what if isinstance(of, ToleranceLine) else "",
)
def test_figures_over_their_periods(line: ToleranceLine, expected: float) -> None:
    assert value(line, BOTH) == pytest.approx(expected, rel=0.06)


def test_the_pv_of_a_band_is_read_high_at_the_rim() -> None:
    """As docs/reference/tolerance.md says."""
    assert 6.0 <= value(ToleranceLine("pv", 1.0, below_mm=9.0), BOTH) < 8.5


def test_form_figures_are_those_of_iso_10110() -> None:
    height = BOTH + 40.0 * (GRID.radius_mm() / 50.0) ** 2
    own = irregularity(height, MASK)
    lines = [ToleranceLine(figure, 1.0) for figure in ("A", "B", "C", "RMSt", "RMSi", "RMSa")]
    found = [one.value for one in judge_lines(lines, height, MASK, PITCH)]
    assert found == [own.a_nm, own.b_nm, own.c_nm, own.rms_t_nm, own.rms_i_nm, own.rms_a_nm]
    assert found[0] == pytest.approx(40.0, rel=0.05)


def test_a_surface_whose_psd_is_the_line_is_at_its_limit() -> None:
    """Its phases random: a ring's density scatters about the line, so that the highest ring is a little above."""
    rng, shape = np.random.default_rng(4), GRID.shape
    frequency = np.hypot(np.fft.fftfreq(shape[0], PITCH)[:, None], np.fft.rfftfreq(shape[1], PITCH))
    density = 30.0 / np.maximum(frequency, 0.02) ** 2
    noise = np.fft.rfft2(rng.standard_normal(shape))
    height = np.fft.irfft2(noise * np.sqrt(density) / PITCH, shape)
    line = ToleranceLine("psd", 30.0, above_mm=2.0, below_mm=20.0, exponent=2.0)
    assert 30.0 < value(line, height) < 90.0
    assert value(line, 2 * height) == pytest.approx(4 * value(line, height))


def test_the_worst_line_is_the_one_that_is_the_farthest_beyond() -> None:
    judged = judge_lines(
        [ToleranceLine("rms", 10.0), ToleranceLine("pv", 8.0), ToleranceLine("pv", 30.0)], BOTH, MASK, PITCH
    )
    assert [one.holds for one in judged] == [True, False, True]
    assert not part_holds(judged)
    farthest = worst_line(judged)
    assert farthest is not None
    assert str(farthest) == f"PV {np.ptp(BOTH[MASK]):.3g} nm of 8 nm allowed"
    assert not part_holds(())
    assert worst_line(()) is None


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (ToleranceLine("rms", 1.0, below_mm=0.9), "it shows periods above 1 mm only"),
        (ToleranceLine("rms", 1.0, above_mm=0.5), "it shows periods above 1 mm only"),
        (ToleranceLine("psd", 1.0, above_mm=0.5, below_mm=9.0), "it shows periods above 1 mm only"),
        (ToleranceLine("slope_rms", 1.0, integration_mm=0.5), "its shortest slope is over 1 mm"),
    ],
    ids=["band below", "band to below", "psd", "slope"],
)
def test_what_a_map_cannot_show_is_not_judged(line: ToleranceLine, says: str) -> None:
    with pytest.raises(MapError, match=says):
        judge_lines([line], BOTH, MASK, PITCH)


def test_a_part_within_its_uncertainty_says_so() -> None:
    near, far, pv = judge_lines(
        [ToleranceLine("rms", 6.0), ToleranceLine("rms", 7.0), ToleranceLine("pv", 22.0)], BOTH, MASK, PITCH, 0.1
    )
    assert (near.uncertainty, pv.uncertainty) == (0.1, None)
    assert [one.unsure for one in (near, far, pv)] == [True, False, False]
    (note,) = tolerance_notes((near, far, pv))
    assert "RMS 6.06 +- 0.1 nm of 6 nm allowed: it does not hold, and the instrument's repeatability" in note


@pytest.mark.parametrize("seed", range(5))
def test_noise_changes_an_rms_by_its_own_at_most(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = wave(rng.uniform(-3, 3), rng.uniform(2.0, 60.0)) + rng.normal(0.0, 0.5, GRID.shape)
    repeats = float(noise[MASK].std())
    lines = [
        ToleranceLine("rms", 1.0),
        ToleranceLine("rms", 1.0, below_mm=9.0),
        ToleranceLine("RMSi", 1.0),
        ToleranceLine("RMSt", 1.0),
        ToleranceLine("RMSa", 1.0),
    ]
    for true, seen in zip(
        judge_lines(lines, BOTH, MASK, PITCH), judge_lines(lines, BOTH + noise, MASK, PITCH), strict=True
    ):
        assert abs(seen.value - true.value) <= repeats * 1.01


def test_what_the_spot_cannot_reach_is_named() -> None:
    lines = [ToleranceLine("rms", 1.0), ToleranceLine("pv", 30.0), ToleranceLine("rms", 2.0, below_mm=5.0)]
    assert [one.what for one in unreachable_lines(lines, BOTH, MASK, PITCH, 6.0)] == [
        "RMS",
        "RMS of periods below 5 mm",
    ]
    assert unreachable_lines(lines, BOTH, MASK, PITCH, 3.0) == ()
    assert unreachable_lines(lines, BOTH, MASK, PITCH, 0.9) == ()
    assert lines_below_cutoff(lines, 6.0) == (lines[2],)


def form_nm(x: FloatArray, y: FloatArray) -> FloatArray:
    return 3.0 * x - 2.0 * y + 0.5 * x * y  # bilinear: interpolation is exact


NOMINAL = SurfaceMap(form_nm(*np.meshgrid(Grid(61, 61, 1.0).x_mm, Grid(61, 61, 1.0).y_mm)), 1.0)


@pytest.mark.parametrize(
    "lies", [Registration(), Registration(0.0, (1.3, -0.7)), Registration(30.0, (-2.0, 1.1)), Registration(-90.0)]
)
def test_a_part_of_the_wanted_form_has_no_error_wherever_it_lies(lies: Registration) -> None:
    grid = Grid(40, 50, 0.5)
    turn = np.radians(lies.rotation_deg)
    right, up = np.meshgrid(grid.x_mm - lies.shift_mm[0], grid.y_mm - lies.shift_mm[1])
    x, y = np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right
    error = np.random.default_rng(3).normal(0.0, 5.0, grid.shape)
    error[4, 5] = np.nan
    found = subtract_nominal(SurfaceMap(form_nm(x, y) + error, 0.5), NOMINAL, lies)
    np.testing.assert_allclose(found.height_nm, error, atol=1e-9)


def test_where_the_form_says_nothing_there_is_no_error() -> None:
    large = SurfaceMap(np.zeros((200, 200)), 0.5)
    found = subtract_nominal(large, NOMINAL, Registration())
    inside = np.maximum(*np.abs(np.meshgrid(large.grid.x_mm, large.grid.y_mm))) <= 30.0
    np.testing.assert_array_equal(found.valid, inside)


def test_both_need_a_scale() -> None:
    flat = SurfaceMap(np.zeros((9, 9)), 1.0)
    for surface, nominal in ((flat, SurfaceMap(np.zeros((9, 9)), None)), (SurfaceMap(np.zeros((9, 9)), None), flat)):
        with pytest.raises(MapError, match="lateral scale"):
            subtract_nominal(surface, nominal, Registration())


# Ripple that the samples of a map average away.

FINE_MM, CELLS = 0.05, 8
SAMPLE_MM = FINE_MM * CELLS
PERIOD_MM, RMS_NM = 1.0, 1.5


def both_maps() -> tuple[FloatArray, FloatArray]:
    """A figure with lines across x: on fine samples, and averaged over cells."""
    at = (np.arange(100 * CELLS) + 0.5) * FINE_MM
    figure = 2.0 * np.sin(2 * np.pi * at[:, None] / 20.0) * np.cos(2 * np.pi * at / 13.0)
    fine = figure + RMS_NM * 2**0.5 * np.cos(2 * np.pi * at / PERIOD_MM)
    return fine, fine.reshape(100, CELLS, 100, CELLS).mean(axis=(1, 3))


LINES = [
    ToleranceLine("rms", 1.0),
    ToleranceLine("rms", 1.0, above_mm=0.85, below_mm=3.0),
    ToleranceLine("slope_rms", 1.0, integration_mm=0.8, above_mm=0.85),
    ToleranceLine("psd", 1.0, above_mm=0.9, below_mm=3.0),
]


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.what)
def test_a_coarse_map_with_the_forecast_ripple_is_judged_as_a_fine_one(line: ToleranceLine) -> None:
    fine, coarse = both_maps()
    (exact,) = judge_lines([line], fine, np.ones(fine.shape, np.bool_), FINE_MM)
    lines = (RippleLine("across", PERIOD_MM, 2**0.5 * RMS_NM, RMS_NM, 1.2 * RMS_NM, 0.0),)
    (found,) = judge_lines([line], coarse, np.ones(coarse.shape, np.bool_), SAMPLE_MM, ripple=Ripple(lines))
    assert found.value < 0.9 * exact.value
    above = 0.3 if line.figure == "psd" else 0.06  # all of it in one ring, where a measured spectrum has it in two
    assert found.with_ripple == found.counted
    assert 0.94 * exact.value < found.counted < (1 + above) * exact.value
    assert found.with_ripple_high is not None
    assert found.with_ripple_high > found.with_ripple


def test_ripple_that_a_fine_map_shows_is_not_counted_again() -> None:
    fine, _ = both_maps()
    lines = (RippleLine("across", PERIOD_MM, 2**0.5 * RMS_NM, RMS_NM, RMS_NM, 0.0),)
    (found,) = judge_lines([LINES[0]], fine, np.ones(fine.shape, np.bool_), FINE_MM, ripple=Ripple(lines))
    assert found.with_ripple == pytest.approx(found.value, rel=3e-3)
    assert found.ripple_words == ""


def test_ripple_of_other_periods_does_not_enter_a_line() -> None:
    _, coarse = both_maps()
    lines = (RippleLine("across", 0.5, RMS_NM, RMS_NM, RMS_NM, 0.0),)
    (found,) = judge_lines([LINES[1]], coarse, np.ones(coarse.shape, np.bool_), SAMPLE_MM, ripple=Ripple(lines))
    assert (found.with_ripple, found.counted) == (None, found.value)


@pytest.mark.parametrize(("limit", "holds", "unsure"), [(3.0, True, False), (2.35, True, True), (1.9, False, False)])
def test_a_line_holds_by_the_figure_with_ripple_and_is_unsure_up_to_its_95_percent(
    limit: float, holds: bool, unsure: bool
) -> None:
    line = LineResult("RMS", 1.5, limit, "nm", with_ripple=2.2, with_ripple_high=2.5)
    assert (line.holds, line.unsure) == (holds, unsure)
    assert "2.2 with ripple that the map does not show (up to 2.5)" in str(line)
    assert LineResult.of(line.facts()) == line
