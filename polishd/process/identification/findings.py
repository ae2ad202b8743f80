"""Findings from several passes: slower convergence than predicted, rate drift, tool wear, a changed spot.

Detection limits and false-alarm rates: docs/explanation/tool-wear.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import scipy

from polishd.model.estimates import Estimate, Finding, FindingLimits, PassIndicators, PassSeries
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.identification.removal_fit import FEWEST, MIN_SIGNAL_NM, regress_signals, remove_plane
from polishd.process.removal.ripple import NO_RIPPLE, SIGMAS_OF_95, Ripple
from polishd.process.removal.transfer_function import SpotTransferFunction

# Forecast of the residual of a planned pass as a distribution, and the errors of earlier forecasts.

LEVEL = 0.9
UNEXPLAINED = 0.009
"""Prior of the unexplained share of the removal, RMS: most first passes of the scenarios then agree with the forecast,
also those with a ripple that no touch shows (docs/explanation/scenarios.md)."""
WITHIN = 0.6
"""Standard deviation of the log of that share from pass to pass."""
MODES = 12
"""Independent parts of the unexplained field: the part's area in correlation areas."""
SURE_NOISE = 3.0
"""Least removal over noise to measure the unexplained share."""
SAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Forecast:
    """Forecast RMS of the next map on its samples, in the clear aperture, aligned alike."""

    low_nm: float
    median_nm: float
    high_nm: float
    level: float
    """Probability of the interval."""
    better: float
    """Probability that it is below the RMS before the pass."""
    ripple: Ripple = NO_RIPPLE
    """Ripple that the pass adds; the interval contains what the map's samples show of it."""
    gain_nm: float | None = None
    """RMS on the process grid before the pass less the RMS that the plan leaves there; None: unknown."""
    floor_nm: float | None = None
    """Mean removal of the machine's shortest times; None: unknown."""

    def facts(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**asdict(self), "ripple": {"lines": self.ripple.facts(), "errors": asdict(self.ripple.errors)}}

    @property
    def words(self) -> str:
        """Return the interval as text."""
        return f"{self.low_nm:.2f} to {self.high_nm:.2f} nm ({100 * self.level:.0f} %)"


def forecast(
    now_nm: FloatArray,
    removal_nm: FloatArray,
    *,
    removed_nm: float,
    rate_sigma: float,
    unexplained: float,
    noise_nm: float = 0.0,
    finer_nm: float = 0.0,
    known_ripple: float = 0.0,
    ripple: Ripple | None = None,
    sample_mm: float | None = None,
) -> Forecast:
    """Forecast the RMS after a pass.

    Args:
        now_nm: (n,) surface in the clear aperture as measured, aligned.
        removal_nm: (n,) expected removal there, aligned alike.
        removed_nm: RMS of the total removal.
        rate_sigma: standard error of the removal rate, relative.
        unexplained: RMS of the unexplained removal, relative to that.
        noise_nm: RMS of the next map's noise beyond that in ``now_nm``, in quadrature.
        finer_nm: RMS of the map's finer structure beyond ``now_nm`` and noise, which stays.
        known_ripple: increase of that by earlier passes, relative to their removal, as uncertain as ``unexplained``.
        ripple: forecast from the path and its spots; None: there is no forecast.
        sample_mm: distance of the map's samples, which average over finer ripple; None: unknown, all of it counts.
    """
    rng = np.random.default_rng(0)  # reproducible
    left, removal = now_nm - removal_nm, removal_nm - removal_nm.mean()
    left = left - left.mean()
    own, across, square = (float(np.mean(a * b)) for a, b in ((left, left), (left, removal), (removal, removal)))
    off = rate_sigma * rng.standard_normal(SAMPLES)
    by_rate = np.maximum(own - 2 * off * across + off**2 * square, 0.0)
    size = unexplained * removed_nm * np.exp(WITHIN * rng.standard_normal(SAMPLES))
    field = size**2 * rng.chisquare(MODES, SAMPLES) / MODES
    mixed = 2 * np.sqrt(by_rate * field / MODES) * rng.standard_normal(SAMPLES)
    after = np.sqrt(np.maximum(by_rate + field + mixed, 0.0))
    alike = rng.uniform(size=SAMPLES)  # 1: the same tracks add up; 0: independent
    finer = finer_nm + known_ripple * removed_nm * alike * np.exp(WITHIN * rng.standard_normal(SAMPLES))
    adds = NO_RIPPLE if ripple is None else ripple
    nominal, high = (adds.shown_nm(sample_mm, high=high) for high in (False, True))
    shown = nominal + max(high - nominal, 0.0) * np.abs(rng.standard_normal(SAMPLES)) / SIGMAS_OF_95
    finer = np.maximum(finer, np.hypot(finer_nm, shown))
    seen = np.hypot(np.hypot(after, noise_nm), finer)
    low, median, high_nm = np.quantile(seen, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2])
    better = float(np.mean(np.hypot(after, finer) < np.hypot(now_nm.std(), finer_nm)))
    gain_nm = float(now_nm.std()) - own**0.5
    return Forecast(float(low), float(median), float(high_nm), LEVEL, better, adds, gain_nm)


