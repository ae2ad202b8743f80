"""Progress of a controller in its file from infrequent reports. Sans-IO: reports in, records of blocks out.

A line that is new in a report began some time since the previous report: 100 ms between reports leave 29 ms rms. Within
that interval a block gets its planned time, corrected by the executed blocks. If the controller reports the start time
of its block, that time is used. Errors do not accumulate: each report limits them again.
"""

from __future__ import annotations

import random
import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from polishd.api import DeviceRefused, Plan, ProtocolError
from polishd.config.controller_profile import (
    ClockVariable,
    Flag,
    LineVariable,
    ProgramTable,
    StateVariable,
    Value,
    VariablesTable,
)
from polishd.drivers.plc_robot.variables import VariableSnapshot
from polishd.drivers.transport.program_tracker import START_S, ProgramFile, ProgramTracker, planned_block_s

# The program file: blocks, pauses at the stops, and dwells that check the reported line.

_N_WORD = re.compile(rb"\s*/?\s*N\s*(\d+)", re.IGNORECASE)


class PlcProgramFile(ProgramFile):
    """File with dwells of ``proof_s`` before its first stop, out of contact: see ``LineCheck``."""

    def __init__(
        self,
        blocks: Sequence[bytes],
        stops: Iterable[int],
        table: ProgramTable,
        *,
        line: LineVariable,
        proof_s: Sequence[float] = (),
        pause_at_end: bool = False,
    ) -> None:
        pause = table.pause.encode()
        dwells = [table.dwell.format(seconds=seconds).encode() for seconds in proof_s]
        stops = list(stops)
        first = min((stop for stop in stops if stop > 0), default=0)
        numbered = line.counts == "n_words"
        if pause_at_end and table.last:
            stops.append(_last_block(blocks, table.last.encode()))

        def own(at: int, *lines: bytes) -> list[bytes]:
            return _numbered(lines, blocks[:at]) if numbered else list(lines)

        super().__init__(
            blocks,
            stops,
            lambda stop: own(stop, *(dwells if stop == first else ()), pause),
            lambda end: own(end, pause) if pause_at_end and not table.last else [],
            table.end.encode(),
        )
        if table.line_end == "crlf":
            self.text = b"\r\n".join([*self.lines, b""])
        self.end = max(self.pauses.values()) if pause_at_end else None
        """Number of blocks executed at the pause before the end; None without a pause."""
        proved = self.stops[:1] == (first,)
        self.proof = _dwell_lines(self.inserted, len(dwells)) if proved else ()
        """1-based lines of the dwells."""
        self._first = line.first
        self._numbers = _counted(self.lines, line)

    def block_at(self, line: int) -> int:
        """See ProgramFile; the block before an added dwell ends with the dwell: only then the tool may land."""
        return super().block_at(line) - (line in self.proof)

    def line_of(self, shown: int) -> int:
        """Return the 1-based line of the file for the controller's line; 0 for none."""
        if self._numbers is None:
            return min(max(shown + 1 - self._first, 0), len(self.lines))
        numbers, lines = self._numbers
        at = bisect_right(numbers, shown) - 1
        return lines[at] if at >= 0 else 0


def _last_block(blocks: Sequence[bytes], last: bytes) -> int:
    """Return the block that ends the program. DeviceRefused if there is none."""
    for at in range(len(blocks) - 1, 0, -1):
        if blocks[at].strip() == last:
            return at
    raise DeviceRefused(
        f"the program has no line {last.decode()}, which ends it. Check program.format and the controller's profile."
    )


def _dwell_lines(inserted: Sequence[int], count: int) -> tuple[int, ...]:
    return tuple(index + 1 for index in inserted[:count])


def _numbered(lines: Sequence[bytes], before: Sequence[bytes]) -> list[bytes]:
    """Add N words to the driver's lines, continuing from the last N word before."""
    last = next((int(found[1]) for block in reversed(before) if (found := _N_WORD.match(block))), 0)
    return [b"N%d %s" % (last + k, line) for k, line in enumerate(lines, 1)]


