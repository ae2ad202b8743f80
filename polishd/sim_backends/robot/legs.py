"""Planned legs: whole blocks, or parts of blocks, with their times on the controller's process clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends.robot.path import DWELL, MOVE, PAUSE, BlockColumns
from polishd.sim_backends.robot.profile import Trapezoids, along, junctions, trapezoids

STEP_MM = 0.25
STEP_S = 0.05


@dataclass(slots=True)
class Cursor:
    """Where the tool is: the first block not completed, how much of it is done, and the speed."""

    block: int = 0
    done_mm: float = 0.0
    done_s: float = 0.0
    speed: float = 0.0


@dataclass(frozen=True, slots=True)
class Legs:
    """m legs in order. ``end_s`` is when each ends; ``stop`` the last leg to be run before standing still."""

    block: NDArray[np.int64]
    from_mm: FloatArray
    from_s: FloatArray
    shape: Trapezoids
    nominal_s: FloatArray
    start_s: FloatArray
    end_s: FloatArray
    completes: BoolArray
    stop: int

    def reached(self, process_s: float) -> int:
        """Number of legs whose end is reached."""
        return int(np.searchsorted(self.end_s[: self.stop + 1], process_s, side="right"))

    def state(self, k: int, process_s: float) -> tuple[float, float, float]:
        """(mm done, s of dwell done, mm/s) of leg ``k``'s block at that time."""
        span = self.end_s[k] - self.start_s[k]
        share = float(np.clip((process_s - self.start_s[k]) / span, 0.0, 1.0)) if span > 0.0 else 1.0
        nominal = np.array([share * self.nominal_s[k]])
        distance, speed = along(self.shape, np.array([k]), nominal)
        return self.from_mm[k] + float(distance[0]), self.from_s[k] + float(nominal[0]), float(speed[0])


def plan(path: BlockColumns, cursor: Cursor, process_s: float, until: int | None) -> Legs:
    """Legs for everything accepted beyond the cursor; the last junction and that of ``until`` are stops."""
    block = np.arange(cursor.block, path.accepted)
    length = path.length[block].copy()
    dwell = path.seconds[block].copy()
    part = np.ones(len(block))
    if len(block):
        part[0] = _left(path, cursor)
        length[0] = max(length[0] - cursor.done_mm, 0.0)
        dwell[0] = max(dwell[0] - cursor.done_s, 0.0)
    cap = np.append(path.entry[block], 0.0)
    if until is not None and cursor.block < until < path.accepted:
        cap[until - cursor.block] = 0.0
    accel, overhead_s = path.limits.accel_mm_s2, path.limits.overhead_s
    squared = junctions(length, cap, cursor.speed**2, accel)
    shape = trapezoids(length, path.feed[block], squared, accel)
    nominal = np.where(path.kind[block] == DWELL, dwell, shape.seconds)
    timed = (path.length[block] > 0.0) | (path.kind[block] == DWELL)
    end = process_s + np.cumsum(nominal + np.where(timed, overhead_s * part, 0.0))
    start = np.concatenate([[process_s], end[:-1]])
    from_mm, from_s = np.zeros(len(block)), np.zeros(len(block))
    if len(block):
        from_mm[0], from_s[0] = cursor.done_mm, cursor.done_s
    halts = (path.kind[block] == PAUSE) | (block + 1 == (-1 if until is None else until))
    stop = int(np.argmax(halts)) if halts.any() else len(block) - 1
    return Legs(block, from_mm, from_s, shape, nominal, start, end, np.ones(len(block), dtype=bool), stop)


def braking(path: BlockColumns, cursor: Cursor, process_s: float) -> Legs:
    """Legs that come to a stop along the path as soon as the acceleration allows; the last may end inside a block."""
    block = np.arange(cursor.block, path.accepted)
    length = path.length[block].copy()
    length[0] = max(length[0] - cursor.done_mm, 0.0)
    ahead = np.concatenate([[0.0], np.cumsum(length)])
    accel = path.limits.accel_mm_s2
    distance = cursor.speed**2 / (2.0 * accel)
    count = min(max(int(np.searchsorted(ahead, distance - 1e-9)), 1), len(block))
    squared = np.maximum(cursor.speed**2 - 2.0 * accel * ahead[: count + 1], 0.0)
    speed = np.sqrt(squared)
    down = (speed[:-1] - speed[1:]) / accel
    nothing = np.zeros(count)
    shape = Trapezoids(speed[:-1], speed[:-1], speed[1:], nothing, nothing, down)
    end = process_s + np.cumsum(down)
    completes = np.ones(count, dtype=bool)
    completes[-1] = path.kind[block[count - 1]] == MOVE and ahead[count] <= distance + 1e-9
    from_mm, from_s = np.zeros(count), np.zeros(count)
    from_mm[0], from_s[0] = cursor.done_mm, cursor.done_s
    start = np.concatenate([[process_s], end[:-1]])
    nominal = np.where(path.kind[block[:count]] == DWELL, 0.0, down)
    return Legs(block[:count], from_mm, from_s, shape, nominal, start, end, completes, count - 1)


def rows(path: BlockColumns, legs: Legs, first: int, last: int, span: tuple[float, float]) -> FloatArray:
    """Motion between two process times, cut finely: (n, 8) of seq, from_s, to_s and the pose half-way.

    ``first`` and ``last`` are the legs that the two times lie in.
    """
    k = np.arange(first, min(last, len(legs.block) - 1) + 1)
    low, high = np.clip(legs.start_s[k], *span), np.clip(legs.end_s[k], *span)
    lasting = high > low
    k, low, high = k[lasting], low[lasting], high[lasting]
    stretch = legs.nominal_s[k] / (legs.end_s[k] - legs.start_s[k])
    pace = np.maximum(legs.shape.v_top[k] * stretch / STEP_MM, 1.0 / STEP_S)
    count = np.maximum(np.ceil((high - low) * pace), 1).astype(np.int64)
    which = np.repeat(np.arange(len(k)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    width = ((high - low) / count)[which]
    begin = low[which] + number * width
    leg = k[which]
    distance, _ = along(legs.shape, leg, (begin + width / 2.0 - legs.start_s[leg]) * stretch[which])
    block = legs.block[leg]
    total = path.length[block]
    share = np.divide(legs.from_mm[leg] + distance, total, out=np.ones_like(total), where=total > 0.0)
    start, end = path.pose[block], path.pose[block + 1]
    pose = start + (end - start) * np.clip(share, 0.0, 1.0)[:, None]
    return np.column_stack([block, begin, begin + width, pose])


def _left(path: BlockColumns, cursor: Cursor) -> float:
    """Share of the cursor's block that is still to do."""
    total, done = path.length[cursor.block], cursor.done_mm
    if path.kind[cursor.block] == DWELL:
        total, done = path.seconds[cursor.block], cursor.done_s
    return 1.0 - done / total if total > 0.0 else 1.0
