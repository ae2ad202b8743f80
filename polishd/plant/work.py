"""What a cell has to do and has done, for the plant: read from its journal, beside a daemon that may be running."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.daemon.history import read_only
from polishd.daemon.journal import JOURNAL_NAME
from polishd.model.cycle import Outcome
from polishd.model.tolerance import judged_of

MOST_ENDED = 20
"""Jobs that ended, of which is told: what is older is in ``polishd history``."""
TO_ITS_END = {"accepted", "rejected", *(Outcome)} - {Outcome.STOPPED}
"""How a job ends that was worked until its part was judged; any other end cut it off."""


@dataclass(frozen=True, slots=True)
class OpcUaResultValue:
    """One of a part's figures, as its last map shows it."""

    name: str
    value: float | int | str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class OpcUaJob:
    """A job: one that waits, the one under way, or one that ended. Times are Unix times."""

    name: str
    part_id: str
    began_s: float | None
    ended_s: float | None
    end: str
    """How it ended: the queue's verdict, or the job's outcome; empty: it has not."""
    why: str
    number: int | None
    """Its row in the journal's jobs; None: it was never begun."""
    figures: tuple[OpcUaResultValue, ...]
    holds: bool | None
    """Whether the part is what its drawing wants, by its last map; None: nothing judges that."""

    @property
    def id(self) -> str:
        """Unlike that of any other: a job's name may come again where there is no queue."""
        return f"{self.name}.{self.number}"

    @property
    def state(self) -> str:
        """Of OPC 10031-4; ``Running`` also where it stands still, which only the daemon knows."""
        if self.end:
            return "Ended" if self.end in TO_ITS_END else "Aborted"
        return "AllowedToStart" if self.began_s is None else "Running"


def read_work(state_dir: Path) -> tuple[OpcUaJob, ...]:
    """Those that ended, the latest last, the one under way, and those that wait, in their order.

    ConfigError where the journal cannot be read; none where there is no journal yet.
    """
    if not (state_dir / JOURNAL_NAME).exists():
        return ()
    with read_only(state_dir) as journal:
        return tuple(_orders(journal))


def _orders(journal: sqlite3.Connection) -> Iterator[OpcUaJob]:
    queued = {}
    waiting = []
    sql = ("SELECT job, name, part_id, verdict, reason, ended FROM queue WHERE ended IS NULL OR id IN "
           "(SELECT id FROM queue WHERE ended IS NOT NULL ORDER BY ended DESC, id DESC LIMIT ?) "
           "ORDER BY ended IS NULL, ended, place")  # fmt: skip
    for job, name, part_id, verdict, reason, ended_s in journal.execute(sql, (MOST_ENDED,)):
        if job is None:  # waits, or was taken out before it began
            waiting.append(OpcUaJob(name, part_id, None, ended_s, verdict or "", reason, None, (), None))
        else:
            queued[job] = (verdict, reason, ended_s)
    sql = "SELECT id, name, part_id, started, ended, outcome, detail FROM job ORDER BY id DESC LIMIT ?"
    jobs = journal.execute(sql, (MOST_ENDED + 1,)).fetchall()
    for number, name, part_id, began_s, job_ended_s, outcome, detail in reversed(jobs):
        verdict, reason, ended_s = queued.get(number, (None, "", None))
        # Where another was begun after it, it was given up.
        given_up = "given up" if number != jobs[0][0] else ""
        end = verdict or outcome or given_up
        figures, holds = _measured(journal, number)
        when = ended_s or job_ended_s
        yield OpcUaJob(name, part_id, began_s, when, end, reason or detail or "", number, figures, holds)
    yield from waiting


def _measured(journal: sqlite3.Connection, job: int) -> tuple[tuple[OpcUaResultValue, ...], bool | None]:
    """The figures of a job's last map, and whether all lines of its drawing hold."""
    sql = "SELECT stats FROM map WHERE job = ? ORDER BY id DESC LIMIT 1"
    found = journal.execute(sql, (job,)).fetchone()
    passes = journal.execute("SELECT count(*) FROM pass WHERE job = ? AND how = 'done'", (job,)).fetchone()[0]
    if found is None:
        return (OpcUaResultValue("Passes", passes),), None
    stats: dict[str, Any] = json.loads(found[0])
    named = (("RMS", "rms_nm"), ("PV", "pv_nm"))
    figures = [OpcUaResultValue("Passes", passes)]
    figures += [OpcUaResultValue(name, float(stats[key]), "nm") for name, key in named if stats.get(key) is not None]
    lines = judged_of(stats)
    for line in lines:
        figures += [OpcUaResultValue(f"{line.what}, counted", line.counted, line.unit)]
        figures += [OpcUaResultValue(f"{line.what}, limit", line.limit, line.unit)]
    return tuple(figures), all(line.holds for line in lines) if lines else None
