"""Progress of the robot in one pass, from the executed blocks and independent of the state that it reports.

A robot that stands in contact, or moves slower than planned, removes more than planned. It may report the state
"running" meanwhile: feed override, interlock, stopped controller. So each block has an expected time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polishd.daemon.cell.time_limits import LOOK_S, TimeLimits, late_s
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import SafetyStop
from polishd.model.program import Plan
from polishd.model.surface import FloatArray
from polishd.process.removal.excess import Excess, ExcessMap
from polishd.process.robot.motion import clock_rate

STEP_S = 0.02
"""Interval of the checks of the time since the last progress."""
MOST_STEP_S = 0.1
"""Longest interval that counts between two such checks: time in which this process did not run does not count."""
AWAY_S = 300.0
"""Longest time without progress while the tool is up: blocks of the approach have no planned time."""
RECENT_S = 0.4
"""Time constant of the mean slowness of the motion."""
FIRST_POINTS = 10
"""Number of points from which the overhead of a machine is estimated in its first pass."""
MOST_OVERHEAD_S = 0.3
"""Largest overhead of a point that is estimated during a pass; set a larger one in machine.block_overhead_s."""
PIECE = 16_384
"""Number of blocks whose expected times are computed at once."""
SLOW = 0.2
"""Relative slowness from which the excess removal is predicted ahead of the tool."""


@dataclass(frozen=True, slots=True)
class ProgressLimits:
    """Limits of the delay of the robot's reports, and of its speed override."""

    late_s: float = 0.3
    """Tolerated time beyond a block's expected time: the age of a report and two checks."""
    start_s: float = 5.0
    """From the command to run until the first block begins."""
    release_s: float = 0.2
    """From leaving contact until the force is off."""
    report_s: float = 0.1
    """Largest age of a report."""
    reports_dwells: bool = True
    """Whether a move is reported before the dwell after it has ended."""
    blur_s: float = 0.0
    """Uncertainty of the reported end of a block, for a clock as fast as the daemon's."""
    least_override: float = 0.0
    knows_overhead: bool = True
    """Whether the planned times contain the overhead of each point, measured in an earlier pass."""

    @classmethod
    def of(
        cls, limits: TimeLimits, least_override: float, no_progress_s: float | None, *, knows_overhead: bool
    ) -> ProgressLimits:
        """Return the limits for a cell with these time limits; ``no_progress_s`` replaces the derived one."""
        late_s = limits.no_progress_s if no_progress_s is None else no_progress_s
        return cls(
            late_s,
            limits.robot.stop_s,
            limits.actuator.release_s,
            limits.robot.report_s,
            limits.robot.reports_dwells,
            limits.end_blur_s,
            least_override,
            knows_overhead,
        )


