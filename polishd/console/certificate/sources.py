"""What a certificate is made of: one run folder, its summary and its journal, each held against the other."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig, load_config
from polishd.daemon.history import read_only
from polishd.daemon.journal import JOURNAL_NAME
from polishd.model.errors import ConfigError
from polishd.plugins.run_report.folder import ReportSurface, RunFolderReader, read_folder

TABLES = ("job", "map", "phase", "pass", "segment", "event")
"""Whose rows the journal's hash is of, in this order."""
ORDER = {"segment": "cycle, seq", "pass": "cycle"}
"""By what; others have a number of their own."""
SUMMARY, PROFILE = "summary.json", "instrument.toml"
FIGURES = ("rms_nm", "pv_nm", "lsf_rms_nm")

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of one job's journal, as they stand there; what is JSON in them is read."""

    job: Row
    maps: Sequence[Row]
    """The last one of each cycle."""
    passes: Sequence[Row]
    phases: Sequence[Row]
    events: Sequence[Row]
    contact: Mapping[int, Row]
    """By cycle: blocks that are recorded, and mean force and speed of those in contact."""
    counts: Mapping[str, int]
    sha256: str

    @property
    def terms(self) -> Mapping[str, Any]:
        """All values with which the job was begun, by dotted key."""
        found: Mapping[str, Any] = self.job["terms"]
        return found


@dataclass(frozen=True, slots=True)
class CertificateRun:
    """A run that can be certified."""

    folder: RunFolderReader
    rows: Rows
    cell: CellConfig | None
    """The cell's file, where the run was asked for by it."""

    @property
    def path(self) -> Path:
        """Of the folder."""
        return self.folder.path

    def cycle(self, number: int) -> Path:
        """The folder of a cycle."""
        return self.path / f"cycle-{number:02d}"

    def surface(self, cycle: int) -> ReportSurface | None:
        """A cycle's map on the process grid, with the clear aperture; None where it is not there."""
        name = self.cycle(cycle).name
        return next((one.surface for one in self.folder.cycles if one.name == name), None)

    def file(self, cycle: int, stem: str) -> Path | None:
        """The one file of a cycle with that stem: map or program, whatever its ending."""
        return next((path for path in sorted(self.cycle(cycle).glob(f"{stem}.*")) if path.is_file()), None)


def find_run(asked: Path, job: str | None) -> CertificateRun:
    """The run of a folder, or of a cell's job.

    Args:
        asked: a run folder, or a cell's file.
        job: with a cell, its job.id; None: the last one that is over.

    Raises:
        ConfigError: there is none, or it cannot be certified; the message says what to do.
    """
    if asked.is_dir():
        if job is not None:
            raise ConfigError(f"{asked}: a run folder is of one job; leave --job out, or name the cell's file")
        return _read(asked, None)
    if asked.suffix != ".toml":
        raise ConfigError(f"{asked}: is no folder, and no cell's file; name a run folder, or CELL.toml")
    config = load_config(asked)
    with read_only(config.state_dir) as journal:
        sql = "SELECT name, run_dir, ended FROM job ORDER BY id DESC"
        jobs = [row for row in journal.execute(sql) if job is None or row[0] == job]
    if not jobs:
        problem = "no job was begun yet" if job is None else f"there is no job {job!r}; polishd history lists them"
        raise ConfigError(f"{asked}: {problem}")
    over = [row for row in jobs if row[2] is not None]
    name, run_dir, _ = (over or jobs)[0]
    if not run_dir:
        raise ConfigError(f"{asked}: the job {name!r} has no run folder: nothing was measured, nothing to certify")
    return _read(config.resolve(run_dir), config)


def _read(path: Path, cell: CellConfig | None) -> CertificateRun:
    for name in (SUMMARY, JOURNAL_NAME):
        if not (path / name).exists():
            raise ConfigError(
                f"{path}: has no {name}: it is no run folder, or its job is under way, or the daemon was killed; "
                "polishd run CELL.toml ends the job, or takes it up"
            )
    folder = read_folder(path)
    if folder.planned or not folder.rows():
        raise ConfigError(f"{path}: holds no measurement of a job: there is nothing to certify")
    run = CertificateRun(folder, read_rows(path), cell)
    _require_one_truth(run)
    return run


