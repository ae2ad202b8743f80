"""Overlapping sub-apertures of one surface as one map, and how sure each of its samples is.

Each map is the surface plus a piston, a tilt and, as options, a power and a lateral shift. On a grid that has
the first map's samples the surface is eliminated exactly: of a sample that n maps have, the least-squares surface is
their mean, and what remains to be solved for are 3 to 6 unknowns a map [Otsubo, Okada, Tsujiuchi, Opt. Eng. 33 (1994)
608]. Their normal matrix has blocks only for maps that overlap. The first map's unknowns are 0: it is the reference.

Units: heights nm, lengths mm, x right, y up; rows grow downwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
import scipy.linalg
import scipy.ndimage
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray

# Sub-apertures laid on one grid of samples: sums over them, where two meet, slopes of what they make.

REACH = 3
"""Samples to each side that are interpolated between."""
SAME_PLACE = 1e-6
"""Pixels below which a map lies on the grid's samples."""
NOISE_SLOPE = 1 / (8 * np.pi)
"""Variance of a slope per pixel, of white noise of variance 1: a Gaussian's derivative, 1 px wide."""
Window = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class SubAperture:
    """A map and where its centre lies on the part."""

    name: str
    height_nm: FloatArray
    """(ny, nx), NaN where there is no data."""
    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class PlacedMap:
    """A map at the samples of the grid that it covers."""

    name: str
    height_nm: FloatArray
    """(ny, nx) interpolated, NaN where a sample that it takes has no data."""
    valid: BoolArray
    corner: tuple[int, int]
    """(row, column) of its first sample."""
    centre: tuple[float, float]
    """(row, column) of its centre."""
    radius_px: float
    """Distance from its center to its furthest sample with data."""
    gain: float
    """Variance of a sample's noise, of that of the map's own samples: interpolation averages."""

    @property
    def window(self) -> Window:
        """Its samples in the grid."""
        (row, column), (ny, nx) = self.corner, self.height_nm.shape
        return slice(row, row + ny), slice(column, column + nx)

    def meeting(self, other: PlacedMap) -> tuple[Window, Window]:
        """The rectangle in which both lie, in the samples of each."""
        start = np.maximum(self.corner, other.corner)
        stop = np.minimum(np.add(self.corner, self.height_nm.shape), np.add(other.corner, other.height_nm.shape))
        stop = np.maximum(start, stop)
        here, there = (
            (slice(*(int(a[0] - one.corner[0]) for a in (start, stop))),
             slice(*(int(a[1] - one.corner[1]) for a in (start, stop)))) for one in (self, other)
        )  # fmt: skip
        return here, there

    def basis(self, *, power: bool, slope: tuple[FloatArray, FloatArray] | None) -> FloatArray:
        """(p, ny, nx): 1, x and y, and their squares' sum if asked, 1 at its radius; and the slopes if given."""
        ny, nx = self.height_nm.shape
        x = (self.corner[1] + np.arange(nx) - self.centre[1])[None, :] / self.radius_px
        y = (self.centre[0] - self.corner[0] - np.arange(ny))[:, None] / self.radius_px
        parts = [np.ones((ny, nx)), x + 0 * y, y + 0 * x]
        parts += [x**2 + y**2] if power else []
        parts += [along[self.window] for along in slope] if slope is not None else []
        return np.stack(parts)


@dataclass(frozen=True, slots=True)
class StitchSum:
    """Sum of maps on the grid."""

    mean: FloatArray
    """(ny, nx); 0 where no map has data."""
    count: FloatArray
    """(ny, nx) maps that have the sample."""


