"""What a cell's journal has to tell a shop: read beside the daemon that writes it, from any number of events on."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from polishd.daemon.history import read_only
from polishd.daemon.offers import FORGOTTEN
from polishd.model.events import PassProgressed, ShopRateReceived
from polishd.shop.feed import CellReport

MOST_EVENTS = 500
"""In one report."""
LESSON_AGAIN_S = 86400.0
"""What another cell learned of a recipe is offered again when it is newer by so much."""

_JOBS = "SELECT id, name, part_id, started, ended, outcome, detail FROM job WHERE id = ?"
_PASSES = "SELECT job, cycle, program_sha256, started, ended, how, facts FROM pass WHERE job = ? ORDER BY cycle"
_MAPS = "SELECT job, cycle, taken, stats FROM map WHERE job = ? ORDER BY id"


def read_report(
    state_dir: Path, upto: int, now: dict[str, Any], also: Sequence[str], asking: str
) -> tuple[CellReport, bool] | None:
    """What comes after that event, and whether that is not all; None where the journal is still empty.

    ``also``: claims of which the shop wants to know though they may have ended; ``asking``: the request of which nobody
    knows yet whether it is a claim. ConfigError where the journal cannot be read.
    """
    with read_only(state_dir) as journal:
        first = journal.execute("SELECT id, job, at, cycle, name, data FROM event ORDER BY id LIMIT 1").fetchone()
        if first is None:
            return None
        sql = "SELECT id, job, at, cycle, name, data FROM event WHERE id >= ? ORDER BY id LIMIT ?"
        rows = journal.execute(sql, (upto, MOST_EVENTS + 2)).fetchall()
        before = [row for row in rows if row[0] == upto]
        rows = [row for row in rows if row[0] > upto]
        more, rows = len(rows) > MOST_EVENTS, rows[:MOST_EVENTS]
        touched = {row[1] for row in rows} | {journal.execute("SELECT ifnull(max(id), 0) FROM job").fetchone()[0]}
        passes = _of(journal, _PASSES, touched)
        jobs = _of(journal, _JOBS, touched)
        return CellReport(
            journal=_row_hash(first),
            first=upto + 1,
            last=rows[-1][0] if rows else upto,
            before=_row_hash(before[0]) if before else "",
            tail=_row_hash(rows[-1]) if rows else "",
            now=now,
            events=[row for row in rows if row[4] != PassProgressed.name],
            jobs=jobs,
            passes=passes,
            maps=_of(journal, _MAPS, touched),
            lessons=_lessons({row[0]: row[1] for row in jobs}, passes),
            claims=_claims(journal, also, asking),
        ), more


def facts(report: CellReport) -> dict[str, Any]:
    """As it is sent."""
    return asdict(report)


def has_claim(state_dir: Path, claim: str) -> bool:
    """Whether the cell's queue has, or had, the part of that claim. ConfigError where the journal cannot be read."""
    with read_only(state_dir) as journal:
        return journal.execute("SELECT 1 FROM queue WHERE claim = ?", (claim,)).fetchone() is not None


def wanted_rates(state_dir: Path, offers: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those of which this cell has no lesson of its own, and none that was offered lately."""
    with read_only(state_dir) as journal:
        return [offer for offer in offers if not _known(journal, offer)]


def _known(journal: sqlite3.Connection, offer: dict[str, Any]) -> bool:
    own = "SELECT 1 FROM pass WHERE instr(facts, ?) LIMIT 1"  # which may have NaN in it, that SQLite takes for no JSON
    if journal.execute(own, (json.dumps({"recipe": offer["recipe"]})[1:-1],)).fetchone():
        return True
    sql = (
        "SELECT max(json_extract(data, '$.at_s')) FROM event WHERE name = ? AND json_extract(data, '$.recipe') = ? "
        "AND id > ifnull((SELECT max(id) FROM event WHERE name = ?), 0)"
    )
    (at_s,) = journal.execute(sql, (ShopRateReceived.name, offer["recipe"], FORGOTTEN)).fetchone()
    return at_s is not None and offer["at_s"] < at_s + LESSON_AGAIN_S


def _of(journal: sqlite3.Connection, sql: str, jobs: Iterable[int]) -> list[tuple[Any, ...]]:
    return [row for job in sorted(jobs) for row in journal.execute(sql, (job,))]


def _lessons(names: dict[int, str], passes: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Of each recipe the last one; none where a person had to see to the tool, and none without its uncertainty."""
    found: dict[str, tuple[Any, ...]] = {}
    for job, cycle, _, _, ended, how, text in passes:
        known = json.loads(text)
        taught = known.get("taught") or {}
        recipe, rate = taught.get("recipe"), taught.get("believed", {}).get("removal", {}).get("rate", {})
        seen_to = any(one["stops"] == "cell" for one in known.get("findings", ()))
        if recipe and how == "done" and rate.get("sigma") is not None and not seen_to:
            found[recipe] = (recipe, names[job], cycle, ended, taught["tool"], rate["value"], rate["sigma"])
    return list(found.values())


def _claims(journal: sqlite3.Connection, also: Sequence[str], asking: str) -> dict[str, dict[str, str]]:
    """State and reason of those that are open here, and of those that the shop takes for open."""
    rows = journal.execute("SELECT claim, begun, verdict, reason, ended FROM queue WHERE claim != ''").fetchall()
    said = {
        claim: {"state": verdict or ("under way" if begun else "waiting"), "reason": reason or ""}
        for claim, begun, verdict, reason, ended in rows
        if ended is None or claim in also
    }
    unknown = set(also) - {row[0] for row in rows} - {asking}
    return {**said, **{claim: {"state": "unknown"} for claim in unknown}}


def _row_hash(row: tuple[Any, ...]) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()[:16]
