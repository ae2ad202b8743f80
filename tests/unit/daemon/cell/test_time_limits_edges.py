"""The chain of time limits in numbers, worked out by hand, and the very edge at which a limit holds."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from polishd.daemon.cell.time_limits import ActionTimeLimit, TimeLimits, released_within_s, safe_within_s, too_short
from polishd.model.devices import ActuatorTimes, LoaderTimes, RobotTimes, SpindleTimes

COIL = ActuatorTimes(silence_s=0.4, watchdog_s=2.0, landing_s=9.0, release_s=0.5, retract_s=4.0, stroke_mm=12.0)
ROBOT = RobotTimes(silence_s=1.25, watchdog_s=10.0, stop_s=6.0)
SPINDLE = SpindleTimes(silence_s=0.7, watchdog_s=1.5, spin_s=7.0)
LIMITS = TimeLimits(COIL, ROBOT, SPINDLE)


def test_each_link_of_the_chain() -> None:
    rows = [(limit.key, round(limit.seconds, 6), round(limit.least_s, 6)) for limit in LIMITS.chain(8.5)]
    assert rows == [
        ("actuator.silence_s", 0.4, 0.15),
        ("actuator.watchdog_s", 2.0, 0.55),  # silence and a heartbeat
        ("actuator.landing_s", 9.0, 0.0),
        ("actuator.release_s", 0.5, 0.0),
        ("actuator.retract_s", 4.0, 0.0),
        ("", 4.5, 0.0),  # up after an order
        ("", 6.5, 0.0),  # and after the last word
        ("spindle.watchdog_s", 1.5, 0.45),
        ("spindle.spin_s", 7.0, 0.0),
        ("robot.silence_s", 1.25, 0.0),
        ("robot.watchdog_s", 10.0, 6.5),  # longer than 1.25 + 4.5
        ("robot.stop_s", 6.0, 0.0),
        ("job.stream_ahead_s", 8.5, 6.5),
        ("", 25.5, 0.0),  # lift 7.5, a robot that lifts 9 instead, and stops 9
    ]


def test_what_the_daemon_makes_of_them() -> None:
    assert LIMITS.reading_s == pytest.approx(0.95)
    assert LIMITS.buffer_s == 6.5
    assert LIMITS.unseen_s == pytest.approx(1.25 + 2 * 0.95 + 2.0 + 0.2 + 6.5)
    assert LIMITS.lift_mm == 17.0
    assert LIMITS.safe_s == 25.5


def test_an_actuator_that_lifts_at_once_needs_nothing_of_the_robot_and_one_that_stays_does() -> None:
    quick = ActuatorTimes(silence_s=0.2, watchdog_s=0.3, release_s=0.1, retract_s=0.2)
    limits = TimeLimits(quick, ROBOT, SPINDLE)
    assert limits.buffer_s == limits.actuator.alone_s == pytest.approx(0.6)
    assert limits.unseen_s == pytest.approx(1.25 + 2 * 0.55 + 2.0 + 0.2 + 0.6)
    stays = TimeLimits(replace(quick, unpowered="stays"), ROBOT, SPINDLE)
    assert stays.buffer_s == pytest.approx(0.55 + 6.0)
    (taken_off,) = [limit for limit in stays.chain(8.5) if "lifted by the robot" in limit.what]
    assert (taken_off.key, taken_off.seconds) == ("", stays.buffer_s)


def test_the_slowest_way_counts_in_all_of_them() -> None:
    assert TimeLimits(COIL, RobotTimes(stop_s=0.5), SPINDLE).safe_s == pytest.approx(7.5 + 6.5 + 3.5)
    assert TimeLimits(COIL, ROBOT, SpindleTimes(spin_s=90.0)).safe_s == 93.0
    far = TimeLimits(COIL, RobotTimes(silence_s=5.0, watchdog_s=9.0), SPINDLE)
    assert [key for key, _ in too_short(far.chain(8.5))] == ["robot.watchdog_s"], "9.5 s from its silence on"


@pytest.mark.parametrize(
    ("times", "safe_s", "released_s"),
    [
        (COIL, 7.5, 9.5),
        (ROBOT, 9.0, 19.0),
        (RobotTimes(watchdog_s=math.inf), 8.0, 8.0),  # it has no watchdog: only its confirmation counts
        (SPINDLE, 10.0, 11.5),
        (LoaderTimes(stop_s=2.0), 5.0, 5.0),
        (None, 3.0, 3.0),
        (object(), 3.0, 3.0),
    ],
)
def test_how_long_a_device_is_waited_for(times: object, safe_s: float, released_s: float) -> None:
    assert (safe_within_s(times), released_within_s(times)) == (safe_s, released_s)


@pytest.mark.parametrize(
    ("seconds", "holds"), [(0.2, True), (0.2 - 5e-10, True), (0.2 - 2e-9, False), (math.inf, True)]
)
def test_exactly_so_long_is_long_enough(seconds: float, holds: bool) -> None:
    """Sums of times are not exact."""
    assert ActionTimeLimit("key", "what", seconds, 0.2).holds is holds


def test_a_row_is_json() -> None:
    row = ActionTimeLimit("a.b", "it lasts", 1.5, 0.5, "of that").row()
    assert row == {"key": "a.b", "what": "it lasts", "seconds": 1.5, "least_s": 0.5, "because": "of that"}
    assert ActionTimeLimit("", "never", math.inf).row() == {
        "key": "",
        "what": "never",
        "seconds": None,
        "least_s": 0.0,
        "because": "",
    }
