"""The part's place by its outline where that is a polygon: its sides through the rim of the data."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from polishd.model.errors import MapError
from polishd.model.outline import Polygon
from polishd.model.surface import FloatArray
from polishd.process.registration.outline import LEAST_RIM, LEAST_ROUND, WITHIN_PX, require_rim, rim_px
from polishd.process.registration.record import Registration

LEAST_KNOWN = 0.005
"""Of the rim's samples, those that would move if the part were shifted or turned: where fewer, nobody sees how far."""
PLACES = 400
"""Along the outline, at which it is looked for."""


def fit_polygon(height_nm: FloatArray, pitch_mm: float, part: Polygon, tolerance_mm: float) -> Registration:
    """Where the part lies in a map, by the sides that its data end on.

    The turn is the one nearest to none: half a turn of a rectangle cannot be seen.

    Args:
        height_nm: (ny, nx), NaN = no data.
        pitch_mm: of the map.
        part: the outline, about the part's centre.
        tolerance_mm: how much larger or smaller across it may be.

    Raises:
        BadMap: another outline, or too little of the rim in sight to say where the part lies.
    """
    x, y = rim_px(height_nm)
    require_rim(x)
    rim = np.stack([x, y]) * pitch_mm
    lever, within = part.radius_mm, WITHIN_PX * pitch_mm
    low, high = part.corners().min(axis=0), part.corners().max(axis=0)
    middle = (rim.min(axis=1) + rim.max(axis=1) - low - high) / 2
    found = _fitted(np.array([0.0, *middle, 0.0]), rim, part, within)
    held = np.abs(_gap_mm(found.x, rim, part)) <= within
    if not held.mean() >= LEAST_ROUND:
        raise MapError(f"the rim of the map's data is not that of {part}: {held.mean():.0%} of it lies on the best fit; "
                     "name the right map, mend the part's outline, mask what is not the part, or register by "
                     "fiducials")  # fmt: skip
    found = _fitted(found.x, rim[:, held], part, within)
    guess = found.x
    turn, shift, grown = float(guess[0]) / lever, (float(guess[1]), float(guess[2])), float(guess[3])
    if not abs(2 * grown) <= tolerance_mm:
        raise MapError(f"the map's outline is {abs(2 * grown):.3f} mm {'larger' if grown > 0 else 'smaller'} across than "
                     f"{part}, {tolerance_mm:g} mm allowed: the pitch is wrong, or it is another part; mend the part's "
                     "outline or the pitch")  # fmt: skip
    known = found.jac[:, :3].T @ found.jac[:, :3] / len(found.jac)
    seen = _visible_share(part, turn, shift, rim[:, held].T, 2 * pitch_mm + abs(grown))
    if seen < LEAST_RIM or np.linalg.eigvalsh(known)[0] < LEAST_KNOWN:
        raise MapError(f"{seen:.0%} of the part's rim is seen, and it does not say where the part lies in all "
                     "directions: centre the part in the frame, or register by fiducials")  # fmt: skip
    residual = float(np.sqrt(np.mean(_gap_mm(guess, rim[:, held], part) ** 2)))
    scale = 1 + 2 * grown / min(part.size_mm)
    return Registration(np.degrees(turn), shift, residual, int(held.sum()), "aperture", scale)


def _fitted(guess: FloatArray, rim: FloatArray, part: Polygon, within_mm: float) -> Any:
    """What scipy finds; a few samples far off, of a clamp or a chip, draw little."""
    return scipy.optimize.least_squares(_gap_mm, guess, args=(rim, part), loss="soft_l1", f_scale=within_mm / 2)


def _gap_mm(place: FloatArray, rim: FloatArray, part: Polygon) -> FloatArray:
    """(n,) distance of the rim (2, n) from the outline, which is turned, shifted and moved outwards.

    ``place``: way of the farthest corner by the turn, shift along x and y, way outwards; all mm.
    """
    turn = place[0] / part.radius_mm
    right, up = rim[0] - place[1], rim[1] - place[2]
    x, y = np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right
    return np.asarray(part.inside_mm(x, y) + place[3], dtype=np.float64)


def _visible_share(part: Polygon, turn: float, shift: tuple[float, float], rim: FloatArray, within_mm: float) -> float:
    """Share of the outline's length that has a sample (n, 2) of the rim beside it."""
    corner = np.vstack([part.corners(), part.corners()[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1))])
    at = (np.arange(PLACES) + 0.5) * way[-1] / PLACES
    x, y = (np.interp(at, way, corner[:, k]) for k in (0, 1))
    seen_at = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=1) + shift
    away, _ = scipy.spatial.cKDTree(rim).query(seen_at, distance_upper_bound=within_mm)
    return float(np.mean(np.isfinite(away)))