def place_map(maps: Sequence[SubAperture], found_px: FloatArray, pitch_mm: float) -> list[PlacedMap]:
    """Place each map at its nominal position plus ``found_px`` (maps, 2), right and down.

    The grid is the first map's. Others are interpolated by polynomials of degree 6 through 7 samples a direction, which
    keep 97.8 % of a wave of 4 px halfway between two samples and 99.99 % of one of 8 px (linear: 71 and 92 %).
    """
    first = maps[0]
    middle = np.array([np.divide(np.subtract(one.height_nm.shape, 1), 2) for one in maps])
    way = np.array([(first.y_mm - one.y_mm, one.x_mm - first.x_mm) for one in maps]) / pitch_mm
    centre = middle[0] + way + found_px[:, ::-1]
    corner = centre - middle
    whole = np.rint(corner).astype(np.int64)
    part = np.where(np.abs(corner - whole) < SAME_PLACE, 0.0, corner - whole)
    edge = whole.min(axis=0)
    laid = []
    for k, one in enumerate(maps):
        height, gain = _interpolated(one.height_nm, -part[k])
        row, column = np.nonzero(np.isfinite(one.height_nm))
        radius = float(np.hypot(row - middle[k, 0], column - middle[k, 1]).max(initial=1.0))
        at, mid = whole[k] - edge, centre[k] - edge
        places = (int(at[0]), int(at[1])), (float(mid[0]), float(mid[1]))
        laid.append(PlacedMap(one.name, height, np.isfinite(height), *places, radius, gain))
    return laid


def _interpolated(height_nm: FloatArray, way: FloatArray) -> tuple[FloatArray, float]:
    """(ny, nx) the map ``way`` (rows, columns, at most half a pixel) further, and the variance that is left of noise.

    The weights reach ``REACH`` samples, and no further: a missing sample takes those with it, and none else.
    """
    gain = 1.0
    for axis, off in enumerate(way):
        if off:
            nodes = np.arange(-REACH, REACH + 1)
            weights = np.asarray(scipy.interpolate.BarycentricInterpolator(nodes, np.eye(nodes.size))(off))
            height_nm = scipy.ndimage.correlate1d(height_nm, weights, axis=axis, mode="constant", cval=np.nan)
            gain *= float(weights @ weights)
    return height_nm, gain


def sum_maps(laid: Sequence[PlacedMap], heights_nm: Sequence[FloatArray]) -> StitchSum:
    """Mean and count of maps' heights, each (ny, nx) as the map is laid."""
    shape = np.max([np.add(one.corner, one.height_nm.shape) for one in laid], axis=0)
    total, count = np.zeros(shape), np.zeros(shape)
    for one, height in zip(laid, heights_nm, strict=True):
        total[one.window] += np.where(one.valid, height, 0.0)
        count[one.window] += one.valid
    return StitchSum(total / np.maximum(count, 1), count)


def slopes(surface: StitchSum) -> tuple[FloatArray, FloatArray]:
    """(ny, nx) slopes to the right and down, nm per pixel; smoothed over a pixel, so that noise is no slope."""
    none = surface.count == 0
    nearest = scipy.ndimage.distance_transform_edt(none, return_distances=False, return_indices=True)
    whole = surface.mean[tuple(nearest)]
    right, down = (scipy.ndimage.gaussian_filter(whole, 1.0, order=order) for order in ((0, 1), (1, 0)))
    return right, down


LEAST_COMMON = 25
"""Samples that two maps must share to count as overlapping."""
LEAST_EIGENVALUE = 1e-10
"""Least eigenvalue of the normal matrix with a diagonal of 1; below it the overlaps do not separate the unknowns."""
SURE_PX = 0.1
"""Uncertainty of a freed shift, pixels, above which the overlaps have no structure to tell it by."""
CONVERGED_PX = 1e-3
MOST_STEPS = 30
MOST_SHIFT_PX = 5.0
"""A stage that is off by more is to be listed anew: further away the surface's slope says nothing."""


@dataclass(frozen=True, slots=True)
class SubAperturePlacement:
    """Fitted terms of a sub-aperture, against the reference."""

    name: str
    shift_mm: tuple[float, float]
    """x, y offset from its nominal position."""
    shift_uncertainty_mm: tuple[float, float]
    piston_nm: float
    """Of its center, subtracted from the map."""
    tilt_urad: tuple[float, float]
    """Slope in x and y, taken off it."""
    power_nm: float
    """Sag at its radius, taken off it; 0 where power is not free."""
    residual_nm: float
    """RMS deviation from the stitched map, where others overlap it."""
    common: int
    """Samples that others have, too."""