def unexplained_share(
    predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, noise_nm: float
) -> float | None:
    """Return the share of a pass's removal that no rate explains; None where the pass is too weak.

    Args:
        predicted_nm: (ny, nx) total removal by the model of the executed blocks.
        measured_nm: (ny, nx) map before less map after.
        mask: (ny, nx) the clear aperture.
        noise_nm: RMS of one map's noise on these samples.
    """
    predicted, measured = (remove_plane(np.where(mask, v, 0.0), mask)[mask] for v in (predicted_nm, measured_nm))
    size = float(np.sqrt(np.mean(predicted**2)))
    change_nm = 2**0.5 * noise_nm
    if size < max(MIN_SIGNAL_NM, SURE_NOISE * change_nm):
        return None
    rate = float(predicted @ measured / (predicted @ predicted))
    rest = float(np.mean((measured - rate * predicted) ** 2))
    return float(np.sqrt(max(rest - change_nm**2, 0.0) / np.mean(predicted_nm[mask] ** 2)))


def pool_unexplained(known: float, shown: float | None) -> float:
    """Pool the unexplained shares of the passes; the last pass counts as much as all before it."""
    return known if shown is None else float(np.sqrt((known**2 + shown**2) / 2))


SIGMAS = 4.0
"""Standard errors by which a change must differ from 0: a cell makes thousands of passes."""
REFERENCE = 3
"""Passes whose mean rate is the reference for later ones."""
LEAST_PROMISE = 0.05
"""Least gain of a plan, as a share of the RMS; a smaller one counts as none."""
STALLED = 2
"""Passes in a row that gain too little."""
BY_REACH = 0.5
"""Least share of the residual that the spot can correct, for more passes to help."""
BY_WEAR = 0.5
"""Least share of a fall that must occur within the passes to count as wear."""
WORTH = 0.05
"""Least probability of a gain for a pass."""
DIVERGED_RATIO, DIVERGED_NM = 1.3, 1.0
"""A surface worse than the best one by this ratio, and by more than noise and ripple, ends the job."""


def has_diverged(earlier_nm: Sequence[float], now_nm: float) -> bool:
    """Return whether a surface is clearly worse than before: RMS of the earlier measurements, and of this one."""
    best = min(earlier_nm, default=math.inf)
    return now_nm > max(DIVERGED_RATIO * best, best + DIVERGED_NM)


def gain_too_small(expected: Forecast, limits: FindingLimits) -> Finding | None:
    """Return a finding where the next pass will probably not improve the surface."""
    if not limits.min_improvement:
        return None
    adds_nm = expected.ripple.rms_nm
    if expected.gain_nm is not None and expected.gain_nm < adds_nm:
        gain = f"the next pass would gain {expected.gain_nm:.2f} nm RMS and add a ripple of {adds_nm:.2f} nm RMS"
        floor = expected.floor_nm
        floor_words = "" if floor is None else f"; the machine's shortest times remove {floor:.3g} nm in the mean"
        todo = "it is not made. Use a path with a smaller line distance, or another tolerance"
        return Finding("stall", f"{gain} ({expected.ripple.words}{floor_words}): {todo}", "job")
    if expected.better >= WORTH:
        return None
    chance = f"with a chance of {100 * expected.better:.0f} % that it is less than now"
    todo = "it is not made. Take another tool, or tolerance, or a quieter map"
    return Finding("stall", f"the next pass would leave {expected.words}, {chance}: {todo}", "job")


def extend_series(series: PassSeries, shown: PassIndicators) -> PassSeries:
    """Return the series with one more pass."""
    hours = shown.contact_s / 3600
    longer = replace(series, passes=series.passes + 1, contact_h=series.contact_h + hours)
    if shown.rate is not None:
        reference = _mean(series.reference, shown.rate) if series.rated < REFERENCE else series.reference
        longer = replace(longer, reference=reference, rated=series.rated + 1)
    if shown.fade is not None:
        longer = replace(
            longer,
            faded=longer.faded + shown.fade.value,
            faded_variance=longer.faded_variance + _sigma(shown.fade) ** 2,
            faded_h=longer.faded_h + hours,
        )
    return longer


