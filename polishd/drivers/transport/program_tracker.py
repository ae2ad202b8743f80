"""A program as the one file that a controller loads: its blocks, and lines of ours where it is to stop."""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState
from polishd.model.program import Plan

_COMMENT = re.compile(rb"\([^()]*\)|;.*")
_END = re.compile(rb"(?<![A-Z#])M0*(?:2|30)(?:\.0*)?(?![0-9.])")


class ProgramFile:
    """The blocks, with ``at_stop(stop)`` before each of ``stops`` and ``at_end(end)`` before what ends the program.

    The last line that ``at_stop`` gives makes the controller stand: behind it all modal state is kept, which *run from
    line* would lose. A program without an end gets ``end_line``.
    """

    def __init__(
        self,
        blocks: Sequence[bytes],
        stops: Iterable[int],
        at_stop: Callable[[int], Sequence[bytes]],
        at_end: Callable[[int], Sequence[bytes]],
        end_line: bytes = b"M2",
    ) -> None:
        self.blocks = len(blocks)
        end = next((seq for seq, block in enumerate(blocks) if _ends(block, seq)), self.blocks)
        self.stops = tuple(sorted({stop for stop in stops if 0 < stop <= min(end, self.blocks - 1)}))
        self.inserted: list[int] = []
        """Indices, in the file, of lines that are none of the program's."""
        self.pauses: dict[int, int] = {}
        """1-based line of the file that makes the controller stand: number of blocks that are executed there."""
        lines: list[bytes] = []
        at = 0
        for stop in self.stops:
            lines += blocks[at:stop]
            self._put_in(lines, at_stop(stop), stop)
            at = stop
        lines += blocks[at:end]
        self._put_in(lines, at_end(end), end)
        self.lines = (*lines, *(blocks[end:] or [end_line] * bool(end_line)))
        self.text = b"\n".join([*self.lines, b""])

    def _put_in(self, lines: list[bytes], own: Sequence[bytes], executed: int) -> None:
        self.inserted += range(len(lines), len(lines) + len(own))
        lines += own
        if own:
            self.pauses[len(lines)] = executed

    def block_at(self, line: int) -> int:
        """The block at a 1-based line of the file, or the next one where the line is none of the program's."""
        index = max(line - 1, 0)
        return min(index - bisect_left(self.inserted, index), self.blocks)


def _ends(block: bytes, seq: int) -> bool:
    """Whether the interpreter ends the program here: M2, M30, or the second ``%``."""
    code = b"".join(_COMMENT.sub(b"", block).split()).upper()
    return bool(_END.search(code)) or (code == b"%" and seq > 0)


# What a controller that has its whole program has executed of it, and when. Sans-IO.

BLOCK_S = 0.01
"""What a block costs beyond its dwell, about."""


class ProgramTracker:
    """One program from its load to its end. Times are process time: it stands still while the robot is held.

    What a controller says of itself is for its own kind to understand: it moves ``clock_s`` on and calls ``record``.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        self.sha256 = plan.program.sha256
        self.blocks = blocks
        self.state: RobotState = "held"
        self.detail = ""
        self.dropped = False
        """Nothing more will be executed of it."""
        self.stopped = ""
        """Why it stands although it was told to run; empty where nobody knows."""
        self.clock_s = 0.0
        self.began_s = 0.0
        """When the block under way began."""
        self._start_s, self._end_s = array("d"), array("d")
        # asked again and again while the tool presses: the sums are made once
        self._timed = plan.program.block
        self._ahead_s = np.cumsum(np.append(plan.expected_time_s, 0.0)[::-1])[::-1]

    def __len__(self) -> int:
        return len(self._end_s)

    def __getitem__(self, seq: int) -> ExecutedBlock:
        return ExecutedBlock(seq, self._start_s[seq], self._end_s[seq])

    @property
    def ended(self) -> bool:
        """No more records will come."""
        return self.dropped or self.state in ("done", "fault")

    def left_s(self) -> float:
        """What is left of its plan, about."""
        timed_s = float(self._ahead_s[np.searchsorted(self._timed, len(self))])
        return timed_s + BLOCK_S * (self.blocks - len(self))

    def expected_s(self, to: int) -> float:
        """Planned time of the blocks that are not executed yet, up to that one."""
        first, last = np.searchsorted(self._timed, (len(self), to))
        return float(self._ahead_s[first] - self._ahead_s[last])

    def progress(self, accepted: int, buffer_s: float, override: float | None = None) -> RobotProgress:
        """As the port wants it."""
        return RobotProgress(
            state=self.state,
            program_sha256=self.sha256,
            accepted=max(accepted, len(self)),
            executed=len(self),
            buffer_s=buffer_s,
            detail=self.detail,
            override=override,
        )

    def drop(self, reason: str) -> None:
        """It will not be gone on with."""
        self.dropped, self.detail = True, reason
        if self.state == "running":
            self.state = "held"

    def record(self, ends_s: Sequence[float]) -> None:
        """The next blocks are executed, and ended at those process times: rising, the last not after ``clock_s``."""
        self._start_s.extend([self.began_s, *ends_s[:-1]])
        self._end_s.extend(ends_s)
        self.began_s = ends_s[-1]


# What a controller that has its program as one file has executed of it, and when. Sans-IO.

START_S = 1.0
"""So long after being told to run a controller may say that it does not."""


class FileProgramTracker(ProgramTracker):
    """One program from its load to its end; it may stand at the stops of its file."""

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.started = False
        self.file: ProgramFile | None = None
        """What the controller has; None before."""
        self.held_at: int | None = None
        """The stop at which it stands; None while it stands elsewhere."""
        self.runs = False
        """It was seen running since it was told to."""
        self.seen_s = self._went_s = 0.0

    @property
    def refuses(self) -> bool:
        """It was told to run, and had the time to."""
        return self.runs or self.clock_s - self._went_s > START_S

    def go(self, time_s: float, detail: str = "") -> None:
        """It runs, from that time of its own clock."""
        self.state, self.detail, self.started = "running", detail, True
        self.held_at = None
        self.seen_s, self._went_s, self.runs = time_s, self.clock_s, False

    def tick(self, time_s: float) -> None:
        """It ran until that time of its own clock."""
        self.clock_s += max(time_s - self.seen_s, 0.0)
        self.seen_s = time_s
