"""The true force behind the actuator's: a first-order law, step by step exact.

The plant's removal law against the closed-form figures of physics.md, section 2.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Effects, Plant, Truth
from polishd.model.process import HybridRobot, ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.robot.compliance import tip_compliance_mm_per_n
from polishd.sim_backends.batch import BatchPlant
from polishd.sim_backends.common.hidden_truth import Frames, rotation_rpy, tool_axis
from polishd.sim_backends.plant.tool import ForceDynamics, given_way, hertz_depth_mm, wear, worn_depth_mm

STIFF = 120.0
"""N/mm."""


def truly(
    lag: ForceDynamics, seconds: FloatArray, gap_mm: FloatArray, begin_s: float = 0.0, coil_n: float = 12.0
) -> FloatArray:
    until = begin_s + np.cumsum(seconds)
    full = np.full(len(seconds), coil_n)
    return lag.truly(full, begin_s=until - seconds, lasts_s=seconds, gap_mm=gap_mm, stiff=full * 0.0 + STIFF)


def test_a_landing_lacks_the_force_times_the_lag_however_it_is_cut() -> None:
    for cut in (1, 7, 400):
        seconds = np.full(cut, 1.0 / cut)
        lacks = ((12.0 - truly(ForceDynamics(0.05), seconds, np.zeros(cut))) * seconds).sum()
        assert lacks == pytest.approx(12.0 * 0.05 * (1.0 - math.exp(-20.0)), rel=1e-9)


def test_it_goes_on_from_call_to_call_and_lands_anew_after_a_lift() -> None:
    lag, one, level = ForceDynamics(0.5), np.array([1.0]), np.zeros(1)
    first, second = truly(lag, one, level)[0], truly(lag, one, level, begin_s=1.0)[0]
    assert second > first
    assert truly(lag, one, level, begin_s=3.0)[0] == first
    lag.lift()
    assert truly(lag, one, level, begin_s=4.0)[0] == first


@pytest.mark.parametrize(("speed_mm_s", "extra_n"), [(0.4, 0.96), (-0.4, -0.96), (-50.0, -12.0)])
def test_a_part_that_comes_pushes_and_one_that_goes_is_lost_at_worst(speed_mm_s: float, extra_n: float) -> None:
    seconds = np.full(200, 0.01)
    gap = -speed_mm_s * np.cumsum(seconds)
    force = truly(ForceDynamics(0.02), seconds, gap)
    assert (force >= 0.0).all()
    assert force[-1] - 12.0 == pytest.approx(extra_n, rel=1e-6)


def test_no_lag_is_nothing_to_the_last_bit_and_a_short_one_follows() -> None:
    seconds = np.array([0.1, 0.05, 0.2])
    np.testing.assert_allclose(truly(ForceDynamics(1e-9), seconds, np.zeros(3)), 12.0, rtol=1e-6)


def test_a_guide_that_sticks_holds_until_the_friction_is_made_up_and_slides_from_there() -> None:
    """Half a newton is 4 um of the contact; down, up and down again: a hysteresis."""
    way_mm = np.concatenate([np.linspace(0.0, 0.02, 11), np.linspace(0.02, 0.0, 11), np.linspace(0.0, 0.02, 11)])
    force = truly(ForceDynamics(0.0, 0.5), np.full(33, 0.1), way_mm)
    assert force[0] == 11.5, "it has come out"
    np.testing.assert_allclose(force[:11], 11.5)
    assert force[12] == pytest.approx(11.5 + 0.002 * STIFF), "it sticks"
    np.testing.assert_allclose(force[16:22], 12.5)
    np.testing.assert_allclose(force[-6:], 11.5)


def track(**effects: object) -> tuple[BatchPlant, FloatArray, FloatArray]:
    """Ten seconds along a part that is tilted by 1 degree in its seat: plant, removal, and the force as measured."""
    config = SimConfig(
        plant=Plant(aperture_mm=40.0, rms_nm=0.0, seat_tilt_deg=(0.0, 1.0)),
        hidden_truth=Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.0),
        effects=Effects.model_validate({"eq_44": [0, 0], "friction": [0, 0]} | effects),
    )
    return polished(BatchPlant(config, 3))


def polished(made: BatchPlant) -> tuple[BatchPlant, FloatArray, FloatArray]:
    before = made.world.part.height_nm.copy()
    x = np.linspace(-10.0, 10.0, 41)
    ends = np.column_stack([x, 0.0 * x, 0.0 * x])
    one = np.ones(40)
    lean = np.tile([0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))], (40, 1))
    reported = made.polish(
        {
            "begin_mm": ends[:-1],
            "end_mm": ends[1:],
            "axis": lean,
            "seconds": 0.25 * one,
            "force_n": 12.0 * one,
            "rpm": 1000.0 * one,
        }
    )
    return made, before - made.world.part.height_nm, reported["force_n"]


def test_up_a_tilted_part_the_true_force_is_another_than_the_measured_one() -> None:
    made, lagging, measured = track(force_lag_s=0.01)
    _, follows, same = track()
    assert np.array_equal(measured, same), "the coil reports its force"
    column = made.world.part.grid.x_mm
    middle = np.abs(column) < 5.0
    ratio = lagging[:, middle].sum() / follows[:, middle].sum()
    speed_mm_s = 2.0 * math.tan(math.radians(1.0))
    pushed = 1.5 * 12.0 / 0.14835 * 0.01 * speed_mm_s / math.cos(math.radians(15.0))
    assert abs(ratio - 1.0) == pytest.approx(pushed / 12.0, rel=0.05), "removal goes with the force"


def test_a_guide_with_friction_presses_otherwise_along_a_tilted_part_without_a_report() -> None:
    _, sticks, measured = track(guide_friction_n=0.6)
    _, slides, same = track()
    assert np.array_equal(measured, same)
    assert abs(sticks.sum() / slides.sum() - 1.0) == pytest.approx(0.05, rel=0.05)


def test_robots_that_are_off_along_the_normal_push_only_where_the_force_lags() -> None:
    _, follows, _ = track(robot_error_mm=0.3)
    _, lagging, _ = track(robot_error_mm=0.3, force_lag_s=0.05)
    assert not np.allclose(lagging, follows, rtol=1e-4)


def test_the_next_pass_lands_anew() -> None:
    made, first, _ = track(force_lag_s=0.01)
    np.testing.assert_allclose(polished(made)[1], first, atol=1e-9)


TOOL = ToolProcess()
DIP = math.radians(15.0)
AXIS = np.array([[0.0, -math.sin(DIP), math.cos(DIP)]])
DEPTH = hertz_depth_mm(TOOL, np.array([12.0]))


def worn(
    pitch: float = 0.5,
    centre: tuple[float, float] = (0.0, 0.0),
    axis: FloatArray = AXIS,
    depth: FloatArray = DEPTH,
    rpm: float = 1000.0,
    seconds: float = 1.0,
    stretch: FloatArray | None = None,
) -> tuple[FloatArray, Grid]:
    """Removal (positive, nm) of one contact on a grid of 20 mm."""
    count = int(20 / pitch) + 1
    grid = Grid(count, count, pitch)
    surface = np.zeros(grid.shape)
    one = np.ones(1)
    wear(
        surface,
        grid,
        TOOL,
        centre_mm=np.array([centre]),
        axis=axis,
        depth_mm=depth,
        rpm=one * rpm,
        seconds=one * seconds,
        stretch=stretch,
    )
    return -surface, grid


def volume_mm3(removal: FloatArray, grid: Grid) -> float:
    return removal.sum() * grid.pitch_mm**2 * 1e-6


def test_hertz_depth_is_the_published_one() -> None:
    assert DEPTH[0] == pytest.approx(0.14835, abs=2e-5)
    assert math.sqrt(TOOL.tool_radius_mm * DEPTH[0]) == pytest.approx(1.7225, abs=2e-4)


@pytest.mark.parametrize("pitch", [0.118, 0.25, 0.5])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.1, 0.2), (0.25, -0.25)])
def test_volume_rate(pitch: float, centre: tuple[float, float]) -> None:
    assert volume_mm3(*worn(pitch, centre)) == pytest.approx(9.72e-4, rel=5e-3)


def test_peak_rate() -> None:
    removal, _ = worn(0.05)
    assert removal.max() == pytest.approx(162.0, rel=5e-3)


def test_a_stop_of_63_ms_removes_about_61_nm_mm2() -> None:
    removal, grid = worn(seconds=0.063)
    assert removal.sum() * grid.pitch_mm**2 == pytest.approx(61.2, rel=0.01)


SHEARED = np.array([[1.08, 0.11], [-0.04, 1.02]])
"""Along a steep, twisted surface."""


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("stretch", [np.eye(2), SHEARED], ids=["flat", "sheared"])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.13, -0.21)])
def test_a_cell_is_its_mean(centre: tuple[float, float], stretch: FloatArray) -> None:
    """Against a sum over 61 x 61 points of each cell, of Hertz's pressure times the speed of a tilted sphere."""
    removal, grid = worn(0.5, centre, stretch=stretch[None])
    fine = (np.arange(61) + 0.5) / 61 - 0.5
    x = (grid.x_mm[:, None] + fine * grid.pitch_mm).ravel() - centre[0]
    y = (grid.y_mm[:, None] - fine * grid.pitch_mm).ravel() - centre[1]
    along = np.einsum("ij,jyx->iyx", stretch, np.stack(np.meshgrid(x, y)))
    pressure = np.sqrt(np.maximum(1.0 - (along**2).sum(axis=0) / (TOOL.tool_radius_mm * DEPTH[0]), 0.0))
    lever = np.stack([along[0], along[1], np.full(along[0].shape, DEPTH[0] - TOOL.tool_radius_mm)], axis=-1)
    speed = np.linalg.norm(np.cross(AXIS[0], lever)[..., :2], axis=-1)
    mean = (pressure * speed).reshape(grid.ny, 61, grid.nx, 61).mean(axis=(1, 3))
    expected = mean * (removal.sum() / mean.sum())  # another test checks the volume
    assert np.abs(removal - expected).max() < 4e-3 * removal.max()