def _counted(lines: Sequence[bytes], line: LineVariable) -> tuple[Sequence[int], Sequence[int]] | None:
    """Return the controller's numbers and their 1-based lines of the file; None if it counts every line."""
    if line.counts == "n_words":
        return _n_words(lines)
    if line.counts == "statements":
        begins = tuple(text.encode() for text in line.counted)
        at = [number for number, text in enumerate(lines, 1) if text.lstrip().startswith(begins)]
    elif line.starts_at:
        start = next((number for number, text in enumerate(lines, 1) if text.strip() == line.starts_at.encode()), None)
        if start is None:
            raise DeviceRefused(
                f"the file has no line {line.starts_at}, from which the controller counts. Check program.format and "
                "the controller's profile."
            )
        at = list(range(start, len(lines) + 1))
    else:
        return None
    return range(line.first, line.first + len(at)), at


def _n_words(lines: Sequence[bytes]) -> tuple[list[int], list[int]]:
    """Return the N words of the file, and their lines. DeviceRefused if they do not increase."""
    numbers: list[int] = []
    at: list[int] = []
    for number, text in enumerate(lines, 1):
        if (found := _N_WORD.match(text)) is None:
            continue
        value = int(found[1])
        if numbers and value <= numbers[-1]:
            raise DeviceRefused(
                f"line {number} of the file: N{value} after N{numbers[-1]}: the controller identifies blocks by their "
                "N words. Number the program in steps of 10."
            )
        numbers.append(value)
        at.append(number)
    return numbers, at


# Check with dwells of known times that the reported line is the executed one. Sans-IO.

REPORTS = (6.0, 12.0)
"""Length of a dwell in reports: long enough to be seen even if reports are missed."""
MORE_S = 1.0
"""Tolerance of a controller's dwell, wall seconds."""
_CHANCE = random.SystemRandom()


def dwells_s(report_s: float, step_s: float = 0.001, count: int = 2) -> list[float]:
    """Return the times of the dwells of one file, s: multiples of the step."""
    return [round(max(round(report_s * _CHANCE.uniform(*REPORTS) / step_s), 1) * step_s, 6) for _ in range(count)]


class LineCheck:
    """Check of the dwells of one file: it gets each reported line with its time, and returns the error."""

    def __init__(self, lines: Sequence[int], seconds: Sequence[float], more_s: float, less_s: float = 0.0) -> None:
        """``lines``: increasing lines of the file; ``more_s``: tolerance of a dwell, controller's time.

        ``less_s``: variation of the age of a report, by which a dwell seems shorter; 0 with the controller's clock.
        """
        self._left = list(zip(lines, seconds, strict=False))
        self._more_s, self._less_s = more_s, less_s
        self._before_s: float | None = None
        """Time of the last report."""
        self._first: tuple[float, float] | None = None
        """(before, at): reports between which the present dwell began."""

    @property
    def over(self) -> bool:
        """Whether the check is complete."""
        return not self._left

    def look(self, line: int, time_s: float) -> str:
        """Process a reported line; return the error, or an empty text."""
        wrong = ""
        while self._left and not wrong and line >= self._left[0][0]:
            dwell, seconds = self._left[0]
            if self._first is None:
                self._first = (time_s if self._before_s is None else self._before_s, time_s)
            if line == dwell:
                break
            wrong = self._judge(dwell, seconds, time_s)
            del self._left[0]
            self._first = None
        self._before_s = time_s
        return wrong

    def _judge(self, dwell: int, seconds: float, now_s: float) -> str:
        if self._first is None or self._before_s is None:
            return ""
        longest_s, least_s = now_s - self._first[0], self._before_s - self._first[1]
        if longest_s >= seconds * 0.99 - self._less_s and least_s <= seconds + self._more_s:
            return ""
        return (
            f"the reported line is not the executed block: a dwell of {seconds:.3f} s, line {dwell} of "
            f"the file, was reported for {max(least_s, 0.0):.3f} to {longest_s:.3f} s"
        )


# Interpretation of a controller's variables by its profile. Sans-IO.

MEANINGS = ("idle", "ready", "running", "paused", "held", "done", "ended", "fault")
LEAST_OVERRIDE = 0.01
"""Share of the programmed feed below which the robot stands still."""


