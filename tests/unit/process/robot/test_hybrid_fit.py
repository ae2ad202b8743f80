"""The fit of the default robot can be run again, and comes to the same robot."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks import fit_robot
from polishd.model.process import HybridRobot

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
