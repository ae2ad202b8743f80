"""Acceptance of a part by its measured figure, or by the bound of its true error (docs/reference/tolerance.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from polishd.model.errors import ConfigError
from polishd.model.instrument import UnmeasuredTerms
from polishd.model.program import Plan
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.tolerance import LineResult, ToleranceLine
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse, MeasureResult
from polishd.process.identification.findings import Forecast, forecast
from polishd.process.metrology import zernike
from polishd.process.metrology.absolute_poses import LEVEL, terms
from polishd.process.metrology.statistics import remove_terms
from polishd.process.metrology.tolerance import in_line_band, ripple_psd_alone, ripple_rms_nm, ripple_slope_urad
from polishd.process.metrology.uncertainty import (
    MapErrors,
    MapNoise,
    RemeasureAdvice,
    errors_from_system_map,
    required_references,
    true_rms_bound,
)
from polishd.process.removal.quiet_pitch import quieter_pitch_mm
from polishd.process.removal.ripple import ActingSpots, Ripple
from polishd.process.removal.ripple_forecast import ripple_of

MOST_SAMPLES = 20_000
"""Of a map, for its bound: with so many samples the square of the RMS is known to 1 %."""
NOT_KNOWN = "the instrument's error is not known. Run polishd calibrate instrument"


def bounded(
    recipe: Recipe, judged: tuple[LineResult, ...], figure_nm: FloatArray, clear: BoolArray, pitch_mm: float
) -> tuple[LineResult, ...]:
    """Return the result of each line, with the bound of its true value where the job is accepted by that.

    Args:
        recipe: with the lines.
        judged: result of each line, in the recipe's order.
        figure_nm: (ny, nx) on the map's pixels, without the alignment terms; finite inside ``clear``.
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
            # the ripple that the map does not show, 95 % value
            hidden = max((one.with_ripple_high or 0.0) ** 2 - one.value**2, 0.0) ** 0.5
            found.append(replace(one, bound=float(np.hypot(counts.bound, hidden)), removed=removed))
        else:
            found.append(one)
    return tuple(found)


def errors_of(recipe: Recipe, *, periods: bool = False) -> MapErrors:
    """Return the errors of one map, less the system map where there is one.

    ``periods``: of some periods only. Their noise is not known and counts as figure.
    """
    instrument = recipe.instrument
    white = 0.0 if periods or instrument is None else instrument.repeatability_nm or 0.0
    unseen = UnmeasuredTerms() if instrument is None else instrument.unseen
    priors = {(n, m): unseen.of(n, m) for n, m in terms(_degree(recipe))[LEVEL:]}
    if recipe.system is None:
        return MapErrors(MapNoise(white), _degree(recipe), unseen_nm=priors, unseen_rest_nm=unseen.shorter_nm)
    return errors_from_system_map(recipe.system.result, MapNoise(white), priors)


def demanded(recipe: Recipe) -> tuple[RemeasureAdvice, ...]:
    """Return the references without which no map of this instrument can be accepted; no map is needed for this."""
    if recipe.accept == "figure":
        return ()
    limit = min(line.limit for line in recipe.lines if line.bounded)
    return required_references(errors_of(recipe), limit, without_power=_without_power(recipe))


def reason_never_acceptable(recipe: Recipe) -> str:
    """Return why no map can be accepted, and what to do; empty where one can."""
    if not (wanted := demanded(recipe)):
        return ""
    unknown = "; ".join(f"{one.name}, alone {one.prior_nm:.3g} nm: {one.reference}" for one in wanted)
    waiver = (
        ' (calibrate instrument --power), or set job.accept_by = "bound_without_power", which the certificate shows'
    )
    power = waiver if "power" in {one.name for one in wanted} else ""
    return (
        "no map can be accepted by the bound of its true RMS: the instrument's error is not known in "
        f"{unknown}. Measure it{power}"
    )


def require_acceptable(recipe: Recipe) -> None:
    """ConfigError where no map could be accepted, so that polishing would be in vain."""
    if never := reason_never_acceptable(recipe):
        raise ConfigError(f"job.accept_by = {recipe.accept!r}: {never} (nothing was opened)")


def acceptance_words(recipe: Recipe) -> str:
    """Return the rule of acceptance, for ``check``."""
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
    """Return a random choice of at most ``MOST_SAMPLES`` samples: a regular choice could match the raster's lines."""
    inside = np.flatnonzero(mask)
    if inside.size <= MOST_SAMPLES:
        return mask
    some = np.zeros(mask.size, dtype=np.bool_)
    some[np.random.default_rng(0).choice(inside, MOST_SAMPLES, replace=False)] = True
    return some.reshape(mask.shape)


# Forecast of the surface after a planned pass.

