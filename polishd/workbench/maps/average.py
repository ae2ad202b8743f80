"""``polishd map average``: repeats of one measurement as one map, without those that deviate, and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from polishd.model.errors import BadMap
from polishd.model.surface import SurfaceMap
from polishd.process.repeats import Repeats, average
from polishd.show.tables import emit, record_table
from polishd.workbench.maps.convert import require_target, store, stored_lines
from polishd.workbench.maps.files import MapSource, told_apart
from polishd.workbench.maps.history import made
from polishd.workbench.maps.masks import mask_lines, mask_records


def average_verb(
    files: Sequence[Path],
    target: Path | None,
    source: MapSource,
    *,
    mixed: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Average the maps, each without its own piston and tilt; write the mean where it is wanted."""
    if target is not None:
        require_target(target, files, source, force=force)
    surfaces = [source.read(path) for path in files]
    _require_one_part(surfaces)
    found = average(surfaces, mixed=mixed)
    answer: dict[str, Any] = {
        "used": list(found.used),
        "rejected": dict(found.rejected),
        "samples": int(np.count_nonzero(found.mask)),
        "samples_rejected": found.samples_rejected,
        "rms_nm": found.rms_nm,
        "rms_uncertainty_nm": found.rms_uncertainty_nm,
        "sample_uncertainty_nm": float(np.median(found.uncertainty_nm[found.mask])),
    }
    answer["masks"] = [{"path": str(one.path), "masks": mask_records(one)} for one in surfaces if one.masks]
    if target is not None:
        answer |= store(_kept(surfaces, found, source, mixed=mixed), target, source)
    emit(answer, as_json=as_json, table=lambda: _table(answer), lines=_lines(answer))


def _require_one_part(surfaces: Sequence[SurfaceMap]) -> None:
    parts = sorted({surface.part_id for surface in surfaces if surface.part_id})
    if len(parts) > 1:
        raise BadMap(f"the maps are of several parts: {', '.join(parts)}; name repeats of one measurement")


def _mean_map(surfaces: Sequence[SurfaceMap], found: Repeats) -> SurfaceMap:
    """The mean with what is known of the first map; as new as the newest."""
    times = [surface.measured_at for surface in surfaces if surface.measured_at is not None]
    return replace(surfaces[0], height_nm=found.height_nm, taken_at=max(times, default=None), date_from="header")


def _kept(surfaces: Sequence[SurfaceMap], found: Repeats, source: MapSource, *, mixed: bool) -> SurfaceMap:
    """The mean, and in its history all maps by what became of them."""
    roles = ["left out" if name in found.rejected else "repeat" for name in found.names]
    return made(_mean_map(surfaces, found), "average", list(zip(roles, surfaces, strict=True)), source, mixed=mixed)


def _table(answer: Mapping[str, Any]) -> Table:
    rows = [(name, "used", "") for name in answer["used"]]
    rows += [(name, "left out", f"{off:.3f}") for name, off in answer["rejected"].items()]
    return record_table("repeats", ("map", "what", "RMS off the median nm"), rows)


def _lines(answer: Mapping[str, Any]) -> list[str]:
    samples, rejected = answer["samples"], answer["samples_rejected"]
    mean = f"{answer['rms_nm']:.4f} +- {answer['rms_uncertainty_nm']:.4f} nm"
    known = f"{answer['sample_uncertainty_nm']:.4f} nm (median standard error)"
    masked = answer["masks"]
    return [
        *mask_lines(told_apart([record["path"] for record in masked]), masked),
        f"RMS of the mean, tilt removed: {mean} over {samples} samples",
        f"a sample is known to {known}; {rejected} single samples were left out",
        *(stored_lines(answer) if "out" in answer else ["not written: --out MEAN.x3p would"]),
    ]
