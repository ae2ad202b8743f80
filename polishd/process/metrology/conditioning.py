"""From an interferometer map to the process grid: resample, fill, level, and the masks that stay for all cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
import scipy

from polishd.model.errors import MapError, WrongPart
from polishd.model.outline import Outline
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process.metrology import zernike
from polishd.process.metrology.resampling import Registration, resample_registered
from polishd.process.metrology.statistics import Removal, fit_terms

MARGIN_MM = 5.0
"""Margin of the process grid beyond the aperture, where the path turns."""
MOST_DATA = 1.6
"""Area with data, relative to the aperture's, beyond which a map shows another part (a full square frame has 1.27)."""
MIN_SAMPLES = 100
MIN_VALID = 0.8
"""Share of the aperture's cells that must be valid in the map that sets the masks."""
MAX_FILLED = 0.05
"""Share of a frozen mask that later maps may lack and have filled."""


class Masks(NamedTuple):
    """Masks of the counted samples, frozen with the first map of a part."""

    solve: BoolArray
    """(ny, nx) in the solve."""
    metric: BoolArray
    """(ny, nx) in the figures: the clear aperture."""


@dataclass(frozen=True, slots=True)
class ConditionedMap:
    """A surface on the process grid, with its masks."""

    grid: Grid
    height_nm: FloatArray
    """(ny, nx) its alignment over ``metric_mask`` removed; holes filled; NaN outside the aperture."""
    solve_mask: BoolArray
    """(ny, nx) valid data within the aperture, as of the first cycle."""
    metric_mask: BoolArray
    """(ny, nx) the same within the clear aperture: the aperture, and the part as the map shows it, less the edge."""


def condition(
    surface: SurfaceMap,
    *,
    outline: Outline,
    edge_mm: float,
    grid_mm: float,
    masks: Masks | None = None,
    removal: Removal = "piston",
    margin_mm: float = MARGIN_MM,
    registration: Registration | None = None,
) -> ConditionedMap:
    """Bring a map onto the process grid.

    Args:
        surface: the map as its reader gave it.
        outline: of the part, about its centre: its aperture.
        edge_mm: width of the rim outside the clear aperture.
        grid_mm: pitch of the process grid.
        masks: those of the first map, to be kept; None for the first map.
        removal: what is alignment, to be removed, and not figure, to be polished.
        margin_mm: reach of the grid beyond the aperture.
        registration: where the part lies in the map; None: its centre is the centre of the map's array.

    Raises:
        MapError: no lateral scale, no data, a map smaller than the aperture, too few samples or too many holes in it,
            or masks of another grid.
        WrongPart: data over much more than the aperture.
    """
    surface = resample_square(surface)
    _check(surface, outline)
    grid = process_grid(outline, grid_mm, margin_mm)
    raw = resample_registered(surface.height_nm, surface.grid, grid, registration)
    aperture = outline.contains(*grid.axes_mm)
    clear = outline.contains(*grid.axes_mm, edge_mm) & (from_outline_mm(raw, grid_mm) > edge_mm)
    solve, metric = masks or _new_masks(raw, aperture, clear)
    if solve.shape != grid.shape or metric.shape != grid.shape:
        raise MapError(f"the masks of the first map are {solve.shape}, the process grid is {grid.shape}")
    missing = int(np.count_nonzero(solve & ~np.isfinite(raw)))
    if missing > MAX_FILLED * np.count_nonzero(solve):
        raise MapError(f"{missing} of {np.count_nonzero(solve)} samples that the first map had are missing in this one")
    height = fill_holes(np.where(aperture | solve, raw, np.nan))
    height = height - fit_terms(height, metric, removal)
    return ConditionedMap(grid, np.where(aperture | solve, height, np.nan), solve, metric)


def resample_square(surface: SurfaceMap) -> SurfaceMap:
    """The map on square pixels of the finer of its two pitches; one that has one pitch, or none, as it is.

    Heights are interpolated by cubic splines along the coarser axis, from a map whose holes are filled; a new sample
    has data where both of its neighbours have.
    """
    if surface.pitches_mm is None:
        return surface
    wide, high = surface.pitches_mm
    axis, pitch = (0, wide) if wide < high else (1, high)
    step = pitch / max(wide, high)
    old = surface.height_nm.shape[axis]
    new = int((old - 1) / step + 1e-9) + 1
    place = (np.arange(new) - (new - 1) / 2) * step + (old - 1) / 2
    spline = scipy.interpolate.make_interp_spline(
        np.arange(old), fill_holes(surface.height_nm), k=min(3, old - 1), axis=axis
    )
    low = np.clip(np.floor(place + 1e-9).astype(np.intp), 0, old - 1)
    near = np.minimum(low + (place - low > 1e-6), old - 1)
    valid = surface.valid.take(low, axis) & surface.valid.take(near, axis)
    marks = [list(mark) for mark in surface.fiducials_px]
    for mark in marks:
        mark[axis] = (mark[axis] - (old - 1) / 2) / step + (new - 1) / 2
    doubt = surface.doubts.get("square pixels")
    said = f"pixels of {wide:.6g} x {high:.6g} mm: resampled to {pitch:.6g} mm"
    return replace(
        surface,
        height_nm=np.where(valid, spline(np.clip(place, 0, old - 1)), np.nan),
        pitch_mm=pitch,
        pitches_mm=None,
        unsaid=surface.unsaid - {"square pixels"},
        doubts={key: words for key, words in surface.doubts.items() if key != "square pixels"},
        warnings=(*(words for words in surface.warnings if words != doubt), said),
        factors={**surface.factors, "pitches_mm": (wide, high)},
        fiducials_px=tuple((row, column) for row, column in marks),
    )


