"""RNC programs as polishd sees them: columns of timed points beside bytes that stay untouched."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import FloatArray

IntArray = NDArray[np.int64]
Encoding = Literal["feed", "dwell", "inverse"]


@dataclass(frozen=True, slots=True)
class Program:
    """A parsed RNC program: n timed points (blocks that carry time), in program order.

    A point is a feed move with its own dwell (``encoding == "dwell"``), or each feed move where time sits in
    the feed (``"feed"``: F in mm/min a block; ``"inverse"``: G93 F in 1/min).
    """

    text: bytes
    sha256: str
    name: str
    dialect: str
    encoding: Encoding
    line: IntArray
    """(n,) 1-based line of the block whose number carries the time."""
    block: IntArray
    """(n,) 0-based index of that line among the lines that are streamed (see ``blocks``)."""
    start_mm: FloatArray
    """(n, 3) where the tool tip is when the block begins; a dwell stays there (what leads to it: ``travel_mm``)."""
    end_mm: FloatArray
    """(n, 3) where it is when the block ends."""
    axis: FloatArray
    """(n, 3) unit tool axis at the block's end, from the tip into the spindle."""
    time_s: FloatArray
    """(n,) time the program asks for at that block."""
    lines: int
    max_feed_mm_min: float
    """Largest feed that the program itself asks for in a timed block."""
    warnings: tuple[str, ...] = ()
    feed_mm_min: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(n,) feed of the move that leads to each point; NaN where unknown; empty where nobody asked."""
    unit: str = "s"
    """Unit of the numbers that carry the time, as they are written: "s", "ms", "mm/min", "1/min", ..."""
    frame: Literal["program", "part"] = "program"
    """Whose axes ``start_mm``, ``end_mm`` and ``axis`` are in: the program's own, as read, or the part's."""

    @property
    def n(self) -> int:
        """Number of timed points."""
        return int(self.line.size)

    @property
    def length_mm(self) -> FloatArray:
        """Path length of each block itself, (n,): 0 for a dwell."""
        return np.asarray(np.linalg.norm(self.end_mm - self.start_mm, axis=1), dtype=np.float64)

    @property
    def travel_mm(self) -> FloatArray:
        """Way that takes time at each timed point, (n,): the block, or the move from the last dwell to this one."""
        if self.encoding != "dwell":
            return self.length_mm
        return np.asarray(np.linalg.norm(np.diff(self.end_mm, axis=0, prepend=self.end_mm[:1]), axis=1))

    @property
    def blocks(self) -> list[bytes]:
        """The program's lines without line ends, as they are streamed (blank and ``%`` lines included)."""
        return self.text.split(b"\n")


@dataclass(frozen=True, slots=True)
class Segment:
    """One block on its way to the robot: sequence number, and the line's bytes without the line end."""

    seq: int
    text: bytes


@dataclass(frozen=True, slots=True)
class Plan:
    """What will be streamed: the rewritten program and what it is expected to do."""

    program: Program
    """The rewritten program, read back from its own bytes."""
    approach_blocks: int
    """Blocks before the first timed point: run with the tool retracted, then the robot waits for contact."""
    contact_blocks: int
    """Blocks up to and with the last timed point: after them the robot waits until the tool has left contact."""
    expected_time_s: FloatArray
    """(n,) delivered time expected of each timed point, s."""
    predicted_removal_nm: FloatArray
    """(ny, nx) removal on the process grid expected of the whole plan."""
    segments: tuple[Segment, ...] = field(repr=False, default=())

    @property
    def total_s(self) -> float:
        """Expected process time of the timed points."""
        return float(self.expected_time_s.sum())
