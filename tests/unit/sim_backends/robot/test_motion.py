"""Execution: time, place, holds and stops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.program_reader import Reader
from polishd.sim_backends.robot.trajectory import Limits

HOME = (0.0, 0.0, 50.0, 0.0, 0.0)
PERFECT = {"accel_mm_s2": 1000.0, "overhead_s": 0.0, "corner_deg": 30.0, "rapid_mm_s": 100.0, "max_feed_mm_s": 100.0}


def loaded(
    lines: list[Any], *, blocks: int | None = None, until: int | None = None, start: bool = True, **limits: Any
) -> SimMotion:
    """A motion with these blocks, started at wall time 0."""
    reader = Reader(HOME)
    motion = SimMotion(Limits(**{**PERFECT, "speed": 1.0, **limits}), HOME)
    motion.load(blocks or len(lines))
    motion.append(0.0, [reader.read(line.encode()) for line in lines])
    if start:
        motion.resume(0.0, until)
    return motion


def run(motion: SimMotion, until_s: float = 1000.0, step_s: float = 0.01) -> np.ndarray:
    """Run in ticks; all rows of motion."""
    wall = 0.0
    while motion.state == "running" and wall < until_s:
        wall += step_s
        motion.advance(wall)
    return np.concatenate(motion.rows) if motion.rows else np.zeros((0, 9))


LINE = ["G1 X10 F600", "X20", "X30"]


def test_blocks_follow_each_other_without_a_gap() -> None:
    motion = loaded(LINE)
    rows = run(motion)
    assert motion.state == "done"
    assert [seq for seq, _, _ in motion.executed] == [0, 1, 2]
    assert motion.executed[0][1] == 0.0
    assert [end for _, _, end in motion.executed[:-1]] == [start for _, start, _ in motion.executed[1:]]
    assert motion.executed[-1][2] == pytest.approx(30.0 / 10.0 + 10.0 / 1000.0)
    assert rows[:, 3].sum() == pytest.approx(motion.executed[-1][2])
    assert np.allclose(rows[1:, 1], rows[:-1, 2])


@pytest.mark.full
def test_time_in_rows_is_time_in_blocks() -> None:
    motion = loaded([f"G1 X{k % 7} Y{k / 3:.3f} F{300 + 40 * (k % 5)}" for k in range(200)], overhead_s=0.005)
    rows = run(motion)
    spans = {seq: end - start for seq, start, end in motion.executed}
    for seq, span in spans.items():
        assert rows[rows[:, 0] == seq, 3].sum() == pytest.approx(span, abs=1e-9)


def test_steps_are_fine() -> None:
    rows = run(loaded(["G1 X40 F5000", "G4 P1", "X41 F6"]), step_s=0.5)
    assert np.abs(np.diff(rows[:, 4])).max() <= 0.2501
    assert rows[:, 3].max() <= 0.0501


def test_each_block_pays_its_overhead() -> None:
    free, paid = loaded(LINE), loaded(LINE, overhead_s=0.005)
    run(free)
    run(paid)
    assert paid.executed[-1][2] - free.executed[-1][2] == pytest.approx(0.015)


def test_corners_stop_and_gentle_bends_do_not() -> None:
    sharp, gentle = loaded(["G1 X10 F600", "Y10"]), loaded(["G1 X10 F600", "X20 Y5"])
    run(sharp)
    run(gentle)
    assert sharp.executed[0][2] == pytest.approx(1.01)
    assert gentle.executed[0][2] == pytest.approx(1.005)


def test_dwell_stands_still() -> None:
    motion = loaded(["G1 X1 F600", "G4 P0.3", "X2"])
    rows = run(motion)
    standing = rows[rows[:, 0] == 1]
    assert standing[:, 3].sum() == pytest.approx(0.3)
    assert np.allclose(standing[:, 4], 1.0)


def test_inverse_time_takes_its_time() -> None:
    motion = loaded(["G93", "G1 X1 F60", "X2 F60", "X3 F60"])
    run(motion)
    assert motion.executed[2][2] - motion.executed[2][1] == pytest.approx(1.0)


def test_blocks_without_motion_take_no_time() -> None:
    motion = loaded(["G21", "(comment)", "G1 X1 F600", "", "M2"], overhead_s=0.005)
    run(motion)
    assert motion.state == "done"
    assert [round(end - start, 4) for _, start, end in motion.executed] == [0.0, 0.0, 0.115, 0.0, 0.0]


def test_speed_scales_process_time_only() -> None:
    motion = loaded(LINE, speed=60.0)
    rows = run(motion, step_s=0.001)
    assert motion.process_s == pytest.approx(3.01)
    assert rows[-1, 2] == pytest.approx(3.01 / 60.0)
    assert motion.changed_s == pytest.approx(3.01 / 60.0)


def test_until_comes_to_a_stop_between_blocks() -> None:
    motion = loaded(LINE, until=2)
    run(motion)
    assert (motion.state, motion.detail) == ("held", "until")
    assert len(motion.executed) == 2
    assert motion.pose[0] == 20.0
    assert motion.executed[-1][2] == pytest.approx(2.01)
    motion.resume(50.0, None)
    motion.advance(100.0)
    assert motion.state == "done"
    assert motion.executed[2][1:] == (pytest.approx(2.01), pytest.approx(3.02))


def test_hold_decelerates_inside_a_block_and_resume_finishes_it() -> None:
    motion = loaded(LINE)
    motion.hold(1.5, "hold")
    assert motion.state == "running"
    motion.advance(1.6)
    assert (motion.state, motion.detail) == ("held", "hold")
    assert motion.changed_s == pytest.approx(1.51)
    assert len(motion.executed) == 1
    assert motion.pose[0] == pytest.approx((1.5 - 0.005) * 10.0 + 0.05)
    motion.resume(10.0, None)
    motion.advance(20.0)
    assert [seq for seq, _, _ in motion.executed] == [0, 1, 2]
    rows = np.concatenate(motion.rows)
    assert np.abs(np.diff(rows[:, 4])).max() <= 0.2501
    assert rows[-1, 4] == pytest.approx(30.0, abs=0.3)


def test_hold_may_run_over_several_blocks() -> None:
    motion = loaded([f"G1 X{k / 10:.1f} F6000" for k in range(1, 300)])
    motion.advance(0.2)
    before = len(motion.executed)
    motion.hold(0.2, "hold")
    motion.advance(0.4)
    assert motion.state == "held"
    assert len(motion.executed) >= before + 40
    assert motion.pose[0] == pytest.approx(20.0, abs=0.2)


def test_hold_in_a_dwell_keeps_what_is_left() -> None:
    motion = loaded(["G4 P1", "G1 X1 F600"])
    motion.hold(0.25, "hold")
    motion.advance(0.25)
    assert motion.state == "held"
    motion.resume(5.0, None)
    motion.advance(5.7)
    assert motion.executed == []
    motion.advance(5.76)
    assert motion.executed[0] == (0, 0.0, pytest.approx(1.0))


@pytest.mark.parametrize("at_s", np.linspace(0.05, 3.0, 14))
def test_no_hold_loses_or_repeats_anything(at_s: float) -> None:
    motion = loaded(["G1 X10 F600", "G4 P0.5", "X10.5 Y4", "(note)", "X12 Y9", "G4 P0.2", "M2"], overhead_s=0.005)
    motion.hold(at_s, "hold")
    motion.advance(at_s + 1.0)
    motion.resume(10.0, None)
    motion.advance(100.0)
    assert motion.state == "done"
    assert [seq for seq, _, _ in motion.executed] == list(range(7))
    rows = np.concatenate(motion.rows)
    assert rows[rows[:, 0] == 1, 3].sum() == pytest.approx(0.505)
    assert motion.pose[:2] == (12.0, 9.0)


def test_an_empty_buffer_is_an_underrun() -> None:
    motion = loaded(LINE, blocks=10)
    run(motion)
    assert (motion.state, motion.detail) == ("held", "underrun")
    assert len(motion.executed) == 3


def test_appending_in_time_leaves_no_trace() -> None:
    lines = [f"G1 X{k} F{600 + 60 * (k % 3)}" for k in range(1, 60)]
    whole = loaded(lines)
    run(whole)
    pieces = loaded(lines[:20], blocks=len(lines))
    reader = Reader(HOME)
    blocks = [reader.read(line.encode()) for line in lines]
    for k in range(20, len(lines), 7):
        pieces.append(0.05 * k / 20, blocks[k : k + 7])
    run(pieces)
    assert np.allclose(np.array(pieces.executed), np.array(whole.executed), atol=1e-9)


def test_pause_waits_for_resume() -> None:
    motion = loaded(["G1 X1 F600", "M0", "X2"])
    run(motion)
    assert (motion.state, motion.detail, len(motion.executed)) == ("held", "pause", 2)
    motion.resume(10.0, None)
    motion.advance(20.0)
    assert motion.state == "done"


def test_rapid_runs_at_the_machines_own_speed_and_rotation_alone_is_a_move() -> None:
    motion = loaded(["G0 X100", "G1 A30 F600"])
    run(motion)
    assert motion.executed[0][2] == pytest.approx(1.1)
    assert motion.pose[3] == 30.0
    assert motion.executed[1][2] - motion.executed[1][1] == pytest.approx(3.01)


def test_the_buffer_is_reported_in_wall_seconds() -> None:
    motion = loaded(LINE, speed=10.0, start=False)
    assert motion.ahead_s == pytest.approx(0.301)
    motion.resume(0.0, None)
    motion.advance(0.1)
    assert motion.ahead_s == pytest.approx(0.201)


def test_the_process_clock_stands_while_the_robot_does() -> None:
    motion = loaded(LINE, until=1)
    run(motion)
    stopped = motion.process_s
    motion.advance(500.0)
    assert motion.process_s == stopped


def test_load_forgets() -> None:
    motion = loaded(LINE)
    run(motion)
    motion.load(2)
    assert (motion.state, motion.accepted, motion.executed) == ("held", 0, [])
    assert motion.path.pose[0, 0] == 30.0
