"""Blocks as a robot is handed them."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceRefused, Segment


def new_blocks(segments: Sequence[Segment], accepted: int, longest_line: int, name: str) -> list[Segment]:
    """Those that the robot does not have yet; DeviceRefused for blocks out of turn, and for what is no line (bytes)."""
    if any(segment.seq != segments[0].seq + at for at, segment in enumerate(segments)):
        raise DeviceRefused(f"{name}: blocks are not numbered one by one")
    new = [segment for segment in segments if segment.seq >= accepted]
    if new and new[0].seq > accepted:
        raise DeviceRefused(f"{name}: the robot expects block {accepted}, not {new[0].seq}")
    for segment in new:
        if b"\n" in segment.text or len(segment.text) > longest_line:
            raise DeviceRefused(f"{name}: block {segment.seq} is no single line of at most {longest_line} bytes")
    return new
