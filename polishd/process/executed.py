"""Executed time: from the blocks that a robot executed to the timed points of its program."""

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
