"""What a controller that has its whole program has executed of it, and when. Sans-IO."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from polishd.api import ExecutedBlock, Plan, RobotProgress
from polishd.model.devices import RobotState

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
