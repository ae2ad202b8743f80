"""What a certificate is made of: one run folder, its summary and its journal, each held against the other."""

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


# The first and the last map of a run, made again from their files as the daemon judged them: one surface, one figure.

SAME = 1e-6
"""Relative: figures that were made again from the same file may differ by so much, on another processor."""
HSF_MM = 0.12
TERMS = 36
E_LINE_NM = 546.07


@dataclass(frozen=True, slots=True)
class ReconstructedMap:
    """A map with all its figures."""

    cycle: int
    reported: MapReportData
    figure_nm: FloatArray
    """(ny, nx) on the map's own samples, without what is alignment; NaN outside the clear aperture."""
    clear: BoolArray
    """(ny, nx) the clear aperture there."""
    pitch_mm: float
    source: SurfaceMap
    """As its file gives it."""

    def beyond_nm(self, cutoff_mm: float) -> float:
        """RMS of the periods below that."""
        return float(split_bands(self.figure_nm, self.clear, self.pitch_mm, (cutoff_mm,))[1][self.clear].std())


def profile_of(run: CertificateRun) -> InstrumentProfile | None:
    """The instrument's, as it was; None where the cell named none."""
    path = run.path / PROFILE
    return load_profile(path) if path.exists() else None


class MapReconstructor:
    """Makes maps of one run again, and keeps the reasons of what cannot be."""

    def __init__(self, run: CertificateRun, wavelength_nm: float) -> None:
        self.left_out: list[str] = []
        self._run = run
        self._terms = run.rows.terms
        self._wavelength_nm = wavelength_nm
        self._readers = load_plugins(self._terms["plugins.load"]).surface_readers()

    def surface(self, measured: Row) -> ReconstructedMap | None:
        """That measurement's map; None, with the reason kept, where it cannot be had."""
        name = f"cycle-{measured['cycle']:02d}"
        try:
            found = self._found(measured)
        except PolishdError as error:
            self.left_out.append(f"figures of the map in {name}: {error}")
            return None
        if wrong := _otherwise(found, measured["stats"]):
            self.left_out.append(f"figures of the map in {name}: {wrong}")
            return None
        self.left_out += [f"{name}: {reason}" for reason in found.reported.answer["left_out"]]
        return found

    def _found(self, measured: Row) -> ReconstructedMap:
        run, cycle, stats = self._run, measured["cycle"], measured["stats"]
        path = run.file(cycle, "map")
        if path is None:
            raise ConfigError(f"{run.cycle(cycle)}: the map's file is not there")
        profile = profile_of(run)
        instrument = None if profile is None else profile.instrument
        source = read_map(path, self._readers.values())
        lies = record_of(Registration, stats.get("registration") or {})
        lying = steps.map_on_part(source, instrument, self._system(profile, stats.get("system") or ""))
        clean, _ = steps.of_part(lying, self._terms["instrument.spike_threshold_mad"], self._nominal(), lies)
        grid, mask = _aperture(run, cycle)
        alignment = self._terms["part.alignment"]
        figure, clear = steps.figure_of(clean, grid, mask, lies, alignment)
        lsf_mm = float(self._terms["job.lsf_period_mm"])
        edges = (lsf_mm, HSF_MM) if lsf_mm > HSF_MM else (lsf_mm,)
        asked = MapReportOptions(self._wavelength_nm, "fringe", TERMS, alignment=alignment)
        made = reported(figured(clean.with_height(figure), 0, edges, alignment), asked)
        return ReconstructedMap(cycle, made, figure, clear, clean.grid.pitch_mm, source)

    def _nominal(self) -> SurfaceMap | None:
        named = self._terms.get("part.form")
        if not named:
            return None
        path = self._named(named["file"], named["sha256"], "the form wanted (part.form)")
        return read_map(path, self._readers.values())

    def _system(self, profile: InstrumentProfile | None, sha256: str) -> SystemMap | None:
        if not sha256:
            return None
        if profile is None or profile.system is None:
            raise ConfigError(f"{PROFILE}: does not name the system map that was taken off ({sha256[:12]}…)")
        path = self._named(profile.system.map, sha256, "the instrument's system map")
        surface = read_map(path, self._readers.values())
        if surface.history is None:
            raise ConfigError(f"{path}: does not say how sure its terms are")
        return SystemMap(surface, AbsoluteTestResult.load(surface.history.options["terms"]))

    def _named(self, name: str, sha256: str, what: str) -> Path:
        """A file that lies beside the cell or its profile: found by its name, believed by its content."""
        cell = self._run.cell
        places = [self._run.path / name, Path(name)]
        if cell is not None:
            places.append(cell.resolve(name))
            places += [] if cell.profile_path is None else [cell.profile_path.parent / name]
        for path in places:
            if path.is_file() and sha256_of(path) == sha256:
                return path
        raise ConfigError(
            f"{what}, {name} (sha256 {sha256[:12]}…), is not at hand; put it into the run folder, or name CELL.toml"
        )


def _aperture(run: CertificateRun, cycle: int) -> tuple[Grid, BoolArray]:
    """The process grid, and the clear aperture on it."""
    path = run.cycle(cycle) / "surface.npz"
    surface = run.surface(cycle)
    if surface is None:
        raise ConfigError(f"{path}: is not there, or cannot be read: nobody knows the clear aperture")
    ny, nx = surface.height_nm.shape
    return Grid(ny, nx, surface.pitch_mm), surface.metric_mask


def _otherwise(found: ReconstructedMap, stats: Mapping[str, Any]) -> str:
    """In what a map that was made again is not what the journal says of it; empty where it is."""
    bands = found.reported.answer["bands"]
    made = {
        "rms_nm": found.reported.answer["rms_nm"],
        "pv_nm": found.reported.answer["pv_nm"],
        "lsf_rms_nm": bands[0]["rms_nm"] if bands else math.nan,
        "samples": int(np.count_nonzero(found.clear)),
    }
    apart = [
        f"{key} comes out as {value:.9g}, and the journal has {stats[key]:.9g}"
        for key, value in made.items()
        if value is not None and not math.isclose(value, stats[key], rel_tol=SAME, abs_tol=SAME)
    ]
    return f"{'; '.join(apart)}: another polishd measured it" if apart else ""


def as_one_source(found: ReconstructedMap, stats: Mapping[str, Any]) -> ReconstructedMap:
    """The same with the journal's own digits of the figures that it has: no figure is told twice."""
    answer = dict(found.reported.answer)
    answer |= {key: stats[key] for key in ("rms_nm", "pv_nm")}
    if answer["bands"]:
        answer["bands"] = [{**answer["bands"][0], "rms_nm": stats["lsf_rms_nm"]}, *answer["bands"][1:]]
    return replace(found, reported=replace(found.reported, answer=answer))
