"""Bounds of the figures of the true surface, from a measured map and the known errors of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrology import zernike
from polishd.process.metrology.absolute_poses import LEVEL, OTHER_FOLDS, family_name, reference_for, terms
from polishd.process.metrology.absolute_test import AbsoluteTestResult
from polishd.process.metrology.zernike import values

# Errors of a measured map: noise, the determined terms of the instrument, and its unknown terms.

REACH = 4.0
"""Correlation lengths to which a kernel is computed: e^-8 is left."""
Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class MapNoise:
    """Noise of a map: a white part and an independent part that is correlated between neighbors, as of air."""

    white_nm: float
    """Standard deviation of a sample."""
    correlated_nm: float = 0.0
    """Likewise."""
    length_mm: float = 0.0
    """L of the correlation exp(-d^2 / 2 L^2) of samples at a distance d."""

    def alike(self, pitch_mm: float) -> float:
        """Return the correlation area in samples: the sum of squares of the correlation, at least 1."""
        return max(1.0, float(np.pi * (self.length_mm / pitch_mm) ** 2))

    def term_covariance(self, weights: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
        """Return the covariance (k, k), nm^2, of weighted sums of the noise.

        Args:
            weights: (k, p) of each sum, of the p samples in ``mask``.
            mask: (ny, nx)
            pitch_mm: distance of samples.
        """
        found = self.white_nm**2 * weights @ weights.T
        if self.correlated_nm and self.length_mm:
            spread = np.zeros(mask.shape)
            near = np.empty_like(weights)
            for index, own in enumerate(weights):
                spread[mask] = own
                near[index] = _along_both(spread, _kernel(self.length_mm / pitch_mm))[mask]
            found = found + self.correlated_nm**2 * (near @ weights.T)
        return np.asarray((found + found.T) / 2)

    def draw(self, shape: tuple[int, ...], pitch_mm: float, rng: np.random.Generator) -> FloatArray:
        """Draw (ny, nx) nm of this noise."""
        found = rng.normal(0.0, self.white_nm, shape) if self.white_nm else np.zeros(shape)
        if self.correlated_nm and self.length_mm:
            kernel = _kernel(self.length_mm / pitch_mm / np.sqrt(2))
            kernel /= np.linalg.norm(kernel)
            edge = len(kernel) // 2
            whole = _along_both(rng.normal(0.0, self.correlated_nm, tuple(n + 2 * edge for n in shape)), kernel)
            found = found + whole[edge : edge + shape[0], edge : edge + shape[1]]
        return found


@dataclass(frozen=True, slots=True)
class MapErrors:
    """Errors of a map after the instrument's known error was subtracted."""

    noise: MapNoise
    degree: int = 10
    """Radial order up to which terms are treated one by one."""
    terms: tuple[Term, ...] = ()
    """(n, m) of the instrument's terms: RMS norm, angles from x towards y."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(j, j) nm^2 of them, as far as they were measured."""
    unseen_nm: Mapping[Term, float] = field(default_factory=dict)
    """Prior of the undetermined terms: one standard deviation each about 0, nm RMS."""
    unseen_rest_nm: float = 0.0
    """Prior RMS of the instrument's undetermined error above the terms."""


def errors_from_system_map(
    result: AbsoluteTestResult, noise: MapNoise, unseen_nm: Mapping[Term, float], unseen_rest_nm: float | None = None
) -> MapErrors:
    """Return the errors of a map less the instrument's map from an absolute test.

    Args:
        result: errors of the instrument's map.
        noise: of the map to be judged, not of the maps of the test.
        unseen_nm: priors of the instrument's terms; those that the test determined are not used.
        unseen_rest_nm: prior RMS of its undetermined shorter waves; None: as the test estimates it.
    """
    unseen = {
        term: prior * float(np.sqrt(result.unknown[term]))
        for term, prior in unseen_nm.items()
        if term in result.unknown
    }
    rest = result.rest_nm if unseen_rest_nm is None else unseen_rest_nm
    return MapErrors(noise, result.degree, result.terms, result.covariance, unseen, rest)


def _kernel(length_px: float) -> FloatArray:
    far = int(np.ceil(REACH * length_px))
    return np.asarray(np.exp(-0.5 * (np.arange(-far, far + 1) / length_px) ** 2))


def _along_both(height: FloatArray, kernel: FloatArray) -> FloatArray:
    for axis in (0, 1):
        height = scipy.ndimage.correlate1d(height, kernel, axis=axis, mode="constant")
    return height


# Posterior of the true figure, given a map and its errors.

GROUPS = (4, 7)
"""Last radial order of the first groups of terms with one common size; the others are one more group."""
SIZES = 50
"""Draws of the size of the part's terms."""
SMALLEST = 1e-3
"""Least size of a part's terms over the noise."""
POWER = (2, 0)


