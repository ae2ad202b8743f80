"""Sources of a certificate: run folder, summary and journal, checked against each other."""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.cell import CellConfig, load_config
from polishd.config.instrument_profile import InstrumentProfile, load_profile
from polishd.daemon.journal.history import read_only
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.maps.figures import figured
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.pipeline import steps
from polishd.pipeline.records import record_of
from polishd.pipeline.run_folder import read_map
from polishd.plugin_loader import load_plugins
from polishd.process.metrology.absolute_test import AbsoluteTestResult, SystemMap
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.spectra import split_bands
from polishd.reports.map_figures import MapReportData, MapReportOptions, reported
from polishd.reports.run_reader import ReportSurface, RunFolderReader, read_folder

TABLES = ("job", "map", "phase", "pass", "segment", "event")
"""Tables that the hash of the journal covers, in this order."""
ORDER = {"segment": "cycle, seq", "pass": "cycle"}
"""Order of the rows; other tables are ordered by their id."""
SUMMARY, PROFILE = "summary.json", "instrument.toml"
FIGURES = ("rms_nm", "pv_nm", "lsf_rms_nm")

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of one job's journal, with JSON columns parsed."""

    job: Row
    maps: Sequence[Row]
    """The last map of each cycle."""
    passes: Sequence[Row]
    phases: Sequence[Row]
    events: Sequence[Row]
    contact: Mapping[int, Row]
    """By cycle: number of recorded blocks, and mean force and speed in contact."""
    counts: Mapping[str, int]
    sha256: str

    @property
    def terms(self) -> Mapping[str, Any]:
        """Values at the start of the job, by dotted key."""
        found: Mapping[str, Any] = self.job["terms"]
        return found


@dataclass(frozen=True, slots=True)
class CertificateRun:
    """A run that can be certified."""

    folder: RunFolderReader
    rows: Rows
    cell: CellConfig | None
    """The cell's file, if it named the run."""

    @property
    def path(self) -> Path:
        """Path of the run folder."""
        return self.folder.path

    def cycle(self, number: int) -> Path:
        """Return the folder of a cycle."""
        return self.path / f"cycle-{number:02d}"

    def surface(self, cycle: int) -> ReportSurface | None:
        """Return a cycle's map on the process grid with the clear aperture; None if it is missing."""
        name = self.cycle(cycle).name
        return next((one.surface for one in self.folder.cycles if one.name == name), None)

    def file(self, cycle: int, stem: str) -> Path | None:
        """Return the file of a cycle with this stem (``map`` or ``program``) and any ending."""
        return next((path for path in sorted(self.cycle(cycle).glob(f"{stem}.*")) if path.is_file()), None)


def find_run(path: Path, job: str | None) -> CertificateRun:
    """Return the run of a folder, or of a cell's job.

    Args:
        path: a run folder, or a cell's file.
        job: with a cell, its job.id; None: the last job that ended.

    Raises:
        ConfigError: there is no run, or it cannot be certified.
    """
    if path.is_dir():
        if job is not None:
            raise ConfigError(f"{path}: a run folder has one job. Omit --job, or name the cell's file.")
        return _read(path, None)
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: neither a folder nor a cell's file. Name a run folder, or CELL.toml.")
    config = load_config(path)
    with read_only(config.state_dir) as journal:
        sql = "SELECT name, run_dir, ended FROM job ORDER BY id DESC"
        jobs = [row for row in journal.execute(sql) if job is None or row[0] == job]
    if not jobs:
        problem = (
            "no job has begun. Run polishd run CELL.toml first."
            if job is None
            else f"there is no job {job!r}. Run polishd history for a list."
        )
        raise ConfigError(f"{path}: {problem}")
    over = [row for row in jobs if row[2] is not None]
    name, run_dir, _ = (over or jobs)[0]
    if not run_dir:
        raise ConfigError(f"{path}: the job {name!r} has no run folder: nothing was measured.")
    return _read(config.resolve(run_dir), config)


def _read(path: Path, cell: CellConfig | None) -> CertificateRun:
    folder = read_folder(path)
    if folder.planned:
        raise ConfigError(f"{path}: is the folder of a plan: nothing was polished. Name a run folder.")
    for name in (SUMMARY, JOURNAL_NAME):
        if not (path / name).exists():
            raise ConfigError(
                f"{path}: has no {name}: not a run folder, or the job has not ended. Name another run folder, or end "
                "the job with polishd run CELL.toml."
            )
    if not folder.rows():
        raise ConfigError(f"{path}: has no measurement of a job. Name another run folder.")
    run = CertificateRun(folder, read_rows(path), cell)
    _require_consistent(run)
    return run


