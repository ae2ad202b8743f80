"""The compliance over the workspace: the published range, what is out of reach, and robots without a cylinder."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from polishd.model.process import ComplianceOptions, HybridRobot, MeasuredCompliance, Placement, ToolProcess
from polishd.process.frames import rotation_from_rpy_deg
from polishd.process.robot.compliance import ComplianceField, compliance_field

PAPER = ToolProcess()
PLACEMENT = Placement((300.0, 220.0, 2315.0), rotation_from_rpy_deg(180.0, 0.0, 0.0))
SHIPPED = HybridRobot()


def field(robot: HybridRobot | MeasuredCompliance = SHIPPED, **options: str) -> ComplianceField:
    return compliance_field(robot, PAPER, PLACEMENT, ComplianceOptions(**options), planes=4, across=31)  # type: ignore[arg-type]


def test_the_shipped_robot_has_the_published_range() -> None:
    found = field()
    known = found.compliance_um_per_n[np.isfinite(found.compliance_um_per_n)]
    assert 1.03 < known.min() < 1.15
    assert 1.85 < known.max() < 1.98
    gamma = found.gamma[np.isfinite(found.gamma)]
    assert 0.83 < gamma.min() < gamma.max() < 0.92


def test_places_out_of_reach_are_left_out_and_counted() -> None:
    found = field()
    assert np.isfinite(found.compliance_um_per_n).sum() == found.places - found.out_of_reach
    assert 0.85 < 1 - found.out_of_reach / found.places < 0.98
    corner = np.hypot(found.x_mm[0], found.y_mm[0])
    assert corner > SHIPPED.workspace_radius_mm
    assert np.isnan(found.compliance_um_per_n[:, 0, 0]).all()


def test_planes_are_those_of_the_workspace() -> None:
    found = field()
    np.testing.assert_allclose(found.z_mm, np.linspace(2535 - 910, 2535 - 200, 4))
    assert found.compliance_um_per_n.shape == (4, 31, 31)


def test_mirror_images_are_as_soft_as_each_other() -> None:
    """The shipped limbs lie symmetric about the y-z plane."""
    found = field().compliance_um_per_n
    np.testing.assert_allclose(found, found[:, :, ::-1], rtol=1e-9)


def test_eq_41_as_printed_is_undefined_at_some_places() -> None:
    options = ComplianceOptions(moment="paper")
    found = compliance_field(SHIPPED, PAPER, PLACEMENT, options, planes=7, across=81)
    assert 0 < found.undefined < 0.01 * found.places
    assert np.isfinite(found.compliance_um_per_n).sum() == found.places - found.out_of_reach - found.undefined


def test_a_robot_too_soft_for_the_depth_shows_it_in_gamma() -> None:
    soft = field(dataclasses.replace(SHIPPED, a_stiffness_n_mm_per_rad=2e6))
    assert np.nanmin(soft.gamma) < 0


@pytest.mark.parametrize(("direction", "azimuth"), [("along", 0.0), ("across", 90.0)])
def test_without_a_path_along_is_along_x(direction: str, azimuth: float) -> None:
    fixed = compliance_field(
        SHIPPED, PAPER, PLACEMENT, ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=azimuth), planes=2, across=9
    )
    found = compliance_field(
        SHIPPED,
        PAPER,
        PLACEMENT,
        ComplianceOptions(dip_direction=direction),  # type: ignore[arg-type]
        planes=2,
        across=9,
    )
    np.testing.assert_array_equal(found.compliance_um_per_n, fixed.compliance_um_per_n)


def test_the_other_options_hold_without_a_path() -> None:
    asked = ComplianceOptions(dip_direction="along", projection="normal")
    plain = ComplianceOptions(dip_direction="along")
    one, other = (compliance_field(SHIPPED, PAPER, PLACEMENT, o, planes=2, across=9) for o in (asked, plain))
    assert not np.allclose(one.compliance_um_per_n, other.compliance_um_per_n, equal_nan=True)


def test_a_table_is_shown_over_the_box_of_its_places() -> None:
    corners = np.array([[x, y, 2300.0] for x in (0.0, 100.0) for y in (-50.0, 50.0)])
    found = field(MeasuredCompliance(corners, 1 + corners[:, 0] / 100, "table"))
    assert found.z_mm.tolist() == [2300.0]
    np.testing.assert_allclose(found.compliance_um_per_n[0], np.tile(1 + found.x_mm / 100, (31, 1)), rtol=1e-9)
