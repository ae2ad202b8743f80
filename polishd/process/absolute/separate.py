"""Maps of one part at several turns and shifts as two: the instrument's own error, and the part.

Low orders are Zernike terms, since in them the design says exactly what is told and how sure it is; what they leave
goes sample by sample (`rest`). What no pose tells is the part's, and named: the instrument's map has nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.design import Design, design
from polishd.process.absolute.hidden_rest import hidden_share
from polishd.process.absolute.poses import LEVEL, PartPose
from polishd.process.absolute.rest import PixelRemainder, split
from polishd.process.absolute.solution import PlaceError, TermSolution, solve, solve_noise
from polishd.process.metrics import zernike
from polishd.process.metrics.zernike_terms import values

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
    """Of each map, how far the middle of its data lies from where its pose puts the axis."""
    noise_nm: float
    """Of one sample of one map, as it acts on the terms."""
    rest_noise_nm: float | None
    """The same of what the terms leave; None where too few maps tell it."""
    hidden_share: float
    """Of the square of the instrument's waves above the terms' order, what the poses leave in the part."""
    hidden_rest_nm: float
    """The RMS of those waves, from what is seen of the rest: for a print that follows no fold of the turns."""
    misfit: float
    """Of the terms, over its expectation: 1 where the noise was found here."""
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
        """Of a sample of the instrument's map, RMS, one standard deviation, without what is hidden."""
        noise = self.noise_nm if self.rest_noise_nm is None else self.rest_noise_nm
        rest = 2 * noise**2 / len(self.design.poses)  # of the mean over maps, and of the part's that is taken off
        return float(np.sqrt(np.trace(self.solution.covariance) + rest))


def separate(
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
        BadMap: maps of other sizes, or too few; poses that are all alike; angles of the wrong sense; too little in
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
    found = design(poses, degree, radius * pitch_mm)
    if noise_nm is None and found.freedom < LEAST_FREEDOM:
        raise MapError(f"{len(poses)} maps up to order {degree} have nothing in common to tell their noise by: give it, "
                     "measure at more angles, or take more orders")  # fmt: skip
    seen = np.stack([fit.coefficients_nm[LEVEL:] for fit in fits])
    per_noise = np.stack([fit.per_noise[LEVEL:, LEVEL:] for fit in fits])
    sense = _sense(found, seen, per_noise)
    solution, noise = solve_noise(found, seen, per_noise, place or PlaceError(), noise_nm)
    rest = split(
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
    middle = np.array([zernike.enclosing(mask)[:2] for mask in masks])
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
    """Whether the maps tell that angles are counter-clockwise; BadMap where they tell the opposite."""
    turned = [replace(pose, angle_deg=-pose.angle_deg) for pose in found.poses]
    other = design(turned, found.degree, found.radius_mm)
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
    surface[mask] = terms_nm @ values(found.terms, "rms", *zernike.unit(mask, (*axis_px, radius_px)))
    return surface
