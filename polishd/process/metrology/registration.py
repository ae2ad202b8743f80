"""Register a map as its instrument's profile asks, within the profile's limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from math import ceil, comb, perm
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ConfigError, MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle, Outline, Polygon
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.metrology.resampling import Point, Registration

# The part's place by its marks: a rigid fit of found to nominal points, whatever their order, missing or spurious.

ComplexArray = NDArray[np.complex128]

MIN_MARKS = 3
NEEDED = 2 / 3
"""Share of the nominal marks that must be found."""
MOST_FOUND = 40
"""Points beyond which a map shows dirt rather than marks."""
SCALE_TOLERANCE = 0.005
OUTLIER = 8.0
"""RMS distances of the other marks from their own fit, beyond which a mark within the tolerance is half covered."""
FLOOR_PX = 0.05
"""Least RMS distance believed: three marks may lie in line with their nominal places by chance."""
CHANCE = 1e-6
"""Most agreements as good as the one found that chance may be expected to bring."""
SAME_SCALE = (0.2, 5.0)
"""Scales tried to say why nothing fits."""


@dataclass(frozen=True, slots=True)
class _Match:
    """A placement, and the found point of each nominal one (-1: none)."""

    a: complex
    b: complex
    partner: NDArray[np.int64]
    residual_mm: float

    @property
    def used(self) -> int:
        return int(np.count_nonzero(self.partner >= 0))

    @property
    def rank(self) -> tuple[int, float]:
        return (self.used, -self.residual_mm)


def fit_marks(
    found_px: Sequence[Point],
    nominal_mm: Sequence[Point],
    shape: tuple[int, int],
    pitch_mm: float,
    tolerance_mm: float = 0.5,
) -> Registration:
    """Where the part lies in a map, by the marks found there.

    Args:
        found_px: (row, column) of the marks in the map, in any order; some may be missing, some no marks at all.
        nominal_mm: (x, y) of the marks on the part, in no symmetric arrangement.
        shape: of the map's array.
        pitch_mm: of the map.
        tolerance_mm: how far a mark may lie from where the fit has it.

    Raises:
        MapError: too few marks fit, more than one placement fits, or the marks are those of a mirrored or scaled part.
        ConfigError: the nominal marks are too few, or symmetric.
    """
    require_asymmetric(nominal_mm, tolerance_mm)
    p = _complex(nominal_mm)
    q = _in_mm(found_px, shape, pitch_mm)
    needed = max(MIN_MARKS, ceil(NEEDED * p.size - 1e-9))
    where = f"{q.size} marks found, {p.size} on the part"
    if q.size < needed:
        raise MapError(f"{where}: at least {needed} are needed to place it; clean it, mend what covers the marks, or "
                     "register by the aperture")  # fmt: skip
    if q.size > MOST_FOUND:
        raise MapError(f"{where}: more than {MOST_FOUND} is dirt rather than marks; clean the part and measure again")
    matches = _matches(p, q, tolerance_mm, needed)
    mirrored = _matches(p.conj(), q, tolerance_mm, needed)
    if not matches or (mirrored and mirrored[0].used > matches[0].used):
        raise MapError(f"{where}, {_why(p, q, bool(mirrored), tolerance_mm, needed)}")
    best = matches[0]
    rivals = [other for other in (*matches, *mirrored) if other.used == best.used and other is not best]
    best = _without_outlier(p, q, best, FLOOR_PX * pitch_mm, needed)
    if rivals:
        raise MapError(f"{where}: {best.used} of them fit in {1 + len(rivals)} ways, within {tolerance_mm:g} mm: "
                     "uncover the other marks, or add one that breaks the symmetry")  # fmt: skip
    scale = _scale(p, q, best)
    if abs(scale - 1) > SCALE_TOLERANCE:
        raise MapError(f"{where}: they lie {scale:.4f} times as far apart as they should: the map's pitch "
                     f"({pitch_mm:g} mm) is wrong, or it is another part")  # fmt: skip
    expected = _by_chance(p, q, best, pitch_mm)
    if expected > CHANCE:
        raise MapError(
            f"{where}: {best.used} fit with {best.residual_mm:.3f} mm RMS, which chance brings about "
            f"too (one in {1 / min(expected, 1.0):.0f}): uncover more marks, or measure where they lie"
        )
    turn = float(np.degrees(np.angle(best.a)))
    shift = (float(best.b.real), float(best.b.imag))
    return Registration(turn, shift, best.residual_mm, best.used, "fiducials", scale)


def require_asymmetric(nominal_mm: Sequence[Point], tolerance_mm: float = 0.5) -> None:
    """Refuse marks that a turn or a flip lays onto themselves: no fit of them could tell the two apart.

    Raises:
        ConfigError: fewer than three marks, two within the tolerance, or a symmetric arrangement.
    """
    _require_asymmetric(tuple(nominal_mm), tolerance_mm)


@lru_cache(maxsize=16)
def _require_asymmetric(nominal_mm: tuple[Point, ...], tolerance_mm: float) -> None:
    p = _complex(nominal_mm)
    where = "instrument.fiducials_mm"
    if p.size < MIN_MARKS:
        raise ConfigError(f"{where} has {p.size} marks: at least {MIN_MARKS} are needed, in no symmetric arrangement")
    gaps = abs(p[:, None] - p[None, :])[np.triu_indices(p.size, 1)]
    if gaps.min() <= 4 * tolerance_mm:
        raise ConfigError(f"{where}: two marks are {gaps.min():g} mm apart, less than four tolerances "
                          f"({tolerance_mm:g} mm)")  # fmt: skip
    # two placements within the tolerance of the same points differ by up to twice as much
    turned = [m for m in _matches(p, p, 2 * tolerance_mm, p.size) if (m.partner != np.arange(p.size)).any()]
    flipped = _matches(p.conj(), p, 2 * tolerance_mm, p.size)
    for what, same in (("turned by {:.0f} deg", turned), ("flipped and turned by {:.0f} deg", flipped)):
        if same:
            how = what.format(np.degrees(np.angle(same[0].a)))
            raise ConfigError(f"{where}: the marks {how} fall onto themselves within twice the tolerance "
                              f"({tolerance_mm:g} mm): move one, or add one")  # fmt: skip


def _complex(points_mm: Sequence[Point]) -> ComplexArray:
    flat = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
    return np.asarray(flat[:, 0] + 1j * flat[:, 1])


def _in_mm(found_px: Sequence[Point], shape: tuple[int, int], pitch_mm: float) -> ComplexArray:
    """Pixels to mm from the centre of the array: x right, y up."""
    flat = np.asarray(found_px, dtype=np.float64).reshape(-1, 2)
    return np.asarray(((flat[:, 1] - (shape[1] - 1) / 2) + 1j * ((shape[0] - 1) / 2 - flat[:, 0])) * pitch_mm)


def _matches(
    p: ComplexArray, q: ComplexArray, tolerance_mm: float, needed: int, scales: tuple[float, float] | None = None
) -> list[_Match]:
    """All different ways to lay at least ``needed`` of p onto q, best first; rigid unless ``scales`` are allowed."""
    a, b = _hypotheses(p, q, tolerance_mm, scales)
    gap = abs((a[:, None] * p + b[:, None])[:, :, None] - q)  # (hypotheses, nominal, found)
    near = gap.min(axis=2) <= 2 * tolerance_mm  # a hypothesis from two marks carries their errors to the far ones
    worth = np.flatnonzero(near.sum(axis=1) >= needed)
    if not worth.size:
        return []
    found: dict[bytes, _Match] = {}
    for partner in np.unique(np.where(near, gap.argmin(axis=2), -1)[worth], axis=0):
        match = _refined(p, q, partner, tolerance_mm, rigid=scales is None)
        if match is not None and match.used >= needed:
            found[match.partner.tobytes()] = match
    # a part of a fuller match is no other way to lie
    ranked = sorted(found.values(), key=lambda match: match.rank, reverse=True)
    return [m for i, m in enumerate(ranked) if not any(_part_of(m, fuller) for fuller in ranked[:i])]


def _part_of(match: _Match, fuller: _Match) -> bool:
    held = match.partner >= 0
    return bool((match.partner[held] == fuller.partner[held]).sum() >= 2)


def _hypotheses(
    p: ComplexArray, q: ComplexArray, tolerance_mm: float, scales: tuple[float, float] | None
) -> tuple[ComplexArray, ComplexArray]:
    """Placements that lay a pair of p onto an ordered pair of q."""
    pairs = np.array(list(combinations(range(p.size), 2)))
    one, two = np.nonzero(~np.eye(q.size, dtype=bool))
    side = p[pairs[:, 1]] - p[pairs[:, 0]]
    seen = q[two] - q[one]
    with np.errstate(divide="ignore", invalid="ignore"):
        a = seen[None, :] / side[:, None]
    size = abs(a)
    if scales is None:
        k, m = np.nonzero(abs(size - 1) * abs(side)[:, None] <= 2 * tolerance_mm)
        a = a[k, m] / size[k, m]
    else:
        k, m = np.nonzero((size >= scales[0]) & (size <= scales[1]))
        a = a[k, m]
    middle_p, middle_q = p[pairs].mean(axis=1)[k], ((q[one] + q[two]) / 2)[m]
    return a, middle_q - a * middle_p


def _refined(
    p: ComplexArray, q: ComplexArray, partner: NDArray[np.int64], tolerance_mm: float, *, rigid: bool
) -> _Match | None:
    """The least-squares placement of the matched points, without those that it puts out of tolerance."""
    while np.count_nonzero(partner >= 0) >= MIN_MARKS:
        held = np.flatnonzero(partner >= 0)
        if np.unique(partner[held]).size < held.size:
            return None  # two marks on one point
        a, b = _least_squares(p[held], q[partner[held]], rigid=rigid)
        gap = abs(a * p[held] + b - q[partner[held]])
        if gap.max() <= tolerance_mm:
            return _Match(a, b, partner, float(np.sqrt(np.mean(gap**2))))
        partner = partner.copy()
        partner[held[gap.argmax()]] = -1
    return None


def _without_outlier(p: ComplexArray, q: ComplexArray, match: _Match, floor_mm: float, needed: int) -> _Match:
    """The match without the marks, one by one, that lie far from where the others have them."""
    while match.used > needed:
        tried = []
        for k in np.flatnonzero(match.partner >= 0):
            partner = match.partner.copy()
            partner[k] = -1
            rest = _refined(p, q, partner, np.inf, rigid=True)
            if rest is not None:
                tried.append((abs(rest.a * p[k] + rest.b - q[match.partner[k]]), rest))
        off, rest = min(tried, key=lambda pair: pair[1].residual_mm)
        if off <= OUTLIER * max(rest.residual_mm, floor_mm):
            break
        match = rest
    return match


def _least_squares(p: ComplexArray, q: ComplexArray, *, rigid: bool) -> tuple[complex, complex]:
    """The a, b of least ``sum |a p + b - q|^2`` (Procrustes in the plane)."""
    centred = p - p.mean()
    a = complex(np.vdot(centred, q - q.mean()) / np.vdot(centred, centred).real)
    if rigid:
        a /= abs(a) or 1.0
    return a, complex(q.mean() - a * p.mean())


def _scale(p: ComplexArray, q: ComplexArray, match: _Match) -> float:
    held = match.partner >= 0
    return abs(_least_squares(p[held], q[match.partner[held]], rigid=False)[0])


def _by_chance(p: ComplexArray, q: ComplexArray, match: _Match, pitch_mm: float) -> float:
    """Expected number of matches of as many marks, as close, among as many points strewn over the same area."""
    span = 2 * float(abs(p - p.mean()).max())
    reach = max(2 * match.residual_mm, pitch_mm / 10)
    m = match.used
    ways = comb(p.size, m) * perm(q.size, m)
    # two marks place the part, their distance must agree (a line), and each further one fall within reach (an area)
    return float(ways * min(2 * reach / span, 1.0) * min((2 * reach / span) ** 2, 1.0) ** (m - 2))


def _why(p: ComplexArray, q: ComplexArray, mirrored: bool, tolerance_mm: float, needed: int) -> str:
    """Return the cause and the remedy for points that no rigid placement explains."""
    if mirrored:
        return "and they are the part's mirror image: the profile's mirror is the wrong way round"
    for points, what in ((p, ""), (p.conj(), "mirrored and ")):
        scaled = [m for m in _matches(points, q, tolerance_mm, needed, SAME_SCALE)
                  if m.used == min(p.size, q.size)]  # fmt: skip
        if scaled:
            return (
                f"and they are the part's {what}{abs(scaled[0].a):.4f} times as large: the map's pitch is wrong, "
                "or it is another part"
            )
    return (
        f"and fewer than {needed} of them fit, within {tolerance_mm:g} mm: another part, another face, marks that are "
        "covered, or the wrong instrument.fiducials_mm"
    )


# Fiducials in the map itself: dark marks reflect nothing, so they are small compact holes in the data.

SMALLEST_PX = 5
"""Pixels below which a hole is a drop-out."""
LARGEST_MM = 6.0
"""Diameter above which a hole is no mark."""
MOST_ELONGATED = 2.0
"""Longest to shortest axis of a hole that may be a mark; scratches are longer."""
LEAST_FULL = 0.7
"""Least share of its ellipse that a hole fills; dirt has arms."""
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.bool_)


def find_marks(height_nm: FloatArray, pitch_mm: float) -> tuple[Point, ...]:
    """(row, column) px of the centroid of each hole that may be a mark, largest first; open to the outside is none.

    The missing pixels of a mark d pixels wide place its centre within about 0.15 / sqrt(d) pixels, RMS.

    Args:
        height_nm: (ny, nx), NaN = no data.
        pitch_mm: of the map.
    """
    missing = ~np.isfinite(height_nm)
    core = scipy.ndimage.binary_opening(
        missing, CROSS
    )  # without drop-outs; then with the marks' own outermost pixels again
    missing &= scipy.ndimage.binary_dilation(core, CROSS)
    labels, count = scipy.ndimage.label(missing)
    if not count:
        return ()
    area = np.bincount(labels.ravel(), minlength=count + 1)
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    fits = (area >= SMALLEST_PX) & (area <= np.pi / 4 * (LARGEST_MM / pitch_mm) ** 2)
    fits[np.append(edge, 0)] = False
    boxes = scipy.ndimage.find_objects(labels)
    order = sorted(np.flatnonzero(fits), key=lambda label: -area[label])
    found = []
    for label in order:
        box = boxes[label - 1]
        row, column = np.nonzero(labels[box] == label)
        if _compact(row, column):
            found.append((float(row.mean() + box[0].start), float(column.mean() + box[1].start)))
    return tuple(found)


def _compact(row: np.ndarray, column: np.ndarray) -> bool:
    """Return whether a hole is about an ellipse, of moments that its pixels have, and not too long."""
    moments = np.cov(np.stack([row, column]), bias=True) + np.eye(2) / 12  # a pixel is a square
    short, long = np.sqrt(np.linalg.eigvalsh(moments))
    return bool(long <= MOST_ELONGATED * short and row.size >= LEAST_FULL * 4 * np.pi * short * long)


# The part's place by its outline: a circle through the rim of the data, whatever is missing inside or cut off.

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
        MapError: an outline that is no circle, another diameter, or too little of the rim in sight.
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
        raise MapError(
            f"the rim of the map's data is no circle: {held.mean():.0%} of it lies on the best one; only round"
            " outlines are fitted, so register by fiducials, or mask what is not the part"
        )
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
    """MapError unless so many samples of a rim (n,) can place a part."""
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


# The part's place by its outline where that is a polygon: its sides through the rim of the data.

LEAST_KNOWN = 0.005
"""Least share of the rim's samples that move with a shift or turn of the part; with fewer the pose is unknown."""
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
        MapError: another outline, or too little of the rim in sight to say where the part lies.
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
        raise MapError(
            f"the rim of the map's data is not that of {part}: {held.mean():.0%} of it lies on the best fit; "
            "name the right map, mend the part's outline, mask what is not the part, or register by "
            "fiducials"
        )
    found = _fitted(found.x, rim[:, held], part, within)
    guess = found.x
    turn, shift, grown = float(guess[0]) / lever, (float(guess[1]), float(guess[2])), float(guess[3])
    if not abs(2 * grown) <= tolerance_mm:
        raise MapError(
            f"the map's outline is {abs(2 * grown):.3f} mm {'larger' if grown > 0 else 'smaller'} across than "
            f"{part}, {tolerance_mm:g} mm allowed: the pitch is wrong, or it is another part; mend the part's "
            "outline or the pitch"
        )
    known = found.jac[:, :3].T @ found.jac[:, :3] / len(found.jac)
    seen = _visible_share(part, turn, shift, rim[:, held].T, 2 * pitch_mm + abs(grown))
    if seen < LEAST_RIM or np.linalg.eigvalsh(known)[0] < LEAST_KNOWN:
        raise MapError(f"{seen:.0%} of the part's rim is seen, and it does not say where the part lies in all "
                     "directions: centre the part in the frame, or register by fiducials")  # fmt: skip
    residual = float(np.sqrt(np.mean(_gap_mm(guess, rim[:, held], part) ** 2)))
    scale = 1 + 2 * grown / min(part.size_mm)
    return Registration(np.degrees(turn), shift, residual, int(held.sum()), "aperture", scale)