@dataclass(frozen=True, slots=True)
class StitchResult:
    """The surface in the reference's frame: its piston, tilt and power are the first map's."""

    height_nm: FloatArray
    """(ny, nx), NaN where no map has data."""
    uncertainty_nm: FloatArray
    """(ny, nx) one standard deviation from the noise alone, that of the unknowns with it."""
    maps: FloatArray
    """(ny, nx) how many maps have the sample."""
    placed: tuple[SubAperturePlacement, ...]
    noise_nm: float
    """Noise of one sample of one map, from the residual of the overlaps."""
    power_growth: float
    """(R/r)^2: sag at the rim of the result, about the reference's centre, for 1 nm at the rim of a sub-aperture. So a
    power that all maps share, as the reference optic's, grows; no overlap shows it."""
    centre_px: tuple[float, float]
    """(row, column) of the reference's centre."""


@dataclass(frozen=True, slots=True)
class _Fit:
    """Least squares with the maps laid as they are."""

    laid: Sequence[PlacedMap]
    bases: Sequence[FloatArray]
    values: FloatArray
    """(maps, p) of each map's basis; the first's are 0."""
    inverse: FloatArray
    """(maps, maps, p, p) of the normal matrix; 0 for the first."""
    noise_nm: float
    surface: StitchSum


def stitch(maps: Sequence[SubAperture], pitch_mm: float, *, power: bool = False, shift: bool = False) -> StitchResult:
    """The surface that overlapping maps agree upon.

    Args:
        maps: of one pitch; the first is the reference.
        pitch_mm: of each.
        power: fit a power of each map but the first.
        shift: fit a shift of each map but the first, up to some pixels (Gauss-Newton).

    Raises:
        MapError: fewer than two; maps that do not overlap; overlaps that do not tell the unknowns.
    """
    if len(maps) < 2:
        raise MapError("one sub-aperture is nothing to stitch: name two or more that overlap")
    found = np.zeros((len(maps), 2))
    _require_near(maps, pitch_mm)
    fit = _fit(place_map(maps, found, pitch_mm), power=power)
    if shift:
        found, fit = _shifted(maps, pitch_mm, fit, power=power)
    return _result(maps, pitch_mm, found, fit, power=power)


def _shifted(maps: Sequence[SubAperture], pitch_mm: float, fit: _Fit, *, power: bool) -> tuple[FloatArray, _Fit]:
    """(maps, 2) shifts in pixels to the right and down, and the fit with the maps laid there."""
    _require_structure(fit)
    found = np.zeros((len(maps), 2))
    for _ in range(MOST_STEPS):
        with_slopes = _fit(fit.laid, power=power, slope=slopes(fit.surface))
        step = with_slopes.values[:, -2:]
        found = found + step
        if np.abs(found).max() > MOST_SHIFT_PX:
            break
        fit = _fit(place_map(maps, found, pitch_mm), power=power)
        if np.abs(step).max() < CONVERGED_PX:
            # what the shifts leave open is part of the uncertainty; their last step is too small to be laid again
            last = _fit(fit.laid, power=power, slope=slopes(fit.surface))
            return found, replace(last, values=np.column_stack([fit.values, np.zeros((len(maps), 2))]))
    worst = maps[int(np.abs(found).max(axis=1).argmax())].name
    raise MapError(
        f"{worst}: its shift does not settle within {MOST_SHIFT_PX:g} px: list where it lies more exactly, or "
        "leave the shift out of --free"
    )


