"""What a pass teaches: the removal rate. Whether map and machine agree on left and right is the gate's to judge."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray

TILES = 4
"""The mask is cut into this many tiles a side for the standard error: residuals are correlated over a spot."""
SIGNIFICANT = 2.0
"""A rate is applied only if it is this many standard errors from 1."""
MIN_SIGNAL_NM = 1.5
"""RMS of the predicted removal below which it teaches nothing: the map's noise is in what was predicted, too."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What measured removal says of the predicted one."""

    rate: float
    """Factor to apply to the removal rate: 1 where nothing significant was found."""
    measured_rate: float
    """Factor as fitted, whether significant or not; NaN where the prediction has no signal."""
    rate_sigma: float
    """Its standard error (jackknife over tiles)."""
    correlation: float
    """Of measured with predicted removal, both without piston and tilt."""
    explained: float
    """Share of the measured removal's variance that the scaled prediction explains."""
    notes: tuple[str, ...] = ()


def learn_rate(
    predicted_nm: FloatArray,
    measured_nm: FloatArray,
    mask: BoolArray,
    *,
    weight: FloatArray | None = None,
) -> Learned:
    """Fit ``measured = rate * predicted + piston + tilt`` by weighted least squares.

    Args:
        predicted_nm: (ny, nx) removal predicted from what was executed, positive = removed.
        measured_nm: (ny, nx) map before less map after; its piston and tilt are unknown.
        mask: (ny, nx) samples to compare.
        weight: (ny, nx) not negative; None for ones.

    Raises:
        ComputeError: shapes that do not fit, or no data.
    """
    _check(predicted_nm, measured_nm, mask, weight)
    w = np.ones(mask.shape) if weight is None else weight
    rows, columns = np.nonzero(mask)
    nuisance = [np.ones(rows.size), rows - rows.mean(), columns - columns.mean()]
    columns_nm = np.column_stack([predicted_nm[mask], *nuisance])
    weights, measured = w[mask], measured_nm[mask]
    signal = _without(columns_nm[:, 0], columns_nm[:, 1:], weights)
    left = _without(measured, columns_nm[:, 1:], weights)
    own = _correlation(signal, left)
    if _rms(signal, weights) < MIN_SIGNAL_NM:
        note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: it teaches nothing of the rate"
        return Learned(1.0, float("nan"), float("inf"), own, 0.0, (note,))
    rate = _slope(signal, left, weights)
    sigma = _jackknife(columns_nm, measured, weights, _tiles(rows, columns, mask.shape))
    spread = _rms(left, weights) ** 2
    explained = 1 - _rms(left - rate * signal, weights) ** 2 / spread if spread > 0 else 0.0
    notes: tuple[str, ...] = ()
    applied = rate
    if not abs(rate - 1) > SIGNIFICANT * sigma:
        applied, notes = 1.0, (f"a rate of {rate:.3f} +- {sigma:.3f} is not significant: the rate stays",)
    return Learned(applied, rate, sigma, own, explained, notes)


def withheld(learned: Learned) -> Learned:
    """The same where the gate says that this pass could not show a wrong rate: what was fitted is not applied."""
    if learned.rate == 1:
        return learned
    fitted = f"a rate of {learned.measured_rate:.3f} +- {learned.rate_sigma:.3f} was fitted"
    return replace(learned, rate=1.0, notes=(f"{fitted}, but this pass could not show a wrong one: the rate stays",))


def _check(predicted: FloatArray, measured: FloatArray, mask: BoolArray, weight: FloatArray | None) -> None:
    for name, array in (("predicted", predicted), ("measured", measured), ("weight", weight)):
        if array is None:
            continue
        if array.shape != mask.shape:
            raise ComputeError(f"{name} is {array.shape}, the mask {mask.shape}")
        if not np.isfinite(array[mask]).all():
            raise ComputeError(f"{name} is not finite everywhere in the mask")
    if np.count_nonzero(mask) < TILES**2:
        raise ComputeError(f"{np.count_nonzero(mask)} samples are too few to learn from")
    if weight is not None and not ((weight[mask] >= 0).all() and weight[mask].any()):
        raise ComputeError("weights must not be negative, nor all zero")


def _without(values: FloatArray, nuisance: FloatArray, weights: FloatArray) -> FloatArray:
    """Values less their weighted least-squares fit by the nuisance columns."""
    root = np.sqrt(weights)
    fit = np.linalg.lstsq(nuisance * root[:, None], values * root, rcond=None)[0]
    return np.asarray(values - nuisance @ fit, dtype=np.float64)


def _slope(signal: FloatArray, left: FloatArray, weights: FloatArray) -> float:
    return float((weights * signal) @ left / ((weights * signal) @ signal))


def _rms(values: FloatArray, weights: FloatArray) -> float:
    return float(np.sqrt(np.average(values**2, weights=weights)))


def _tiles(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(m,) number of the tile that each sample lies in."""
    return np.asarray((rows * TILES // shape[0]) * TILES + columns * TILES // shape[1])


def _jackknife(columns: FloatArray, measured: FloatArray, weights: FloatArray, tile: np.ndarray) -> float:
    """Standard error of the first column's factor: the fit is repeated without each tile in turn."""
    weighted = columns * weights[:, None]
    tiles = np.unique(tile)
    normal = np.stack([weighted[tile == k].T @ columns[tile == k] for k in tiles])
    right = np.stack([weighted[tile == k].T @ measured[tile == k] for k in tiles])
    without = np.linalg.pinv(normal.sum(0) - normal, hermitian=True) @ (right.sum(0) - right)[..., None]
    rates = without[:, 0, 0]
    return float(np.sqrt((len(rates) - 1) * np.mean((rates - rates.mean()) ** 2)))


def _correlation(a: FloatArray, b: FloatArray) -> float:
    if a.size < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
