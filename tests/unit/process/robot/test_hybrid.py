"""Robot compliance against beam finite elements with a released U joint, and against statics and strain energy.

The fit of the default robot can be run again, and comes to the same robot.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import fit_robot
from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, ToolProcess
from polishd.process.robot.compliance import depth_ratio, equivalent_compliance, tip_compliance_mm_per_n
from tests.unit.process.robot.hybrid_matrices import Pose, platform_stiffness, pose_of, tip_compliance
from tests.unit.process.robot.hybrid_poses import CROOKED, DIP, ROBOT, SLANTED, cylinder, workspace

UP = np.array([0.0, 0.0, -1.0])
EXACT = (ROBOT, SLANTED, dataclasses.replace(CROOKED, limb_ea_n=2.7e7))


def poses(n: int = 5, robot: HybridRobot = ROBOT) -> Pose:
    return pose_of(robot, *workspace(n, robot))


def limb_stiffness(robot: HybridRobot, pose: Pose, k: int) -> np.ndarray:
    """(3,) N/mm at pose k."""
    if robot.limb_ea_n is None:
        return np.full(3, robot.limb_stiffness_n_per_mm)
    return robot.limb_ea_n / np.linalg.norm(pose.limbs_mm[k], axis=1)


def beam_elements(length: float, bending: float, torsion: float, free_turns: np.ndarray, count: int = 3) -> np.ndarray:
    """(6, 6) stiffness at the tip of a beam along its third axis, of Euler-Bernoulli elements that slide axially.

    The root is held, but may turn about the columns of ``free_turns`` (3, 2). Order: u, v, w, turns about u, v, w.
    """
    h = length / count
    near, far = [12, 6 * h, -12, 6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]
    plane = bending / h**3 * np.array([near, [6 * h, 4 * h**2, -6 * h, 2 * h**2], [-e for e in near], far])
    whole = np.zeros((6 * (count + 1), 6 * (count + 1)))
    for k in range(count):
        a, b = 6 * k, 6 * (k + 1)
        along_u = np.array([a + 0, a + 4, b + 0, b + 4])  # u' = turn about v
        along_v = np.array([a + 1, a + 3, b + 1, b + 3])  # v' = minus the turn about u
        flip = np.diag([1.0, -1.0, 1.0, -1.0])
        whole[np.ix_(along_u, along_u)] += plane
        whole[np.ix_(along_v, along_v)] += flip @ plane @ flip
        twist = [a + 5, b + 5]
        whole[np.ix_(twist, twist)] += torsion / h * np.array([[1.0, -1.0], [-1.0, 1.0]])
    moves = [np.concatenate([np.zeros(3), turn, np.zeros(6 * count)]) for turn in free_turns.T]
    inner = [6 * k + j for k in range(1, count) for j in (0, 1, 3, 4, 5)]
    unit = np.eye(6 * (count + 1))
    hidden = np.column_stack([*moves, *unit[:, inner].T])
    tip = unit[:, -6:]
    corner = hidden.T @ whole @ tip
    return tip.T @ whole @ tip - corner.T @ np.linalg.solve(hidden.T @ whole @ hidden, corner)


def limb_springs(robot: HybridRobot, pose: Pose, k: int) -> np.ndarray:
    """(6, 6) stiffness of the three limbs at pose k, from the exact slope of their lengths (complex step)."""
    slope = np.empty((3, 6))
    for j, move in enumerate(np.eye(6)):
        step = 1e-30j * (move[:3] + np.cross(move[3:], pose.joints_mm[k]))
        slope[:, j] = np.sqrt(((pose.limbs_mm[k] + step) ** 2).sum(axis=1)).imag / 1e-30
    return slope.T @ np.diag(limb_stiffness(robot, pose, k)) @ slope


@pytest.mark.parametrize("robot", EXACT)
def test_the_platform_is_as_stiff_as_beam_elements_and_springs(robot: HybridRobot) -> None:
    pose = poses(robot=robot)
    got = platform_stiffness(robot, pose)
    assert len(got) > 30
    for k, frame in enumerate(pose.frame):
        released = np.linalg.solve(frame, np.column_stack([pose.outer, frame[:, 1]]))
        length = float(np.linalg.norm(pose.platform_mm[k]))
        beam = beam_elements(length, robot.up_bending_n_mm2, robot.up_torsion_n_mm2, released)
        turn = np.kron(np.eye(2), frame)
        want = turn @ beam @ turn.T + limb_springs(robot, pose, k)
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        assert (np.abs(got[k] - want) / scale).max() < 1e-9


def stored_energy(robot: HybridRobot, pose: Pose, k: int, force: np.ndarray) -> float:
    """Twice the strain energy under a force at the tip: reactions by statics, moments integrated along the limb."""
    frame = pose.frame[k]
    u, v, w = frame.T
    n = np.cross(pose.outer, v)
    direction = pose.limbs_mm[k] / np.linalg.norm(pose.limbs_mm[k], axis=1)[:, None]
    base = pose.platform_mm[k] + pose.joints_mm[k] - pose.limbs_mm[k]
    # columns: three limbs' pushes, the U joint's shear along u and v, its moment about n; all act on the moving part
    pushes = np.vstack([direction.T, np.cross(base, direction).T])
    balance = np.column_stack([pushes, [*u, 0, 0, 0], [*v, 0, 0, 0], [0, 0, 0, *n]])
    reaction = np.linalg.solve(balance, -np.concatenate([force, np.cross(pose.tip_mm[k], force)]))
    energy = (reaction[:3] ** 2 / limb_stiffness(robot, pose, k)).sum()
    length = float(np.linalg.norm(pose.platform_mm[k]))
    node, weight = np.polynomial.legendre.leggauss(4)
    for z, share in zip((node + 1) * length / 2, weight * length / 2, strict=True):
        moment = reaction[5] * n + np.cross(-z * w, reaction[3] * u + reaction[4] * v)
        twist = moment @ w
        energy += share * ((moment @ moment - twist**2) / robot.up_bending_n_mm2 + twist**2 / robot.up_torsion_n_mm2)
    torque = np.cross(pose.tip_mm[k] - pose.wrist_mm[k], force)
    hinge = np.cross(w, pose.axis[k])
    energy += (torque @ w) ** 2 / robot.c_stiffness_n_mm_per_rad
    return energy + (torque @ hinge) ** 2 / (hinge @ hinge) / robot.a_stiffness_n_mm_per_rad


@pytest.mark.full
@pytest.mark.parametrize("robot", EXACT)
def test_the_tip_gives_way_as_the_strain_energy_says(robot: HybridRobot) -> None:
    pose = poses(robot=robot)
    compliance = tip_compliance_mm_per_n(robot, pose.tip_mm, pose.axis)
    for k, matrix in enumerate(compliance):
        for force in np.random.default_rng(k).normal(size=(4, 3)):
            assert force @ matrix @ force == pytest.approx(stored_energy(robot, pose, k, force), rel=1e-9)


def moved_energy(robot: HybridRobot, pose: Pose, k: int, move: np.ndarray) -> tuple[float, np.ndarray]:
    """Strain energy and the tip's place when the platform moves by (6,), then C and A turn: lengths by geometry."""
    frame, centre = pose.frame[k], pose.platform_mm[k]
    turn = Rotation.from_rotvec(move[3:6])
    growth = np.linalg.norm(pose.limbs_mm[k] + move[:3] + turn.apply(pose.joints_mm[k]) - pose.joints_mm[k], axis=1)
    growth -= np.linalg.norm(pose.limbs_mm[k], axis=1)
    released = np.linalg.solve(frame, np.column_stack([pose.outer, frame[:, 1]]))
    length = float(np.linalg.norm(centre))
    beam = beam_elements(length, robot.up_bending_n_mm2, robot.up_torsion_n_mm2, released)
    bent = np.concatenate([frame.T @ move[:3], frame.T @ move[3:6]])
    stiffness = np.array([robot.c_stiffness_n_mm_per_rad, robot.a_stiffness_n_mm_per_rad])
    energy = (limb_stiffness(robot, pose, k) @ growth**2 + bent @ beam @ bent + stiffness @ move[6:] ** 2) / 2
    hinge = np.cross(frame[:, 2], pose.axis[k])
    wrist = Rotation.from_rotvec(move[6] * frame[:, 2]) * Rotation.from_rotvec(move[7] * hinge / np.linalg.norm(hinge))
    tip = pose.wrist_mm[k] - centre + wrist.apply(pose.tip_mm[k] - pose.wrist_mm[k])
    return energy, centre + move[:3] + turn.apply(tip)


