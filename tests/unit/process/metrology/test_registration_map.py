"""Marks and outline found in a map, the limits of a registration, and the way into the part's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle
from polishd.model.surface import Grid, SurfaceMap
from polishd.process.metrology import registration
from polishd.process.metrology.registration import register
from polishd.process.metrology.resampling import Registration, averaging_matrix, resample_registered
from tests.unit.process.metrology.placed_parts import MARKS_MM, disc, on_part, punched, seen_px

GRID = Grid(432, 425, 0.25)
PROFILE = Instrument("shop", fiducials_mm=MARKS_MM, register_by="both", aperture_mm=104.0)
PLACE = (0.8, (0.43, -0.61))


def part(turn_deg: float = PLACE[0], shift_mm: tuple[float, float] = PLACE[1], holes_px: float = 9.0) -> SurfaceMap:
    height = disc(GRID, 104.0, turn_deg, shift_mm)
    return SurfaceMap(punched(height, seen_px(MARKS_MM, GRID, turn_deg, shift_mm), holes_px), GRID.pitch_mm)


def off_px(found: Registration, shift_mm: tuple[float, ...] = PLACE[1]) -> float:
    return float(np.hypot(found.shift_mm[0] - shift_mm[0], found.shift_mm[1] - shift_mm[1])) / GRID.pitch_mm


# marks


@pytest.mark.parametrize("seed", range(5))
def test_marks_are_found_to_a_part_of_a_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = seen_px(MARKS_MM, GRID, rng.uniform(-2, 2), rng.uniform(-1, 1, 2))
    height = punched(np.ones(GRID.shape), true, rng.uniform(7, 13))
    found = np.array(registration.find_marks(height, GRID.pitch_mm))
    assert len(found) == 4
    nearest = np.hypot(*(found[:, None] - true[None]).transpose(2, 0, 1)).min(axis=0)
    assert np.sqrt((nearest**2).mean()) < 0.12


def test_what_is_no_mark_is_left() -> None:
    rng = np.random.default_rng(0)
    height = disc(GRID, 104.0)
    height[rng.random(GRID.shape) < 0.005] = np.nan  # drop-outs
    height[200:203, 150:200] = np.nan  # a scratch
    height[250:300, 250:300] = np.nan  # a stain
    for i in range(24):
        height[100 + i, 120 + i : 124 + i] = np.nan  # a slanting hair
    assert registration.find_marks(height, GRID.pitch_mm) == ()
    assert len(registration.find_marks(punched(height, np.array([[150.0, 90.0]]), 9.0), GRID.pitch_mm)) == 1


def test_a_full_map_has_no_marks() -> None:
    assert registration.find_marks(np.zeros((30, 40)), 0.1) == ()
    assert registration.find_marks(np.full((30, 40), np.nan), 0.1) == ()


# outline


@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("what", ["whole", "drop-outs", "clipped", "cut through", "dirty rim"])
def test_the_outline_is_found_whatever_is_missing(what: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shift = tuple(rng.uniform(-1.5, 1.5, 2))
    height = disc(GRID, 100.0, 0.0, shift)
    if what == "drop-outs":
        height[rng.random(GRID.shape) < 0.05] = np.nan
    if what == "clipped":
        height[:, :60] = np.nan
    if what == "cut through":
        height[200:240] = np.nan
    if what == "dirty rim":
        x, y = on_part(GRID, 0, shift)
        height[(np.hypot(x, y) > 46) & (abs(np.arctan2(y, x) - 1) < 0.4)] = np.nan
    found = registration.fit_circle(height, GRID.pitch_mm, 100.0, 1.0)
    assert off_px(found, shift) < 0.1
    assert found.scale == pytest.approx(1, abs=0.002)
    assert found.rotation_deg == 0
    assert found.residual_mm < 0.15


def test_a_frame_that_cuts_the_part_is_no_rim() -> None:
    whole = disc(GRID, 100.0, 0.0, (0.4, 0.3))
    cut = Grid(432, 365, 0.25)
    found = registration.fit_circle(whole[:, 30:-30], 0.25, 100.0, 1.0)
    assert np.hypot(found.shift_mm[0] - 0.4, found.shift_mm[1] - 0.3) / cut.pitch_mm < 0.1


@pytest.mark.parametrize(
    ("diameter_mm", "expected_mm", "match"),
    [(100.0, 102.0, r"100\.\d+ mm across, 102 mm expected"), (97, 100, "across")],
)
def test_another_diameter_is_refused(diameter_mm: float, expected_mm: float, match: str) -> None:
    with pytest.raises(MapError, match=match):
        registration.fit_circle(disc(GRID, diameter_mm), GRID.pitch_mm, expected_mm, 1.0)


def apertures() -> dict[str, np.ndarray]:
    x, y = on_part(GRID, 0, PLACE[1])
    rounded = np.hypot(np.maximum(abs(x) - 20, 0), np.maximum(abs(y) - 20, 0)) < 30
    return {
        "annulus": (np.hypot(x, y) < 50) & (np.hypot(x, y) > 15),
        "annulus with its hole beside": (np.hypot(x, y) < 50) & (np.hypot(x - 10, y) > 15),
        "bite": (np.hypot(x, y) < 50) & (np.hypot(x - 45, y) > 15),
        "flat": (np.hypot(x, y) < 50) & (x < 35),
        "ellipse": np.hypot(x, y / 0.8) < 50,
        "rectangle": (abs(x) < 45) & (abs(y) < 30),
        "square": (abs(x) < 50) & (abs(y) < 50),
        "rounded square": rounded,
    }


@pytest.mark.parametrize("name", ["annulus", "annulus with its hole beside", "bite", "flat"])
def test_what_has_a_round_rim_is_placed_by_it(name: str) -> None:
    found = registration.fit_circle(np.where(apertures()[name], 0.0, np.nan), GRID.pitch_mm, 100.0, 1.0)
    assert off_px(found) < 0.05


@pytest.mark.parametrize("name", ["ellipse", "rectangle", "square", "rounded square"])
def test_what_is_not_round_is_said_to_be_no_circle(name: str) -> None:
    with pytest.raises(MapError, match=r"is no circle.*register by fiducials"):
        registration.fit_circle(np.where(apertures()[name], 0.0, np.nan), GRID.pitch_mm, 100.0, 1.0)


def test_too_little_rim_is_refused() -> None:
    height = disc(GRID, 100.0)
    height[:300] = np.nan
    with pytest.raises(MapError, match="of the part's rim is seen"):
        registration.fit_circle(height, GRID.pitch_mm, 100.0, 1.0)
    for nothing in (np.zeros(GRID.shape), np.full(GRID.shape, np.nan)):
        with pytest.raises(MapError, match="too few to place it"):
            registration.fit_circle(nothing, GRID.pitch_mm, 100.0, 1.0)


# register


@pytest.mark.parametrize("by", ["aperture", "fiducials", "both"])
def test_each_way_finds_the_part(by: str) -> None:
    found = register(part(), replace(PROFILE, register_by=by), Circle(50.0))
    assert found.by == by
    assert off_px(found) < 0.1
    assert found.rotation_deg == pytest.approx(0 if by == "aperture" else 0.8, abs=0.02)
    assert "centre at (+0.4" in str(found)


def test_nothing_is_done_where_nothing_is_asked() -> None:
    assert register(part(), None, Circle(52.0)) == Registration()
    assert register(part(), replace(PROFILE, register_by="none"), Circle(52.0)) == Registration()


def test_marks_that_the_file_lists_are_taken_first() -> None:
    listed = tuple((float(r), float(c)) for r, c in seen_px(MARKS_MM, GRID, 1.5, (0.2, 0.1)))
    found = register(replace(part(), fiducials_px=listed), replace(PROFILE, register_by="fiducials"), Circle(52.0))
    assert found.rotation_deg == pytest.approx(1.5)
    with pytest.raises(MapError, match="by its outline"):
        register(replace(part(), fiducials_px=tuple((r - 4, c) for r, c in listed)), PROFILE, Circle(52.0))


@pytest.mark.parametrize(
    ("turn_deg", "shift_mm", "match"),
    [(2.6, (0, 0), r"turned by 2\.6\d? deg.*2 deg"), (90, (0, 0), "rotation_deg"), (0, (1.6, -1.6), "centre the part")],
)
def test_limits(turn_deg: float, shift_mm: tuple[float, float], match: str) -> None:
    with pytest.raises(MapError, match=match):
        register(part(turn_deg, shift_mm), PROFILE, Circle(52.0))


def test_a_mirrored_map_is_named() -> None:
    seen = part()
    with pytest.raises(MapError, match="mirror image"):
        register(seen.with_height(seen.height_nm[:, ::-1]), PROFILE, Circle(52.0))


def test_drift_is_judged_against_the_last_map() -> None:
    last = register(part(), PROFILE, Circle(52.0))
    assert register(part(0.8, (0.7, -0.5)), PROFILE, Circle(52.0), last).drift_mm(last) == pytest.approx(0.29, abs=0.03)
    with pytest.raises(MapError, match=r"0\.6\d\d mm from where the last map"):
        register(part(0.8, (1.0, -0.3)), PROFILE, Circle(52.0), last)
    assert register(part(0.8, (1.0, -0.3)), PROFILE, Circle(52.0), Registration()).distance_mm > 1


def test_without_a_scale_nothing_is_registered() -> None:
    with pytest.raises(MapError, match="lateral scale"):
        register(replace(part(), pitch_mm=None), PROFILE, Circle(52.0))


# into the part's frame


@pytest.mark.parametrize("turn_deg", [0.0, 0.5, 2.0, 30.0])
def test_volume_is_conserved(turn_deg: float) -> None:
    rng = np.random.default_rng(1)
    height = np.where(rng.random(GRID.shape) < 0.03, np.nan, rng.normal(5, 3, GRID.shape))
    target = Grid(180, 180, 1.0)  # all of the map lies inside
    placed = Registration(turn_deg, (0.37, -0.81))
    filled = np.nan_to_num(height)
    ones = resample_registered(np.ones_like(filled), GRID, target, placed)
    mean = resample_registered(filled, GRID, target, placed)
    inner = np.s_[60:120, 60:120]
    assert np.isfinite(mean[inner]).all()
    np.testing.assert_allclose(ones[np.isfinite(ones)], 1, atol=1e-12)
    from polishd.process.metrology import resampling

    do = resampling._turned if turn_deg else resampling._aligned
    volume, area = do(filled, np.ones(GRID.shape, dtype=bool), GRID, target, placed)
    assert volume.sum() == pytest.approx(filled.sum() * GRID.pitch_mm**2, rel=1e-12)
    assert area.sum() == pytest.approx(filled.size * GRID.pitch_mm**2, rel=1e-12)


@pytest.mark.parametrize(("source_mm", "target_mm"), [(0.25, 1.0), (0.25, 0.25), (1.0, 1.0), (1.0, 0.5)])
@pytest.mark.parametrize("turn_deg", [0.0, 0.5, 2.0, 45.0])
def test_a_plane_comes_out_as_it_is(source_mm: float, target_mm: float, turn_deg: float) -> None:
    """To first order in a sample: what a pixel's flat top loses on a slope, no average over cells brings back."""
    n = round(110 / source_mm)
    source, target = Grid(n, n, source_mm), Grid(round(60 / target_mm), round(60 / target_mm), target_mm)
    x, y = on_part(source, turn_deg, (0.3, -0.7))
    seen = resample_registered(3 * x - 2 * y, source, target, Registration(turn_deg, (0.3, -0.7)))
    truth = 3 * target.x_mm[None, :] - 2 * target.y_mm[:, None]
    assert abs(seen - truth).max() < 4 * source_mm
    assert abs((seen - truth).mean()) < 0.02 * source_mm


