"""Pose of the part in each map, and its effect on the Zernike terms.

A pose is a turn about the axis, then a lateral shift: the part's point p is seen at ``R(angle) p + shift``. Angles are
counter-clockwise as the map is displayed (row 0 at the top, x right, y up).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray
from polishd.process.metrology.zernike import order, values

LEVEL = 3
"""Number of piston and tilt terms, which differ from map to map and carry no information."""


@dataclass(frozen=True, slots=True)
class PartPose:
    """Pose of the part in one map."""

    angle_deg: float
    """Counter-clockwise as displayed."""
    x_mm: float = 0.0
    """By which the part lies further to the right ..."""
    y_mm: float = 0.0
    """... and up, after the turn."""

    def __str__(self) -> str:
        shift = f", shifted {self.x_mm:g},{self.y_mm:g} mm" if self.x_mm or self.y_mm else ""
        return f"{self.angle_deg:g} deg{shift}"

    def on_part(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates on the part of points in the map, all from the axis."""
        turn = np.radians(self.angle_deg)
        x, y = x_mm - self.x_mm, y_mm - self.y_mm
        return np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x

    def in_map(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The inverse: where points of the part are seen."""
        turn = np.radians(self.angle_deg)
        x, y = np.cos(turn) * x_mm - np.sin(turn) * y_mm, np.sin(turn) * x_mm + np.cos(turn) * y_mm
        return x + self.x_mm, y + self.y_mm


def terms(degree: int) -> tuple[tuple[int, int], ...]:
    """(n, m) of all Zernike terms up to this radial order, piston and tilts first."""
    return order("ansi", (degree + 1) * (degree + 2) // 2)


def pose_matrix(degree: int, pose: PartPose, radius_mm: float) -> FloatArray:
    """Return the (k, k) matrix of a pose: ``seen = matrix @ part``, both of RMS norm over the unit circle.

    Exact: a polynomial that is turned and shifted is one of the same degree. Solved on a lattice of points.
    """
    x, y, inverse = _lattice(degree)
    there = (along / radius_mm for along in pose.on_part(x * radius_mm, y * radius_mm))
    return np.asarray(inverse @ values(terms(degree), "rms", *there).T)


@cache
def _lattice(degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(p,) x and y of points in the unit circle, and the (k, p) pseudo-inverse of the terms there."""
    radius = np.sqrt((np.arange(degree + 2) + 0.5) / (degree + 2))[:, None]
    angle = 2 * np.pi * np.arange(2 * degree + 3)[None, :] / (2 * degree + 3)
    x: FloatArray = (radius * np.cos(angle)).ravel()
    y: FloatArray = (radius * np.sin(angle)).ravel()
    return x, y, np.asarray(np.linalg.pinv(values(terms(degree), "rms", x, y).T), dtype=np.float64)


# Names of Zernike terms, and the measurement that determines a term which no pose does.

FOLDS = {2: "astigmatism", 3: "trefoil", 4: "tetrafoil", 5: "pentafoil", 6: "hexafoil"}
RANKS = ("", "secondary ", "tertiary ")
RADIUS = "a reference of known radius or a flat of known power"
OTHER_FOLDS = "more angles that share no fold, and a lateral shift"
ROUND = "a lateral shift of the part, or a reference"


def family_name(n: int, m: int) -> str:
    """The family's name of a term, without its direction: astigmatism for (2, 2) and (2, -2)."""
    fold = abs(m)
    if (n, fold) == (2, 0):
        return "power"
    first = 4 if fold == 0 else 3 if fold == 1 else fold
    rank = (n - first) // 2
    family = {0: "spherical", 1: "coma"}.get(fold) or FOLDS.get(fold, f"{fold}-foil")
    return f"{RANKS[rank]}{family}" if rank < len(RANKS) else f"{family} of order {n}"


def term_name(n: int, m: int) -> str:
    """A single term: its family, and cos or sin where it has a direction."""
    return family_name(n, m) + (" cos" if m > 0 else " sin" if m < 0 else "")


def family_names(pairs: Iterable[tuple[int, int]]) -> list[str]:
    """Names of terms, each family once, lowest order first."""
    ordered = sorted({(n, abs(m)) for n, m in pairs}, key=lambda pair: (pair[0] + pair[1], pair[1]))
    return list(dict.fromkeys(family_name(n, m) for n, m in ordered))


def reference_for(n: int, m: int, angles_deg: Iterable[float] = ()) -> str:
    """Return what determines a term that the poses do not: a reference for power, a shift for m = 0, else an angle."""
    if (n, m) == (2, 0):
        return RADIUS
    if m == 0:
        return ROUND
    used = ", ".join(f"{angle:g}" for angle in angles_deg)
    turn = 180 / abs(m)
    return f"one more angle, {turn:g} deg from one of {used or 'those measured'}"


# The terms that a set of poses determines, before any measurement: the null space of part and instrument together.

MOST_GAIN = 30.0
"""Noise of a direction, in that of one map, beyond which it counts as unknown."""
UNKNOWN_SHARE = 0.01
"""Share of a term that lies in the unknown directions, from which on it is named."""


@dataclass(frozen=True, slots=True)
class UnobservedTerm:
    """A term of the instrument that the poses do not determine."""

    n: int
    m: int
    share: float
    """Undetermined share of its square: 1 all of it, less where only a mixture with other terms is."""

    @property
    def name(self) -> str:
        """Name of the term in optics."""
        return term_name(self.n, self.m)


@dataclass(frozen=True, slots=True)
class Design:
    """Poses, and the terms that they determine."""

    poses: tuple[PartPose, ...]
    degree: int
    radius_mm: float
    """Radius of the unit circle."""
    terms: tuple[tuple[int, int], ...]
    """(n, m) of the j terms above tilt; RMS norm, m > 0 cosine, angles from x towards y."""
    moves: FloatArray
    """(maps, j, j) the T_k."""
    null: FloatArray
    """(2 j, q) orthonormal: changes of part and instrument that no map shows."""
    hidden: FloatArray
    """(j, r) orthonormal: changes of the instrument among them."""

    @property
    def unknown(self) -> tuple[UnobservedTerm, ...]:
        """The instrument's terms that are unknown, in whole or in part."""
        share = (self.hidden**2).sum(axis=1)
        return tuple(
            UnobservedTerm(n, m, min(float(part), 1.0))
            for (n, m), part in zip(self.terms, share, strict=True)
            if part > UNKNOWN_SHARE
        )

    @property
    def freedom(self) -> int:
        """Number of equations less the determined unknowns: the degrees of freedom of the noise."""
        count, size, _ = self.moves.shape
        return int(count * size - (2 * size - self.null.shape[1]))


def design_poses(poses: Sequence[PartPose], degree: int, radius_mm: float) -> Design:
    """Return which terms up to a radial order over a circle the poses determine.

    Raises:
        MapError: fewer than two poses, or poses that are all alike or nearly so.
        ValueError: an order below 2.
    """
    if degree < 2:
        raise ValueError(f"terms up to order {degree}: the lowest above tilt is 2")
    moves = np.stack([pose_matrix(degree, pose, radius_mm)[LEVEL:, LEVEL:] for pose in poses])
    size = moves.shape[1]
    null = null_space(sum((information(move) for move in moves), np.zeros((2 * size, 2 * size))))
    own, strength, _ = np.linalg.svd(null[size:], full_matrices=False)
    hidden = own[:, strength > 1 / MOST_GAIN]
    if hidden.shape[1] == size:
        raise MapError("the part lies alike in all maps, so they do not show the instrument's error. Turn it between "
                     "maps, by 90 deg for example")  # fmt: skip
    return Design(
        poses=tuple(poses),
        degree=degree,
        radius_mm=radius_mm,
        terms=terms(degree)[LEVEL:],
        moves=moves,
        null=null,
        hidden=hidden,
    )


def information(move: FloatArray) -> FloatArray:
    """(2 j, 2 j) information of one map in the normal matrix of part and instrument, for noise of 1 a term."""
    whole = np.hstack([move, np.eye(len(move))])
    return whole.T @ whole


def null_space(normal: FloatArray) -> FloatArray:
    """(2 j, q) orthonormal directions of which the noise is more than ``MOST_GAIN`` times one map's.

    A direction holds part and instrument in about equal shares: half of its variance is the instrument's.
    """
    value, vector = np.linalg.eigh(normal)
    return np.asarray(vector[:, value < 0.5 / MOST_GAIN**2])


# Poses to measure next: the fewest that reach the wanted errors of the instrument's terms.

KEPT = 12
"""Beam width: the best sets of poses of each size that the search keeps."""
PRIOR_SIGMA = 1e6
"""Prior of a term over the noise of one map; an undetermined term keeps it."""

Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """Poses that the cell can take, and the noise of its maps."""

    candidates: tuple[PartPose, ...]
    """Candidate poses: angles of the rotary port, shifts of the stage."""
    radius_mm: float
    """Radius of the aperture."""
    noise_nm: float
    """Noise of one map, in a term of RMS norm."""
    most: int = 6
    """Maps more, at most."""


@dataclass(frozen=True, slots=True)
class NextPoses:
    """Poses to measure next, and the errors after them."""

    poses: tuple[PartPose, ...]
    """In order; empty where no further pose helps."""
    sigma_nm: Mapping[Term, float | None]
    """Of each wanted term after these poses; None: it stays undetermined."""
    met: bool
    """Each wanted term that a pose can determine is as certain as wanted."""
    demanded: Mapping[Term, str]
    """Wanted terms that no candidate pose determines, and what determines them."""

    @property
    def words(self) -> str:
        """Text for the log and for the operator who turns the part."""
        poses = "; ".join(map(str, self.poses)) or "no further pose"
        return ". ".join([poses, *(f"{term_name(*term)} needs {what}" for term, what in self.demanded.items())])


def next_poses(wanted_nm: Mapping[Term, float], have: Sequence[PartPose], options: PoseOptions) -> NextPoses:
    """Find the least number of further poses by a beam search over pose sets.

    Args:
        wanted_nm: (n, m) of the instrument's terms above tilt, and the standard deviation wanted of each, nm RMS.
        have: poses that were measured; none at first.
        options: candidate poses and noise.

    Raises:
        ValueError: no term is wanted, a term is not above tilt, or there are no candidates.
    """
    degree = max((n for n, _ in wanted_nm), default=0) + 2
    above = terms(degree)[LEVEL:]
    if not wanted_nm or not options.candidates or not set(wanted_nm) <= set(above):
        raise ValueError("wanted_nm needs terms (n, m) above tilt, and options needs one candidate pose or more")
    search = _Search(wanted_nm, above, options, degree)
    start = search.information(have)
    everything = start + search.information(options.candidates)
    hidden = search.hidden(everything)
    reachable = [term for term in wanted_nm if term not in hidden]
    best = search.best(start, reachable)
    after = start + search.information(best)
    sigma, hidden_after = search.sigma_nm(after), search.hidden(after)
    angles = [pose.angle_deg for pose in (*have, *options.candidates)]
    return NextPoses(
        poses=best,
        sigma_nm={term: None if term in hidden_after else sigma[term] for term in wanted_nm},
        met=all(sigma[term] <= wanted_nm[term] for term in reachable),
        demanded={term: reference_for(*term, angles) for term in wanted_nm if term in hidden},
    )


@dataclass(frozen=True)
class _Search:
    wanted_nm: Mapping[Term, float]
    terms: Sequence[Term]
    options: PoseOptions
    degree: int

    def information(self, poses: Sequence[PartPose]) -> FloatArray:
        """(2 j, 2 j) Fisher information of maps at these poses for noise of 1."""
        size = 2 * len(self.terms)
        return sum((self._information(pose) for pose in poses), np.zeros((size, size)))

    def _information(self, pose: PartPose) -> FloatArray:
        return information(pose_matrix(self.degree, pose, self.options.radius_mm)[LEVEL:, LEVEL:])

    def sigma_nm(self, normal: FloatArray) -> dict[Term, float]:
        """Return the standard deviation of each wanted term of the instrument."""
        size = len(self.terms)
        variance = np.diag(np.linalg.inv(normal + np.eye(2 * size) / PRIOR_SIGMA**2))[size:]
        at = {term: index for index, term in enumerate(self.terms)}
        return {term: self.options.noise_nm * float(np.sqrt(variance[at[term]])) for term in self.wanted_nm}

    def hidden(self, normal: FloatArray) -> set[Term]:
        """Wanted terms that lie in the null space by more than a tenth."""
        share = (null_space(normal)[len(self.terms) :] ** 2).sum(axis=1) * 2  # half of a direction is the part's
        return {term for term, part in zip(self.terms, share, strict=True) if part > 0.1 and term in self.wanted_nm}

    def best(self, start: FloatArray, reachable: Sequence[Term]) -> tuple[PartPose, ...]:
        """Return the smallest set that meets all reachable terms, else the best of the largest size."""

        def missing(normal: FloatArray) -> tuple[float, float]:
            """Return the distance from the wanted errors; ties go to the set with the smaller errors."""
            sigma = self.sigma_nm(normal)
            over = [float(np.log(sigma[term] / self.wanted_nm[term])) for term in reachable]
            return sum(max(0.0, one) for one in over), sum(over)

        adds = [(index, self._information(pose)) for index, pose in enumerate(self.options.candidates)]
        kept: list[tuple[tuple[float, float], tuple[int, ...], FloatArray]] = [(missing(start), (), start)]
        best = kept[0]
        for _ in range(self.options.most):
            if best[0][0] <= 0:
                break
            grown = {tuple(sorted((*chosen, index))): normal + add for _, chosen, normal in kept for index, add in adds}
            scored = [(missing(normal), chosen, normal) for chosen, normal in grown.items()]
            kept = sorted(scored, key=lambda one: one[:2])[:KEPT]
            best = kept[0]
        return tuple(self.options.candidates[index] for index in best[1])