def findings(series: PassSeries, job: Sequence[PassIndicators], limits: FindingLimits) -> tuple[Finding, ...]:
    """Return the findings after the last pass of a job.

    Args:
        series: with that pass (`extend_series`).
        job: indicators of this job's passes in time order, without interrupted ones.
        limits: limit of each indicator.
    """
    shown = job[-1]
    of_tool = [found for found in (_rate(series, shown, limits), _spot(shown, limits)) if found is not None]
    stall = None if of_tool else _stall(job, limits)  # a changed tool explains a stall
    return tuple(of_tool) if stall is None else (stall,)


def _rate(series: PassSeries, shown: PassIndicators, limits: FindingLimits) -> Finding | None:
    """Return a finding on a rate change within the pass, or since the series' first passes."""
    since = _change(series, shown)
    if shown.fade is not None and _beyond(shown.fade, limits.max_rate_drift):
        word = f"the removal rate changed by {_percent(shown.fade)} during one pass of {_hours(shown.contact_s / 3600)}"
        return _tool(word, falls=shown.fade.value < 0, within=True)
    if since is None or series.rated <= REFERENCE or not _beyond(since, limits.max_rate_drift):
        return None
    over = f"{series.passes} passes, {_hours(series.contact_h)} in contact"
    word = f"the removal rate changed by {_percent(since)} in {over}"
    return _tool(word, falls=since.value < 0, within=_by_wear(series, since.value))


def _tool(word: str, *, falls: bool, within: bool | None) -> Finding:
    if falls and within:
        return Finding("wear", f"{word}, and it falls while the tool polishes: dress or change the tool", "cell")
    within_words = {
        True: "within the pass",
        False: "and not within the passes",
        None: "within the passes or between them",
    }
    advice = "look at slurry, temperature, force and speed; then the tool"
    return Finding("drift", f"{word}, {within_words[within]}: {advice}", "cell")


def _by_wear(series: PassSeries, change: float) -> bool | None:
    """Return whether wear within the passes explains a fall between them; None: undetermined."""
    if change >= 0:
        return False
    if not series.faded_h:
        return None
    scale = series.contact_h / series.faded_h  # passes that showed no fade wore the tool, too
    lost, sigma = scale * series.faded, scale * math.sqrt(series.faded_variance)
    share = BY_WEAR * math.log1p(max(change, -0.99))
    if lost < -2 * sigma and lost <= share:
        return True
    return False if lost - 2 * sigma > share else None


def _spot(shown: PassIndicators, limits: FindingLimits) -> Finding | None:
    if shown.width is None or not _beyond(shown.width, limits.max_spot_change):
        return None
    if abs(shown.width.value) - 2 * _sigma(shown.width) <= limits.max_spot_change:
        return None  # on a part of few spots across, the widths scatter up to the limit
    word = "wider" if shown.width.value > 0 else "narrower"
    size = f"{100 * abs(shown.width.value):.0f} +- {100 * _sigma(shown.width):.0f} %"
    advice = "look at tool, pressure and dip, and calibrate the spot"
    return Finding("spot", f"the spot is {size} {word} than the plans count with: {advice}", "cell")


def _stall(job: Sequence[PassIndicators], limits: FindingLimits) -> Finding | None:
    last = job[-STALLED:]
    if not limits.min_improvement or len(last) < STALLED or not all(_gains_little(one, limits) for one in last):
        return None
    first, shown = last[0], last[-1]
    word = (
        f"the last {STALLED} passes brought the RMS from {first.before_nm:.2f} to {shown.after_nm:.2f} nm, and "
        f"{first.predicted_nm:.2f} and {shown.predicted_nm:.2f} were predicted"
    )
    if shown.within_reach_nm is not None:
        word += f"; {shown.within_reach_nm:.2f} nm of what is left has periods that this spot corrects"
    reach = shown.within_reach_nm is None or shown.within_reach_nm >= BY_REACH * shown.after_nm
    todo = "look in the report where predicted and measured differ" if reach else "take another tool, or tolerance"
    return Finding("stall", f"{word}: {todo}", "job")


def _gains_little(shown: PassIndicators, limits: FindingLimits) -> bool:
    if shown.predicted_nm is None:
        return False
    promised, gained = shown.before_nm - shown.predicted_nm, shown.before_nm - shown.after_nm
    return promised < LEAST_PROMISE * shown.before_nm or gained < limits.min_improvement * promised


