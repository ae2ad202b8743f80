"""The closed form for long programs against the paper's matrices, equation by equation, and its options."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot
from polishd.process.robot import hybrid
from polishd.process.robot.compliance import tip_compliance_mm_per_n
from tests.unit.process.robot.hybrid_matrices import Pose, platform_stiffness, pose_of, tip_compliance
from tests.unit.process.robot.hybrid_poses import CROOKED, PAPER, ROBOT, ROBOTS, random_poses, workspace


def difference(got: np.ndarray, want: np.ndarray) -> float:
    """Largest difference of (n, 3, 3) matrices relative to their norm."""
    return float((np.linalg.norm(got - want, axis=(1, 2)) / np.linalg.norm(want, axis=(1, 2))).max())


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_is_the_tips_block_of_the_whole_compliance(robot: HybridRobot) -> None:
    tip, axis = random_poses(3 * hybrid.CHUNK // 2, robot)
    whole = tip_compliance(robot, pose_of(robot, tip, axis))
    assert difference(tip_compliance_mm_per_n(robot, tip, axis), whole[:, :3, :3]) < 1e-12


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_papers_moment_is_equation_41_at_the_wrist_centre(robot: HybridRobot) -> None:
    tip, axis = random_poses(500, robot)
    pose = pose_of(robot, tip, axis)
    whole = tip_compliance(robot, pose)
    want = np.empty((len(tip), 3, 3))
    for k, arm in enumerate(tip - pose.wrist_mm):
        hat = np.cross(arm, np.eye(3)).T  # hat @ x = arm x x
        carry = np.eye(6)
        carry[:3, 3:] = hat  # from the tip to the wrist centre
        at_wrist = carry @ whole[k] @ carry.T
        want[k] = at_wrist[:3, :3] - hat @ at_wrist[:3, 3:].T
    got = tip_compliance_mm_per_n(robot, tip, axis, moment="paper")
    assert difference(got, want) < 1e-10
    assert np.abs(got - got.transpose(0, 2, 1)).max() > 1e-4


def test_the_papers_moment_leaves_the_wrist_out() -> None:
    tip, axis = random_poses(100)
    soft = dataclasses.replace(ROBOT, a_stiffness_n_mm_per_rad=1e6, c_stiffness_n_mm_per_rad=1e6)
    want = tip_compliance_mm_per_n(ROBOT, tip, axis, moment="paper")
    np.testing.assert_array_equal(tip_compliance_mm_per_n(soft, tip, axis, moment="paper"), want)


def test_a_few_points_of_the_papers_moment_have_complex_eigenvalues() -> None:
    tip, axis = random_poses(20_000)
    values = np.linalg.eigvals(tip_compliance_mm_per_n(ROBOT, tip, axis, moment="paper"))
    assert 0 < (np.abs(values.imag).max(axis=1) > 0).mean() < 0.02


def paper_stiffness(robot: HybridRobot, pose: Pose, k: int) -> np.ndarray:
    """(6, 6) eq. 8 and 12 with the misprints of S_c mended: ``(H^-1 J)' K_Q (H^-1 J)``."""
    u, v, w = pose.frame[k].T
    n = np.cross(pose.outer, v)
    length = float(np.linalg.norm(pose.platform_mm[k]))
    limbs = np.linalg.norm(pose.limbs_mm[k], axis=1)
    direction = pose.limbs_mm[k] / limbs[:, None]
    zero = np.zeros(3)
    jacobian = np.vstack(
        [
            *(np.concatenate([w_i, np.cross(a_i, w_i)]) for w_i, a_i in zip(direction, pose.joints_mm[k], strict=True)),
            np.concatenate([u, -length * v]),
            np.concatenate([v, length * u]),
            np.concatenate([zero, n]),
        ]
    )
    tie = np.array([[0.0, -1.5 / length], [1.5 / length, 0.0]])  # W: a cantilever under a force at its end
    section = np.array(
        [
            [1 - length * tie[1, 0], -length * tie[1, 1], 0],
            [length * tie[0, 0], 1 + length * tie[0, 1], 0],
            [n @ u * tie[0, 0] + n @ v * tie[1, 0], n @ u * tie[0, 1] + n @ v * tie[1, 1], n @ w],
        ]
    )
    spread = np.eye(6)
    spread[3:, 3:] = section
    bending = 3 * robot.up_bending_n_mm2 / length**3
    limb = np.full(3, robot.limb_stiffness_n_per_mm) if robot.limb_ea_n is None else robot.limb_ea_n / limbs
    springs = np.diag([*limb, bending, bending, robot.up_torsion_n_mm2 / length])
    moved = np.linalg.solve(spread, jacobian)
    return moved.T @ springs @ moved


@pytest.mark.parametrize("robot", [PAPER, dataclasses.replace(ROBOT, beam="paper")])
def test_the_papers_beam_is_equation_12_with_its_tie(robot: HybridRobot) -> None:
    pose = pose_of(robot, *workspace(5, robot))
    for k, got in enumerate(platform_stiffness(robot, pose)):
        want = paper_stiffness(robot, pose, k)
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        assert (np.abs(got - want) / scale).max() < 1e-10


def test_the_beam_matters_to_the_platform_and_hardly_to_the_tip() -> None:
    tip, axis = workspace(9)
    tied = dataclasses.replace(ROBOT, beam="paper")
    pose = pose_of(ROBOT, tip, axis)
    exact, paper = (np.linalg.inv(platform_stiffness(r, pose)) for r in (ROBOT, tied))
    change = np.abs(np.einsum("nii->ni", paper) / np.einsum("nii->ni", exact) - 1)
    assert change.max(axis=1).min() > 0.02
    assert change.max() < 0.07
    change = difference(tip_compliance_mm_per_n(tied, tip, axis), tip_compliance_mm_per_n(ROBOT, tip, axis))
    assert 1e-4 < change < 0.01


def test_chunks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    tip, axis = random_poses(100, CROOKED)
    want = tip_compliance_mm_per_n(CROOKED, tip, axis)
    monkeypatch.setattr(hybrid, "CHUNK", 7)
    # to the last bit on some processors only: BLAS takes another kernel for another number of rows
    chunked = tip_compliance_mm_per_n(CROOKED, tip, axis, path=False)
    np.testing.assert_allclose(chunked, want, rtol=4 * np.finfo(float).eps, atol=0)
    tip[[50, 93], 2] = 5000.0
    with pytest.raises(ComputeError, match=r"point 50: the tip's height is .* \(so at 2 of 100 points"):
        tip_compliance_mm_per_n(CROOKED, tip, axis)


def test_no_points_are_no_matrices() -> None:
    nothing = np.empty((0, 3))
    for moment in ("full", "paper"):
        assert tip_compliance_mm_per_n(ROBOT, nothing, nothing, moment=moment, path=True).shape == (0, 3, 3)
