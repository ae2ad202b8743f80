"""What the machine can do, and what must never happen to the part."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Envelope:
    """Limits of the machine (as its data sheet says, on the safe side) and of the process on this part."""

    max_feed_mm_s: float
    min_feed_mm_s: float
    accel_mm_s2: float
    block_overhead_s: float
    """Time that a block takes beyond its motion; learned from what was executed."""
    corner_deg: float
    """Change of direction beyond which the machine stops at a block's end."""
    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    z_mm: tuple[float, float]
    """Allowed tool tip range in the program's frame."""
    max_removal_nm: float
    """Largest removal of one pass at any point of the part."""
    max_pass_s: float
    """Longest process time of one pass."""
