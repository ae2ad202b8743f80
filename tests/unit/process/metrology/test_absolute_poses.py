"""What poses determine, from the null space, against the literature on such sets (Evans, Kestner 1996)."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.process.metrology.absolute_poses import (
    Design,
    PartPose,
    design_poses,
    family_name,
    family_names,
    pose_matrix,
    reference_for,
    term_name,
    terms,
)
from polishd.process.metrology.zernike import values
from tests.unit.process.metrology.turned_maps import turns

RADIUS_MM = 50.0
SHIFT = PartPose(0, 0.05 * RADIUS_MM)


def folds(found: Design) -> set[int]:
    """The m of all that is wholly unknown."""
    return {abs(one.m) for one in found.unknown if one.share > 0.99}


@pytest.mark.parametrize(
    "count", [2, 3, pytest.param(4, marks=pytest.mark.full), pytest.param(5, marks=pytest.mark.full)]
)
def test_equal_turns_leave_what_is_round_and_what_has_their_folds(count: int) -> None:
    found = design_poses(turns(count), 8, RADIUS_MM)
    assert folds(found) == {m for m in range(9) if m % count == 0}
    assert {(one.n, one.m) for one in found.unknown} == {(n, m) for n, m in found.terms if m % count == 0}


def test_the_lowest_that_equal_turns_leave_has_a_name() -> None:
    left = {
        count: family_names((one.n, one.m) for one in design_poses(turns(count), 8, RADIUS_MM).unknown)
        for count in (2, 3, 4)
    }
    low = ("astigmatism", "coma", "trefoil", "tetrafoil")
    assert {count: [name for name in names if name in low] for count, names in left.items()} == {
        2: ["astigmatism", "tetrafoil"],
        3: ["trefoil"],
        4: ["tetrafoil"],
    }


def test_four_and_three_leave_what_is_round_and_one_shift_more_leaves_power() -> None:
    both = [*turns(4), *turns(3)[1:]]
    assert folds(design_poses(both, 8, RADIUS_MM)) == {0}
    shifted = design_poses([*both, SHIFT], 8, RADIUS_MM)
    assert [(one.n, one.m) for one in shifted.unknown] == [(2, 0)]
    assert shifted.unknown[0].share == pytest.approx(1)
    assert [one.name for one in shifted.unknown] == ["power"]


def test_no_pose_tells_power() -> None:
    many = [PartPose(angle, x, y) for angle in range(0, 360, 40) for x, y in ((0, 0), (2.5, 0), (0, 2.5), (-5, 3))]
    assert [one.name for one in design_poses(many, 6, RADIUS_MM).unknown] == ["power"]


def test_shifts_alone_leave_astigmatism_and_power() -> None:
    """P(x) = x^2, y^2 and xy become only tilted by a shift."""
    found = design_poses([PartPose(0), PartPose(0, 2.5), PartPose(0, 0, 2.5)], 6, RADIUS_MM)
    assert {(one.n, one.m) for one in found.unknown} == {(2, 0), (2, 2), (2, -2)}


def test_a_mixture_is_reported_as_one() -> None:
    """One shift along x leaves any function of y: no single term wholly, many in part."""
    found = design_poses([PartPose(0), PartPose(0, 2.5)], 4, RADIUS_MM)
    shares = {one.share for one in found.unknown if one.n == 4}
    assert all(0.01 < share < 0.99 for share in shares)
    assert found.hidden.shape[1] == 5  # x^2, xy, y^2, y^3 and y^4: what a shift along x changes by a tilt at most


@pytest.mark.parametrize("degree", [4, pytest.param(8, marks=pytest.mark.full)])
def test_a_shift_of_a_twentieth_tells_spherical_at_a_few_times_the_noise(degree: int) -> None:
    """Z(4, 0) shifted by e radii shows e sqrt(5) 24 / (3 sqrt(8)) = 6.3 e of coma: a third of it at 5 %."""
    base = [*turns(4), *turns(3)[1:]]

    def sigma(share: float) -> float:
        found = design_poses([*base, PartPose(0, share * RADIUS_MM)], degree, RADIUS_MM)
        size = len(found.terms)
        rows = np.concatenate([np.hstack([move, np.eye(size)]) for move in found.moves])
        spread = np.linalg.pinv(rows.T @ rows, rcond=1e-8)
        return float(np.sqrt(np.diag(spread)[size + found.terms.index((4, 0))]))

    assert 3.0 < sigma(0.05) < 5.0
    assert sigma(0.05) / sigma(0.1) == pytest.approx(2, rel=0.15)


def test_terms_are_moved_as_the_part_is() -> None:
    """The terms of a turned and shifted part, seen at points, are its heights at the points that lie there."""
    pose = PartPose(37, 3.0, -2.0)
    rng = np.random.default_rng(0)
    part = rng.normal(size=len(terms(6)))
    x, y = rng.uniform(-0.6, 0.6, (2, 50))
    seen = (pose_matrix(6, pose, RADIUS_MM) @ part) @ values(terms(6), "rms", x, y)
    own = ((x + 1j * y) * RADIUS_MM - complex(3, -2)) * np.exp(-1j * np.radians(37)) / RADIUS_MM
    assert seen == pytest.approx(part @ values(terms(6), "rms", own.real, own.imag), abs=1e-9)
    back = pose.in_map(*pose.on_part(x, y))
    assert np.allclose(back, (x, y))


def test_poses_that_are_all_alike_tell_nothing() -> None:
    for other in (90, 450, 90.01):
        with pytest.raises(MapError, match="lies alike in all maps"):
            design_poses([PartPose(90), PartPose(other)], 6, RADIUS_MM)
    with pytest.raises(ValueError, match="the lowest above tilt"):
        design_poses(turns(2), 1, RADIUS_MM)


def test_names_are_those_of_optics() -> None:
    named = {(2, 0): "power", (2, 2): "astigmatism", (3, -1): "coma", (3, 3): "trefoil", (4, 0): "spherical",
             (4, -2): "secondary astigmatism", (4, 4): "tetrafoil", (5, 1): "secondary coma",
             (6, 0): "secondary spherical", (7, 7): "7-foil", (10, 0): "spherical of order 10"}  # fmt: skip
    assert {pair: family_name(*pair) for pair in named} == named
    assert term_name(3, -3) == "trefoil sin"
    assert "radius" in reference_for(2, 0)
    assert "shift" in reference_for(4, 0)
    assert "45 deg from one of 0, 90" in reference_for(4, 4, [0, 90])
