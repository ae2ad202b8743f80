"""Compliance along a path: what frame, dip and robot make of it, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import ComplianceOptions, HybridRobot, MeasuredCompliance, Optic, Placement, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process import frames
from polishd.process.robot.compliance import (
    compliance_at,
    equivalent_compliance,
    path_compliance,
    tip_compliance_mm_per_n,
)
from tests.unit.process.moves import DIP, PLACEMENT, inward_program, program
from tests.unit.process.robot.hybrid_matrices import pose_of

PAPER = ToolProcess()
DEPTH = 0.14834891
ROBOT = HybridRobot()


def test_the_compliance_along_the_shipped_part_varies_as_documented() -> None:
    angle = np.linspace(0, 2 * np.pi, 60)
    rim = 50 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = path_compliance(inward_program(rim, rim), PAPER, ROBOT, PLACEMENT)
    gamma = 1 - found.compliance_mm_per_n * 12 / np.cos(DIP) / DEPTH
    assert (gamma.min(), gamma.max()) == pytest.approx((0.8658, 0.8778), abs=3e-4)
    assert (found.jumps, found.fallbacks, found.notes) == (0, 0, ())


def test_the_wrist_stays_on_one_branch_and_off_its_singularity_over_the_shipped_part() -> None:
    x, y = np.meshgrid(*2 * [np.arange(-55.0, 56.0, 10.0)])
    moves = inward_program(*2 * [np.column_stack([x.ravel(), y.ravel()])])
    base = moves.end_mm * [1, -1, -1] + np.array(PLACEMENT.origin_mm)
    u, v, w = pose_of(ROBOT, base, moves.axis * [1, -1, -1]).tool.T
    assert np.degrees(np.arctan2(np.hypot(u, v), -w)).min() > 4.5
    across = (u + 1j * v) / (u + 1j * v)[0]
    assert np.degrees(np.ptp(np.angle(across))) < 60


def test_a_block_is_as_soft_as_the_robot_is_at_its_middle() -> None:
    resting = inward_program([[1.0, 2.0]], [[1.0, 2.0]])
    half = np.array([5.0, 0.0, 0.0])
    moving = dataclasses.replace(resting, start_mm=resting.start_mm - half, end_mm=resting.end_mm + half)
    one, other = (path_compliance(p, PAPER, ROBOT, PLACEMENT) for p in (moving, resting))
    np.testing.assert_allclose(one.compliance_mm_per_n, other.compliance_mm_per_n, rtol=1e-12)


def test_an_axis_that_is_not_dipped_as_the_process_says_is_refused() -> None:
    steep = dataclasses.replace(PAPER, dip_deg=20.0)
    with pytest.raises(ComputeError, match=r"point 0: .*the dip is 15 deg, the process says 20"):
        path_compliance(program([[0.0, 0.0]], [[0.0, 0.0]]), steep, ROBOT, PLACEMENT)


def test_points_out_of_reach_or_not_finite_are_refused_by_number() -> None:
    far = Placement((900.0, 0.0, 2335.0), PLACEMENT.rotation)
    with pytest.raises(ComputeError, match=r"point 0: the tip's radius is 900 mm, out of the workspace"):
        path_compliance(program([[0.0, 0.0]], [[0.0, 0.0]], np.pi), PAPER, ROBOT, far)
    with pytest.raises(ComputeError, match="point 1: start of block is nan mm"):
        path_compliance(program([[0.0, 0.0], [np.nan, 0.0]], [[0.0, 0.0]] * 2), PAPER, ROBOT, PLACEMENT)


def test_columns_of_different_lengths_are_refused() -> None:
    moves = dataclasses.replace(program([[0.0, 0.0]], [[0.0, 0.0]]), start_mm=np.zeros((2, 3)))
    with pytest.raises(ComputeError, match="2 starts, 1 ends and 1 axes"):
        path_compliance(moves, PAPER, ROBOT, PLACEMENT)


def arc(n: int = 40, degrees: float = 300.0) -> tuple[FloatArray, FloatArray]:
    """Points on a circle of the part, and axes dipped radially inward to the base."""
    angle = np.radians(np.linspace(0, degrees, n))
    points = np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), np.zeros(n)])
    return points, dipped(points, ComplianceOptions())


def dipped(points: FloatArray, options: ComplianceOptions, optic: Optic = Optic()) -> FloatArray:  # noqa: B008
    tip = frames.points_to_base(PLACEMENT, points)
    normal = frames.surface_normals(PLACEMENT, points, optic)
    return np.asarray(frames.dipped_axes(options, PLACEMENT, tip, normal, 15.0) @ PLACEMENT.rotation)


def by_hand(points: FloatArray, axis: FloatArray, normal: FloatArray, projection: str = "linear") -> FloatArray:
    base = frames.directions_to_base(PLACEMENT, axis)
    matrix = tip_compliance_mm_per_n(ROBOT, frames.points_to_base(PLACEMENT, points), base)
    return equivalent_compliance(matrix, base, frames.directions_to_base(PLACEMENT, normal), projection)  # type: ignore[arg-type]


@pytest.mark.parametrize("projection", ["linear", "quadratic", "normal"])
def test_each_projection_is_taken_along_the_surface_normal(projection: str) -> None:
    points, axis = arc()
    options = ComplianceOptions(projection=projection)  # type: ignore[arg-type]
    got = compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, options=options)
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    np.testing.assert_allclose(got.compliance_mm_per_n, by_hand(points, axis, up, projection), rtol=1e-12)


@pytest.mark.parametrize("direction", ["inward", "fixed", "along", "across"])
def test_the_tool_axis_turned_back_is_the_surface_normal(direction: str) -> None:
    points, _ = arc()
    options = ComplianceOptions(dip_direction=direction, dip_azimuth_deg=200.0)  # type: ignore[arg-type]
    points = points / 3 + [-60.0, 60.0, 60.0]  # where limbs are shorter: the spindle leans outward, too
    axis = dipped(points, options)
    surface = compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, options=options)
    turned = compliance_at(
        points, axis, PAPER, ROBOT, PLACEMENT, options=dataclasses.replace(options, frame="tool_axis")
    )
    np.testing.assert_allclose(turned.compliance_mm_per_n, surface.compliance_mm_per_n, rtol=1e-9)


def test_a_flat_arc_has_the_surface_normal_as_its_binormal_save_at_the_ends() -> None:
    points, axis = arc()
    frenet = compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, options=ComplianceOptions(frame="frenet"))
    surface = compliance_at(points, axis, PAPER, ROBOT, PLACEMENT)
    np.testing.assert_allclose(frenet.compliance_mm_per_n, surface.compliance_mm_per_n, rtol=1e-9)
    assert frenet.fallbacks == 2
    assert "no Frenet frame at 2 of 40 points" in frenet.notes[0]


def test_a_straight_line_falls_back_everywhere_and_counts_it() -> None:
    points = np.column_stack([np.linspace(-20, 20, 11), np.zeros(11), np.zeros(11)])
    found = compliance_at(
        points,
        dipped(points, ComplianceOptions()),
        PAPER,
        ROBOT,
        PLACEMENT,
        options=ComplianceOptions(frame="frenet"),
    )
    assert found.fallbacks == 11


def test_on_a_curved_raster_the_binormal_leans_away_from_the_surface_normal() -> None:
    """Physics, section 1: there the principal normal lies near the surface normal, and Frenet's b along the surface."""
    optic = Optic(400.0)
    x = np.linspace(-20, 20, 41)
    points = np.column_stack([x, np.full(41, 5.0), (x**2 + 25) / 800])
    axis = dipped(points, ComplianceOptions(), optic)
    frenet, surface = (
        compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, options=ComplianceOptions(frame=frame), optic=optic)  # type: ignore[arg-type]
        for frame in ("frenet", "surface")
    )
    inner = slice(1, -1)
    assert frenet.fallbacks == 2
    assert (np.abs(frenet.compliance_mm_per_n / surface.compliance_mm_per_n - 1)[inner] > 0.5).all()