@dataclass(frozen=True, slots=True)
class ControllerReport:
    """State of the controller at one reading."""

    time_s: float
    """Time on the controller's clock, or on its substitute."""
    states: frozenset[str]
    """Possible states: one value may mean several."""
    line: int
    """Line, counted as in the profile's ``line``."""
    line_began_s: float | None = None
    """Start time of the block at that line on the same clock, if the controller reports it."""
    state_began_s: float | None = None
    """Start time of its state, likewise."""
    moving: bool | None = None
    feed_held: bool = False
    override: float = 1.0
    """Feed as a share of the programmed feed."""
    alarm: str = ""
    beat: Value | None = None
    session: str = ""
    loaded: str | None = None

    @property
    def running(self) -> bool:
        """Whether the controller executes its program."""
        return "running" in self.states

    @property
    def stands_still(self) -> bool:
        """Whether all values report standstill."""
        return not self.running and not self.moving

    @property
    def stopped_by(self) -> str:
        """Action of an operator at the controller that prevents motion; empty if there is none."""
        if self.feed_held:
            return "the feed is held at the controller"
        if self.override < LEAST_OVERRIDE:
            return f"the feed override is {100 * self.override:.5g} %"
        return ""


def report_of(table: VariablesTable, reading: VariableSnapshot) -> ControllerReport:
    """Interpret a reading. ProtocolError if a value contradicts the profile."""
    values = reading.values
    line = values["line"]
    if isinstance(line, bool | str | float):
        raise ProtocolError(f"variable line: {line!r} is not a line number. Check the controller's profile.")
    override = values.get("feed_override")
    time_s = _time_of(table.clock, values.get("clock"))
    return ControllerReport(
        time_s=reading.time_s if time_s is None else time_s,
        states=_states(table.state, values["state"]),
        line=max(line, 0),  # some controllers report no line as a negative number
        line_began_s=_line_began(table, reading),
        state_began_s=_time_of(table.state_began, values.get("state_began")),
        moving=_flag(table.in_motion, values.get("in_motion")),
        feed_held=bool(_flag(table.feed_hold, values.get("feed_hold"))),
        override=1.0 if table.feed_override is None else _number(override) / table.feed_override.full,
        alarm=_alarm(values),
        beat=values.get("controller_heartbeat"),
        session=str(values.get("session", "")),
        loaded=str(values["loaded"]) if "loaded" in values else None,
    )


def _states(state: StateVariable, value: Value) -> frozenset[str]:
    named = frozenset(name for name in MEANINGS if any(value == one for one in getattr(state, name)))
    return named or frozenset({"fault"})


def _time_of(clock: ClockVariable | None, value: Value | None) -> float | None:
    return None if clock is None else _number(value) * clock.unit_s


def _line_began(table: VariablesTable, reading: VariableSnapshot) -> float | None:
    if table.line_began is not None:
        return _time_of(table.line_began, reading.values["line_began"])
    if table.line.stamped and table.clock is None:
        return reading.changed_s.get("line")
    return None


def _flag(flag: Flag | None, value: Value | None) -> bool | None:
    return None if flag is None else value == flag.on


def _alarm(values: Mapping[str, Value]) -> str:
    alarm, text = values.get("alarm", 0), str(values.get("alarm_text", ""))
    if not alarm:
        return ""
    if isinstance(alarm, str):
        return alarm
    return f"alarm {alarm}{': ' if text else ''}{text}"


def _number(value: Value | None) -> float:
    if value is None or isinstance(value, str):
        raise ProtocolError(f"{value!r} is not a number. Check the types in the controller's profile.")
    return float(value)


START_REPORTS = 10
"""Number of reports that may show standstill after the command to run."""
SPREAD = 1e-3
"""Share of the time that is spread evenly, so that no block lasts no time at all."""