@dataclass(frozen=True)
class FigurePosterior:
    """Distribution of the true figure's terms; of its remainder, the share of the measured one and its noise."""

    seen_nm: FloatArray
    """(k,) of all terms as measured, piston and tilts first."""
    by_source: dict[str, FloatArray]
    """(k, k) nm^2 each: covariance of the measured terms from "noise", "instrument" and "unseen"."""
    weight: FloatArray
    """(k, k) mean products of terms over the mask: ``c @ weight @ c`` is the mean square of terms c."""
    terms: tuple[tuple[int, int], ...]
    rest_nm: FloatArray
    """(p,) remainder above the terms, of the samples in the mask."""
    kept: float
    """Share of the remainder's variance that is the part's."""
    rest_square: tuple[float, float]
    """Mean square of the part's remainder and its standard deviation, nm^2."""
    evaluated: FloatArray
    """(k, p) the terms over the mask."""

    def draw(self, samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw (samples, k) true terms, nm."""
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
        """Return (k, k) weights of the mean square after a fit of piston, tilt and, as option, power is removed."""
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
    """Return the posterior of the true figure of a measured surface.

    Args:
        height_nm: (ny, nx) less the instrument's known error, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        MapError: as `zernike.fit`, or errors have terms above their order.
    """
    found = terms(errors.degree)
    stray = (set(errors.terms) | set(errors.unseen_nm)) - set(found)
    if stray:
        raise MapError(f"the errors hold terms (n, m) {sorted(stray)} above order {errors.degree}. Raise the order")
    circle = zernike.enclosing_circle(mask) if circle_px is None else circle_px
    fitted = zernike.fit(height_nm, mask, len(found), "ansi", circle_px=circle)
    evaluated = values(found, "rms", *zernike.unit_coordinates(mask, circle))
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


# The one-sided 95 % bound of a true RMS or any other figure, and its largest contributions.

BOUND = 0.95
SAMPLES, MAP_SAMPLES = 4000, 300
SHORTER = "shorter waves"
"""Name of the waves above the order of the terms."""
LEAST_NM = 1e-3
"""Contributions below it are left out."""


@dataclass(frozen=True, slots=True)
class FigureBound:
    """Bound of a figure of the true surface, from samples of its posterior."""

    mean: float
    interval: tuple[float, float]
    """90 % interval."""
    bound: float
    """95 % one-sided upper bound."""


@dataclass(frozen=True, slots=True)
class ErrorContribution:
    """A part of the uncertainty; independent ones add in squares."""

    name: str
    source: str
    """"noise", "instrument" or "unseen"."""
    rms_nm: float
    """One standard deviation, over the mask."""


@dataclass(frozen=True, slots=True)
class RemeasureAdvice:
    """Reference measurement that is needed because the prior of a term alone exceeds the tolerance."""

    name: str
    prior_nm: float
    """RMS over the mask."""
    reference: str
    """The reference that determines the term."""


@dataclass(frozen=True, slots=True)
class RmsBound(FigureBound):
    """Bound of the RMS without piston and tilt, nm."""

    removed: str
    """"tilt", or "power": piston, tilt and power."""
    contributions: tuple[ErrorContribution, ...]
    """The largest first."""
    demanded: tuple[RemeasureAdvice, ...]
    """References that acceptance needs; empty without a tolerance."""
    power_removed: RmsBound | None = None
    """Bound of the RMS without power, for a certificate where power is undetermined."""


def true_rms_bound(
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    errors: MapErrors,
    *,
    tolerance_nm: float | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    circle_px: tuple[float, float, float] | None = None,
) -> RmsBound:
    """Return the bound of the true RMS.

    Args:
        height_nm: (ny, nx) less the instrument's map, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        tolerance_nm: RMS that is allowed; decides which references are needed.
        samples: of the posterior.
        seed: of them.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        MapError: as `posterior`.
    """
    found = posterior(height_nm, mask, pitch_mm, errors, circle_px)
    rng = np.random.default_rng(seed)
    drawn = found.draw(samples, rng)
    rest = np.maximum(rng.normal(*found.rest_square, samples), 0.0)
    rest += errors.unseen_rest_nm**2 * rng.exponential(size=samples)  # a print is a few waves: of two, chi-squared / 2
    whole, without = (_rms_bound(found, errors, tolerance_nm, drawn, rest, power=power) for power in (False, True))
    return replace(whole, power_removed=without)


def true_figure_bound(
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    errors: MapErrors,
    figure: Callable[[FloatArray], float],
    *,
    samples: int = MAP_SAMPLES,
    seed: int = 0,
    circle_px: tuple[float, float, float] | None = None,
) -> FigureBound:
    """Return the bound of any figure, as PV or a drawing line, from sampled maps of the true surface.

    Args:
        height_nm: (ny, nx) less the instrument's map, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        figure: function of a map (ny, nx), NaN outside ``mask``; it removes terms as needed.
        samples: of the posterior.
        seed: of them.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        MapError: as `posterior`.
    """
    found = posterior(height_nm, mask, pitch_mm, errors, circle_px)
    rng = np.random.default_rng(seed)
    drawn = found.draw(samples, rng)
    values = np.empty(samples)
    surface = np.full(mask.shape, np.nan)
    for index, terms_nm in enumerate(drawn):
        noise = errors.noise.draw(mask.shape, pitch_mm, rng)[mask]
        surface[mask] = terms_nm @ found.evaluated + found.kept * found.rest_nm + np.sqrt(found.kept) * noise
        surface[mask] += rng.normal(0.0, errors.unseen_rest_nm, found.rest_nm.size)
        values[index] = figure(surface)
    return _bound(values)


def _rms_bound(
    found: FigurePosterior,
    errors: MapErrors,
    tolerance_nm: float | None,
    drawn_nm: FloatArray,
    rest_square: FloatArray,
    *,
    power: bool,
) -> RmsBound:
    weight = found.figure_weight(power=power)
    square = np.einsum("si,ij,sj->s", drawn_nm, weight, drawn_nm, optimize=True)
    rms = _bound(np.sqrt(np.maximum(square, 0.0) + rest_square))
    wanted: tuple[RemeasureAdvice, ...] = ()
    if tolerance_nm is not None:
        own = dict(zip(found.terms, np.diag(weight).tolist(), strict=True))
        wanted = required_references(errors, tolerance_nm, without_power=power, mean_square=own.__getitem__)
    return RmsBound(
        rms.mean, rms.interval, rms.bound,
        removed="power" if power else "tilt",
        contributions=_contributions(found, errors, weight),
        demanded=wanted,
    )  # fmt: skip


def _bound(values: FloatArray) -> FigureBound:
    low, high = np.quantile(values, (1 - BOUND, BOUND))
    return FigureBound(float(values.mean()), (float(low), float(high)), float(high))


def _contributions(found: FigurePosterior, errors: MapErrors, weight: FloatArray) -> tuple[ErrorContribution, ...]:
    """Return the contribution of each source and family of terms, and of the noise above the terms."""
    squares: dict[tuple[str, str], float] = {}
    for source, covariance in found.by_source.items():
        for index, (n, m) in list(enumerate(found.terms))[LEVEL:]:
            key = (family_name(n, m), source)
            squares[key] = squares.get(key, 0.0) + float(weight[index, index] * covariance[index, index])
    squares[SHORTER, "noise"] = found.rest_square[1]
    squares[SHORTER, "unseen"] = errors.unseen_rest_nm**2
    all_of_them = (ErrorContribution(*key, float(np.sqrt(max(one, 0.0)))) for key, one in squares.items())
    large = [one for one in all_of_them if one.rms_nm >= LEAST_NM]
    return tuple(sorted(large, key=lambda one: -one.rms_nm))


def required_references(
    errors: MapErrors,
    tolerance_nm: float,
    *,
    without_power: bool = False,
    mean_square: Callable[[Term], float] = lambda _: 1.0,
) -> tuple[RemeasureAdvice, ...]:
    """Return the references for term families whose undetermined part alone exceeds the tolerance.

    Args:
        errors: what is known of a map's errors; its noise plays no part.
        tolerance_nm: RMS that is allowed.
        without_power: the figure does not count power.
        mean_square: of a term of size 1 over the mask; of the whole circle, before there is a map: 1.
    """
    square: dict[str, float] = {}
    needs: dict[str, str] = {}
    for (n, m), prior in errors.unseen_nm.items():
        if not (without_power and (n, m) == POWER):
            name = family_name(n, m)
            square[name] = square.get(name, 0.0) + mean_square((n, m)) * prior**2
            needs[name] = reference_for(n, m)
    square[SHORTER], needs[SHORTER] = errors.unseen_rest_nm**2, OTHER_FOLDS
    over = {name: float(np.sqrt(one)) for name, one in square.items() if one > tolerance_nm**2}
    return tuple(RemeasureAdvice(name, prior, needs[name]) for name, prior in over.items())


__all__ = [
    "ErrorContribution",
    "FigureBound",
    "MapErrors",
    "MapNoise",
    "RemeasureAdvice",
    "RmsBound",
    "errors_from_system_map",
    "required_references",
    "true_figure_bound",
    "true_rms_bound",
]
