"""The chain of time limits: derived from what devices state, and refused where a watchdog is too short."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from polishd.daemon.time_limits import TimeLimits, safe_within_s, too_short
from polishd.model.times import ActuatorTimes, RobotTimes, SpindleTimes

LIMITS = TimeLimits(ActuatorTimes(), RobotTimes(), SpindleTimes())


def keys(limits: TimeLimits, lookahead_s: float = 8.0) -> list[str]:
    return [key for key, _ in too_short(limits.chain(lookahead_s))]


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
    ("changed", "lookahead_s", "expected"),
    [
        ({"robot": RobotTimes(watchdog_s=2.0)}, 8.0, ["robot.watchdog_s"]),
        ({"robot": RobotTimes(silence_s=3.0)}, 8.0, ["robot.watchdog_s"]),
        ({"robot": RobotTimes(watchdog_s=math.inf)}, 8.0, []),
        ({}, 1.0, ["job.lookahead_s"]),
        ({"actuator": ActuatorTimes(retract_s=12.0)}, 8.0, ["robot.watchdog_s", "job.lookahead_s"]),
        ({"actuator": ActuatorTimes(watchdog_s=0.3)}, 8.0, ["actuator.watchdog_ms"]),
        ({"actuator": ActuatorTimes(silence_s=0.1)}, 8.0, ["actuator.silence_s"]),
        ({"spindle": SpindleTimes(watchdog_s=0.2)}, 8.0, ["spindle.watchdog_s"]),
    ],
)
def test_what_is_shorter_than_what_it_guards_is_named(
    changed: dict[str, object], lookahead_s: float, expected: list[str]
) -> None:
    assert keys(replace(LIMITS, **changed), lookahead_s) == expected


def test_what_is_wrong_says_how_long_is_needed_and_why() -> None:
    (_, said), *_ = too_short(replace(LIMITS, robot=RobotTimes(watchdog_s=2.0)).chain(8.0))
    assert "robot stops by itself: 2 s; at least 6.7 s until the tool is up" in said


def test_a_time_that_never_comes_is_json() -> None:
    chain = replace(LIMITS, robot=RobotTimes(watchdog_s=math.inf)).chain(8.0)
    assert {row["what"]: row["seconds"] for row in (limit.row() for limit in chain)}["robot stops by itself"] is None
