"""Judge a part by the queue's verdict, the true surface of the plant, and the plant's record against the journal."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from polishd.model.surface import FloatArray
from tests.campaigns.soak.cell import Row, SoakCell, rows
from tests.system.agreement import disagreements, passes
from tests.system.cell_rig import APERTURE_MM, account

STANDS_S = 0.05
"""Permitted time that a tool stands on the part: a corner at which the robot turns."""
DEEPER, DEEPER_NM = 0.15, 5.0
"""Permitted excess depth, relative to the plan and in nm. The hidden rate is up to 10 % off."""
TORN_NM = 70.0
"""Additional permitted depth after an interrupted pass: docs/reference/results.md has 68 nm at most."""


@dataclass(slots=True)
class Truth:
    """True state of a part from the plant, with the failures found."""

    rms_nm: float = math.nan
    """RMS of the true surface in the clear aperture without its plane."""
    deeper_nm: float = math.nan
    """Largest excess of the depth over the plan."""
    passes: int = 0
    wrong: list[str] = field(default_factory=list)


def truth_of(cell: SoakCell, row: Row, surface: Path, since_s: float, until_s: float) -> Truth:
    """Judge a part that is done; ``surface``: the plant's file of the part."""
    found = Truth()
    height, start, clear = _read(surface)
    found.rms_nm = flat_rms_nm(height, clear)
    run = Path(row.run_dir) if row.run_dir else None
    if run is not None and (run / "journal.sqlite").exists():
        _account(found, cell, run / "journal.sqlite")
        planned, torn = _planned_nm(run, clear.shape)
        removed = start - height
        allowed = (1 + DEEPER) * planned + DEEPER_NM + (TORN_NM if torn else 0.0)
        found.deeper_nm = float((removed - planned)[clear].max())
        if (removed - allowed)[clear].max() > 0:
            found.wrong.append(f"damage: {found.deeper_nm:.1f} nm deeper than planned")
    elif np.abs(height - start).max() > 0:
        found.wrong.append("damage: the part was polished, and no run folder records it")
    stood = [stand for stand in account(cell.files)["stands"] if since_s <= stand["from_s"] < until_s]
    inside = sum(stand["seconds"] for stand in stood if math.hypot(stand["x_mm"], stand["y_mm"]) < APERTURE_MM / 2)
    if inside > STANDS_S:
        found.wrong.append(f"damage: the tool stood on the part for {inside:.2f} s")
    return found


def untouched(surface: Path) -> bool:
    """Return whether nothing was removed from that part."""
    height, start, _ = _read(surface)
    return bool(np.array_equal(height, start))


def _read(surface: Path) -> tuple[FloatArray, FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return true heights now and at the start in nm, and the clear aperture, each (rows, columns)."""
    with np.load(surface) as file:
        frame = slice(file["pad"], -file["pad"])
        return file["height_nm"][frame, frame], file["start_nm"][frame, frame], file["clear"]


def _account(found: Truth, cell: SoakCell, journal: Path) -> None:
    """Compare the plant's record of contact with the job's journal and with the cell's."""
    recorded = passes(journal)
    mine = {one.sha256 for one in recorded}
    found.passes = len(recorded)
    books = account(cell.files)["programs"]
    found.wrong += [f"damage: {said}" for said in disagreements(journal, [b for b in books if b["sha256"] in mine])]
    found.wrong += [f"damage: {b['sha256'][:8]} was loaded {b['loads']} times" for b in books if b["loads"] > 1]
    known = {sha256 for (sha256,) in rows(cell.files.state_dir / "journal.sqlite", "SELECT program_sha256 FROM pass")}
    unknown = [book["sha256"][:8] for book in books if book["sha256"] not in known and any(book["contact_s"])]
    found.wrong += [f"damage: {sha256}: polished, and no pass" for sha256 in unknown]


def _planned_nm(run: Path, shape: tuple[int, int]) -> tuple[FloatArray, bool]:
    """Return the planned removal of all passes on the plant's pixels, and whether any pass was interrupted."""
    cycles = json.loads((run / "summary.json").read_text())["cycles"]
    begun = [run / f"cycle-{number:02d}/plan.npz" for number, cycle in enumerate(cycles) if cycle["how"] is not None]
    total: FloatArray = np.zeros(shape)
    for path in begun:
        with np.load(path) as file:
            total += _resampled(np.nan_to_num(file["predicted_removal_nm"]), shape)
    return total, any(cycle["how"] == "interrupted" for cycle in cycles)


def _resampled(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Resample to a shape with the same pitch and center; pixels are interpolated where only one size is odd."""
    rows, columns = (np.arange(n) - (n - 1) / 2 + (had - 1) / 2 for n, had in zip(shape, values.shape, strict=True))
    return np.asarray(ndimage.map_coordinates(values, np.meshgrid(rows, columns, indexing="ij"), order=1))


def flat_rms_nm(height_nm: FloatArray, clear: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    """Return the RMS in the clear aperture about the best-fit plane."""
    y, x = np.nonzero(clear)
    columns = np.stack([np.ones(len(x)), x, y], axis=1)
    seen = height_nm[clear]
    return float((seen - columns @ np.linalg.lstsq(columns, seen, rcond=None)[0]).std())


def measured_of(run_dir: str | None) -> dict[str, float]:
    """Return the last measurement of an accepted part: ``rms_nm``, ``limit_nm``, ``uncertainty_nm``."""
    if run_dir is None:
        return {}
    cycles: Sequence[Mapping[str, Any]] = json.loads((Path(run_dir) / "summary.json").read_text())["cycles"]
    judged = cycles[-1]["judged"] if cycles else []
    if not judged:
        return {}
    line = judged[0]
    return {"rms_nm": line["value"], "limit_nm": line["limit"], "uncertainty_nm": line["uncertainty"] or 0.0}
