"""Executed time: from the blocks that a robot executed to the timed points of its program, and what may follow them."""

from __future__ import annotations

import numpy as np

from polishd.model.program import IntArray
from polishd.model.surface import FloatArray


def executed_s(point_block: IntArray, seq: IntArray, duration_s: FloatArray) -> FloatArray:
    """Process time that each timed point really had, with what leads to it: a dwell's own move removes, too.

    Args:
        point_block: (n,) ascending sequence number of the block that carries each point's time (``Program.block``).
        seq: (k,) sequence numbers of the blocks executed in contact; one that came in pieces may stand there twice.
        duration_s: (k,) s, of each of them.

    Returns:
        (n,) s; 0 where nothing was run.
    """
    blocks = np.zeros(max(int(seq.max(initial=-1)), int(point_block.max())) + 1)
    np.add.at(blocks, seq, duration_s)
    return np.asarray(np.diff(np.cumsum(blocks)[point_block], prepend=0.0), dtype=np.float64)


def reached(least_s: FloatArray, after: int, within_s: float) -> int:
    """End (excluded) of the blocks that may have begun within that time of the end of block ``after``.

    Args:
        least_s: (n,) s, the least that each block takes.
        after: sequence number of the last block that is known to have ended; -1: none.
        within_s: s, on the clock of ``least_s``.
    """
    first = after + 1
    ends_s = np.cumsum(least_s[first:])
    return min(first + 1 + int(np.searchsorted(ends_s, within_s)), least_s.size)


def pace(process_s: float, wall_s: float, late_s: float) -> float | None:
    """Most seconds of a process clock that can have passed in one of the wall's, from two words and their times.

    Each word came at most ``late_s`` after what it tells, so that a short while tells little: None then.
    """
    return process_s / (wall_s - late_s) if wall_s >= 2 * late_s else None
