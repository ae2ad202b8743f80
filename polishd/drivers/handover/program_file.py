"""The file that is handed over: the program's blocks, pauses where it is to stop, and dwells that prove the line."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence

from polishd.api import DeviceRefused
from polishd.config.controller_profile import LineVariable, ProgramTable
from polishd.drivers.transport import program_file

_N_WORD = re.compile(rb"\s*/?\s*N\s*(\d+)", re.IGNORECASE)


class PlcProgramFile(program_file.ProgramFile):
    """Before its first stop, out of contact, stand dwells of ``proof_s``: see ``proof.Proof``."""

    def __init__(
        self,
        blocks: Sequence[bytes],
        stops: Iterable[int],
        table: ProgramTable,
        *,
        line: LineVariable,
        proof_s: Sequence[float] = (),
        pause_at_end: bool = False,
    ) -> None:
        pause = table.pause.encode()
        dwells = [table.dwell.format(seconds=seconds).encode() for seconds in proof_s]
        stops = list(stops)
        first = min((stop for stop in stops if stop > 0), default=0)
        numbered = line.counts == "n_words"

        def own(at: int, *lines: bytes) -> list[bytes]:
            return _numbered(lines, blocks[:at]) if numbered else list(lines)

        super().__init__(
            blocks,
            stops,
            lambda stop: own(stop, *(dwells if stop == first else ()), pause),
            lambda end: own(end, pause) if pause_at_end else [],
            table.end.encode(),
        )
        self.end = max(self.pauses.values()) if pause_at_end else None
        """Blocks that are executed at the pause before the end; None without one."""
        proved = self.stops[:1] == (first,)
        self.proof = _dwell_lines(self.inserted, len(dwells)) if proved else ()
        """1-based lines of the dwells."""
        self._first = line.first
        self._numbers = _n_words(self.lines) if numbered else None

    def block_at(self, line: int) -> int:
        """As any file; but the block before a dwell of ours is over when that is, for only then the tool may land."""
        return super().block_at(line) - (line in self.proof)

    def line_of(self, shown: int) -> int:
        """The 1-based line of the file that the controller means; 0 for none of it."""
        if self._numbers is None:
            return min(max(shown + 1 - self._first, 0), len(self.lines))
        numbers, lines = self._numbers
        at = bisect_right(numbers, shown) - 1
        return lines[at] if at >= 0 else 0


def _dwell_lines(inserted: Sequence[int], count: int) -> tuple[int, ...]:
    return tuple(index + 1 for index in inserted[:count])


def _numbered(lines: Sequence[bytes], before: Sequence[bytes]) -> list[bytes]:
    """Lines of ours with N words of their own, which go on from the last one before."""
    last = next((int(found[1]) for block in reversed(before) if (found := _N_WORD.match(block))), 0)
    return [b"N%d %s" % (last + k, line) for k, line in enumerate(lines, 1)]


def _n_words(lines: Sequence[bytes]) -> tuple[list[int], list[int]]:
    """The N words in the file, and the lines that they stand in. DeviceRefused where they do not rise."""
    numbers: list[int] = []
    at: list[int] = []
    for number, text in enumerate(lines, 1):
        if (found := _N_WORD.match(text)) is None:
            continue
        value = int(found[1])
        if numbers and value <= numbers[-1]:
            raise DeviceRefused(
                f"line {number} of the file: N{value} after N{numbers[-1]}: the controller tells blocks by their N "
                "words. To do: number the program in steps of 10"
            )
        numbers.append(value)
        at.append(number)
    return numbers, at
