"""The simulated Universal Robots controller: its language, its arm, its modes. Frame by frame, without a clock."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.sim_backends.common.hidden_truth import tool_axis
from polishd.sim_backends.universal_robots import arm as m
from polishd.sim_backends.universal_robots.arm import (
    UrArm,
    after,
    angle,
    between,
    from_vector,
    from_wrist,
    to_vector,
    turned,
    wrist_deg,
)
from polishd.sim_backends.universal_robots.controller import UrController
from polishd.sim_backends.universal_robots.device import ScriptIntake
from polishd.sim_backends.universal_robots.urscript import parse

FRAME_S = 0.002
DOWN = "3.14159265, 0, 0"


def machine(overhead_s: float = 0.0) -> UrController:
    return UrController(SimRobotSection(), UrArm.at((0.0, 0.0, 60.0, 0.0, 0.0)), FRAME_S, overhead_s, 1.0, 0.0)


def run(found: UrController, body: str, most_s: float = 20.0) -> list[tuple[int, str]]:
    """To its end; what it had to complain of."""
    said: list[tuple[int, str]] = []
    found.complain = lambda line, text: said.append((line, text))
    found.load(f"def test():\n{body}\nend")
    frames = 0
    while found.runtime != m.STOPPED and frames < most_s / FRAME_S:
        found.frame()
        frames += 1
    return said


def pose(x_mm: float, y_mm: float = 0.0, z_mm: float = 60.0) -> str:
    return f"p[{x_mm / 1000}, {y_mm / 1000}, {z_mm / 1000}, {DOWN}]"


def test_a_line_takes_what_its_trapezoid_says_and_ends_where_it_should() -> None:
    found = machine()
    assert run(found, f"movel({pose(20)}, a=1.0, v=0.1)") == []
    assert found.arm.place.xyz_mm == pytest.approx((20.0, 0.0, 60.0))
    assert sum(row[3] for row in found.rows) == pytest.approx(0.1 / 1.0 + 0.02 / 0.1, abs=2 * FRAME_S)
    assert max(abs(b[4] - a[4]) / FRAME_S for a, b in pairwise(found.rows)) <= 100.0 + 1e-6


def test_a_wait_takes_whole_frames_and_each_block_its_overhead() -> None:
    found = machine(overhead_s=0.005)
    run(found, "sleep(0.0991)\n" * 10)
    assert sum(row[3] for row in found.rows) == pytest.approx(10 * (0.1 + 0.005), abs=2 * FRAME_S)


def test_a_blend_does_not_stop_and_cuts_the_corner() -> None:
    ends = f"movel({pose(20)}, a=1, v=0.05, r=0.005)\nmovel({pose(20, 20)}, a=1, v=0.05)"
    found = machine()
    run(found, ends)
    assert found.arm.place.xyz_mm == pytest.approx((20.0, 20.0, 60.0))
    speeds = [math.dist(a[4:7], b[4:7]) / FRAME_S for a, b in pairwise(found.rows)]
    assert min(speeds[60:-60]) > 10.0
    assert min(math.dist(row[4:6], (20.0, 0.0)) for row in found.rows) > 0.3
    stops = machine()
    run(stops, ends.replace(", r=0.005", ""))
    assert min(math.dist(row[4:6], (20.0, 0.0)) for row in stops.rows) < 0.01


def test_blended_moves_straight_on_take_their_times_and_keep_the_speed() -> None:
    """Ten moves of 1 mm in 66 ms, which is no whole number of frames."""
    found = machine()
    run(found, "\n".join(f"movel({pose(at)}, a=1.2, t=0.066, r=0.0002)" for at in range(1, 11)))
    speeds = [math.dist(a[4:7], b[4:7]) / FRAME_S for a, b in pairwise(found.rows)]
    assert max(speeds) == pytest.approx(1.0 / 0.066, rel=1e-3)
    assert min(speeds[20:-20]) == pytest.approx(1.0 / 0.066, rel=1e-3)
    assert sum(row[3] for row in found.rows) == pytest.approx(10 * 0.066 + 0.0126, abs=2 * FRAME_S)


def test_threads_run_side_by_side_and_a_killed_one_lets_the_arm_brake() -> None:
    found = machine()
    body = f"""thread go():
  movel({pose(100)}, a=1, v=0.1)
end
h = run go()
sleep(0.5)
kill h
sleep(0.3)
write_output_integer_register(3, 7)"""
    assert run(found, body) == []
    assert found.ints_out[3] == 7
    assert 40.0 < found.arm.place.xyz_mm[0] < 60.0
    assert not found.arm.moves


def test_branches_loops_and_globals() -> None:
    body = """global n = 0
def add(k):
  if k < 0:
    n = n - k
  elif k == 0:
    n = n + 100
  else:
    n = n + k
  end
end
i = -2
while i <= 2 and not (i == 2):
  add(i)
  i = i + 1
