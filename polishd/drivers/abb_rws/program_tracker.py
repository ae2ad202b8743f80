"""Progress of an ABB controller in its module. Sans-IO: reports in, records of executed blocks out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from polishd.api import Plan, ProtocolError
from polishd.drivers.abb_rws.rapid_module import AT_END, RapidModule
from polishd.drivers.transport.program_tracker import ProgramTracker, planned_block_s

START_S = 5.0
"""Time that may pass with standstill after the command to run, on our clock."""
SPREAD = 1e-3
"""Share of the time that is spread evenly, so that no block lasts no time at all."""
MODES = {"AUTO": "", "MANR": "manual mode", "MANF": "manual full-speed mode"}
STATES = {
    "motoroff": "its motors are off", "guardstop": "its safeguard stop is active",
    "emergencystop": "its emergency stop is pressed", "emergencystopreset": "its emergency stop waits for motors on",
    "sysfail": "it has a system failure", "init": "it starts up",
}  # fmt: skip
LIMIT_SHARE = 1e-3
"""Share by which the background task's limit may differ from the number that was written."""
LEAST_OVERRIDE = 0.01
"""Share of the programmed speed below which the robot stands still."""


@dataclass(frozen=True, slots=True)
class RwsReport:
    """What the controller reported last, when this was made."""

    running: bool
    """Whether it runs its normal tasks."""
    moved: bool = True
    """Whether its joints have moved between the last two readings; True until two readings while no program runs."""
    state: str = "motoron"
    mode: str = "AUTO"
    speed: float = 1.0
    """Speed ratio, as a share of the programmed speed."""
    count: int = 0
    """Number of the program's last report."""
    count_s: float = 0.0
    """Time of that report on the program's clock."""
    token: int = 0
    stop: int = -1
    """Block before which the program stops next or stands."""
    tripped: bool = False
    """Its background task has stopped the motion."""
    limit_s: float = 0.0
    """Longest silence of polishd's heartbeat that the background task permits; 0: any."""

    def obstacle(self) -> str:
        """Return why it would not run a program; empty if it would."""
        if self.mode != "AUTO":
            return f"it is in {MODES.get(self.mode) or f'mode {self.mode}'} (switch it to automatic at the robot)"
        if self.state != "motoron":
            return STATES.get(self.state, f"its state is {self.state!r}")
        return ""

    def other_limit(self, limit_s: float) -> str:
        """Return how the background task's limit differs from the one that was written; empty if it does not."""
        if abs(self.limit_s - limit_s) <= LIMIT_SHARE * limit_s:
            return ""
        return (
            f"its background task reports a limit of {self.limit_s:g} s (polishd_limit), "
            f"and polishd wrote {limit_s:g} s (robot.watchdog_s). Install polishd_watch.mod as shipped, "
            "and let no other client write polishd_limit"
        )


class AbbProgramTracker(ProgramTracker):
    """Tracker of one program from its load to its end.

    A report's number says which blocks are executed, its time when: reports that the link leaves out cost no block.
    """

    def __init__(self, plan: Plan, blocks: int, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__(plan, blocks)
        self.file: RapidModule | None = None
        self.limit_s = 0.0
        """Limit that was written to the background task."""
        self.stays = False
        """Whether standstill was commanded, and is expected."""
        self._planned_s = planned_block_s(plan, blocks)
        self._now_s = now_s
        self._ordered_s = 0.0
        self._last: RwsReport | None = None
        self._before: RwsReport | None = None
        """The last report before the command to run."""
        self._count = 0
        """Number of the last report."""
        self._offset_s = 0.0
        """Process time less the program's clock."""

    def go(self, time_s: float, detail: str = "") -> None:
        """See ProgramTracker."""
        super().go(time_s, detail)
        self.stays, self._ordered_s, self._before = False, self._now_s(), self._last

    def update(self, report: RwsReport) -> None:
        """Process a report of the controller. ProtocolError if it is impossible."""
        module = self.file
        if module is None:
            return
        self._last = report
        if self.ended or not self.started:
            return
        if report.token != module.token:
            self._fail("the controller runs another program, or has restarted")
        elif report.count < self._count:
            self._fail("the program was started from its beginning at the controller")
        else:
            self._follow(module, report)
            self._judge(module, report)

    def _judge(self, module: RapidModule, report: RwsReport) -> None:
        """Set the state, and end the program if it cannot continue."""
        if self.state != "running":
            if report.running:
                self.go(report.count_s, "started at the controller")
            return
        if not self.runs:
            self._starts(report)
        if report.tripped:
            self._fail("its background task stopped the motion: polishd's heartbeat did not arrive in time")
        elif why := report.obstacle() or report.other_limit(self.limit_s):
            self._fail(why)
        elif report.speed < LEAST_OVERRIDE and not self.stays:
            self._held(f"the speed ratio is {100 * report.speed:.5g} %")
        elif self.runs and not report.running:
            self._stand(module, report)

    def _starts(self, report: RwsReport) -> None:
        """Detect the start: reported running, or elsewhere than at the command to run."""
        was = self._before
        is_elsewhere = was is not None and (report.count, report.stop) != (was.count, was.stop)
        if report.running or is_elsewhere:
            self.runs = True
        elif self._now_s() - self._ordered_s > START_S:
            self._held("it does not start")

    def _follow(self, module: RapidModule, report: RwsReport) -> None:
        """Record the blocks that a new report says are executed."""
        if not 0 <= report.count <= module.last_report:
            raise ProtocolError(f"the robot reports point {report.count} of {module.last_report}")
        self._count = report.count
        now_s = report.count_s + self._offset_s
        done = module.done_after[report.count]
        if done <= len(self):
            if report.count_s > self.seen_s:  # it goes on from a stop: no block had the time until then
                self._offset_s -= max(now_s - self.clock_s, 0.0)
            self.seen_s = report.count_s
            return
        self.clock_s, self.seen_s = max(now_s, self.began_s), report.count_s
        self._advance(done)

    def _advance(self, to: int) -> None:
        first = len(self)
        if to > first:
            self.stretch(self._planned_s[first:to], spread=SPREAD)

    def _stand(self, module: RapidModule, report: RwsReport) -> None:
        """Handle standstill: at a stop of the module, at its end, or elsewhere."""
        if report.stop == AT_END and len(self) >= self.blocks:
            self.state, self.detail = "done", ""
        elif report.stop in module.stops and report.stop >= len(self):
            self.clock_s = self.began_s
            self._advance(report.stop)
            self.state, self.detail, self.held_at = "held", "", report.stop
        else:
            self._held("hold" if self.stays else "the program was stopped at the controller")

    def _held(self, why: str) -> None:
        self.state, self.detail = "held", why
        if not self.stays:
            self.stopped = why

    def _fail(self, why: str) -> None:
        self.state, self.detail = "fault", why