def _change(series: PassSeries, shown: PassIndicators) -> Estimate | None:
    """Relative change of the rate against the series' reference."""
    if shown.rate is None or series.reference is None:
        return None
    ratio = shown.rate.value / series.reference.value
    error = math.hypot(_sigma(shown.rate) / shown.rate.value, _sigma(series.reference) / series.reference.value)
    return Estimate(ratio - 1, ratio * error)


def _beyond(change: Estimate, limit: float) -> bool:
    """Return whether a change exceeds its limit significantly."""
    return abs(change.value) > limit and abs(change.value) > SIGMAS * _sigma(change)


def _mean(known: Estimate | None, new: Estimate) -> Estimate:
    if known is None:
        return new
    a, b = (1 / max(_sigma(one), 1e-6) ** 2 for one in (known, new))
    return Estimate((a * known.value + b * new.value) / (a + b), (a + b) ** -0.5)


def _sigma(belief: Estimate) -> float:
    return math.inf if belief.sigma is None else belief.sigma


def _percent(change: Estimate) -> str:
    return f"{100 * change.value:+.0f} +- {100 * _sigma(change):.0f} %"


def _hours(hours: float) -> str:
    return f"{hours:.1f} h" if hours >= 1 else f"{60 * hours:.0f} min"


# Tool indicators from a pass's removal beside the rate: wear within the pass, and a change of the spot.


@dataclass(frozen=True, slots=True)
class WearIndicators:
    """Relative indicators with standard errors, infinite where the pass does not show them."""

    fade: float = 0.0
    """Change of the removal rate from the pass's begin to its end, over its mean."""
    fade_sigma: float = float("inf")
    width: float = 0.0
    """Relative excess of the spot's width over the predicted one, at equal volume."""
    width_sigma: float = float("inf")


def traces(
    predicted_nm: FloatArray,
    late_nm: FloatArray,
    measured_nm: FloatArray,
    mask: BoolArray,
    *,
    pitch_mm: float,
    spot_mm: float,
) -> WearIndicators:
    """Fit both by least squares with rate, shift and plane: ``measured = rate (predicted + fade late + width s^2 L)``.

    A slightly wider spot smooths its removal like diffusion: L is the prediction's Laplacian. All maps are smoothed by
    the spot's size first, because shorter periods are noise and raster ripple, which depends on the grid. The standard
    errors contain the scatter over tiles, the drift between maps, and what the model does not explain of a removal.

    Args:
        predicted_nm: (ny, nx) removal predicted of what was executed, positive = removed; also beside the mask.
        late_nm: (ny, nx) the same, each point's time weighted by its position in the pass, -1/2 at the begin, 1/2 at
            the end.
        measured_nm: (ny, nx) map before less map after.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        spot_mm: the spot's RMS half width along one direction, s.
    """
    signal = remove_plane(predicted_nm, mask)[mask]
    if mask.sum() < FEWEST or np.sqrt(np.mean(signal**2)) < MIN_SIGNAL_NM:
        return WearIndicators()
    reach = spot_mm / pitch_mm
    predicted, late, measured = (
        scipy.ndimage.gaussian_filter(height, reach) for height in (predicted_nm, late_nm, measured_nm)
    )
    bent = scipy.ndimage.laplace(predicted, mode="nearest") * reach**2
    slopes = [np.gradient(predicted, axis=axis) for axis in (0, 1)]

    def figures(factors: FloatArray) -> FloatArray:
        return np.asarray(factors[..., 1:3] / factors[..., :1], dtype=np.float64)

    found = regress_signals([predicted, late, bent, *slopes], measured, mask, figures)
    fade, width = figures(found.factors)
    # What the model does not explain of a removal looks like a little of any signal, however small its scatter is.
    unexplained_nm = UNEXPLAINED * float(np.sqrt(np.mean(signal**2)) / math.sqrt(MODES))
    weights = np.diag(np.linalg.pinv(found.terms.T @ found.terms / mask.sum(), hermitian=True))[1:3]
    fade_sigma, width_sigma = np.hypot(found.sigma, unexplained_nm * np.sqrt(weights))
    return WearIndicators(float(fade), float(fade_sigma), float(width), float(width_sigma))


def half_width_mm(transfer: SpotTransferFunction) -> float:
    """RMS half width of a spot along one direction: a transfer function falls from 1 by ``(2 pi s f)^2 / 2``."""
    frequency, modulus = transfer.frequency_per_mm, transfer.modulus
    few = (frequency > 0) & (modulus > 0.9)
    if not few.any():
        return 0.0
    return float(np.sqrt(np.mean(2 * (1 - modulus[few]) / (2 * np.pi * frequency[few]) ** 2)))