class PlcProgramTracker(ProgramTracker):
    """Tracker of one program from its load to its end.

    A line counts only after a report that the controller runs: at its start it may show the line of another program.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.file: PlcProgramFile | None = None
        self.proof: LineCheck | None = None
        self.start_s = START_S
        """Time on the controller's clock that may pass with standstill after the command to run."""
        self.stays = False
        """Whether standstill was commanded, and is expected."""
        self._planned_s = planned_block_s(plan, blocks)
        self._sure_s = 0.0
        """Last time at which the present block was certainly under way."""
        self._leeway_s = 0.0
        """Longest delay after ``began_s`` of the start of this stretch's first block."""
        self._last: ControllerReport | None = None
        self._before: ControllerReport | None = None
        """The last report before the command to run."""
        self._waits_s = 0.0
        self._waits = 0
        """Time, and number of reports, of standstill after the command to run."""

    def go(self, time_s: float, detail: str = "") -> None:
        """See ProgramTracker."""
        if self.held_at is not None or not len(self):
            self.began_s = self._sure_s = self.clock_s  # it stood still at the end of a block
        super().go(time_s, detail)
        self.stays, self.stopped = False, self.stopped if detail else ""
        self._before, self._waits_s, self._waits = self._last, 0.0, 0

    def update(self, report: ControllerReport) -> None:
        """Process a report of the controller."""
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
            self._end("fault", report.alarm or "the controller's state is unknown to the profile, or a fault")
        elif report.states & {"done", "ended", "idle", "ready"} and not report.states & {"paused", "held", "running"}:
            self._over(file, report)
        else:
            self._follow(file, report)
            self._stand(file, report, before)

    def _starts(self, report: ControllerReport, before: ControllerReport | None) -> None:
        """Detect the start: reported running, or standing at another line than at the command to run."""
        waited_s = 0.0 if before is None else report.time_s - before.time_s
        was = self._before
        elsewhere = was is not None and (report.line, report.states) != (was.line, was.states)
        if report.running or (elsewhere and report.states & {"paused", "done", "ended"}):
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
        """Record the start, some time since the last report. The end of the first block determines the time."""
        starts_s = (report.state_began_s, report.line_began_s if self._at_first(report) else None)
        start_s = next((at for at in starts_s if at is not None and self.seen_s <= at <= report.time_s), None)
        if start_s is not None:
            self.seen_s = start_s
        elif self.began_s == self.clock_s:
            self.seen_s, self._leeway_s = report.time_s - waited_s, waited_s
        else:
            self.seen_s = report.time_s - waited_s / 2  # in the middle of a block
        self.tick(report.time_s)

    def _at_first(self, report: ControllerReport) -> bool:
        """Whether the present block is the next one to record."""
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
        """Handle two successive reports of standstill: at a pause of the file, or elsewhere."""
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
        """Handle the end of the program: regular if the controller reports it, or stood at the pause before the end."""
        stood = file.end is not None and len(self) >= file.end
        if "done" in report.states or ("ended" in report.states and stood):
            self._advance(self.blocks, None)
            self._end("done", "")
        else:
            self._end("fault", report.alarm or "the program was ended at the controller")

    def _end(self, state: str, detail: str) -> None:
        self.state, self.detail = ("done", "") if state == "done" else ("fault", detail)

    def _advance(self, to: int, began_s: float | None) -> None:
        """Record all blocks below ``to`` as executed; ``began_s``: start time of block ``to``, if known."""
        first = len(self)
        if began_s is not None and not self.began_s <= began_s <= self.clock_s:
            began_s = None
        lasted_s = float(self._planned_s[first:to].sum())
        if to > first or (began_s is not None and to == first):
            self._settle_begin(began_s if lasted_s or to == first else None, lasted_s)
        if to > first:
            low_s = max(self._sure_s, self.began_s)
            high_s = self.clock_s if began_s is None else max(began_s, low_s)
            shares_s, reaches = self._planned_s[first:to], began_s is not None
            self.stretch(shares_s, low_s=low_s, high_s=high_s, reaches=reaches, spread=SPREAD)
        self._sure_s = self.clock_s

    def _settle_begin(self, next_s: float | None, lasted_s: float) -> None:
        """Determine the start of the stretch from the start of the next block, if known."""
        if next_s is not None:
            self.began_s = min(max(next_s - lasted_s, self.began_s), self.began_s + self._leeway_s)
        else:
            self.began_s += self._leeway_s / 2
        self._leeway_s = 0.0
