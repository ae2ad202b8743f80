"""The queue of a cell for the page, from its journal: jobs in working order with their recipe and expected time."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.journal.history import read_only
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.queue.queue import TO_DO
from polishd.model.errors import ConfigError
from polishd.web.part_history import PartHistory

ENDED_SHOWN = 8
"""Number of ended jobs in the answer, the last ones."""
TYPICAL_OF = 200
"""The expected time of a job is the median of the finished jobs with its program among so many that ended last."""
EVENTS_SEARCHED = 100_000
"""Number of the last events in which the user who added a job is looked for."""
PROGRAM = "program.path"
_COLUMNS = "id, name, part_id, path, content, files, added, job, begun, ended, verdict, reason, claim"
_KEYS = ("id", "name", "part_id", "path", "content", "files", "added_s", "job", "begun_s", "ended_s", "verdict",
         "reason", "claim")  # fmt: skip


class QueueView:
    """Reader of one cell's queue. Its methods read the disk: call them in a thread."""

    def __init__(self, config: CellConfig, history: PartHistory) -> None:
        self._config, self._history = config, history
        self._lock = threading.Lock()
        self._details: dict[int, dict[str, Any]] = {}
        """By id of the job: a job's file does not change in the queue."""
        self._added_by: dict[int, str] = {}

    def facts(self) -> dict[str, Any]:
        """Return the jobs under way and waiting, in working order, and the last ones that ended, the newest first.

        A job to do has ``details`` (its recipe), or ``problem`` where its file no longer fits the cell's; ``typical_s``
        and ``typical_of`` (the expected time, and of how many jobs it is the median), and ``starts_s``, the expected
        Unix time of its begin if the queue does not stop; null: not known.
        """
        if not (self._config.state_dir / JOURNAL_NAME).exists():
            return {"jobs": [], "ended": [], "ended_total": 0}
        with self._lock:
            to_do, ended, total, done = self._read()
            self._find_added_by(to_do)
            self._details = {one["id"]: self._details.get(one["id"]) or self._details_of(one) for one in to_do}
            jobs = [self._job(one, done) for one in to_do]
        _expect_starts(jobs)
        return {"jobs": jobs, "ended": [_ended(one) for one in ended], "ended_total": total}

    def _read(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]], int, list[tuple[int, str | None]]]:
        """Return the jobs to do, the last ended ones, the number of ended ones, and programs of those that ran."""
        last = f"ended IS NOT NULL ORDER BY place DESC LIMIT {ENDED_SHOWN}"
        programs = (
            f"SELECT job, json_extract(files, '$.\"{PROGRAM}\"') FROM queue "  # noqa: S608 - our own words
            f"WHERE ended IS NOT NULL AND job IS NOT NULL ORDER BY place DESC LIMIT {TYPICAL_OF}"
        )
        with read_only(self._config.state_dir) as journal:

            def jobs(condition: str) -> list[dict[str, Any]]:
                rows = journal.execute(f"SELECT {_COLUMNS} FROM queue WHERE {condition}")  # noqa: S608 - our own words
                return [dict(zip(_KEYS, row, strict=True)) for row in rows]

            to_do = [{**one, "files": json.loads(one["files"])} for one in jobs(TO_DO)]
            ((total,),) = journal.execute("SELECT count(*) FROM queue WHERE ended IS NOT NULL")
            ran = [(job, _hash_of(json.loads(text or "null"))) for job, text in journal.execute(programs)]
            return to_do, jobs(last), total, ran

    def _job(self, one: Mapping[str, Any], done: Iterable[tuple[int, str | None]]) -> dict[str, Any]:
        typical = self._history.typical_s(job for job, program in done if program == _program(one["files"]))
        return {
            **{key: one[key] for key in ("name", "part_id", "path", "added_s", "job", "begun_s", "reason")},
            "state": "waiting" if one["begun_s"] is None else "under way",
            "by": self._added_by.get(one["id"], ""),
            "shop": bool(one["claim"]),
            **self._details[one["id"]],
            "typical_s": None if typical is None else typical[0],
            "typical_of": 0 if typical is None else typical[1],
            "starts_s": None,
        }

    def _find_added_by(self, to_do: Iterable[Mapping[str, Any]]) -> None:
        unresolved = {one["name"]: one["id"] for one in to_do if one["id"] not in self._added_by}
        if not unresolved:
            return
        sql = (
            "SELECT data FROM event WHERE name = 'command_received' AND id > (SELECT max(id) FROM event) - ? "
            "AND json_extract(data, '$.order') = 'queue_add' ORDER BY id DESC"
        )
        with read_only(self._config.state_dir) as journal:
            for (text,) in journal.execute(sql, (EVENTS_SEARCHED,)):
                data = json.loads(text)
                for name in str(data["reason"]).split(", "):
                    if name in unresolved:
                        self._added_by[unresolved.pop(name)] = str(data["by"])
                if not unresolved:
                    return
        for number in unresolved.values():
            self._added_by[number] = ""

    def _details_of(self, one: Mapping[str, Any]) -> dict[str, Any]:
        try:
            config = JobFile(Path(one["path"]), one["content"]).laid_over(self._config)
            return {"details": job_details(config, one["files"]), "problem": ""}
        except ConfigError as error:
            return {"details": None, "problem": str(error)}


def job_details(config: CellConfig, files: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part, tolerance and recipe of a job for the page. ConfigError where its outline cannot be read."""
    part, process, job, program = config.part, config.process, config.job, config.program
    return {
        "outline": str(config.outline()),
        "edge_mm": part.edge_mm,
        "curvature_radius_mm": part.curvature_radius_mm,
        "conic": part.conic,
        "off_axis_mm": list(part.off_axis_mm),
        "form": part.form,
        "tolerance": [{"what": line.what, "limit": line.limit, "unit": line.unit} for line in config.lines],
        "accept_by": job.accept_by,
        "program": ", ".join(Path(path).name for path in program.paths),
        "program_format": program.format,
        "program_sha256": _program(files),
        "force_n": process.force_n,
        "rpm": process.rpm,
        "tools": list(config.tools),
        "removal_model": process.removal_model,
        "correction": process.correction,
        "objective": config.dwell.objective,
        "max_passes": job.max_cycles,
        "approve": job.approve,
    }


def _program(files: Mapping[str, Any]) -> str | None:
    """Return the SHA-256 of the job's own program; None: it has that of the cell."""
    return _hash_of(files.get(PROGRAM))


def _hash_of(named: Any) -> str | None:
    """Return the SHA-256 of a file of the journal; of several, that of their hashes in order."""
    match named:
        case {"sha256": sha256}:
            return str(sha256)
        case [*several] if several:
            return hashlib.sha256(" ".join(str(one["sha256"]) for one in several).encode()).hexdigest()
        case _:
            return None


def _ended(one: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("name", "part_id", "added_s", "job", "begun_s", "ended_s", "reason")
    return {**{key: one[key] for key in keys}, "state": one["verdict"]}


def _expect_starts(jobs: Iterable[dict[str, Any]]) -> None:
    """Set the expected begin of each waiting job, as far as the times of all jobs before it are known."""
    at_s: float | None = time.time()
    for job in jobs:
        if job["begun_s"] is None:
            job["starts_s"] = at_s
            at_s = None if at_s is None or job["typical_s"] is None else at_s + job["typical_s"]
        elif at_s is not None:
            at_s = None if job["typical_s"] is None else max(job["begun_s"] + job["typical_s"], at_s)