def _fitted(guess: FloatArray, rim: FloatArray, part: Polygon, within_mm: float) -> Any:
    """Fit by scipy with a robust loss: samples of a clamp or a chip have little weight."""
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


def register(
    surface: SurfaceMap, instrument: Instrument | None, part: Outline, last: Registration | None = None
) -> Registration:
    """Where the part lies in a map that has been turned as its profile says.

    Args:
        surface: the map (`process.instrument.as_profiled`).
        instrument: the profile; None: the centre of the array is the part's centre, as without a profile's wish.
        part: its outline, which maps show where the profile gives no other.
        last: the last map's registration of the same part; None: no drift is judged.

    Raises:
        MapError: nothing to register by, or the part lies too far off, too far turned, or has moved too much.
        ConfigError: the profile's fiducials are too few, or symmetric.
    """
    if instrument is None or instrument.register_by == "none":
        return Registration()
    if surface.pitch_mm is None:
        raise MapError("the map has no lateral scale: give the instrument's profile a pitch")
    found = {
        "aperture": lambda: _by_aperture(surface, instrument, part),
        "fiducials": lambda: _by_fiducials(surface, instrument),
        "both": lambda: _by_both(surface, instrument, part),
    }[instrument.register_by]()
    _within_limits(found, instrument)
    if last is not None and last.by != "none":
        drift = found.drift_mm(last)
        if drift > instrument.max_drift_mm:
            raise MapError(f"the part's centre lies {drift:.3f} mm from where the last map had it, "
                         f"{instrument.max_drift_mm:g} mm allowed: it has moved in its fixture, or the "
                         "instrument was set anew; seat the part, measure again, or begin a new job")  # fmt: skip
    return found


