"""By what a part is accepted: its figure as measured, or the bound of what it truly is (docs/tolerance.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.errors import ConfigError
from polishd.model.instrument import UnmeasuredTerms
from polishd.model.program import Plan
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.tolerance import LineResult
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse, MeasureResult
from polishd.process.identification.findings import Forecast, forecast
from polishd.process.metrology import zernike
from polishd.process.metrology.absolute_poses import LEVEL, terms
from polishd.process.metrology.statistics import remove_terms
from polishd.process.metrology.tolerance import in_line_band
from polishd.process.metrology.uncertainty import (
    MapErrors,
    MapNoise,
    RemeasureAdvice,
    errors_from_system_map,
    required_references,
    true_rms_bound,
)

MOST_SAMPLES = 20_000
"""Of a map by which its bound is told: the square of its RMS is known to 1 % from so many."""
NOT_KNOWN = "nothing is known of the instrument's own error (polishd calibrate instrument)"


def bounded(
    recipe: Recipe, judged: tuple[LineResult, ...], figure_nm: FloatArray, clear: BoolArray, pitch_mm: float
) -> tuple[LineResult, ...]:
    """What was measured of each line, with the bound of what is true where the job is accepted by that.

    Args:
        recipe: whose lines they are.
        judged: each line, in the recipe's order.
        figure_nm: (ny, nx) on the map's own pixels, without what is alignment; finite inside ``clear``.
        clear: (ny, nx) clear aperture.
        pitch_mm: distance of samples.
    """
    if recipe.accept == "figure":
        return judged
    some = _some(clear)
    circle = zernike.enclosing_circle(clear) if recipe.system is None else recipe.system.result.circle_px
    removed = "power" if _without_power(recipe) else ""
    found = []
    for line, one in zip(recipe.lines, judged, strict=True):
        if line.bounded:
            errors = errors_of(recipe, periods=bool(line.above_mm))
            height = in_line_band(line, figure_nm, clear, pitch_mm)
            bound = true_rms_bound(height, some, pitch_mm, errors, circle_px=circle)
            counts = bound.power_removed if removed and bound.power_removed is not None else bound
            found.append(replace(one, bound=counts.bound, removed=removed))
        else:
            found.append(one)
    return tuple(found)


def errors_of(recipe: Recipe, *, periods: bool = False) -> MapErrors:
    """Of one map, less the system map where there is one.

    ``periods``: of some periods only. How much noise they have nobody knows, so that it counts as figure.
    """
    instrument = recipe.instrument
    white = 0.0 if periods or instrument is None else instrument.repeatability_nm or 0.0
    unseen = UnmeasuredTerms() if instrument is None else instrument.unseen
    priors = {(n, m): unseen.of(n, m) for n, m in terms(_degree(recipe))[LEVEL:]}
    if recipe.system is None:
        return MapErrors(MapNoise(white), _degree(recipe), unseen_nm=priors, unseen_rest_nm=unseen.shorter_nm)
    return errors_from_system_map(recipe.system.result, MapNoise(white), priors)


def demanded(recipe: Recipe) -> tuple[RemeasureAdvice, ...]:
    """References without which no map of this instrument can be accepted: known before there is one."""
    if recipe.accept == "figure":
        return ()
    limit = min(line.limit for line in recipe.lines if line.bounded)
    return required_references(errors_of(recipe), limit, without_power=_without_power(recipe))


def reason_never_acceptable(recipe: Recipe) -> str:
    """Why no map can be accepted, and what to do; empty where one may."""
    if not (wanted := demanded(recipe)):
        return ""
    told = "; ".join(f"{one.name}, {one.prior_nm:.3g} nm by itself: {one.reference}" for one in wanted)
    waiver = (
        ' (calibrate instrument --power), or say job.accept_by = "bound_without_power": the certificate then says so'
    )
    power = waiver if "power" in {one.name for one in wanted} else ""
    return (
        f"no map can be accepted by the bound of its true RMS, for nothing has told of the instrument: {told}. Measure "
        f"that{power}"
    )


def require_acceptable(recipe: Recipe) -> None:
    """ConfigError where no map could be accepted: polishing would be for nothing."""
    if never := reason_never_acceptable(recipe):
        raise ConfigError(f"job.accept_by = {recipe.accept!r}: {never} (nothing was opened)")


def acceptance_words(recipe: Recipe) -> str:
    """By what a part is accepted, for ``check``."""
    if recipe.accept == "figure":
        known = "the instrument's system map is off" if recipe.system is not None else NOT_KNOWN
        return f"as measured: {known}"
    if never := reason_never_acceptable(recipe):
        return f"run will refuse: {never}"
    removed = ", power removed" if _without_power(recipe) else ""
    return f"by the one-sided 95 % bound of the true RMS, as its mount holds it{removed}"


def _without_power(recipe: Recipe) -> bool:
    return recipe.accept == "bound_without_power" or recipe.part.alignment == "power"


def _degree(recipe: Recipe) -> int:
    return MapErrors(MapNoise(0.0)).degree if recipe.system is None else recipe.system.result.degree


def _some(mask: BoolArray) -> BoolArray:
    """At most so many of its samples, drawn: a lattice could lie on the lines of a raster."""
    inside = np.flatnonzero(mask)
    if inside.size <= MOST_SAMPLES:
        return mask
    some = np.zeros(mask.size, dtype=np.bool_)
    some[np.random.default_rng(0).choice(inside, MOST_SAMPLES, replace=False)] = True
    return some.reshape(mask.shape)


# What a planned pass is expected to leave, from what the recipe and the cycles know.

SIGMAS = 3.0
"""Of the rate before anything was learned: what ``limits.max_rate_change`` refuses is so many standard errors off."""
SMOOTHED = 0.03
"""Share of a mean square that means over cells may take from a surface that a spot follows: periods of ten cells."""


def forecast_of(recipe: Recipe, measured: MeasureResult, plan: Plan, believed: EstimatesInUse) -> Forecast:
    """Of a plan that was made for that surface by what was believed."""
    mask, alignment = measured.metric_mask, recipe.part.alignment
    maps = (measured.height_nm, plan.predicted_removal_nm)
    now, removal = (remove_terms(one, mask, alignment)[mask] for one in maps)
    removed = float(np.sqrt(np.mean(plan.predicted_removal_nm[mask] ** 2)))
    return forecast(
        now,
        removal,
        removed_nm=removed,
        rate_sigma=_rate_sigma(recipe, believed),
        unexplained=believed.unexplained,
        noise_nm=_finer_noise_nm(recipe, measured),
        finer_nm=_finer_nm(recipe, measured),
        ripple=believed.ripple,
    )


def noise_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """RMS of a map's noise on the process grid, as far as anybody has said: a cell is the mean of its samples."""
    one = 0.0 if recipe.instrument is None else recipe.instrument.repeatability_nm or 0.0
    if measured.map_grid is None:
        return one
    return one * min(measured.map_grid.pitch_mm / measured.grid.pitch_mm, 1.0)


def ripple(recipe: Recipe, before: MeasureResult, after: MeasureResult, removed_nm: float) -> float:
    """What a pass has added to what is finer than the process grid, relative to the RMS of all that it removed."""
    return max(_finer_nm(recipe, after) - _finer_nm(recipe, before), 0.0) / removed_nm


def _finer_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """RMS of what the map shows on its own samples, and neither the process grid does nor its noise explains."""
    mask = measured.metric_mask
    coarse = remove_terms(measured.height_nm, mask, recipe.part.alignment)[mask].std()
    square = measured.figure_nm**2 - coarse**2 - _finer_noise_nm(recipe, measured) ** 2
    return 0.0 if square < SMOOTHED * coarse**2 else float(np.sqrt(square))


def _finer_noise_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """RMS of a map's noise on its own samples that is gone on the process grid, as far as anybody has said."""
    one = 0.0 if recipe.instrument is None else recipe.instrument.repeatability_nm or 0.0
    return float(np.sqrt(one**2 - noise_nm(recipe, measured) ** 2))


def _rate_sigma(recipe: Recipe, believed: EstimatesInUse) -> float:
    rate = believed.removal.rate
    return recipe.max_rate_change / SIGMAS if rate.sigma is None else rate.sigma / rate.value