def test_a_turn_and_its_limit_of_no_turn_agree() -> None:
    height = disc(GRID, 100.0)
    target = Grid(120, 120, 1.0)
    still = resample_registered(height, GRID, target, Registration(0.0, (0.3, 0.2)))
    nearly = resample_registered(height, GRID, target, Registration(1e-5, (0.3, 0.2)))
    both = np.isfinite(still) & np.isfinite(nearly)
    assert (np.isfinite(still) != np.isfinite(nearly)).sum() <= 2
    np.testing.assert_allclose(nearly[both], still[both], atol=1e-3)


@pytest.mark.parametrize("turn_deg", [0.0, 2.0])
@pytest.mark.parametrize("pitch_mm", [0.7, 1.0])
def test_the_means_as_a_matrix_are_those_of_a_full_map(turn_deg: float, pitch_mm: float) -> None:
    source, target, placed = Grid(61, 50, pitch_mm), Grid(70, 66, 0.8), Registration(turn_deg, (0.31, -0.77))
    height = np.random.default_rng(3).normal(size=source.shape)
    want = resample_registered(height, source, target, placed)
    means = averaging_matrix(source, target, placed)
    got = (means @ height.ravel()).reshape(target.shape)
    has = np.isfinite(want)
    assert 0 < has.sum() < has.size, "the map does not cover all of the grid"
    np.testing.assert_allclose(got[has], want[has], atol=1e-12)
    np.testing.assert_array_equal(got[~has], 0.0)


