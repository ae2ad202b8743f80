"""A cell's data on disk, read beside its daemon: jobs, maps, plans, alarms. A read never waits for a writer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.journal.history import naming_damage, read_events, read_only
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME
from polishd.daemon.journal.store import ArrayStore
from polishd.model.errors import ConfigError, JournalDamage, NoSuchResource
from polishd.model.events import PlanAwaitingApproval
from polishd.process.metrology.spectra import radial_psd
from polishd.web.cell_figure import CellFigures
from polishd.web.map_data import MapQuery, picture

MOST_POINTS = 4000
"""Most points of a path, unless the request says more."""
LARGEST_PLAN = 20_000
"""Most points of a path that a request may have."""
MOST_ROWS = 500
"""Most events in an answer."""
ALARMS: Mapping[str, tuple[str, str, str]] = {
    "cell_held": ("warning", "error", "correct the cause, then resume"),
    "daemon_failed": ("alarm", "error", "the daemon has ended: correct the cause, then start polishd run again"),
    "finding_reported": ("warning", "what", "look at the tool and the last pass"),
    "signal_out_of_range": ("warning", "what", "check what that signal measures, and its sensor"),
    "map_refused": ("warning", "reason", "look at the instrument, and measure again"),
    "removal_check_failed": ("warning", "stop", "look at gate.png in the run folder, and measure again"),
    "part_requested": ("warning", "part_id", "put that part in, then resume"),
    PlanAwaitingApproval.name: ("warning", "program_sha256", "look at the plan, then approve it"),
    "notification_failed": ("warning", "error", "correct what it names, and try polishd notify"),
}
"""By event: severity, key of the detail, and default advice."""


NO_CYCLE = "there is none of that job and cycle"


class RunData:
    """Data of one cell."""

    def __init__(self, state_dir: Path) -> None:
        self._state_dir = state_dir
        self._store = ArrayStore(state_dir / ARRAYS_NAME)
        self._figures = CellFigures()

    def jobs(self) -> list[dict[str, Any]]:
        """All jobs, the newest last."""
        rows = self._rows("SELECT id, name, part_id, started, ended, outcome FROM job ORDER BY id")
        return [dict(zip(("number", "job", "part", "began_s", "ended_s", "outcome"), row, strict=True)) for row in rows]

    def cycles(self, job: int) -> list[dict[str, Any]]:
        """Measurements of a job, each with the pass after it. NoSuchResource where there is no such job."""
        self._one("SELECT id FROM job WHERE id = ?", job, missing=f"there is no job {job} in this cell's journal")
        sql = "SELECT cycle, facts, started, ended, how, program_sha256 FROM pass WHERE job = ?"
        with naming_damage(self._state_dir):
            maps = {
                row[0]: row for row in self._rows("SELECT cycle, stats, taken FROM map WHERE job = ? ORDER BY id", job)
            }
            passes = {row[0]: row for row in self._rows(sql, job)}
            return [
                {
                    "cycle": cycle,
                    "taken_s": taken,
                    "measured": dict(json.loads(stats)),
                    "run": None if cycle not in passes else _pass(passes[cycle]),
                }
                for cycle, stats, taken in maps.values()
            ]

    def waiting_plan(self, program_sha256: str) -> dict[str, Any]:
        """Figures of a plan of the newest job that waits, or waited, for approval, and of the pass before it.

        NoSuchResource where that job has no such plan.
        """
        sql = (
            "SELECT id, job, at, cycle, data FROM event WHERE job = (SELECT max(id) FROM job) AND name = ? "
            "ORDER BY id DESC"
        )
        with naming_damage(self._state_dir):
            plans = [(*row, dict(json.loads(text))) for *row, text in self._rows(sql, PlanAwaitingApproval.name)]
            found = next((one for one in plans if one[4]["program_sha256"] == program_sha256), None)
            if found is None:
                raise NoSuchResource(f"no plan {program_sha256[:12]} of the present job waits, or waited, for approval")
            _, job, at_s, cycle, plan = found
            figures = {key: value for key, value in plan.items() if key not in {"program_sha256", "plan"}}
            cycles = self.cycles(job)
            approved = [
                {"at_s": at, "by": data["by"]}
                for at, text in self._rows(
                    "SELECT at, data FROM event WHERE job = ? AND name = ?", job, "plan_approved"
                )
                if (data := json.loads(text))["program_sha256"] == program_sha256
            ]
            before = [one for one in cycles if one["cycle"] < cycle and one["run"] is not None]
            after = {one["cycle"]: one["measured"] for one in cycles}
            last = before[-1] if before else None
            return {
                "program_sha256": program_sha256,
                "job": job,
                "cycle": cycle,
                "at_s": at_s,
                "figures": figures if "limits" in figures else None,  # none of an earlier polishd
                "has_maps": bool(plan.get("plan")),
                "measured": after.get(cycle),
                "approved": approved[-1] if approved else None,
                "last": None if last is None else {**last, "after": after.get(last["cycle"] + 1)},
            }

    def approvals(self, job: int) -> list[dict[str, Any]]:
        """Approvals of plans of a job: cycle, program, user and Unix time."""
        with naming_damage(self._state_dir):
            sql = "SELECT at, data FROM event WHERE job = ? AND name = 'plan_approved' ORDER BY id"
            return [{"at_s": at_s, **json.loads(text)} for at_s, text in self._rows(sql, job)]

    def run_folder(self, job: int) -> str:
        """Run folder of a job by the journal; empty: nothing was measured. NoSuchResource where there is no job."""
        sql = "SELECT id, run_dir FROM job WHERE id = ?"
        return str(self._one(sql, job, missing=f"there is no job {job} in this cell's journal")[1])

    def certificate(self, job: int, cycle: int) -> dict[str, Any]:
        """Dwell certificate of the cycle's plan."""
        with naming_damage(self._state_dir):
            facts = self._one("SELECT facts FROM pass WHERE job = ? AND cycle = ?", job, cycle)
            return dict(json.loads(facts[0])["certificate"])

    def map(self, job: int, cycle: int, request: MapQuery) -> dict[str, Any]:
        """A map as an array: see `map_data.MAP_KINDS`."""
        surface, plan, after = self._surface(job, cycle), None, None
        if request.kind != "measured":
            plan = self._plan(job, cycle)
        if request.kind == "residual":
            try:
                after = self._surface(job, cycle + 1)
            except NoSuchResource:
                raise NoSuchResource(
                    f"there is none of that job and cycle: no measurement after pass {cycle} yet"
                ) from None
        return picture(request, surface, plan, after)

    def cell(self, job: int, cycle: int, config: CellConfig) -> dict[str, Any]:
        """Robot, part and path of a cycle's plan in the robot's base frame, with the job's own configuration."""
        with naming_damage(self._state_dir):
            name = self._plan_name(job, cycle)
            facts = self._rows("SELECT facts FROM pass WHERE job = ? AND cycle = ?", job, cycle)
            tool = str(json.loads(facts[0][0]).get("tool", "")) if facts else ""
        for path, content in self._rows("SELECT path, content FROM queue WHERE job = ?", job):
            config = JobFile(Path(path), content).laid_over(config)
        return self._figures.of((name, tool, job), config.of_tool(tool) if tool else config, self._arrays(name))

    def psd(self, job: int, cycle: int) -> dict[str, Any]:
        """Spectrum of the measured map in its clear aperture: 1/mm and nm^2 mm^2."""
        surface = self._surface(job, cycle)
        found = radial_psd(surface["height_nm"], surface["metric_mask"], float(surface["pitch_mm"]))
        density = _rounded(found.density_nm2_mm2, 6)
        return {"frequency_per_mm": _rounded(found.frequency_per_mm, 5), "power_nm2_mm2": density}

    def plan(self, job: int, cycle: int, most: int = MOST_POINTS) -> dict[str, Any]:
        """Plan of a cycle: points in the part's frame, dwell, compliance and gamma along the path."""
        plan = self._plan(job, cycle)
        step = max(1, -(-plan["block"].size // most))
        chosen = slice(None, None, step)
        return {
            "block": plan["block"][chosen].tolist(),
            "x_mm": _rounded(plan["end_mm"][chosen, 0], 3),
            "y_mm": _rounded(plan["end_mm"][chosen, 1], 3),
            "dwell_s": _rounded(plan["time_s"][chosen], 5),
            "gamma": _rounded(plan["gamma"][chosen], 5),
            "compliance_um_per_n": _rounded(plan["compliance_um_per_n"][chosen], 5),
            "points": int(plan["block"].size),
        }

    def events(self, before: int | None = None) -> list[dict[str, Any]]:
        """Events and orders of all jobs, the newest first."""
        return read_events(self._state_dir, MOST_ROWS, before)[::-1]

    def alarms(self) -> list[dict[str, Any]]:
        """Unacknowledged alarms of any age, the oldest first: it is often the cause of the others.

        At most ``MOST_ROWS``; the others follow once these are acknowledged.
        """
        found: list[dict[str, Any]] = []
        before, full = None, True
        while full:
            older = read_events(self._state_dir, MOST_ROWS, before, (*ALARMS, "alarm_acknowledged"))
            full = len(older) == MOST_ROWS
            found = [*older, *found]
            before = found[0]["number"] if found else None
        with naming_damage(self._state_dir):
            seen = {number for one in found if one["name"] == "alarm_acknowledged" for number in one["data"]["alarms"]}
            open_ = [one for one in found if one["name"] in ALARMS and one["number"] not in seen]
            return [{**_alarm(one), "first": one is open_[0]} for one in open_[:MOST_ROWS]]

    def tally(self) -> dict[str, Any]:
        """Number of parts (``parts``) and passes (``passes``) by their end, and the last map of the last job.

        The map is ``measured``, from the journal; None: the job has no map yet.
        """
        parts = self._rows("SELECT outcome, count(*) FROM job WHERE outcome IS NOT NULL GROUP BY outcome")
        passes = self._rows("SELECT how, count(*) FROM pass WHERE how IS NOT NULL GROUP BY how")
        sql = "SELECT stats FROM map WHERE job = (SELECT max(id) FROM job) ORDER BY id DESC LIMIT 1"
        with naming_damage(self._state_dir):
            measured = [dict(json.loads(stats)) for (stats,) in self._rows(sql)]
        return {"parts": dict(parts), "passes": dict(passes), "measured": measured[0] if measured else None}

    def _surface(self, job: int, cycle: int) -> dict[str, NDArray[Any]]:
        """Arrays of the last measurement of a cycle."""
        name = self._one("SELECT arrays FROM map WHERE job = ? AND cycle = ? ORDER BY id DESC", job, cycle)[0]
        return self._arrays(name)

    def _plan(self, job: int, cycle: int) -> dict[str, NDArray[Any]]:
        return self._arrays(self._plan_name(job, cycle))

    def _plan_name(self, job: int, cycle: int) -> str:
        rows = self._rows("SELECT plan FROM pass WHERE job = ? AND cycle = ?", job, cycle)
        if not rows:  # a plan that waits for approval has no pass yet
            sql = (
                "SELECT json_extract(data, '$.plan') FROM event WHERE job = ? AND cycle = ? "
                "AND name = 'plan_awaiting_approval' ORDER BY id DESC LIMIT 1"
            )
            rows = self._rows(sql, job, cycle)
        if not rows or not rows[0][0]:
            raise NoSuchResource(NO_CYCLE)
        return str(rows[0][0])

    def _arrays(self, name: str) -> dict[str, NDArray[Any]]:
        """Arrays of the store. JournalDamage names a file that is missing or is not what was written."""
        try:
            return self._store.get(name)
        except (ConfigError, ValueError, EOFError, OSError, BadZipFile) as error:
            raise JournalDamage(f"arrays {name[:12]}: {error}") from error

    def _one(self, sql: str, *values: Any, missing: str = NO_CYCLE) -> tuple[Any, ...]:
        found = self._rows(sql, *values)
        if not found or not found[0][0]:
            raise NoSuchResource(missing)
        return found[0]

    def _rows(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        if not (self._state_dir / JOURNAL_NAME).exists():
            return []
        with read_only(self._state_dir) as journal, closing(journal.execute(sql, values)) as rows:
            return rows.fetchall()


def _pass(row: tuple[Any, ...]) -> dict[str, Any]:
    _, facts, started, ended, how, program = row
    record = json.loads(facts)
    keys = ("predicted_rms_nm", "dwell_s", "forecast", "tool", "program", "findings", "plan_figures")
    contact_s = (record.get("shown") or {}).get("contact_s")
    values = {"program_sha256": program, "contact_s": contact_s, **{key: record.get(key) for key in keys}}
    return {"began_s": started, "ended_s": ended, "how": how or "begun", **values}


def _alarm(event: Mapping[str, Any]) -> dict[str, Any]:
    severity, field, todo = ALARMS[event["name"]]
    data = event["data"]
    if event["name"] == PlanAwaitingApproval.name:
        what = f"a plan of {data['dwell_s'] / 60:.0f} min to {data['predicted_rms_nm']:.2f} nm RMS waits for approval"
        data = {**data, field: what}
    entry = {key: event[key] for key in ("number", "at_s", "cycle", "name")}
    return {**entry, "severity": severity, "what": str(data.get(field, "")), "todo": data.get("next") or todo}


def _rounded(values: NDArray[np.float64], digits: int) -> list[float | None]:
    return [None if np.isnan(one) else float(one) for one in np.round(values, digits)]
