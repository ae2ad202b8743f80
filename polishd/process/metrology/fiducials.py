"""The part's place by its marks: a rigid fit of found to nominal points, whatever their order, missing or spurious.

Points are complex numbers, x + iy, in mm. A rigid placement is ``q = a p + b`` with ``|a| = 1``; a mirrored one takes
the conjugate of ``p``, one at another scale ``|a| != 1``. Every pair of nominal points is tried on every pair of found
ones, so nothing is left to luck. What agrees is accepted only if chance would not: the expected number of agreements
as good among points strewn at random (a-contrario; A. Desolneux, L. Moisan, J.-M. Morel, IJCV 40, 2000) must be small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import ceil, comb, perm

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import FloatArray
from polishd.process.metrology.resampling import Point, Registration

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
        BadMap: too few marks fit, more than one placement fits, or the marks are those of a mirrored or scaled part.
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
    """What is wrong with points that no rigid placement explains, in words that say what to do."""
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
"""Least share of its own ellipse that a hole fills: dirt has arms."""
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
    """Whether a hole is about an ellipse, of moments that its pixels have, and not too long."""
    moments = np.cov(np.stack([row, column]), bias=True) + np.eye(2) / 12  # a pixel is a square of its own
    short, long = np.sqrt(np.linalg.eigvalsh(moments))
    return bool(long <= MOST_ELONGATED * short and row.size >= LEAST_FULL * 4 * np.pi * short * long)