def read_rows(path: Path) -> Rows:
    """The journal of a run folder; ConfigError where it cannot be read, or is of more than one job."""
    with read_only(path) as journal:
        journal.row_factory = sqlite3.Row
        tables = {name: list(_rows(journal, name)) for name in TABLES if name != "segment"}
        digest, counts = _digest(journal)
        contact = {row["cycle"]: dict(row) for row in journal.execute(CONTACT)}
    if len(tables["job"]) != 1:
        raise ConfigError(f"{path / JOURNAL_NAME}: is of {len(tables['job'])} jobs, and a run folder's is of one")
    (job,) = tables["job"]
    if not isinstance(job["terms"], dict):
        raise ConfigError(
            f"{path / JOURNAL_NAME}: its job was begun by an earlier polishd, which did not write down how"
        )
    last = {row["cycle"]: row for row in tables["map"]}
    passes, phases, events = (tables[name] for name in ("pass", "phase", "event"))
    return Rows(job, list(last.values()), passes, phases, events, contact, counts, digest)


CONTACT = """
SELECT cycle, count(*) AS blocks,
    sum(CASE WHEN touched = 1 AND force_n IS NOT NULL THEN force_n * (end_s - start_s) END) /
    sum(CASE WHEN touched = 1 AND force_n IS NOT NULL THEN end_s - start_s END) AS force_n,
    sum(CASE WHEN touched = 1 AND rpm IS NOT NULL THEN rpm * (end_s - start_s) END) /
    sum(CASE WHEN touched = 1 AND rpm IS NOT NULL THEN end_s - start_s END) AS rpm
FROM segment GROUP BY cycle
"""
JSON_COLUMNS = ("terms", "stats", "facts", "data")


def _rows(journal: sqlite3.Connection, table: str) -> Iterator[Row]:
    for row in journal.execute(f"SELECT * FROM {table} ORDER BY {ORDER.get(table, 'id')}"):  # noqa: S608
        yield {key: json.loads(row[key]) if key in JSON_COLUMNS else row[key] for key in row.keys()}  # noqa: SIM118


def _digest(journal: sqlite3.Connection) -> tuple[str, dict[str, int]]:
    """sha256 of all rows, a line of JSON each with the table's name first; and how many there are of each table."""
    digest, counts = hashlib.sha256(), {}
    for table in TABLES:
        rows = journal.execute(f"SELECT * FROM {table} ORDER BY {ORDER.get(table, 'id')}")  # noqa: S608
        counts[table] = 0
        for row in rows:
            digest.update(json.dumps([table, *row], separators=(",", ":"), ensure_ascii=True).encode() + b"\n")
            counts[table] += 1
    return digest.hexdigest(), counts


def _require_one_truth(run: CertificateRun) -> None:
    """ConfigError where summary, journal and files do not tell of one and the same run."""
    rows, told = run.folder.rows(), run.rows.maps
    if len(rows) != len(told):
        raise ConfigError(
            f"{run.path}: summary.json has {len(rows)} measurements, its journal {len(told)}; restore both as they were"
        )
    for row, measured in zip(rows, told, strict=True):
        for key in FIGURES:
            if row.get(key) != measured["stats"].get(key):
                raise ConfigError(
                    f"{run.path / SUMMARY}: {key} of measurement {measured['cycle']} is {row.get(key)}, and "
                    f"{measured['stats'].get(key)} in the journal; restore the file as it was"
                )
        _require_file(run, run.file(measured["cycle"], "map"), measured["sha256"])
    for done in run.rows.passes:
        _require_file(run, run.file(done["cycle"], "program"), done["program_sha256"])
    named = run.rows.terms.get("instrument.profile")
    if isinstance(named, dict) and (run.path / PROFILE).exists():
        _require_file(run, run.path / PROFILE, named["sha256"])


def _require_file(run: CertificateRun, path: Path | None, sha256: str) -> None:
    """What is there must be what the journal names. What is not there is said in the certificate."""
    if path is not None and sha256_of(path) != sha256:
        raise ConfigError(
            f"{path}: is not the file that the journal names (sha256 {sha256[:12]}…); restore it, or take it out of "
            f"{run.path.name}: the certificate then says that it is missing"
        )


def sha256_of(path: Path) -> str:
    """Of a file's content; ConfigError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; mend its rights") from error
