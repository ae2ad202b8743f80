"""The true force behind the actuator's: a first-order law, step by step exact."""

from __future__ import annotations

import math

import numpy as np
import pytest

from polishd.config.simulator import Effects, Plant, SimConfig, Truth
from polishd.model.surface import FloatArray
from polishd.sim_backends.batch import BatchPlant
from polishd.sim_backends.plant.tool import ForceDynamics

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
