"""What the true figure can be, given a map and its errors.

The map is terms of low order and what they leave. Its noise is new: of terms of like order the part's are taken to be
about as large as they were measured, less the noise, or noise would count twice, once in the map and once as its
uncertainty; how large, is itself drawn. The instrument's error is not new. A part that was polished by the same
instrument has it with the other sign, however small the map looks, so that nothing is assumed of the part there: errors
of the instrument's terms, and the priors of those that nothing has seen, are added in squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.poses import LEVEL, terms
from polishd.process.metrics import zernike
from polishd.process.metrics.zernike_terms import values
from polishd.process.trust.errors import MapErrors

GROUPS = (4, 7)
"""Last radial order of the first groups of terms that are taken to be alike; the rest is one more."""
SIZES = 50
"""Draws of how large the part's terms are."""
SMALLEST = 1e-3
"""Of the noise: the least size of a part's terms."""
POWER = (2, 0)


@dataclass(frozen=True)
class FigurePosterior:
    """Of the terms a distribution to draw from; of the rest a share of what was measured, and its noise."""

    seen_nm: FloatArray
    """(k,) of all terms as measured, piston and tilts first."""
    by_source: dict[str, FloatArray]
    """(k, k) nm^2 each: what "noise", "instrument" and "unseen" give to the measured terms."""
    weight: FloatArray
    """(k, k) mean products of terms over the mask: ``c @ weight @ c`` is the mean square of terms c."""
    terms: tuple[tuple[int, int], ...]
    rest_nm: FloatArray
    """(p,) of the samples in the mask: what the terms leave."""
    kept: float
    """Share of the rest's variance that is the part's."""
    rest_square: tuple[float, float]
    """Mean square of the part's rest, and its standard deviation, nm^2."""
    evaluated: FloatArray
    """(k, p) the terms over the mask."""

    def draw(self, samples: int, rng: np.random.Generator) -> FloatArray:
        """(samples, k) true terms, nm."""
        noise = self.by_source["noise"]
        instrument = self.by_source["instrument"] + self.by_source["unseen"]
        each = -(-samples // SIZES)
        found = []
        for _ in range(SIZES):
            mean, covariance = _less_noise(self.seen_nm, noise, self._sizes(rng))
            found.append(rng.multivariate_normal(mean, covariance + instrument, each, method="eigh"))
        return rng.permutation(np.concatenate(found))[:samples]

    def _sizes(self, rng: np.random.Generator) -> FloatArray:
        """(k,) standard deviation of the part's terms, drawn; infinite for piston and tilts."""
        group = np.searchsorted(GROUPS, [n for n, _ in self.terms])
        found = np.full(len(self.terms), np.inf)
        for number in range(len(GROUPS) + 1):
            own = (group == number) & (np.arange(len(self.terms)) >= LEVEL)
            if count := np.count_nonzero(own):
                error = float(np.diag(self.by_source["noise"])[own].mean())
                square = float((self.seen_nm[own] ** 2).sum() / rng.chisquare(count))
                found[own] = np.sqrt(max(square - error, SMALLEST * error))
        return found

    def figure_weight(self, *, power: bool) -> FloatArray:
        """(k, k) of the mean square without piston and tilt, and without power where that is asked, by least squares.

        Those have no weight of their own in it.
        """
        away = [i for i, term in enumerate(self.terms) if i < LEVEL or (power and term == POWER)]
        both = self.weight[:, away]
        return np.asarray(self.weight - both @ np.linalg.solve(self.weight[np.ix_(away, away)], both.T))


def posterior(
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    errors: MapErrors,
    circle_px: tuple[float, float, float] | None = None,
) -> FigurePosterior:
    """The true figure of a measured surface.

    Args:
        height_nm: (ny, nx) less the instrument's known error, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        BadMap: as `zernike.fit`; or errors have terms above their order.
    """
    found = terms(errors.degree)
    stray = (set(errors.terms) | set(errors.unseen_nm)) - set(found)
    if stray:
        raise MapError(
            f"errors are given of terms (n, m) {sorted(stray)}, above order {errors.degree}: raise the order"
        )
    circle = zernike.enclosing(mask) if circle_px is None else circle_px
    fitted = zernike.fit(height_nm, mask, len(found), "ansi", circle_px=circle)
    evaluated = values(found, "rms", *zernike.unit(mask, circle))
    by_source = _by_source(found, errors, fitted.per_noise @ evaluated, mask, pitch_mm)
    weight = evaluated @ evaluated.T / fitted.samples
    noise = errors.noise
    rest_noise = noise.white_nm**2 + noise.correlated_nm**2 - float(np.trace(weight @ by_source["noise"]))
    square = fitted.residual_rms_nm**2
    own = max(square - rest_noise, 0.0)
    pieces = fitted.samples / np.array([1.0, noise.alike(pitch_mm)])
    parts = np.array([noise.white_nm, noise.correlated_nm]) ** 2
    spread = float(np.sqrt(((2 * parts**2 + 4 * own * parts) / pieces).sum()))
    return FigurePosterior(
        seen_nm=fitted.coefficients_nm,
        by_source=by_source,
        weight=weight,
        terms=found,
        rest_nm=height_nm[mask] - fitted.coefficients_nm @ evaluated,
        kept=own / square if square else 0.0,
        rest_square=(own, spread),
        evaluated=evaluated,
    )


def _by_source(
    found: tuple[tuple[int, int], ...], errors: MapErrors, weights: FloatArray, mask: BoolArray, pitch_mm: float
) -> dict[str, FloatArray]:
    at = {term: index for index, term in enumerate(found)}
    instrument, unseen = np.zeros((2, len(found), len(found)))
    own = [at[term] for term in errors.terms]
    instrument[np.ix_(own, own)] = errors.covariance
    for term, prior in errors.unseen_nm.items():
        unseen[at[term], at[term]] = prior**2
    noise = errors.noise.term_covariance(weights, mask, pitch_mm)
    return {"noise": noise, "instrument": instrument, "unseen": unseen}


def _less_noise(seen_nm: FloatArray, noise: FloatArray, size_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k,) mean and (k, k) covariance of terms that are normal about 0, of standard deviations ``size_nm``."""
    root = 1 / np.maximum(size_nm, np.sqrt(np.finfo(float).tiny))
    scaled = noise * root
    gain = np.linalg.solve(np.eye(len(noise)) + root[:, None] * scaled, scaled.T).T * root
    after = noise - gain @ noise
    return seen_nm - gain @ seen_nm, (after + after.T) / 2
