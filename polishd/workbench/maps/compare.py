"""``polishd map compare``: two maps over the samples that both have, as the paper's Table V and fig. 15 compare two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from polishd.model.errors import BadMap
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process import metrics
from polishd.show.tables import figure_table, stdout
from polishd.workbench.maps.figures import band_records, json_line
from polishd.workbench.maps.files import edges_mm, map_from, profile_of, readers_for, require_picture, shown, told_apart
from polishd.workbench.maps.options import FigureOptions

SAME_PITCH = 1e-6
"""Part of a pitch by which two may differ and still be one grid."""
LEAST_COMMON = 0.5
"""Share of the smaller map's data that both must have: less is another part, or another place on it."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two maps on one grid; ``notes`` say how they came there."""

    before_nm: FloatArray
    after_nm: FloatArray
    mask: BoolArray
    """(ny, nx) samples that both have."""
    pitch_mm: float | None
    notes: tuple[str, ...] = ()


def compare_verb(before: Path, after: Path, options: FigureOptions, *, as_json: bool) -> None:
    """Figures of both, and by how much they changed."""
    edges = edges_mm(options.bands)
    require_picture(options.out)
    instrument, readers = profile_of(options.profile), readers_for(options.cell)
    maps = [map_from(path, readers, instrument) for path in (before, after)]
    pair = paired(*maps, trim=options.trim)
    found = _compared(pair, edges)
    answer: dict[str, Any] = {
        "before": {**_which(maps[0]), **_figures(pair, pair.before_nm, None if found is None else found.before, edges)},
        "after": {**_which(maps[1]), **_figures(pair, pair.after_nm, None if found is None else found.after, edges)},
    }
    answer["change_percent"] = _changes(answer["before"], answer["after"])
    answer |= _common(pair, options.trim)
    answer["psd"] = None if found is None else _psd(found)
    if as_json:
        typer.echo(json_line(answer))
    else:
        _show(answer)
    if options.out is not None:
        _draw(options.out, pair, found, answer)
        if not as_json:
            stdout.print(f"drawn in {shown(options.out)}", markup=False)


def paired(before: SurfaceMap, after: SurfaceMap, *, trim: int = 0) -> Pair:
    """Two maps on the coarser one's grid, over the samples that both have.

    Raises:
        BadMap: shapes differ and a pitch is missing, or little of the maps covers the same place.
    """
    notes = _part_notes(before, after)
    pitch, other = before.pitch_mm, after.pitch_mm
    same_shape = before.height_nm.shape == after.height_nm.shape
    if pitch is None or other is None:
        if not same_shape:
            raise BadMap(f"{after.path}: has not the samples of {before.path}, and one has no lateral scale; "
                         "give the instrument's --profile")  # fmt: skip
        heights = (before.height_nm, after.height_nm)
        if pitch is not other:
            notes.append("one map has no lateral scale: the other's is taken for both")
        pitch = other if pitch is None else pitch
    elif same_shape and abs(pitch - other) <= SAME_PITCH * pitch:
        heights = (before.height_nm, after.height_nm)
    else:
        grid = _common_grid(before.grid, after.grid)
        heights, pitch = _resampled(before, after, grid), grid.pitch_mm
        notes.append(f"resampled to {grid.ny} x {grid.nx} samples of {pitch:.7g} mm, centre on centre")
    return Pair(*heights, _common_mask(before, after, heights, trim), pitch, tuple(notes))


def _common_grid(one: Grid, two: Grid) -> Grid:
    """The coarser pitch, over what both reach."""
    pitch = max(one.pitch_mm, two.pitch_mm)
    rows, columns = (min(one.shape[k] * one.pitch_mm, two.shape[k] * two.pitch_mm) for k in (0, 1))
    return Grid(max(1, int(rows / pitch + 1e-6)), max(1, int(columns / pitch + 1e-6)), pitch)


def _resampled(before: SurfaceMap, after: SurfaceMap, grid: Grid) -> tuple[FloatArray, FloatArray]:
    from polishd.process.registration import resample_registered

    one, two = (resample_registered(found.height_nm, found.grid, grid) for found in (before, after))
    return one, two


def _common_mask(before: SurfaceMap, after: SurfaceMap, heights: tuple[FloatArray, FloatArray], trim: int) -> BoolArray:
    valid = [np.isfinite(height) for height in heights]
    both = np.asarray(valid[0] & valid[1])
    if np.count_nonzero(both) < max(1.0, LEAST_COMMON * min(np.count_nonzero(one) for one in valid)):
        raise BadMap(f"{after.path}: shares only {np.count_nonzero(both)} samples with {before.path}: another part, "
                     "or another place on it")  # fmt: skip
    mask = metrics.trimmed(both, trim)
    if not mask.any():
        raise BadMap(f"{after.path}: nothing is left of what it shares with {before.path}; --trim less")
    return mask


def _part_notes(before: SurfaceMap, after: SurfaceMap) -> list[str]:
    parts = {name for name in (before.part_id, after.part_id) if name}
    notes = [f"the maps name two parts: {before.part_id}, {after.part_id}"] if len(parts) > 1 else []
    unsaid = sorted(before.unsaid ^ after.unsaid)
    return notes + ([f"only one of the maps says its {', '.join(unsaid)}"] if unsaid else [])


