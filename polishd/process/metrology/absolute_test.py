"""Maps of one part at several turns and shifts as two: the instrument's own error, and the part.

Low orders are Zernike terms: for them the design of the poses gives exactly which are determined, and their errors. The
remainder is separated sample by sample (`split_remainder`). A term that no pose determines stays in the part, is listed
by name, and is not in the instrument's map.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology import zernike
from polishd.process.metrology.absolute_poses import LEVEL, Design, PartPose, design_poses, pose_matrix
from polishd.process.metrology.conditioning import SAME_PITCH
from polishd.process.metrology.zernike import values

# Part and instrument by generalised least squares over their Zernike terms, in what the poses tell of them.

LEAST_SHARE = 0.1
"""Noise, in that of a fit with exact poses, below which it is not sought: the poses' errors explain all."""


@dataclass(frozen=True, slots=True)
class PlaceError:
    """Standard deviation of the poses, independent from map to map."""

    angle_deg: float = 0.0
    shift_mm: float = 0.0
    """Error in x and in y."""


@dataclass(frozen=True, slots=True)
class TermSolution:
    """Terms of both, and how sure they are. What is hidden is the part's: the instrument's share of it is 0."""

    part_nm: FloatArray
    """(j,) of the design's terms, RMS norm."""
    instrument_nm: FloatArray
    """(j,)"""
    covariance: FloatArray
    """(j, j) of the instrument's terms, nm^2, without what is hidden."""
    left_nm: FloatArray
    """(maps, j) seen less what part and instrument explain."""
    chi2: float
    """Chi-squared of ``left_nm`` in the covariance of the observations; its expectation is the design's freedom."""


def solve(design: Design, seen_nm: FloatArray, covariance: FloatArray) -> TermSolution:
    """Least squares over what the poses tell.

    Args:
        design: the poses.
        seen_nm: (maps, j) terms of each map.
        covariance: (maps, j, j) of each map's terms, nm^2; maps are independent.
    """
    size = len(design.terms)
    known = _complement(design.null)
    root = np.linalg.cholesky(covariance)
    whole = np.concatenate([design.moves, np.broadcast_to(np.eye(size), design.moves.shape)], axis=2) @ known
    rows = np.linalg.solve(root, whole).reshape(-1, known.shape[1])
    right = np.linalg.solve(root, seen_nm[:, :, None]).reshape(-1)
    q, r = np.linalg.qr(rows)
    value = np.linalg.solve(r, q.T @ right)
    spread = known @ np.linalg.inv(r)
    gauge = _gauge(design)
    both, spread = gauge @ (known @ value), gauge @ spread
    part, instrument = both[:size], both[size:]
    left = seen_nm - (design.moves @ part + instrument)
    return TermSolution(
        part_nm=part,
        instrument_nm=instrument,
        covariance=spread[size:] @ spread[size:].T,
        left_nm=left,
        chi2=float(((right - rows @ value) ** 2).sum()),
    )


def solve_noise(
    design: Design, seen_nm: FloatArray, per_noise: FloatArray, place: PlaceError, noise_nm: float | None
) -> tuple[TermSolution, float]:
    """The solution, and the noise of a sample: the one that is given, or that at which the misfit is as expected.

    Errors of the poses act through the part, as a first solution without them has it.

    Args:
        design: the poses; where the noise is not given, of a freedom above 0.
        seen_nm: (maps, j) terms of each map.
        per_noise: (maps, j, j) their covariance for noise of 1 nm a sample.
        place: how well the poses are known.
        noise_nm: of a sample; None: to be found.
    """
    exact = solve(design, seen_nm, per_noise)
    found = np.sqrt(exact.chi2 / design.freedom) if noise_nm is None else noise_nm
    least = float(np.finfo(float).eps * np.abs(seen_nm).max(initial=1.0))
    found = max(float(found), least)
    own = pose_error_covariance(design, exact.part_nm, place)
    if not own.any():
        return replace(exact, covariance=exact.covariance * found**2, chi2=exact.chi2 / found**2), found

    def excess(noise: float) -> float:
        return solve(design, seen_nm, noise**2 * per_noise + own).chi2 - design.freedom

    if noise_nm is None and excess(LEAST_SHARE * found) <= 0:
        found *= LEAST_SHARE
    elif noise_nm is None:
        found = float(scipy.optimize.brentq(excess, LEAST_SHARE * found, found, rtol=1e-3))
    return solve(design, seen_nm, found**2 * per_noise + own), found