@pytest.mark.full
@pytest.mark.parametrize("robot", EXACT)
def test_it_is_the_curvature_of_the_whole_structures_energy(robot: HybridRobot) -> None:
    """By finite differences over eight freedoms, and of where the tip goes; nothing is linearised by hand."""
    pose = poses(3, robot)
    steps = np.diag([1e-2] * 3 + [1e-5] * 5)
    assert len(pose.tip_mm) >= 10
    for k, matrix in enumerate(tip_compliance_mm_per_n(robot, pose.tip_mm, pose.axis)):
        curvature, slope = np.empty((8, 8)), np.empty((3, 8))
        for i, a in enumerate(steps):
            slope[:, i] = (moved_energy(robot, pose, k, a)[1] - moved_energy(robot, pose, k, -a)[1]) / 2
            for j, b in enumerate(steps):
                corners = [(s * t, moved_energy(robot, pose, k, s * a + t * b)[0]) for s in (1, -1) for t in (1, -1)]
                curvature[i, j] = sum(sign * energy for sign, energy in corners) / 4
        want = slope @ np.linalg.solve(curvature, slope.T)
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        assert (np.abs(matrix - want) / scale).max() < 1e-6


@pytest.mark.parametrize("robot", EXACT)
def test_it_is_symmetric_and_positive_definite_over_the_workspace(robot: HybridRobot) -> None:
    tip, axis = workspace(9, robot)
    whole = tip_compliance(robot, pose_of(robot, tip, axis))
    scale = np.sqrt(np.einsum("nii,njj->nij", whole, whole))
    assert (np.abs(whole - whole.transpose(0, 2, 1)) / scale).max() < 1e-12
    assert np.linalg.eigvalsh(whole / scale).min() > 0
    matrix = tip_compliance_mm_per_n(robot, tip, axis)
    np.testing.assert_array_equal(matrix, matrix.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(matrix).min() > 1e-5


def test_a_mirrored_pose_has_the_mirrored_compliance() -> None:
    mirror = np.array([-1.0, 1.0, 1.0])
    tip, axis = workspace(7)
    there = tip_compliance_mm_per_n(ROBOT, tip, axis)
    here = tip_compliance_mm_per_n(ROBOT, tip * mirror, axis * mirror)
    np.testing.assert_allclose(here, mirror[:, None] * there * mirror, rtol=0, atol=1e-14)


def test_renaming_the_limbs_changes_nothing() -> None:
    tip, axis = workspace(7)
    renamed = dataclasses.replace(ROBOT, first_limb_deg=ROBOT.first_limb_deg + 120)
    want = tip_compliance_mm_per_n(ROBOT, tip, axis)
    np.testing.assert_allclose(tip_compliance_mm_per_n(renamed, tip, axis), want, rtol=0, atol=1e-14)


def test_a_turned_robot_gives_way_alike() -> None:
    turn = Rotation.from_euler("Z", -52.0, degrees=True)
    assert CROOKED.base_joints_mm
    assert CROOKED.platform_joints_mm
    turned = dataclasses.replace(
        CROOKED,
        base_joints_mm=tuple(map(tuple, turn.apply(CROOKED.base_joints_mm))),
        platform_joints_mm=tuple(map(tuple, turn.apply(CROOKED.platform_joints_mm))),
        outer_axis=tuple(turn.apply(CROOKED.outer_axis)),
    )
    tip, axis = workspace(7, CROOKED)
    rotation = turn.as_matrix()
    want = rotation @ tip_compliance_mm_per_n(CROOKED, tip, axis) @ rotation.T
    got = tip_compliance_mm_per_n(turned, turn.apply(tip), turn.apply(axis))
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-14)


