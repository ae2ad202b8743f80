"""The last look at a plan before anything moves: every limit of the envelope, and the plan's own consistency."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO

import numpy as np

from polishd.api import Envelope, Plan, hookimpl
from polishd.model.surface import BoolArray, FloatArray

# What a plan must keep. Comparisons are written so that NaN is a violation too.

DIGITS = 2e-4
"""Relative room for the digits that a program is written with."""
SAME_PLACE_MM = 1e-3
MAX_FEED, MIN_FEED = "machine.max_feed_mm_s", "machine.min_feed_mm_s"

Check = Callable[[Plan, Envelope], Iterator[str]]


def text(plan: Plan, envelope: Envelope) -> Iterator[str]:  # noqa: ARG001  one signature for all checks
    """The hash is that of the text with the file beside it, and the segments are the text's lines, numbered from 0."""
    program = plan.program
    sha256 = hashlib.sha256(program.text + program.beside).hexdigest()
    if sha256 != program.sha256:
        yield f"the program's sha256 is {sha256[:12]}…, the plan says {program.sha256[:12]}…"
    if not plan.segments:
        return
    count = program.block_count
    if not plan.contact_blocks <= len(plan.segments) <= count:
        yield f"{len(plan.segments)} segments for a program of {count} lines"
    lines = (line.removesuffix(b"\n") for line in BytesIO(program.text + b"\n"))  # one at a time: they may be millions
    for index, (segment, block) in enumerate(zip(plan.segments, lines, strict=False)):
        if segment.seq != index or segment.text.rstrip(b"\r") != block.rstrip(b"\r"):
            yield f"line {index + 1}: segment {segment.seq} is {segment.text!r}, the program says {block!r}"
            return


def blocks(plan: Plan, envelope: Envelope) -> Iterator[str]:  # noqa: ARG001
    """Approach and contact begin and end where the timed points do, and points stand in program order."""
    program = plan.program
    if program.n == 0:
        yield "the plan has no timed points"
        return
    if (np.diff(program.block) <= 0).any():
        yield "the timed points are not in the program's order"
    first, last = int(program.block[0]), int(program.block[-1])
    if plan.approach_blocks != first:
        yield f"line {program.line[0]}: first timed point in block {first}, approach_blocks is {plan.approach_blocks}"
    if plan.contact_blocks != last + 1:
        yield f"line {program.line[-1]}: last timed point in block {last}, but contact_blocks is {plan.contact_blocks}"
    if last >= program.block_count:
        yield f"line {program.line[-1]}: the text has only {program.block_count} lines"


def positions(plan: Plan, envelope: Envelope) -> Iterator[str]:
    """The tool tip stays inside the envelope, its axis is a unit vector."""
    program = plan.program
    for index, (axis, (low, high)) in enumerate(zip("xyz", (envelope.x_mm, envelope.y_mm, envelope.z_mm), strict=True)):
        both = {"starts": program.start_mm[:, index], "ends": program.end_mm[:, index]}
        limit = f"outside {low:g} to {high:g} mm (machine.{axis}_mm)"
        for name, values in both.items():
            inside = (values >= low) & (values <= high)
            if not inside.all():
                needs = (
                    f"the path needs {min(map(np.min, both.values())):.6g} to {max(map(np.max, both.values())):.6g} mm"
                )
                yield from _lines(plan, inside, values, f"{name} at {axis} = {{:.6g}} mm, {limit}; {needs}")
                break
    length = np.linalg.norm(program.axis, axis=1)
    yield from _lines(plan, np.abs(length - 1) < 1e-6, length, "tool axis of length {:.6g}, not 1")


def path(plan: Plan, envelope: Envelope) -> Iterator[str]:  # noqa: ARG001
    """In contact nothing moves that is not timed: each block of a feed-timed program starts where the last ended."""
    program = plan.program
    if program.encoding == "dwell":
        return  # there the moves between the points carry no time of their own
    gap = np.zeros(program.n)
    gap[1:] = np.linalg.norm(program.start_mm[1:] - program.end_mm[:-1], axis=1)
    yield from _lines(plan, gap <= SAME_PLACE_MM, gap, "an untimed move of {:.6g} mm leads here, in contact")


