"""What passes say together: converging slower than predicted, a rate that drifts, a tool that wears, another spot.

How large each must be to be seen, and how often one is found where there is none: docs/wear.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from polishd.model.beliefs import Estimate
from polishd.model.finding import Finding, FindingLimits, PassIndicators, PassSeries
from polishd.process.forecast import Forecast

SIGMAS = 4.0
"""Standard errors by which a change must be other than none: a cell makes thousands of passes."""
REFERENCE = 3
"""Passes that make the rate that later ones are held against."""
LEAST_PROMISE = 0.05
"""Of the RMS: a plan that expects less of a gain expects none."""
STALLED = 2
"""Passes in a row that gain too little."""
BY_REACH = 0.5
"""Share of what is left that the spot must be able to correct, for more passes to be worth a thought."""
BY_WEAR = 0.5
"""Share of a fall that what was lost within the passes must make, for the fall to be wear."""
WORTH = 0.05
"""Chance of a gain below which a pass is not made."""
DIVERGED_RATIO, DIVERGED_NM = 1.3, 1.0
"""A surface that is worse than the best one so far by this ratio, and by more than noise and ripple, ends the job."""


def has_diverged(earlier_nm: Sequence[float], now_nm: float) -> bool:
    """Whether a surface is clearly worse than it has been: RMS of the earlier measurements, and of this one."""
    best = min(earlier_nm, default=math.inf)
    return now_nm > max(DIVERGED_RATIO * best, best + DIVERGED_NM)


def gain_too_small(expected: Forecast, limits: FindingLimits) -> Finding | None:
    """A pass that is not worth making: it will hardly leave the surface better than it is."""
    if not limits.least_gain or expected.better >= WORTH:
        return None
    chance = f"with a chance of {100 * expected.better:.0f} % that it is less than now"
    todo = "it is not made. Take another tool, or tolerance, or a quieter map"
    return Finding("stall", f"the next pass would leave {expected.words}, {chance}: {todo}", "job")


def extend_series(series: PassSeries, shown: PassIndicators) -> PassSeries:
    """The series with one more pass."""
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
    """What is found after the last pass of a job; none where all is as it should be.

    Args:
        series: with that pass (`followed`).
        job: what this job's passes showed, in time order; those that were interrupted are not among them.
        limits: how far each may go.
    """
    shown = job[-1]
    of_tool = [found for found in (_rate(series, shown, limits), _spot(shown, limits)) if found is not None]
    stall = None if of_tool else _stall(job, limits)  # a tool that changed is why
    return tuple(of_tool) if stall is None else (stall,)


def _rate(series: PassSeries, shown: PassIndicators, limits: FindingLimits) -> Finding | None:
    """A rate that changed within the pass, or since the series' first passes."""
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
    """Whether what was lost within the passes explains a fall between them; None: they do not show it."""
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
        return None  # a part of few spots across reads widths that scatter as far as the limit
    word = "wider" if shown.width.value > 0 else "narrower"
    size = f"{100 * abs(shown.width.value):.0f} +- {100 * _sigma(shown.width):.0f} %"
    advice = "look at tool, pressure and dip, and calibrate the spot"
    return Finding("spot", f"the spot is {size} {word} than the plans count with: {advice}", "cell")


def _stall(job: Sequence[PassIndicators], limits: FindingLimits) -> Finding | None:
    last = job[-STALLED:]
    if not limits.least_gain or len(last) < STALLED or not all(_gains_little(one, limits) for one in last):
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
    return promised < LEAST_PROMISE * shown.before_nm or gained < limits.least_gain * promised


def _change(series: PassSeries, shown: PassIndicators) -> Estimate | None:
    """Of the rate against the series' reference, relative."""
    if shown.rate is None or series.reference is None:
        return None
    ratio = shown.rate.value / series.reference.value
    error = math.hypot(_sigma(shown.rate) / shown.rate.value, _sigma(series.reference) / series.reference.value)
    return Estimate(ratio - 1, ratio * error)


def _beyond(change: Estimate, limit: float) -> bool:
    """Beyond its limit, and surely no chance."""
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
