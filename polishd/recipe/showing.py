"""What a pass showed of its process, from what the learning step has at hand."""

from __future__ import annotations

import numpy as np

from polishd.hookspecs import RemovalAnswer
from polishd.model.beliefs import Estimate
from polishd.model.finding import PassIndicators
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.edge.correctable import SpotTransferFunction, correctable
from polishd.process.gate import RemovalCheckResult
from polishd.process.traces import WearIndicators, half_width_mm, traces
from polishd.recipe.records import ExecutedPass, MeasureResult


def pass_indicators(
    done: ExecutedPass, answer: RemovalAnswer, predicted_nm: FloatArray, verdict: RemovalCheckResult, rate: float
) -> PassIndicators:
    """What a pass showed that the gate did not stop.

    Args:
        done: the pass.
        answer: of the removal model, by what was believed.
        predicted_nm: (ny, nx) removal that it predicts of what was executed; also beside the clear aperture.
        verdict: the gate's.
        rate: the removal rate that was believed.
    """
    grid, mask = done.before.grid, done.before.metric_mask
    seen = WearIndicators()
    if verdict.tells_rate and answer.transfer is not None:
        late = answer.removal_nm(done.acted_s * _lateness(done.executed_s))
        spot_mm = half_width_mm(answer.transfer)
        measured = done.before.height_nm - done.after.height_nm
        seen = traces(predicted_nm, late, measured, mask, pitch_mm=grid.pitch_mm, spot_mm=spot_mm)
    return PassIndicators(
        before_nm=float(done.before.height_nm[mask].std()),
        predicted_nm=done.predicted_rms_nm,
        after_nm=float(done.after.height_nm[mask].std()),
        within_reach_nm=_within_reach_nm(done.after, mask, grid, answer.transfer),
        contact_s=float(done.executed_s.sum()),
        rate=Estimate(rate * verdict.rate, rate * verdict.rate_sigma) if verdict.tells_rate else None,
        fade=_told(seen.fade, seen.fade_sigma),
        width=_told(seen.width, seen.width_sigma),
        expected_nm=None if done.forecast is None else (done.forecast.low_nm, done.forecast.high_nm),
        seen_nm=done.after.stats.rms_nm,
    )


def _lateness(time_s: FloatArray) -> FloatArray:
    """(n,) where each point lies in the pass's time: -1/2 at its begin, 1/2 at its end."""
    total = float(time_s.sum())
    return np.asarray((np.cumsum(time_s) - time_s / 2) / total - 0.5 if total > 0 else time_s, dtype=np.float64)


def _within_reach_nm(
    after: MeasureResult, mask: BoolArray, grid: Grid, spot: SpotTransferFunction | None
) -> float | None:
    if spot is None:
        return None
    found = correctable(after.height_nm, mask, grid.pitch_mm, spot)
    return found.within_reach_rms_nm if found.resolved else found.rms_nm


def _told(value: float, sigma: float) -> Estimate | None:
    return Estimate(value, sigma) if np.isfinite(sigma) else None
