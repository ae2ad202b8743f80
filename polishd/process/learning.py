"""What a pass teaches: the removal rate. Whether map and machine agree on left and right is the gate's to judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.beliefs import Estimates, EstimateUpdate, PassEvidence
from polishd.model.text import with_error
from polishd.process.removal_fit import MIN_SIGNAL_NM, Fit, fit, levelled

REST = 0.03
"""By how much a rate walks at random in a day, relative; in n days by sqrt(n) times this."""
SIGNIFICANT = 2.0
"""A rate is applied only if it is this many standard errors from the one believed."""


def learn_rate(evidence: PassEvidence) -> EstimateUpdate:
    """The removal rate by the gate's own fit, ``measured = rate * predicted + piston + tilt``.

    It stays where nothing significant was found, and where this pass could not have shown a wrong one. ``found`` has
    ``rate``, the factor applied to the one believed; ``measured_rate`` as fitted (NaN without a signal) and
    ``rate_sigma``, its standard error; ``correlation`` of measured with predicted removal; and ``explained``, the share
    of the measured removal's variance that the scaled prediction explains.
    """
    mask, believed = evidence.mask, evidence.beliefs.rate
    predicted, measured = (levelled(v, mask) for v in (evidence.predicted_nm, evidence.measured_nm))
    own = fit(predicted, measured, mask, None, evidence.pitch_mm)
    signal = float(np.sqrt(np.mean(predicted[mask] ** 2)))
    factor, notes = _applied(own, signal, tells_rate=evidence.tells_rate)
    low, high = evidence.rates
    rate = min(max(believed.value * factor, low), high)  # what is beyond them is so by less than its error
    if rate != believed.value * factor:
        found = f"a rate of {believed.value * factor:.3f} was found"
        notes += (f"{found}: {rate:.3f} is taken, the farthest that limits.max_rate_change allows",)
    told = signal >= MIN_SIGNAL_NM
    how = {
        "rate": factor,
        "measured_rate": own.rate if told else float("nan"),
        "rate_sigma": own.rate_scatter if told else float("inf"),
        "correlation": own.correlation,
        "explained": own.correlation**2 if told else 0.0,
    }
    if told and evidence.tells_rate:
        believed = replace(believed, sigma=believed.value * own.rate_scatter)
    return EstimateUpdate(replace(evidence.beliefs, rate=replace(believed, value=rate)), how, notes)


def later(beliefs: Estimates, days: float) -> Estimates:
    """What a job begins with, so many days after the pass that taught it: the rate, less certain by a random walk."""
    rate = beliefs.rate
    if rate.sigma is None:
        return beliefs
    walked = rate.value * REST * max(days, 0.0) ** 0.5
    return replace(beliefs, rate=replace(rate, sigma=float(np.hypot(rate.sigma, walked))))


def _applied(own: Fit, signal_nm: float, *, tells_rate: bool) -> tuple[float, tuple[str, ...]]:
    """The factor to apply to the rate believed, 1 where it stays; and why it does."""
    if signal_nm < MIN_SIGNAL_NM:
        note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: it teaches nothing of the rate"
        return 1.0, (note,)
    fitted = f"a rate of {with_error(own.rate, own.rate_scatter)}"
    if not abs(own.rate - 1) > SIGNIFICANT * own.rate_scatter:
        return 1.0, (f"{fitted} is not significant: the rate stays",)
    if not tells_rate:
        return 1.0, (f"{fitted} was fitted, but this pass could not show a wrong one: the rate stays",)
    return own.rate, ()
