"""How far LinuxCNC is in its file, and when it did what. Sans-IO: snapshots in, records out."""

from __future__ import annotations

import numpy as np

from polishd.api import Plan
from polishd.drivers.linuxcnc.dialogue import RshSnapshot
from polishd.drivers.linuxcnc.program_file import LinuxCncProgramFile
from polishd.drivers.transport.file_watch import FileProgramTracker
from polishd.model.surface import FloatArray

FASTEST = 2.5
"""More than any feed override makes of the planned speed."""
SLACK_S = 0.25
"""Of the plan, and of looks at a busy controller."""


class LinuxCncProgramTracker(FileProgramTracker):
    """One program from its load to its end.

    A block that moves is timed to one look. The blocks of one look share its time: those that dwell get what passed
    at rest, by the time they ask for; in a program that times its feed, the others get nothing.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.file: LinuxCncProgramFile | None = None
        self._asked_s = np.zeros(blocks)
        timed = plan.program.block[plan.program.block < blocks]
        self._asked_s[timed] = plan.program.time_s[: len(timed)]
        self._dwells = plan.program.encoding == "dwell"
        self._rest_s = 0.0
        """When it last moved."""
        self._reached: int | None = None
        self._last: RshSnapshot | None = None

    def go(self, time_s: float, detail: str = "") -> None:
        """It runs, from that time of its own clock."""
        super().go(time_s, detail)
        self._reached = None

    def update(self, look: RshSnapshot) -> None:
        """Take what LinuxCNC was doing just now."""
        moved = self._last is not None and look.moved_since(self._last)
        self._last = look
        if self.file is None or self.ended:
            return
        if self.state != "running":
            self._told_while_held(look)
            return
        self.tick(look.time_s)
        if moved:
            self._rest_s = self.clock_s
        self._hear(self.file, look)
        if look.status == "idle":
            self._idle()
            return
        block = self.file.block_at(look.line)
        if self._can_be_at(block):
            self._advance(block)
        if look.status == "running":
            self.runs = True
        elif not moved:
            self._paused()

    def _can_be_at(self, block: int) -> bool:
        """Whether its motion can be there by now: while it begins to move it reports the line that it has read last."""
        return self.expected_s(block) <= FASTEST * (self.clock_s - self.began_s) + SLACK_S

    def _told_while_held(self, look: RshSnapshot) -> None:
        """Somebody else starts it; or our message comes after the pause, since others stood before it."""
        if not self.started or self.file is None:
            return
        if look.status == "running":
            self.go(look.time_s, "started at the controller")
        if self._hear(self.file, look) and look.status == "paused":
            self._paused()

    def _hear(self, file: LinuxCncProgramFile, look: RshSnapshot) -> bool:
        reached = file.reached(look.display)
        self._reached = self._reached if reached is None else reached
        return reached is not None

    def _idle(self) -> None:
        """It ended, or has not begun. The line that it tells now is the one last read, far ahead of the motion."""
        if self._reached == self.blocks:
            self._advance(self.blocks)
            self.state, self.detail = "done", ""
        elif self.refuses:
            self.state, self.detail = "fault", "the program was ended at the controller"

    def _paused(self) -> None:
        if self._reached is not None:
            self._advance(self._reached)
            self.state, self.detail, self.held_at = "held", "", self._reached
        elif self.refuses:
            self.state, self.detail = "held", "paused"

    def _advance(self, to: int) -> None:
        """All blocks below ``to`` are executed by now."""
        first = len(self)
        if to <= first:
            return
        rest_s = min(max(self._rest_s, self.began_s), self.clock_s)
        shares = _shares(self._asked_s[first:to], self._dwells, rest_s - self.began_s, self.clock_s - rest_s)
        ends = np.minimum(self.began_s + np.cumsum(shares), self.clock_s)
        ends[-1] = self.clock_s
        self.record(ends.tolist())


def _shares(asked_s: FloatArray, dwells: bool, moving_s: float, resting_s: float) -> FloatArray:
    """What of the time in motion and at rest is each block's, (n,) s."""
    timed = asked_s > 0.0
    if timed.all() or not timed.any():
        weights = asked_s if timed.all() else np.ones(len(asked_s))
        return np.asarray((moving_s + resting_s) * weights / weights.sum())
    on_timed = resting_s if dwells else moving_s + resting_s
    shares = on_timed * asked_s / asked_s.sum()
    shares[~timed] = (moving_s + resting_s - on_timed) / np.count_nonzero(~timed)
    return np.asarray(shares)
