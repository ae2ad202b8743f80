"""The shop's queue: parts and their cells. Each function is one step of a transaction.

A claim does not expire: the cell ends it (the part is done, set aside, or given back), or a person does, when the cell
is gone.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from polishd.config.job_file import JobFile
from polishd.config.renamed_keys import present_text
from polishd.config.toml_loader import join_words
from polishd.model.errors import ConfigError
from polishd.shop.database import DatabaseTransaction
from polishd.util.files import read_input

WAITING, UNDER_WAY, REMOVED, UNKNOWN = "waiting", "under way", "removed", "unknown"
"""States of a claim in a cell's report, besides the verdict on its part; unknown: its queue never had it."""
DONE = frozenset({"accepted", "rejected"})
REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class NewPart:
    """A job, checked as far as is possible without a cell."""

    job: str
    """``job.id``."""
    part_id: str
    content: str
    """Its file's text; names of files in it have no folders."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Contents by name."""


@dataclass(slots=True)
class AssignmentReply:
    """Answer to a cell about its claims."""

    stands: list[str] = field(default_factory=list)
    back: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def add(sql: DatabaseTransaction, parts: Sequence[NewPart], by: str, digests: Sequence[Mapping[str, str]]) -> None:
    """Append all parts or none; ConfigError where a job or its part exists.

    ``digests``: SHA-256 of each part's files, by name.
    """
    for part, digest in zip(parts, digests, strict=True):
        if (existing := sql.row("SELECT state FROM part WHERE job = ?", part.job)) is not None:
            raise ConfigError(f"job.id: {part.job!r} is {existing['state']} in this shop already; choose another name")
        open_ = "SELECT job, state FROM part WHERE part_id = ? AND state NOT IN ('done', 'removed')"
        if (other := sql.row(open_, part.part_id)) is not None:
            raise ConfigError(
                f"part.id: the part {part.part_id!r} is {other['state']} as {other['job']!r} already; it can be worked "
                "once at a time: end that one first"
            )
        for name, content in part.files.items():
            sql.insert("file", {"sha256": digest[name], "content": content}, conflict="IGNORE")
        row = {"job": part.job, "part_id": part.part_id, "content": part.content, "files": json.dumps(dict(digest))}
        sql.insert("part", {**row, "added": time.time(), "by": by})
        sql.log_decision(by, "added", part.job)


def claim(sql: DatabaseTransaction, cell: str, request: str) -> dict[str, Any]:
    """Give a cell a part, the same one for the same request. ``{"part": None}`` where there is none for it.

    ``over``: the part of this request was given back or ended; use another request.
    """
    found = sql.row("SELECT cell, part, state, back, ended FROM claim WHERE request = ?", request)
    if found is not None and found["cell"] != cell:
        raise ConfigError("that request is another cell's")
    if found is not None and found["ended"] is None and found["back"] and found["state"] == "given":
        _free(sql, request, "given back", cell)  # a cell that asks again has not taken it
        found = {**found, "ended": time.time()}
    if found is not None:
        return {"part": None, "over": True} if found["ended"] else _given(sql, request, found["part"])
    part = sql.row(
        "SELECT id, job FROM part WHERE state = 'waiting' AND id NOT IN (SELECT part FROM not_for WHERE cell = ?) "
        "ORDER BY id LIMIT 1",
        cell,
    )
    if part is None:
        return {"part": None}
    sql.insert("claim", {"request": request, "part": part["id"], "cell": cell, "given": time.time()})
    sql.run("UPDATE part SET state = 'claimed' WHERE id = ?", part["id"])
    sql.log_decision(cell, "claimed", part["job"], cell)
    return _given(sql, request, part["id"])


def refuse(sql: DatabaseTransaction, cell: str, request: str, why: str) -> None:
    """Free a part that the cell cannot work and has not put into its queue."""
    found = _open(sql, cell, request)
    if found is not None and found["state"] == "given":
        _free(sql, request, REFUSED, cell, why)


def report(
    sql: DatabaseTransaction, cell: str, journal: str, claims: Mapping[str, Mapping[str, str]]
) -> AssignmentReply:
    """Apply the cell's report on its claims, and return the valid state of each."""
    reply = AssignmentReply()
    for request, reported in claims.items():
        found = _open(sql, cell, request)
        if found is None:
            if reported["state"] in {WAITING, UNDER_WAY}:
                reply.lost.append(request)
                _came_back(sql, cell, request, reported["state"])
            continue
        _apply_state(sql, found, reported, journal)
    for found in sql.rows("SELECT request, state, back FROM claim WHERE cell = ? AND ended IS NULL", cell):
        begun = found["state"].startswith("begun")
        (reply.back if found["back"] and not begun else reply.stands).append(found["request"])
    return reply