SIGMAS = 3.0
"""``limits.max_rate_change`` is so many standard errors of the rate before the first estimate."""
SMOOTHED = 0.03
"""Share of the mean square that averaging over cells may remove from periods of ten cells, which a spot corrects."""


def forecast_of(
    recipe: Recipe, measured: MeasureResult, plan: Plan, believed: EstimatesInUse, acting: ActingSpots | None
) -> Forecast:
    """Return the forecast of a plan for that surface with those estimates.

    ``acting``: spots along the path, for the ripple of its lines; None: the removal model knows none.
    """
    mask, alignment, errors = measured.metric_mask, recipe.part.alignment, recipe.ripple_errors
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
        known_ripple=believed.ripple,
        ripple=None if acting is None else ripple_of(acting, plan.expected_time_s, measured.grid, mask, errors=errors),
        sample_mm=None if measured.map_grid is None else measured.map_grid.pitch_mm,
    )


HALF = 0.5
"""Share of a line's limit from which the ripple of a path is worth a note."""


def ripple_notes(
    lines: Sequence[ToleranceLine], ripple: Ripple, side_mm: float, acting: ActingSpots | None = None
) -> list[str]:
    """Describe the ripple of a plan, and each tolerance line of which it alone takes more than half.

    Args:
        lines: of the drawing.
        ripple: of the plan.
        side_mm: width of the map, which the rings of a spectrum depend on.
        acting: spots along the path, for the line distance that would do; None: none is named.
    """
    if not ripple.lines:
        return []
    high = f"{ripple.rms_high_nm:.2f} nm with {ripple.errors.words}"
    found = [f"the path leaves a ripple of {ripple.rms_nm:.2f} nm RMS ({ripple.words}), {high}"]
    for line in lines:
        own = ripple_in_line(line, ripple, side_mm)
        if own is None or own <= HALF * line.limit:
            continue
        share = HALF * line.limit / own
        share = share**0.5 if line.figure == "psd" else share
        pitch = None if acting is None else quieter_pitch_mm(acting, ripple, share)
        todo = "a smaller line distance" if pitch is None else f"lines {pitch:.3g} mm apart"
        found.append(
            f"that ripple alone is {own:.3g} {line.unit} of the {line.limit:g} {line.unit} of {line.what}: use a path "
            f"with {todo}, or two passes at an angle"
        )
    return found


def ripple_in_line(line: ToleranceLine, ripple: Ripple, side_mm: float) -> float | None:
    """Return a tolerance line's figure of the ripple alone, 95 % value; None for the figures A and C of ISO 10110."""
    rms_nm = ripple_rms_nm(line, ripple, high=True)
    match line.figure:
        case "rms" | "RMSt" | "RMSi" | "RMSa":
            return rms_nm
        case "pv" | "B":
            return 2 * 2**0.5 * rms_nm
        case "slope_rms":
            return ripple_slope_urad(line, ripple, high=True)
        case "slope_max":
            return 2**0.5 * ripple_slope_urad(line, ripple, high=True)
        case "psd":
            return ripple_psd_alone(line, ripple, side_mm)
        case _:
            return None


def noise_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """Return the RMS of a map's noise on the process grid, where a cell is the mean of its samples; 0 if unknown."""
    one = 0.0 if recipe.instrument is None else recipe.instrument.repeatability_nm or 0.0
    if measured.map_grid is None:
        return one
    return one * min(measured.map_grid.pitch_mm / measured.grid.pitch_mm, 1.0)


def ripple(recipe: Recipe, before: MeasureResult, after: MeasureResult, removed_nm: float) -> float:
    """Return the RMS that a pass added below the process grid, relative to the RMS of its removal."""
    return max(_finer_nm(recipe, after) - _finer_nm(recipe, before), 0.0) / removed_nm


def _finer_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """Return the RMS of the map below the process grid, without its noise."""
    mask = measured.metric_mask
    coarse = remove_terms(measured.height_nm, mask, recipe.part.alignment)[mask].std()
    square = measured.figure_nm**2 - coarse**2 - _finer_noise_nm(recipe, measured) ** 2
    return 0.0 if square < SMOOTHED * coarse**2 else float(np.sqrt(square))


def _finer_noise_nm(recipe: Recipe, measured: MeasureResult) -> float:
    """Return the RMS of a map's noise below the process grid; 0 if unknown."""
    one = 0.0 if recipe.instrument is None else recipe.instrument.repeatability_nm or 0.0
    return float(np.sqrt(one**2 - noise_nm(recipe, measured) ** 2))


def _rate_sigma(recipe: Recipe, believed: EstimatesInUse) -> float:
    rate = believed.removal.rate
    return recipe.max_rate_change / SIGMAS if rate.sigma is None else rate.sigma / rate.value
