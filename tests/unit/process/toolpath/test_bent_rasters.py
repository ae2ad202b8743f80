"""Pseudo-random and adaptive rasters: no crossing, coverage, radius, seed, density, and what cannot be made."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial import KDTree

from polishd.model.errors import ComputeError
from polishd.model.outline import polygon
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray, Grid
from polishd.process.optic_surface import sag_mm
from polishd.process.toolpath.apertures import annulus, circle, ellipse, over_outline, rectangle
from polishd.process.toolpath.bent_rasters import LineDensity, adaptive_raster, random_raster
from polishd.process.toolpath.paths import raster
from polishd.programs.make import SHAPES
from tests.unit.process.toolpath.test_paths_raster import lengths, outside, samples

APERTURES = {
    "circle": circle(60),
    "annulus": annulus(60, 20),
    "ellipse": ellipse(70, 36),
    "rectangle": rectangle(50, 30),
    "hexagon": SHAPES["hexagon"][1](40.0),
    "polygon": over_outline(polygon([(25, 15), (-25, 12), (-12, -20), (18, -14)])),
}
OFF_AXIS = Optic(120.0, -0.5, (1e-8,), (30.0, 10.0))
GRID = Grid(81, 81, 1.0)


def crossings(points: FloatArray) -> int:
    """Pairs of moves that cross, seen from above."""
    begin, move = points[:-1, :2], np.diff(points[:, :2], axis=0)
    pairs = KDTree(begin + move / 2).query_pairs(
        1.01 * float(np.linalg.norm(move, axis=1).max()), output_type="ndarray"
    )
    a, b = pairs[np.abs(np.diff(pairs, axis=1)[:, 0]) > 1].T
    between = begin[b] - begin[a]
    area = move[a, 0] * move[b, 1] - move[a, 1] * move[b, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along_a = (between[:, 0] * move[b, 1] - between[:, 1] * move[b, 0]) / area
        along_b = (between[:, 0] * move[a, 1] - between[:, 1] * move[a, 0]) / area
    return int(np.count_nonzero((along_a > 0) & (along_a < 1) & (along_b > 0) & (along_b < 1)))


def curvature_per_mm(points: FloatArray) -> FloatArray:
    """(n - 2,) turn from one move to the next over the way between their middles, seen from above."""
    move = np.diff(points[:, :2], axis=0)
    size = np.linalg.norm(move, axis=1)
    turn = np.diff(np.unwrap(np.arctan2(move[:, 1], move[:, 0])))
    return np.asarray(np.abs(turn) / ((size[1:] + size[:-1]) / 2))


def tilted() -> LineDensity:
    """Four times as much is to be removed at the right as at the left."""
    x, _ = np.meshgrid(GRID.x_mm, GRID.y_mm)
    return LineDensity.of_removal(GRID, 50 + x, GRID.radius_mm() < 30)


def test_the_check_for_crossings_finds_one() -> None:
    loop = np.array([(0, 0), (1, 0), (1, 1), (0.5, 1), (0.5, -1)], dtype=float)
    assert crossings(loop) == 1
    assert crossings(loop[:-1]) == 0


@pytest.mark.full
@pytest.mark.parametrize("optic", [FLAT, OFF_AXIS])
@pytest.mark.parametrize("name", APERTURES)
def test_a_random_raster_covers_any_aperture_without_crossing(name: str, optic: Optic) -> None:
    aperture = APERTURES[name]
    points = random_raster(aperture, 0.8, 1.0, seed=1, min_radius_mm=2.5, optic=optic, landing_mm=6.0)
    assert crossings(points) == 0
    near = KDTree(points[:, :2]).query(samples(aperture))[0]
    assert near.max() < 1.0, "half of the largest distance of lines, and half a step"
    np.testing.assert_allclose(points[:, 2], sag_mm(optic, points[:, :2]), atol=1e-12)
    assert (outside(aperture, points[[0, -1]]) > 6.0 - 1e-3).all()
    bend = curvature_per_mm(points)
    on_part = outside(aperture.larger(1.0), points[1:-1]) < -1.5
    assert bend[on_part].max() <= 1 / 2.5
    assert bend[on_part].max() > 0.2 / 2.5, "it uses what it may"


@pytest.mark.full
@pytest.mark.parametrize("direction", [0.0, 37.0])
def test_the_path_is_as_long_as_that_of_a_raster(direction: float) -> None:
    straight = lengths(raster(circle(60), 0.8, 1.0, direction_deg=direction)).sum()
    wandering = lengths(random_raster(circle(60), 0.8, 1.0, direction_deg=direction)).sum()
    assert wandering == pytest.approx(straight, rel=0.05)


@pytest.mark.full
def test_the_seed_makes_the_path() -> None:
    one, again, other = (random_raster(circle(40), 1.0, 1.0, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert len(one) != len(other) or np.abs(one - other).max() > 0.5


@pytest.mark.full
def test_any_seed_gives_a_path() -> None:
    for seed in range(30):
        points = random_raster(rectangle(60, 30), 0.9, 1.0, seed=seed)
        assert crossings(points) == 0, seed


@pytest.mark.full
def test_no_direction_has_most_of_the_lines() -> None:
    """The pattern has its power at (direction, distance) of its lines: of both the spread is what the design says."""
    points = random_raster(circle(100), 0.8, 1.0, seed=2)
    move = np.diff(points[:, :2], axis=0)
    on_part = np.hypot(*points[1:, :2].T) < 48
    slope = move[on_part, 1] / move[on_part, 0]
    assert 0.3 < slope.std() < 0.7
    assert np.abs(np.mean(slope)) < 0.2


def test_lines_lie_denser_where_more_is_to_be_removed() -> None:
    points = adaptive_raster(circle(60), 1.0, 1.0, tilted(), direction_deg=90.0)
    assert crossings(points) == 0
    x = points[np.hypot(*points[:, :2].T) < 29, 0]
    right, left = np.count_nonzero((x > 10) & (x < 20)), np.count_nonzero((x < -10) & (x > -20))
    assert right / left == pytest.approx((65 / 35) ** 0.5, rel=0.1)
    straight = lengths(raster(circle(60), 1.0, 1.0)).sum()
    assert lengths(points).sum() == pytest.approx(straight, rel=0.05)


@pytest.mark.full
@pytest.mark.parametrize("name", APERTURES)
def test_an_adaptive_raster_covers_any_aperture_without_crossing(name: str) -> None:
    rng = np.random.default_rng(3)
    rough = LineDensity(GRID, rng.uniform(0.6, 1.7, GRID.shape))
    for density in (tilted(), rough):
        points = adaptive_raster(APERTURES[name], 0.8, 1.0, density, min_radius_mm=2.5, landing_mm=6.0)
        assert crossings(points) == 0
        assert KDTree(points[:, :2]).query(samples(APERTURES[name]))[0].max() < 1.2
        on_part = outside(APERTURES[name].larger(1.0), points[1:-1]) < -1.5
        assert curvature_per_mm(points)[on_part].max() <= 1 / 2.5
        assert (outside(APERTURES[name], points[[0, -1]]) > 6.0 - 1e-3).all()


@pytest.mark.full
def test_random_lines_follow_a_density_too() -> None:
    def right_over_left(density: LineDensity | None) -> float:
        points = random_raster(circle(60), 1.0, 1.0, density=density, direction_deg=90.0)
        assert crossings(points) == 0
        x = points[np.hypot(*points[:, :2].T) < 29, 0]
        return float(np.count_nonzero(x > 5) / np.count_nonzero(x < -5))

    assert right_over_left(tilted()) > 1.15 * right_over_left(None)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ({"pitch_mm": 0.0}, "the pitch is 0 mm"),
        ({"step_mm": -1.0}, "the step is -1 mm"),
        ({"pitch_mm": 1e-5}, "the number of points is"),
        ({"seed": -1}, "the seed is -1"),
        ({"min_radius_mm": 0.0}, "the smallest radius of the path is 0 mm"),
        ({"min_radius_mm": 16.0}, "bends of 16 mm radius do not fit into a part of 20 mm radius, at most 10 mm do"),
    ],
)
def test_what_cannot_be_made_is_one_error(words: dict[str, float], what: str) -> None:
    with pytest.raises(ComputeError, match=what):
        random_raster(**{"aperture": circle(40), "pitch_mm": 1.0, "step_mm": 1.0, **words})  # type: ignore[arg-type]


def test_a_density_for_nothing_is_refused() -> None:
    with pytest.raises(ComputeError, match="nothing is to be removed"):
        LineDensity.of_removal(GRID, np.zeros(GRID.shape), GRID.radius_mm() < 30)


@pytest.mark.full
def test_a_hundred_thousand_points() -> None:
    began_s = time.process_time()
    points = random_raster(circle(300), 0.7, 1.0)
    assert len(points) > 100_000
    assert time.process_time() - began_s < 60, "20 s on a computer that is three times as fast"
    assert curvature_per_mm(points)[np.hypot(*points[1:-1, :2].T) < 149].max() < 1 / 3.0
