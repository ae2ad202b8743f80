"""Which poses to measure next: the fewest that make wanted terms of the instrument as sure as they are wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.metrology.absolute_poses import (
    LEVEL,
    PartPose,
    information,
    null_space,
    pose_matrix,
    reference_for,
    term_name,
    terms,
)

KEPT = 12
"""Sets of poses that are followed further, the best of each size."""
UNTOLD = 1e6
"""Prior of a term, in the noise of one map's: what no pose tells stays as uncertain as this."""

Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """What the cell can do."""

    candidates: tuple[PartPose, ...]
    """Poses that can be had: angles of the rotary port, shifts of the stage."""
    radius_mm: float
    """Of the aperture."""
    noise_nm: float
    """Of one map, in a term of RMS norm."""
    most: int = 6
    """Maps more, at most."""


@dataclass(frozen=True, slots=True)
class NextPoses:
    """What to measure, and what comes of it."""

    poses: tuple[PartPose, ...]
    """In order; none where all that a pose can tell is told already."""
    sigma_nm: Mapping[Term, float | None]
    """Of each wanted term after them; None: it stays unknown."""
    met: bool
    """Each wanted term that a pose can tell is as sure as wanted."""
    demanded: Mapping[Term, str]
    """Wanted terms that no pose which can be had tells, and what would."""

    @property
    def words(self) -> str:
        """For the log, or for a person who turns the part."""
        asked = "; ".join(map(str, self.poses)) or "no further pose"
        return ". ".join([asked, *(f"{term_name(*term)} needs {what}" for term, what in self.demanded.items())])


def next_poses(wanted_nm: Mapping[Term, float], have: Sequence[PartPose], options: PoseOptions) -> NextPoses:
    """The least number of further poses, by a search that keeps the best sets of each size.

    Args:
        wanted_nm: (n, m) of the instrument's terms above tilt, and how sure each is to be, one standard deviation, nm
            RMS.
        have: poses that were measured; none at first.
        options: what can be had.

    Raises:
        ValueError: nothing is wanted, a term is none above tilt, or there are no candidates.
    """
    degree = max((n for n, _ in wanted_nm), default=0) + 2
    above = terms(degree)[LEVEL:]
    if not wanted_nm or not options.candidates or not set(wanted_nm) <= set(above):
        raise ValueError("wanted are terms (n, m) above tilt, and candidates are one pose or more")
    search = _Search(wanted_nm, above, options, degree)
    start = search.told(have)
    everything = start + search.told(options.candidates)
    hidden = search.hidden(everything)
    reachable = [term for term in wanted_nm if term not in hidden]
    best = search.best(start, reachable)
    sigma = search.sigma_nm(start + search.told(best))
    untold = search.hidden(start + search.told(best))
    angles = [pose.angle_deg for pose in (*have, *options.candidates)]
    return NextPoses(
        poses=best,
        sigma_nm={term: None if term in untold else sigma[term] for term in wanted_nm},
        met=all(sigma[term] <= wanted_nm[term] for term in reachable),
        demanded={term: reference_for(*term, angles) for term in wanted_nm if term in hidden},
    )


@dataclass(frozen=True)
class _Search:
    wanted_nm: Mapping[Term, float]
    terms: Sequence[Term]
    options: PoseOptions
    degree: int

    def told(self, poses: Sequence[PartPose]) -> FloatArray:
        """(2 j, 2 j) what maps at these poses tell, for noise of 1."""
        size = 2 * len(self.terms)
        return sum((self._information(pose) for pose in poses), np.zeros((size, size)))

    def _information(self, pose: PartPose) -> FloatArray:
        return information(pose_matrix(self.degree, pose, self.options.radius_mm)[LEVEL:, LEVEL:])

    def sigma_nm(self, told: FloatArray) -> dict[Term, float]:
        """Of each wanted term of the instrument."""
        size = len(self.terms)
        variance = np.diag(np.linalg.inv(told + np.eye(2 * size) / UNTOLD**2))[size:]
        at = {term: index for index, term in enumerate(self.terms)}
        return {term: self.options.noise_nm * float(np.sqrt(variance[at[term]])) for term in self.wanted_nm}

    def hidden(self, told: FloatArray) -> set[Term]:
        """Wanted terms that lie in the null space by more than a tenth."""
        share = (null_space(told)[len(self.terms) :] ** 2).sum(axis=1) * 2  # half of a direction is the part's
        return {term for term, part in zip(self.terms, share, strict=True) if part > 0.1 and term in self.wanted_nm}

    def best(self, start: FloatArray, reachable: Sequence[Term]) -> tuple[PartPose, ...]:
        """The smallest set by which all that is reachable is met; else the best of the largest size."""

        def missing(told: FloatArray) -> tuple[float, float]:
            """How far from what is wanted, and of sets alike in that the surest first."""
            sigma = self.sigma_nm(told)
            over = [float(np.log(sigma[term] / self.wanted_nm[term])) for term in reachable]
            return sum(max(0.0, one) for one in over), sum(over)

        adds = [(index, self._information(pose)) for index, pose in enumerate(self.options.candidates)]
        kept: list[tuple[tuple[float, float], tuple[int, ...], FloatArray]] = [(missing(start), (), start)]
        best = kept[0]
        for _ in range(self.options.most):
            if best[0][0] <= 0:
                break
            grown = {tuple(sorted((*chosen, index))): told + add for _, chosen, told in kept for index, add in adds}
            scored = [(missing(told), chosen, told) for chosen, told in grown.items()]
            kept = sorted(scored, key=lambda one: one[:2])[:KEPT]
            best = kept[0]
        return tuple(self.options.candidates[index] for index in best[1])