def _fit(laid: Sequence[PlacedMap], *, power: bool, slope: tuple[FloatArray, FloatArray] | None = None) -> _Fit:
    surface = sum_maps(laid, [one.height_nm for one in laid])
    shared = surface.count >= 2
    used = [one.valid & shared[one.window] for one in laid]
    _require_overlap(laid, used)
    bases = [one.basis(power=power, slope=slope) for one in laid]
    share = 1.0 / np.maximum(surface.count, 1)
    normal, right = _normal(laid, used, bases, share, surface)
    count, size = right.shape
    free = (count - 1) * size
    matrix = normal.transpose(0, 2, 1, 3).reshape(count * size, -1)[size:, size:]
    inverse = np.zeros_like(normal)
    inverse[1:, 1:] = _inverted(matrix, laid, size).reshape(count - 1, size, count - 1, size).transpose(0, 2, 1, 3)
    values = np.einsum("klpq,lq->kp", inverse, right)
    flat = [one.height_nm - np.tensordot(own, base, 1) for one, own, base in zip(laid, values, bases, strict=True)]
    surface = sum_maps(laid, flat)
    off = [np.where(use, z - surface.mean[one.window], 0.0) for one, use, z in zip(laid, used, flat, strict=True)]
    # interpolation takes noise off single samples, not off the long waves that the unknowns are
    freedom = sum(one.gain * float((use * (1 - share[one.window])).sum()) for one, use in zip(laid, used, strict=True))
    if freedom <= free:
        raise MapError("the overlaps hold too few samples for these terms. Measure sub-apertures that overlap more")
    noise = np.sqrt(sum(float((one**2).sum()) for one in off) / (freedom - free))
    return _Fit(laid, bases, values, inverse, float(noise), surface)


def _normal(
    laid: Sequence[PlacedMap],
    used: Sequence[BoolArray],
    bases: Sequence[FloatArray],
    share: FloatArray,
    surface: StitchSum,
) -> tuple[FloatArray, FloatArray]:
    """(maps, maps, p, p) and (maps, p): the surface, the mean of each sample, is eliminated."""
    count, size = len(laid), len(bases[0])
    normal, right = np.zeros((count, count, size, size)), np.zeros((count, size))
    for k, one in enumerate(laid):
        own = bases[k][:, used[k]]
        right[k] = own @ (one.height_nm - surface.mean[one.window])[used[k]]
        normal[k, k] = own @ own.T
        for other in range(k + 1):
            here, there = one.meeting(laid[other])
            both = used[k][here] & used[other][there]
            if both.any():
                weight = share[one.window][here][both]
                block = (bases[k][:, *here][:, both] * weight) @ bases[other][:, *there][:, both].T
                normal[k, other] -= block
                if other != k:
                    normal[other, k] -= block.T
    return normal, right


