"""The effect matrix against brute force over a fine grid, against conservation and against symmetry."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from scipy import integrate, sparse

from polishd.model.errors import ComputeError
from polishd.model.process import Correction, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.process.removal import contact
from polishd.process.removal.dynamic_tif import effect_matrix, tif_at_point
from polishd.process.removal.tif import HertzSpot
from tests.unit.process.moves import program, raster

PAPER = ToolProcess()
DEPTH = contact.hertz_depth_mm(PAPER)
Point = tuple[float, float]


def effect(
    grid: Grid, moves: Program, gamma: float = 1.0, factor: float = 1.0, process: ToolProcess = PAPER
) -> sparse.csr_array:
    return effect_matrix(grid, HertzSpot(process), moves, np.full(moves.n, gamma), np.full(moves.n, factor))


def brute_force(
    grid: Grid, start: Point, end: Point, azimuth: float, depth: float, process: ToolProcess = PAPER
) -> np.ndarray:
    """(ny, nx) the same by sampling: 24 points a cell and direction, 40 stops on the way."""
    share = (np.arange(40) + 0.5) / 40
    stops = [np.asarray(start) + s * (np.asarray(end) - np.asarray(start)) for s in share]
    return np.asarray(np.mean([sampled(grid, at, azimuth, depth, process) for at in stops], axis=0))


def sampled(
    grid: Grid, at: np.ndarray, azimuth: float, depth: float, process: ToolProcess = PAPER, fine: int = 24
) -> np.ndarray:
    """(ny, nx) mean rate of a spot at rest over each cell, of ``fine`` points a cell and direction."""
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    right = (grid.x_mm[:, None] + offset * grid.pitch_mm).ravel()[None, :] - at[0]
    up = (grid.y_mm[:, None] - offset * grid.pitch_mm).ravel()[:, None] - at[1]
    along = right * np.cos(azimuth) + up * np.sin(azimuth)
    across = right * np.sin(azimuth) - up * np.cos(azimuth)
    rate = contact.removal_rate_nm_s(process, depth, across, along)
    return np.asarray(rate.reshape(grid.ny, fine, grid.nx, fine).mean(axis=(1, 3)))


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("pitch", "start", "end", "azimuth", "gamma"),
    [
        (1.0, (0.0, 0.0), (0.0, 0.0), 0.0, 1.0),
        (1.0, (0.3, -0.2), (1.1, 0.4), 0.9, 0.87),
        (0.5, (-0.61, 0.17), (0.39, 0.17), -2.2, 0.8),
        (1.0, (-3.0, 1.0), (3.5, -1.5), 2.0, 1.0),
        (0.25, (0.1, 0.0), (0.0, 0.25), 3.0, 1.0),
        (3.0, (0.4, 0.3), (1.4, 0.3), 1.0, 1.0),
    ],
)
def test_a_column_is_what_brute_force_says(
    pitch: float, start: Point, end: Point, azimuth: float, gamma: float
) -> None:
    cells = int(13 / pitch)
    grid = Grid(cells, cells + 1, pitch)
    want = brute_force(grid, start, end, azimuth, gamma * DEPTH)
    got = effect(grid, program([start], [end], azimuth), gamma).toarray().reshape(grid.shape)
    assert np.abs(got - want).max() < (3e-3 if pitch >= 0.5 else 2e-2) * want.max()


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("pitch", "largest", "half"), [(0.5, 0.012, 0.006), (1.0, 0.006, 0.003)])
def test_how_right_a_cell_is_is_what_the_docstring_says(pitch: float, largest: float, half: float) -> None:
    """Any place in the cell, azimuth and gamma from 0.75 to 1; of 500 such the worst were 1.10 and 0.54 %."""
    rng, grid, off = np.random.default_rng(7), Grid(int(5 / pitch), int(5 / pitch), pitch), []
    for _ in range(60):
        at, azimuth, gamma = rng.uniform(-pitch / 2, pitch / 2, 2), rng.uniform(0, 7), rng.uniform(0.75, 1)
        fine = sampled(grid, at, azimuth, gamma * DEPTH, fine=int(100 * pitch))
        got = effect(grid, program([at], [at], azimuth), gamma).toarray().reshape(grid.shape)
        off.append(np.abs(got - fine).max() / fine.max())
    assert largest / 2 < max(off) < largest
    assert np.median(off) < half


@pytest.mark.parametrize("azimuth", [0.0, 2.0])
def test_the_dissipative_shift_moves_the_pressure_but_not_the_speed(azimuth: float) -> None:
    thick = dataclasses.replace(PAPER, second_viscosity_mpa_s=0.02, viscosity_mpa_s=0.05)
    assert contact.dissipative_shift_mm(thick, DEPTH) > 0.2
    grid = Grid(14, 14, 0.5)
    want = brute_force(grid, (0.0, 0.0), (0.0, 0.0), azimuth, DEPTH, thick)
    got = effect(grid, program([[0.0, 0.0]], [[0.0, 0.0]], azimuth), process=thick).toarray().reshape(grid.shape)
    assert np.abs(got - want).max() < 6e-3 * want.max()


@pytest.mark.parametrize("pitch", [0.5, 1.0, 2.3])
def test_the_sum_of_a_column_is_the_volume_rate(pitch: float) -> None:
    rng = np.random.default_rng(4)
    start = rng.uniform(-8, 8, (300, 2))
    moves = program(start, start + rng.uniform(-4, 4, (300, 2)), rng.uniform(-4, 4, 300))
    gamma = rng.uniform(0.8, 1.0, 300)
    grid = Grid(int(40 / pitch), int(40 / pitch), pitch)
    matrix = effect_matrix(grid, HertzSpot(PAPER), moves, gamma, np.ones(300))
    want = contact.volume_rate_nm_mm2_s(PAPER, gamma * DEPTH)
    np.testing.assert_allclose(matrix.sum(axis=0) * pitch**2, want, rtol=1e-9)


def test_long_blocks_spread_evenly_and_lose_nothing() -> None:
    grid = Grid(20, 120, 1.0)
    matrix = effect(grid, program([[-40.0, 0.3]], [[40.0, 0.3]])).toarray().reshape(grid.shape)
    assert matrix.sum() == pytest.approx(contact.volume_rate_nm_mm2_s(PAPER, DEPTH)[0], rel=1e-9)
    middle = matrix.sum(axis=0)[30:90]
    assert np.ptp(middle) < 0.05 * middle.mean()


def test_up_is_up_and_right_is_right() -> None:
    grid = Grid(21, 31, 1.0)
    spot = effect(grid, program([[7.0, 4.0]], [[7.0, 4.0]])).toarray().reshape(grid.shape)
    row, column = np.unravel_index(spot.argmax(), grid.shape)
    assert (grid.x_mm[column], grid.y_mm[row]) == (7.0, 4.0)


def test_turning_the_spindle_by_a_quarter_turns_the_spot() -> None:
    grid = Grid(9, 9, 1.0)
    spots = [
        effect(grid, program([[0.0, 0.0]], [[0.0, 0.0]], k * np.pi / 2)).toarray().reshape(grid.shape) for k in (0, 1)
    ]
    np.testing.assert_allclose(np.rot90(spots[0]), spots[1], atol=1e-6 * spots[0].max())
    assert spots[0][4, 5] > 1.05 * spots[0][4, 3]  # leans towards +x: more on that side


def test_a_spot_off_the_grid_leaves_an_empty_column_and_one_across_its_edge_a_part() -> None:
    grid = Grid(20, 20, 1.0)
    edge = effect(
        grid,
        program([[0.0, 0.0], [30.0, 0.0], [10.0, 0.0], [0, -40]], [[0.0, 0.0], [31.0, 0.0], [10.0, 0.0], [0, -41]]),
    )
    volume = edge.sum(axis=0) / contact.volume_rate_nm_mm2_s(PAPER, DEPTH)
    np.testing.assert_allclose(volume, [1.0, 0.0, 0.5, 0.0], atol=0.07)
    assert (volume[[1, 3]] == 0).all()
    assert edge.shape == (400, 4)


def test_no_points_make_an_empty_matrix() -> None:
    assert effect(Grid(3, 4, 1.0), program(np.empty((0, 2)), np.empty((0, 2)))).shape == (12, 0)


def test_chunks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, moves = Grid(30, 30, 1.0), raster(2.0, 10.0)
    whole = effect(grid, moves)
    monkeypatch.setattr("polishd.process.removal.dynamic_tif.CHUNK", 7)
    assert abs(effect(grid, moves) - whole).max() < 1e-12 * whole.max()


def test_the_factor_multiplies() -> None:
    grid, moves = Grid(30, 30, 1.0), raster(5.0, 10.0)
    assert abs(effect(grid, moves, factor=0.4) - 0.4 * effect(grid, moves)).max() < 1e-12


@pytest.mark.full
@pytest.mark.parametrize("pitch", [1.0, 0.5])
def test_a_raster_of_ten_thousand_blocks_takes_well_below_two_seconds(pitch: float) -> None:
    moves, grid = raster(1.0), Grid(int(106 / pitch), int(106 / pitch), pitch)
    begin = time.process_time()
    matrix = effect(grid, moves)
    assert time.process_time() - begin < 2.0
    assert moves.n == 10100
    inner = (np.abs(grid.x_mm) < 45)[None, :] & (np.abs(grid.y_mm) < 45)[:, None]
    even = matrix.sum(axis=1).reshape(grid.shape)[inner]
    assert even.mean() == pytest.approx(contact.volume_rate_nm_mm2_s(PAPER, DEPTH)[0], rel=1e-3)
    assert even.std() < 0.02 * even.mean()


def volume_ratio(correction: Correction, gamma: np.ndarray) -> np.ndarray:
    """Volume of the corrected spot over the rigid robot's."""
    spots = tif_at_point(correction, gamma)
    volume = contact.volume_rate_nm_mm2_s(PAPER, spots.depth_ratio * DEPTH)
    return spots.factor * volume / contact.volume_rate_nm_mm2_s(PAPER, DEPTH)