def pose_error_covariance(design: Design, part_nm: FloatArray, place: PlaceError) -> FloatArray:
    """(maps, j, j) covariance that errors of the poses give to the terms that are seen, nm^2."""
    whole = np.concatenate([np.zeros(LEVEL), part_nm])

    def seen(pose: PartPose) -> FloatArray:
        return np.asarray((pose_matrix(design.degree, pose, design.radius_mm) @ whole)[LEVEL:])

    found = []
    for pose in design.poses:
        ways = (
            replace(pose, angle_deg=pose.angle_deg + place.angle_deg),
            replace(pose, x_mm=pose.x_mm + place.shift_mm),
            replace(pose, y_mm=pose.y_mm + place.shift_mm),
        )
        change = np.stack([seen(way) - seen(pose) for way in ways])
        found.append(change.T @ change)
    return np.stack(found)


def _complement(null: FloatArray) -> FloatArray:
    """(2 j, p) orthonormal: all that is not in the null space."""
    whole, _ = np.linalg.qr(null, mode="complete")
    return np.asarray(whole[:, null.shape[1] :])


def _gauge(design: Design) -> FloatArray:
    """(2 j, 2 j) moves along the null space until the instrument has nothing of what is hidden: the part takes it."""
    size = len(design.terms)
    own = design.null[size:]
    away = np.linalg.pinv(own) @ design.hidden @ design.hidden.T
    found = np.eye(2 * size)
    found[:, size:] -= design.null @ away
    return found


# What Zernike terms leave of the maps, sample by sample: the instrument's in the map's frame, the part's in its own.

SWEEPS = 12
"""Sweeps of both means. A wave of which each sweep finds half is known to 1/4096 after them."""
LEAST_MAPS = 2
"""Maps that must show a sample."""
SETTLED = 1e-3
"""Change of the instrument's map, of itself, at which it is done."""
LEAST_SHARE = 0.1
"""Share of the samples that must exceed the unknowns to estimate the noise."""
Way = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Function from coordinates in one frame, mm about the axis, to those in the other."""


@dataclass(frozen=True, slots=True)
class PixelRemainder:
    """Two maps of (ny, nx) on the grid of the maps, NaN where fewer than two show a sample."""

    instrument_nm: FloatArray
    part_nm: FloatArray
    """About the axis, as it lies at 0 deg without a shift."""
    noise_nm: float | None
    """Noise of one sample of one map, from the residual of both; None without degrees of freedom."""


@dataclass(frozen=True, slots=True)
class _Turned:
    """A frame's samples in the other: what does not change from sweep to sweep."""

    at: FloatArray
    """(2, ny, nx) rows and columns of where each lies in the other."""
    nearest: NDArray[np.int32]
    """(2, ny, nx) of each sample of the other the nearest with data."""
    there: BoolArray
    """(ny, nx) where the other has data."""

    @classmethod
    def of(cls, way: Way, valid: BoolArray, axis_px: tuple[float, float], pitch_mm: float) -> _Turned:
        """By coordinates about the axis, of a frame with data where ``valid``."""
        rows, columns = np.indices(valid.shape, dtype=np.float64)
        x, y = way(np.asarray((columns - axis_px[1]) * pitch_mm), np.asarray((axis_px[0] - rows) * pitch_mm))
        at = np.stack([axis_px[0] - y / pitch_mm, axis_px[1] + x / pitch_mm])
        nearest = scipy.ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
        there = scipy.ndimage.map_coordinates(valid.astype(np.float64), at, order=1, cval=0.0) > 0.5
        return cls(at, nearest, there)

    def take(self, height_nm: FloatArray) -> FloatArray:
        """(ny, nx) by cubic splines through the data and, where there is none, the nearest."""
        found = scipy.ndimage.map_coordinates(height_nm[tuple(self.nearest)], self.at, order=3, mode="nearest")
        return np.where(self.there, found, np.nan)


