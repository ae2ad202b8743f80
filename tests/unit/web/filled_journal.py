"""Write a cell's journal of months for the tests of the page: parts with maps and passes, a queue, a waiting plan."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.cell import CellConfig
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME
from polishd.daemon.journal.store import ArrayStore, Row, Store
from polishd.model.events import CommandReceived, Event, PlanApproved, PlanAwaitingApproval
from polishd.model.tolerance import LineResult
from polishd.pipeline.records import npz

NOW_S = 1_795_910_400.0
"""2026-11-29 0:00 UTC."""
HOUR_S, DAY_S = 3600.0, 86400.0
LIMIT_NM = 2.0
ENDS = {"accepted": "in_tolerance", "rejected": "cycles_used", "set aside": "set aside"}
JOB = "INSERT INTO job (id, name, part_id, terms, started, ended, outcome, run_dir) VALUES (?,?,?,'null',?,?,?,?)"
MAP = "INSERT INTO map (job, cycle, sha256, path, stats, taken, arrays) VALUES (?,?,?,'',?,?,?)"
PASS = (
    "INSERT INTO pass (job, cycle, program_sha256, boot_id, blocks, contact_from, contact_to, facts, started, ended, "
    "how, plan) VALUES (?,?,?,'boot',2500,40,2400,?,?,?,'done',?)"
)
EVENT = "INSERT INTO event (job, at, cycle, name, data) VALUES (?,?,?,?,?)"
QUEUE = (
    "INSERT INTO queue (place, name, part_id, path, content, files, added, job, begun, ended, verdict, reason) "
    "VALUES (?,?,?,?,?,?,?,?,?,?,?,?)"
)


def stats_of(rms_nm: float) -> dict[str, Any]:
    """Return the facts of a map."""
    judged = [LineResult("RMS", rms_nm, LIMIT_NM, "nm", 0.1).facts()]
    return {"rms_nm": rms_nm, "pv_nm": 6.1 * rms_nm, "lsf_rms_nm": 0.7 * rms_nm, "band_rms_nm": None, "judged": judged}


def figures_of(before_nm: float, after_nm: float, program: str = "") -> dict[str, Any]:
    """Return the figures of a plan as ``plan_figures`` makes them."""
    limits = [
        ("limits.max_removal_nm", 8.0 * before_nm, 1000.0, "nm", False),
        ("limits.max_pass_s", 1260.0 * before_nm / 18, 86400.0, "s", False),
        ("machine.min_feed_mm_s", 1.2, 0.05, "mm/s", True),
        ("machine.max_feed_mm_s", 19.4, 20.0, "mm/s", False),
        ("machine.x_mm", -52.0, -150.0, "mm", True),
        ("machine.x_mm", 52.0, 150.0, "mm", False),
    ]
    note = "the path leaves a ripple of 0.42 nm RMS (1.50 mm across, amplitude 0.58 nm), 0.83 nm with a spot off by 3 %"
    return {
        "before_rms_nm": before_nm,
        "predicted_rms_nm": after_nm,
        "predicted_pv_nm": 5.0 * after_nm,
        "expected_nm": [0.8 * after_nm, 1.9 * after_nm],
        "level": 0.9,
        "better": 0.98,
        "ripple_rms_nm": 0.42,
        "ripple_rms_high_nm": 0.83,
        "ripple": "1.50 mm across, amplitude 0.58 nm",
        "removal_mean_nm": 3.2 * before_nm,
        "removal_max_nm": 8.0 * before_nm,
        "removal_mm3": 2.1e-2 * before_nm,
        "dwell_s": 1260.0 * before_nm / 18,
        "points": 2360,
        "points_at_least_time": 12,
        "force_n": 12.0,
        "rpm": 800.0,
        "limits": [dict(zip(("key", "value", "limit", "unit", "least"), one, strict=True)) for one in limits],
        "notes": [note],
    }


def facts_of(before_nm: float, predicted_nm: float, measured_nm: float) -> dict[str, Any]:
    """Return the facts of a pass."""
    figures = figures_of(before_nm, predicted_nm)
    low, high = figures["expected_nm"]
    shown = {"contact_s": figures["dwell_s"], "expected_nm": [low, high], "seen_nm": measured_nm,
             "rate": {"value": 0.95, "sigma": 0.02}}  # fmt: skip
    forecast = {"low_nm": low, "median_nm": predicted_nm, "high_nm": high, "level": 0.9, "better": 0.98}
    certificate = {"predicted_rms_nm": predicted_nm, "solver": "newton_cg", "dwell_total_s": figures["dwell_s"]}
    return {
        "predicted_rms_nm": predicted_nm,
        "dwell_s": figures["dwell_s"],
        "forecast": forecast,
        "certificate": certificate,
        "shown": shown,
        "plan_figures": figures,
    }


@dataclass
class FilledCell:
    """Rows and arrays of one cell's journal, written at the end by ``write``."""

    config: CellConfig
    maps: bool = True
    """Whether maps and plans have arrays; without them a history is written in a second."""
    rows: list[Row] = field(default_factory=list)
    jobs: int = 0
    places: int = 0

    def part(self, name: str, at_s: float, rms_nm: list[float], result: str = "accepted", hours: float = 2.0) -> int:
        """Add a job with these measurements and a pass between two; return its number. "under way": not ended."""
        self.jobs += 1
        number, ended = self.jobs, None if result == "under way" else at_s + hours * HOUR_S
        run_dir = f"runs/{name}"
        outcome = None if ended is None else ENDS[result]
        self.rows.append((JOB, (number, name, f"part-{name}", at_s, ended, outcome, run_dir)))
        for cycle, value in enumerate(rms_nm):
            taken = at_s + cycle * hours * HOUR_S / len(rms_nm)
            arrays = self.surface(value, number + cycle) if self.maps else ""
            self.rows.append((MAP, (number, cycle, f"{number}-{cycle}", json.dumps(stats_of(value)), taken, arrays)))
        for cycle, (before, after) in enumerate(pairwise(rms_nm)):
            began = at_s + (cycle + 0.3) * hours * HOUR_S / len(rms_nm)
            facts = facts_of(before, (0.78 + 0.05 * ((5 * number + cycle) % 7)) * after, after)
            plan = self.plan(before, after, number + cycle) if self.maps and ended is None else ""
            row = (number, cycle, f"{number:032x}{cycle:032x}", json.dumps(facts), began, began + 1200, plan)
            self.rows.append((PASS, row))
        self.queued(
            name, at_s - DAY_S, job=number, begun_s=at_s, ended_s=ended, verdict=None if ended is None else result
        )
        return number

    def queued(
        self,
        name: str,
        added_s: float,
        *,
        by: str = "",
        text: str = "",
        files: str = "{}",
        job: int | None = None,
        begun_s: float | None = None,
        ended_s: float | None = None,
        verdict: str | None = None,
    ) -> None:
        """Add a job to the queue."""
        self.places += 1
        content = text or f'[job]\nid = "{name}"\ntolerance_nm = {LIMIT_NM}\n[part]\nid = "part-{name}"\n'
        reason = {"rejected": "the job has used all its passes", "set aside": "WrongSeat: the part is tilted"}
        path = str(self.config.state_dir.parent / f"{name}.toml")
        row = (self.places, name, f"part-{name}", path, content, files, added_s, job, begun_s, ended_s, verdict)
        self.rows.append((QUEUE, (*row, reason.get(verdict or "", ""))))
        if by:
            self.event(0, added_s, CommandReceived(order="queue_add", reason=name, by=by))

    def event(self, job: int, at_s: float, event: Event) -> None:
        """Add an event."""
        self.rows.append((EVENT, (job, at_s, event.cycle, event.name, json.dumps(dict(event.data)))))

    def waiting_plan(self, job: int, cycle: int, program: str, before_nm: float, after_nm: float, at_s: float) -> None:
        """Let a plan of that job wait for approval."""
        figures = figures_of(before_nm, after_nm)
        plan = self.plan(before_nm, after_nm, 99) if self.maps else ""
        values = {"predicted_rms_nm": after_nm, "dwell_s": figures["dwell_s"], "figures": figures, "plan": plan}
        self.event(job, at_s, PlanAwaitingApproval(cycle=cycle, program_sha256=program, **values))

    def approved(self, job: int, cycle: int, program: str, by: str, at_s: float) -> None:
        """Approve a plan."""
        self.event(job, at_s, PlanApproved(cycle=cycle, program_sha256=program, by=by))

    def surface(self, rms_nm: float, seed: int) -> str:
        """Put a map into the store and return its name."""
        height, mask = _figure(rms_nm, seed)
        return self._put({"height_nm": height, "solve_mask": mask, "metric_mask": mask, "pitch_mm": np.float64(1.0)})

    def plan(self, before_nm: float, after_nm: float, seed: int) -> str:
        """Put the arrays of a plan into the store and return their name."""
        before, _ = _figure(before_nm, seed)
        residual, _ = _figure(after_nm, seed + 7)
        removal = before - residual + 4 * before_nm
        n = 400
        angle = np.linspace(0, 60, n)
        end = np.column_stack([angle / 2 * np.cos(angle), angle / 2 * np.sin(angle), np.zeros(n)])
        values = {"residual_nm": residual, "predicted_removal_nm": removal, "block": np.arange(n), "end_mm": end,
                  "start_mm": np.roll(end, 1, axis=0), "time_s": np.full(n, 0.5), "gamma": np.full(n, 0.9),
                  "compliance_um_per_n": np.full(n, 2.0)}  # fmt: skip
        return self._put(values)

    def write(self) -> None:
        """Write all rows."""
        self.config.state_dir.mkdir(parents=True, exist_ok=True)
        store = Store.open(self.config.state_dir / JOURNAL_NAME)
        try:
            store.write(*self.rows)
        finally:
            store.close()

    def _put(self, arrays: dict[str, Any]) -> str:
        return ArrayStore(self.config.state_dir / ARRAYS_NAME).put(npz(arrays))


