"""What is drawn to be wrong, by what it does to a removal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Effects, Plant, Truth
from polishd.model.errors import BatchRequestError
from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.sim_backends.batch import BatchPlant
from polishd.sim_backends.common.mechanics import tip_gives_mm_per_n
from polishd.sim_backends.plant import effects
from polishd.sim_backends.plant.tool import hertz_depth_mm, sliding

PERFECT = Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.0, map_noise_nm=0.0)


def plant(**wrong: object) -> BatchPlant:
    """A small flat part of the demo's cell, on a machine that does as eq. 44 says, and pulls nothing sideways."""
    wrong = {"eq_44": [1, 1], "friction": [0, 0]} | wrong
    config = SimConfig(
        plant=Plant(aperture_mm=40.0, rms_nm=0.0, pitch_mm=0.25),
        hidden_truth=PERFECT,
        effects=Effects.model_validate(wrong),
    )
    return BatchPlant(config, 3)


def spot(
    made: BatchPlant, x: float = 0.0, y: float = 0.0, seconds: float = 10.0, force: float = 12.0, rpm: float = 1000.0
) -> FloatArray:
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
            "rpm": rpm * one,
        }
    )
    return before - made.world.part.height_nm


def centroid(made: BatchPlant, removal: FloatArray) -> FloatArray:
    grid = made.world.part.grid
    along = np.array([(removal.sum(axis=0) * grid.x_mm).sum(), (removal.sum(axis=1) * grid.y_mm).sum()])
    return np.asarray(along / removal.sum())


def test_off_is_nothing_to_the_last_bit() -> None:
    drawn = effects.draw(SimConfig(effects=Effects(eq_44=(1.0, 1.0), friction=(0.0, 0.0))), 5)
    place, worked = np.array([[10.0, -20.0, 0.0], [1.0, 2.0, 0.0]]), np.array([0.0, 5000.0])
    assert (drawn.rate(place, worked) == 1.0).all()
    assert (drawn.speed(worked) == 1.0).all()
    assert (drawn.force(worked) == 1.0).all()
    assert (drawn.compliance, drawn.eq_44, drawn.turn_deg, drawn.skew, drawn.bonnet) == (1.0, 1.0, 0.0, 0.0, 1.0)
    assert (drawn.friction, drawn.force_lag_s, drawn.guide_friction_n) == (0.0, 0.0, 0.0)
    assert not drawn.robot.at(place).any()
    assert not drawn.height.at(place).any()
    assert not drawn.lean.at(place).any()


@pytest.mark.full
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


@pytest.mark.full
@pytest.mark.parametrize("frame", ["tool", "part"])
def test_spot_shift_has_its_length(frame: str) -> None:
    made, right = plant(spot_shift_mm=1.5, spot_frame=frame), plant()
    moved = centroid(made, spot(made)) - centroid(right, spot(right))
    assert np.hypot(*moved) == pytest.approx(1.5, abs=0.01)


def test_a_part_off_its_seat_is_hit_the_other_way() -> None:
    made, right = plant(seat_shift_mm=2.0), plant()
    moved = centroid(made, spot(made)) - centroid(right, spot(right))
    assert moved == pytest.approx(-np.array(made.world.effects.seat_mm), abs=0.01)


def second(made: BatchPlant, removal: FloatArray) -> FloatArray:
    """(2, 2) of its second moments about its centroid, mm^2."""
    grid, at = made.world.part.grid, centroid(made, removal)
    x, y = np.meshgrid(grid.x_mm - at[0], grid.y_mm - at[1])
    away = np.stack([x, y])
    return np.asarray(np.einsum("iyx,jyx,yx->ij", away, away, removal) / removal.sum())


