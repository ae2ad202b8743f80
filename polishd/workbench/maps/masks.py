"""``--mask`` of the map verbs: which samples count, by shapes, by corners in a file, or by what another map has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import typer

from polishd.model.errors import ComputeError, MapError
from polishd.model.outline import Circle, Outline, hexagon, rectangle
from polishd.model.surface import BoolArray, FloatArray, MaskCount, SurfaceMap
from polishd.process.plausible import SAME_PITCH

FORMS = (
    "circle:X,Y,R, annulus:X,Y,R,r, rectangle:X,Y,W,H, hexagon:X,Y,W, polygon:FILE, map:FILE; before it not: for what "
    "lies outside, px: for pixels"
)
Inside = Callable[[FloatArray, FloatArray], BoolArray]
"""Whether points lie in a shape, by x (1, nx) and y (ny, 1)."""


@dataclass(frozen=True, slots=True)
class Mask:
    """One ``--mask``; lengths are mm from the map's centre, or px: columns and rows from its upper left sample."""

    text: str
    """As it was given."""
    what: Inside | SurfaceMap
    """A shape, or a map: where it has data."""
    inverted: bool = False
    in_px: bool = False

    @classmethod
    def of(cls, text: str, read: Callable[[Path], SurfaceMap]) -> Mask:
        """From what stands behind ``--mask``; ``read`` reads a map that it names, as those are that it is laid over.

        Raises:
            BadParameter: it is no mask.
            ConfigError: a file of corners that cannot be read, with its line.
            SurfaceError: a map that cannot be.
        """
        marks: set[str] = set()
        kind, _, rest = text.partition(":")
        while kind in ("not", "px") and kind not in marks:
            marks.add(kind)
            kind, _, rest = rest.partition(":")
        in_px, inverted = "px" in marks, "not" in marks
        if kind == "polygon" and rest:
            from polishd.config.tables import read_polygon  # which most calls can do without

            outline = read_polygon(Path(rest), ("column", "row") if in_px else ("x_mm", "y_mm"))
            return cls(text, _about((0.0, 0.0), outline), inverted, in_px)
        if kind == "map" and rest:
            if in_px:
                raise typer.BadParameter(f"--mask {text!r}: a map has its own samples; leave out px:")
            return cls(text, read(Path(rest)), inverted)
        return cls(text, _shape(text, kind, rest), inverted, in_px)

    def holds(self, surface: SurfaceMap) -> BoolArray:
        """(ny, nx) samples of a map that lie in it. BadMap where nobody can say."""
        if isinstance(self.what, SurfaceMap):
            found = _valid_on(surface, self.what)
        elif self.in_px:
            ny, nx = surface.height_nm.shape
            found = self.what(np.arange(float(nx))[None, :], np.arange(float(ny))[:, None])
        elif surface.pitch_mm is None:
            raise MapError(f"{surface.path}: has no lateral scale for --mask {self.text}; give the instrument's "
                         f"--profile, or the mask in pixels: px:{self.text.removeprefix('not:')}")  # fmt: skip
        else:
            found = self.what(*surface.grid.axes_mm)
        return np.asarray(found != self.inverted)


def masked(surface: SurfaceMap, masks: Sequence[Mask]) -> SurfaceMap:
    """The map without what lies outside any of them, and how many samples each holds; BadMap where none is left."""
    if not masks:
        return surface
    valid = surface.valid
    left, counts = valid.copy(), []
    for mask in masks:
        held = mask.holds(surface) & valid
        counts.append(MaskCount(mask.text, int(np.count_nonzero(held)), int(np.count_nonzero(valid))))
        if not held.any():
            raise MapError(f"{surface.path}: --mask {mask.text} holds none of its {counts[-1].of} samples with data; "
                         f"{_size(surface)}")  # fmt: skip
        left &= held
    if not left.any():
        raise MapError(f"{surface.path}: no sample with data lies in all of the {len(masks)} masks; use fewer")
    return replace(surface, height_nm=np.where(left, surface.height_nm, np.nan), masks=(*surface.masks, *counts))


