"""How far inside a part's rim a point lies, and which way the rim is: round parts, and masks of any outline."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.edge.rim import mask_rim, round_rim

GRID = Grid(140, 160, 0.5)
RADIUS = 28.0


def points(seed: int = 0, within: float = 34.0, n: int = 400) -> FloatArray:
    return np.random.default_rng(seed).uniform(-within, within, (n, 2))


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.abs(np.angle(np.exp(1j * (a - b)))), dtype=np.float64)


def test_a_round_part() -> None:
    rim = round_rim(RADIUS)
    at = np.array([[0.0, 0.0], [28.0, 0.0], [0.0, -30.0], [3.0, 4.0]])
    np.testing.assert_allclose(rim.inside_mm(at), [28, 0, -2, 23], atol=1e-12)
    np.testing.assert_allclose(rim.outward_rad(at)[1:], [0, -np.pi / 2, np.arctan2(4, 3)])


def test_a_round_mask_is_a_round_part() -> None:
    rim, true = mask_rim(GRID, GRID.radius_mm() <= RADIUS), round_rim(RADIUS)
    at = points()
    np.testing.assert_allclose(rim.inside_mm(at), true.inside_mm(at), atol=0.6 * GRID.pitch_mm)
    near = np.abs(true.inside_mm(at)) < 5
    assert near.sum() > 50
    assert angle_between(rim.outward_rad(at), true.outward_rad(at))[near].max() < np.radians(5)


def test_a_straight_rim_lies_between_the_samples() -> None:
    part = np.broadcast_to(GRID.x_mm < 10.0, GRID.shape)
    edge = GRID.x_mm[np.flatnonzero(part[0])[-1]] + GRID.pitch_mm / 2
    rim = mask_rim(GRID, part)
    x = np.linspace(edge - 3, edge + 3, 61)
    np.testing.assert_allclose(rim.inside_mm(np.column_stack([x, 0 * x])), edge - x, atol=1e-9)
    np.testing.assert_allclose(rim.outward_rad(np.column_stack([x, 0 * x])), 0, atol=1e-9)
    up = mask_rim(GRID, np.broadcast_to((GRID.y_mm < 5.0)[:, None], GRID.shape))
    assert up.outward_rad(np.array([[3.0, 5.0]]))[0] == pytest.approx(np.pi / 2)
    assert up.inside_mm(np.array([[3.0, 20.0], [3.0, 0.0]])) == pytest.approx([-15.0, 5.0], abs=0.26)


def test_a_bore_has_a_rim_of_its_own() -> None:
    radius = GRID.radius_mm()
    rim = mask_rim(GRID, (radius <= RADIUS) & (radius > 6.0))
    at = np.array([[7.0, 0.0], [5.0, 0.0], [0.0, 0.0], [17.0, 0.0]])
    np.testing.assert_allclose(rim.inside_mm(at), [1, -1, -6, 11], atol=0.6)
    assert angle_between(rim.outward_rad(at[:1]), np.array([np.pi]))[0] < np.radians(5)


def test_beyond_the_map_there_is_no_part() -> None:
    whole = mask_rim(GRID, np.ones(GRID.shape, dtype=bool))
    at = np.array([[39.75, 0.0], [40.0, 0.0], [50.0, 0.0], [0.0, 0.0], [0.0, -60.0]])
    np.testing.assert_allclose(whole.inside_mm(at), [0.25, 0.25, -10, 35, -25], atol=0.51)
    assert (np.diff(whole.inside_mm(np.column_stack([np.linspace(0, 80, 400), np.zeros(400)]))) <= 1e-9).all()


def test_what_is_no_part_is_refused() -> None:
    for radius in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ComputeError, match="the part's radius"):
            round_rim(radius)
    with pytest.raises(ComputeError, match="the part's mask is empty"):
        mask_rim(GRID, np.zeros(GRID.shape, dtype=bool))
    with pytest.raises(ComputeError, match=r"the part's mask is \(3, 3\), the grid \(140, 160\)"):
        mask_rim(GRID, np.ones((3, 3), dtype=bool))
