"""Executed time of timed points: each block counts once, for the point that it leads to."""

from __future__ import annotations

import hypothesis
import numpy as np
from hypothesis import strategies as st

from polishd.process.executed import executed_s


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
