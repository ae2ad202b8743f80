"""Write a journal with jobs of a queue: accepted, rejected, interrupted, under way, and waiting."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.journal.store import Store, connect

JOBS = ((1, "lens", "A-1", 100.0, 200.0, "in_tolerance"), (2, "mirror", "A-2", 300.0, 400.0, "cycles_used"),
        (3, "flat", "A-3", 500.0, None, None), (4, "wedge", "A-4", 600.0, None, None))  # fmt: skip
QUEUE = ((1, "lens", "A-1", 1, 200.0, "accepted", ""), (2, "mirror", "A-2", 2, 400.0, "rejected", "all used"),
         (3, "flat", "A-3", 3, 550.0, "set aside", "cut off"), (4, "wedge", "A-4", 4, None, None, ""),
         (5, "prism", "A-5", None, None, None, ""))  # fmt: skip
RMS_NM = {1: 1.5, 2: 3.5}


def write_journal(state_dir: Path) -> None:
    """Write the journal as a daemon does."""
    state_dir.mkdir(parents=True, exist_ok=True)
    Store.open(state_dir / JOURNAL_NAME).close()
    with closing(connect(state_dir / JOURNAL_NAME)) as journal:
        for row in JOBS:
            sql = (
                "INSERT INTO job (id, name, part_id, terms, started, ended, outcome) VALUES (?, ?, ?, 'null', ?, ?, ?)"
            )
            journal.execute(sql, row)
        for number, name, part, job, ended, verdict, reason in QUEUE:
            begun = None if job is None else 90.0
            sql = ("INSERT INTO queue (id, place, name, part_id, path, content, files, added, job, begun, ended, "
                   "verdict, reason) VALUES (?, ?, ?, ?, '', '', '{}', 80.0, ?, ?, ?, ?, ?)")  # fmt: skip
            journal.execute(sql, (number, number, name, part, job, begun, ended, verdict, reason))
        for measured, rms_nm in RMS_NM.items():
            line = {"what": "RMS", "value": rms_nm, "limit": 2.0, "unit": "nm"}
            stats = json.dumps({"rms_nm": rms_nm, "pv_nm": 5 * rms_nm, "judged": [line]})
            for cycle, stats_text in enumerate((json.dumps({"rms_nm": 9.0, "pv_nm": 50.0}), stats)):
                sql = "INSERT INTO map (job, cycle, sha256, path, stats, taken) VALUES (?, ?, '', '', ?, 150.0)"
                journal.execute(sql, (measured, cycle, stats_text))
            sql = ("INSERT INTO pass (job, cycle, program_sha256, boot_id, blocks, contact_from, contact_to, facts, "
                   "started, how) VALUES (?, 0, '', '', 1, 0, 1, '{}', 110.0, 'done')")  # fmt: skip
            journal.execute(sql, (measured,))