end
write_output_integer_register(0, n)
write_output_float_register(1, sqrt(norm([9, 12, 20]) / 25 * 4))"""
    found = machine()
    assert run(found, body) == []
    assert found.ints_out[0] == 2 + 1 + 100 + 1
    assert found.doubles_out[1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("body", "line", "said"),
    [
        ("moveq(1)", 2, "name 'moveq' is not defined"),
        ("x = = 2", 2, "syntax error"),
        ("sync()\n?what", 3, "syntax error"),
        ("x = y", 2, "name 'y' is not defined"),
        ("movel(p[1, 2, 3], a=1, v=1)", 2, "six numbers"),
        ("while True:\n  x = 1\nend", 2, "infinite loop"),
        ("x = 1 / 0", 2, "division"),
        ("elif True:", 2, "elif without if"),
        ("x = [i for i in [1]]", 2, "syntax error"),
        ("x = ().__class__", 2, "syntax error"),
    ],
)
def test_what_it_cannot_run_is_complained_of_with_its_line(body: str, line: int, said: str) -> None:
    found = machine()
    ((where, text),) = run(found, body)
    assert (where, said in text) == (line, True), text
    assert found.runtime == m.STOPPED


def test_a_script_that_breaks_off_is_none() -> None:
    with pytest.raises(ProgramError, match="breaks off"):
        parse("def test():\n  sync()")


def test_a_watchdog_stops_a_program_that_hears_nothing() -> None:
    found = machine()
    found.load('def t():\n  rtde_set_watchdog("input_int_register_24", 10, "stop")\n  sleep(5)\nend')
    for frame in range(400):
        if frame < 200 and frame % 20 == 0:
            found.written("input_int_register_24")
        found.frame()
    assert found.runtime == m.STOPPED
    assert sum(row[3] for row in found.rows) == pytest.approx(0.36 + 0.1, abs=0.01), "last received at 0.36 s"


def test_a_pause_stands_on_the_path_and_play_goes_on() -> None:
    found = machine()
    found.load(f"def t():\n  movel({pose(50)}, a=1, v=0.05)\nend")
    for _ in range(200):
        found.frame()
    assert found.pause()
    for _ in range(100):
        found.frame()
    assert found.runtime == m.PAUSED
    assert not found.arm.moves
    stood = found.arm.place.xyz_mm
    for _ in range(50):
        found.frame()
    assert found.arm.place.xyz_mm == stood
    assert found.play()
    for _ in range(1000):
        found.frame()
    assert found.arm.place.xyz_mm[0] == pytest.approx(50.0)
    assert found.runtime == m.STOPPED


def test_a_script_that_comes_while_one_is_paused_only_stops_that() -> None:
    found = machine()
    found.load("def a():\n  sleep(5)\nend")
    found.frame()
    found.pause()
    for _ in range(100):
        found.frame()
    found.load("def b():\n  write_output_integer_register(1, 1)\nend")
    for _ in range(10):
        found.frame()
    assert (found.runtime, found.ints_out[1]) == (m.STOPPED, 0)
    found.load("def b():\n  write_output_integer_register(1, 1)\nend")
    found.frame()
    assert found.ints_out[1] == 1


def test_beyond_its_ranges_it_stops_and_waits_for_an_operator() -> None:
    found = machine()
    found.load(f"def t():\n  movel({pose(900)}, a=2, v=0.1)\nend")
    for _ in range(1500):
        found.frame()
    assert found.safety_mode == m.PROTECTIVE_STOP
    assert found.runtime == m.PAUSED
    assert not found.play()
    x = found.arm.place.xyz_mm[0]
    assert SimRobotSection().x_mm[1] < x < SimRobotSection().x_mm[1] + 10.0
    found.unlock()
    assert found.safety_mode == m.NORMAL


def test_the_slider_slows_motion_and_no_wait() -> None:
    full, half = machine(), machine()
    half.slider = 0.5
    for found in (full, half):
        run(found, f"movel({pose(10)}, a=1, v=0.05)\nwrite_output_integer_register(25, 1)\nsleep(0.2)")
    took = [[sum(row[3] for row in found.rows if row[0] == seq) for seq in (0, 1)] for found in (full, half)]
    assert took[1][0] == pytest.approx(2 * took[0][0], rel=0.02)
    assert took[1][1] == pytest.approx(took[0][1], abs=2 * FRAME_S)


def test_scripts_are_cut_at_their_last_end() -> None:
    found: list[str] = []
    intake = ScriptIntake(found.append)
    text = "# old\nset_digital_out(1, True)\ndef a():\n  if x:\n    sync()\n  end\nend\ndef b():\nend\n"
    for char in text:
        intake.feed(char.encode())
    assert [part.splitlines()[0] for part in found] == ["def a():", "def b():"]


@pytest.mark.parametrize("wrist", [(0.0, 0.0), (15.0, 40.0), (22.0, -170.0), (60.0, 90.0)])
def test_orientations_mean_the_plants_a_and_c(wrist: tuple[float, float]) -> None:
    turn = from_wrist(*wrist)
    assert wrist_deg(turn) == pytest.approx(wrist, abs=1e-9)
    axis = tool_axis(*(np.array([part]) for part in wrist))[0]
    assert [-part for part in turned(turn, (0.0, 0.0, 1.0))] == pytest.approx(axis.tolist())
    again = from_vector(to_vector(turn))
    assert angle(turn, again) == pytest.approx(0.0, abs=1e-6)
    halfway = between(turn, after(from_vector((0.0, 0.0, 0.4)), turn), 0.5)
    assert angle(turn, halfway) == pytest.approx(0.2, abs=1e-6)


LONG = "def t():\n" + "\n".join(f"  movel({pose(k % 100)}, a=1, v=0.1)" for k in range(2000)) + "\nend"


@pytest.mark.full
def test_a_long_script_is_read_a_few_statements_at_a_turn() -> None:
    found, turns = machine(), 0
    for _ in found.loading(LONG):
        turns += 1
        found.frame()
        assert (found.program, found.runtime) == (None, m.STOPPED), "all of it or nothing"
    assert turns > 100
    assert found.runtime == m.PLAYING


@pytest.mark.parametrize("event", ["stop", "emergency_stop", "power_off", "protective_stop"])
def test_a_script_on_its_way_in_is_forgotten_when_the_robot_is_stopped(event: str) -> None:
    found = machine()
    loading = found.loading(LONG)
    next(loading)
    getattr(found, event)()
    assert list(loading) != []
    assert (found.program, found.runtime) == (None, m.STOPPED)