def test_cells_with_little_data_have_none() -> None:
    height = np.ones((40, 40))
    height[:, 23:] = np.nan
    for turn_deg in (0.0, 1e-5):
        seen = resample_registered(height, Grid(40, 40, 0.25), Grid(10, 10, 1.0), Registration(turn_deg))
        assert np.isfinite(seen[5]).tolist() == [True] * 6 + [False] * 4


def test_registered_maps_of_one_part_agree() -> None:
    """The same part, shifted and turned in each map: in its own frame it is the same."""
    target = Grid(100, 100, 1.0)
    truth = disc(target, 100.0)
    for turn_deg, shift_mm in ((0.0, (0.0, 0.0)), (1.7, (1.1, -0.9)), (-1.2, (-0.4, 1.3))):
        seen = part(turn_deg, shift_mm, holes_px=9)
        mapped = resample_registered(seen.height_nm, seen.grid, target, register(seen, PROFILE, Circle(52.0)))
        inner = (target.radius_mm() < 45) & np.isfinite(mapped)
        difference = (mapped - truth)[inner]
        assert np.sqrt(np.mean(difference**2)) < 0.35  # of 35 nm RMS; a cell's average is not its middle
    unregistered = resample_registered(seen.height_nm, GRID, target)
    inner &= np.isfinite(unregistered)
    assert np.sqrt(np.mean((unregistered - truth)[inner] ** 2)) > 2
