"""The part's place by its outline: a circle through the rim of the data, whatever is missing inside or cut off."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray
from polishd.process.registration.record import Registration

TRIALS = 400
"""Circles through three samples of the rim that are tried; the seed is fixed: the same map, the same answer."""
WITHIN_PX = 1.0
"""Distance from the circle up to which a sample of the rim belongs to it."""
SECTORS = 72
LEAST_RIM = 0.4
"""Share of the circle that must be seen."""
LEAST_ROUND = 0.75
"""Share of the rim that lies on its best circle below which another diameter is that of no circle at all."""
LEAST_PIECE = 0.05
"""Size of a piece of the data, relative to the largest, below which it is a crumb."""
STEPS = 20


def fit_circle(height_nm: FloatArray, pitch_mm: float, diameter_mm: float, tolerance_mm: float) -> Registration:
    """Where the part's centre lies in a map, by the circle that its data end on. The turn cannot be seen: 0.

    Args:
        height_nm: (ny, nx), NaN = no data.
        pitch_mm: of the map.
        diameter_mm: of the outline.
        tolerance_mm: how far the diameter may be off.

    Raises:
        BadMap: an outline that is no circle, another diameter, or too little of the rim in sight.
    """
    x, y = rim_px(height_nm)
    require_rim(x)
    centre_x, centre_y, radius = _trials(x, y)
    for _ in range(STEPS):
        held = abs(np.hypot(x - centre_x, y - centre_y) - radius) <= WITHIN_PX
        moved = _step(x[held], y[held], centre_x, centre_y)
        if np.hypot(moved[0] - centre_x, moved[1] - centre_y) < 1e-6:
            break
        centre_x, centre_y, radius = moved
    diameter = 2 * radius * pitch_mm
    gap = np.hypot(x - centre_x, y - centre_y) - radius
    held = abs(gap) <= WITHIN_PX
    if not abs(diameter - diameter_mm) <= tolerance_mm and held.mean() < LEAST_ROUND:
        raise MapError(f"the rim of the map's data is no circle: {held.mean():.0%} of it lies on the best one; only round"
                     " outlines are fitted, so register by fiducials, or mask what is not the part")  # fmt: skip
    if not abs(diameter - diameter_mm) <= tolerance_mm:
        raise MapError(f"the map's outline is {diameter:.3f} mm across, {diameter_mm:g} mm expected and "
                     f"{tolerance_mm:g} mm allowed: the pitch is wrong, it is another part, or another aperture; mend "
                     "instrument.aperture_mm or the pitch")  # fmt: skip
    seen = _visible_turn(x[held] - centre_x, y[held] - centre_y)
    if seen < LEAST_RIM:
        raise MapError(f"only {seen:.0%} of the part's rim is seen, at least {LEAST_RIM:.0%} is needed to place it: "
                     "centre the part in the frame, or register by fiducials")  # fmt: skip
    shift = (centre_x * pitch_mm, centre_y * pitch_mm)
    residual = float(np.sqrt(np.mean(gap[held] ** 2))) * pitch_mm
    return Registration(0.0, shift, residual, int(held.sum()), "aperture", diameter / diameter_mm)


def require_rim(x: FloatArray) -> None:
    """BadMap unless so many samples of a rim (n,) can place a part."""
    if x.size < SECTORS:
        raise MapError(f"the map shows {x.size} samples of the part's rim, too few to place it: the part fills the "
                     "frame, or hardly has data; register by fiducials, or measure with the rim in view")  # fmt: skip


def rim_px(height_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """X right and y up, px from the centre of the array: the middle of each pixel side between part and outside.

    Holes are no rim, nor is the edge of the array; crumbs of data beside the part do not count.
    """
    valid = np.isfinite(height_nm)
    labels, count = scipy.ndimage.label(valid)
    if not count:
        return np.empty(0), np.empty(0)
    size = np.bincount(labels.ravel())
    size[0] = 0
    part = scipy.ndimage.binary_fill_holes((size >= LEAST_PIECE * size.max())[labels])
    row, column = np.nonzero(part[:, 1:] != part[:, :-1])
    row_2, column_2 = np.nonzero(part[1:] != part[:-1])
    ny, nx = part.shape
    x = np.concatenate([column + 0.5, column_2]) - (nx - 1) / 2
    y = (ny - 1) / 2 - np.concatenate([row, row_2 + 0.5])
    return x, y


def _trials(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """The circle through three samples that most others lie on."""
    rng = np.random.default_rng(0)
    three = rng.integers(0, x.size, (TRIALS, 3))
    (xa, xb, xc), (ya, yb, yc) = x[three].T, y[three].T
    twice = 2 * ((xb - xa) * (yc - ya) - (xc - xa) * (yb - ya))
    fine = abs(twice) > x.size  # else nearly in line, or the same sample
    xa, xb, xc, ya, yb, yc, twice = (v[fine] for v in (xa, xb, xc, ya, yb, yc, twice))
    b2, c2 = (xb - xa) ** 2 + (yb - ya) ** 2, (xc - xa) ** 2 + (yc - ya) ** 2
    u, v = ((yc - ya) * b2 - (yb - ya) * c2) / twice, ((xb - xa) * c2 - (xc - xa) * b2) / twice
    centre_x, centre_y, radius = xa + u, ya + v, np.hypot(u, v)
    if not radius.size:
        raise MapError("the rim of the map's data is no circle: mask what is not the part, or register by fiducials")
    some = slice(None, None, 1 + x.size // 2000)
    away = abs(np.hypot(x[some] - centre_x[:, None], y[some] - centre_y[:, None]) - radius[:, None])
    best = int((away <= WITHIN_PX).sum(axis=1).argmax())
    return float(centre_x[best]), float(centre_y[best]), float(radius[best])


def _step(x: FloatArray, y: FloatArray, centre_x: float, centre_y: float) -> tuple[float, float, float]:
    """One Gauss-Newton step to the circle of least squared distances (not of least algebraic ones, which is biased)."""
    dx, dy = x - centre_x, y - centre_y
    distance = np.hypot(dx, dy)
    terms = np.column_stack([dx / distance, dy / distance, np.ones(x.size)])
    step = np.linalg.lstsq(terms, distance, rcond=None)[0]
    return float(centre_x + step[0]), float(centre_y + step[1]), float(step[2])


def _visible_turn(dx: FloatArray, dy: FloatArray) -> float:
    """Share of the sectors of the circle that hold a sample of the rim."""
    sector = np.floor((np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    return np.unique(sector).size / SECTORS