def _which(surface: SurfaceMap) -> dict[str, Any]:
    return {"path": str(surface.path), "sha256": surface.sha256, "warnings": list(surface.warnings)}


def _compared(pair: Pair, edges: Sequence[float]) -> metrics.Comparison | None:
    """Bands and spectra; None without a lateral scale."""
    if pair.pitch_mm is None:
        return None
    return metrics.compare(pair.before_nm, pair.after_nm, pair.mask, pair.pitch_mm, edges)


def _figures(
    pair: Pair, height_nm: FloatArray, found: metrics.Figures | None, edges: Sequence[float]
) -> dict[str, Any]:
    pv, rms = metrics.pv_rms(height_nm, pair.mask)
    level_pv, level_rms = metrics.pv_rms(metrics.without(height_nm, pair.mask, "tilt"), pair.mask)
    bands = None if found is None or pair.pitch_mm is None else band_records(found.band_rms_nm, pair.pitch_mm, edges)
    return {
        "pv_nm": pv,
        "rms_nm": rms,
        "pv_tilt_removed_nm": level_pv,
        "rms_tilt_removed_nm": level_rms,
        "bands": bands,
    }


def _changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Table V: change of each figure, percent of the one before; below 0 is better, None where that is 0 or none."""
    keys = ("pv_nm", "rms_nm", "pv_tilt_removed_nm", "rms_tilt_removed_nm")
    found = {key.removesuffix("_nm"): _percent(before[key], after[key]) for key in keys}
    pairs = zip(before["bands"] or (), after["bands"] or (), strict=True)
    return found | {was["name"]: _percent(was["rms_nm"], now["rms_nm"]) for was, now in pairs}


def _percent(before: float | None, after: float | None) -> float | None:
    return 100 * (after / before - 1) if before and after is not None else None


def _psd(found: metrics.Comparison) -> dict[str, Any]:
    """Fig. 15: the radial spectra of both."""
    before, after = found.before.psd, found.after.psd
    return {
        "frequency_per_mm": before.frequency_per_mm,
        "before_nm2_mm2": before.density_nm2_mm2,
        "after_nm2_mm2": after.density_nm2_mm2,
    }


def _common(pair: Pair, trim: int) -> dict[str, Any]:
    change = pair.after_nm - pair.before_nm
    pv, rms = metrics.pv_rms(change, pair.mask)
    rows, columns = pair.mask.shape
    return {
        "difference_pv_nm": pv,
        "difference_rms_nm": rms,
        "rows": rows,
        "cols": columns,
        "pitch_mm": pair.pitch_mm,
        "samples": int(np.count_nonzero(pair.mask)),
        "trim": trim,
        "notes": list(pair.notes),
    }


def _draw(out: Path, pair: Pair, found: metrics.Comparison | None, answer: Mapping[str, Any]) -> None:
    from polishd.show.style import save_picture
    from polishd.workbench.maps.pictures import compared_picture

    spectra = {} if found is None else {"before": found.before.psd, "after": found.after.psd}
    heights = {"before": pair.before_nm, "after": pair.after_nm}
    figures = {name: (was, now) for name, was, now, _ in _lines(answer) if was is not None and now is not None}
    save_picture(out, compared_picture(heights, spectra, pair.mask, pair.pitch_mm, figures))


def _lines(answer: Mapping[str, Any]) -> list[tuple[str, float | None, float | None, float | None]]:
    """Name, before and after in nm, change in percent: Table V, and the bands."""
    before, after, change = answer["before"], answer["after"], answer["change_percent"]
    names = {"pv": "PV", "rms": "RMS", "pv_tilt_removed": "PV level", "rms_tilt_removed": "RMS level"}
    bands = zip(before["bands"] or (), after["bands"] or (), strict=True)
    return [(name, before[f"{key}_nm"], after[f"{key}_nm"], change[key]) for key, name in names.items()] + [
        (f"{was['name']} RMS", was["rms_nm"], now["rms_nm"], change[was["name"]]) for was, now in bands
    ]


def _show(answer: Mapping[str, Any]) -> None:
    names = told_apart([answer[which]["path"] for which in ("before", "after")])
    rows = [_row(*line) for line in _lines(answer)]
    stdout.print(figure_table(" to ".join(names), ("nm", "before", "after", "change, %"), rows))
    notes = [f"warning: {name}: {shown(warning)}" for name, which in zip(names, ("before", "after"), strict=True)
             for warning in answer[which]["warnings"]]  # fmt: skip
    notes.insert(0, f"over the {answer['samples']} samples that both have")
    for line in (*notes, *(f"note: {shown(note)}" for note in answer["notes"])):
        stdout.print(line, markup=False)


def _row(name: str, *values: float | None) -> tuple[str, ...]:
    forms = (".3f", ".3f", "+.2f")
    return (name, *("-" if v is None else f"{v:{form}}" for v, form in zip(values, forms, strict=True)))