def _inverted(matrix: FloatArray, laid: Sequence[PlacedMap], size: int) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    value, vector = scipy.linalg.eigh(matrix * scale * scale[:, None])
    if value[0] < LEAST_EIGENVALUE:
        worst = laid[1 + int(np.abs(vector[:, 0]).argmax()) // size].name
        raise MapError(
            f"{worst}: its overlaps do not tell its piston, tilt and what else is free apart; let it overlap "
            "more, or free less"
        )
    return np.asarray((vector / value) @ vector.T * scale * scale[:, None])


def _require_near(maps: Sequence[SubAperture], pitch_mm: float) -> None:
    """Before a canvas is made that a position in other units would make huge."""
    place = np.array([(one.x_mm, one.y_mm) for one in maps])
    half = np.array([one.height_nm.shape[::-1] for one in maps]) * pitch_mm / 2
    near = (np.abs(place[:, None] - place) < half[:, None] + half).all(axis=2)
    _require_linked([one.name for one in maps], near)


def _require_overlap(laid: Sequence[PlacedMap], used: Sequence[BoolArray]) -> None:
    linked = np.eye(len(laid), dtype=np.bool_)
    for k, one in enumerate(laid):
        for other in range(k):
            here, there = one.meeting(laid[other])
            linked[k, other] = np.count_nonzero(used[k][here] & used[other][there]) >= LEAST_COMMON
    _require_linked([one.name for one in laid], linked)


def _require_linked(names: Sequence[str], linked: BoolArray) -> None:
    _, group = connected_components(scipy.sparse.csr_array(linked), directed=False)
    apart = [name for name, its in zip(names, group, strict=True) if its != group[0]]
    if apart:
        raise MapError(f"{', '.join(apart)}: no overlap leads from there to {names[0]} (at least {LEAST_COMMON} common "
                     "samples a link); see where they are said to lie, or measure between")  # fmt: skip


def _require_structure(fit: _Fit) -> None:
    """The surface's slopes in the overlaps, less what piston, tilt and power explain, must be more than the noise's."""
    slope = slopes(fit.surface)
    shared = fit.surface.count >= 2
    for one, base in zip(fit.laid[1:], fit.bases[1:], strict=True):
        use = one.valid & shared[one.window]
        own = base[:, use].T
        both = np.column_stack([along[one.window][use] for along in slope])
        left = both - own @ np.linalg.lstsq(own, both, rcond=None)[0]
        energy = float(np.linalg.eigvalsh(left.T @ left)[0])
        noise = fit.noise_nm**2 * NOISE_SLOPE * float((1.0 / fit.surface.count[one.window][use]).sum())
        unsure = fit.noise_nm / np.sqrt(max(energy - noise, np.finfo(float).tiny))
        if energy < 2 * noise or unsure > SURE_PX:
            raise MapError(
                f"{one.name}: the overlaps show no shift (its standard error would be {unsure:.2g} px "
                f"with {fit.noise_nm:.3g} nm of noise). Leave the shift out of --free"
            )


def _result(maps: Sequence[SubAperture], pitch_mm: float, found: FloatArray, fit: _Fit, *, power: bool) -> StitchResult:
    surface, laid = fit.surface, fit.laid
    there = surface.count > 0
    first = laid[0]
    row, column = np.nonzero(there)
    furthest = float(np.hypot(row - first.centre[0], column - first.centre[1]).max())
    return StitchResult(
        height_nm=np.where(there, surface.mean, np.nan),
        uncertainty_nm=np.where(there, fit.noise_nm * np.sqrt(_variance(fit)), np.nan),
        maps=surface.count,
        placed=tuple(_placed(k, pitch_mm, found[k], fit, power=power) for k in range(len(maps))),
        noise_nm=fit.noise_nm,
        power_growth=(furthest / first.radius_px) ** 2,
        centre_px=first.centre,
    )


def _variance(fit: _Fit) -> FloatArray:
    """(ny, nx) of each sample's mean for noise of variance 1: its own noise, and that of the unknowns taken off.

    The two are independent: the unknowns follow from differences within a sample, the mean does not hold them.
    """
    share = 1.0 / np.maximum(fit.surface.count, 1)
    found = np.zeros(fit.surface.count.shape)
    for k, one in enumerate(fit.laid):
        found[one.window] += np.where(one.valid, one.gain, 0.0)
        for other, its in enumerate(fit.laid):
            here, there = one.meeting(its)
            both = one.valid[here] & its.valid[there]
            if both.any():
                mine, theirs = fit.bases[k][:, *here][:, both], fit.bases[other][:, *there][:, both]
                found[one.window][here][both] += ((fit.inverse[k, other] @ theirs) * mine).sum(axis=0)
    return np.asarray(found * share**2)


def _placed(k: int, pitch_mm: float, found_px: FloatArray, fit: _Fit, *, power: bool) -> SubAperturePlacement:
    one, values = fit.laid[k], fit.values[k]
    radius_mm = one.radius_px * pitch_mm
    base = fit.bases[k]
    shared = one.valid & (fit.surface.count[one.window] >= 2)
    off = (one.height_nm - np.tensordot(values, base, 1) - fit.surface.mean[one.window])[shared]
    sure = fit.noise_nm * np.sqrt(np.diag(fit.inverse[k, k])) * pitch_mm
    freed = len(values) > 3 + power
    return SubAperturePlacement(
        name=one.name,
        shift_mm=(float(found_px[0]) * pitch_mm, (0.0 - float(found_px[1])) * pitch_mm),
        shift_uncertainty_mm=(float(sure[-2]), float(sure[-1])) if freed else (0.0, 0.0),
        piston_nm=float(values[0]),
        tilt_urad=(float(values[1] / radius_mm), float(values[2] / radius_mm)),
        power_nm=float(values[3]) if power else 0.0,
        residual_nm=float(np.sqrt(np.mean(off**2))),
        common=int(np.count_nonzero(shared)),
    )
