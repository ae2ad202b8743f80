"""``polishd map average`` and ``polishd map subtract``: mean of repeats with uncertainty; difference of two maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from polishd.maps.compare import Pair, paired
from polishd.maps.convert import require_target, store, stored_lines
from polishd.maps.figures import HEIGHTS, figured, heights_nm
from polishd.maps.map_files import (
    MapSource,
    distinguish_names,
    draw,
    edges_mm,
    history_step,
    known_lines,
    mask_lines,
    mask_records,
    printable,
    require_picture,
    uncertainty_nm,
    warnings,
)
from polishd.maps.options import BANDS, AverageOptions, NewMapOptions
from polishd.model.errors import MapError
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.metrology.averaging import AverageResult, average_maps
from polishd.process.metrology.instrument import same_system
from polishd.process.metrology.statistics import pv_rms, remove_terms
from polishd.rendering.terminal import emit, figure_table, record_table

# ``polishd map subtract``: one map less another: a reference, a system error, the wavefront of a test stand.

SIDES = ("map", "subtracted")
"""Names of the two maps, in JSON and in the history."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference of two maps over their common samples."""

    surface: SurfaceMap
    """With the properties of the first map; unknown properties of either map are unknown."""
    pair: Pair
    uncertainty_nm: float | None
    """Uncertainty of a sample, one standard deviation; None where either map does not state its own."""


def subtract_maps(surface: SurfaceMap, other: SurfaceMap) -> Difference:
    """Subtract ``other`` from ``surface``, aligned as in ``map compare``: not registered, nothing leveled.

    Independent errors add in squares. Where maps are resampled the sum holds for errors that are alike over a few
    samples; noise from sample to sample becomes less.

    Raises:
        MapError: they cannot be laid on each other.
    """
    pair = paired(surface, other)
    one, two = pair.heights_nm
    doubts = {**other.doubts, **surface.doubts}
    unsaid = surface.unsaid | other.unsaid
    if surface.pitch_mm is not None and "pitch" not in surface.unsaid:  # samples for samples, the other's is the same
        unsaid -= {"pitch"}
        doubts.pop("pitch", None)
    known = [uncertainty_nm(side) for side in (surface, other)]
    found = replace(
        surface,
        height_nm=np.where(pair.mask, one - two, np.nan),
        pitch_mm=None if surface.pitch_mm is None else pair.pitch_mm,
        unsaid=unsaid,
        doubts=doubts,
        fiducials_px=_marks(surface, one, pair.pitch_mm),
    )
    return Difference(found, pair, None if None in known else math.hypot(*filter(None, known)))


def subtract_verb(first: Path, second: Path, asked: NewMapOptions, *, as_json: bool) -> None:
    """Show FIRST less SECOND, with the figures of both and of the difference; write it on request."""
    source = MapSource.by(asked)
    require_picture(asked.picture)
    if asked.out is not None:
        require_target(asked.out, [first, second], source, force=asked.force)
    other = source.read(second)
    if other.history is not None and other.history.options.get("result") == "instrument":
        source = replace(source, system=None)  # this map is the system error
    maps = [source.read(first), other]
    found = subtract_maps(*maps)
    mask = found.pair.mask
    heights = (*found.pair.heights_nm, found.surface.height_nm)
    figures = [heights_nm(height, remove_terms(height, mask, "tilt"), mask) for height in heights]
    answer: dict[str, Any] = {
        side: {
            "path": str(surface.path),
            "sha256": surface.sha256,
            "warnings": list(surface.warnings),
            "masks": mask_records(surface),
            **own,
        }
        for side, surface, own in zip(SIDES, maps, figures, strict=False)
    }
    rows, columns = mask.shape
    answer |= figures[2] | {
        "rows": rows,
        "cols": columns,
        "pitch_mm": found.surface.pitch_mm,
        "samples": int(np.count_nonzero(mask)),
        "sample_uncertainty_nm": found.uncertainty_nm,
        "notes": list(found.pair.notes),
    }
    kept = history_step(
        found.surface, "subtract", list(zip(SIDES, maps, strict=True)), source, known_nm=found.uncertainty_nm
    )
    if asked.out is not None:
        stored = store(kept, asked.out, source)
        answer |= stored | {"notes": [*found.pair.notes, *stored["notes"]]}
    _show(answer, as_json=as_json)
    if asked.picture is not None:
        draw_maps(asked.picture, [*maps, replace(kept, path=Path("difference"))], as_json=as_json)


