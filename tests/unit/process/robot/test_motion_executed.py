"""Executed time of timed points: each block counts once, for the point that it leads to."""

from __future__ import annotations

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from polishd.process.robot.motion import clock_rate, executed_s, last_reachable_block


def test_a_block_that_carries_time_is_its_points_own() -> None:
    found = executed_s(np.array([2, 3, 4]), np.array([2, 3, 4]), np.array([1.0, 2.0, 4.0]))
    assert found.tolist() == [1.0, 2.0, 4.0]


def test_the_move_that_leads_to_a_dwell_counts_for_it() -> None:
    found = executed_s(np.array([3, 6]), np.array([3, 5, 6]), np.array([1.5, 0.25, 2.25]))
    assert found.tolist() == [1.5, 2.5]


def test_pieces_of_one_block_are_summed() -> None:
    assert executed_s(np.array([1]), np.array([1, 1]), np.array([0.5, 0.25])).tolist() == [0.75]


def test_what_was_not_run_has_no_time() -> None:
    assert executed_s(np.array([1, 2]), np.zeros(0, dtype=np.int64), np.zeros(0)).tolist() == [0.0, 0.0]
    assert executed_s(np.array([1, 2]), np.array([1]), np.array([3.0])).tolist() == [3.0, 0.0]


def test_what_follows_the_last_point_counts_for_none() -> None:
    assert executed_s(np.array([1]), np.array([1, 2, 9]), np.array([1.0, 5.0, 5.0])).tolist() == [1.0]


@hypothesis.given(st.data())
def test_no_time_is_lost_up_to_the_last_point(data: st.DataObject) -> None:
    block = np.array(sorted(data.draw(st.sets(st.integers(0, 40), min_size=1))))
    seq = np.array(data.draw(st.lists(st.integers(0, int(block[-1])))), dtype=np.int64)
    found = executed_s(block, seq, np.ones(seq.size))
    assert found.shape == block.shape
    assert found.sum() == seq.size


@pytest.mark.parametrize(
    ("after", "within_s", "end"),
    [(-1, 0.5, 1), (-1, 1.0, 1), (-1, 1.5, 2), (0, 1.5, 2), (0, 2.5, 5), (3, 0.1, 5), (3, 99.0, 6), (5, 9.0, 6)],
)
def test_a_block_is_reached_that_may_have_begun_within_the_time(after: int, within_s: float, end: int) -> None:
    least_s = np.array([1.0, 2.0, 0.0, 0.0, 3.0, 1.0])  # moves to a dwell carry no time: they are run in none
    assert last_reachable_block(least_s, after, within_s) == end


@pytest.mark.full
@hypothesis.given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=20), st.floats(0.01, 30.0), st.data())
def test_no_block_is_left_out_however_much_longer_they_take(
    least_s: list[float], within_s: float, data: st.DataObject
) -> None:
    after = data.draw(st.integers(-1, len(least_s) - 2))
    takes_s = [least + data.draw(st.floats(0.0, 1.0)) for least in least_s]
    begins_s = np.cumsum([0.0, *takes_s[after + 1 :]])[:-1]
    ran = after + 1 + int((begins_s < within_s).sum())
    assert last_reachable_block(np.array(least_s), after, within_s) >= ran


def test_a_pace_is_never_taken_too_slow() -> None:
    """Two words of a robot whose clock runs at 1.5, each as late as it may be."""
    for first_late_s, last_late_s in ((0.0, 0.0), (1.5, 0.0), (0.0, 1.5)):
        wall_s = 20.0 - first_late_s + last_late_s
        found = clock_rate(30.0, wall_s, 1.5)
        assert found is not None
        assert found >= 30.0 / 20.0
    assert clock_rate(3.0, 2.9, 1.5) is None, "the interval is too short"