def test_a_turned_spot_is_the_same_spot_turned() -> None:
    made, right = plant(spot_turn_deg=30.0, spot_shift_mm=1.0), plant(spot_shift_mm=1.0)
    angle = np.radians(made.world.effects.turn_deg)
    assert 1.0 < abs(np.degrees(angle)) < 30.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned, straight = spot(made), spot(right)
    assert turned.sum() == pytest.approx(straight.sum(), rel=1e-4)
    assert centroid(made, turned) == pytest.approx(turn @ centroid(right, straight), abs=2e-3)
    assert second(made, turned) == pytest.approx(turn @ second(right, straight) @ turn.T, abs=2e-3)


@pytest.mark.full
def test_a_skewed_spot_removes_more_where_the_bonnet_slides_to() -> None:
    made, right = plant(spot_skew=0.3, eq_44=[0, 0]), plant(eq_44=[0, 0])
    skewed, straight = spot(made), spot(right)
    moved = centroid(made, skewed) - centroid(right, straight)
    assert skewed.sum() == pytest.approx(straight.sum(), rel=1e-6), "as much in all"
    tool = made.config.process.tool()
    rim_mm = np.sqrt(tool.tool_radius_mm * hertz_depth_mm(tool, np.array([12.0]))[0])
    along_x = made.world.effects.skew * second(right, straight)[0, 0] / rim_mm
    assert abs(along_x) > 0.05
    assert moved == pytest.approx([along_x, 0.0], abs=2e-3), "it leans back along y, and so slides along x"


def test_a_soft_bonnet_makes_the_same_volume_wider() -> None:
    made, right = plant(bonnet_pressure=0.2, eq_44=[0, 0]), plant(eq_44=[0, 0])
    modulus = made.world.effects.bonnet
    assert abs(modulus - 1.0) == pytest.approx(0.2)
    changed, straight = spot(made), spot(right)
    assert changed.sum() == pytest.approx(straight.sum(), rel=5e-3), "Preston: force times speed"
    width = np.trace(second(made, changed)) / np.trace(second(right, straight))
    assert width == pytest.approx(modulus ** (-2.0 / 3.0), rel=0.02), "Hertz: a^2 as E*^(-2/3)"


def test_a_robot_is_off_by_a_smooth_field_within_its_size() -> None:
    waves = plant(robot_error_mm=0.3, robot_error_wave_mm=200.0).world.effects.robot
    here = np.random.default_rng(1).uniform(-500.0, 500.0, (4000, 3))
    off = waves.at(here)
    assert 0.25 < np.hypot(*off.T).max() <= 0.3
    near = waves.at(here + np.array([1.0, 0.0, 0.0])) - off
    assert np.hypot(*near.T).max() <= 0.3 * 2.0 * np.pi / 200.0