def mask_records(surface: SurfaceMap) -> list[dict[str, Any]]:
    """For ``--json``: each mask, and of how many samples with data it holds how many."""
    return [count._asdict() for count in surface.masks]


def masked_out(surface: SurfaceMap) -> int:
    """Samples with data that lie outside one of the masks."""
    return surface.masks[0].of - int(np.count_nonzero(surface.valid)) if surface.masks else 0


def mask_words(record: Mapping[str, Any]) -> str:
    """The same for people."""
    return f"holds {record['samples']} of {record['of']} samples with data"


def mask_lines(names: Sequence[str], answers: Sequence[Mapping[str, Any]]) -> list[str]:
    """The same of several maps, a line each."""
    return [
        f"{name}: mask {record['mask']} {mask_words(record)}"
        for name, answer in zip(names, answers, strict=True)
        for record in answer["masks"]
    ]


def _shape(text: str, kind: str, rest: str) -> Inside:
    """What ``circle:X,Y,R`` and its like hold."""
    try:
        values = [float(word) for word in rest.split(",")]
    except ValueError:
        values = []
    try:
        match kind, values:
            case "circle", [x, y, radius]:
                return _about((x, y), Circle(radius))
            case "annulus", [x, y, outer, inner]:
                if inner >= outer:
                    raise typer.BadParameter(f"--mask {text!r}: its hole is not smaller than itself; X,Y,R,r has R > r")
                ring, hole = _about((x, y), Circle(outer)), _about((x, y), Circle(inner))
                return lambda x_mm, y_mm: ring(x_mm, y_mm) & ~hole(x_mm, y_mm)
            case "rectangle", [x, y, width, height]:
                return _about((x, y), rectangle(width, height))
            case "hexagon", [x, y, flats]:
                return _about((x, y), hexagon(flats))
    except ComputeError as error:
        raise typer.BadParameter(f"--mask {text!r}: {error}") from error
    raise typer.BadParameter(f"--mask {text!r} is none of {FORMS}")


def _about(centre: tuple[float, float], outline: Outline) -> Inside:
    if not np.isfinite(centre).all():
        raise ComputeError("its centre is no finite number")
    return lambda x, y: outline.contains(x - centre[0], y - centre[1])


def _valid_on(surface: SurfaceMap, other: SurfaceMap) -> BoolArray:
    """(ny, nx) samples of a map where the nearest one of the other has data, centre on centre."""
    pitch, its = surface.pitch_mm, other.pitch_mm
    same_shape = other.height_nm.shape == surface.height_nm.shape
    if same_shape and (pitch is None or its is None or abs(its - pitch) <= SAME_PITCH * pitch):
        return other.valid
    if pitch is None or its is None:
        raise MapError(f"{other.path}: as a mask it has not the samples of {surface.path}, and one of both has no "
                     "lateral scale; give the instrument's --profile")  # fmt: skip
    ny, nx = other.height_nm.shape
    row = np.rint((other.grid.y_mm[0] - surface.grid.y_mm) / its).astype(np.int64)
    column = np.rint((surface.grid.x_mm - other.grid.x_mm[0]) / its).astype(np.int64)
    there = ((row >= 0) & (row < ny))[:, None] & ((column >= 0) & (column < nx))[None, :]
    return np.asarray(there & other.valid[np.ix_(row.clip(0, ny - 1), column.clip(0, nx - 1))])


def _size(surface: SurfaceMap) -> str:
    ny, nx = surface.height_nm.shape
    if surface.pitch_mm is None:
        return f"the map is {nx} x {ny} px"
    wide, high = nx * surface.pitch_mm, ny * surface.pitch_mm
    return f"the map is {wide:g} x {high:g} mm about its centre, or {nx} x {ny} px"