SQUARE_WITHIN = 1e-3
"""Relative difference of the pitches in x and y that still counts as square pixels."""


def is_square(wide: float, high: float) -> bool:
    """Return whether pixels of this width and height count as square."""
    return abs(wide - high) <= SQUARE_WITHIN * max(wide, high)


def not_square_warning(wide_mm: float, high_mm: float) -> str:
    """Return the warning of a map whose pixels are not square."""
    return f"pixels are {wide_mm:.6g} mm wide and {high_mm:.6g} mm high: not square; a cell resamples the map"


def with_coordinate_unit(surface: SurfaceMap, unit_mm: float) -> SurfaceMap:
    """The map with the lateral scale of its coordinates (``unscaled_pitches``), one unit of which is ``unit_mm``.

    Raises:
        MapError: no map has such a scale.
    """
    if surface.unscaled_pitches is None:
        return surface
    wide, high = (value * unit_mm for value in surface.unscaled_pitches)
    fault = _pixel_fault(surface, wide, high)
    if fault:
        raise MapError(f"{_name(surface)}: coordinates in units of {unit_mm:g} mm: {fault}. Check the unit")
    square = is_square(wide, high)
    new = {} if square else {"square pixels": not_square_warning(wide, high)}
    settled = surface.doubts.get("pitch")
    return replace(
        surface,
        pitch_mm=wide / 2 + high / 2 if square else None,
        pitches_mm=None if square else (wide, high),
        unsaid=(surface.unsaid - {"pitch"}) | new.keys(),
        doubts={key: words for key, words in surface.doubts.items() if key != "pitch"} | new,
        warnings=(*(words for words in surface.warnings if words != settled), *new.values()),
    )


def from_outline_mm(height_nm: FloatArray, pitch_mm: float) -> FloatArray:
    """(ny, nx) distance of each sample from the outline of the data, mm; 0 outside it, holes are not outline."""
    outline = scipy.ndimage.binary_fill_holes(np.isfinite(height_nm))
    depth = scipy.ndimage.distance_transform_edt(np.pad(outline, 1))[1:-1, 1:-1]
    # from the centre of the sample to the rim of the outermost one
    return np.asarray(np.maximum(depth - 0.5, 0.0) * pitch_mm, dtype=np.float64)


def process_grid(outline: Outline, grid_mm: float, margin_mm: float = MARGIN_MM) -> Grid:
    """The grid about the part's centre that covers the aperture and a margin around it."""
    nx, ny = (int(np.ceil((2 * half + 2 * margin_mm) / grid_mm - 1e-9)) for half in outline.half_mm)
    return Grid(ny, nx, grid_mm)


def fill_holes(height_nm: FloatArray) -> FloatArray:
    """Fill every NaN harmonically: each filled sample is the mean of its neighbours (a stretched membrane).

    Args:
        height_nm: (ny, nx), NaN = no data.

    Returns:
        (ny, nx) without NaN; data are untouched.

    Raises:
        MapError: there are no data at all.
    """
    hole = ~np.isfinite(height_nm)
    if hole.all():
        raise MapError("the map holds no data")
    if not hole.any():
        return height_nm.copy()
    index = np.arange(hole.size).reshape(hole.shape)
    ends = [(index[:, 1:], index[:, :-1]), (index[1:], index[:-1])]
    a = np.concatenate([pair[i].ravel() for i in (0, 1) for pair in ends])
    b = np.concatenate([pair[1 - i].ravel() for i in (0, 1) for pair in ends])
    flat = hole.ravel()
    a, b = a[flat[a]], b[flat[a]]  # one equation per hole: neighbours' sum = count * own
    known = np.bincount(a, np.where(flat[b], 0.0, height_nm.ravel()[b]), minlength=hole.size)[flat]
    number = np.cumsum(flat) - 1
    both = flat[b]
    links = scipy.sparse.coo_array((np.ones(both.sum()), (number[a[both]], number[b[both]])), shape=(flat.sum(),) * 2)
    count = np.bincount(a, minlength=hole.size)[flat]
    filled = height_nm.copy()
    filled[hole] = scipy.sparse.linalg.spsolve(
        scipy.sparse.csc_array(scipy.sparse.diags_array(count.astype(np.float64)) - links), known
    )
    return filled


