"""Share of an instrument's shorter waves that poses leave undetermined: predicted, then confirmed."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.surface import FloatArray
from polishd.process.metrology.absolute_poses import PartPose
from polishd.process.metrology.absolute_test import hidden_share, separate_instrument
from tests.unit.process.metrology.turned_maps import PITCH_MM, RADIUS_MM, maps, rms_nm, true_nm, turns


@pytest.mark.parametrize("count", [2, 4, pytest.param(3, marks=pytest.mark.full)])
def test_equal_turns_leave_one_part_in_their_number(count: int) -> None:
    """Of directions alike: m = kN are one in N of all."""
    assert hidden_share(turns(count), 10, RADIUS_MM) == pytest.approx(1 / count, abs=0.06)


@pytest.mark.full
def test_turns_that_share_no_fold_leave_little() -> None:
    both = [*turns(4), *turns(3)[1:]]
    assert hidden_share(both, 10, RADIUS_MM) < 0.5 * hidden_share(turns(4), 10, RADIUS_MM)
    assert hidden_share([*both, PartPose(0, 2.0), PartPose(0, 0, 2.0)], 10, RADIUS_MM) < hidden_share(
        both, 10, RADIUS_MM
    )


@pytest.mark.parametrize("count", [4, pytest.param(2, marks=pytest.mark.full)])
def test_what_is_left_of_prints_is_as_large_as_said(count: int) -> None:
    """Of eight waves each, of 31 radians a radius: one print can leave half or twice as much, twelve together not."""
    poses = turns(count)
    off, said = [], []
    for seed in range(12):
        ways = np.random.default_rng(seed).uniform(0, 2 * np.pi, (8, 2))

        def print_nm(x: FloatArray, y: FloatArray, ways: FloatArray = ways) -> FloatArray:
            return np.asarray(sum(np.sin(31 * (np.cos(a) * x + np.sin(a) * y) + b) for a, b in ways) / 2)

        found = separate_instrument(maps(poses, 0.01, instrument=print_nm), poses, PITCH_MM, noise_nm=0.01)
        off.append(rms_nm(found.instrument_nm - true_nm(print_nm)))
        said.append(found.hidden_rest_nm)
    # of prints of 1 nm RMS
    assert np.hypot.reduce(off) / 12**0.5 == pytest.approx(1 / count**0.5, rel=0.2)
    assert np.hypot.reduce(said) == pytest.approx(np.hypot.reduce(off), rel=0.25)


def test_noise_is_no_print() -> None:
    poses = turns(4)
    found = separate_instrument(maps(poses, 0.3, instrument=lambda x, y: 3 * (x * x - y * y)), poses, PITCH_MM)
    assert found.hidden_rest_nm < 0.03
