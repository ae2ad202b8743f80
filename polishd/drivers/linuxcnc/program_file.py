"""The file that LinuxCNC runs: the program's blocks, with places to stand and words that tell how far it is."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from pathlib import Path

from polishd.api import DeviceRefused
from polishd.files import write_atomic

_COMMENT = re.compile(rb"\([^()]*\)|;.*")
_END = re.compile(rb"(?<![A-Z#])M0*(?:2|30)(?:\.0*)?(?![0-9.])")


class ProgramFile:
    """Blocks with a pause (``M0``) before each of ``stops``, and a message before each pause and the program's end.

    Run from line would lose G61/G64 and what else is queued; behind a pause all modal state is kept. linuxcncrsh shows
    no line of a block that does not move, and the same state for our pause and an operator's: hence the messages.
    """

    def __init__(self, blocks: Sequence[bytes], stops: Iterable[int], token: str) -> None:
        self.blocks = len(blocks)
        end = next((seq for seq, block in enumerate(blocks) if _ends(block, seq)), self.blocks)
        self.stops = tuple(sorted({stop for stop in stops if 0 < stop <= min(end, self.blocks - 1)}))
        self._token = token
        self._inserted: list[int] = []
        """Indices, in the file, of lines that are none of the program's."""
        lines: list[bytes] = []
        at = 0
        for stop in self.stops:
            lines += blocks[at:stop]
            self._inserted.append(len(lines))
            lines.append(self._message(stop) + b" M0")
            at = stop
        lines += blocks[at:end]
        self._inserted.append(len(lines))
        lines.append(self._message(self.blocks))
        self.text = b"\n".join([*lines, *(blocks[end:] or [b"M2"]), b""])

    def block_at(self, line: int) -> int:
        """The block at a 1-based line of the file, or the next one where the line is none of the program's."""
        index = max(line - 1, 0)
        return min(index - bisect_left(self._inserted, index), self.blocks)

    def reached(self, message: str) -> int | None:
        """Number of blocks that are executed by this operator message; None where it is none of ours."""
        words = message.split()
        if len(words) == 3 and words[:2] == ["polishd", self._token] and words[2].isdecimal():
            return int(words[2])
        return None

    def write(self, folder: Path, name: str) -> Path:
        """Put it there whole: temp, fsync, rename. DeviceRefused where that fails."""
        path = folder / name
        try:
            write_atomic(path, self.text)  # readable by all: LinuxCNC may be another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. To do: look at [robot] program_dir") from error
        return path

    def _message(self, executed: int) -> bytes:
        return f"(MSG,polishd {self._token} {executed})".encode()


def _ends(block: bytes, seq: int) -> bool:
    """Whether the interpreter ends the program here: M2, M30, or the second ``%``."""
    code = b"".join(_COMMENT.sub(b"", block).split()).upper()
    return bool(_END.search(code)) or (code == b"%" and seq > 0)
