"""How far LinuxCNC is in its file, and when it did what. Sans-IO: snapshots in, records out."""

from __future__ import annotations

from array import array

import numpy as np

from polishd.api import Executed, Plan, RobotProgress
from polishd.drivers.linuxcnc.dialogue import Snapshot
from polishd.drivers.linuxcnc.program_file import ProgramFile
from polishd.model.devices import RobotState
from polishd.model.surface import FloatArray

START_S = 1.0
"""So long after being told to run it may say that it does not."""


class Watch:
    """One program from its load to its end. Times are process time: it stands still while the robot is held.

    A block that moves is timed to one look. The blocks of one look share its time: those that dwell get what passed
    at rest, by the time they ask for; in a program that times its feed, the others get nothing.
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
        self.held_at: int | None = None
        """The stop at which it stands; None while it stands elsewhere."""
        self._asked_s = np.zeros(blocks)
        timed = plan.program.block[plan.program.block < blocks]
        self._asked_s[timed] = plan.program.time_s[: len(timed)]
        self._dwells = plan.program.encoding == "dwell"
        self._start_s, self._end_s = array("d"), array("d")
        self._clock_s = self._seen_s = self._went_s = 0.0
        self._rest_s = 0.0
        """When it last moved."""
        self._began_s = 0.0
        self._reached: int | None = None
        self._runs = False
        self._last: Snapshot | None = None

    def __len__(self) -> int:
        return len(self._end_s)

    def __getitem__(self, seq: int) -> Executed:
        return Executed(seq, self._start_s[seq], self._end_s[seq])

    @property
    def ended(self) -> bool:
        """No more records will come."""
        return self.dropped or self.state in ("done", "fault")

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
        self.held_at = self._reached = None
        self._seen_s, self._went_s, self._runs = time_s, self._clock_s, False

    def drop(self, reason: str) -> None:
        """It will not be gone on with."""
        self.dropped, self.detail = True, reason
        if self.state == "running":
            self.state = "held"

    def update(self, look: Snapshot) -> None:
        """Take what LinuxCNC was doing just now."""
        moved = self._last is not None and look.moved_since(self._last)
        self._last = look
        if self.file is None or self.ended:
            return
        if self.state != "running":
            self._told_while_held(look)
            return
        self._clock_s += max(look.time_s - self._seen_s, 0.0)
        self._seen_s = look.time_s
        if moved:
            self._rest_s = self._clock_s
        self._hear(self.file, look)
        if look.status == "idle":
            self._idle()
            return
        self._advance(self.file.block_at(look.line))
        if look.status == "running":
            self._runs = True
        elif not moved:
            self._paused()

    def _told_while_held(self, look: Snapshot) -> None:
        """Somebody else starts it; or our message comes after the pause, since others stood before it."""
        if not self.started or self.file is None:
            return
        if look.status == "running":
            self.go(look.time_s, "started at the controller")
        if self._hear(self.file, look) and look.status == "paused":
            self._paused()

    def _hear(self, file: ProgramFile, look: Snapshot) -> bool:
        reached = file.reached(look.display)
        self._reached = self._reached if reached is None else reached
        return reached is not None

    def _idle(self) -> None:
        """It ended, or has not begun. The line that it tells now is the one last read, far ahead of the motion."""
        if self._reached == self.blocks:
            self._advance(self.blocks)
            self.state, self.detail = "done", ""
        elif self._runs or self._clock_s - self._went_s > START_S:
            self.state, self.detail = "fault", "the program was ended at the controller"

    def _paused(self) -> None:
        if self._reached is not None:
            self._advance(self._reached)
            self.state, self.detail, self.held_at = "held", "", self._reached
        elif self._runs or self._clock_s - self._went_s > START_S:
            self.state, self.detail = "held", "paused"

    def _advance(self, to: int) -> None:
        """All blocks below ``to`` are executed by now."""
        first = len(self)
        if to <= first:
            return
        rest_s = min(max(self._rest_s, self._began_s), self._clock_s)
        shares = _shares(self._asked_s[first:to], self._dwells, rest_s - self._began_s, self._clock_s - rest_s)
        ends = np.minimum(self._began_s + np.cumsum(shares), self._clock_s)
        ends[-1] = self._clock_s
        self._start_s.extend([self._began_s, *ends[:-1].tolist()])
        self._end_s.extend(ends.tolist())
        self._began_s = self._clock_s


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
