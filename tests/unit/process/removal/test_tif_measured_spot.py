"""A measured spot along a path: what it removes where, turned, shrunk, and against the model that it was made with."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import Grid
from polishd.process.removal import contact
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.tif import SQUARES, HertzSpot, Spot, measured_spot
from tests.unit.process.moves import program, raster

PAPER = ToolProcess()
DEPTH = contact.hertz_depth_mm(PAPER)


def gaussian(sigma_x: float = 0.8, sigma_y: float = 0.4, pitch: float = 0.1, **about: Any) -> MeasuredTif:
    """An elliptic spot, long in the map's x."""
    line = np.arange(-30, 31) * 0.1 if pitch == 0.1 else np.arange(-int(3 / pitch), int(3 / pitch) + 1) * pitch
    rate = 50 * np.exp(-(line[None, :] ** 2) / 2 / sigma_x**2 - line[:, None] ** 2 / 2 / sigma_y**2)
    rate[np.hypot(line[None, :], line[:, None]) > 3.0] = 0
    return MeasuredTif(rate, pitch, **about)


def volume(tif: MeasuredTif) -> float:
    return float(tif.rate_nm_s.sum()) * tif.pitch_mm**2


def at_rest(spot: Spot, grid: Grid, azimuth: float = 0.0, gamma: float = 1.0, at: tuple[float, float] = (0, 0)) -> Any:
    """(ny, nx) nm/s of one dwell."""
    matrix = effect_matrix(grid, spot, program([at], [at], azimuth), np.array([gamma]), np.ones(1))
    return matrix.toarray().reshape(grid.shape)