class Progress:
    """Executed blocks of one pass with the times of their reports, and the excess removal that follows."""

    def __init__(self, plan: Plan, limits: ProgressLimits, excess: ExcessMap | None = None) -> None:
        """``excess`` of the plan's points; without it only a standstill is detected, not slow motion."""
        self._limits = limits
        self._block = plan.program.block
        self._expected_s = expected_block_s(plan, reports_dwells=limits.reports_dwells)
        self._reported = excess
        """Excess by the controller's clock."""
        self._seen = None if excess is None else excess.fresh()
        """Excess by the arrival times of the reports."""
        self._executed = 0
        self._clock_s = 0.0
        """Elapsed time, without the time in which this process did not run."""
        self._looked_s: float | None = None
        self._since_s = 0.0
        """When the robot was commanded to run, or last made progress."""
        self._starting = True
        self._point = 0
        """The first timed point that is not executed yet."""
        self._point_began: tuple[float, float] | None = None
        """When it began, by the controller's clock and by this one."""
        self._took_s, self._points = 0.0, 0
        """Time beyond the planned times, and the number of points."""
        self._slow_s = self._recent_s = self._recent_points = 0.0
        """Excess, expected time and number of the latest points, exponentially weighted."""
        self._first: tuple[float, float] | None = None
        """When the first counted point began, as ``_point_began``."""
        self._new: list[int] = []
        """Points that were not checked yet."""

    @property
    def executed(self) -> int:
        """Number of blocks that the robot has executed, by its latest report."""
        return self._executed

    def start(self, now_s: float) -> None:
        """Note that the robot is commanded to run."""
        self._pass(now_s)
        self._since_s, self._starting = self._clock_s, True
        self._point_began = None

    def reported(self, executed: int, now_s: float) -> None:
        """Update the number of executed blocks from a report."""
        self._pass(now_s)
        if executed > self._executed:
            self._executed, self._since_s, self._starting = executed, self._clock_s, False

    def record(self, block: ExecutedBlock, now_s: float, *, in_contact: bool) -> None:
        """Add a block that the robot reports with its times."""
        self.reported(block.seq + 1, now_s)
        if not in_contact or self._reported is None or self._seen is None:
            return
        began = self._point_began or (block.start_s, self._clock_s)
        self._point_began = began
        while self._point < self._block.size and self._block[self._point] < block.seq:
            self._point += 1  # executed before contact, or not reported separately
        if self._point == self._block.size or self._block[self._point] != block.seq:
            return
        point, expected_s = self._point, float(self._reported.expected_s[self._point])
        reported_s, seen_s = block.end_s - began[0] - expected_s, self._clock_s - began[1] - expected_s
        self._point, self._point_began = point + 1, (block.end_s, self._clock_s)
        if point == 0:  # it begins at rest, off the part, and may start late
            self._first = self._point_began
            return
        self._reported.add(point, reported_s)
        self._seen.add(point, seen_s)
        self._took_s, self._points = self._took_s + reported_s, self._points + 1
        fade = math.exp(-expected_s / RECENT_S)
        self._slow_s = fade * self._slow_s + reported_s
        self._recent_s = fade * self._recent_s + expected_s
        self._recent_points = fade * self._recent_points + 1.0
        self._new.append(point)

    def look(self, now_s: float, *, in_contact: bool) -> None:
        """Raise SafetyStop if the robot, which has to run now, does not advance or has removed too much."""
        self._pass(now_s)
        stood_s = self._clock_s - self._since_s
        if in_contact and (found := self._judged()):
            raise SafetyStop(_slow(found, self._executed))
        if not in_contact:
            if stood_s > AWAY_S:
                raise SafetyStop(self._stands("no expected time", stood_s))
            return
        expected_s = self._expected_of(self._executed) + self._slack_s
        over_s = stood_s - expected_s - late_s(expected_s) - self._limits.late_s
        if self._starting:
            over_s -= self._limits.start_s
        if over_s > 0.0:
            raise SafetyStop(self._stands(f"expected {expected_s:.2f} s", stood_s))
        standing_s = over_s + LOOK_S
        if standing_s <= 0.0 or self._reported is None or self._point >= self._block.size:
            return
        blur_nm = self._blur_nm(self._reported)
        if blur_nm is None:
            return
        if found := self._reported.beyond(self._point, standing_s, allowed_nm=blur_nm, overhead_s=self._overhead_s):
            beyond = f", {found.excess_nm:.1f} nm beyond the plan, at most {found.limit_nm:.1f} nm (limits.excess_nm)"
            raise SafetyStop(self._stands(f"expected {expected_s:.2f} s", stood_s, beyond))

    @property
    def worst(self) -> float:
        """Largest excess removal of all points, as a share of its limit."""
        return 0.0 if self._reported is None else self._reported.worst(self._overhead_s)

    @property
    def _overhead_s(self) -> float:
        """Time of a point beyond its planned time, estimated in this pass if no earlier pass gives it."""
        if self._limits.knows_overhead or not self._points:
            return 0.0
        return min(max(self._took_s / self._points, 0.0), MOST_OVERHEAD_S)

    @property
    def _slack_s(self) -> float:
        """The same; its upper limit until enough points are executed."""
        if self._limits.knows_overhead:
            return 0.0
        return self._overhead_s if self._points >= FIRST_POINTS else MOST_OVERHEAD_S

    def _pass(self, now_s: float) -> None:
        if self._looked_s is not None:
            self._clock_s += min(max(now_s - self._looked_s, 0.0), MOST_STEP_S)
        self._looked_s = now_s

    def _expected_of(self, block: int) -> float:
        return float(self._expected_s[min(block, self._expected_s.size - 1)]) if self._expected_s.size else 0.0

    def _judged(self) -> Excess | None:
        """Return excess removal beyond its limit at the new points; if motion is slow, also until force off."""
        reported, seen, points, self._new = self._reported, self._seen, self._new, []
        if reported is None or seen is None or not points:
            return None
        if not self._limits.knows_overhead and self._points < FIRST_POINTS:
            return None
        if (blur_nm := self._blur_nm(reported)) is None:
            return None
        allowed_nm, last, own_s = blur_nm + seen.peak_nm_s * self._limits.late_s, points[-1], self._overhead_s
        judged: int | None = None
        for point in points:
            if point != last and judged is not None and not reported.far(point, judged):
                continue
            judged = point
            if found := reported.beyond(point, allowed_nm=blur_nm, overhead_s=own_s) or seen.beyond(
                point, allowed_nm=allowed_nm, overhead_s=own_s
            ):
                return found
        slow = (self._slow_s - own_s * self._recent_points) / self._recent_s if self._recent_s > 0.0 else 0.0
        return self._ahead(reported, last, slow, blur_nm) if slow > SLOW else None

    def _blur_nm(self, excess: ExcessMap) -> float | None:
        """Return the removal that corresponds to the uncertainty of the reported times; None while it is unknown.

        The clock of a simulated controller may be faster than this one, which scales the intervals of its reports.
        """
        blur_s = self._limits.blur_s
        if not blur_s:
            return 0.0
        if self._first is None or self._point_began is None:
            return None
        process_s, wall_s = self._point_began[0] - self._first[0], self._clock_s - self._first[1]
        most = clock_rate(process_s, wall_s, self._limits.report_s)
        return None if most is None else blur_s * max(most, 1.0) * excess.peak_nm_s

    def _ahead(self, excess: ExcessMap, point: int, slow: float, blur_nm: float) -> Excess | None:
        """Return the excess removal at force off, if motion stays as slow."""
        left_s = self._limits.release_s + LOOK_S
        counted: list[tuple[int, float]] = []
        for later in range(point + 1, excess.n):
            if left_s <= 0.0:
                break
            takes_s = float(excess.expected_s[later]) * (1.0 + slow)
            counted.append((later, min(takes_s, left_s) * slow / (1.0 + slow)))
            left_s -= takes_s
        for later, more_s in counted:
            excess.add(later, more_s, times=0)
        allowed = {"allowed_nm": blur_nm, "overhead_s": self._overhead_s}
        found = next((found for later, _ in counted if (found := excess.beyond(later, **allowed))), None)
        for later, more_s in counted:
            excess.add(later, -more_s, times=0)
        return found

    def _stands(self, expected: str, stood_s: float, beyond: str = "") -> str:
        return (
            f"robot does not advance: block {self._executed} {expected}, no progress for {stood_s:.1f} s{beyond}. "
            "Check the feed override, the interlocks and the state of the robot's controller"
        )