def test_a_robot_that_is_off_hits_where_it_truly_is() -> None:
    made, right = plant(robot_error_mm=0.3), plant()
    frames = made.world._frames
    for x, y in ((0.0, 0.0), (12.0, -9.0)):
        tips, _ = frames.in_base(np.array([[x, y, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
        moved = centroid(made, spot(made, x, y)) - centroid(right, spot(right, x, y))
        assert moved == pytest.approx(made.world.effects.robot.at(tips)[0], abs=2e-3)


def test_a_spindle_that_leans_more_slides_faster() -> None:
    made, right = plant(robot_error_deg=5.0, eq_44=[0, 0]), plant(eq_44=[0, 0])
    tips, _ = made.world._frames.in_base(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    by = made.world.effects.lean.at(tips)[0]
    axis = np.array([by[0], by[1] - np.sin(np.radians(15.0)), np.cos(np.radians(15.0))])
    lean = np.hypot(*axis[:2]) / np.linalg.norm(axis)
    assert spot(made).sum() / spot(right).sum() == pytest.approx(lean / np.sin(np.radians(15.0)), rel=0.02)


@pytest.mark.full
def test_a_tool_that_vibrates_smears_its_track() -> None:
    def track(made: BatchPlant) -> FloatArray:
        x = np.linspace(-10.0, 10.0, 201)
        tip = np.column_stack([x, 0.0 * x, 0.0 * x])
        lean = np.tile([0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))], (201, 1))
        one = np.ones(201)
        blocks = {"begin_mm": tip, "end_mm": tip, "axis": lean, "seconds": 0.1 * one}
        made.polish({**blocks, "force_n": 12.0 * one, "rpm": 1000.0 * one})
        return np.asarray(-made.world.part.height_nm)

    made, right = plant(vibration_mm=0.5), plant()
    smeared, straight = track(made), track(right)
    assert smeared.sum() == pytest.approx(straight.sum(), rel=1e-6)
    wider = second(made, smeared)[1, 1] - second(right, straight)[1, 1]
    assert wider == pytest.approx(0.5**2 / 2.0, rel=0.05), "the mean of a circle's y^2"


def test_force_that_acts_decides() -> None:
    made, right = plant(force_ripple=0.2, force_ripple_s=40.0, eq_44=[0, 0]), plant(eq_44=[0, 0])
    assert spot(made).sum() / spot(right).sum() == pytest.approx(1.0 + 0.2 * np.sin(np.pi / 4.0), rel=5e-3)


@pytest.mark.full
def test_a_new_effect_changes_no_other_one_s_draw() -> None:
    alone, beside = plant(seat_shift_mm=2.0), plant(seat_shift_mm=2.0, spot_turn_deg=10.0, robot_error_mm=0.3)
    assert alone.world.effects.seat_mm == beside.world.effects.seat_mm
    other = plant(seat_shift_mm=2.0, eq_44=[0.2, 0.3], friction=[0.1, 0.9], force_lag_s=0.1).world.effects
    assert replace(other, eq_44=1.0, friction=0.0, force_lag_s=0.0) == alone.world.effects


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
    with pytest.raises(BatchRequestError, match="quarter turn"):
        made.measure(0.0, 45.0, (0, 0))


@pytest.mark.full
def test_friction_pulls_the_spot_by_what_the_robot_gives_sideways() -> None:
    made, right = plant(friction=[0.5, 0.5]), plant()
    frames = made.world._frames
    lean = np.array([[0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))]])
    tips, axes = frames.in_base(np.zeros((1, 3)), lean)
    _, matrix = tip_gives_mm_per_n(HybridRobot(), tips, axes)
    pull = frames.to_base.T @ matrix[0] @ frames.to_base @ (-sliding(lean, np.ones(1))[0] @ np.eye(2, 3))
    moved = centroid(made, spot(made)) - centroid(right, spot(right))
    pulled = pull[:2] * 0.5 * 12.0 / np.cos(np.radians(15.0))
    assert np.hypot(*pulled) > 5e-3
    assert moved == pytest.approx(pulled, abs=5e-4)
    reversed_moved = centroid(made, spot(made, rpm=-1000.0)) - centroid(right, spot(right))
    assert reversed_moved == pytest.approx(-pulled, abs=5e-4), "it slides the other way"


def test_a_reversed_spindle_removes_as_much_and_the_same_where_nothing_has_a_side() -> None:
    made = plant()
    forward = spot(made)
    assert forward.max() > 1000.0
    assert np.allclose(spot(made, rpm=-1000.0), forward, rtol=1e-9, atol=1e-9)
    assert made.world.acted
    assert np.allclose(np.concatenate(made.world.acted)[:, 3], -1000.0), "as the spindle measures it"


def test_a_reversed_spindle_removes_the_mirror_image_of_a_skewed_spot() -> None:
    made = plant(spot_skew=0.3)
    forward, backward = spot(made), spot(made, rpm=-1000.0)
    assert np.abs(forward - backward).max() > 0.05 * forward.max()
    assert np.allclose(backward, forward[:, ::-1], atol=1e-6 * forward.max()), "the axis leans along y"


def test_what_is_lost_and_the_friction_are_drawn_between_their_ends() -> None:
    drawn = [effects.draw(SimConfig(), seed) for seed in range(40)]
    lost, friction = np.array([one.eq_44 for one in drawn]), np.array([one.friction for one in drawn])
    assert lost.min() < 0.1
    assert lost.max() > 0.9
    assert friction.min() >= 0.2
    assert friction.max() <= 0.5
