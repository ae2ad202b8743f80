"""What a planned pass is expected to leave, from what the recipe and the cycles know."""

from __future__ import annotations

import numpy as np

from polishd.model.program import Plan
from polishd.process import metrics
from polishd.process.forecast import Forecast, forecast
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import EstimatesInUse, MeasureResult

SIGMAS = 3.0
"""Of the rate before anything was learned: what ``limits.max_rate_change`` refuses is so many standard errors off."""
SMOOTHED = 0.03
"""Share of a mean square that means over cells may take from a surface that a spot follows: periods of ten cells."""


def forecast_of(recipe: Recipe, measured: MeasureResult, plan: Plan, believed: EstimatesInUse) -> Forecast:
    """Of a plan that was made for that surface by what was believed."""
    mask, alignment = measured.metric_mask, recipe.part.alignment
    maps = (measured.height_nm, plan.predicted_removal_nm)
    now, removal = (metrics.without(one, mask, alignment)[mask] for one in maps)
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
    coarse = metrics.without(measured.height_nm, mask, recipe.part.alignment)[mask].std()
    square = measured.figure_nm**2 - coarse**2 - _finer_noise_nm(recipe, measured) ** 2
    return 0.0 if square < SMOOTHED * coarse**2 else float(np.sqrt(square))


def _finer_noise_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """RMS of a map's noise on its own samples that is gone on the process grid, as far as anybody has said."""
    one = 0.0 if recipe.instrument is None else recipe.instrument.repeatability_nm or 0.0
    return float(np.sqrt(one**2 - noise_nm(recipe, measured) ** 2))


def _rate_sigma(recipe: Recipe, believed: EstimatesInUse) -> float:
    rate = believed.removal.rate
    return recipe.max_rate_change / SIGMAS if rate.sigma is None else rate.sigma / rate.value
