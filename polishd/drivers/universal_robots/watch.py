"""How far the controller is in our program, and when it did what. Sans-IO: samples in, records out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from polishd.api import Plan, ProtocolError
from polishd.drivers.transport.program_watch import ProgramTracker
from polishd.drivers.universal_robots.sample import RtdeSample, ScriptPhase, UrRuntimeState
from polishd.drivers.universal_robots.script import ScriptLine
from polishd.model.surface import FloatArray

START_S = 5.0
"""So long after its order it may stand yet: our own clock, since samples from before it may come late."""
SILENT_S = 0.1
"""A program that has not run for so long is not there any more, whatever its registers say; the same clock."""
LIVE = (ScriptPhase.WAITS, ScriptPhase.RUNS)


class UrProgramTracker(ProgramTracker):
    """One program from its load to its end.

    A block ends when a sample names a later one; so each boundary is known to one sample, and none is lost between two
    blocks. What two samples in a row say is booked, so that one damaged number does not count blocks that nobody ran.
    """

    def __init__(self, plan: Plan, blocks: int, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__(plan, blocks)
        self.token = 0
        """Of the script that was sent last."""
        self.live = False
        """That script waits or runs on the controller."""
        self.until = 0
        """Blocks below it may begin."""
        self._moves = np.zeros(0, dtype=bool)
        self._dwells = np.zeros(0, dtype=bool)
        self._dwell_s = np.zeros(0)
        self._now_s = now_s
        self._ordered_s = 0.0
        self._turned_s = 0.0
        """When the program ran last."""
        self._last: RtdeSample | None = None

    @property
    def spent_s(self) -> float:
        """Process time that the block under way has had."""
        return self.clock_s - self.began_s

    @property
    def heard(self) -> bool:
        """The script that was sent last has spoken."""
        return self._last is not None

    def sent(self, token: int, blocks: Sequence[ScriptLine]) -> None:
        """A script with that token is on its way; it will wait before its first block."""
        self.token, self.until, self._last, self.live = token, 0, None, False
        self._dwells = np.array([block.dwell_s is not None for block in blocks], dtype=bool)
        self._moves = np.array([block.acts for block in blocks], dtype=bool) & ~self._dwells
        self._dwell_s = np.array([block.dwell_s or 0.0 for block in blocks])

    def ordered(self, until: int) -> None:
        """Told to go on to there."""
        self.until, self._ordered_s = until, self._now_s()
        self.state, self.detail = "running", ""

    def drop(self, reason: str) -> None:
        """It will not be gone on with."""
        super().drop(reason)
        self.live = False

    def update(self, sample: RtdeSample) -> None:
        """Take a sample. ProtocolError where what it says cannot be."""
        if not self.token:
            return
        if sample.token != self.token:
            if self.live:
                self._fail("the controller runs another program, or was started anew")
            return
        before, self._last = self._last, sample
        if before is None or sample.turns != before.turns:
            self._turned_s = sample.time_s
        if before is None:
            self.live = True
        else:
            self._book(before, sample)
        if not self.ended:
            self._judge(before or sample, sample)

    def _book(self, before: RtdeSample, sample: RtdeSample) -> None:
        if not before.block <= sample.block <= self.blocks:
            raise ProtocolError(f"the robot says block {sample.block} of {self.blocks}, after block {before.block}")
        self._advance(before.block)
        if before.phase == ScriptPhase.RUNS or sample.block > before.block:
            self.clock_s += max(sample.time_s - before.time_s, 0.0)

    def _judge(self, before: RtdeSample, sample: RtdeSample) -> None:
        """What state that is, and whether it is one to go on in."""
        match sample.phase:
            case ScriptPhase.DONE if len(self) == self.blocks:
                self.state, self.live = "done", False
            case ScriptPhase.HELD:
                self.state, self.live = "held", False
            case ScriptPhase.LIFTED:
                self.drop("lifted off the path")
        if sample.phase not in LIVE:
            return
        self.live = True
        if why := sample.obstacle():
            self._fail(why)
        elif sample.runtime in (UrRuntimeState.PAUSING, UrRuntimeState.PAUSED):
            self._paused()
        elif sample.runtime == before.runtime == UrRuntimeState.STOPPED:
            self._fail("the program was stopped at the controller")
        elif sample.time_s - self._turned_s > SILENT_S:
            self._fail("the controller runs another program, or ours hangs")
        elif sample.phase == ScriptPhase.WAITS:
            self._waits(sample)
        else:
            self.state, self.detail = "running", ""

    def _waits(self, sample: RtdeSample) -> None:
        """It stands before a block: where it is told to, or because the order has not come through yet."""
        if sample.block >= self.until:
            self.state, self.detail = "held", ""
            return
        if self._now_s() - self._ordered_s > START_S:
            self._fail(f"it does not begin block {sample.block}")

    def _paused(self) -> None:
        """By somebody else. While it runs, the tool may come to stand on the part: nothing is waited for."""
        self.detail = "the program was paused at the controller"
        if self.state == "running":
            self._fail(self.detail)

    def _fail(self, why: str) -> None:
        self.state, self.detail, self.live = "fault", why, False

    def _advance(self, to: int) -> None:
        """All blocks below ``to`` are executed by now."""
        first = len(self)
        if to <= first:
            return
        ends = self.began_s + np.cumsum(self._shares(first, to))
        if (self._moves | self._dwells)[first:to].any():
            ends[-1] = self.clock_s  # what rounding leaves
        self.record(ends.tolist())

    def _shares(self, first: int, to: int) -> FloatArray:
        """(n,) s of each block of one sample: dwells get what they ask for, moves the rest, others nothing."""
        moves, dwells, asked = self._moves[first:to], self._dwells[first:to], self._dwell_s[first:to]
        if not (moves | dwells).any():
            return np.zeros(to - first)
        took_s = self.clock_s - self.began_s
        shares = asked * min(1.0, took_s / asked.sum()) if asked.any() else np.zeros(to - first)
        takers = moves if moves.any() else dwells
        shares[takers] += (took_s - shares.sum()) / np.count_nonzero(takers)
        return np.asarray(shares)
