"""What is drawn to be wrong, by what it does to a removal."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from polishd.config.simulator import Plant, SimConfig, Truth
from polishd.config.simulator_effects import Effects
from polishd.model.errors import BadRequestError
from polishd.model.surface import FloatArray
from polishd.sim_backends.batch.plant import BatchPlant
from polishd.sim_backends.plant import effects

PERFECT = Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.0, map_noise_nm=0.0)


def plant(**wrong: object) -> BatchPlant:
    """A small flat part of the demo's cell."""
    config = SimConfig(
        plant=Plant(aperture_mm=40.0, rms_nm=0.0, pitch_mm=0.25),
        truth=PERFECT,
        effects=Effects.model_validate(wrong),
    )
    return BatchPlant(config, 3)


def spot(made: BatchPlant, x: float = 0.0, y: float = 0.0, seconds: float = 10.0, force: float = 12.0) -> FloatArray:
    """Removal, nm, of one spot at rest."""
    before = made.world.part.height_nm.copy()
    tip = np.array([[x, y, 0.0]])
    lean = np.array([[0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))]])
    one = np.ones(1)
    made.polish(
        {
            "begin_mm": tip,
            "end_mm": tip,
            "axis": lean,
            "seconds": seconds * one,
            "force_n": force * one,
            "rpm": 1000.0 * one,
        }
    )
    return before - made.world.part.height_nm


def centroid(made: BatchPlant, removal: FloatArray) -> FloatArray:
    grid = made.world.part.grid
    along = np.array([(removal.sum(axis=0) * grid.x_mm).sum(), (removal.sum(axis=1) * grid.y_mm).sum()])
    return np.asarray(along / removal.sum())


def test_off_is_nothing_to_the_last_bit() -> None:
    drawn = effects.draw(SimConfig(), 5)
    place, worked = np.array([[10.0, -20.0, 0.0], [1.0, 2.0, 0.0]]), np.array([0.0, 5000.0])
    assert (drawn.rate(place, worked) == 1.0).all()
    assert (drawn.speed(worked) == 1.0).all()
    assert (drawn.compliance, drawn.eq_44) == (1.0, 1.0)


def test_constant_depth_removes_as_a_robot_that_does_not_give() -> None:
    stiff, soft = spot(plant(eq_44=[0, 0])), spot(plant())
    volume = 9.72e-3 * 1e6 / plant().world.part.grid.pitch_mm ** 2
    assert stiff.sum() == pytest.approx(volume, rel=5e-3)
    gamma = (soft.sum() / stiff.sum()) ** (2.0 / 3.0)
    assert 0.8 < gamma < 0.92


def test_a_pad_loses_half_in_its_half_life() -> None:
    made = plant(pad_half_life_s=100.0)
    first = spot(made).sum()
    spot(made, x=10.0, seconds=90.0)
    assert spot(made).sum() == pytest.approx(first / 2.0, rel=1e-9)


def test_a_cold_tool_warms_up() -> None:
    made = plant(warm_up=0.5, warm_up_s=20.0)
    first, second = spot(made, seconds=20.0).sum(), spot(made, seconds=20.0).sum()
    at = 0.5 * np.exp(-np.array([0.5, 1.5]))
    assert second / first == pytest.approx((1.0 - at[1]) / (1.0 - at[0]), rel=1e-9)


def test_rate_field_is_what_was_drawn() -> None:
    made = plant(rate_field=0.2, eq_44=[0, 0])
    drawn = made.world.effects
    assert abs(drawn.linear) + abs(drawn.square) == pytest.approx(0.2)
    angle = np.radians(drawn.field_deg)
    x, y = 10.0 * np.cos(angle), 10.0 * np.sin(angle)
    ratio = spot(made, x, y).sum() / spot(made, -x, -y).sum()
    half, quarter = drawn.linear / 2.0, 1.0 + drawn.square / 4.0
    assert ratio == pytest.approx((quarter + half) / (quarter - half), rel=2e-3)


@pytest.mark.parametrize("frame", ["tool", "part"])
def test_spot_shift_has_its_length(frame: str) -> None:
    made, right = plant(spot_shift_mm=1.5, spot_frame=frame), plant()
    moved = centroid(made, spot(made)) - centroid(right, spot(right))
    assert np.hypot(*moved) == pytest.approx(1.5, abs=0.01)


def test_a_part_off_its_seat_is_hit_the_other_way() -> None:
    made, right = plant(seat_shift_mm=2.0), plant()
    moved = centroid(made, spot(made)) - centroid(right, spot(right))
    assert moved == pytest.approx(-np.array(made.world.effects.seat_mm), abs=0.01)


def test_speed_that_acts_decides() -> None:
    made = plant(speed_ripple=0.2, speed_ripple_s=40.0)
    assert spot(made).sum() / spot(plant()).sum() == pytest.approx(1.0 + 0.2 * np.sin(np.pi / 4.0), rel=1e-9)


def test_a_range_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(ValidationError, match="give the lower one first"):
        Effects(eq_44=(0.8, 0.2))


def test_a_turned_map_is_the_turned_truth() -> None:
    made = plant()
    spot(made, 5.0, 3.0)
    straight, turned = made.measure(0.0, 0.0, (0, 0)), made.measure(0.0, 90.0, (2, 0))
    assert np.array_equal(turned[:, 2:], np.rot90(straight)[:, :-2], equal_nan=True)
    assert np.isnan(turned[:, :2]).all()
    with pytest.raises(BadRequestError, match="quarter turn"):
        made.measure(0.0, 45.0, (0, 0))
