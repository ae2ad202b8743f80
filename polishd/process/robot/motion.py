"""Motion times of the machine: speeds, accelerations, corners, overhead of each block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.program import Envelope, IntArray, Program
from polishd.model.surface import BoolArray, FloatArray

SAME_PLACE_MM = 1e-6
MIN_LEARNED = 10
"""Least number of blocks for an estimate of the overhead."""


def least_time_s(program: Program, envelope: Envelope) -> FloatArray:
    """(n,) s: time of each timed point when the whole path is run at the largest feed, overhead included.

    Not quite a bound for each block alone: a slow neighbour lowers the speed at the junction.
    """
    fastest = delivered_time_s(program, np.zeros(program.n), envelope)
    if program.timing is None:
        return fastest
    return np.maximum(fastest, program.timing.resolution_s * _blend_factor(program) + envelope.block_overhead_s)


def most_time_s(program: Program, envelope: Envelope) -> FloatArray:
    """(n,) s: time of each timed point at the smallest feed; a dwell on the spot may take the whole pass."""
    if program.encoding == "dwell":
        longest = np.full(program.n, envelope.max_pass_s)
    else:
        longest = program.length_mm / envelope.min_feed_mm_s + envelope.block_overhead_s
    return np.asarray(np.maximum(longest, least_time_s(program, envelope)), dtype=np.float64)


def delivered_time_s(program: Program, time_s: FloatArray, envelope: Envelope) -> FloatArray:
    """Return the time that the machine takes for each timed point of ``time_s``.

    Each block runs at the requested feed (at most ``max_feed_mm_s``) with a trapezoidal speed profile; the speed at
    a junction is at most either block's and what acceleration can reach from both sides; the machine stops at the
    path's ends, at gaps, at moves that are programmed to stop, and where the direction changes by more than
    ``corner_deg``. The blend at a move's end adds its share of the move's time (``Program.timing``). A dwell is run
    after its move from rest to rest at the largest feed. Each point takes ``block_overhead_s`` besides.

    Args:
        program: the path.
        time_s: (n,) requested time of each point, s; 0 requests the largest feed.
        envelope: what the machine can do.

    Returns:
        (n,) s.

    Raises:
        ComputeError: ``time_s`` has another shape, is negative or not finite.
    """
    asked = np.asarray(time_s, dtype=np.float64)
    if asked.shape != (program.n,) or not (np.isfinite(asked).all() and (asked >= 0).all()):
        raise ComputeError(f"each of the {program.n} timed points needs a finite time, not negative")
    length = program.travel_mm
    fastest = np.full(program.n, envelope.max_feed_mm_s)
    if program.encoding == "dwell":
        rest = np.zeros(program.n + 1)
        return asked + _trapezoid_s(length, fastest, rest, envelope.accel_mm_s2) + envelope.block_overhead_s
    feed = np.divide(length, asked, out=fastest.copy(), where=asked * fastest > length)
    limit = np.zeros(program.n + 1)
    limit[1:-1] = np.where(_stops(program, envelope.corner_deg), 0.0, np.minimum(feed[1:], feed[:-1]))
    speed = _reachable(limit, length, envelope.accel_mm_s2)
    moving_s = _trapezoid_s(length, feed, speed, envelope.accel_mm_s2)
    return moving_s * _blend_factor(program) + envelope.block_overhead_s


def asked_time_s(program: Program, wanted_s: FloatArray, envelope: Envelope) -> FloatArray:
    """(n,) s to write for the points to take ``wanted_s``, where the machine reaches its feeds; never negative.

    Of a dwell, the time that its move takes is not written; of a move, its block's overhead and the share of its blend.
    No move is asked to be slower than the smallest feed: where acceleration makes it so, it takes longer than asked.
    """
    if program.encoding == "dwell":
        return np.maximum(wanted_s - least_time_s(program, envelope), 0.0)
    asked = np.maximum(wanted_s - envelope.block_overhead_s, 0.0) / _blend_factor(program)
    return np.asarray(np.minimum(asked, program.length_mm / envelope.min_feed_mm_s), dtype=np.float64)


def _blend_factor(program: Program) -> FloatArray:
    """(n,) ratio of what a move takes and what its speed or time says, because of the blend at its end."""
    if program.timing is None:
        return np.ones(program.n)
    return np.where(program.timing.stops, 1.0, 1.0 + program.timing.blend_share)


def learn_overhead_s(program: Program, asked_s: FloatArray, executed_s: FloatArray, envelope: Envelope) -> float:
    """Overhead of a block in s: median of what blocks took beyond what their motion explains, at least 0.

    Args:
        program: the path that was run.
        asked_s: (n,) time that the program requested.
        executed_s: (n,) time that the blocks took, NaN where it is not known.
        envelope: the present one; its overhead is returned with fewer than ten known blocks.

    Raises:
        ComputeError: shapes that do not fit.
    """
    if executed_s.shape != (program.n,):
        raise ComputeError(f"executed times are {executed_s.shape}, the program has {program.n} timed points")
    extra = executed_s - delivered_time_s(program, asked_s, replace(envelope, block_overhead_s=0.0))
    extra = extra[np.isfinite(extra)]
    return envelope.block_overhead_s if extra.size < MIN_LEARNED else max(0.0, float(np.median(extra)))


def _stops(program: Program, corner_deg: float) -> BoolArray:
    """(n - 1,) whether the machine stops between a point and the next: corners, gaps, moves of no length."""
    way = program.end_mm - program.start_mm
    length = program.length_mm
    still = length <= SAME_PLACE_MM
    gap = np.linalg.norm(program.start_mm[1:] - program.end_mm[:-1], axis=1) > SAME_PLACE_MM
    scale = np.where(still, 1.0, length)
    cosine = np.einsum("ij,ij->i", way[1:], way[:-1]) / (scale[1:] * scale[:-1])
    # a little inclusive: corners of exactly corner_deg are run through whatever the rounding
    corner = cosine < np.cos(np.radians(corner_deg)) - 1e-12
    stops = np.zeros(program.n, dtype=np.bool_) if program.timing is None else program.timing.stops
    return np.asarray(corner | gap | still[1:] | still[:-1] | stops[:-1], dtype=np.bool_)


def _reachable(limit: FloatArray, length: FloatArray, accel: float) -> FloatArray:
    """(n + 1,) largest junction speeds below their limits with ``|d(v^2)| <= 2 a length`` over each block.

    In ``v^2 - 2 a s`` the forward pass is a running minimum, and so is the backward pass in ``v^2 + 2 a s``.
    """
    gain = 2 * accel * np.concatenate([[0.0], np.cumsum(length)])
    square = np.minimum.accumulate(limit**2 - gain) + gain
    square = np.minimum.accumulate((square + gain)[::-1])[::-1] - gain
    return np.sqrt(np.clip(square, 0.0, limit**2))


def _trapezoid_s(length: FloatArray, feed: FloatArray, speed: FloatArray, accel: float) -> FloatArray:
    """(n,) s for blocks of this length at this feed, entered and left at the junction speeds (n + 1,)."""
    enter, leave = speed[:-1], speed[1:]
    top = np.sqrt(np.minimum(feed**2, (enter**2 + leave**2) / 2 + accel * length))
    top = np.maximum(top, np.maximum(enter, leave))  # rounding only
    cruise = np.maximum(length - (2 * top**2 - enter**2 - leave**2) / (2 * accel), 0.0)
    ramps = (2 * top - enter - leave) / accel
    return ramps + np.divide(cruise, top, out=np.zeros_like(top), where=top > 0)


# Executed time: from the blocks that a robot executed to the timed points of its program, and what may follow them.


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


def last_reachable_block(least_s: FloatArray, after: int, within_s: float) -> int:
    """End (excluded) of the blocks that may have begun within that time of the end of block ``after``.

    Args:
        least_s: (n,) s, the least that each block takes.
        after: sequence number of the last block that is known to have ended; -1: none.
        within_s: s, on the clock of ``least_s``.
    """
    first = after + 1
    ends_s = np.cumsum(least_s[first:])
    return min(first + 1 + int(np.searchsorted(ends_s, within_s)), least_s.size)


def clock_rate(process_s: float, wall_s: float, late_s: float) -> float | None:
    """Most seconds of a process clock that can have passed in one of the wall's, from two words and their times.

    Each message arrives at most ``late_s`` after its event. A short interval shows little: None then.
    """
    return process_s / (wall_s - late_s) if wall_s >= 2 * late_s else None
