"""The effect matrix against brute force over a fine grid, against conservation and against symmetry."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, Placement, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.process import contact
from polishd.process.dynamic_tif import corrected_spot, effect_matrix, path_compliance
from polishd.process.frames import rotation_from_rpy_deg
from polishd.process.robot import inverse_kinematics

PAPER = ToolProcess()
DEPTH = 0.14834891
DIP = np.radians(15.0)
ROBOT = HybridRobot()
Point = tuple[float, float]
PLACEMENT = Placement((300.0, 220.0, 2315.0), rotation_from_rpy_deg(180.0, 0.0, 0.0))


def program(start: ArrayLike, end: ArrayLike, azimuth: ArrayLike = 0.0) -> Program:
    """A program of moves from (n, 2) to (n, 2) mm with the spindle leaning towards the (n,) azimuth, rad."""
    start, end = (np.column_stack([a, np.zeros(len(a))]) for a in np.broadcast_arrays(*np.atleast_2d(start, end)))
    n = len(end)
    azimuth = np.broadcast_to(azimuth, n)
    axis = np.stack([np.cos(azimuth) * np.sin(DIP), np.sin(azimuth) * np.sin(DIP), np.full(n, np.cos(DIP))], axis=1)
    index = np.arange(n)
    return Program(b"", "", "p", "rs274", "feed", index + 1, index, start, end, axis, np.ones(n), n, 600.0)


def inward_program(start: ArrayLike, end: ArrayLike) -> Program:
    """The same on the shipped part with the spindle leaning towards the base's z axis."""
    moves = program(start, end)
    base = moves.end_mm * [1, -1, -1] + np.array(PLACEMENT.origin_mm)
    return program(start, end, np.arctan2(base[:, 1], -base[:, 0]))


def raster(step: float, half: float = 50.0) -> Program:
    line = np.arange(-half, half + 1e-9, step)
    x, y = np.meshgrid(line, line)
    start, end = (np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((x[:, :-1], y[:, :-1]), (x[:, 1:], y[:, 1:])))
    return inward_program(start, end)


def effect(
    grid: Grid, moves: Program, depth: float = DEPTH, factor: float = 1.0, process: ToolProcess = PAPER
) -> sparse.csr_array:
    return effect_matrix(grid, process, moves, np.full(moves.n, depth), np.full(moves.n, factor))


def brute_force(
    grid: Grid, start: Point, end: Point, azimuth: float, depth: float, process: ToolProcess = PAPER
) -> np.ndarray:
    """(ny, nx) the same by sampling: 24 points a cell and direction, 40 stops on the way."""
    fine, steps = 24, 40
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    x = (grid.x_mm[:, None] + offset * grid.pitch_mm).ravel()[None, :]
    y = (grid.y_mm[:, None] - offset * grid.pitch_mm).ravel()[:, None]
    total = np.zeros((grid.ny, grid.nx))
    for k in range(steps):
        here = np.asarray(start) + (k + 0.5) / steps * (np.asarray(end) - np.asarray(start))
        right, up = x - here[0], y - here[1]
        along = right * np.cos(azimuth) + up * np.sin(azimuth)
        across = right * np.sin(azimuth) - up * np.cos(azimuth)
        rate = contact.removal_rate_nm_s(process, depth, across, along)
        total += rate.reshape(grid.ny, fine, grid.nx, fine).mean(axis=(1, 3)) / steps
    return total


@pytest.mark.parametrize(
    ("pitch", "start", "end", "azimuth", "depth"),
    [
        (1.0, (0.0, 0.0), (0.0, 0.0), 0.0, DEPTH),
        (1.0, (0.3, -0.2), (1.1, 0.4), 0.9, 0.87 * DEPTH),
        (0.5, (-0.61, 0.17), (0.39, 0.17), -2.2, 0.8 * DEPTH),
        (1.0, (-3.0, 1.0), (3.5, -1.5), 2.0, DEPTH),
        (0.25, (0.1, 0.0), (0.0, 0.25), 3.0, DEPTH),
        (3.0, (0.4, 0.3), (1.4, 0.3), 1.0, DEPTH),
    ],
)
def test_a_column_is_what_brute_force_says(
    pitch: float, start: Point, end: Point, azimuth: float, depth: float
) -> None:
    cells = int(13 / pitch)
    grid = Grid(cells, cells + 1, pitch)
    want = brute_force(grid, start, end, azimuth, depth)
    got = effect(grid, program([start], [end], azimuth), depth).toarray().reshape(grid.shape)
    assert np.abs(got - want).max() < (3e-3 if pitch >= 0.5 else 2e-2) * want.max()


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
    depth = rng.uniform(0.8, 1.0, 300) * DEPTH
    grid = Grid(int(40 / pitch), int(40 / pitch), pitch)
    matrix = effect_matrix(grid, PAPER, moves, depth, np.ones(300))
    want = contact.volume_rate_nm_mm2_s(PAPER, depth)
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
    monkeypatch.setattr("polishd.process.dynamic_tif.CHUNK", 7)
    assert abs(effect(grid, moves) - whole).max() < 1e-12 * whole.max()


