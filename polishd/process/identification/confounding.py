"""What a pass cannot tell apart: said parameter by parameter, from the posterior against what was known before.

A parameter is *undecided* where the pass took less than half off its standard error: it told less than one bit. It is
*confounded* where knowing some others would take half off that, or, of one that is decided, nine tenths: a whole digit
that is theirs. Those, the fewest that do it, are what it is confounded with. Undecided and not confounded: the pass
does not show it. The rules ask for ratios of errors only, so that they do not depend on units; what is undecided
depends on the prior, as what is worth knowing does.

A digit, because mean rate and piston share some error in every pass: removal of which a fifth is figure leaves a factor
of five between them, and that is no reason to doubt a rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.identification.parameters import Parameter

HALF = 0.5
DIGIT = 0.1


@dataclass(frozen=True, slots=True)
class Confounding:
    """How much a pass told of a parameter."""

    retained: float
    """Standard error after over before the pass."""
    decided: bool
    """Whether the pass took half off its error, or more."""
    confounded_with: tuple[str, ...]
    """Others without which it, or which without it, cannot be known."""


def confounding_of(parameters: tuple[Parameter, ...], before: FloatArray, after: FloatArray) -> dict[str, Confounding]:
    """By name, how much was told of each parameter.

    Args:
        parameters: k of them.
        before: (k, k) covariance before the pass.
        after: (k, k) after it.
    """
    retained = np.sqrt(np.diag(after) / np.diag(before))
    partners: list[set[int]] = [set() for _ in parameters]
    for k, share in enumerate(np.where(retained > HALF, HALF, DIGIT)):
        for other in _fewest(after, k, float(share)):
            partners[k].add(other)
            partners[other].add(k)
    return {
        p.name: Confounding(float(r), bool(r <= HALF), tuple(parameters[j].name for j in sorted(others)))
        for p, r, others in zip(parameters, retained, partners, strict=True)
    }


def _fewest(covariance: FloatArray, k: int, share: float) -> list[int]:
    """The others that, if known, would leave a share of the error of parameter k: greedily in, what is idle out."""
    enough = share**2 * covariance[k, k]
    rest = [j for j in range(len(covariance)) if j != k]
    if _left(covariance, k, rest) > enough:
        return []
    taken: list[int] = []
    while _left(covariance, k, taken) > enough:
        taken.append(min((j for j in rest if j not in taken), key=lambda j: _left(covariance, k, [*taken, j])))
    for j in taken[:-1]:
        fewer = [i for i in taken if i != j]
        if _left(covariance, k, fewer) <= enough:
            taken = fewer
    return taken


def _left(covariance: FloatArray, k: int, known: list[int]) -> float:
    """Variance of parameter k where others are known."""
    if not known:
        return float(covariance[k, k])
    across = covariance[known, k]
    scale = np.sqrt(np.diag(covariance)[known])  # units far apart cost no digits
    own = covariance[np.ix_(known, known)] / np.outer(scale, scale)
    return float(covariance[k, k] - (across / scale) @ np.linalg.solve(own, across / scale))