def release(sql: DatabaseTransaction, job: str, by: str, why: str, *, gone: bool) -> str:
    """Release a part for another cell, and describe the result. ConfigError where there is nothing to release.

    A cell that may have begun the part must give it back first. ``gone``: a person confirms that the cell is gone.
    """
    part = _part(sql, job)
    if part["state"] == "waiting" and sql.run("DELETE FROM not_for WHERE part = ?", part["id"]):
        sql.log_decision(by, "for all cells", job, "", why)
        return f"{job} waits, and any cell may have it"
    if part["state"] in {"waiting", "done", "removed"}:
        raise ConfigError(f"{job!r} is {part['state']}: no cell has it; run polishd shop list SHOP.toml to see all")
    found = sql.row("SELECT request, cell, state FROM claim WHERE part = ? AND ended IS NULL", part["id"])
    if found is None:
        sql.run("UPDATE part SET state = 'waiting', verdict = '', reason = '', ended = NULL WHERE id = ?", part["id"])
        sql.log_decision(by, "released", job, "", why)
        return f"{job} waits again"
    cell = found["cell"]
    if gone:
        sql.log_decision(by, "cell is gone", job, cell, why)
        _free(sql, found["request"], "gone", by, why)
        return f"{job} waits again; {cell} must not begin it any more and gets this answer when it reconnects"
    if part["state"] == "begun":
        todo = "put it aside there (polishd hold, polishd queue remove), or say that the cell is gone: --cell-is-gone"
        raise ConfigError(f"{job!r}: {cell} has begun it; {todo}")
    sql.run("UPDATE claim SET back = ? WHERE request = ?", by, found["request"])
    sql.log_decision(by, "wanted back", job, cell, why)
    return f"{job}: {cell} is asked to give it back, and keeps it until it has; polishd shop list shows it"


def remove(sql: DatabaseTransaction, job: str, by: str, why: str) -> None:
    """Remove a part that waits or was set aside. ConfigError where a cell has it."""
    if _part(sql, job)["state"] not in {"waiting", "aside"}:
        raise ConfigError(f"{job!r} is {_part(sql, job)['state']}: only what waits, or was set aside, can be taken out")
    sql.run("UPDATE part SET state = 'removed', reason = ?, ended = ? WHERE job = ?", why, time.time(), job)
    sql.log_decision(by, "removed", job, "", why)


def _apply_state(sql: DatabaseTransaction, found: Mapping[str, Any], reported: Mapping[str, str], journal: str) -> None:
    """Apply the report on an open claim."""
    request, cell, state, reason = found["request"], found["cell"], reported["state"], reported.get("reason", "")
    if state == UNKNOWN:
        if found["back"] and found["state"] == "given":
            _free(sql, request, "given back", cell)
    elif state == WAITING:
        sql.run("UPDATE claim SET state = ? WHERE request = ?", f"taken by {journal}", request)
    elif state == UNDER_WAY:
        sql.run("UPDATE claim SET state = ? WHERE request = ?", f"begun by {journal}", request)
        if sql.run("UPDATE part SET state = 'begun' WHERE id = ? AND state = 'claimed'", found["part"]):
            sql.log_decision(cell, "begun", found["job"], cell)
    elif state == REMOVED and found["back"]:
        _free(sql, request, "given back", cell, f"released by {found['back']}")
    else:
        over = "done" if state in DONE else "aside"
        sql.run("UPDATE claim SET ended = ?, how = ? WHERE request = ?", time.time(), state, request)
        sql.run(
            "UPDATE part SET state = ?, verdict = ?, reason = ?, ended = ? WHERE id = ?",
            *(over, state, reason, time.time(), found["part"]),
        )
        sql.log_decision(cell, state, found["job"], cell, reason)


def _came_back(sql: DatabaseTransaction, cell: str, request: str, state: str) -> None:
    """Report once that an ended claim is still in the cell's queue."""
    sql_job = (
        "SELECT part.job FROM claim JOIN part ON part.id = claim.part WHERE request = ? AND cell = ? AND how = 'gone'"
    )
    found = sql.row(sql_job, request, cell)
    if found is not None and state == UNDER_WAY:
        sql.run("UPDATE claim SET how = 'gone, and had begun' WHERE request = ?", request)
        sql.log_decision(cell, "came back, and had begun it", found["job"], cell, "look which cell has the part")