def test_the_factor_multiplies() -> None:
    grid, moves = Grid(30, 30, 1.0), raster(5.0, 10.0)
    assert abs(effect(grid, moves, factor=0.4) - 0.4 * effect(grid, moves)).max() < 1e-12


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


def test_corrections_stand_for_what_they_say() -> None:
    gamma = np.array([0.85, 0.91])
    volume = contact.volume_rate_nm_mm2_s(PAPER, np.array([DEPTH]))[0]
    ratio = {}
    for name in ("exact", "none", "linear", "power"):
        depth, factor = corrected_spot(name, DEPTH, gamma)
        ratio[name] = factor * contact.volume_rate_nm_mm2_s(PAPER, depth) / volume
        assert (depth == (gamma * DEPTH if name == "exact" else DEPTH)).all()
    np.testing.assert_allclose(ratio["none"], 1, rtol=1e-12)
    np.testing.assert_allclose(ratio["linear"], gamma, rtol=1e-12)
    np.testing.assert_allclose(ratio["power"], gamma**1.5, rtol=1e-12)
    np.testing.assert_allclose(ratio["exact"], gamma**1.5, rtol=2e-3)  # nearly: the speed changes with the depth too


@pytest.mark.parametrize("name", ["pointwise", "guess"])
def test_a_correction_without_a_matrix_is_refused(name: str) -> None:
    with pytest.raises(ComputeError, match=f"{name}.* has no effect matrix of its own; use exact"):
        corrected_spot(name, DEPTH, np.ones(1))


def test_the_compliance_along_the_shipped_part_varies_as_documented() -> None:
    angle = np.linspace(0, 2 * np.pi, 60)
    rim = 50 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    compliance, jumps = path_compliance(inward_program(rim, rim), PAPER, ROBOT, PLACEMENT)
    gamma = 1 - compliance * 12 / np.cos(DIP) / DEPTH
    assert (gamma.min(), gamma.max()) == pytest.approx((0.8658, 0.8778), abs=3e-4)
    assert jumps == 0


def test_the_wrist_stays_on_one_branch_and_off_its_singularity_over_the_shipped_part() -> None:
    moves = raster(10.0, 55.0)
    base = moves.end_mm * [1, -1, -1] + np.array(PLACEMENT.origin_mm)
    pose = inverse_kinematics(ROBOT, base, moves.axis * [1, -1, -1])
    assert np.degrees(pose.a_rad).min() > 4.5
    assert np.degrees(np.ptp(pose.c_rad)) < 60


def test_a_block_is_as_soft_as_the_robot_is_at_its_middle() -> None:
    resting = inward_program([[1.0, 2.0]], [[1.0, 2.0]])
    half = np.array([5.0, 0.0, 0.0])
    moving = dataclasses.replace(resting, start_mm=resting.start_mm - half, end_mm=resting.end_mm + half)
    (moving, _), (resting, _) = (path_compliance(p, PAPER, ROBOT, PLACEMENT) for p in (moving, resting))
    assert moving[0] == pytest.approx(resting[0], rel=1e-12)


def test_an_axis_that_is_not_dipped_as_the_process_says_is_refused() -> None:
    steep = dataclasses.replace(PAPER, dip_deg=20.0)
    with pytest.raises(ComputeError, match=r"point 0: .*the dip is 15 deg, the process says 20"):
        path_compliance(program([[0.0, 0.0]], [[0.0, 0.0]]), steep, ROBOT, PLACEMENT)


def test_points_out_of_reach_or_not_finite_are_refused_by_number() -> None:
    far = Placement((900.0, 0.0, 2335.0), PLACEMENT.rotation)
    with pytest.raises(ComputeError, match=r"point 0: the longest limb is .* mm, out of stroke"):
        path_compliance(program([[0.0, 0.0]], [[0.0, 0.0]], np.pi), PAPER, ROBOT, far)
    with pytest.raises(ComputeError, match="point 1: start of block is nan mm"):
        path_compliance(program([[0.0, 0.0], [np.nan, 0.0]], [[0.0, 0.0]] * 2), PAPER, ROBOT, PLACEMENT)


def test_columns_of_different_lengths_are_refused() -> None:
    moves = dataclasses.replace(program([[0.0, 0.0]], [[0.0, 0.0]]), start_mm=np.zeros((2, 3)))
    with pytest.raises(ComputeError, match="2 starts, 1 ends and 1 axes"):
        path_compliance(moves, PAPER, ROBOT, PLACEMENT)


@pytest.mark.parametrize(("depth", "factor"), [(np.nan, 1.0), (0.0, 1.0), (DEPTH, np.nan), (DEPTH, -1.0)])
def test_an_impossible_depth_or_factor_is_refused(depth: float, factor: float) -> None:
    with pytest.raises(ComputeError, match=r"point 0: the (depth|factor on the removal) is"):
        effect(Grid(3, 3, 1.0), program([[0.0, 0.0]], [[0.0, 0.0]]), depth, factor)
