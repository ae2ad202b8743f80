"""The one-sided 95 % bound of a part's true RMS, or of any other figure, and what would make it smaller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.names import OTHER_FOLDS, name_of, reference_for
from polishd.process.absolute.poses import LEVEL
from polishd.process.trust.errors import MapErrors, Term
from polishd.process.trust.posterior import POWER, FigurePosterior, posterior

BOUND = 0.95
SAMPLES, MAP_SAMPLES = 4000, 300
SHORTER = "shorter waves"
"""What is above the order of the terms."""
LEAST_NM = 1e-3
"""Contributions below it are left out."""


@dataclass(frozen=True, slots=True)
class FigureBound:
    """A figure of the true surface, from samples of what that can be."""

    mean: float
    interval: tuple[float, float]
    """In which it lies in 90 % of cases."""
    bound: float
    """Below which it lies in 95 %."""


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
    """A term of which the prior alone is more than the tolerance."""

    name: str
    prior_nm: float
    """RMS over the mask."""
    reference: str
    """What would tell it."""


@dataclass(frozen=True, slots=True)
class RmsBound(FigureBound):
    """Of the RMS without piston and tilt, nm."""

    removed: str
    """"tilt", or "power": piston, tilt and power."""
    contributions: tuple[ErrorContribution, ...]
    """The largest first."""
    demanded: tuple[RemeasureAdvice, ...]
    """What accepting the part needs; empty without a tolerance."""
    power_removed: RmsBound | None = None
    """The same of the figure without power, which a certificate can hold to where power is not told."""


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
    """How large the true RMS can be.

    Args:
        height_nm: (ny, nx) less the instrument's map, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        tolerance_nm: RMS that is allowed: says which references are demanded.
        samples: of the posterior.
        seed: of them.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        BadMap: as `posterior`.
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
    """How large any figure can be, PV or a line of the drawing: of whole maps, samples of what the part can be.

    Args:
        height_nm: (ny, nx) less the instrument's map, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        errors: what is known of the map's errors.
        figure: of a map (ny, nx), NaN outside ``mask``; it takes off what it wants taken off.
        samples: of the posterior.
        seed: of them.
        circle_px: (row, column, radius) of the errors' terms; None: around the mask.

    Raises:
        BadMap: as `posterior`.
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
        wanted = demands(errors, tolerance_nm, without_power=power, mean_square=own.__getitem__)
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
    """Of each source and family of terms; of noise what the terms leave, too."""
    squares: dict[tuple[str, str], float] = {}
    for source, covariance in found.by_source.items():
        for index, (n, m) in list(enumerate(found.terms))[LEVEL:]:
            key = (name_of(n, m), source)
            squares[key] = squares.get(key, 0.0) + float(weight[index, index] * covariance[index, index])
    squares[SHORTER, "noise"] = found.rest_square[1]
    squares[SHORTER, "unseen"] = errors.unseen_rest_nm**2
    all_of_them = (ErrorContribution(*key, float(np.sqrt(max(one, 0.0)))) for key, one in squares.items())
    told = [one for one in all_of_them if one.rms_nm >= LEAST_NM]
    return tuple(sorted(told, key=lambda one: -one.rms_nm))


def demands(
    errors: MapErrors,
    tolerance_nm: float,
    *,
    without_power: bool = False,
    mean_square: Callable[[Term], float] = lambda _: 1.0,
) -> tuple[RemeasureAdvice, ...]:
    """References for families of which the unseen part alone is more than the tolerance.

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
            name = name_of(n, m)
            square[name] = square.get(name, 0.0) + mean_square((n, m)) * prior**2
            needs[name] = reference_for(n, m)
    square[SHORTER], needs[SHORTER] = errors.unseen_rest_nm**2, OTHER_FOLDS
    over = {name: float(np.sqrt(one)) for name, one in square.items() if one > tolerance_nm**2}
    return tuple(RemeasureAdvice(name, prior, needs[name]) for name, prior in over.items())
