"""Nested models compared by their evidence, and what each extension is worth to the next pass.

Each extension is a hypothesis: its parameters are 0, or normal about 0 with their first prior. For a normal posterior
the evidence of every model without some of them follows from the one fit of all: the posterior's density at 0 over the
prior's (J. M. Dickey, Ann. Math. Stat. 42, 204, 1971). So all 2^m of them are looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.identification.parameters import Parameter

PRICE = float(np.log(20.0))
"""Logarithm of the odds against each extension before anything was measured."""
RIVAL = float(np.log(20.0))
"""Models whose odds are not worse than the best one's by more than this are rivals of it."""


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A model with some of the extensions."""

    extensions: frozenset[str]
    log_odds: float
    """Against the model with all of them, natural logarithm."""


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """What evidence says of the extensions."""

    best: CandidateModel
    rivals: tuple[CandidateModel, ...]
    """Others that the map cannot exclude, the likeliest first."""
    probability: Mapping[str, float]
    """Of each extension, over all models."""


def compare(parameters: Sequence[Parameter], theta: FloatArray, covariance: FloatArray) -> ModelComparison:
    """The models with and without each extension, from the posterior of all parameters.

    Args:
        parameters: k of them.
        theta: (k,) posterior mean.
        covariance: (k, k) of the posterior.
    """
    names = extensions(parameters)
    found = []
    for taken in product((True, False), repeat=len(names)):
        inside = frozenset(name for name, is_in in zip(names, taken, strict=True) if is_in)
        out = without(parameters, inside)
        odds = _density_at_zero(parameters, theta, covariance, out) + PRICE * (len(names) - len(inside))
        found.append(CandidateModel(inside, odds))
    found.sort(key=lambda one: -one.log_odds)
    best = found[0]
    share = np.exp([one.log_odds - best.log_odds for one in found])
    probability = {name: float(share[[name in one.extensions for one in found]].sum() / share.sum()) for name in names}
    rivals = tuple(one for one in found[1:] if one.log_odds > best.log_odds - RIVAL)
    return ModelComparison(best, rivals, probability)


def extensions(parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """Their names, each once, in order."""
    return tuple(dict.fromkeys(p.extension for p in parameters if p.extension is not None))


def without(parameters: Sequence[Parameter], taken: frozenset[str]) -> list[int]:
    """Indices of the parameters that a model with these extensions leaves at 0."""
    return [k for k, p in enumerate(parameters) if p.extension is not None and p.extension not in taken]


def conditioned(theta: FloatArray, covariance: FloatArray, out: list[int]) -> tuple[FloatArray, FloatArray]:
    """(k,) mean and (k, k) covariance where the parameters ``out`` are known to be 0."""
    if not out:
        return theta, covariance
    gain = np.linalg.solve(covariance[np.ix_(out, out)], covariance[out, :]).T
    mean, rest = theta - gain @ theta[out], covariance - gain @ covariance[out, :]
    mean[out], rest[out, :], rest[:, out] = 0.0, 0.0, 0.0
    return mean, rest


def detection_limits(parameters: Sequence[Parameter], covariance: FloatArray) -> dict[str, float]:
    """By parameter of an extension: the size at which evidence is even, were it the only thing wrong."""
    found = {}
    for name in extensions(parameters):
        _, alone = conditioned(np.zeros(len(parameters)), covariance, without(parameters, frozenset({name})))
        own = [k for k, p in enumerate(parameters) if p.extension == name]
        prior = 2 * sum(np.log(parameters[k].sigma) for k in own)
        occam = (prior - np.linalg.slogdet(alone[np.ix_(own, own)])[1]) / 2
        for k in own:
            # seen by itself, the others of its extension free to follow: the marginal error is what it must exceed
            found[parameters[k].name] = float(np.sqrt(2 * max(occam + PRICE, 0.0) * alone[k, k]))
    return found


def worth(
    parameters: Sequence[Parameter], theta: FloatArray, covariance: FloatArray, next_columns: FloatArray, name: str
) -> float:
    """What an extension takes off the next pass's residual, mean square in nm^2: its gain less its cost in noise.

    Left out it leaves ``|J theta|^2``, taken in with its error ``tr(J C J')``; the first is known by its estimate,
    which is too large by that error. So it pays where ``|J theta|^2 > 2 tr(J C J')`` (C. L. Mallows, Technometrics 15,
    661, 1973).

    Args:
        parameters: k of them.
        theta: (k,) of the model that holds it.
        covariance: (k, k) likewise.
        next_columns: (N, k) what each parameter does to the next pass, without piston and tilt.
        name: of the extension.
    """
    own = [k for k, p in enumerate(parameters) if p.extension == name]
    columns = next_columns[:, own]
    gram = columns.T @ columns / len(columns)
    return float(theta[own] @ gram @ theta[own] - 2 * np.trace(gram @ covariance[np.ix_(own, own)]))


def _density_at_zero(
    parameters: Sequence[Parameter], theta: FloatArray, covariance: FloatArray, out: list[int]
) -> float:
    """Log of the posterior's density over the first prior's, of the parameters ``out`` all at 0."""
    if not out:
        return 0.0
    own = covariance[np.ix_(out, out)]
    off = theta[out] @ np.linalg.solve(own, theta[out])
    prior = 2 * sum(np.log(parameters[k].sigma) for k in out)
    return float((prior - np.linalg.slogdet(own)[1] - off) / 2)
