"""Values of the dashboard beside the live ones: limits, tolerance, progress of the pass and of the phase, time left.

Times left are derived from the journal alone: planned time that is not executed yet, times the pace of earlier passes.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.journal.history import naming_damage, read_only
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME
from polishd.daemon.journal.store import ArrayStore
from polishd.model.devices import SPEED_BAND
from polishd.model.errors import PolishdError

CACHE_S = 2.0
"""Age up to which an answer is given again: many pages cost as much as one."""
EARLIER = 12
"""Number of earlier passes or phases from which a pace is taken."""
MOST_POINTS = 240
"""Most points of a curve."""
LEAST_SHARE = 0.05
"""Share of a pass after which its own pace is used where there is no earlier pass."""
LEAST_ERROR, UNKNOWN_ERROR = 0.02, 0.1
"""Least relative error of a time left, and that where one pass, or none, has shown the pace."""


def unix_s() -> float:
    """Return the Unix time."""
    return time.time()


@dataclass(slots=True)
class _PassProgress:
    """Executed blocks of one pass, read piece by piece: a block is read once."""

    key: tuple[int, int]
    plan: list[tuple[float, int]]
    """Planned time in contact, s, and number of blocks."""
    last_seq: int = -1
    begin_s: float | None = None
    contact_begin_s: float | None = None
    end_s: float = 0.0
    contact_s: float = 0.0
    curve: list[tuple[float, int]] = field(default_factory=list)

    def add(self, rows: Sequence[tuple[int, float, float, int | None]]) -> None:
        """Add blocks: sequence number, begin and end on the robot's process clock, contact."""
        for seq, start_s, end_s, touched in rows:
            self.begin_s = start_s if self.begin_s is None else self.begin_s
            if touched:
                self.contact_begin_s = start_s if self.contact_begin_s is None else self.contact_begin_s
                self.contact_s += end_s - start_s
            self.last_seq, self.end_s = seq, end_s
            self.curve.append((round(end_s - self.begin_s, 3), seq + 1))
        while len(self.curve) > 2 * MOST_POINTS:
            self.curve = [*self.curve[:-1:2], self.curve[-1]]