def draw_maps(out: Path, surfaces: Sequence[SurfaceMap], *, as_json: bool) -> None:
    """Draw maps, some of which are in no file, as the PNG of ``--picture``, like ``polishd map FILE... --out``."""
    from polishd.maps.pictures import figures_picture

    edges = edges_mm(BANDS)
    picture = figures_picture([figured(surface, 0, edges) for surface in surfaces])
    draw(out, picture, "--picture", as_json=as_json)


def _marks(surface: SurfaceMap, laid_nm: FloatArray, pitch_mm: float | None) -> tuple[tuple[float, float], ...]:
    """The map's marks, (row, column), in the pixels of the new grid, center on center."""
    finer = surface.pitch_mm / pitch_mm if surface.pitch_mm is not None and pitch_mm is not None else 1.0
    (rows, columns), (ny, nx) = surface.height_nm.shape, laid_nm.shape
    return tuple(
        ((row - (rows - 1) / 2) * finer + (ny - 1) / 2, (column - (columns - 1) / 2) * finer + (nx - 1) / 2)
        for row, column in surface.fiducials_px
    )


def _show(answer: Mapping[str, Any], *, as_json: bool) -> None:
    both = [answer[side] for side in SIDES]
    names = distinguish_names([one["path"] for one in both])
    columns = ("nm", *names, "difference")
    rows = [(words, *(f"{one[key]:.3f}" for one in (*both, answer))) for key, words in HEIGHTS.items()]
    lines = [
        f"over the {answer['samples']} samples that both have",
        *known_lines(answer["sample_uncertainty_nm"]),
        *mask_lines(names, both),
        *warnings(names, both),
    ]
    if "out" in answer:
        lines += stored_lines(answer)
    else:
        lines += [*(f"note: {printable(note)}" for note in answer["notes"]), "not written: --out C.x3p would"]
    title = " less ".join(names)
    emit(answer, as_json=as_json, table=lambda: figure_table(title, columns, rows), lines=lines)


def average_verb(files: Sequence[Path], asked: AverageOptions, *, as_json: bool) -> None:
    """Average the maps, each without system error, piston and tilt; write the mean on request."""
    system, mixed = asked.system, asked.mixed
    source = MapSource.by(asked, system=system is None)  # one of the two options only
    require_picture(asked.picture)
    if asked.out is not None:
        require_target(asked.out, files if system is None else [*files, system], source, force=asked.force)
    read = [source.read(path) for path in files]
    _require_one_part(read)
    error = None if system is None else source.read(system)
    surfaces, notes = (read, []) if error is None else _without_system(read, error, mixed=mixed)
    found = average_maps(surfaces, mixed=mixed)
    own_nm = float(np.median(found.uncertainty_nm[found.mask]))
    system_nm = None if error is None else uncertainty_nm(error)
    known_nm = own_nm if error is None else None if system_nm is None else math.hypot(own_nm, system_nm)
    answer: dict[str, Any] = {
        "used": list(found.used),
        "rejected": dict(found.rejected),
        "samples": int(np.count_nonzero(found.mask)),
        "samples_rejected": found.samples_rejected,
        "rms_nm": found.rms_nm,
        "rms_uncertainty_nm": found.rms_uncertainty_nm,
        "sample_uncertainty_nm": own_nm,
        "system": None if error is None else _system_record(error, system_nm, known_nm),
        "notes": notes,
    }
    answer["masks"] = [{"path": str(one.path), "masks": mask_records(one)} for one in read if one.masks]
    mean = _mean_map(surfaces, found)
    if asked.out is not None:
        roles = ["left out" if name in found.rejected else "repeat" for name in found.names]
        inputs = [*zip(roles, read, strict=True), *([] if error is None else [("system error", error)])]
        stored = store(history_step(mean, "average", inputs, source, known_nm, mixed=mixed), asked.out, source)
        answer |= stored | {"notes": [*notes, *stored["notes"]]}
    emit(answer, as_json=as_json, table=lambda: _table(answer), lines=_lines(answer))
    if asked.picture is not None:
        drawn = [replace(mean, path=Path("mean")), *([] if error is None else [error])]
        draw_maps(asked.picture, drawn, as_json=as_json)


