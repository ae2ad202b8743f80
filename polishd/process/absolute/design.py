"""What a set of poses can tell, before anything is measured: the null space of part and instrument together.

A map has the part's terms as its pose moves them, plus the instrument's: ``seen_k = T_k part + instrument``. Piston and
tilt are each map's own and are left out. A change of the instrument that a change of the part hides in every map is
unknown; nothing here knows of equal turns or of symmetry, it follows from the T_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray
from polishd.process.absolute.names import term_name
from polishd.process.absolute.poses import LEVEL, PartPose, moved, terms

MOST_GAIN = 30.0
"""Noise of a direction, in that of one map, beyond which it counts as unknown."""
UNKNOWN_SHARE = 0.01
"""Share of a term that lies in the unknown directions, from which on it is named."""


@dataclass(frozen=True, slots=True)
class UnobservedTerm:
    """A term of the instrument that the poses do not tell."""

    n: int
    m: int
    share: float
    """Of its square that is unknown: 1 all of it, less where only a mixture with other terms is."""

    @property
    def name(self) -> str:
        """In words."""
        return term_name(self.n, self.m)


@dataclass(frozen=True, slots=True)
class Design:
    """Poses, and what they tell."""

    poses: tuple[PartPose, ...]
    degree: int
    radius_mm: float
    """Of the unit circle."""
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
        """Equations more than unknowns that can be found: what tells the noise."""
        count, size, _ = self.moves.shape
        return int(count * size - (2 * size - self.null.shape[1]))


def design(poses: Sequence[PartPose], degree: int, radius_mm: float) -> Design:
    """What poses tell of terms up to a radial order over a circle.

    Raises:
        BadMap: fewer than two poses, or all alike, if by a whole turn or by next to nothing.
        ValueError: an order below 2.
    """
    if degree < 2:
        raise ValueError(f"terms up to order {degree}: the lowest above tilt is 2")
    moves = np.stack([moved(degree, pose, radius_mm)[LEVEL:, LEVEL:] for pose in poses])
    size = moves.shape[1]
    null = null_space(sum((information(move) for move in moves), np.zeros((2 * size, 2 * size))))
    own, strength, _ = np.linalg.svd(null[size:], full_matrices=False)
    hidden = own[:, strength > 1 / MOST_GAIN]
    if hidden.shape[1] == size:
        raise MapError("the part lies alike in all maps, which tells nothing of the instrument: turn it between them, "
                     "by 90 deg say")  # fmt: skip
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
    """(2 j, 2 j) what one map adds to the normal matrix of part and instrument, for noise of 1 a term."""
    whole = np.hstack([move, np.eye(len(move))])
    return whole.T @ whole


def null_space(normal: FloatArray) -> FloatArray:
    """(2 j, q) orthonormal directions of which the noise is more than ``MOST_GAIN`` times one map's.

    A direction holds part and instrument in about equal shares: half of its variance is the instrument's.
    """
    value, vector = np.linalg.eigh(normal)
    return np.asarray(vector[:, value < 0.5 / MOST_GAIN**2])
