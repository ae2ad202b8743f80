"""What the robot has executed of one program."""

from __future__ import annotations

from array import array
from collections.abc import Iterable

from polishd.api import Executed, LinkError


class ExecutionRecord:
    """Executed blocks from 0 on, without gaps, each once; 16 bytes a block. Outlives connections, not the program."""

    def __init__(self, program_sha256: str = "", boot_id: str = "") -> None:
        self.program_sha256 = program_sha256
        self.boot_id = boot_id
        self._start_s = array("d")
        self._end_s = array("d")

    def __len__(self) -> int:
        return len(self._start_s)

    def __getitem__(self, seq: int) -> Executed:
        return Executed(seq, self._start_s[seq], self._end_s[seq])

    def extend(self, executed: Iterable[Executed]) -> None:
        """Add what is new. LinkError where records were lost: the robot gives them again after a reconnect."""
        for one in executed:
            if one.seq > len(self):
                raise LinkError(
                    f"robot: records of blocks {len(self)} to {one.seq - 1} were lost on the wire: reconnect"
                )
            if one.seq == len(self):
                self._start_s.append(one.start_s)
                self._end_s.append(one.end_s)