@pytest.mark.parametrize("robot", EXACT)
def test_the_whole_compliance_moves_with_its_point_of_reference(robot: HybridRobot) -> None:
    """A longer tool on the same wrist: carrying the 6 x 6 by hand to the new tip must give what the robot gives."""
    roomy = dataclasses.replace(robot, workspace_height_mm=(0.0, 1000.0))
    pose = poses(robot=robot)
    step = -50.0 * pose.axis
    longer = dataclasses.replace(roomy, tool_length_mm=roomy.tool_length_mm + 50.0, workspace_radius_mm=700.0)
    got = tip_compliance(longer, pose_of(longer, pose.tip_mm + step, pose.axis))
    tips = tip_compliance_mm_per_n(longer, pose.tip_mm + step, pose.axis)
    for k, matrix in enumerate(tip_compliance(robot, pose)):
        carry = np.eye(6)
        carry[:3, 3:] = -np.cross(step[k], np.eye(3)).T
        want = carry @ matrix @ carry.T
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        assert (np.abs(got[k] - want) / scale).max() < 1e-10
        assert (np.abs(tips[k] - want[:3, :3]) / scale[:3, :3]).max() < 1e-10


def test_twice_as_stiff_members_give_way_half_as_much() -> None:
    tip, axis = workspace(5)
    names = [f.name for f in dataclasses.fields(ROBOT) if "stiffness" in f.name or f.name.startswith("up_")]
    assert len(names) == 5
    twice = dataclasses.replace(ROBOT, **{name: 2 * getattr(ROBOT, name) for name in names})
    want = tip_compliance_mm_per_n(ROBOT, tip, axis) / 2
    np.testing.assert_allclose(tip_compliance_mm_per_n(twice, tip, axis), want, rtol=1e-9, atol=1e-15)


