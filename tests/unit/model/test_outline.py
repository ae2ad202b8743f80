"""Outlines: what lies inside, how far, and which corners enclose nothing."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path as Drawn

from polishd.model.errors import ComputeError
from polishd.model.outline import MOST_CORNERS, Circle, Outline, Polygon, hexagon, polygon, rectangle

ELL = [(-3.0, -2.0), (3.0, -2.0), (3.0, 0.5), (0.5, 0.5), (0.5, 4.0), (-3.0, 4.0)]
TURN = np.arange(10) * np.pi / 5
STAR = np.tile([1.5, 4.0], 5)[:, None] * np.stack([np.cos(TURN), np.sin(TURN)], axis=1)


@pytest.mark.parametrize("outline", [polygon(ELL), polygon(ELL[::-1]), polygon(STAR), hexagon(6.0), rectangle(5, 3)])
def test_points_lie_inside_as_matplotlib_has_it_and_as_far_from_the_sides_as_they_are(outline: Polygon) -> None:
    x, y = np.random.default_rng(1).uniform(-5, 5, (2, 4000))
    inside = outline.inside_mm(x, y)
    np.testing.assert_array_equal(inside > 0, Drawn(outline.corners()).contains_points(np.stack([x, y], axis=1)))
    share = np.linspace(0, 1, 2001)[:, None, None]
    corners = outline.corners()
    sides = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    near = [np.hypot(sides[:, 0] - a, sides[:, 1] - b).min() for a, b in zip(x[:200], y[:200], strict=True)]
    np.testing.assert_allclose(np.abs(inside[:200]), near, atol=4e-3)


@pytest.mark.parametrize(
    ("outline", "area", "radius", "half", "words"),
    [
        (Circle(25.0), np.pi * 625, 25.0, (25.0, 25.0), "a circle of 50 mm"),
        (Circle(25.0, 10.0), np.pi * 525, 25.0, (25.0, 25.0), "a circle of 50 mm, less a hole of 20 mm"),
        (rectangle(40, 24), 960.0, np.hypot(20, 12), (20.0, 12.0), "a rectangle of 40 x 24 mm"),
        (hexagon(30.0), 900 * np.sqrt(3) / 2, 15 / np.cos(np.pi / 6), (15 / np.cos(np.pi / 6), 15.0), "a hexagon of "),
        (polygon([*ELL, ELL[0]]), 6 * 2.5 + 3.5 * 3.5, 5.0, (3.0, 4.0), "a polygon of 6 x 6 mm"),
    ],
)
def test_sizes(outline: Outline, area: float, radius: float, half: tuple[float, float], words: str) -> None:
    assert outline.area_mm2 == pytest.approx(area)
    assert outline.radius_mm == pytest.approx(radius)
    assert outline.half_mm == pytest.approx(half)
    assert str(outline).startswith(words)


def test_an_edge_is_kept_from_the_rim_and_a_sample_on_it_counts() -> None:
    x = np.array([0.0, 17.0, 17.1, 20.0, 20.1, 30.0])
    for outline in (Circle(20.0), rectangle(40.0, 24.0)):
        np.testing.assert_array_equal(outline.contains(x, np.zeros(6)), [True, True, True, True, False, False])
        np.testing.assert_array_equal(outline.contains(x, np.zeros(6), 3.0), [True, True, False, False, False, False])
        np.testing.assert_array_equal(outline.contains(x, np.zeros(6), -10.0), np.ones(6))
    third = hexagon(6.0 * np.sqrt(3))
    assert third.contains(np.array([4.5]), np.array([1.5 * np.sqrt(3)])).all()  # on a slanting side, but for rounding


def test_a_ring_is_kept_from_both_its_rims() -> None:
    x = np.array([0.0, 4.9, 5.0, 7.9, 8.0, 12.0, 17.0, 17.1, 20.0, 20.1])
    ring = Circle(20.0, 5.0)
    np.testing.assert_array_equal(ring.contains(x, 0.0), [False] * 2 + [True] * 7 + [False])
    np.testing.assert_array_equal(ring.contains(x, 0.0, 3.0), [False] * 4 + [True] * 3 + [False] * 3)
    np.testing.assert_allclose(ring.inside_mm(x, 0.0)[[0, 4, 6, 9]], [-5, 3, 3, -0.1])
    assert ring.depth_mm == 7.5


def test_grids_are_taken_as_rows_and_columns() -> None:
    x, y = np.linspace(-30, 30, 61)[None, :], np.linspace(20, -20, 41)[:, None]
    assert np.count_nonzero(rectangle(40, 24).contains(x, y)) == 41 * 25
    assert rectangle(40, 24).inside_mm(x, y).shape == Circle(3.0).inside_mm(x, y).shape == (41, 61)


@pytest.mark.parametrize(
    ("corners", "says"),
    [
        (ELL[:2], "has 3 to 500 corners, not 2"),
        ([(k, k * k) for k in range(MOST_CORNERS + 1)], "not 501"),
        ([(0, 0), (1, 0), (np.nan, 1)], "no finite number"),
        ([(0, 0), (1, 0), (1, 0), (1, 1)], "corners 2 and 3 of the polygon are the same"),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "begin at its corners 1 and 3 cross"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "begin at its corners 1 and 3 cross or touch"),
        ([(0, 0), (2, 0), (1, 0)], "cross or touch"),
        ([(0, 0), (2, 0), (2, 2), (2, 5), (2, 3), (0, 2)], "begin at its corners 3 and 4 cross or touch"),
    ],
)
def test_corners_that_enclose_nothing_are_refused(corners: list[tuple[float, float]], says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        polygon(corners)


def test_a_hole_is_smaller_than_its_circle() -> None:
    for hole in (5.0, -1.0, np.nan):
        with pytest.raises(ComputeError, match="it must be less than 10 mm"):
            Circle(5.0, hole)


@pytest.mark.parametrize(
    "made", [lambda: Circle(0.0), lambda: Circle(np.nan), lambda: rectangle(4, -1), lambda: hexagon(np.inf)]
)
def test_lengths_that_are_none_are_refused(made: type) -> None:
    with pytest.raises(ComputeError, match="it must be above 0"):
        made()