def second_moments(rate: np.ndarray, grid: Grid) -> np.ndarray:
    """(2, 2) central second moments, mm^2."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    w = rate / rate.sum()
    x, y = x - (w * x).sum(), y - (w * y).sum()
    return np.array([[(w * x * x).sum(), (w * x * y).sum()], [(w * x * y).sum(), (w * y * y).sum()]])


@pytest.mark.parametrize("pitch", [0.1, 0.23, 0.5])
def test_the_squares_hold_the_measured_volume(pitch: float) -> None:
    tif = gaussian(pitch=pitch)
    spot = measured_spot(tif, PAPER)
    assert len(spot.squares) <= SQUARES
    assert spot.squares.sum() == pytest.approx(volume(tif), rel=1e-12)
    patch = spot.patch(np.ones(5), np.linspace(-3, 3, 5))
    np.testing.assert_allclose(patch.sum(axis=(1, 2)), volume(tif), rtol=1e-9)
    assert (patch >= 0).all()


def test_laid_down_as_it_was_measured_it_is_the_map() -> None:
    """On cells of three samples of the map, each holds their mean."""
    tif = gaussian(azimuth_deg=40.0)
    grid = Grid(21, 21, 0.3)
    padded = np.pad(tif.rate_nm_s, 1)
    want = padded.reshape(21, 3, 21, 3).mean(axis=(1, 3))
    got = at_rest(measured_spot(tif, PAPER), grid, np.radians(40.0))
    np.testing.assert_allclose(got, want, atol=1e-12 * want.max())


@pytest.mark.parametrize("azimuth", [0.0, 20.0, 90.0, 135.0, -100.0])
def test_it_turns_with_the_spindle(azimuth: float) -> None:
    grid = Grid(61, 61, 0.125)
    spot = at_rest(measured_spot(gaussian(azimuth_deg=30.0), PAPER), grid, np.radians(azimuth))
    turn = np.radians(azimuth - 30.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    want = rotation @ np.diag([0.64, 0.16]) @ rotation.T
    np.testing.assert_allclose(second_moments(spot, grid), want, atol=0.01)


def test_it_does_not_turn_where_the_tool_s_precession_does_not() -> None:
    grid = Grid(61, 61, 0.125)
    spot = measured_spot(gaussian(rotates=False), PAPER)
    np.testing.assert_array_equal(at_rest(spot, grid, 1.0), at_rest(spot, grid, -2.0))


@pytest.mark.parametrize("exponent", [1.5, 1.8])
def test_depth_changes_its_size_and_volume_as_hertz_does(exponent: float) -> None:
    process = dataclasses.replace(PAPER, depth_exponent=exponent)
    grid, tif = Grid(61, 61, 0.125), gaussian(depth_ratio=0.9)
    as_is, deep = (at_rest(measured_spot(tif, process), grid, gamma=g) for g in (0.9, 0.99))
    assert as_is.sum() * 0.125**2 == pytest.approx(volume(tif), rel=1e-9)
    assert deep.sum() / as_is.sum() == pytest.approx(1.1**exponent, rel=1e-9)
    np.testing.assert_allclose(second_moments(deep, grid), 1.1 * second_moments(as_is, grid), atol=0.005)


def test_its_offset_turns_too() -> None:
    process = dataclasses.replace(PAPER, spot_offset_mm=(0.2, 1.0))
    grid = Grid(81, 81, 0.125)
    spot = at_rest(measured_spot(gaussian(rotates=False), process), grid, np.pi / 2, at=(0.5, 0.0))
    x, y = (spot.sum(axis=0) @ grid.x_mm) / spot.sum(), (spot.sum(axis=1) @ grid.y_mm) / spot.sum()
    assert (x, y) == pytest.approx((0.5 + 0.2, 1.0), abs=1e-5)  # leaning to +y, the tool's x is the part's


def as_measured(azimuth_deg: float) -> MeasuredTif:
    """The paper's spot as a perfect measurement would give it, about its contact's centre."""
    line = np.arange(-60, 61) * 0.03
    right, up = np.meshgrid(line, -line)
    azimuth = np.radians(azimuth_deg)
    x, y = right * np.sin(azimuth) - up * np.cos(azimuth), right * np.cos(azimuth) + up * np.sin(azimuth)
    fine = ((np.arange(6) + 0.5) / 6 - 0.5) * 0.03
    rate = np.mean([contact.removal_rate_nm_s(PAPER, DEPTH, x + a, y + b) for a in fine for b in fine], axis=0)
    return MeasuredTif(rate, 0.03, azimuth_deg)


def test_a_measured_hertz_spot_is_the_hertz_spot_along_a_path() -> None:
    """Turned by each point's azimuth and shrunk by each point's depth, over the whole of a raster."""
    grid, moves = Grid(50, 50, 1.0), raster(4.0, 16.0)
    gamma = np.random.default_rng(1).uniform(0.83, 1.0, moves.n)
    measured = effect_matrix(grid, measured_spot(as_measured(77.0), PAPER), moves, gamma, np.ones(moves.n))
    modelled = effect_matrix(grid, HertzSpot(PAPER), moves, gamma, np.ones(moves.n))
    assert abs(measured - modelled).max() < 0.01 * modelled.max()
    np.testing.assert_allclose(measured.sum(axis=0), modelled.sum(axis=0), rtol=2e-3)


def test_a_moving_spot_loses_nothing() -> None:
    tif = gaussian()
    moves = program([[-9.0, 0.4]], [[9.0, -0.3]], 0.5)
    got = effect_matrix(Grid(40, 40, 1.0), measured_spot(tif, PAPER), moves, np.ones(1), np.ones(1))
    assert got.sum() == pytest.approx(volume(tif), rel=1e-9)
    middle = got.toarray().reshape(40, 40).sum(axis=0)[14:26]
    assert np.ptp(middle) < 0.02 * middle.mean()


def test_no_points_have_no_patches() -> None:
    assert measured_spot(gaussian(), PAPER).patch(np.empty(0), np.empty(0)).shape[0] == 0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pitch_mm": 0.0}, "measured TIF's pitch is 0 mm"),
        ({"depth_ratio": -0.1}, "measured TIF's depth_ratio is -0.1"),
        ({"azimuth_deg": np.nan}, "measured TIF's azimuth_deg is nan deg"),
        ({"rate_nm_s": np.zeros((5, 5))}, "runs from 0 to 0 nm/s"),
        ({"rate_nm_s": np.eye(3) - 0.1}, "runs from -0.1 to 0.9 nm/s"),
        ({"rate_nm_s": np.full((5, 5), np.nan)}, "must be a map of finite rates"),
        ({"rate_nm_s": np.zeros(5)}, r"its shape is \(5,\)"),
        ({"rate_nm_s": np.zeros((0, 5))}, r"its shape is \(0, 5\)"),
    ],
)
def test_what_is_no_tif_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        measured_spot(dataclasses.replace(gaussian(), **changes), PAPER)


def test_an_impossible_process_is_refused_here_too() -> None:
    with pytest.raises(ComputeError, match="force_n is 0 N"):
        measured_spot(gaussian(), dataclasses.replace(PAPER, force_n=0.0))