def test_removal_is_linear_in_time_and_speed() -> None:
    base, _ = worn()
    assert np.allclose(worn(seconds=3.0)[0], 3.0 * base)
    assert np.allclose(worn(rpm=500.0)[0], 0.5 * base)


def test_nothing_is_removed_without_depth_speed_or_time() -> None:
    for change in ({"depth": np.zeros(1)}, {"rpm": 0.0}, {"seconds": 0.0}):
        assert not worn(**change)[0].any()


def test_volume_goes_as_the_depth_to_the_power_of_three_halves() -> None:
    full = volume_mm3(*worn(0.1))
    less = volume_mm3(*worn(0.1, depth=0.87 * DEPTH))
    assert less / full == pytest.approx(0.811, abs=0.004)


def test_the_spot_shrinks_with_the_root_of_the_depth() -> None:
    wide = np.count_nonzero(worn(0.05)[0])
    narrow = np.count_nonzero(worn(0.05, depth=0.64 * DEPTH)[0])
    assert narrow / wide == pytest.approx(0.64, rel=0.03)


def test_the_spot_turns_with_the_axis() -> None:
    """More speed on the side that the axis leans away from: the spot's centre of mass follows the azimuth."""
    for azimuth in (0.0, 90.0, 180.0, 270.0):
        axis = tool_axis(np.array([15.0]), np.array([azimuth]))
        removal, grid = worn(0.1, axis=axis)
        x = (removal * grid.x_mm[None, :]).sum() / removal.sum()
        y = (removal * grid.y_mm[:, None]).sum() / removal.sum()
        lean = axis[0, :2] / math.sin(DIP)
        assert abs(x * lean[0] + y * lean[1]) > 20 * abs(x * lean[1] - y * lean[0]) - 1e-3


