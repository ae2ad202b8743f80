"""The search of a part's place: its figures against `compliance_at`, its margins, and the keys that it writes."""

from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle
from polishd.model.process import (
    ComplianceOptions,
    HybridRobot,
    MeasuredCompliance,
    Optic,
    Placement,
    RobotModel,
    ToolProcess,
)
from polishd.process import frames
from polishd.process.frames import rotation_from_rpy_deg
from polishd.process.optic_surface import sag_mm, unit_normals
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.robot.compliance import compliance_at, depth_ratio
from polishd.process.robot.placement import (
    PlacedPart,
    PlacementMargins,
    PlacementTask,
    placement_fragment,
    search_placement,
)
from polishd.process.robot.serial import posture_margins, serial_inverse_kinematics
from tests.unit.process.robot.arms import UR5

HERE = Placement((300.0, 220.0, 2315.0), rotation_from_rpy_deg(180.0, 0.0, 0.0))
BESIDE = Placement((-450.0, -200.0, 150.0), np.eye(3))
FIXED = ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=30.0)


def task(robot: RobotModel | None = None, placement: Placement = HERE, **others: object) -> PlacementTask:
    given: dict[str, object] = {
        "process": ToolProcess(),
        "options": ComplianceOptions(),
        "outline": Circle(50.0),
        "alignment": "tilt",
    }
    return PlacementTask(robot=robot or HybridRobot(), placement=placement, **(given | others))  # type: ignore[arg-type]


def gammas(of: PlacementTask, found: PlacedPart) -> np.ndarray:
    """Gamma at the samples of the part's box that lie on it, by the way that plans take."""
    turned = of.placement.rotation @ rotation_from_rpy_deg(0.0, 0.0, found.turn_deg)
    placement = Placement(found.origin_mm, turned)
    line = np.linspace(-50.0, 50.0, 7)
    plane = np.array([(x, y) for y in line for x in line if np.hypot(x, y) <= 50.0])
    points = np.column_stack([plane, sag_mm(of.optic, plane)])
    tip = frames.points_to_base(placement, points)
    normal = frames.directions_to_base(placement, unit_normals(of.optic, plane))
    axis = frames.dipped_axes(of.options, placement, tip, normal, of.process.dip_deg) @ turned
    gamma = [
        depth_ratio(
            compliance_at(
                point[None], one[None], of.process, of.robot, placement, options=of.options, optic=of.optic
            ).compliance_mm_per_n,
            of.process,
            hertz_depth_mm(of.process),
        )[0]
        for point, one in zip(points, axis, strict=True)
    ]
    return np.array(gamma)


@pytest.mark.full
@pytest.mark.parametrize("optic", [Optic(), Optic(radius_mm=800.0)], ids=["flat", "concave"])
@pytest.mark.parametrize("options", [ComplianceOptions(), FIXED], ids=["inward", "fixed"])
def test_a_place_has_the_gamma_that_plans_take(options: ComplianceOptions, optic: Optic) -> None:
    of = task(options=options, optic=optic)
    found = search_placement(of, 100.0)
    for one in (found.reached[0], found.reached[-1]):
        gamma = gammas(of, one)
        assert one.gamma_mean == pytest.approx(gamma.mean(), rel=1e-9)
        assert one.gamma_range == pytest.approx(np.ptp(gamma), rel=1e-6)


@pytest.mark.full
def test_no_place_that_was_tried_is_better_and_errors_grow_with_the_removal() -> None:
    found = search_placement(task(), 100.0)
    errors = [one.error_nm for one in found.reached]
    assert errors[0] <= min(errors) + 1e-4
    assert found.present is not None
    assert found.gain_nm == found.present.error_nm - errors[0] >= 0
    more = search_placement(task(removal_nm=500.0), 100.0)
    assert more.reached[0].error_nm <= 5 * errors[0] + 1e-4
    assert more.present is not None
    assert more.present.error_nm == pytest.approx(5 * found.present.error_nm, rel=1e-9)