def test_corrections_stand_for_what_they_say() -> None:
    gamma = np.array([0.85, 0.91])
    np.testing.assert_allclose(volume_ratio("none", gamma), 1, rtol=1e-12)
    np.testing.assert_allclose(volume_ratio("pointwise", gamma), 1, rtol=1e-12)
    np.testing.assert_allclose(volume_ratio("linear", gamma), gamma, rtol=1e-12)
    np.testing.assert_allclose(volume_ratio("power", gamma), gamma**1.5, rtol=1e-12)
    # nearly: the speed changes with the depth too
    np.testing.assert_allclose(volume_ratio("exact", gamma), gamma**1.5, rtol=2e-3)
    assert (tif_at_point("exact", gamma).depth_ratio == gamma).all()


def test_only_pointwise_divides_the_dwell() -> None:
    gamma = np.array([0.85, 0.91])
    every: tuple[Correction, ...] = ("none", "linear", "power", "exact", "pointwise")
    *others, pointwise = (tif_at_point(name, gamma).divide_by for name in every)
    assert others == [None] * 4
    np.testing.assert_array_equal(pointwise, gamma)


def test_pointwise_and_linear_give_one_removal() -> None:
    """The trap in the paper's comparison: ``R_0 diag(gamma) (t / gamma) = R_0 t``."""
    grid, moves = Grid(40, 40, 1.0), raster(4.0, 12.0)
    rng = np.random.default_rng(8)
    gamma, dwell = rng.uniform(0.83, 0.92, moves.n), rng.uniform(0, 5, moves.n)
    linear, pointwise = (tif_at_point(name, gamma) for name in ("linear", "pointwise"))
    plant = effect_matrix(grid, HertzSpot(PAPER), moves, linear.depth_ratio, linear.factor)
    believed = effect_matrix(grid, HertzSpot(PAPER), moves, pointwise.depth_ratio, pointwise.factor)
    assert pointwise.divide_by is not None
    np.testing.assert_allclose(plant @ (dwell / pointwise.divide_by), believed @ dwell, rtol=1e-12)


