"""The chain of time limits: derived from what devices state, and refused where a watchdog is too short."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polishd.daemon.cell.time_limits import LOOK_S, TimeLimits, safe_within_s, stays_on, too_short
from polishd.model.devices import ActuatorTimes, RobotTimes, SensorTimes, SpindleTimes

IN_MS = {"watchdog_s": "watchdog_ms"}
LIMITS = TimeLimits(ActuatorTimes(), RobotTimes(), SpindleTimes())


def keys(limits: TimeLimits, stream_ahead_s: float = 8.0) -> list[str]:
    return [key for key, _ in too_short(limits.chain(stream_ahead_s))]


def test_the_shipped_times_hold() -> None:
    assert keys(LIMITS) == []


def test_the_tool_is_up_before_anything_stops_by_itself() -> None:
    coil = LIMITS.actuator
    assert coil.alone_s == coil.watchdog_s + coil.release_s + coil.retract_s == LIMITS.buffer_s
    assert LIMITS.robot.watchdog_s >= coil.alone_s
    assert safe_within_s(coil) > coil.lifted_s, "the daemon waits for longer than the lift takes"


def test_what_goes_unseen_is_what_each_may_be_late_by_and_then_the_lift() -> None:
    assert (
        pytest.approx(LIMITS.robot.silence_s + 2 * LIMITS.reading_s + 2.2 + LIMITS.actuator.alone_s) == LIMITS.unseen_s
    )


@pytest.mark.parametrize(
    ("changed", "stream_ahead_s", "expected"),
    [
        ({"robot": RobotTimes(watchdog_s=2.0)}, 8.0, ["robot.watchdog_s"]),
        ({"robot": RobotTimes(silence_s=3.0)}, 8.0, ["robot.watchdog_s"]),
        ({"robot": RobotTimes(watchdog_s=math.inf)}, 8.0, []),
        ({}, 1.0, ["job.stream_ahead_s"]),
        ({"actuator": ActuatorTimes(retract_s=12.0)}, 8.0, ["robot.watchdog_s", "job.stream_ahead_s"]),
        ({"actuator": ActuatorTimes(watchdog_s=0.3)}, 8.0, ["actuator.watchdog_s"]),
        (
            {"actuator": ActuatorTimes(watchdog_s=0.3, keys={"watchdog_s": "watchdog_ms"})},
            8.0,
            ["actuator.watchdog_ms"],
        ),
        ({"robot": RobotTimes(watchdog_s=2.0, keys={"watchdog_s": "profile"})}, 8.0, ["robot.profile"]),
        ({"actuator": ActuatorTimes(silence_s=0.1)}, 8.0, ["actuator.silence_s"]),
        ({"spindle": SpindleTimes(watchdog_s=0.2)}, 8.0, ["spindle.watchdog_s"]),
    ],
)
def test_what_is_shorter_than_what_it_guards_is_named(
    changed: dict[str, object], stream_ahead_s: float, expected: list[str]
) -> None:
    assert keys(replace(LIMITS, **changed), stream_ahead_s) == expected


def test_what_is_wrong_says_how_long_is_needed_and_why() -> None:
    (_, said), *_ = too_short(replace(LIMITS, robot=RobotTimes(watchdog_s=2.0)).chain(8.0))
    assert "watchdog of the robot: 2 s; at least 6.7 s until the tool is up" in said


def test_a_time_that_never_comes_is_json() -> None:
    chain = replace(LIMITS, robot=RobotTimes(watchdog_s=math.inf)).chain(8.0)
    assert {row["what"]: row["seconds"] for row in (limit.row() for limit in chain)}["watchdog of the robot"] is None


# a force sensor


@pytest.mark.parametrize(
    ("sensor", "apart_s", "force_s", "expected"),
    [
        (SensorTimes(), 0.5, 0.3, []),
        (SensorTimes(silence_s=0.1), 0.5, 0.3, ["force_sensor.silence_s"]),
        (SensorTimes(), 0.3, 0.3, ["force_sensor.alarm_delay_s"]),
        (SensorTimes(), 0.5, 0.2, ["limits.force_alarm_delay_s"]),
        (SensorTimes(delay_s=0.5), 0.5, 0.3, ["force_sensor.alarm_delay_s", "limits.force_alarm_delay_s"]),
    ],
)
def test_a_landing_must_not_look_like_a_disagreement(
    sensor: SensorTimes, apart_s: float, force_s: float, expected: list[str]
) -> None:
    chain = replace(LIMITS, sensor=sensor).chain(8.0, apart_s=apart_s, force_s=force_s)
    assert [key for key, _ in too_short(chain)] == expected


def test_a_cell_without_a_sensor_has_no_limits_of_it() -> None:
    assert not [limit for limit in LIMITS.chain(8.0) if limit.key.startswith("force_sensor")]


# without power

STAYS = ActuatorTimes(unpowered="stays")


def test_a_tool_that_stays_is_taken_off_by_the_robot_while_it_still_moves() -> None:
    limits = replace(LIMITS, actuator=STAYS, robot=RobotTimes(stop_s=7.0))
    assert limits.buffer_s == limits.taken_off_s == limits.reading_s + 7.0
    assert keys(limits, 7.7) == ["job.stream_ahead_s"]
    assert keys(limits, 7.8) == []
    assert keys(replace(limits, actuator=ActuatorTimes()), 7.7) == [], "one that lifts needs no robot for it"
    whats = [limit.what for limit in limits.chain(8.0)]
    assert "tool lifted by the robot if the actuator has no power" in whats


def test_a_tool_that_stays_may_touch_until_the_robot_stops_by_itself() -> None:
    alone_s = LIMITS.actuator.alone_s
    assert replace(LIMITS, actuator=STAYS).unseen_s - LIMITS.unseen_s == pytest.approx(8.0 + 5.0 - alone_s)


@pytest.mark.parametrize(
    ("unpowered", "lifts", "why"),
    [
        ("lifts", False, ""),
        ("stays", True, ""),
        ("stays", False, "needs a robot that lifts it, and the job's robot cannot"),
        ("presses", True, "an actuator that presses without power is refused"),
    ],
)
def test_what_an_actuator_does_without_power(unpowered: Any, lifts: bool, why: str) -> None:
    found = stays_on(ActuatorTimes(unpowered=unpowered), RobotTimes(lifts=lifts))
    assert bool(found) is bool(why)
    assert why in found


# a robot that holds few instructions

EIGHT = replace(LIMITS, robot=RobotTimes(held_instructions=8, report_s=0.05))


@pytest.mark.parametrize(("encoding", "points"), [("feed", 7), ("dwell", 3)])
def test_the_instructions_beyond_the_one_under_way_last_until_the_tool_is_up(encoding: str, points: int) -> None:
    needed_s = EIGHT.buffer_s + 0.05
    time_s = np.full(20, needed_s / points)
    enough, short = EIGHT.held_motion(encoding, time_s), EIGHT.held_motion(encoding, 0.99 * time_s)
    assert enough is not None
    assert short is not None
    assert (enough.holds, short.holds) == (True, False)
    assert short.key == "machine.least_point_s"
    time_s[10] -= 0.1
    worst = EIGHT.held_motion(encoding, time_s)
    assert worst is not None
    assert worst.seconds == pytest.approx(needed_s - 0.1, abs=1e-3), "the shortest of all stretches counts"


def test_a_robot_that_holds_enough_has_no_such_limit() -> None:
    assert LIMITS.held_motion("feed", np.full(20, 0.01)) is None


def test_the_end_of_a_block_may_be_off_by_three_standard_deviations() -> None:
    limits = replace(LIMITS, robot=RobotTimes(block_end_s=0.01))
    assert limits.end_blur_s == pytest.approx(0.03)
    assert limits.no_progress_s == pytest.approx(limits.robot.report_s + 0.03 + 2 * LOOK_S)


@pytest.mark.parametrize(("limits", "more"), [(LIMITS, ""), (EIGHT, ", twice the motion in its instructions ")])
def test_its_watchdog_waits_for_what_lifts_the_tool(limits: TimeLimits, more: str) -> None:
    (watchdog,) = [row for row in limits.chain(8.0) if row.what == "watchdog of the robot"]
    coil, robot = limits.actuator, limits.robot
    expected = (
        f"until the tool is up: actuator's watchdog and lift {coil.alone_s:g} s, "
        f"robot's silence and lift {robot.silence_s + coil.lifted_s:g} s"
    )
    assert watchdog.because == expected + (f"{more}{2 * limits.held_motion_s:g} s" if more else "")