def test_axis_of_a_and_c() -> None:
    axis = tool_axis(np.array([15.0, 15.0, 0.0]), np.array([0.0, 90.0, 33.0]))
    expected = [[0.0, -math.sin(DIP), math.cos(DIP)], [math.sin(DIP), 0.0, math.cos(DIP)], [0.0, 0.0, 1.0]]
    assert np.allclose(axis, expected, atol=1e-12)


def test_rotation_is_intrinsic_x_then_y_then_z() -> None:
    rotation = rotation_rpy((30.0, 40.0, 50.0))
    from scipy.spatial.transform import Rotation

    assert np.allclose(rotation, Rotation.from_euler("XYZ", [30.0, 40.0, 50.0], degrees=True).as_matrix())


def test_frames_turn_and_shift_the_program() -> None:
    frames = Frames(Plant(program_rotation_deg=90.0, program_offset_mm=(1.0, 2.0, 3.0)))
    tips, axes = frames.in_part(np.array([[10.0, 0.0, 0.0, 15.0, 0.0]]))
    assert np.allclose(tips, [[1.0, 12.0, 3.0]])
    assert np.allclose(axes, [[math.sin(DIP), 0.0, math.cos(DIP)]])
    base, up = frames.in_base(tips, axes)
    assert np.allclose(base, [[231.0, 148.0, 2082.0]])
    assert up[0, 2] == pytest.approx(-math.cos(DIP))