def split_remainder(
    heights_nm: Sequence[FloatArray], poses: Sequence[PartPose], axis_px: tuple[float, float], pitch_mm: float
) -> PixelRemainder:
    """Part and instrument of maps that piston, tilt and the low terms were taken off.

    Args:
        heights_nm: (ny, nx) of each map, NaN = no data.
        poses: of the part in each.
        axis_px: (row, column) about which the part is turned.
        pitch_mm: of all.
    """
    valid = [np.isfinite(height) for height in heights_nm]
    onto = [_Turned.of(pose.in_map, there, axis_px, pitch_mm) for pose, there in zip(poses, valid, strict=True)]
    shown, seen = np.sum([way.there for way in onto], axis=0), np.sum(valid, axis=0)
    back = [_Turned.of(pose.on_part, shown > 0, axis_px, pitch_mm) for pose in poses]
    instrument = np.zeros(seen.shape)
    for _ in range(SWEEPS):
        before = instrument
        part = _part(heights_nm, instrument, onto)
        instrument = _mean([height - way.take(part) for height, way in zip(heights_nm, back, strict=True)])
        if np.linalg.norm(instrument - before) <= SETTLED * np.linalg.norm(instrument):
            break
    part = _part(heights_nm, instrument, onto)
    enough = seen >= LEAST_MAPS
    off = [(height - way.take(part) - instrument)[enough] for height, way in zip(heights_nm, back, strict=True)]
    left = np.concatenate([one[np.isfinite(one)] for one in off])
    freedom = left.size - np.count_nonzero(enough) - np.count_nonzero(shown >= LEAST_MAPS)
    return PixelRemainder(
        instrument_nm=np.where(enough, instrument, np.nan),
        part_nm=np.where(shown >= LEAST_MAPS, part, np.nan),
        noise_nm=float(np.sqrt((left**2).sum() / freedom)) if freedom > LEAST_SHARE * left.size else None,
    )


def _part(heights_nm: Sequence[FloatArray], instrument_nm: FloatArray, onto: Sequence[_Turned]) -> FloatArray:
    return _mean([way.take(height - instrument_nm) for height, way in zip(heights_nm, onto, strict=True)])


def _mean(heights_nm: Sequence[FloatArray]) -> FloatArray:
    """(ny, nx) of what has data, 0 where nothing has."""
    count = np.sum([np.isfinite(height) for height in heights_nm], axis=0)
    return np.asarray(np.nansum(heights_nm, axis=0) / np.maximum(count, 1))


# How much of an instrument's shorter waves poses leave unknown: those above the order of the Zernike terms.

RADIUS_PX = 30
"""Samples across the trial's aperture."""
WAVE_PX = 1.5
"""Over which its noise is made smooth, for turning it costs short waves by themselves."""
TRIALS = 3
"""Trials of some 300 waves each: the share is known to a tenth of itself."""


def hidden_share(poses: Sequence[PartPose], degree: int, radius_mm: float) -> float:
    """Mean share, 0 to 1, of the square of the instrument's waves above an order that stays in the part.

    Args:
        poses: of the part in each map.
        degree: radial order of the terms, which `solve` determines.
        radius_mm: of the aperture.
    """
    along = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    mask = np.hypot(along[:, None], along[None, :]) <= RADIUS_PX
    pitch_mm, axis = radius_mm / RADIUS_PX, (float(RADIUS_PX), float(RADIUS_PX))
    count = (degree + 1) * (degree + 2) // 2
    rng = np.random.default_rng(0)
    whole, hidden = 0.0, 0.0
    for _ in range(TRIALS):
        noise = np.where(mask, scipy.ndimage.gaussian_filter(rng.normal(size=mask.shape), WAVE_PX), np.nan)
        print_nm = noise - zernike.surface(zernike.fit(noise, mask, count, "ansi", circle_px=(*axis, RADIUS_PX)), mask)
        seen = [np.where(_on_part(pose, mask, pitch_mm), print_nm, np.nan) for pose in poses]
        found = split_remainder(seen, poses, axis, pitch_mm).instrument_nm
        there = np.isfinite(found)
        whole += float((print_nm[there] ** 2).sum())
        hidden += float(((print_nm - found)[there] ** 2).sum())
    return min(hidden / whole, 1.0) if whole else 1.0


def _on_part(pose: PartPose, mask: BoolArray, pitch_mm: float) -> BoolArray:
    """(ny, nx) samples of the map where the part is."""
    along = (np.arange(len(mask), dtype=np.float64) - RADIUS_PX) * pitch_mm
    x_mm, down_mm = np.meshgrid(along, along)
    x, y = pose.on_part(x_mm, -down_mm)
    return np.asarray(np.hypot(x, y) <= RADIUS_PX * pitch_mm)


DEGREE = 10
"""Radial order of the terms: 66 with piston and tilts."""
BY_FAR = 10.0
"""Misfits of the two senses of turning that differ by more than this tell which is right."""
LEAST_SHOWN = 0.01
"""Share of shorter waves that is taken to be seen at least."""
LEAST_FREEDOM = 3
"""Equations more than unknowns, below which the noise must be given."""


