"""``polishd map stitch``: combine overlapping sub-apertures into one map with its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from polishd.maps.convert import require_target, store, stored_lines
from polishd.maps.map_files import (
    MapSource,
    distinguish_names,
    draw,
    history_step,
    mask_lines,
    mask_records,
    require_picture,
)
from polishd.maps.options import StitchOptions
from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.conditioning import SAME_PITCH
from polishd.process.metrology.statistics import pv_rms
from polishd.process.metrology.stitching import StitchResult, SubAperture, stitch
from polishd.rendering.terminal import emit, figure_table

FREE = ("power", "shift")


def stitch_verb(files: Sequence[Path], asked: StitchOptions, *, as_json: bool) -> None:
    """Stitch the maps, with the first as reference; write the result and its uncertainty on request."""
    from polishd.config.table_files import read_positions

    free = _free(asked.free)
    source = MapSource.by(asked)
    _require_targets(files, asked, source)
    positions = read_positions(asked.at)
    require_lines(files, positions, asked.at, "file,x_mm,y_mm")
    surfaces = [source.read(path) for path in files]
    pitch = one_pitch(surfaces)
    names = distinguish_names(files)
    maps = [
        SubAperture(name, one.height_nm, *positions[path.name])
        for name, path, one in zip(names, files, surfaces, strict=True)
    ]
    found = stitch(maps, pitch, power="power" in free, shift="shift" in free)
    answer = _answer(found, maps[0], pitch, free)
    answer["masks"] = [{"path": str(one.path), "masks": mask_records(one)} for one in surfaces if one.masks]
    places = [f"{path.name} {x:.9g},{y:.9g} mm" for path in files for x, y in [positions[path.name]]]
    answer |= _stored(surfaces, found, asked, source, free=list(free), at=places)
    emit(answer, as_json=as_json, table=lambda: _table(answer), lines=_lines(answer))
    if asked.picture is not None:
        from polishd.maps.pictures import stitch_picture

        draw(
            asked.picture,
            stitch_picture(found.height_nm, found.uncertainty_nm, found.maps, pitch),
            "--picture",
            as_json=as_json,
        )


def _free(text: str) -> tuple[str, ...]:
    words = tuple(word.strip() for word in text.split(",") if word.strip())
    unknown = [word for word in words if word not in FREE]
    if unknown:
        raise typer.BadParameter(f"--free {text!r}: {', '.join(FREE)}, or both; piston and tilt always are")
    return words


def _require_targets(files: Sequence[Path], asked: StitchOptions, source: MapSource) -> None:
    targets = [target for target in (asked.out, asked.uncertainty) if target is not None]
    for target in targets:
        require_target(target, files, source, force=asked.force)
    if len({target.absolute() for target in targets}) < len(targets):
        raise ConfigError(f"{asked.out}: is named by --out and --uncertainty; name two files")
    require_picture(asked.picture)


def require_lines(files: Sequence[Path], listed: Collection[str], at: Path, line: str) -> None:
    """ConfigError where a list does not have a line for each map, identified by its file's name."""
    names = [path.name for path in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{', '.join(twice)}: named twice; {at} identifies maps by their file names")
    missing = [name for name in names if name not in listed]
    if missing:
        raise ConfigError(f"{at}: does not say where {', '.join(missing)} lies; add a line {line} for each map")


def one_pitch(surfaces: Sequence[SurfaceMap]) -> float:
    """Common pitch of maps of one part; MapError where there is none, or where they show several parts."""
    pitches: list[float] = []
    for one in surfaces:
        if one.pitch_mm is None:
            raise MapError(f"{one.path}: has no lateral scale, so the positions of its samples are unknown; give the "
                         "instrument's --profile")  # fmt: skip
        pitches.append(one.pitch_mm)
        if abs(one.pitch_mm - pitches[0]) > SAME_PITCH * pitches[0]:
            raise MapError(
                f"{one.path}: has a pitch of {one.pitch_mm:.7g} mm, {surfaces[0].path} {pitches[0]:.7g} mm: name "
                "maps of one zoom"
            )
    parts = sorted({one.part_id for one in surfaces if one.part_id})
    if len(parts) > 1:
        raise MapError(f"the maps are of several parts: {', '.join(parts)}; name those of one")
    return pitches[0]


def _answer(found: StitchResult, first: SubAperture, pitch_mm: float, free: Sequence[str]) -> dict[str, Any]:
    there = np.isfinite(found.height_nm)
    row, column = np.unravel_index(int(np.nanargmax(found.uncertainty_nm)), there.shape)
    pv, rms = pv_rms(found.height_nm, there)
    rows, columns = there.shape
    return {
        "reference": found.placed[0].name,
        "free": ["piston", "tilt", *free],
        "maps": [asdict(one) for one in found.placed],
        "rows": rows,
        "cols": columns,
        "pitch_mm": pitch_mm,
        "samples": int(np.count_nonzero(there)),
        "pv_nm": pv,
        "rms_nm": rms,
        "noise_nm": found.noise_nm,
        "uncertainty_rms_nm": float(np.sqrt(np.nanmean(found.uncertainty_nm**2))),
        "uncertainty_worst_nm": float(found.uncertainty_nm[row, column]),
        "uncertainty_worst_at_mm": _on_part(found, first, pitch_mm, float(row), float(column)),
        "centre_mm": _on_part(found, first, pitch_mm, (rows - 1) / 2, (columns - 1) / 2),
        "power_growth": found.power_growth,
        "notes_power": _power_notes(found, free),
    }


def _on_part(found: StitchResult, first: SubAperture, pitch_mm: float, row: float, column: float) -> list[float]:
    """Position x, y in mm of the origin of the list of positions."""
    down, right = row - found.centre_px[0], column - found.centre_px[1]
    return [first.x_mm + float(right) * pitch_mm, first.y_mm - float(down) * pitch_mm]


def _power_notes(found: StitchResult, free: Sequence[str]) -> list[str]:
    shared = (
        f"a power that all maps share, as the reference optic's, is (R/r)^2 = {found.power_growth:.3g} times as large "
        "in the result; no overlap shows it, and the uncertainty does not hold it"
    )
    notes = [shared]
    if "power" in free:
        notes.append(
            f"freed power cannot be separated from the part's: the result has the power of {found.placed[0].name}"
        )
    return notes


def _stored(
    surfaces: Sequence[SurfaceMap], found: StitchResult, asked: StitchOptions, source: MapSource, **options: Any
) -> dict[str, Any]:
    """Write the map and its uncertainty; return notes on each."""
    times = [one.measured_at for one in surfaces if one.measured_at is not None]
    whole = replace(surfaces[0], taken_at=max(times, default=None), date_from="header", fiducials_px=(), masks=())
    inputs = [("reference", surfaces[0]), *(("sub-aperture", one) for one in surfaces[1:])]
    answer: dict[str, Any] = {}
    if asked.out is not None:
        result = history_step(whole.with_height(found.height_nm), "stitch", inputs, source, **options)
        answer |= store(result, asked.out, source)
    if asked.uncertainty is not None:
        unsure = whole.with_height(found.uncertainty_nm)
        unsure = history_step(unsure, "stitch", inputs, source, **options, result="uncertainty, one standard deviation")
        answer["uncertainty"] = store(unsure, asked.uncertainty, source)
    return answer


def _table(answer: Mapping[str, Any]) -> Table:
    rows = [
        (
            one["name"],
            *(f"{value:+.4f}" for value in one["shift_mm"]),
            *(f"{value:+.3f}" for value in one["tilt_urad"]),
            f"{one['power_nm']:+.3f}",
            f"{one['residual_nm']:.3f}",
            str(one["common"]),
        )
        for one in answer["maps"]
    ]
    columns = ("map", "shift x mm", "y mm", "tilt x urad", "y urad", "power nm", "residual nm", "common")
    return figure_table("stitched", columns, rows)


def _lines(answer: Mapping[str, Any]) -> list[str]:
    masked = answer["masks"]
    x, y = answer["uncertainty_worst_at_mm"]
    unsure = answer.get("uncertainty")
    size = f"{answer['rows']} x {answer['cols']}, {answer['samples']} samples"
    known = (
        f"the result is known to {answer['uncertainty_rms_nm']:.4f} nm RMS, at worst to "
        f"{answer['uncertainty_worst_nm']:.4f} nm at ({x:+.2f}, {y:+.2f}) mm"
    )
    return [
        *mask_lines(distinguish_names([record["path"] for record in masked]), masked),
        f"{size}: PV {answer['pv_nm']:.3f}, RMS {answer['rms_nm']:.3f} nm in the frame of {answer['reference']}",
        f"noise {answer['noise_nm']:.4f} nm a sample of a map, from the overlaps",
        known,
        *(f"note: {note}" for note in answer["notes_power"]),
        *(stored_lines(answer) if "out" in answer else ["not written: --out C.x3p would"]),
        *(stored_lines(unsure) if unsure else []),
    ]