def test_the_figures_published_for_the_workspace() -> None:
    tip, axis = workspace(25)
    out = len(cylinder(25)[0]) - len(tip)
    assert out == pytest.approx(0.05 * len(cylinder(25)[0]), rel=0.3)  # of the stroke, and so not in the range
    angle = np.linspace(0, 2 * np.pi, 16)  # where the spindle leans matters on the base's own axis too
    lean = np.column_stack([np.sin(DIP) * np.cos(angle), np.sin(DIP) * np.sin(angle), np.full(16, -np.cos(DIP))])
    tip, axis = np.vstack([tip, np.tile([0.0, 0.0, 2335.0], (16, 1))]), np.vstack([axis, lean])
    matrix = tip_compliance_mm_per_n(ROBOT, tip, axis) * 1e3
    compliance = equivalent_compliance(matrix, axis, np.tile(UP, (len(tip), 1)))
    assert compliance.min() == pytest.approx(1.039, abs=0.003)
    assert compliance.max() == pytest.approx(1.972, abs=0.005)
    worst = np.linalg.eigvalsh(matrix)[:, 2]
    assert worst.min() == pytest.approx(5.4, abs=0.05)
    assert worst.max() == pytest.approx(7.3, abs=0.05)
    gamma = depth_ratio(compliance / 1e3, ToolProcess(), 0.14834891)
    assert 0.83 < gamma.min() < 0.84
    assert 0.91 < gamma.max() < 0.92


def test_a_tenth_off_the_torsion_of_a_shows_in_the_compliance() -> None:
    tip, axis = workspace(9)
    soft = dataclasses.replace(ROBOT, a_stiffness_n_mm_per_rad=0.9 * ROBOT.a_stiffness_n_mm_per_rad)
    normal = np.tile(UP, (len(tip), 1))
    before, after = (equivalent_compliance(tip_compliance_mm_per_n(r, tip, axis), axis, normal) for r in (ROBOT, soft))
    change = np.abs(after / before - 1)
    assert 0.05 < np.median(change) < 0.11
    assert change.max() < 0.13