class Overview:
    """Overview of one cell. Its answers are kept for ``CACHE_S``."""

    def __init__(self, config: CellConfig, clock: Callable[[], float] = unix_s) -> None:
        self._config, self._state_dir, self._clock = config, config.state_dir, clock
        self._store = ArrayStore(self._state_dir / ARRAYS_NAME)
        self._progress: _PassProgress | None = None
        self._limits: tuple[tuple[int, str], dict[str, Any]] | None = None
        self._cached: tuple[float, dict[str, Any]] | None = None

    def facts(self) -> dict[str, Any]:
        """Return limits, tolerance, notifiers, pass and phase; the last two are None where none is under way."""
        now_s = self._clock()
        if self._cached is not None and 0 <= now_s - self._cached[0] < CACHE_S:
            return self._cached[1]
        with naming_damage(self._state_dir):
            found = self._read(now_s)
        self._cached = (now_s, found)
        return found

    def _read(self, now_s: float) -> dict[str, Any]:
        jobs = self._rows("SELECT id, name, part_id, ended FROM job ORDER BY id DESC LIMIT 1")
        if not jobs:
            return {**self._limits_of(0, ""), "at_s": now_s, "job": None, "pass": None, "phase": None}
        number, name, part, ended = jobs[0]
        under_way = ended is None
        phase = self._phase(number, now_s) if under_way else None
        running = self._pass(number, now_s) if under_way else None
        tool = "" if running is None else running.pop("tool")
        job = {"number": number, "job": name, "part": part}
        return {**self._limits_of(number, tool), "at_s": now_s, "job": job, "pass": running, "phase": phase}

    def _limits_of(self, job: int, tool: str) -> dict[str, Any]:
        """Return the limits and the tolerance of a job, which do not change within it."""
        if self._limits is None or self._limits[0] != (job, tool):
            self._limits = (job, tool), self._limits_read(job, tool)
        return self._limits[1]

    def _limits_read(self, job: int, tool: str) -> dict[str, Any]:
        config = self._config
        try:
            for path, content in self._rows("SELECT path, content FROM queue WHERE job = ?", job):
                config = JobFile(Path(path), content).laid_over(config)
            config = config.of_tool(tool) if tool else config
        except PolishdError:  # a job file that the cell does not accept any more: limits of the cell itself
            config = self._config
        force_n, rpm, band = config.process.force_n, config.process.rpm, config.limits.force_band
        return {
            "limits": {
                "force_n": force_n,
                "force_band": band,
                "force_max_n": config.process.force_max_n,
                "rpm": rpm,
                "speed_band": SPEED_BAND,
            },
            "tolerance": [{**asdict(line), "what": line.what, "unit": line.unit} for line in config.lines],
            "passes": config.job.max_cycles,
            "notifiers": [{"name": name, "severity": one.severity} for name, one in self._config.notify.items()],
        }

    def _phase(self, job: int, now_s: float) -> dict[str, Any] | None:
        """Return the phase under way, and how long the last ones of its kind took."""
        sql = "SELECT cycle, phase, started, ended FROM phase WHERE job = ? ORDER BY id DESC LIMIT 1"
        rows = self._rows(sql, job)
        if not rows or rows[0][3] is not None:
            return None
        cycle, phase, started, _ = rows[0]
        sql = "SELECT ended - started FROM phase WHERE phase = ? AND outcome = 'done' ORDER BY id DESC LIMIT ?"
        took = [value for (value,) in self._rows(sql, phase, EARLIER)]
        found = {"cycle": cycle, "phase": phase, "began_s": started, "earlier": len(took), "left": None}
        if took:
            typical_s = statistics.median(took)
            error_s = max(_spread(took), UNKNOWN_ERROR * typical_s)
            found["left"] = {"s": max(typical_s - (now_s - started), 0.0), "error_s": error_s, "basis": "phases"}
        return found

    def _pass(self, job: int, now_s: float) -> dict[str, Any] | None:
        """Return the pass under way: blocks, time in contact, progress and plan, and the time left."""
        sql = (
            "SELECT cycle, blocks, contact_from, facts, started, ended, plan FROM pass WHERE job = ? "
            "ORDER BY cycle DESC LIMIT 1"
        )
        rows = self._rows(sql, job)
        if not rows or rows[0][5] is not None:
            return None
        cycle, blocks, first, text, started, _, plan = rows[0]
        facts = json.loads(text)
        progress = self._progress
        if progress is None or progress.key != (job, cycle):
            progress = self._progress = _PassProgress((job, cycle), self._plan_curve(plan))
        sql = "SELECT seq, start_s, end_s, touched FROM segment WHERE job = ? AND cycle = ? AND seq > ? ORDER BY seq"
        progress.add(self._rows(sql, job, cycle, progress.last_seq))
        dwell_s = float(facts.get("dwell_s") or 0.0)
        begin_s = 0.0 if progress.begin_s is None else progress.begin_s
        offset_s = begin_s if progress.contact_begin_s is None else progress.contact_begin_s
        planned = [(round(offset_s - begin_s + at_s, 3), number) for at_s, number in progress.plan]
        return {
            "cycle": cycle,
            "tool": str(facts.get("tool") or ""),
            "began_s": started,
            "blocks": blocks,
            "contact_from": first,
            "done": progress.last_seq + 1,
            "dwell_s": dwell_s,
            "contact_s": progress.contact_s,
            "executed": progress.curve,
            "planned": planned,
            "behind_s": _behind_s(progress.curve, planned),
            "left": self._remaining(dwell_s, progress.contact_s, now_s - started),
        }

    def _remaining(self, dwell_s: float, contact_s: float, elapsed_s: float) -> dict[str, Any] | None:
        """Return the time until the end of the pass, its error (one standard deviation), and what both rest on."""
        if dwell_s <= 0:
            return None
        paces = self._paces()
        rest_s = max(dwell_s - contact_s, 0.0)
        if len(paces) > 1:
            pace, error, basis = statistics.median(paces), _spread(paces) / statistics.median(paces), "passes"
        elif contact_s > LEAST_SHARE * dwell_s:
            pace, error, basis = elapsed_s / contact_s, UNKNOWN_ERROR, "this pass"
        else:
            pace, error, basis = (paces or [1.0])[0], UNKNOWN_ERROR, "passes" if paces else "plan"
        left_s = rest_s * pace
        return {"s": left_s, "error_s": max(error, LEAST_ERROR) * left_s, "basis": basis, "earlier": len(paces)}

    def _paces(self) -> list[float]:
        """Return the duration over the planned time of the last passes, the newest first."""
        sql = "SELECT ended - started, facts FROM pass WHERE how = 'done' ORDER BY job DESC, cycle DESC LIMIT ?"
        # facts may contain NaN, which json.loads reads and SQLite's JSON functions refuse
        passes = [(took_s, json.loads(text).get("dwell_s") or 0.0) for took_s, text in self._rows(sql, EARLIER)]
        return [took_s / dwell_s for took_s, dwell_s in passes if took_s > 0 and dwell_s > 0]

    def _plan_curve(self, name: str) -> list[tuple[float, int]]:
        """Return the plan's time in contact up to the end of each block, thinned; empty without a plan."""
        if not name:
            return []
        try:
            plan = self._store.get(name)
        except (PolishdError, ValueError, OSError):
            return []
        expected = np.asarray(plan.get("expected_s", plan["time_s"]), dtype=np.float64)
        block, upto_s = np.asarray(plan["block"]), np.cumsum(expected)
        if not block.size:
            return []
        step = max(1, -(-block.size // MOST_POINTS))
        chosen = np.unique(np.append(np.arange(0, block.size, step), block.size - 1))
        return [(round(float(upto_s[k]), 3), int(block[k]) + 1) for k in chosen]

    def _rows(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        if not (self._state_dir / JOURNAL_NAME).exists():
            return []
        with read_only(self._state_dir) as journal, closing(journal.execute(sql, values)) as rows:
            return rows.fetchall()


def _spread(values: Sequence[float]) -> float:
    """Return the standard deviation of values, or 0 for one of them."""
    return statistics.stdev(values) if len(values) > 1 else 0.0


def _behind_s(executed: Sequence[tuple[float, int]], planned: Sequence[tuple[float, int]]) -> float | None:
    """Return by how much the last executed block is later than planned, s; None outside of the planned blocks."""
    if not executed or not planned or not planned[0][1] <= executed[-1][1] <= planned[-1][1]:
        return None
    at_s, block = executed[-1]
    return at_s - float(np.interp(block, [one[1] for one in planned], [one[0] for one in planned]))


def reading_row(
    live: Mapping[str, Any], at_s: float, oldest_s: float
) -> tuple[float, float | None, float | None, float | None]:
    """Return time, force, set point and speed of an answer of the daemon; None where a reading is older."""
    readings = live.get("readings") or {}

    def fresh_value(name: str, key: str) -> float | None:
        one = readings.get(name)
        return None if not one or one.get("age_s", oldest_s) >= oldest_s else one.get(key)

    return (
        round(at_s, 2),
        fresh_value("force", "force_n"),
        fresh_value("force", "setpoint_n"),
        fresh_value("speed", "rpm"),
    )