def on_the_part(n: int = 7) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(1)
    pose = np.column_stack([rng.uniform(-50, 50, (n, 2)), np.zeros(n), np.full(n, 15.0), rng.uniform(0, 360, n)])
    frames = Frames(Plant())
    return (*frames.in_base(*frames.in_part(pose)), frames.to_base[:, 2])


def test_compliance_leaves_out_the_stiffest_direction_along_the_tool() -> None:
    tip, axis, normal = on_the_part()
    c = given_way(HybridRobot(), tip, axis, normal).along
    full = tip_compliance_mm_per_n(HybridRobot(), tip, axis)
    for k in range(len(tip)):
        values, vectors = np.linalg.eigh(full[k])
        near = int(np.argmax(np.abs(vectors.T @ axis[k])))
        expected = sum(values[j] * abs(vectors[:, j] @ normal) for j in range(3) if j != near)
        assert c[k] == pytest.approx(expected)
    assert (c > 0.5e-3).all()
    assert (c < 3e-3).all()


def test_compliance_ignores_the_eigenvectors_sign_and_is_zero_out_of_reach() -> None:
    tip, axis, normal = on_the_part(2)
    far = tip.copy()
    far[1] = [0.0, 0.0, 9000.0]
    c = given_way(HybridRobot(), far, axis, normal).along
    assert c[0] == pytest.approx(given_way(HybridRobot(), tip, axis, -normal).along[0])
    assert c[1] == 0.0


def test_gamma_is_in_the_papers_range_and_depth_never_negative() -> None:
    tip, axis, normal = on_the_part()
    c = given_way(HybridRobot(), tip, axis, normal).along
    in_part = np.tile([0.0, -math.sin(DIP), math.cos(DIP)], (len(c), 1))
    force = np.full(len(c), 12.0)
    gamma = worn_depth_mm(TOOL, force, in_part, c) / DEPTH
    assert ((gamma > 0.75) & (gamma < 0.95)).all()
    assert np.allclose(gamma, 1.0 - c * 12.0 / math.cos(DIP) / DEPTH)
    assert not worn_depth_mm(TOOL, force, in_part, np.full(len(c), 1.0)).any()


def test_contacts_worn_together_remove_what_each_removes_alone() -> None:
    """Of several sizes, so that the smaller ones lie in a window that is wider than they are."""
    depth = DEPTH * np.array([1.0, 0.3, 0.7, 1.6])
    centre = np.array([(0.0, 0.0), (0.13, -0.21), (4.9, 9.2), (-9.9, 0.4)])
    grid = Grid(41, 41, 0.5)
    surface, n = np.zeros(grid.shape), len(depth)
    seconds = np.arange(1.0, n + 1.0)
    common = {"axis": np.tile(AXIS, (n, 1)), "rpm": np.full(n, 1000.0), "seconds": seconds}
    wear(surface, grid, TOOL, centre_mm=centre, depth_mm=depth, **common)
    alone = sum(worn(0.5, tuple(centre[k]), depth=depth[k : k + 1], seconds=seconds[k])[0] for k in range(n))
    np.testing.assert_allclose(-surface, alone, rtol=1e-12, atol=1e-12)