def read_rows(path: Path) -> Rows:
    """Read the journal of a run folder; ConfigError if it cannot be read, or has more than one job."""
    with read_only(path) as journal:
        journal.row_factory = sqlite3.Row
        tables = {name: list(_rows(journal, name)) for name in TABLES if name != "segment"}
        digest, counts = _digest(journal)
        contact = {row["cycle"]: dict(row) for row in journal.execute(CONTACT)}
    if len(tables["job"]) != 1:
        raise ConfigError(f"{path / JOURNAL_NAME}: has {len(tables['job'])} jobs, and must have one. Restore the file.")
    (job,) = tables["job"]
    if not isinstance(job["terms"], dict):
        raise ConfigError(
            f"{path / JOURNAL_NAME}: the job was begun by an earlier polishd, which did not record its settings."
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
    """Return the SHA-256 of all rows (a line of JSON each, with the table's name first) and the number of rows.

    They count as they were written: a certificate of an earlier version has that hash.
    """
    digest, counts = hashlib.sha256(), {}
    for table in TABLES:
        rows = journal.execute(f"SELECT * FROM main.{table} ORDER BY {ORDER.get(table, 'id')}")  # noqa: S608
        counts[table] = 0
        for row in rows:
            digest.update(json.dumps([table, *row], separators=(",", ":"), ensure_ascii=True).encode() + b"\n")
            counts[table] += 1
    return digest.hexdigest(), counts


def _require_consistent(run: CertificateRun) -> None:
    """ConfigError if summary, journal and files contradict each other."""
    rows, maps = run.folder.rows(), run.rows.maps
    if len(rows) != len(maps):
        raise ConfigError(
            f"{run.path}: summary.json has {len(rows)} measurements, the journal {len(maps)}. Restore both files."
        )
    for row, measured in zip(rows, maps, strict=True):
        for key in FIGURES:
            if row.get(key) != measured["stats"].get(key):
                raise ConfigError(
                    f"{run.path / SUMMARY}: {key} of measurement {measured['cycle']} is {row.get(key)}, and "
                    f"{measured['stats'].get(key)} in the journal. Restore the file."
                )
        _require_file(run.file(measured["cycle"], "map"), measured["sha256"])
    for done in run.rows.passes:
        _require_file(run.file(done["cycle"], "program"), done["program_sha256"])
    named = run.rows.terms.get("instrument.profile")
    if isinstance(named, dict) and (run.path / PROFILE).exists():
        _require_file(run.path / PROFILE, named["sha256"])


def _require_file(path: Path | None, sha256: str) -> None:
    """ConfigError if a file differs from that of the journal. A missing file is listed in the certificate."""
    if path is not None and sha256_of(path) != sha256:
        raise ConfigError(
            f"{path}: SHA-256 differs from {sha256[:12]}… in the journal. Restore the file, or remove it: the "
            "certificate then lists it as missing."
        )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file; ConfigError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}. Check its permissions.") from error


# First and last map of a run, reconstructed from their files in the way of the daemon.

SAME = 1e-6
"""Relative difference that figures of the same file may have on another processor."""
HSF_MM = 0.12
TERMS = 36


@dataclass(frozen=True, slots=True)
class ReconstructedMap:
    """Map with its figures."""

    cycle: int
    reported: MapReportData
    figure_nm: FloatArray
    """(ny, nx) on the samples of the map, alignment removed; NaN outside the clear aperture."""
    clear: BoolArray
    """(ny, nx) clear aperture on the samples of the map."""
    pitch_mm: float
    source: SurfaceMap
    """The map as read from its file."""

    def beyond_nm(self, cutoff_mm: float) -> float:
        """Return the RMS of the periods below a cut-off."""
        return float(split_bands(self.figure_nm, self.clear, self.pitch_mm, (cutoff_mm,))[1][self.clear].std())


def profile_of(run: CertificateRun) -> InstrumentProfile | None:
    """Return the instrument's profile at the time of the run; None if the cell had none."""
    path = run.path / PROFILE
    return load_profile(path) if path.exists() else None