def test_the_exponent_of_power_is_the_process_s() -> None:
    gamma = np.array([0.8, 0.9])
    np.testing.assert_allclose(tif_at_point("power", gamma, 1.8).factor, gamma**1.8, rtol=1e-15)


def test_a_spot_of_another_depth_ratio_can_stand_for_all() -> None:
    """One measured at gamma 0.9, or the static spot calibrated at the mean pose."""
    gamma = np.array([0.81, 0.9])
    for name, factor in (("none", [1, 1]), ("linear", [0.9, 1]), ("power", [0.9**2, 1]), ("pointwise", [1, 1])):
        spots = tif_at_point(name, gamma, 2.0, 0.9)
        np.testing.assert_allclose(spots.factor, factor, rtol=1e-12)
        assert (spots.depth_ratio == 0.9).all()
    np.testing.assert_allclose(tif_at_point("pointwise", gamma, 2.0, 0.9).divide_by, [0.9, 1], rtol=1e-12)
    assert (tif_at_point("exact", gamma, 2.0, 0.9).depth_ratio == gamma).all()


def test_an_unknown_correction_is_refused() -> None:
    with pytest.raises(ComputeError, match="no correction 'guess'; use exact"):
        tif_at_point("guess", np.ones(1))  # type: ignore[arg-type]


