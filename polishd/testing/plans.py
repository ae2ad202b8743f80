"""Small plans for tests that stream them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from polishd.api import Plan, Program, Segment


def plan_of(lines: Sequence[bytes], approach_blocks: int = 0) -> Plan:
    """A plan of these lines without timed points: what a robot link needs, and nothing more."""
    text = b"\n".join(lines)
    none, points = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    program = Program(
        text=text,
        sha256=hashlib.sha256(text).hexdigest(),
        name="test.rnc",
        dialect="test",
        encoding="feed",
        line=none,
        block=none,
        start_mm=points,
        end_mm=points,
        axis=points,
        time_s=np.zeros(0),
        lines=len(lines),
        max_feed_mm_min=60.0,
    )
    return Plan(
        program=program,
        approach_blocks=approach_blocks,
        contact_blocks=len(lines),
        expected_time_s=np.zeros(0),
        predicted_removal_nm=np.zeros((1, 1)),
        segments=tuple(Segment(seq, line) for seq, line in enumerate(lines)),
    )
