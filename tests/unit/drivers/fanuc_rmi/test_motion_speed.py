"""Slow motion from poses: what proves it, and what does not."""

from __future__ import annotations

import math

import pytest

from polishd.drivers.fanuc_rmi.motion_speed import LEAST_ACCEL_MM_S2, SLOW_SPANS, MotionSpeed, PoseTimes, StraightMove
from tests.unit.drivers.fanuc_rmi.test_program import read

POLL_S, TRIP_S = 0.04, 0.003
MOVE = StraightMove((0.0, 0.0, 0.0), (0.0, 3.0, 0.0), 20.0)


def times(asked_s: float, late_s: float = 0.0) -> PoseTimes:
    """Return the times of a pose that is reached at once."""
    return PoseTimes(asked_s, asked_s + late_s)


def travelled_mm(time_s: float, length_mm: float, speed_mm_s: float, accel_mm_s2: float) -> float:
    """From rest to rest."""
    speed_mm_s = min(speed_mm_s, math.sqrt(length_mm * accel_mm_s2))
    ramp_s = speed_mm_s / accel_mm_s2
    whole_s = length_mm / speed_mm_s + ramp_s
    time_s = min(max(time_s, 0.0), whole_s)
    if time_s > whole_s - ramp_s:
        return length_mm - accel_mm_s2 * (whole_s - time_s) ** 2 / 2
    return accel_mm_s2 * time_s**2 / 2 if time_s < ramp_s else speed_mm_s * (time_s - ramp_s / 2)


def after(
    move: StraightMove, count: int, share: float = 1.0, accel_mm_s2: float = 800.0, late_s: float = TRIP_S
) -> MotionSpeed:
    """The move, so often, from rest to rest, with all times stretched by an override."""
    found, phase_s = MotionSpeed(), 0.0
    found.add(-1, None, move.begin_mm, times(0.0))
    length_mm = math.dist(move.begin_mm, move.end_mm)
    for number in range(count):
        for poll in range(200):
            at_s = phase_s + poll * POLL_S
            way = travelled_mm(at_s * share, length_mm, move.speed_mm_s, accel_mm_s2) / length_mm
            x, y, z = (b + (e - b) * way for b, e in zip(move.begin_mm, move.end_mm, strict=True))
            found.add(number, move, (x, y, z), times(10.0 * number + at_s, late_s))
            if way >= 1.0:
                break
        phase_s = (phase_s + 0.011) % POLL_S
    return found


@pytest.mark.parametrize("move", [MOVE, StraightMove((1.0, 2.0, 3.0), (31.0, 2.0, 3.0), 5.0)])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.55])
def test_slow_motion_is_measured(move: StraightMove, share: float) -> None:
    measured = after(move, 8, share).share
    assert measured is not None
    assert share <= measured <= 1.5 * share


@pytest.mark.parametrize("accel_mm_s2", [LEAST_ACCEL_MM_S2, 800.0, 5000.0])
@pytest.mark.parametrize("length_mm", [0.3, 1.0, 3.0, 40.0])
@pytest.mark.parametrize("speed_mm_s", [2.0, 20.0, 100.0])
def test_full_speed_is_not_slow_whatever_the_acceleration(
    accel_mm_s2: float, length_mm: float, speed_mm_s: float
) -> None:
    move = StraightMove((0.0, 0.0, 0.0), (length_mm, 0.0, 0.0), speed_mm_s)
    assert after(move, 20, accel_mm_s2=accel_mm_s2).share is None


def test_late_answers_are_not_slow_motion() -> None:
    assert after(MOVE, 20, late_s=0.9 * POLL_S).share is None


def test_one_span_at_full_speed_begins_anew() -> None:
    found = after(MOVE, 8, 0.5)
    for number, position in ((98, 0.6), (98, 1.8), (98, 2.4), (99, 0.0)):
        found.add(number, MOVE, (0.0, position, 0.0), times(500.0 + position / 20.0))
    assert found.share is None


@pytest.mark.parametrize(
    ("aside_mm", "step", "interrupted", "slow"),
    [(0.0, 0, False, True), (0.5, 0, False, False), (0.0, 1, False, False), (0.0, 0, True, False)],
)
def test_poses_beside_the_line_across_moves_or_an_interruption_do_not_count(
    aside_mm: float, step: int, interrupted: bool, slow: bool
) -> None:
    long = StraightMove((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), 20.0)
    found = MotionSpeed()
    found.add(0, None, (0.0, 0.0, 0.0), times(0.0))
    for number in range(1, 3 * SLOW_SPANS):
        found.add(1 + number * step, long, (40.0 + number * 0.1, aside_mm, 0.0), times(1.0 * number))
        if interrupted:
            found.interrupt()
    assert (found.share is not None) == slow


def test_a_move_that_starts_in_its_middle_does_not_count() -> None:
    found = MotionSpeed()
    found.interrupt()
    for number in range(20):
        found.add(5, MOVE, (0.0, 1.5 + 0.01 * number, 0.0), times(0.3 * number))
    assert found.share is None


def test_moves_of_a_program_have_their_ends_and_speed() -> None:
    first, second, timed, back = read(
        "L P[1] 20mm/sec FINE ;", "L P[2] 20mm/sec FINE ;", "L P[3] 0.5sec CNT100 ;", "J P[1] 20% FINE ;"
    )
    assert first.move is None, "where it begins is not known"
    assert second.move == StraightMove((0.0, 0.0, 3.5), (10.0, 0.0, 3.5), 20.0)
    assert timed.move is not None
    assert timed.move.speed_mm_s == pytest.approx(20.0)
    assert back.move is None


def test_a_time_tag_counts_if_requests_and_answers_confirm_it() -> None:
    first = PoseTimes(10.0, 10.05, 1000)
    assert first.least_s_until(PoseTimes(10.2, 10.25, 1210)) == pytest.approx(0.21)
    assert first.least_s_until(PoseTimes(10.2, 10.25, 1100)) == pytest.approx(0.15), "another unit"
    assert first.least_s_until(PoseTimes(10.2, 10.25)) == pytest.approx(0.15)
