"""What a controller that has its program as one file has executed of it, and when. Sans-IO."""

from __future__ import annotations

from polishd.api import Plan
from polishd.drivers.transport.program_file import ProgramFile
from polishd.drivers.transport.program_watch import ProgramTracker

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