def _name(surface: SurfaceMap) -> str:
    return surface.path.name if surface.path is not None else "the map"


def _check(surface: SurfaceMap, outline: Outline) -> None:
    name = _name(surface)
    if surface.pitch_mm is None:
        raise MapError(f"{name} has no lateral scale: give the instrument's profile a pitch")
    if not surface.valid.any():
        raise MapError(f"{name} holds no data")
    shown = np.count_nonzero(surface.valid) * surface.pitch_mm**2 / outline.area_mm2
    if shown > MOST_DATA:
        raise WrongPart(
            f"{name} has data over {shown:.1f} times the area of the part, {outline}: it shows a larger one; name the "
            "right map, mend the part's outline, mask what is not the part, or check the map's units and the profile's "
            "pitch_mm"
        )
    ny, nx = surface.height_nm.shape
    for word, count, needed_mm in zip(("wide", "high"), (nx, ny), outline.size_mm, strict=True):
        size = count * surface.pitch_mm
        if size < needed_mm - surface.pitch_mm:
            raise MapError(
                f"{name} is {size:g} mm {word}, the aperture {needed_mm:g} mm. Name a map of the whole part, or check "
                "the map's units, the profile's pitch_mm or coordinate_unit_mm, and the part's outline"
            )


def _new_masks(raw: FloatArray, aperture: BoolArray, clear: BoolArray) -> Masks:
    solve = aperture & np.isfinite(raw)
    metric = clear & solve
    if np.count_nonzero(metric) < MIN_SAMPLES:
        raise MapError(f"the clear aperture has {np.count_nonzero(metric)} samples with data, fewer than {MIN_SAMPLES}")
    if np.count_nonzero(solve) < MIN_VALID * np.count_nonzero(aperture):
        share = np.count_nonzero(solve) / np.count_nonzero(aperture)
        raise MapError(f"only {share:.0%} of the aperture has data, less than {MIN_VALID:.0%}")
    return Masks(solve, metric)


# What no map can be: of a day on which there were none, or of samples that no instrument takes.

EARLIEST = datetime(1985, 1, 1, tzinfo=UTC)
"""Before it there were no such files: clocks never set, or days where seconds should be."""
AHEAD = timedelta(days=1)
"""Local times are taken for UTC's where a file names no zone; what is further ahead has another reason."""
LARGEST_PART_MM, SMALLEST_SAMPLE_MM = 20e3, 1e-6
SAME_PITCH = 1e-6
"""Part of a pitch by which two may differ and still be one grid."""


def drop_implausible(surface: SurfaceMap, now: datetime, written: datetime | None) -> SurfaceMap:
    """The map as a reader gave it, without a date or a lateral scale that cannot be.

    Args:
        surface: the map.
        now: with a zone.
        written: when its file was, by the file system, with a zone: what dates a map whose header does not.

    Returns:
        The map; what is not believed is a warning, a date then "guessed", and a scale left to the profile ("pitch"). A
        date that is ahead is warned of, too, and stays the header's: in the order of an instrument's maps it counts.
    """
    return _scaled(_dated(surface, now, written))


def scale_fault(shape: tuple[int, ...], pitch_mm: float) -> str:
    """Why no map of (rows, columns) has such a pitch; "" where one may."""
    if not pitch_mm >= SMALLEST_SAMPLE_MM:
        return f"a sample would be {pitch_mm:.4g} mm wide, less than 1 nm"
    if not max(shape) * pitch_mm <= LARGEST_PART_MM:
        size_m = max(shape) * pitch_mm / 1e3
        return f"{max(shape)} samples of {pitch_mm:.7g} mm would be a part of {size_m:.4g} m, more than 20 m"
    return ""


def _pixel_fault(surface: SurfaceMap, wide_mm: float, high_mm: float) -> str:
    """`scale_fault` of pixels of this width and height."""
    ny, nx = surface.height_nm.shape
    samples, pitch_mm = max((nx, wide_mm), (ny, high_mm), key=lambda side: side[0] * side[1])
    return scale_fault((0,), min(wide_mm, high_mm)) or scale_fault((samples,), pitch_mm)