@pytest.mark.parametrize("azimuth", [0.0, 1.0, -2.5])
def test_the_spots_offset_turns_with_the_spindle(azimuth: float) -> None:
    """y of the tool's frame is where the spindle leans, x is to its right seen from above."""
    grid, moves = Grid(81, 81, 0.25), program([[0.5, -1.0]], [[0.5, -1.0]], azimuth)
    along, right = 3.0, 1.2
    offset = dataclasses.replace(PAPER, spot_offset_mm=(right, along))
    lean = np.array([np.cos(azimuth), np.sin(azimuth)])
    want = along * lean + right * np.array([lean[1], -lean[0]])
    centre = []
    for process in (PAPER, offset):
        spot = effect(grid, moves, process=process).toarray().reshape(grid.shape)
        centre.append(np.array([(spot.sum(axis=0) @ grid.x_mm), spot.sum(axis=1) @ grid.y_mm]) / spot.sum())
    np.testing.assert_allclose(centre[1] - centre[0], want, atol=1e-4)


def test_the_cells_hold_the_volume_of_an_adaptive_integral() -> None:
    """Volume conserved to 1e-6, against an integral that shares no code with the patch."""
    radius, shift = (float(f(PAPER, DEPTH)) for f in (contact.contact_radius_mm, contact.dissipative_shift_mm))

    def ring(rho: float, angle: float) -> float:
        x, y = shift + rho * np.cos(angle), rho * np.sin(angle)
        return rho * float(contact.removal_rate_nm_s(PAPER, DEPTH, np.array(x), np.array(y)))

    want = integrate.dblquad(ring, 0, 2 * np.pi, 0, radius, epsrel=1e-9)[0]
    moves = program([[0.21, -0.4], [-3.0, 2.0]], [[0.21, -0.4], [3.0, 2.5]], 0.6)
    for pitch in (0.2, 1.0, 1.7):
        got = effect(Grid(31, 32, pitch), moves).sum(axis=0) * pitch**2
        np.testing.assert_allclose(got if pitch > 0.5 else got[:1], want, rtol=1e-6)


@pytest.mark.parametrize(("gamma", "factor"), [(np.nan, 1.0), (0.0, 1.0), (-0.2, 1.0), (1.0, np.nan), (1.0, -1.0)])
def test_an_impossible_depth_or_factor_is_refused(gamma: float, factor: float) -> None:
    with pytest.raises(ComputeError, match=r"point 0: the (depth ratio gamma|factor on the removal) is"):
        effect(Grid(3, 3, 1.0), program([[0.0, 0.0]], [[0.0, 0.0]]), gamma, factor)