@pytest.mark.full
def test_without_the_alignment_terms_less_is_left() -> None:
    piston, tilt, power = (
        search_placement(task(alignment=alignment), 1.0).present for alignment in ("piston", "tilt", "power")
    )
    assert piston is not None
    assert tilt is not None
    assert power is not None
    assert piston.error_nm > 3 * tilt.error_nm > 0
    assert tilt.error_nm >= power.error_nm


@pytest.mark.full
def test_the_parts_turn_counts_where_the_spindle_leans_in_a_direction_of_the_part() -> None:
    assert {one.turn_deg for one in search_placement(task(), 50.0).reached} == {0.0}
    assert len({one.turn_deg for one in search_placement(task(options=FIXED), 50.0).reached}) >= 5


@pytest.mark.full
def test_an_arm_keeps_its_margins_and_turns_its_flange() -> None:
    of = task(UR5, BESIDE, outline=Circle(30.0))
    found = search_placement(of, 60.0)
    assert {one.flange_turn_deg for one in found.reached} > {0.0}
    for one in found.reached[:3]:
        placement = Placement(one.origin_mm, of.placement.rotation)
        tip = frames.points_to_base(placement, np.zeros((1, 3)))
        normal = frames.surface_normals(placement, np.zeros((1, 3)))
        axis = frames.dipped_axes(of.options, placement, tip, normal, of.process.dip_deg)
        turn = rotation_from_rpy_deg(0.0, 0.0, one.flange_turn_deg)
        x, y, z = (turn @ np.asarray(UR5.flange_x)).tolist()
        joints = serial_inverse_kinematics(dataclasses.replace(UR5, flange_x=(x, y, z)), tip, axis)
        joint_deg, regular = posture_margins(UR5, joints)
        assert joint_deg >= of.margins.joint_deg
        assert regular >= of.margins.regular


def test_a_spindle_that_leans_inward_has_no_direction_on_the_bases_axis() -> None:
    found = search_placement(task(placement=Placement((0.0, 0.0, 2315.0), HERE.rotation)), 40.0)
    assert found.present is None
    assert found.gain_nm is None


def test_a_place_within_the_margins_is_none() -> None:
    assert search_placement(task(margins=PlacementMargins(around_mm=900.0)), 50.0).reached == ()


def test_a_table_of_loading_tests_is_searched_within_its_hull() -> None:
    corners = np.array([(x, y, 0.0) for x in (-100.0, 100.0) for y in (-100.0, 100.0)])
    table = MeasuredCompliance(corners, np.array([1.0, 1.0, 1.0, 1.4]))
    found = search_placement(task(table, Placement((0.0, 0.0, 0.0), np.eye(3)), outline=Circle(20.0)), 100.0)
    assert found.refused > 0
    assert all(abs(one.origin_mm[0]) <= 80.1 and abs(one.origin_mm[1]) <= 80.1 for one in found.reached)


@pytest.mark.parametrize(("within", "removal"), [(0.0, 100.0), (np.nan, 100.0), (50.0, 0.0), (50.0, -1.0)])
def test_lengths_that_cannot_be_are_refused(within: float, removal: float) -> None:
    with pytest.raises(ComputeError, match="above 0"):
        search_placement(task(removal_nm=removal), within)


def test_the_keys_that_are_written_lay_the_part_there() -> None:
    found = PlacedPart((1.5, -2.25, 3.0), 40.0, 90.0, 0.9, 0.1, 0.2)
    keys = tomllib.loads(placement_fragment(found, HERE, UR5))
    assert keys["part"]["origin_mm"] == [1.5, -2.25, 3.0]
    turned = HERE.rotation @ rotation_from_rpy_deg(0.0, 0.0, 40.0)
    assert rotation_from_rpy_deg(*keys["part"]["rotation_rpy_deg"]) == pytest.approx(turned, abs=1e-6)
    assert np.linalg.norm(keys["kinematics"]["flange_x"]) == pytest.approx(np.linalg.norm(UR5.flange_x))
    assert np.dot(keys["kinematics"]["flange_x"], UR5.flange_x) == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ComputeError, match="only a serial arm"):
        placement_fragment(found, HERE, HybridRobot())
