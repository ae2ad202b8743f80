"""Planned legs: whole blocks, or parts of blocks, with their times on the controller's process clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends.robot.program_reader import Pose, SimProgramBlock

# The controller's block store: accepted blocks as columns.

NONE, MOVE, DWELL, PAUSE = 0, 1, 2, 3
_KINDS = {"none": NONE, "move": MOVE, "dwell": DWELL, "pause": PAUSE}


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of this machine."""

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
        self._exact = -1
        """Last block that ends with an exact stop."""

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
        exact = np.array([block.exact for block in batch], dtype=np.bool_)
        self.entry[here] = self._entries(here, exact)
        self.accepted = first + count

    def _entries(self, here: slice, exact: BoolArray) -> FloatArray:
        """Squared junction speeds: both feeds, and a full stop at corners, exact stops, dwells and pauses."""
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
        stops = np.maximum.accumulate(np.concatenate([[self._exact], np.where(exact, index, -1)]))
        self._exact = int(stops[-1])
        return np.asarray(np.where(standing | (stops[:-1] >= before), 0.0, allowed) ** 2)


# The look-ahead speed profile: trapezoids under one acceleration, for whole buffers at once.


@dataclass(frozen=True, slots=True)
class Trapezoids:
    """n moves: speeds in, at the top and out (mm/s), and seconds of the three phases."""

    v_in: FloatArray
    v_top: FloatArray
    v_out: FloatArray
    t_up: FloatArray
    t_top: FloatArray
    t_down: FloatArray

    @property
    def seconds(self) -> FloatArray:
        """(n,) duration."""
        return self.t_up + self.t_top + self.t_down


def junctions(length: FloatArray, cap: FloatArray, start: float, accel: float) -> FloatArray:
    """Squared speeds at the n + 1 junctions of n moves.

    ``cap`` (n + 1,) is the squared speed allowed at each junction; a stop must be possible at the last one.
    Forward and backward pass in closed form: ``u[i+1] <= u[i] + 2 a L`` is a running minimum of ``cap - sum 2 a L``.
    """
    gain = np.concatenate([[0.0], np.cumsum(2.0 * accel * length)])
    limit = cap.copy()
    limit[0] = start
    forward = np.minimum.accumulate(limit - gain) + gain
    backward = np.minimum.accumulate((forward + gain)[::-1])[::-1] - gain
    squared = np.maximum(backward, 0.0)
    squared[0] = start
    return np.asarray(squared)


def trapezoids(length: FloatArray, feed: FloatArray, squared: FloatArray, accel: float) -> Trapezoids:
    """The moves between junctions of known speed. Moves of no length take no time."""
    u_in, u_out = squared[:-1], squared[1:]
    u_top = np.minimum(feed**2, accel * length + (u_in + u_out) / 2.0)
    v_in, v_out = np.sqrt(u_in), np.sqrt(u_out)
    v_top = np.sqrt(np.maximum.reduce([u_top, u_in, u_out]))
    t_up, t_down = (v_top - v_in) / accel, (v_top - v_out) / accel
    ramps = (v_top + v_in) / 2.0 * t_up + (v_top + v_out) / 2.0 * t_down
    rest = np.maximum(length - ramps, 0.0)
    t_top = np.divide(rest, v_top, out=np.zeros_like(rest), where=v_top > 0.0)
    moving = length > 0.0
    return Trapezoids(v_in, v_top, v_out, t_up * moving, t_top * moving, t_down * moving)


def along(shape: Trapezoids, k: np.ndarray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance travelled (mm) and speed (mm/s) in moves ``k`` (m,) at ``t`` (m,) seconds after their start."""
    up = np.minimum(t, shape.t_up[k])
    top = np.clip(t - shape.t_up[k], 0.0, shape.t_top[k])
    down = np.clip(t - shape.t_up[k] - shape.t_top[k], 0.0, shape.t_down[k])
    v_in, v_top, v_out = shape.v_in[k], shape.v_top[k], shape.v_out[k]
    rise = np.divide(v_top - v_in, shape.t_up[k], out=np.zeros_like(t), where=shape.t_up[k] > 0.0)
    fall = np.divide(v_top - v_out, shape.t_down[k], out=np.zeros_like(t), where=shape.t_down[k] > 0.0)
    distance = v_in * up + rise * up**2 / 2.0 + v_top * top + v_top * down - fall * down**2 / 2.0
    speed = np.where(down > 0.0, v_top - fall * down, np.where(t < shape.t_up[k], v_in + rise * up, v_top))
    return distance, speed


STEP_MM = 0.25
STEP_S = 0.05


@dataclass(slots=True)
class Cursor:
    """Position of the tool: the first block not completed, the part of it that is done, and the speed."""

    block: int = 0
    done_mm: float = 0.0
    done_s: float = 0.0
    speed: float = 0.0


@dataclass(frozen=True, slots=True)
class Legs:
    """m legs in order. ``end_s`` is the end of each; ``stop`` the last leg before standstill."""

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
    """Motion between two process times, finely divided: (n, 8) of seq, from_s, to_s and the pose half-way.

    ``first`` and ``last`` are the legs that contain the two times.
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
    """Remaining share of the cursor's block."""
    total, done = path.length[cursor.block], cursor.done_mm
    if path.kind[cursor.block] == DWELL:
        total, done = path.seconds[cursor.block], cursor.done_s
    return 1.0 - done / total if total > 0.0 else 1.0