def _by_aperture(surface: SurfaceMap, instrument: Instrument, part: Outline) -> Registration:
    height, pitch, tolerance = surface.height_nm, surface.grid.pitch_mm, instrument.aperture_tolerance_mm
    seen = part if instrument.aperture_mm is None else Circle(instrument.aperture_mm / 2)
    if isinstance(seen, Circle):
        return fit_circle(height, pitch, 2 * seen.radius_mm, tolerance)
    return fit_polygon(height, pitch, seen, tolerance)


def _by_fiducials(surface: SurfaceMap, instrument: Instrument) -> Registration:
    """By the marks that the file lists; where it lists too few, by those seen in the map."""
    listed, pitch = surface.fiducials_px, surface.grid.pitch_mm
    found = listed if len(listed) >= MIN_MARKS else find_marks(surface.height_nm, pitch)
    shape = surface.grid.shape
    return fit_marks(found, instrument.fiducials_mm, shape, pitch, instrument.fiducial_tolerance_mm)


def _by_both(surface: SurfaceMap, instrument: Instrument, part: Outline) -> Registration:
    """By the fiducials; the outline must have the centre in the same place."""
    found, seen = _by_fiducials(surface, instrument), _by_aperture(surface, instrument, part)
    apart = found.drift_mm(seen)
    if apart > instrument.fiducial_tolerance_mm:
        raise MapError(f"by its fiducials the part has its {found}, by its outline its {seen}: {apart:.3f} mm apart, "
                     f"{instrument.fiducial_tolerance_mm:g} mm allowed; check instrument.fiducials_mm, and that "
                     "nothing covers the rim")  # fmt: skip
    return replace(found, by="both")


def _within_limits(found: Registration, instrument: Instrument) -> None:
    if abs(found.rotation_deg) > instrument.max_turn_deg:
        raise MapError(
            f"the part is turned by {found.rotation_deg:.2f} deg in the map, {instrument.max_turn_deg:g} deg "
            "allowed: seat it as the fixture has it, or mend the profile's rotation_deg"
        )
    if found.distance_mm > instrument.max_shift_mm:
        x, y = found.shift_mm
        raise MapError(
            f"the part's centre lies at ({x:.3f}, {y:.3f}) mm in the map, {instrument.max_shift_mm:g} mm from "
            "its centre allowed: centre the part before the instrument and measure again"
        )