def _scaled(surface: SurfaceMap) -> SurfaceMap:
    pixel_mm = surface.pitches_mm or (None if surface.pitch_mm is None else (surface.pitch_mm, surface.pitch_mm))
    fault = "" if pixel_mm is None else _pixel_fault(surface, *pixel_mm)
    if not fault:
        return surface
    warning = f"its lateral scale is not used: {fault}"
    return replace(
        surface,
        pitch_mm=None,
        pitches_mm=None,
        warnings=(*surface.warnings, warning),
        unsaid=surface.unsaid | {"pitch"},
        doubts={**surface.doubts, "pitch": warning},
    )


def _dated(surface: SurfaceMap, now: datetime, written: datetime | None) -> SurfaceMap:
    if surface.taken_at is None:
        return replace(surface, taken_at=written, date_from="file system")
    at = surface.measured_at
    if at is None or EARLIEST <= at <= now + AHEAD:
        return surface
    if at < EARLIEST:
        warning = f"its date, {at.isoformat()}, is before 1985: the map counts as not dated"
        return replace(surface, date_from="guessed", warnings=(*surface.warnings, warning))
    warning = f"its date, {at.isoformat()}, is in the future: the instrument's clock, or this computer's, is wrong"
    return replace(surface, warnings=(*surface.warnings, warning))


# Samples that are not surface: spikes, and islands of data beside the part.

SPIKE_MADS = 12.0
"""Default distance from the Zernike fit, in scaled median absolute deviations: MSF ripple stays within 3."""
MOST_SPIKES = 0.01
"""Share of a map's samples that may be spikes: beyond it the map, not a sample, is bad."""
TERMS = 36
FLOOR_NM = 0.1
"""Least scatter believed: a computed surface has none."""
ROUNDS = 10
"""Fits at most: each without the spikes that the one before found, which drew the fit towards them."""
SIGMA_PER_MAD = 1.4826
SMALLEST_ISLAND = 0.001
"""Share of the largest piece of data below which a piece that does not touch it is no part of the part."""


def clean_map(surface: SurfaceMap, mads: float) -> tuple[SurfaceMap, int]:
    """The map without spikes and islands, and the number of spikes; ``mads`` = 0 leaves it as it is.

    Raises:
        MapError: see ``remove_spikes``.
    """
    if not mads:
        return surface, 0
    height_nm, spikes = remove_spikes(surface.height_nm, mads)
    return surface.with_height(remove_islands(height_nm)), spikes


def remove_spikes(height_nm: FloatArray, mads: float = SPIKE_MADS, most: float = MOST_SPIKES) -> tuple[FloatArray, int]:
    """Take out what stands off the 36-term Zernike fit by more than ``mads`` robust standard deviations.

    Args:
        height_nm: (ny, nx), NaN = no data.
        mads: the threshold, in 1.4826 median absolute deviations of what the fit leaves.
        most: share of the samples that may be spikes.

    Returns:
        (ny, nx) the map, without data where spikes were, grown by a pixel on all sides; number of spikes before that.

    Raises:
        MapError: no data, data that tell no Zernike terms apart, or more spikes than ``most``.
        ValueError: a threshold that is not positive.
    """
    if not mads > 0:
        raise ValueError(f"spikes are off by a positive number of deviations, not {mads:g}")
    valid = np.isfinite(height_nm)
    spike = np.zeros_like(valid)
    for _ in range(ROUNDS):
        fitted = zernike.fit(height_nm, valid & ~spike, TERMS, "fringe", circle_px=zernike.enclosing_circle(valid))
        off = np.abs(height_nm - zernike.surface(fitted, valid))
        threshold = mads * max(SIGMA_PER_MAD * float(np.median(off[valid & ~spike])), FLOOR_NM)
        before, spike = spike, valid & (off > threshold)
        if np.count_nonzero(spike) > most * np.count_nonzero(valid):
            raise MapError(
                f"{np.count_nonzero(spike)} samples stand more than {threshold:.1f} nm off the surface, more than "
                f"{most:.1%} of the map: measure again, or mask what is not the part"
            )
        if (spike == before).all():
            break
    grown = scipy.ndimage.binary_dilation(spike, structure=np.ones((3, 3), dtype=np.bool_))
    return np.where(grown, np.nan, height_nm), int(np.count_nonzero(spike))


def remove_islands(height_nm: FloatArray, smallest: float = SMALLEST_ISLAND) -> FloatArray:
    """Take out pieces of data that are far smaller than the largest: reflections, and pixels beyond the part's edge.

    Args:
        height_nm: (ny, nx), NaN = no data.
        smallest: share of the largest piece's samples that a piece must have to stay.
    """
    pieces, count = scipy.ndimage.label(np.isfinite(height_nm))
    if count < 2:
        return height_nm.copy()
    sizes = np.bincount(pieces.ravel())
    gone = sizes < smallest * sizes[1:].max()
    gone[0] = False
    return np.where(gone[pieces], np.nan, height_nm)