def test_limbs_of_one_cross_section_are_stiffer_where_they_are_short() -> None:
    tip, axis = np.array([[0.0, 300.0, 2000.0]]), np.array([[0.0, -np.sin(DIP), -np.cos(DIP)]])
    lengths = pose_of(ROBOT, tip, axis).limb_mm[0]
    soft, stiff = (
        dataclasses.replace(ROBOT, limb_stiffness_n_per_mm=2.7e7 / length) for length in (max(lengths), min(lengths))
    )
    rod = dataclasses.replace(ROBOT, limb_ea_n=2.7e7, limb_stiffness_n_per_mm=1.0)
    low, got, high = (np.trace(tip_compliance_mm_per_n(r, tip, axis)[0]) for r in (stiff, rod, soft))
    assert low < got < high


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("limb_stiffness_n_per_mm", "N/mm"),
        ("limb_ea_n", "N"),
        ("up_bending_n_mm2", r"N mm\^2"),
        ("up_torsion_n_mm2", r"N mm\^2"),
        ("a_stiffness_n_mm_per_rad", "N mm/rad"),
        ("c_stiffness_n_mm_per_rad", "N mm/rad"),
    ],
)
def test_a_member_without_stiffness_is_refused_by_name(name: str, unit: str) -> None:
    tip, axis = workspace(5)
    pose = pose_of(ROBOT, tip, axis)
    for value in (0.0, np.nan, -1.0, np.inf):
        robot = dataclasses.replace(ROBOT, **{name: value})
        for compute in (
            lambda r=robot: tip_compliance_mm_per_n(r, tip, axis),
            lambda r=robot: tip_compliance(r, pose),
        ):
            with pytest.raises(ComputeError, match=f"{name} is .* {unit}, it must be above 0"):
                compute()


SHIPPED = HybridRobot()


@pytest.fixture(scope="module")
def sample() -> fit_robot.Sample:
    return fit_robot.workspace(9)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.6])
def test_a_perturbed_start_ends_in_the_published_range(factor: float, sample: fit_robot.Sample) -> None:
    changed = {name: factor * getattr(SHIPPED, name) for name in fit_robot.GUESS}
    start = dataclasses.replace(SHIPPED, **changed)
    before, after = (fit_robot.range_um_per_n(r, sample) for r in (start, fit_robot.fit(start, sample)))
    assert np.abs(before - fit_robot.PUBLISHED_UM_PER_N).max() > 0.2
    np.testing.assert_allclose(after, fit_robot.PUBLISHED_UM_PER_N, rtol=0, atol=2 * fit_robot.ROUNDING_UM_PER_N)
    shipped = fit_robot.range_um_per_n(SHIPPED, sample)
    np.testing.assert_allclose(after, shipped, rtol=0, atol=0.02)  # the sample is coarser than that of the fit


@pytest.mark.full
def test_the_guess_ends_at_the_shipped_robot(capsys: pytest.CaptureFixture[str]) -> None:
    fitted = fit_robot.fit(dataclasses.replace(SHIPPED, **fit_robot.GUESS), fit_robot.workspace(25))
    for name in fit_robot.GUESS:
        assert getattr(fitted, name) == pytest.approx(getattr(SHIPPED, name), rel=0.01), name
    assert fit_robot.main() == 0
    said = capsys.readouterr().out
    assert "limbs 953-1750 mm (published stroke 950-1750)" in said
    assert "points of the workspace are out of stroke" in said


def test_the_sample_leans_all_ways_on_the_axis_of_the_base(sample: fit_robot.Sample) -> None:
    upright = np.hypot(sample.tip_mm[:, 0], sample.tip_mm[:, 1]) < 1e-9
    assert len(np.unique(np.round(sample.axis[upright], 9), axis=0)) == 16
    np.testing.assert_allclose(sample.axis[:, 2], -np.cos(np.radians(15.0)))
    assert 0.01 < sample.out_of_stroke / (len(upright) + sample.out_of_stroke) < 0.1