def expected_block_s(plan: Plan, *, reports_dwells: bool = True) -> FloatArray:
    """Return the expected time of each block up to the end of contact, (contact_blocks,) s.

    A block without a programmed time leads to a timed point. If a dwell carries the time, the block's expected time is
    the point's time without the dwell; otherwise the point's time plus the time of the way there at the same speed. If
    the robot does not report a dwell separately from the move before it, the move's time contains the dwell. The
    removal planned for the dwell happens at that point anyway, so a robot that stands in the move removes no more.
    """
    program, expected = plan.program, plan.expected_time_s
    found = np.zeros(plan.contact_blocks)
    if not expected.size:
        return found
    for first in range(0, plan.contact_blocks, PIECE):  # limits the memory for a long program
        blocks = np.arange(first, min(first + PIECE, plan.contact_blocks))
        point = np.minimum(np.searchsorted(program.block, blocks), expected.size - 1)
        if program.encoding == "dwell":
            leading = np.maximum(expected[point] - program.time_s[point], 0.0)
            if not reports_dwells:
                leading = np.where(program.block[point] == blocks + 1, expected[point], leading)
        else:
            way = np.linalg.norm(program.start_mm[point] - program.end_mm[np.maximum(point - 1, 0)], axis=1)
            way[point == 0] = 0.0
            length = np.linalg.norm(program.end_mm[point] - program.start_mm[point], axis=1)
            leading = expected[point] * (1.0 + np.divide(way, length, out=np.zeros_like(way), where=length > 0.0))
        found[blocks] = np.where(program.block[point] == blocks, expected[point], leading)
    return found


def low_override(robot: RobotProgress, least: float) -> str:
    """Return the message for an override or a measured speed below ``least``; empty if high enough or unknown."""
    if robot.override is not None and robot.override < least:
        return (
            f"the robot's speed override is {100 * robot.override:.5g}%, at least {100 * least:.5g}% is needed "
            "(robot.least_override): slower motion removes more than planned. Set the override to 100% at the "
            "controller"
        )
    if robot.measured_speed is not None and robot.measured_speed < least:
        reported = "no override" if robot.override is None else f"an override of {100 * robot.override:.5g}%"
        return (
            f"the robot moves at {100 * robot.measured_speed:.3g}% of the programmed speed at most and reports "
            f"{reported}; at least {100 * least:.5g}% is needed (robot.least_override): slower motion removes more "
            "than planned. Check the overrides and the speed limits at the controller"
        )
    return ""


def _slow(found: Excess, executed: int) -> str:
    return (
        f"the robot is slower than planned: {found.excess_nm:.1f} nm beyond the plan at x {found.x_mm:.1f}, y "
        f"{found.y_mm:.1f} mm after block {executed}, at most {found.limit_nm:.1f} nm (limits.excess_nm). Check the "
        "feed override, and the machine's feed and acceleration limits"
    )