def _free(sql: DatabaseTransaction, request: str, how: str, author: str, why: str = "") -> None:
    """End the claim; its part waits for another cell."""
    sql.run("UPDATE claim SET ended = ?, how = ? WHERE request = ?", time.time(), how, request)
    found = sql.row("SELECT part, cell, job FROM claim JOIN part ON part.id = claim.part WHERE request = ?", request)
    if found is None:
        raise ConfigError("there is no such claim")
    sql.run("UPDATE part SET state = 'waiting' WHERE id = ?", found["part"])
    if how != REFUSED:  # exclude the last cell only, and all cells that cannot work it
        sql.run("DELETE FROM not_for WHERE part = ? AND why NOT LIKE ?", found["part"], f"{REFUSED}%")
    row = {"part": found["part"], "cell": found["cell"], "why": f"{how}: {why}" if why else how}
    sql.insert("not_for", row, conflict="REPLACE")
    sql.log_decision(author, how, found["job"], found["cell"], why)


def _given(sql: DatabaseTransaction, request: str, part: int) -> dict[str, Any]:
    row = sql.row("SELECT job, part_id, content, files FROM part WHERE id = ?", part)
    if row is None:
        raise ConfigError("there is no such part")
    content = present_text(row["content"])  # added before release 1.0
    return {"part": {**row, "content": content, "files": json.loads(row["files"])}, "request": request}


def _open(sql: DatabaseTransaction, cell: str, request: str) -> dict[str, Any] | None:
    return sql.row(
        "SELECT request, claim.cell, claim.part, claim.state, claim.back, part.job FROM claim "
        "JOIN part ON part.id = claim.part WHERE request = ? AND cell = ? AND claim.ended IS NULL",
        *(request, cell),
    )


def _part(sql: DatabaseTransaction, job: str) -> dict[str, Any]:
    found = sql.row("SELECT id, state FROM part WHERE job = ?", job)
    if found is None:
        raise ConfigError(f"there is no part {job!r} in this shop; run polishd shop list SHOP.toml to see all")
    return found


# A job's file in the shop, with all files that it names, so that a cell needs nothing else.

MOST_BYTES = 8 << 20
"""Largest total size of a job's files, so that a report or an answer can be read at once."""
FLAT = re.compile(r"[\w][\w.-]{0,199}", re.ASCII)


def read_part(path: Path) -> NewPart:
    """Read a job's file and the files that it names. ConfigError where one is invalid or cannot be read."""
    file = JobFile.read(path)
    fragment, _ = file.fragment()
    document = tomlkit.parse(file.text)
    files: dict[str, bytes] = {}
    for key, named in file.named(fragment):
        several = isinstance(named, list)
        flat = [_read_file(files, Path(one), f"{path}: {key}") for one in (named if several else [named])]
        _put(document, key.split("."), flat if several else flat[0])
    return NewPart(str(fragment["job"]["id"]), str(fragment["part"]["id"]), tomlkit.dumps(document), files)


def part_of(content: str, files: Mapping[str, bytes]) -> NewPart:
    """Build a part from a job's text and its files. ConfigError also where it names another file."""
    file = JobFile(Path("/") / "job.toml", content)
    fragment, source = file.fragment()
    wanted = {one for _, named in file.named(fragment) for one in (named if isinstance(named, list) else [named])}
    known = {f"/{name}" for name in files}
    if any(not FLAT.fullmatch(name) for name in files) or wanted != known:
        came = f"its files are {join_words(sorted(wanted))}, and with it came {join_words(sorted(known))}"
        raise ConfigError(f"{source.file}: {came}; send each, by a name without folders")
    return NewPart(str(fragment["job"]["id"]), str(fragment["part"]["id"]), content, files)


def digests(part: NewPart) -> dict[str, str]:
    """SHA-256 of its files, by name."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in part.files.items()}


def _read_file(files: dict[str, bytes], path: Path, where: str) -> str:
    """Read a file and return its name, unique among the others. ConfigError where all files exceed ``MOST_BYTES``."""
    try:
        content = read_input(path, MOST_BYTES)
    except OSError as error:
        raise ConfigError(f"{where}: {path}: cannot be read: {error.strerror}; name a file") from error
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", path.name).lstrip(".-") or "file"
    if files.get(name, content) != content:
        name = f"{hashlib.sha256(content).hexdigest()[:12]}-{name}"
    files[name] = content
    if sum(map(len, files.values())) > MOST_BYTES:
        raise ConfigError(
            f"{where}: {path}: with it its files are more than {MOST_BYTES >> 20} MiB; let the cells' own files name it"
        )
    return name


def _put(document: Any, keys: list[str], value: Any) -> None:
    *tables, last = keys
    for table in tables:
        document = document[table]
    document[last] = value