def test_a_curved_part_is_dipped_off_its_own_normal() -> None:
    optic = Optic(400.0)
    points, flat = arc()
    with pytest.raises(ComputeError, match="the process says 15"):
        compliance_at(points, flat, PAPER, ROBOT, PLACEMENT, optic=optic)
    axis = dipped(points, ComplianceOptions(), optic)
    got = compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, optic=optic).compliance_mm_per_n
    normal = frames.surface_normals(PLACEMENT, points, optic) @ PLACEMENT.rotation
    np.testing.assert_allclose(got, by_hand(points, axis, normal), rtol=1e-12)


def test_a_measured_cell_has_what_was_measured() -> None:
    corners = np.array([[x, y, z] for x in (-60.0, 60.0) for y in (-60.0, 60.0) for z in (-10.0, 10.0)])
    base = frames.points_to_base(PLACEMENT, corners)
    table = MeasuredCompliance(base, 1.5 + corners[:, 0] / 100, "table.csv")
    points, axis = arc()
    found = compliance_at(points, axis, PAPER, table, PLACEMENT)
    np.testing.assert_allclose(found.compliance_mm_per_n, (1.5 + points[:, 0] / 100) * 1e-3, rtol=1e-9)


def test_moment_as_printed_is_another_robot() -> None:
    points, axis = arc()
    full, paper = (
        compliance_at(points, axis, PAPER, ROBOT, PLACEMENT, options=ComplianceOptions(moment=moment))  # type: ignore[arg-type]
        for moment in ("full", "paper")
    )
    assert (np.abs(paper.compliance_mm_per_n / full.compliance_mm_per_n - 1) > 0.02).all()
