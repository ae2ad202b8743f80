"""How far a controller is in its file, and when it did what, from reports far apart. Sans-IO: reports in, records out.

A line that is new in a report began some time since the report before: 100 ms between reports leave 29 ms rms. Within
that, a block is taken to have lasted as long as the plan expects of it, which what was executed has taught; where the
controller tells when its block began, that is taken. Neither error adds up: each report bounds it anew.
"""

from __future__ import annotations

import numpy as np

from polishd.api import Plan
from polishd.drivers.handover.program_file import PlcProgramFile
from polishd.drivers.handover.proof import LineCheck
from polishd.drivers.handover.report import ControllerReport
from polishd.drivers.transport.file_watch import START_S, FileProgramTracker
from polishd.model.surface import FloatArray

START_REPORTS = 10
"""And for so many reports it may say that it does not run, after being told to."""
SPREAD = 1e-3
"""Share of the time that is spread evenly, so that no block lasts no time at all."""


class PlcProgramTracker(FileProgramTracker):
    """One program from its load to its end.

    A line counts only if the controller was seen running before: what it shows as it starts may be of another program.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.file: PlcProgramFile | None = None
        self.proof: LineCheck | None = None
        self.start_s = START_S
        """So long after being told to run it may say that it does not, by its own clock."""
        self.stays = False
        """It was told to stand: nobody wonders that it does."""
        self._expected_s = np.zeros(blocks)
        timed = plan.program.block < blocks
        self._expected_s[plan.program.block[timed]] = plan.expected_time_s[timed]
        self._sure_s = 0.0
        """When the block under way was last known to be so."""
        self._leeway_s = 0.0
        """By how much later than ``began_s`` the first block of this stretch may have begun."""
        self._last: ControllerReport | None = None
        self._before: ControllerReport | None = None
        """The report before it was told to run."""
        self._waits_s = 0.0
        self._waits = 0
        """How long, and for how many reports, it was told to run and does not."""

    def go(self, time_s: float, detail: str = "") -> None:
        """It runs, from that time of its own clock."""
        if self.held_at is not None or not len(self):
            self.began_s = self._sure_s = self.clock_s  # it stood at the end of a block
        super().go(time_s, detail)
        self.stays, self.stopped = False, self.stopped if detail else ""
        self._before, self._waits_s, self._waits = self._last, 0.0, 0

    def update(self, report: ControllerReport) -> None:
        """Take what the controller was doing just now."""
        before, self._last = self._last, report
        file = self.file
        if file is None or self.ended:
            return
        if self.state != "running":
            if self.started and report.running:
                self.go(report.time_s, "started at the controller")
            return
        if not self.runs:
            self._starts(report, before)
            return
        self.tick(report.time_s)
        if "fault" in report.states:
            self._end("fault", report.alarm or "the controller is in a state that the profile calls none, or a fault")
        elif report.states & {"done", "ended", "idle", "ready"} and not report.states & {"paused", "held", "running"}:
            self._over(file, report)
        else:
            self._follow(file, report)
            self._stand(file, report, before)

    def _starts(self, report: ControllerReport, before: ControllerReport | None) -> None:
        """Seen running, or standing where it did not stand when it was told to run."""
        waited_s = 0.0 if before is None else report.time_s - before.time_s
        was = self._before
        elsewhere = was is not None and (report.line, report.states) != (was.line, was.states)
        if report.running or (elsewhere and report.states & {"paused", "done"}):
            self.runs = True
            self._begin(report, waited_s)
            return
        self.seen_s = report.time_s
        self._waits_s += waited_s
        self._waits += 1
        if "fault" in report.states:
            self._end("fault", report.alarm or "the controller is in fault")
        elif self._waits_s > self.start_s and self._waits > START_REPORTS:
            self._held(report, "it does not start")

    def _begin(self, report: ControllerReport, waited_s: float) -> None:
        """It began at some time since the last report: when, is settled with the end of its first block."""
        told = (report.state_began_s, report.line_began_s if self._at_first(report) else None)
        told_s = next((at for at in told if at is not None and self.seen_s <= at <= report.time_s), None)
        if told_s is not None:
            self.seen_s = told_s
        elif self.began_s == self.clock_s:
            self.seen_s, self._leeway_s = report.time_s - waited_s, waited_s
        else:
            self.seen_s = report.time_s - waited_s / 2  # in the middle of a block
        self.tick(report.time_s)

    def _at_first(self, report: ControllerReport) -> bool:
        """The block under way is the one that comes next."""
        return self.file is not None and self.file.block_at(self.file.line_of(report.line)) == len(self)

    def _follow(self, file: PlcProgramFile, report: ControllerReport) -> None:
        line = file.line_of(report.line)
        began_s = None if report.line_began_s is None else self.clock_s - (report.time_s - report.line_began_s)
        if self.proof is not None and not self.proof.over and (wrong := self.proof.look(line, report.time_s)):
            self._end("fault", wrong)
            return
        if line:
            self._advance(file.block_at(line), began_s)

    def _stand(self, file: PlcProgramFile, report: ControllerReport, before: ControllerReport | None) -> None:
        """Two reports in a row that it does not run: at a pause of the file, or elsewhere."""
        if report.running and not report.stopped_by:
            return
        if report.stopped_by and not self.stays:
            self._held(report, report.stopped_by)
        elif not report.running and before is not None and not before.running:
            line = file.line_of(report.line)
            stop = file.pauses.get(line, file.pauses.get(line - 1))
            if stop is not None and stop == len(self) and "paused" in report.states and not report.feed_held:
                self.state, self.detail, self.held_at = "held", "", stop
            else:
                self._held(report, "it was held at the controller")

    def _held(self, report: ControllerReport, why: str) -> None:
        self.state = "held"
        self.detail = report.alarm or ("hold" if self.stays else why)
        if not self.stays:
            self.stopped = self.detail

    def _over(self, file: PlcProgramFile, report: ControllerReport) -> None:
        """It ended. By itself: where it says so, or where it stood at the pause before its end."""
        stood = file.end is not None and len(self) >= file.end
        if "done" in report.states or ("ended" in report.states and stood):
            self._advance(self.blocks, None)
            self._end("done", "")
        else:
            self._end("fault", report.alarm or "the program was ended at the controller")

    def _end(self, state: str, detail: str) -> None:
        self.state, self.detail = ("done", "") if state == "done" else ("fault", detail)

    def _advance(self, to: int, began_s: float | None) -> None:
        """All blocks below ``to`` are executed by now; the one there began at ``began_s``, where that is known."""
        first = len(self)
        if began_s is not None and not self.began_s <= began_s <= self.clock_s:
            began_s = None
        lasted_s = float(self._expected_s[first:to].sum())
        if to > first or (began_s is not None and to == first):
            self._settle_begin(began_s if lasted_s or to == first else None, lasted_s)
        if to > first:
            low_s = max(self._sure_s, self.began_s)
            high_s = self.clock_s if began_s is None else max(began_s, low_s)
            ends = between(self.began_s, self._expected_s[first:to], low_s, high_s, reaches=began_s is not None)
            self.record(ends.tolist())
        self._sure_s = self.clock_s

    def _settle_begin(self, next_s: float | None, lasted_s: float) -> None:
        """When the stretch began, where the reports leave that open: so long before the next block began, if known."""
        if next_s is not None:
            self.began_s = min(max(next_s - lasted_s, self.began_s), self.began_s + self._leeway_s)
        else:
            self.began_s += self._leeway_s / 2
        self._leeway_s = 0.0


def between(
    began_s: float, expected_s: FloatArray, low_s: float, high_s: float, *, reaches: bool = False
) -> FloatArray:
    """Ends of n blocks in a row, (n,) s, rising: as expected (n,), within the two reports that they lie between.

    Args:
        began_s: When the first began, at most ``low_s``.
        expected_s: How long each is expected to last; none at all: all alike.
        low_s: None had ended by then.
        high_s: All have ended by then.
        reaches: The last ended at ``high_s``.
    """
    count = len(expected_s)
    even = np.arange(1, count + 1) / count
    total_s = float(expected_s.sum())
    if total_s > 0.0:
        ends = began_s + np.cumsum(expected_s)
        if reaches or ends[-1] > high_s:
            ends = began_s + np.cumsum(expected_s) * (high_s - began_s) / total_s
    else:
        ends = began_s + (high_s - began_s) * even
    ends = np.clip(ends, low_s, high_s)
    if reaches:
        ends[-1] = high_s
    return np.asarray((1.0 - SPREAD) * ends + SPREAD * (low_s + (high_s - low_s) * even))
