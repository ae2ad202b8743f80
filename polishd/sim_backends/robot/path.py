"""The controller's block store: what each accepted block is, as columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.sim_backends.robot.rnc import Pose, SimProgramBlock

NONE, MOVE, DWELL, PAUSE = 0, 1, 2, 3
_KINDS = {"none": NONE, "move": MOVE, "dwell": DWELL, "pause": PAUSE}


@dataclass(frozen=True, slots=True)
class Limits:
    """What this machine does."""

    accel_mm_s2: float
    overhead_s: float
    corner_deg: float
    rapid_mm_s: float
    max_feed_mm_s: float
    speed: float
    """Process seconds per wall second while running."""


class BlockColumns:
    """Columns of all blocks of the loaded program, filled as they are accepted."""

    def __init__(self, blocks: int, pose: Pose, limits: Limits) -> None:
        self.blocks = blocks
        self.accepted = 0
        self.limits = limits
        self.kind = np.zeros(blocks, dtype=np.int8)
        self.pose = np.zeros((blocks + 1, 5))
        """Block k runs from ``pose[k]`` to ``pose[k + 1]``."""
        self.pose[0] = pose
        self.length = np.zeros(blocks)
        self.feed = np.zeros(blocks)
        self.seconds = np.zeros(blocks)
        """Time of a dwell."""
        self.entry = np.zeros(blocks + 1)
        """Squared speed allowed where the block begins."""
        self._direction = np.zeros((blocks, 3))
        self._last = -1

    def append(self, batch: Sequence[SimProgramBlock]) -> None:
        """Take the next blocks."""
        first, count = self.accepted, len(batch)
        here = slice(first, first + count)
        self.kind[here] = [_KINDS[block.kind] for block in batch]
        self.pose[first + 1 : first + count + 1] = [block.end for block in batch]
        rate = np.array([block.rate for block in batch])
        inverse = np.array([block.inverse for block in batch])
        step = self.pose[first + 1 : first + count + 1] - self.pose[here]
        length = np.linalg.norm(step[:, :3], axis=1)
        self._direction[here] = step[:, :3] / np.maximum(length, 1e-12)[:, None]
        length = np.where(length > 1e-9, length, np.linalg.norm(step[:, 3:], axis=1))
        length[(self.kind[here] != MOVE) | (length <= 1e-9)] = 0.0
        rapid, max_feed = self.limits.rapid_mm_s, self.limits.max_feed_mm_s
        feed = np.where(rate > 0.0, rate, rapid)
        feed = np.where(inverse, length / np.maximum(rate, 1e-9), feed)
        self.length[here] = length
        self.feed[here] = np.clip(feed, 1e-3, np.where(rate > 0.0, max_feed, rapid))
        self.seconds[here] = np.where(self.kind[here] == DWELL, rate, 0.0)
        self.entry[here] = self._entries(here)
        self.accepted = first + count

    def _entries(self, here: slice) -> FloatArray:
        """Squared junction speeds: both feeds, and a full stop at corners, dwells and pauses."""
        index = np.arange(here.start, here.stop)
        moving = self.length[here] > 0.0
        standing = self.kind[here] >= DWELL
        marks = np.maximum.accumulate(np.concatenate([[self._last], np.where(moving | standing, index, -1)]))
        before, self._last = marks[:-1], int(marks[-1])
        after_move = (before >= 0) & (self.length[before] > 0.0)
        speed = np.where(after_move, self.feed[before], 0.0)
        corner = math.cos(math.radians(self.limits.corner_deg))
        straight = np.sum(self._direction[here] * self._direction[before], axis=1) >= corner - 1e-9
        allowed = np.where(moving, np.where(straight, np.minimum(speed, self.feed[here]), 0.0), speed)
        return np.asarray(np.where(standing, 0.0, allowed) ** 2)
