"""The way out where the actuator does not lift: the robot leaves the path along the tool's axis, and never stands."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common.hidden_truth import tool_axis
from polishd.sim_backends.robot.motion import Lift, SimMotion
from polishd.sim_backends.robot.trajectory import Limits
from tests.unit.sim_backends.robot.test_controller import Bench, kinds, naks
from tests.unit.sim_backends.robot.test_motion import HOME, PERFECT, loaded, run

PATH = ["G1 X0 Y0 Z0 A15 C30 F6000", "X20 F1200", "X40"]


def lifted(at_s: float, distance_mm: float = 15.0) -> tuple[np.ndarray, float]:
    """All rows of a run with a lift at that time, and its process time."""
    motion = loaded(PATH)
    wall = 0.0
    while wall < at_s:
        wall += 0.01
        motion.advance(wall)
    reported_s = motion.process_s
    motion.lift(wall, distance_mm)
    while motion.state == "running":
        wall += 0.01
        motion.advance(wall)
    assert (motion.state, motion.detail, motion.lifted) == ("held", "lift", True)
    return np.concatenate(motion.rows), reported_s


def test_it_goes_along_the_tools_axis_while_it_still_brakes() -> None:
    rows, reported_s = lifted(1.2)
    after = rows[rows[:, 1] > reported_s]
    axis = tool_axis(np.array([15.0]), np.array([30.0]))[0]
    off = after[-1, 4:7] @ axis - after[0, 4:7] @ axis
    assert off == pytest.approx(15.0, abs=0.3), "and the little that it brakes"
    moved = np.linalg.norm(np.diff(after[:, 4:7], axis=0), axis=1)
    assert (moved > 0.0).all(), "the tool never stands before it is off"
    assert np.allclose(after[1:, 1], after[:-1, 2]), "without a gap in time"


def test_who_looks_late_books_the_lift_to_the_block_that_it_stands_in() -> None:
    motion = loaded([PATH[0], *(f"X{x} F1200" if x == 1 else f"X{x}" for x in range(1, 30))])
    motion.advance(0.905)
    before = len(motion.rows)
    motion.lift(0.905, 15.0)
    motion.advance(2.0)  # over the end of a block, to a stand in the next one, in one step
    blocks = np.concatenate(motion.rows[before:])[:, 0]
    assert len(np.unique(blocks)) == 2
    assert (np.diff(blocks) >= 0).all()


def test_a_block_that_is_done_as_the_path_ends_has_no_more_than_its_own_time() -> None:
    motion = loaded([PATH[0], "X20 F1200", "Y20", "X0"])
    wall = 0.0
    while motion._cursor.block == 0 or motion._cursor.done_mm < 19.85:  # it brakes for the corner
        motion.advance(wall := wall + 0.001)
    motion.lift(wall, 15.0)
    motion.advance(wall + 1.0)
    rows = np.concatenate(motion.rows)
    done = {seq: until_s - from_s for seq, from_s, until_s in motion.executed}
    assert sorted(done) == [0, 1], "braking ends where the corner is"
    booked = {seq: rows[rows[:, 0] == seq, 3].sum() for seq in (0, 1, 2)}
    assert [booked[0], booked[1]] == pytest.approx([done[0], done[1]], abs=1e-9)
    assert booked[2] > 0.1, "the lift belongs to the next block, which is not executed"


def test_it_is_off_within_a_tenth_of_a_second() -> None:
    lift = Lift(0.0, 15.0, 1000.0, 100.0)
    assert lift.offset_mm(np.array([0.1]))[0] == pytest.approx(5.0)
    assert lift.end_s == pytest.approx(0.25)
    assert lift.offset_mm(np.array([0.25, 9.0])) == pytest.approx([15.0, 15.0])


def test_a_short_lift_never_reaches_full_speed() -> None:
    lift = Lift(1.0, 4.0, 1000.0, 100.0)
    assert lift.offset_mm(np.array([lift.end_s]))[0] == pytest.approx(4.0)
    assert lift.end_s == pytest.approx(1.0 + 2 * np.sqrt(4.0 / 1000.0))


def test_a_robot_that_stands_lifts_from_there() -> None:
    motion = loaded(PATH, until=1)
    run(motion)
    assert motion.state == "held"
    motion.lift(100.0, 10.0)
    motion.advance(101.0)
    axis = tool_axis(np.array([15.0]), np.array([30.0]))[0]
    assert motion.pose[:3] == pytest.approx(tuple(10.0 * axis))
    assert motion.pose[3:] == (15.0, 30.0)


def test_without_a_program_it_lifts_too() -> None:
    motion = SimMotion(Limits(**PERFECT, speed=1.0), HOME)
    motion.lift(1.0, 10.0)
    motion.advance(2.0)
    assert motion.pose[2] == pytest.approx(HOME[2] + 10.0)


def test_the_controller_answers_once_it_stands_and_wants_a_new_program() -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.resume(client)
    bench.until(0.5, client)
    got.clear()
    bench.say(client, f.LIFT, {"distance_mm": 15.0})
    assert f.ACK not in kinds(got)
    bench.until(2.0, client)
    assert f.ACK in kinds(got)
    status = bench.controller.status()
    assert (status["state"], status["detail"]) == ("held", "lift")
    bench.resume(client)
    assert naks(got) == [(f.RESUME, "no_program")]
    bench.load(client)
    assert bench.controller.status()["detail"] == "loaded"


@pytest.mark.parametrize("distance", [0, -1.0, 501.0, "15", None])
def test_nonsense_is_refused(distance: object) -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.say(client, f.LIFT, {"distance_mm": distance})
    assert naks(got) == [(f.LIFT, "protocol")]
    assert not bench.controller.motion.lifted


def test_a_reader_may_not_lift() -> None:
    bench = Bench()
    bench.loaded()
    reader, got = bench.client("reader")
    bench.say(reader, f.LIFT, {"distance_mm": 15.0})
    assert naks(got) == [(f.LIFT, "reader")]


def test_nothing_moves_after_an_emergency_stop() -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.resume(client)
    bench.until(0.5, client)
    bench.controller.press("emergency stop", bench.now)
    bench.until(1.0, client)
    assert (bench.controller.status()["state"], bench.controller.motion.state) == ("fault", "held")
    bench.say(client, f.LIFT, {"distance_mm": 15.0})
    bench.resume(client)
    assert naks(got)[0] == (f.LIFT, "fault")
    assert len(naks(got)) == 2
