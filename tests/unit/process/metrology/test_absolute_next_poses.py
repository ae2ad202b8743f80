"""Poses to measure next: the fewest, and another reference for terms that no pose determines."""

from __future__ import annotations

import pytest

from polishd.process.metrology.absolute_poses import PartPose, PoseOptions, design_poses, next_poses

RADIUS_MM = 50.0
PORT = tuple(PartPose(angle) for angle in range(15, 360, 15))
STAGE = (PartPose(0, 2.5), PartPose(0, 0, 2.5))
ASTIGMATISM = {(2, 2): 0.3, (2, -2): 0.3}


def options(*candidates: PartPose, most: int = 6) -> PoseOptions:
    return PoseOptions(candidates, RADIUS_MM, noise_nm=0.2, most=most)


def test_astigmatism_takes_a_quarter_turn() -> None:
    found = next_poses(ASTIGMATISM, [PartPose(0)], options(*PORT))
    assert found.met
    assert [one.angle_deg % 180 for one in found.poses] == [90]
    # half of the difference of two maps: 0.2 / sqrt(2)
    assert found.sigma_nm[2, 2] == pytest.approx(0.2 / 2**0.5, rel=1e-3)


def test_nothing_is_measured_that_is_known() -> None:
    found = next_poses(ASTIGMATISM, [PartPose(0), PartPose(90)], options(*PORT))
    assert found.met
    assert found.poses == ()
    assert found.words == "no further pose"


def test_a_fold_that_is_missing_is_filled_by_one_map() -> None:
    wanted = {**ASTIGMATISM, (4, 4): 0.3, (4, -4): 0.3}
    found = next_poses(wanted, [PartPose(0), PartPose(90)], options(*PORT))
    assert found.met
    assert len(found.poses) == 1
    left = {(one.n, one.m) for one in design_poses([PartPose(0), PartPose(90), *found.poses], 6, RADIUS_MM).unknown}
    assert not left & set(wanted)


def test_power_needs_a_reference_and_spherical_a_shift() -> None:
    wanted = {(2, 0): 1.0, (4, 0): 2.0}
    on_port = next_poses(wanted, [PartPose(0)], options(*PORT))
    assert set(on_port.demanded) == {(2, 0), (4, 0)}
    assert on_port.poses == ()
    assert on_port.sigma_nm[4, 0] is None
    on_stage = next_poses(wanted, [PartPose(0)], options(*PORT, *STAGE))
    assert set(on_stage.demanded) == {(2, 0)}
    assert on_stage.met
    assert any(one.x_mm or one.y_mm for one in on_stage.poses)
    assert "radius" in on_stage.words


def test_more_certainty_takes_more_maps() -> None:
    few, many = (
        next_poses(dict.fromkeys(ASTIGMATISM, sigma), [PartPose(0)], options(*PORT)).poses for sigma in (0.15, 0.08)
    )
    assert len(few) < len(many)
    short = next_poses(dict.fromkeys(ASTIGMATISM, 0.02), [PartPose(0)], options(*PORT, most=2))
    assert not short.met
    assert len(short.poses) == 2


def test_what_is_wanted_must_be_a_term_above_tilt() -> None:
    for wanted in ({}, {(1, 1): 0.1}, {(3, 2): 0.1}):
        with pytest.raises(ValueError, match="above tilt"):
            next_poses(wanted, [PartPose(0)], options(*PORT))
    with pytest.raises(ValueError, match="candidate"):
        next_poses(ASTIGMATISM, [PartPose(0)], options())
