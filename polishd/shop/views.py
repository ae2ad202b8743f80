"""What a shop knows, for people and programs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from operator import itemgetter
from typing import Any

from polishd.shop.database import DatabaseTransaction

UNHEARD_S = 60.0
"""A cell that has said nothing for so long is told to be away."""


def status_view(sql: DatabaseTransaction, names: Iterable[str]) -> dict[str, Any]:
    """Its cells, what each does and for how long it has said nothing, and how many parts are where.

    ``names``: of cells that have a token; one that has never reported has None in the place of ``heard_s``.
    """
    now_s = time.time()
    cells = [
        {
            "cell": row["name"],
            "heard_s": round(max(now_s - row["heard"], 0.0), 1),
            "away": now_s - row["heard"] > UNHEARD_S,
            **json.loads(row["now"]),
            "claims": _count(sql, "SELECT count(*) AS n FROM claim WHERE cell = ? AND ended IS NULL", row["name"]),
            "passes": _count(sql, "SELECT count(*) AS n FROM pass WHERE cell = ?", row["name"]),
        }
        for row in sql.rows("SELECT name, heard, now FROM cell ORDER BY name")
    ]
    silent = set(names) - {cell["cell"] for cell in cells}
    cells += [{"cell": name, "heard_s": None, "away": True, "claims": 0, "passes": 0} for name in silent]
    parts = {row["state"]: row["n"] for row in sql.rows("SELECT state, count(*) AS n FROM part GROUP BY state")}
    return {"cells": sorted(cells, key=itemgetter("cell")), "parts": parts}


def parts_view(sql: DatabaseTransaction) -> dict[str, Any]:
    """All parts in the order in which they came, and whose each is; then what was decided, and who wanted it."""
    rows = sql.rows(
        "SELECT part.job, part.part_id, part.state, part.added, part.by, part.verdict, part.reason, part.ended, "
        "claim.cell, claim.given, claim.back FROM part LEFT JOIN claim ON claim.part = part.id "
        "AND claim.request = (SELECT request FROM claim AS last WHERE last.part = part.id AND last.how NOT IN "
        "('refused', 'given back', 'gone', 'gone, and had begun') ORDER BY given DESC LIMIT 1) ORDER BY part.id"
    )
    why = {row["part"]: row["why"] for row in sql.rows(
        "SELECT part.job AS part, group_concat(not_for.cell || ': ' || not_for.why, '; ') AS why FROM not_for "
        "JOIN part ON part.id = not_for.part WHERE part.state = 'waiting' GROUP BY part.id"
    )}  # fmt: skip
    return {"parts": [{**row, "not_for": why.get(row["job"], "")} for row in rows]}


def words(sql: DatabaseTransaction, most: int = 1000) -> list[dict[str, Any]]:
    """What the shop decided, and who wanted it, the last ones."""
    return sql.rows("SELECT * FROM (SELECT * FROM word ORDER BY id DESC LIMIT ?) ORDER BY id", most)


def history(sql: DatabaseTransaction) -> dict[str, Any]:
    """All jobs of all cells, in the order in which they began."""
    maps: dict[tuple[str, ...], list[float]] = {}
    for row in sql.rows("SELECT cell, journal, job, stats FROM map ORDER BY cell, journal, job, cycle"):
        maps.setdefault((row["cell"], row["journal"], row["job"]), []).append(json.loads(row["stats"]).get("rms_nm"))
    jobs = sql.rows(
        "SELECT cell, journal, job AS number, name, part_id, started, ended, ifnull(outcome, '') AS outcome, "
        "(SELECT count(*) FROM pass WHERE pass.cell = job.cell AND pass.journal = job.journal AND pass.job = job.job "
        "AND how = 'done') AS passes FROM job ORDER BY started"
    )
    for job in jobs:
        job["rms_nm"] = maps.get((job["cell"], job["journal"], job.pop("number")), [])
        del job["journal"]
    return {"jobs": jobs}


def lessons(sql: DatabaseTransaction) -> dict[str, Any]:
    """What each cell has learned last of each recipe."""
    return {"lessons": sql.rows("SELECT * FROM lesson ORDER BY recipe, at_s")}


def _count(sql: DatabaseTransaction, query: str, *values: Any) -> int:
    return int(sql.rows(query, *values)[0]["n"])
