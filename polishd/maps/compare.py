"""``polishd map compare``: two maps over their common samples, with the figures of the paper's Table V and fig. 15."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polishd.maps.figures import HEIGHTS, band_records, heights_nm
from polishd.maps.map_files import (
    MapSource,
    distinguish_names,
    draw,
    edges_mm,
    mask_lines,
    mask_records,
    or_dash,
    printable,
    require_picture,
    warnings,
)
from polishd.maps.options import FigureOptions
from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process.metrology.conditioning import SAME_PITCH
from polishd.process.metrology.spectra import RadialPsd, compare_maps
from polishd.process.metrology.statistics import pv_rms, remove_terms, trim_mask
from polishd.rendering.terminal import emit, figure_table

LEAST_COMMON = 0.5
"""Least share of the smaller map's data that both maps have: below it, they show different parts or positions."""
SIDES = ("before", "after")
Line = tuple[str, float | None, float | None]
"""Compared figures, before and after, nm."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two maps on one grid; ``notes`` describe the resampling."""

    heights_nm: tuple[FloatArray, FloatArray]
    """(ny, nx) before and after."""
    mask: BoolArray
    """(ny, nx) common samples."""
    pitch_mm: float | None
    notes: tuple[str, ...] = ()


def compare_verb(before: Path, after: Path, asked: FigureOptions, *, as_json: bool) -> None:
    """Figures of both maps, and their changes."""
    edges = edges_mm(asked.bands)
    require_picture(asked.out)
    source = MapSource.by(asked)
    maps = [source.read(path) for path in (before, after)]
    pair = paired(*maps, trim=asked.trim)
    pitch, mask = pair.pitch_mm, pair.mask
    found = None if pitch is None else compare_maps(*pair.heights_nm, mask, pitch, edges)
    answer: dict[str, Any] = {}
    for side, surface, height in zip(SIDES, maps, pair.heights_nm, strict=True):
        answer[side] = {
            "path": str(surface.path),
            "sha256": surface.sha256,
            "warnings": list(surface.warnings),
            "masks": mask_records(surface),
            **heights_nm(height, remove_terms(height, mask, "tilt"), mask),
            "bands": None if pitch is None else band_records(getattr(found, side).band_rms_nm, mask, pitch, edges),
        }
    lines = _lines(answer)
    answer["change_percent"] = {key: _percent(was, now) for key, (_, was, now) in lines.items()}
    answer |= _common(pair, asked.trim)
    spectra = {} if found is None else {side: getattr(found, side).psd for side in SIDES}
    answer["psd"] = None if found is None else _psd(spectra)
    _show(answer, lines, as_json=as_json)
    if asked.out is not None:
        from polishd.maps.pictures import comparison_picture

        figures = {words: (was, now) for words, was, now in lines.values() if was is not None and now is not None}
        heights = dict(zip(SIDES, pair.heights_nm, strict=True))
        draw(asked.out, comparison_picture(heights, spectra, mask, pitch, figures), as_json=as_json)


def paired(before: SurfaceMap, after: SurfaceMap, *, trim: int = 0) -> Pair:
    """Two maps on the coarser one's grid, over the samples that both have.

    Raises:
        MapError: shapes differ and a pitch is missing, or little of the maps covers the same place.
    """
    notes = _part_notes(before, after)
    pitch, other = before.pitch_mm, after.pitch_mm
    same_shape = before.height_nm.shape == after.height_nm.shape
    heights = (before.height_nm, after.height_nm)
    if pitch is None or other is None:
        if not same_shape:
            raise MapError(f"{after.path}: has not the samples of {before.path}, and one has no lateral scale; "
                         "give the instrument's --profile")  # fmt: skip
        if pitch is not other:
            notes.append("one map has no lateral scale: the other's is taken for both")
        pitch = other if pitch is None else pitch
    elif not same_shape or abs(pitch - other) > SAME_PITCH * pitch:
        heights, grid = _resampled(before, after)
        pitch = grid.pitch_mm
        notes.append(f"resampled to {grid.ny} x {grid.nx} samples of {pitch:.7g} mm, centre on centre")
    return Pair(heights, _common_mask(before, after, heights, trim), pitch, tuple(notes))