def _figure(rms_nm: float, seed: int) -> tuple[Any, Any]:
    """Return a smooth surface of 61 x 61 samples over a circle with that RMS."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1:1:61j, -1:1:61j]
    mask = x**2 + y**2 <= 0.97**2
    a = rng.normal(size=6)
    height = a[0] * (x**2 + y**2) + a[1] * (x**2 - y**2) + a[2] * x * y + a[3] * (x**3 - x * y**2)
    height = height + 0.5 * a[4] * np.cos(7 * x + 3 * a[5]) * np.cos(6 * y) + 0.15 * rng.normal(size=x.shape)
    height = (height - height[mask].mean()) * rms_nm / height[mask].std()
    return np.where(mask, height, np.nan), mask


def months(cell: FilledCell, count: int, last_s: float = NOW_S, days: float = 0.25) -> Iterator[int]:
    """Add parts before that time at intervals of days, most of them accepted; yield their numbers."""
    rng = random.Random(4)
    at_s = last_s - count * days * DAY_S
    for number in range(count):
        at_s += days * DAY_S * rng.uniform(0.8, 1.2)
        first = rng.uniform(14, 30)
        passes = [first, first * rng.uniform(0.1, 0.35), rng.uniform(1.2, 1.95)]
        result = rng.choices(("accepted", "rejected", "set aside"), (88, 8, 4))[0]
        if result == "rejected":
            passes[-1] = rng.uniform(2.1, 4)
        elif result == "set aside":
            passes = passes[:1]
        yield cell.part(f"lens-{number + 1:04d}", at_s, passes, result, rng.uniform(1.2, 4.5))


def shop_cell(config: CellConfig, now_s: float = NOW_S, parts: int = 90) -> str:
    """Write months of parts, one whose second plan waits for approval, and four waiting; return the program's hash."""
    cell = FilledCell(config)
    for _ in months(cell, parts, now_s - 2 * DAY_S, 0.85):
        pass
    job = cell.part("lens-2001", now_s - 1.2 * HOUR_S, [18.4, 4.6], "under way")
    cell.approved(job, 0, f"{job:032x}{0:032x}", "anna (web)", now_s - 1.1 * HOUR_S)
    program = "5f" * 32
    cell.waiting_plan(job, 1, program, 4.6, 1.4, now_s - 240)
    for number, (name, by) in enumerate(
        (("lens-2002", "anna"), ("lens-2003", "anna"), ("mirror-7", "erp"), ("mirror-8", ""))
    ):
        cell.queued(name, now_s - (6 - number) * HOUR_S, by=by)
    cell.write()
    return program


def with_run_folder(config: CellConfig, name: str) -> Path:
    """Make the run folder of a job."""
    folder = config.resolve(f"runs/{name}")
    (folder / "pictures").mkdir(parents=True)
    return folder