def _require_one_part(surfaces: Sequence[SurfaceMap]) -> None:
    parts = sorted({surface.part_id for surface in surfaces if surface.part_id})
    if len(parts) > 1:
        raise MapError(f"the maps are of several parts: {', '.join(parts)}; name repeats of one measurement")


def _mean_map(surfaces: Sequence[SurfaceMap], found: AverageResult) -> SurfaceMap:
    """The mean with the properties of the first map and the newest date; no instrument where there are several."""
    names = [surface.instrument for surface in surfaces if surface.instrument]
    times = [surface.measured_at for surface in surfaces if surface.measured_at is not None]
    return replace(
        surfaces[0],
        height_nm=found.height_nm,
        instrument=names[0] if names and all(same_system(name, names[0]) for name in names) else "",
        taken_at=max(times, default=None),
        date_from="header",
    )


def _without_system(
    surfaces: Sequence[SurfaceMap], error: SurfaceMap, *, mixed: bool
) -> tuple[list[SurfaceMap], list[str]]:
    """Subtract the instrument's own error from each map, and return notes; MapError for another instrument's map."""
    for surface in surfaces:
        named = surface.instrument and error.instrument
        if named and not mixed and not same_system(surface.instrument, error.instrument):
            raise MapError(f"{surface.path} is of the instrument {surface.instrument!r}, the system error {error.path} "
                         f"of {error.instrument!r}; name its own, or say --mixed")  # fmt: skip
    unnamed = replace(error, part_id="")  # expected: the reference is another part
    found = [subtract_maps(surface, unnamed) for surface in surfaces]
    notes = {note: None for one in found for note in one.pair.notes}
    return [one.surface for one in found], list(notes)


def _system_record(error: SurfaceMap, own_nm: float | None, known_nm: float | None) -> dict[str, Any]:
    return {
        "path": str(error.path),
        "sha256": error.sha256,
        "warnings": list(error.warnings),
        "rms_nm": pv_rms(remove_terms(error.height_nm, error.valid, "tilt"), error.valid)[1],
        "sample_uncertainty_nm": own_nm,
        "with_mean_nm": known_nm,
    }


def _table(answer: Mapping[str, Any]) -> Table:
    rows = [(name, "used", "") for name in answer["used"]]
    rows += [(name, "left out", f"{off:.3f}") for name, off in answer["rejected"].items()]
    return record_table("repeats", ("map", "what", "RMS off the median nm"), rows)


def _lines(answer: Mapping[str, Any]) -> list[str]:
    samples, rejected = answer["samples"], answer["samples_rejected"]
    mean = f"{answer['rms_nm']:.4f} +- {answer['rms_uncertainty_nm']:.4f} nm"
    known = f"{answer['sample_uncertainty_nm']:.4f} nm (median standard error)"
    masked = answer["masks"]
    lines = [
        *mask_lines(distinguish_names([record["path"] for record in masked]), masked),
        f"RMS of the mean, tilt removed: {mean} over {samples} samples",
        f"a sample is known to {known}; {rejected} single samples were left out",
        *_system_lines(answer["system"]),
    ]
    if "out" in answer:
        return lines + stored_lines(answer)
    return [*lines, *(f"note: {printable(note)}" for note in answer["notes"]), "not written: --out MEAN.x3p would"]


def _system_lines(system: Mapping[str, Any] | None) -> list[str]:
    if system is None:
        return []
    name = printable(Path(system["path"]).name)
    lines = [f"less the system error {name}, of {system['rms_nm']:.4f} nm RMS (its tilt removed)"]
    if system["with_mean_nm"] is None:
        lines.append("how sure that is its file does not say: a mean of repeats, written by average, does")
    else:
        known, both = (f"{system[key]:.4f} nm" for key in ("sample_uncertainty_nm", "with_mean_nm"))
        lines.append(f"which is known to {known} itself: a sample of the result to {both}")
    return [*lines, *warnings([name], [system])]