def _resampled(before: SurfaceMap, after: SurfaceMap) -> tuple[tuple[FloatArray, FloatArray], Grid]:
    """Both maps at the coarser pitch over their common area, and that grid."""
    from polishd.process.metrology.resampling import resample_registered

    one, two = before.grid, after.grid
    pitch = max(one.pitch_mm, two.pitch_mm)
    ny, nx = (int(min(one.shape[k] * one.pitch_mm, two.shape[k] * two.pitch_mm) / pitch + 1e-6) for k in (0, 1))
    grid = Grid(max(1, ny), max(1, nx), pitch)
    return (resample_registered(before.height_nm, one, grid), resample_registered(after.height_nm, two, grid)), grid


def _common_mask(before: SurfaceMap, after: SurfaceMap, heights: tuple[FloatArray, FloatArray], trim: int) -> BoolArray:
    valid = [np.isfinite(height) for height in heights]
    both = np.asarray(valid[0] & valid[1])
    if np.count_nonzero(both) < max(1.0, LEAST_COMMON * min(np.count_nonzero(one) for one in valid)):
        raise MapError(f"{after.path}: shares only {np.count_nonzero(both)} samples with {before.path}: another part, "
                     "or another place on it")  # fmt: skip
    mask = trim_mask(both, trim)
    if not mask.any():
        raise MapError(f"{after.path}: nothing is left of what it shares with {before.path}; --trim less")
    return mask


def _part_notes(before: SurfaceMap, after: SurfaceMap) -> list[str]:
    parts = {name for name in (before.part_id, after.part_id) if name}
    notes = [f"the maps name two parts: {before.part_id}, {after.part_id}"] if len(parts) > 1 else []
    unsaid = sorted(before.unsaid ^ after.unsaid)
    return notes + ([f"only one of the maps says its {', '.join(unsaid)}"] if unsaid else [])


def _lines(answer: Mapping[str, Any]) -> dict[str, Line]:
    """Table V and the bands, by the names of the changes."""
    before, after = (answer[side] for side in SIDES)
    lines: dict[str, Line] = {
        key.removesuffix("_nm"): (words, before[key], after[key]) for key, words in HEIGHTS.items()
    }
    for was, now in zip(before["bands"] or (), after["bands"] or (), strict=True):
        lines[was["name"]] = (f"{was['name']} RMS{' (soft)' if was['soft'] else ''}", was["rms_nm"], now["rms_nm"])
    return lines


def _percent(before: float | None, after: float | None) -> float | None:
    """Change in percent of the first value, below 0 is better; None where that value is 0 or missing."""
    return 100 * (after / before - 1) if before and after is not None else None


def _common(pair: Pair, trim: int) -> dict[str, Any]:
    before, after = pair.heights_nm
    pv, rms = pv_rms(after - before, pair.mask)
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


def _psd(spectra: Mapping[str, RadialPsd]) -> dict[str, Any]:
    """Fig. 15: the radial spectra of both maps."""
    densities = {f"{side}_nm2_mm2": psd.density_nm2_mm2 for side, psd in spectra.items()}
    return {"frequency_per_mm": spectra["before"].frequency_per_mm, **densities}


def _show(answer: Mapping[str, Any], lines: Mapping[str, Line], *, as_json: bool) -> None:
    names = distinguish_names([answer[side]["path"] for side in SIDES])
    change = answer["change_percent"]
    rows = [
        (words, or_dash(was, ".3f"), or_dash(now, ".3f"), or_dash(change[key], "+.2f"))
        for key, (words, was, now) in lines.items()
    ]
    notes = [f"over the {answer['samples']} samples that both have"]
    both = [answer[side] for side in SIDES]
    notes += [*mask_lines(names, both), *warnings(names, both)]
    notes += [f"note: {printable(note)}" for note in answer["notes"]]
    title, columns = " to ".join(names), ("nm", *SIDES, "change, %")
    emit(answer, as_json=as_json, table=lambda: figure_table(title, columns, rows), lines=notes)
