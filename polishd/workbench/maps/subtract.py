"""``polishd map subtract``: one map less another: a reference, a system error, the wavefront of a test stand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process import metrics
from polishd.show.tables import emit, figure_table
from polishd.workbench.maps.compare import Pair, paired
from polishd.workbench.maps.convert import require_target, store, stored_lines
from polishd.workbench.maps.figures import HEIGHTS, figured, heights_nm
from polishd.workbench.maps.files import (
    MapSource,
    distinguish_names,
    draw,
    edges_mm,
    printable,
    require_picture,
    warnings,
)
from polishd.workbench.maps.history import history_step, known_lines, uncertainty_nm
from polishd.workbench.maps.masks import mask_lines, mask_records
from polishd.workbench.maps.options import BANDS, NewMapOptions

SIDES = ("map", "subtracted")
"""What the two maps are called, in JSON and in the history."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A map less another, over the samples that both have."""

    surface: SurfaceMap
    """With what is known of the map that was subtracted from; it leaves open what either leaves open."""
    pair: Pair
    uncertainty_nm: float | None
    """Of a sample, one standard deviation; None where either map does not say its own."""


def less(surface: SurfaceMap, other: SurfaceMap) -> Difference:
    """``surface`` less ``other``, laid on each other as ``map compare`` does: not registered, nothing levelled.

    Independent errors add in squares. Where maps are resampled the sum holds for errors that are alike over a few
    samples; noise from sample to sample becomes less.

    Raises:
        BadMap: they cannot be laid on each other.
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
    """FIRST less SECOND; figures of both and of the difference over the same samples, written where it is wanted."""
    source = MapSource.by(asked)
    require_picture(asked.picture)
    if asked.out is not None:
        require_target(asked.out, [first, second], source, force=asked.force)
    other = source.read(second)
    if other.history is not None and other.history.options.get("result") == "instrument":
        source = replace(source, system=None)  # it is what is taken off
    maps = [source.read(first), other]
    found = less(*maps)
    mask = found.pair.mask
    heights = (*found.pair.heights_nm, found.surface.height_nm)
    figures = [heights_nm(height, metrics.without(height, mask, "tilt"), mask) for height in heights]
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
    """A PNG as ``polishd map FILE... --out`` draws, of maps of which some are in no file."""
    from polishd.workbench.maps.pictures import figures_picture

    edges = edges_mm(BANDS)
    draw(out, figures_picture([figured(surface, 0, edges) for surface in surfaces]), as_json=as_json)


def _marks(surface: SurfaceMap, laid_nm: FloatArray, pitch_mm: float | None) -> tuple[tuple[float, float], ...]:
    """The map's marks, (row, column), in the pixels of the grid on which it was laid, centre on centre."""
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
