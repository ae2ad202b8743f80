"""A program as the one file that a controller loads: its blocks, and lines of ours where it is to stop."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence

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