class MapReconstructor:
    """Reconstructs maps of a run, and lists those that it cannot."""

    def __init__(self, run: CertificateRun, wavelength_nm: float) -> None:
        self.left_out: list[str] = []
        self._run = run
        self._terms = run.rows.terms
        self._wavelength_nm = wavelength_nm
        self._readers = load_plugins(self._terms["plugins.load"]).surface_readers()

    def surface(self, measured: Row) -> ReconstructedMap | None:
        """Return the map of a measurement; None, listed with the reason, if it cannot be reconstructed."""
        name = f"cycle-{measured['cycle']:02d}"
        try:
            found = self._found(measured)
        except PolishdError as error:
            self.left_out.append(f"figures of the map in {name}: {error}")
            return None
        if wrong := _differences(found, measured["stats"]):
            self.left_out.append(f"figures of the map in {name}: {wrong}")
            return None
        self.left_out += [f"{name}: {reason}" for reason in found.reported.answer["left_out"]]
        return found

    def _found(self, measured: Row) -> ReconstructedMap:
        run, cycle, stats = self._run, measured["cycle"], measured["stats"]
        path = run.file(cycle, "map")
        if path is None:
            raise ConfigError(f"{run.cycle(cycle)}: the file of the map is missing")
        profile = profile_of(run)
        instrument = None if profile is None else profile.instrument
        source = read_map(path, self._readers.values())
        registration = record_of(Registration, stats.get("registration") or {})
        on_part = steps.map_on_part(source, instrument, self._system(profile, stats.get("system") or ""))
        clean, _ = steps.of_part(on_part, self._terms["instrument.spike_threshold_mad"], self._nominal(), registration)
        grid, mask = _aperture(run, cycle)
        alignment = self._terms["part.alignment"]
        figure, clear = steps.figure_of(clean, grid, mask, registration, alignment)
        lsf_mm = float(self._terms["job.lsf_period_mm"])
        edges = (lsf_mm, HSF_MM) if lsf_mm > HSF_MM else (lsf_mm,)
        options = MapReportOptions(self._wavelength_nm, "fringe", TERMS, alignment=alignment)
        made = reported(figured(clean.with_height(figure), 0, edges, alignment), options)
        return ReconstructedMap(cycle, made, figure, clear, clean.grid.pitch_mm, source)

    def _nominal(self) -> SurfaceMap | None:
        named = self._terms.get("part.form")
        if not named:
            return None
        path = self._named(named["file"], named["sha256"], "the nominal form (part.form)")
        return read_map(path, self._readers.values())

    def _system(self, profile: InstrumentProfile | None, sha256: str) -> SystemMap | None:
        if not sha256:
            return None
        if profile is None or profile.system is None:
            raise ConfigError(f"{PROFILE}: does not name the system map that was subtracted ({sha256[:12]}…)")
        path = self._named(profile.system.map, sha256, "the instrument's system map")
        surface = read_map(path, self._readers.values())
        if surface.history is None:
            raise ConfigError(f"{path}: has no uncertainty of its terms")
        return SystemMap(surface, AbsoluteTestResult.load(surface.history.options["terms"]))

    def _named(self, name: str, sha256: str, what: str) -> Path:
        """Return a file in the folder of the run, the cell or the profile, found by name and SHA-256."""
        cell = self._run.cell
        candidates = [self._run.path / name, Path(name)]
        if cell is not None:
            candidates.append(cell.resolve(name))
            candidates += [] if cell.profile_path is None else [cell.profile_path.parent / name]
        for path in candidates:
            if path.is_file() and sha256_of(path) == sha256:
                return path
        raise ConfigError(
            f"{what}, {name} (sha256 {sha256[:12]}…), was not found. Copy it into the run folder, or name CELL.toml."
        )


def _aperture(run: CertificateRun, cycle: int) -> tuple[Grid, BoolArray]:
    """Return the process grid and the clear aperture on it."""
    path = run.cycle(cycle) / "surface.npz"
    surface = run.surface(cycle)
    if surface is None:
        raise ConfigError(f"{path}: missing, or cannot be read: the clear aperture is not known")
    ny, nx = surface.height_nm.shape
    return Grid(ny, nx, surface.pitch_mm), surface.metric_mask


def _differences(found: ReconstructedMap, stats: Mapping[str, Any]) -> str:
    """Return the differences between a reconstructed map and the journal; empty if there are none."""
    bands = found.reported.answer["bands"]
    made = {
        "rms_nm": found.reported.answer["rms_nm"],
        "pv_nm": found.reported.answer["pv_nm"],
        "lsf_rms_nm": bands[0]["rms_nm"] if bands else math.nan,
        "samples": int(np.count_nonzero(found.clear)),
    }
    differences = [
        f"{key} is {value:.9g}, and {stats[key]:.9g} in the journal"
        for key, value in made.items()
        if value is not None and not math.isclose(value, stats[key], rel_tol=SAME, abs_tol=SAME)
    ]
    return f"{'; '.join(differences)}: measured by another version of polishd" if differences else ""


def as_one_source(found: ReconstructedMap, stats: Mapping[str, Any]) -> ReconstructedMap:
    """Return the map with the journal's digits of the figures that the journal has."""
    answer = dict(found.reported.answer)
    answer |= {key: stats[key] for key in ("rms_nm", "pv_nm")}
    if answer["bands"]:
        answer["bands"] = [{**answer["bands"][0], "rms_nm": stats["lsf_rms_nm"]}, *answer["bands"][1:]]
    return replace(found, reported=replace(found.reported, answer=answer))