@dataclass(frozen=True, slots=True)
class AbsoluteSolution:
    """Part and instrument, and how sure the instrument is."""

    instrument_nm: FloatArray
    """(ny, nx) in the maps' frame, NaN where fewer than two maps have data; no piston, tilt, nor what is hidden."""
    part_nm: FloatArray
    """(ny, nx) as it lies at 0 deg, the axis where the maps have it; with what is hidden."""
    solution: TermSolution
    design: Design
    circle_px: tuple[float, float, float]
    """(row, column) about which the part was turned, and the radius of the terms' unit circle."""
    decentre_mm: tuple[float, ...]
    """Distance of each map's data center from the axis by its pose."""
    noise_nm: float
    """Noise of one sample of one map, as it acts on the terms."""
    rest_noise_nm: float | None
    """Noise above the terms; None with too few maps."""
    hidden_share: float
    """Share of the square of the instrument's waves above the terms' order that stays in the part."""
    hidden_rest_nm: float
    """The RMS of those waves, from what is seen of the rest: for a print that follows no fold of the turns."""
    misfit: float
    """Chi-squared of the terms over its expectation: 1 where the noise was estimated here."""
    sense: bool
    """The maps tell that the angles' sense is right; False: both senses fit about alike."""
    left_nm: tuple[float, ...]
    """RMS of the terms of each map that part and instrument do not explain."""

    @property
    def sigma_nm(self) -> FloatArray:
        """(j,) of each of the instrument's terms, one standard deviation, without what is hidden."""
        return np.sqrt(np.diag(self.solution.covariance))

    @property
    def uncertainty_nm(self) -> float:
        """Standard deviation of a sample of the instrument's map, RMS, without the hidden part."""
        noise = self.noise_nm if self.rest_noise_nm is None else self.rest_noise_nm
        rest = 2 * noise**2 / len(self.design.poses)  # of the mean over maps, and of the part's that is taken off
        return float(np.sqrt(np.trace(self.solution.covariance) + rest))


def separate_instrument(
    heights_nm: Sequence[FloatArray],
    poses: Sequence[PartPose],
    pitch_mm: float,
    *,
    degree: int = DEGREE,
    axis_px: tuple[float, float] | None = None,
    noise_nm: float | None = None,
    place: PlaceError | None = None,
) -> AbsoluteSolution:
    """Tell instrument and part apart.

    Args:
        heights_nm: (ny, nx) of each map, all of one camera's frame, positive = high, NaN = no data.
        poses: of the part in each; angles counter-clockwise as displayed.
        pitch_mm: of all.
        degree: radial order of the terms.
        axis_px: (row, column) about which the part is turned; None: the middle of the data, less the shifts.
        noise_nm: white noise of one sample; None: found from what the maps have in common.
        place: how well the poses are known; None: exactly.

    Raises:
        MapError: maps of other sizes, or too few; poses that are all alike; angles of the wrong sense; too little in
            common to tell the noise.
    """
    _require_alike(heights_nm, poses)
    masks = [np.isfinite(height) for height in heights_nm]
    middle = _middles(masks, poses, pitch_mm)
    axis = (float(middle[:, 0].mean()), float(middle[:, 1].mean())) if axis_px is None else axis_px
    radius = max(_furthest(mask, axis) for mask in masks)
    count = (degree + 1) * (degree + 2) // 2
    fits = [
        zernike.fit(height, mask, count, "ansi", circle_px=(*axis, radius))
        for height, mask in zip(heights_nm, masks, strict=True)
    ]
    found = design_poses(poses, degree, radius * pitch_mm)
    if noise_nm is None and found.freedom < LEAST_FREEDOM:
        raise MapError(
            f"{len(poses)} maps up to order {degree} have nothing in common to tell their noise by: give it, "
            "measure at more angles, or take more orders"
        )
    seen = np.stack([fit.coefficients_nm[LEVEL:] for fit in fits])
    per_noise = np.stack([fit.per_noise[LEVEL:, LEVEL:] for fit in fits])
    sense = _sense(found, seen, per_noise)
    solution, noise = solve_noise(found, seen, per_noise, place or PlaceError(), noise_nm)
    rest = split_remainder(
        [height - zernike.surface(fit, mask) for height, fit, mask in zip(heights_nm, fits, masks, strict=True)],
        poses, axis, pitch_mm,
    )  # fmt: skip
    share = hidden_share(poses, degree, radius * pitch_mm)
    return AbsoluteSolution(
        instrument_nm=rest.instrument_nm + _surface(found, solution.instrument_nm, rest.instrument_nm, axis, radius),
        part_nm=rest.part_nm + _surface(found, solution.part_nm, rest.part_nm, axis, radius),
        solution=solution,
        design=found,
        circle_px=(*axis, radius),
        decentre_mm=tuple(float(one) * pitch_mm for one in np.hypot(*(middle - axis).T)),
        noise_nm=noise,
        rest_noise_nm=rest.noise_nm,
        hidden_share=share,
        hidden_rest_nm=_hidden_nm(rest, share, len(poses), noise),
        misfit=solution.chi2 / found.freedom if found.freedom else 0.0,
        sense=sense,
        left_nm=tuple(float(one) for one in np.sqrt((solution.left_nm**2).sum(axis=1))),
    )


