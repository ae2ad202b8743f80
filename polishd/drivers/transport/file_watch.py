"""What a controller that has its program as one file has executed of it, and when. Sans-IO."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from polishd.api import Executed, Plan, RobotProgress
from polishd.drivers.transport.program_file import ProgramFile
from polishd.model.devices import RobotState

START_S = 1.0
"""So long after being told to run a controller may say that it does not."""


class FileWatch:
    """One program from its load to its end. Times are process time: it stands still while the robot is held.

    What a controller says of itself is for its own kind to understand: it calls ``tick`` and ``record``.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        self.sha256 = plan.program.sha256
        self.blocks = blocks
        self.state: RobotState = "held"
        self.detail = ""
        self.dropped = False
        """Nothing more will be executed of it."""
        self.started = False
        self.file: ProgramFile | None = None
        """What the controller has; None before."""
        self.stopped = ""
        """Why it stands although it was told to run; empty where nobody knows."""
        self.held_at: int | None = None
        """The stop at which it stands; None while it stands elsewhere."""
        self.clock_s = 0.0
        self.began_s = 0.0
        """When the block under way began."""
        self.runs = False
        """It was seen running since it was told to."""
        self._start_s, self._end_s = array("d"), array("d")
        self.seen_s = self._went_s = 0.0

    def __len__(self) -> int:
        return len(self._end_s)

    def __getitem__(self, seq: int) -> Executed:
        return Executed(seq, self._start_s[seq], self._end_s[seq])

    @property
    def ended(self) -> bool:
        """No more records will come."""
        return self.dropped or self.state in ("done", "fault")

    @property
    def refuses(self) -> bool:
        """It was told to run, and had the time to."""
        return self.runs or self.clock_s - self._went_s > START_S

    def progress(self, accepted: int, buffer_s: float) -> RobotProgress:
        """As the port wants it."""
        return RobotProgress(
            state=self.state,
            program_sha256=self.sha256,
            accepted=max(accepted, len(self)),
            executed=len(self),
            buffer_s=buffer_s,
            detail=self.detail,
        )

    def go(self, time_s: float, detail: str = "") -> None:
        """It runs, from that time of its own clock."""
        self.state, self.detail, self.started = "running", detail, True
        self.held_at = None
        self.seen_s, self._went_s, self.runs = time_s, self.clock_s, False

    def drop(self, reason: str) -> None:
        """It will not be gone on with."""
        self.dropped, self.detail = True, reason
        if self.state == "running":
            self.state = "held"

    def tick(self, time_s: float) -> None:
        """It ran until that time of its own clock."""
        self.clock_s += max(time_s - self.seen_s, 0.0)
        self.seen_s = time_s

    def record(self, ends_s: Sequence[float]) -> None:
        """The next blocks are executed, and ended at those process times: rising, the last not after ``clock_s``."""
        self._start_s.extend([self.began_s, *ends_s[:-1]])
        self._end_s.extend(ends_s)
        self.began_s = ends_s[-1]
