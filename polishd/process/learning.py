"""What a pass teaches: the removal rate, and whether map and machine agree on what is left, right, up and down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray

TILES = 4
"""The mask is cut into this many tiles a side for the standard error: residuals are correlated over a spot."""
SIGNIFICANT = 2.0
"""A rate is applied only if it is this many standard errors from 1."""
FLIP_MARGIN = 0.1
"""By how much the correlation of another orientation must exceed that of the map as it is."""
MIN_SIGNAL_NM = 1.5
"""RMS of the predicted removal below which it teaches nothing: the map's noise is in what was predicted, too."""

ORIENTATIONS = ("as it is", "turned 90", "turned 180", "turned 270")
FLIPPED = ("flipped left-right", "transposed", "flipped up-down", "transposed across")


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
    best_orientation: str
    """Orientation of the predicted map that correlates best with the measured one; "as it is" when all is well."""
    best_correlation: float
    notes: tuple[str, ...] = ()


def learn_rate(
    predicted_nm: FloatArray,
    measured_nm: FloatArray,
    mask: BoolArray,
    *,
    weight: FloatArray | None = None,
    tilt: bool = True,
    refuse_flips: bool = True,
) -> Learned:
    """Fit ``measured = rate * predicted + piston (+ tilt)`` by weighted least squares.

    Args:
        predicted_nm: (ny, nx) removal predicted from what was executed, positive = removed.
        measured_nm: (ny, nx) map before less map after; its piston is unknown, its tilt too unless ``tilt`` is False.
        mask: (ny, nx) samples to compare.
        weight: (ny, nx) not negative; None for ones.
        tilt: whether a tilt is fitted and forgotten, as interferometer maps need.
        refuse_flips: raise rather than report where another orientation explains the measurement better.

    Raises:
        ComputeError: shapes that do not fit, no data, or (``refuse_flips``) a map that is flipped, turned or negated.
    """
    _check(predicted_nm, measured_nm, mask, weight)
    w = np.ones(mask.shape) if weight is None else weight
    rows, columns = np.nonzero(mask)
    nuisance = [np.ones(rows.size)] + ([rows - rows.mean(), columns - columns.mean()] if tilt else [])
    columns_nm = np.column_stack([predicted_nm[mask], *nuisance])
    weights, measured = w[mask], measured_nm[mask]
    signal = _without(columns_nm[:, 0], columns_nm[:, 1:], weights)
    left = _without(measured, columns_nm[:, 1:], weights)
    orientation, best, own = _best_orientation(_spread(signal, mask), _spread(left, mask), mask)
    if _rms(signal, weights) < MIN_SIGNAL_NM:
        note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: it teaches nothing of the rate"
        return Learned(1.0, float("nan"), float("inf"), own, 0.0, ORIENTATIONS[0], own, (note,))
    if orientation != ORIENTATIONS[0] and refuse_flips:
        raise ComputeError(
            f"the measured removal looks like the predicted one {orientation} (correlation {best:.2f}, as it is "
            f"{own:.2f}): check the instrument's profile and the program's offset and rotation before going on"
        )
    rate = _slope(signal, left, weights)
    sigma = _jackknife(columns_nm, measured, weights, _tiles(rows, columns, mask.shape))
    spread = _rms(left, weights) ** 2
    explained = 1 - _rms(left - rate * signal, weights) ** 2 / spread if spread > 0 else 0.0
    notes: tuple[str, ...] = ()
    applied = rate
    if not abs(rate - 1) > SIGNIFICANT * sigma:
        applied, notes = 1.0, (f"a rate of {rate:.3f} +- {sigma:.3f} is not significant: the rate stays",)
    return Learned(applied, rate, sigma, own, explained, orientation, best, notes)


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


def _spread(values: FloatArray, mask: BoolArray) -> FloatArray:
    """The mask's samples back on the grid, zero elsewhere."""
    grid = np.zeros(mask.shape)
    grid[mask] = values
    return grid


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


def _best_orientation(predicted: FloatArray, measured: FloatArray, mask: BoolArray) -> tuple[str, float, float]:
    """Name and correlation of the best of 8 turns and flips, plain or negated, and the correlation as it is.

    Another orientation counts only where it is better by ``FLIP_MARGIN``. Maps that are not square have 4.
    """
    square = mask.shape[0] == mask.shape[1]
    found = {}
    for names, values, where in ((ORIENTATIONS, predicted, mask), (FLIPPED, predicted[:, ::-1], mask[:, ::-1])):
        for k in range(0, 4, 1 if square else 2):
            both = np.rot90(where, k) & mask
            found[names[k]] = _correlation(np.rot90(values, k)[both], measured[both])
    own = found[ORIENTATIONS[0]]
    best = max(found, key=lambda name: abs(found[name]))
    if abs(found[best]) < max(own, 0.0) + FLIP_MARGIN:
        return ORIENTATIONS[0], own, own
    return (best if found[best] > 0 else f"{best} and negated"), found[best], own


def _correlation(a: FloatArray, b: FloatArray) -> float:
    if a.size < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