def _require_alike(heights_nm: Sequence[FloatArray], poses: Sequence[PartPose]) -> None:
    if len(heights_nm) != len(poses):
        raise MapError(f"{len(heights_nm)} maps and {len(poses)} poses: give an angle for each map, in their order")
    if len(heights_nm) < 2:
        raise MapError("one map does not tell the instrument from the part: turn the part and measure again")
    shapes = sorted({height.shape for height in heights_nm})
    if len(shapes) > 1:
        raise MapError(f"maps of {' and '.join(f'{rows} x {columns}' for rows, columns in shapes)} samples are not of "
                     "one camera's frame: measure all with one zoom and one crop")  # fmt: skip


def _middles(masks: Sequence[BoolArray], poses: Sequence[PartPose], pitch_mm: float) -> FloatArray:
    """(maps, 2) row and column of the middle of each map's data, less its shift."""
    middle = np.array([zernike.enclosing_circle(mask)[:2] for mask in masks])
    return middle - np.array([(-pose.y_mm, pose.x_mm) for pose in poses]) / pitch_mm


def _furthest(mask: BoolArray, axis_px: tuple[float, float]) -> float:
    """Pixels from the axis to the furthest sample."""
    row, column = np.nonzero(mask)
    return float(np.hypot(row - axis_px[0], column - axis_px[1]).max())


def _hidden_nm(rest: PixelRemainder, share: float, maps: int, noise_nm: float) -> float:
    """RMS of what is hidden of the rest, by what is shown of it less the noise of the mean over maps."""
    shown = max(1.0 - share, LEAST_SHOWN)
    own = noise_nm if rest.noise_nm is None else rest.noise_nm
    square = float(np.nanmean(rest.instrument_nm**2)) - shown * own**2 / maps
    return float(np.sqrt(max(square, 0.0) * share / shown))


def _sense(found: Design, seen_nm: FloatArray, per_noise: FloatArray) -> bool:
    """Return whether the maps confirm counterclockwise angles; MapError where they show the opposite."""
    turned = [replace(pose, angle_deg=-pose.angle_deg) for pose in found.poses]
    other = design_poses(turned, found.degree, found.radius_mm)
    least = float(np.finfo(float).eps * (seen_nm**2).sum() / per_noise[0, 0, 0])
    ours, theirs = (solve(one, seen_nm, per_noise).chi2 + least for one in (found, other))
    if theirs * BY_FAR < ours:
        raise MapError(
            f"the maps fit {np.sqrt(ours / theirs):.3g} times better with the angles' signs turned: angles are "
            "counter-clockwise as the maps are displayed; turn their signs, or see whether the maps are mirrored"
        )
    return ours * BY_FAR < theirs


def _surface(
    found: Design, terms_nm: FloatArray, wanted: FloatArray, axis_px: tuple[float, float], radius_px: float
) -> FloatArray:
    """(ny, nx) nm of terms where ``wanted`` has data, NaN elsewhere."""
    mask = np.isfinite(wanted)
    surface = np.full(wanted.shape, np.nan)
    surface[mask] = terms_nm @ values(found.terms, "rms", *zernike.unit_coordinates(mask, (*axis_px, radius_px)))
    return surface


# Errors of the instrument's map, kept beside it: covariance of each term, and the terms that no pose determined.