def times(plan: Plan, envelope: Envelope) -> Iterator[str]:
    """Times are finite and above zero, and the pass ends in time."""
    program, expected = plan.program, plan.expected_time_s
    if expected.shape != (program.n,):
        yield f"{program.n} timed points, but expected times of shape {expected.shape}"
        return
    for says, time_s in (("asks for a time of", program.time_s), ("is expected to take", expected)):
        enough = time_s >= 0 if program.encoding == "dwell" else time_s > 0
        yield from _lines(plan, np.isfinite(time_s) & enough, time_s, f"{says} {{:.6g}} s")
    for name, total in (("is expected to take", plan.total_s), ("asks for", float(program.time_s.sum()))):
        if not total <= envelope.max_pass_s:
            needed = "" if not np.isfinite(total) else f": set it to {math.ceil(total)} or more, or plan less removal"
            yield f"the pass {name} {total:.6g} s, more than limits.max_pass_s = {envelope.max_pass_s:g} s{needed}"


def feeds(plan: Plan, envelope: Envelope) -> Iterator[str]:
    """Feeds stay inside the machine's, as asked for and as expected."""
    program, least, most = plan.program, envelope.min_feed_mm_s, envelope.max_feed_mm_s
    top, low = most * (1 + DIGITS), least * (1 - DIGITS)
    largest = program.max_feed_mm_min / 60
    if not largest <= top:
        yield f"the program asks for a feed of {largest:.6g} mm/s, above {most:g} mm/s ({MAX_FEED})"
    if plan.expected_time_s.shape != (program.n,) or program.encoding == "dwell":
        return  # a dwell's time is not its feed
    length = program.length_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        asked, expected = (np.where(length > 0, length / t, least) for t in (program.time_s, plan.expected_time_s))
    above, below = f"above {most:g} mm/s ({MAX_FEED})", f"below {least:g} mm/s ({MIN_FEED})"
    yield from _lines(plan, asked <= top, asked, f"asks for {{:.6g}} mm/s, {above}")
    yield from _lines(plan, expected <= top, expected, f"is expected at {{:.6g}} mm/s, {above}")
    yield from _lines(plan, asked >= low, asked, f"asks for {{:.6g}} mm/s, {below}")


def removal(plan: Plan, envelope: Envelope) -> Iterator[str]:
    """The pass removes at every point of the part something finite, not negative, and not too much."""
    predicted = plan.predicted_removal_nm
    if predicted.size == 0 or not np.isfinite(predicted).all():
        yield "the predicted removal is not finite everywhere"
        return
    if predicted.min() < 0:
        yield f"the predicted removal falls to {predicted.min():.6g} nm: a tool adds nothing"
    if not predicted.max() <= envelope.max_removal_nm:
        row, column = np.unravel_index(int(predicted.argmax()), predicted.shape)
        grid = plan.grid
        place = "" if grid is None else f" at x {grid.x_mm[column]:.1f}, y {grid.y_mm[row]:.1f} mm of the part"
        yield (
            f"the predicted removal is {predicted.max():.6g} nm{place}, more than limits.max_removal_nm = "
            f"{envelope.max_removal_nm:g} nm. Check process.preston (or process.tif) and its unit, or increase it"
        )


CHECKS: tuple[Check, ...] = (text, blocks, positions, path, times, feeds, removal)


def _lines(plan: Plan, good: BoolArray, values: FloatArray, says: str) -> Iterator[str]:
    """One violation for all points that are not good: line and value of the first, the count, and the last line."""
    found, line = np.flatnonzero(~good), plan.program.line
    if found.size:
        more = (
            f" (so at {found.size} of {good.size} points, the last in line {line[found[-1]]})" if found.size > 1 else ""
        )
        yield f"line {line[found[0]]}: {says.format(float(values[found[0]]))}{more}"


POLISHD_API = 1


@hookimpl
def polishd_check_plan(plan: Plan, envelope: Envelope) -> Sequence[str]:
    """Violations, each with the line and the value; any of them is a veto."""
    return [violation for check in CHECKS for violation in check(plan, envelope)]
