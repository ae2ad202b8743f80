"""RNC programs as polishd sees them: columns of timed points beside bytes that stay untouched."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, overload

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import FloatArray, Grid

IntArray = NDArray[np.int64]
Encoding = Literal["feed", "dwell", "inverse", "time"]


@dataclass(frozen=True, slots=True)
class MoveTiming:
    """What the controller's language and its blends allow of the times of a program's moves."""

    least_mm_s: float
    greatest_mm_s: float
    """Speeds that a move can state."""
    resolution_s: float
    """Shortest time that a move can state."""
    blend_share: float
    """Time that the blend at a move's end adds, as a share of the move's time; negative where it saves time."""
    stops: NDArray[np.bool_]
    """(n,) whether the robot stops at the end of the move; elsewhere it blends into the next one."""


@dataclass(frozen=True, slots=True)
class Program:
    """A parsed RNC program: n timed points (blocks that carry time), in program order.

    A point is a feed move with its own dwell (``encoding == "dwell"``), or each feed move where time sits in
    the feed (``"feed"``: F in mm/min a block; ``"inverse"``: G93 F in 1/min; ``"time"``: seconds of a move).
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
    """(n,) feed of the move that leads to each point; NaN where unknown; empty where not requested."""
    unit: str = "s"
    """Unit of the numbers that carry the time, as they are written: "s", "ms", "mm/min", "1/min", ..."""
    frame: Literal["program", "part"] = "program"
    """Whose axes ``start_mm``, ``end_mm`` and ``axis`` are in: the program's own, as read, or the part's."""
    timing: MoveTiming | None = None
    """Of a robot language whose moves carry their time; None: the machine's limits alone hold."""
    beside: bytes = b""
    """Content of the file beside the program that declares its positions; empty: none. ``sha256`` covers it."""

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
        """The program's lines without line ends, as they are streamed (blank and ``%`` lines included).

        An object for each: where a program may be long, ask ``block_count`` or ``Segments`` instead.
        """
        return self.text.split(b"\n")

    @property
    def block_count(self) -> int:
        """Number of blocks."""
        return self.text.count(b"\n") + 1


def program_of_points(
    name: str, encoding: Encoding, start_mm: FloatArray, end_mm: FloatArray, axis: FloatArray
) -> Program:
    """Return a program without text: n points that ask for no time, (n, 3) mm and unit tool axes (n, 3), part frame."""
    block = np.arange(len(start_mm))
    return Program(
        text=b"",
        sha256="",
        name=name,
        dialect="",
        encoding=encoding,
        line=block + 1,
        block=block,
        start_mm=start_mm,
        end_mm=end_mm,
        axis=axis,
        time_s=np.zeros(len(block)),
        lines=len(block),
        max_feed_mm_min=0.0,
    )


@dataclass(frozen=True, slots=True)
class Segment:
    """One block on its way to the robot: sequence number, and the line's bytes without the line end."""

    seq: int
    text: bytes


class Segments(Sequence[Segment]):
    """All blocks of a program, cut out of its text when they are asked for.

    A tuple of them takes 170 bytes a block beside the text, and is searched by Python's collector; this takes 8.
    """

    __slots__ = ("_ends", "_text")

    def __init__(self, text: bytes) -> None:
        """``text``: the program's; its lines are the blocks, numbered from 0."""
        self._text = text
        self._ends = _line_ends(text)

    def __len__(self) -> int:
        return int(self._ends.size)

    @overload
    def __getitem__(self, at: int) -> Segment: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Segment]: ...
    def __getitem__(self, at: int | slice) -> Segment | Sequence[Segment]:
        """One, or a list of those of a slice."""
        wanted = range(len(self))[at]
        return self._cut(wanted) if isinstance(wanted, int) else [self._cut(seq) for seq in wanted]

    def __iter__(self) -> Iterator[Segment]:
        return map(self._cut, range(len(self)))

    def __reduce__(self) -> tuple[type[Segments], tuple[bytes]]:
        """To another process by the text alone, which goes once with the program that has it."""
        return Segments, (self._text,)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Segments) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)

    def _cut(self, seq: int) -> Segment:
        begin = int(self._ends[seq - 1]) + 1 if seq else 0
        return Segment(seq, self._text[begin : int(self._ends[seq])].rstrip(b"\r"))


_PIECE = 1 << 20
"""Bytes that are searched for line ends at once."""


def _line_ends(text: bytes) -> IntArray:
    """(n,) where each line of a text ends: offset of its line feed, for the last one the text's length."""
    data = np.frombuffer(text, dtype=np.uint8)
    starts = range(0, data.size, _PIECE)
    found = [np.flatnonzero(data[start : start + _PIECE] == ord("\n")) + start for start in starts]
    return np.concatenate([*found, [data.size]]).astype(np.int64, copy=False)


@dataclass(frozen=True, slots=True)
class Plan:
    """The program to stream, and its expected result."""

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
    segments: Sequence[Segment] = field(repr=False, default=())
    grid: Grid | None = None
    """Grid of `predicted_removal_nm`; None: not known."""

    @property
    def total_s(self) -> float:
        """Expected process time of the timed points."""
        return float(self.expected_time_s.sum())


# What the machine can do, and what must never happen to the part.


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
    least_point_s: float = 0.0
    """Least time of a timed point in a plan: a robot that holds few instructions needs so much motion in them."""