DIGITS = 9
"""Digits of the stored covariance; with fewer it is not positive definite."""
Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class AbsoluteTestResult:
    """Errors of the instrument's map, as the bound of a figure needs them."""

    degree: int
    """Radial order of the terms."""
    terms: tuple[Term, ...]
    """(n, m) of the instrument's terms above tilt: RMS norm, angles from x towards y."""
    covariance: FloatArray
    """(j, j) nm^2 of the terms that were determined."""
    unknown: Mapping[Term, float]
    """Undetermined share, 0 to 1, of each term that is not fully determined."""
    rest_nm: float
    """RMS of the waves above the terms that the poses leave undetermined."""
    circle_px: tuple[float, float, float]
    """(row, column, radius) of the terms' unit circle in the map's frame."""

    @classmethod
    def of(cls, found: AbsoluteSolution) -> Self:
        """Return the errors of a solution."""
        design = found.design
        share = {(one.n, one.m): one.share for one in design.unknown}
        return cls(design.degree, design.terms, found.solution.covariance, share, found.hidden_rest_nm, found.circle_px)

    def with_reference(self, term: Term, sigma_nm: float) -> AbsoluteTestResult:
        """Return the errors with a term that a reference determined to ``sigma_nm``, one standard deviation.

        Raises:
            MapError: the poses determined the term already, or there is no such term.
        """
        if term not in self.unknown:
            raise MapError(f"the term (n, m) = {term} is none that the poses left unknown: leave the reference out")
        at = self.terms.index(term)
        covariance = self.covariance.copy()
        covariance[at, :] = covariance[:, at] = 0.0
        covariance[at, at] = sigma_nm**2
        unknown = {one: share for one, share in self.unknown.items() if one != term}
        return replace(self, covariance=covariance, unknown=unknown)

    def shape(self, term: Term, mask: BoolArray) -> FloatArray:
        """Return (ny, nx) of a term of RMS 1 over the circle inside ``mask`` of the map's frame, NaN outside."""
        height = np.full(mask.shape, np.nan)
        height[mask] = values((term,), "rms", *zernike.unit_coordinates(mask, self.circle_px))[0]
        return height

    def facts(self) -> dict[str, Any]:
        """Return JSON values; the covariance is its lower triangle, row by row."""
        lower = self.covariance[np.tril_indices(len(self.terms))]
        return {
            "degree": self.degree,
            "terms": [list(term) for term in self.terms],
            "covariance": [float(f"{value:.{DIGITS}g}") for value in lower],
            "unknown": [[*term, share] for term, share in self.unknown.items()],
            "rest_nm": self.rest_nm,
            "circle_px": list(self.circle_px),
        }

    @classmethod
    def load(cls, facts: Mapping[str, Any]) -> Self:
        """Read the errors from their JSON values; ValueError, TypeError or KeyError where they are malformed."""
        terms = tuple((int(n), int(m)) for n, m in facts["terms"])
        covariance = np.zeros((len(terms), len(terms)))
        covariance[np.tril_indices(len(terms))] = facts["covariance"]
        row, column, radius = map(float, facts["circle_px"])
        return cls(
            int(facts["degree"]),
            terms,
            covariance + np.tril(covariance, -1).T,
            {(int(n), int(m)): float(share) for n, m, share in facts["unknown"]},
            float(facts["rest_nm"]),
            (row, column, radius),
        )


@dataclass(frozen=True, slots=True)
class SystemMap:
    """The instrument's error, which is subtracted from each of its maps."""

    surface: SurfaceMap
    """In the frame of its maps after the instrument's profile."""
    result: AbsoluteTestResult

    def off(self, surface: SurfaceMap) -> SurfaceMap:
        """Subtract the instrument's error from a map, sample by sample; no data where the error has none.

        Args:
            surface: a map after the instrument's profile.

        Raises:
            MapError: the map has other samples or another pitch.
        """
        own, other = self.surface.height_nm.shape, surface.height_nm.shape
        pitch, wanted = surface.pitch_mm, self.surface.grid.pitch_mm
        if other != own or pitch is None or abs(pitch - wanted) > SAME_PITCH * wanted:
            name = surface.path.name if surface.path is not None else "the map"
            given = "no pitch" if pitch is None else f"{pitch:.6g} mm"
            raise MapError(
                f"{name} has {other[0]} x {other[1]} samples of {given}, the instrument's system map "
                f"{own[0]} x {own[1]} of {wanted:.6g} mm: measure with the zoom and crop of its calibration, or "
                "calibrate it with these"
            )
        return surface.with_height(surface.height_nm - self.surface.height_nm)
