"""By what a part is accepted: its figure as measured, or the bound of what it truly is (docs/tolerance.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.errors import ConfigError
from polishd.model.instrument import UnmeasuredTerms
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.tolerance import Judged
from polishd.process.absolute.poses import LEVEL, terms
from polishd.process.metrics import zernike
from polishd.process.tolerance import seen
from polishd.process.trust import MapErrors, MapNoise, RemeasureAdvice, demands, errors_from_system_map, true_rms_bound
from polishd.recipe.recipe import Recipe

MOST_SAMPLES = 20_000
"""Of a map by which its bound is told: the square of its RMS is known to 1 % from so many."""
NOT_KNOWN = "nothing is known of the instrument's own error (polishd calibrate instrument)"


def bounded(
    recipe: Recipe, judged: tuple[Judged, ...], figure_nm: FloatArray, clear: BoolArray, pitch_mm: float
) -> tuple[Judged, ...]:
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
    circle = zernike.enclosing(clear) if recipe.system is None else recipe.system.told.circle_px
    removed = "power" if _without_power(recipe) else ""
    found = []
    for line, one in zip(recipe.lines, judged, strict=True):
        if line.bounded:
            errors = errors_of(recipe, periods=bool(line.above_mm))
            height = seen(line, figure_nm, clear, pitch_mm)
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
    return errors_from_system_map(recipe.system.told, MapNoise(white), priors)


def demanded(recipe: Recipe) -> tuple[RemeasureAdvice, ...]:
    """References without which no map of this instrument can be accepted: known before there is one."""
    if recipe.accept == "figure":
        return ()
    limit = min(line.limit for line in recipe.lines if line.bounded)
    return demands(errors_of(recipe), limit, without_power=_without_power(recipe))


def reason_never_acceptable(recipe: Recipe) -> str:
    """Why no map can be accepted, and what to do; empty where one may."""
    if not (wanted := demanded(recipe)):
        return ""
    told = "; ".join(f"{one.name}, {one.prior_nm:.3g} nm by itself: {one.reference}" for one in wanted)
    waiver = ' (calibrate instrument --power), or say job.accept = "bound_without_power": the certificate then says so'
    power = waiver if "power" in {one.name for one in wanted} else ""
    return (
        f"no map can be accepted by the bound of its true RMS, for nothing has told of the instrument: {told}. Measure "
        f"that{power}"
    )


def require_acceptable(recipe: Recipe) -> None:
    """ConfigError where no map could be accepted: polishing would be for nothing."""
    if never := reason_never_acceptable(recipe):
        raise ConfigError(f"job.accept = {recipe.accept!r}: {never} (nothing was opened)")


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
    return MapErrors(MapNoise(0.0)).degree if recipe.system is None else recipe.system.told.degree


def _some(mask: BoolArray) -> BoolArray:
    """At most so many of its samples, drawn: a lattice could lie on the lines of a raster."""
    inside = np.flatnonzero(mask)
    if inside.size <= MOST_SAMPLES:
        return mask
    some = np.zeros(mask.size, dtype=np.bool_)
    some[np.random.default_rng(0).choice(inside, MOST_SAMPLES, replace=False)] = True
    return some.reshape(mask.shape)
