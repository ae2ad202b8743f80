"""The plant: what it books is what was executed, however late or out of order the devices report."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Plant, Truth
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.plant import part as parts
from polishd.sim_backends.plant.server import SimEventLog
from polishd.sim_backends.plant.world import Timeline, World
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.program_reader import Pose, Reader
from polishd.sim_backends.robot.trajectory import Limits

PERFECT = Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.0, map_noise_nm=0.0)
HOME = (-20.0, 0.0, 0.0, 15.0, 0.0)
LIMITS = Limits(
    accel_mm_s2=1000.0, overhead_s=0.005, corner_deg=30.0, rapid_mm_s=100.0, max_feed_mm_s=100.0, speed=60.0
)


def world(hidden: Truth = PERFECT, pose: Pose = HOME, **seat: Any) -> World:
    """A small flat part that the tool touches with 12 N at 1000 rpm from the start."""
    config = SimConfig(plant=Plant(aperture_mm=40.0, rms_nm=0.0, **seat), hidden_truth=hidden)
    made = World(
        config,
        hidden_truth.draw(hidden, 1),
        parts.make(config.plant, 1),
        np.random.default_rng(1),
        pose,
        robot_s=0.0,
    )
    made.force.push([(0.0, 12.0)], math.inf)
    made.rpm.push([(0.0, 1000.0)], math.inf)
    return made


def motion_rows(lines: list[Any], ticks: Any) -> tuple[SimMotion, list[np.ndarray]]:
    """Rows as the robot sends them, one batch a tick (wall times)."""
    reader, motion = Reader(HOME), SimMotion(LIMITS, HOME)
    motion.load(len(lines))
    motion.append(0.0, [reader.read(line.encode()) for line in lines])
    motion.resume(0.0, None)
    batches = []
    for wall in ticks:
        motion.advance(wall)
        if motion.rows:
            batches.append(np.concatenate(motion.rows))
            motion.rows.clear()
    return motion, batches


LINES = [f"G1 X{x} F{600 + 100 * (x % 3)}" for x in range(-19, 20)]


def worn(batches: list[np.ndarray], horizons: Any, hidden: Truth = PERFECT) -> World:
    plant = world(hidden)
    plant.account.load("ab", len(LINES))
    for batch, horizon in zip(batches, horizons, strict=True):
        plant.move(batch)
        plant.integrate(horizon)
    plant.integrate(math.inf)
    return plant


def test_contact_time_is_executed_time() -> None:
    motion, batches = motion_rows(LINES, np.arange(0.01, 0.5, 0.01))
    plant = worn(batches, np.arange(len(batches)) * 0.01)
    spans = [end - start for _, start, end in motion.executed]
    assert motion.state == "done"
    assert np.allclose(plant.account.programs["ab"], spans, atol=1e-9)
    assert plant.account.standstill_s == 0.0


def test_volume_is_rate_times_time() -> None:
    _, batches = motion_rows(LINES, np.arange(0.01, 0.5, 0.01))
    plant = worn(batches, [math.inf] * len(batches))
    volume = -plant.part.height_nm.sum() * plant.part.grid.pitch_mm**2 * 1e-6
    seconds = plant.account.programs["ab"].sum()
    assert 0.811 * 0.9 < volume / (9.72e-4 * seconds) < 0.95**1.5


def test_a_worn_tool_takes_off_less_by_its_share() -> None:
    _, batches = motion_rows(LINES, np.arange(0.01, 0.5, 0.01))
    removed = [
        worn(batches, [math.inf] * len(batches), PERFECT.model_copy(update={"tool_wear": share})).part.height_nm
        for share in (0.0, 0.4)
    ]
    assert removed[1] == pytest.approx(0.6 * removed[0])


def test_neither_batches_nor_delay_change_the_part() -> None:
    _, fine = motion_rows(LINES, np.arange(0.003, 0.5, 0.003))
    _, coarse = motion_rows(LINES, [0.02, 0.04, 0.6])
    prompt = worn(fine, [math.inf] * len(fine)).part.height_nm
    late = worn(coarse, [0.0, 0.01, 0.05]).part.height_nm
    assert np.abs(prompt - late).max() < 0.01 * np.abs(prompt).max()
    assert prompt.sum() == pytest.approx(late.sum(), rel=1e-4)


def test_nothing_is_worn_beyond_the_horizon() -> None:
    _, batches = motion_rows(LINES, [0.6])
    plant = world()
    plant.account.load("ab", len(LINES))
    plant.move(batches[0])
    plant.integrate(0.03)
    assert plant.process_s == pytest.approx(0.03 * 60.0, abs=0.06)
    before = plant.part.height_nm.copy()
    plant.force.push([(0.031, 12.0), (0.0311, 0.0)], math.inf)
    plant.integrate(math.inf)
    assert np.abs(plant.part.height_nm - before).max() < 60.0
    assert plant.account.programs["ab"].sum() < 2.0


def test_force_off_while_moving_leaves_no_trace() -> None:
    _, batches = motion_rows(LINES, [0.6])
    plant = world()
    plant.force.push([(0.0, 0.0)], math.inf)
    plant.account.load("ab", len(LINES))
    plant.move(batches[0])
    plant.integrate(math.inf)
    assert not plant.part.height_nm.any()
    assert not plant.account.programs["ab"].any()
    assert plant.process_s > 2.0


def test_a_tool_that_stands_in_contact_digs_a_pit() -> None:
    plant = world()
    plant.stand_until(2.0)
    plant.integrate(1.0)
    assert plant.account.standstill_s == pytest.approx(1.0, abs=0.03)
    plant.integrate(math.inf)
    assert plant.part.height_nm.min() < -200.0
    assert plant.account.stands[0]["x_mm"] == -20.0
    assert plant.account.stands[0]["seconds"] == pytest.approx(2.0)


@pytest.mark.parametrize(("z", "near"), [(0.0, True), (4.4, True), (4.6, False), (-4.6, False), (30.0, False)])
def test_reach(z: float, near: bool) -> None:
    plant = world(pose=(0.0, 0.0, z, 15.0, 0.0))
    assert (plant.touch_um is not None) is near
    plant.stand_until(0.1)
    plant.integrate(math.inf)
    assert bool(plant.part.height_nm.any()) is near


def test_beside_the_ring_there_is_nothing_to_touch() -> None:
    assert world(pose=(60.0, 0.0, 0.0, 15.0, 0.0)).touch_um is None
    assert world(pose=(30.0, 0.0, 0.0, 15.0, 0.0)).touch_um == 5000.0


@pytest.mark.parametrize(
    ("seat", "touch_um"),
    [
        ({"seat_height_mm": 0.5}, 5000.0 - 500.0 / math.cos(math.radians(15))),
        ({"seat_tilt_deg": (1.0, 0.0)}, 5000.0 - 1000.0 * 9.0 * math.tan(math.radians(1)) / math.cos(math.radians(15))),
        ({"seat_tilt_deg": (0.0, 1.0)}, 5000.0 + 1000.0 * 6.0 * math.tan(math.radians(1)) / math.cos(math.radians(15))),
        ({"part_missing": True}, None),
    ],
)
def test_the_tool_meets_the_part_where_it_truly_sits(seat: dict[str, Any], touch_um: float | None) -> None:
    """A part that is turned about x rises towards +y; about y, it falls towards +x."""
    found = world(pose=(6.0, 9.0, 0.0, 15.0, 0.0), **seat).touch_um
    assert found == (touch_um if touch_um is None else pytest.approx(touch_um, abs=1.0))


def test_a_tool_that_rests_without_turning_removes_nothing_and_is_booked() -> None:
    plant = world()
    plant.force.push([(0.0, 12.0), (0.0, 0.8)], math.inf)
    plant.rpm.push([(0.0, 1000.0), (0.0, 0.0)], math.inf)
    plant.stand_until(2.0)
    plant.integrate(math.inf)
    assert not plant.part.height_nm.any()
    assert not math.isfinite(plant.polished_s)
    (stand,) = plant.account.stands
    assert (stand["most_n"], stand["most_rpm"]) == (pytest.approx(0.8), 0.0)


def test_a_reversed_spindle_polishes_and_its_speed_is_booked_without_its_sign() -> None:
    plant = world()
    plant.rpm = Timeline()
    plant.rpm.push([(0.0, -1000.0)], math.inf)
    plant.stand_until(1.0, (0.0, 0.0, 0.0, 15.0, 0.0))
    plant.integrate(math.inf)
    (stand,) = plant.account.stands
    assert stand["most_rpm"] == pytest.approx(1000.0)
    assert plant.part.height_nm.min() < -50.0
    assert plant.polished_s == pytest.approx(1.0)


def test_the_truth_scales_removal() -> None:
    def depth(hidden: Truth) -> float:
        plant = world(hidden)
        plant.stand_until(1.0)
        plant.integrate(math.inf)
        return plant.part.height_nm.min()

    slow = Truth(rate=(-0.1, -0.1), stiffness=0.0, drift=0.0, force_noise=0.0)
    assert depth(slow) == pytest.approx(0.9 * depth(PERFECT), rel=1e-6)
    noisy = Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.05)
    assert depth(noisy) == pytest.approx(depth(PERFECT), rel=0.05)
    assert depth(noisy) != depth(PERFECT)


def test_truth_is_drawn_from_the_seed_within_its_ranges() -> None:
    draws = [hidden_truth.draw(Truth(), seed) for seed in range(50)]
    assert hidden_truth.draw(Truth(), 7) == draws[7]
    assert all(0.9 <= draw.rate <= 1.0 for draw in draws)
    assert all(950.0 <= draw.accel_mm_s2 <= 1050.0 for draw in draws)
    assert all(0.0045 <= draw.overhead_s <= 0.0055 for draw in draws)
    assert len({draw.robot.limb_stiffness_n_per_mm for draw in draws}) == 50
    assert np.abs(draws[0].rate_at(np.arange(0.0, 6000.0, 50.0)) / draws[0].rate - 1.0).max() == pytest.approx(
        0.01, rel=0.05
    )


def test_timeline_without_a_device_rests() -> None:
    line = Timeline()
    assert line.at(np.array([1.0])).tolist() == [0.0]
    line.connect(1.0)
    assert line.mark_s == 1.0
    line.push([(1.5, 4.0), (2.0, 8.0)], 3.0)
    assert line.at(np.array([1.75, 2.5])).tolist() == [6.0, 8.0]
    line.disconnect(3.5)
    assert line.mark_s == math.inf
    assert line.at(np.array([3.4, 3.6])).tolist() == [8.0, 0.0]


def test_timeline_forgets_but_keeps_its_value() -> None:
    line = Timeline()
    line.push([(k / 100, float(k)) for k in range(1000)], 10.0)
    line.forget(9.0)
    assert len(line.times) < 200
    assert line.at(np.array([9.05])).tolist() == [905.0]


def test_the_witness_writes_in_the_order_of_events(tmp_path: Path) -> None:
    witness = SimEventLog(tmp_path / "sim.log")
    witness.clock(0.0, 0.0)
    witness.clock(10.0, 600.0)
    witness.add("robot", "motion_stopped", 5.0, detail="hold")
    witness.add("actuator", "force_zero", 4.0)
    witness.write(3.0)
    assert not witness.path.exists()
    witness.add("actuator", "tool_lifted", 4.5)
    witness.write(4.9)
    witness.write(9.0)
    lines = [json.loads(line) for line in witness.path.read_text().splitlines()]
    assert [line["event"] for line in lines] == ["force_zero", "tool_lifted", "motion_stopped"]
    assert [line["process_s"] for line in lines] == [240.0, 270.0, 300.0]


def test_a_program_loaded_again_goes_on_in_its_old_book(tmp_path: Path) -> None:
    plant = world()
    for _ in range(2):
        plant.account.load("ab", 3)
        plant.account.dwell("ab", np.array([1.0, 1.0]), np.array([0.25, 0.5]))
    plant.account.write(tmp_path, plant.part, 12.0, 7.0)
    account = json.loads((tmp_path / "dwell_account.json").read_text())
    assert account["programs"] == [{"sha256": "ab", "blocks": 3, "loads": 2, "contact_s": [0.0, 1.5, 0.0]}]
    assert account["process_s"] == 12.0
    held = np.load(tmp_path / "truth.npz")
    assert held["height_nm"].shape == plant.part.grid.shape
    assert not list(tmp_path.glob(".*"))


def test_what_leaving_contact_costs_is_booked_from_the_mark_on() -> None:
    plant = world()
    plant.stand_until(1.0)
    plant.integrate(1.0)
    plant.mark_way_out(1.0)
    plant.stand_until(1.5)
    plant.integrate(math.inf)
    way_out = plant.account.way_out
    assert way_out is not None
    costs = way_out.report()
    assert (costs["standing_s"], costs["contact_s"]) == (pytest.approx(0.5, abs=0.03), pytest.approx(0.5, abs=0.03))
    assert costs["standing_peak_nm"] == costs["peak_nm"] == pytest.approx(-plant.part.height_nm.min() / 3, rel=0.05)
