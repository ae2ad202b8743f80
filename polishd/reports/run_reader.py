"""Reads a run or plan folder into arrays. A file that is absent or broken is listed as missing."""

from __future__ import annotations

import csv
import json
import math
import zipfile
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polishd.process.robot.motion import executed_s
from polishd.reports.pictures import NamedMap

Arrays = Mapping[str, NDArray[Any]]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
T = TypeVar("T")

NOTED = ("learned.json", "settling.json", "touch_off.json")
"""Files of a cycle that may hold notes for the operator."""

EXECUTED_COLUMNS = frozenset({"seq", "start_s", "end_s", "contact"})


@dataclass(frozen=True, slots=True)
class ReportSurface:
    """Measured map on the process grid: ``height_nm`` (ny, nx), row 0 the top, NaN = no data."""

    height_nm: FloatArray
    metric_mask: BoolArray
    pitch_mm: float

    def levelled(self, height_nm: FloatArray | None = None) -> FloatArray:
        """Return this map, or another on its grid, less its mean in the clear aperture."""
        height = self.height_nm if height_nm is None else height_nm
        inside = height[self.metric_mask & np.isfinite(height)]
        return height - (inside.mean() if inside.size else 0.0)

    def inside(self, height_nm: FloatArray | None = None) -> FloatArray:
        """Samples in the clear aperture that have data, mean removed, (k,)."""
        height = self.levelled(height_nm)
        return height[self.metric_mask & np.isfinite(height)]

    def rms_nm(self, height_nm: FloatArray | None = None) -> float:
        """RMS in the clear aperture, mean removed; NaN without data."""
        inside = self.inside(height_nm)
        return float(inside.std()) if inside.size else math.nan

    def named(self, name: str, height_nm: FloatArray | None = None, rms_nm: float = math.nan) -> NamedMap:
        """Return this map, or another on its grid, for a picture, with the RMS ``rms_nm``; NaN: that of the grid."""
        rms_nm = self.rms_nm(height_nm) if math.isnan(rms_nm) else rms_nm
        return NamedMap(name, self.levelled(height_nm), self.metric_mask, rms_nm)


@dataclass(frozen=True, slots=True)
class ExecutedTimes:
    """Executed blocks in contact: (k,) sequence numbers and seconds, summed over the pieces of a block."""

    seq: NDArray[np.int64]
    seconds: FloatArray

    def per_point(self, plan: Arrays) -> FloatArray | None:
        """Return the executed seconds of each timed point, NaN if not executed; None if the blocks do not match."""
        n = plan["expected_s"].size
        if "block" in plan:
            block = np.asarray(plan["block"], dtype=np.int64)
            return np.where(np.isin(block, self.seq), executed_s(block, self.seq, self.seconds), math.nan)
        return self.seconds if self.seconds.size == n else None


@dataclass(frozen=True, slots=True)
class Cycle:
    """Content of a cycle's folder."""

    name: str
    surface: ReportSurface | None
    plan: Arrays | None
    certificate: Mapping[str, Any] | None
    executed: ExecutedTimes | None
    files: tuple[str, ...]
    notes: tuple[str, ...] = ()
    """From the estimates after the pass before it, the thermal settling and the touch-off."""


@dataclass(frozen=True, slots=True)
class RunFolderReader:
    """A run folder, or a plan folder (``planned``: it holds the files of its single cycle)."""

    path: Path
    planned: bool
    summary: Mapping[str, Any]
    cycles: tuple[Cycle, ...]
    missing: list[str] = field(default_factory=list)
    """Files that a complete folder has and this one has not, or that cannot be read."""

    def rows(self) -> list[Mapping[str, Any]]:
        """Return the summary's entry of each measurement; empty without a summary."""
        rows = self.summary.get("cycles")
        return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []


def read_folder(path: Path) -> RunFolderReader:
    """Read a run or plan folder."""
    reader = _Reader(path)
    summary = reader.json(path / "summary.json") or {}
    planned = (path / "surface.npz").exists() or (path / "plan.npz").exists()
    folders = [path] if planned else sorted(entry for entry in path.glob("cycle-*") if entry.is_dir())
    cycles = tuple(map(reader.cycle, folders))
    if not cycles:
        reader.missing.append("cycle-00: no measurement was taken")
    return RunFolderReader(path, planned, summary, cycles, reader.missing)


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads the files of a run, and lists those that it cannot read."""

    root: Path
    missing: list[str] = field(default_factory=list)

    def lacks(self, path: Path, reason: str) -> None:
        """List a file with what is wrong."""
        self.missing.append(f"{path.relative_to(self.root)}: {reason}")

    def read(self, path: Path, parse: Callable[[Path], T]) -> T | None:
        """Parse a file; None, listed, if it cannot be read."""
        try:
            return parse(path)
        except FileNotFoundError:
            self.lacks(path, "not there")
        except (OSError, ValueError, LookupError, EOFError, AttributeError, zipfile.BadZipFile, csv.Error) as error:
            self.lacks(path, f"cannot be read ({error!r})" if path.suffix == ".csv" else f"cannot be read ({error})")
        return None

    def json(self, path: Path) -> dict[str, Any] | None:
        """Read a JSON object."""
        content = self.read(path, lambda path: [json.loads(path.read_text(encoding="utf-8"))])
        if content is not None and not isinstance(content[0], dict):
            self.lacks(path, "not an object")
            return None
        return content[0] if content else None

    def cycle(self, folder: Path) -> Cycle:
        """Read a cycle's folder. A cycle without a plan had no pass; nothing is missing then."""
        surface = self.surface(folder / "surface.npz")
        plan = certificate = executed = None
        if (folder / "plan.npz").exists():
            plan = self.read(folder / "plan.npz", _arrays)
            certificate = self.json(folder / "certificate.json")
            if folder != self.root:
                executed = self.read(folder / "executed.csv", _executed)
        files = (entry.relative_to(self.root).as_posix() for entry in folder.iterdir() if entry.is_file())
        name = "plan" if folder == self.root else folder.name
        notes = [note for file in NOTED for note in self.notes(folder / file)]
        return Cycle(name, surface, plan, certificate, executed, tuple(sorted(files)), tuple(notes))

    def notes(self, path: Path) -> list[str]:
        """Read the notes of a file; empty if there is no file."""
        notes = (self.json(path) or {}).get("notes") if path.exists() else None
        return [str(note) for note in notes] if isinstance(notes, list) else []

    def surface(self, path: Path) -> ReportSurface | None:
        """Read ``surface.npz``. Without a mask, all data are in the clear aperture."""
        arrays = self.read(path, _arrays)
        if arrays is None:
            return None
        try:
            height = np.asarray(arrays["height_nm"], dtype=np.float64)
            pitch = float(arrays["pitch_mm"])
        except (KeyError, TypeError, ValueError) as error:
            self.lacks(path, str(error))
            return None
        mask = np.asarray(arrays.get("metric_mask", np.isfinite(height)), dtype=np.bool_)
        if height.ndim != 2 or mask.shape != height.shape:
            self.lacks(path, f"shapes {height.shape} and {mask.shape} do not fit")
            return None
        return ReportSurface(height, mask, pitch)


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    # opened here: numpy does not close a file that is no archive
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _executed(path: Path) -> ExecutedTimes:
    """Read the blocks in contact from ``executed.csv`` (seq, start_s, end_s, contact)."""
    found, seconds = array("q"), array("d")
    with path.open(encoding="utf-8", newline="") as lines:
        table = csv.reader(lines)
        header = next(table, [])
        if absent := EXECUTED_COLUMNS.difference(header):
            raise ValueError(f"no column {', '.join(sorted(absent))}")
        seq, start_s, end_s, contact = (header.index(name) for name in ("seq", "start_s", "end_s", "contact"))
        for row in filter(None, table):
            if row[contact].strip().lower() in ("1", "1.0", "true"):
                found.append(int(float(row[seq])))
                seconds.append(float(row[end_s]) - float(row[start_s]))
    order, which = np.unique(np.array(found, dtype=np.int64), return_inverse=True)  # a block in pieces has several rows
    seconds_of = np.bincount(which, weights=np.array(seconds), minlength=order.size)
    return ExecutedTimes(order, seconds_of.astype(np.float64))  # bincount of no rows gives integers
