"""Fit of the measured removal by the predicted one, scaled and shifted: rate and shift with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.estimates import Estimates, EstimateUpdate, PassEvidence
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.text import with_error
from polishd.process.metrology.statistics import Removal, fit_terms

TILES = 4
"""The mask is cut into this many tiles a side for the standard errors: residuals are correlated over a spot."""
FEWEST = 50
MIN_SIGNAL_NM = 1.5
"""RMS of the predicted removal, less piston and tilt, below which it shows nothing above the map's noise."""
MOST_DRIFT_NM = 5.0
"""Largest RMS of power, and of each astigmatism, that the set-up may add between two maps."""
EVEN = 1e-6
"""Share of the slopes' energy below which a slope counts as none."""


@dataclass(frozen=True, slots=True)
class Fit:
    """``measured(p) = rate * predicted(p - shift) + plane``."""

    rate: float
    rate_sigma: float
    """From the scatter over the tiles, and from drift."""
    rate_scatter: float
    """From the scatter alone."""
    rate_excess: float
    """Possible bias of the rate: the map's noise is in the measurement and in the plan made from it."""
    shift_mm: tuple[float, float]
    """(x, y)"""
    shift_sigma_mm: tuple[float, float]
    correlation: float
    """Correlation of the fitted and the measured removal, both without the plane."""
    model_nm: FloatArray
    """(ny, nx) the fit; NaN where the moved prediction has no data."""


def remove_plane(height_nm: FloatArray, mask: BoolArray, removal: Removal = "tilt") -> FloatArray:
    """Subtract the least-squares plane over the mask, or plane and power; zero outside it."""
    return np.where(mask, height_nm - fit_terms(height_nm, mask, removal), 0.0)


def fit(
    predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, samples: tuple[int, int] | None, pitch_mm: float
) -> Fit:
    """Fit rate, plane and, about a shift of whole samples, the remaining shift, by least squares.

    Args:
        predicted_nm: (ny, nx) leveled, zero outside its mask.
        measured_nm: (ny, nx) leveled.
        mask: (ny, nx) where both have data.
        samples: (down, right) that the prediction is moved by first; None: as it is, and no shift is fitted.
        pitch_mm: of the grid.
    """
    down, right = samples or (0, 0)
    inner = mask if samples is None else scipy.ndimage.binary_erosion(mask)  # slopes need both neighbours
    both = shift_samples(inner, down, right) & mask
    model = np.full(mask.shape, np.nan)
    if np.count_nonzero(both) < FEWEST:
        return unknown_fit(0.0, model)
    signals = [predicted_nm]
    if samples is not None:
        signals += [np.gradient(predicted_nm, axis=1) / pitch_mm, -np.gradient(predicted_nm, axis=0) / pitch_mm]
    figures = _rate_and_shift(len(signals))
    found = regress_signals([shift_samples(s, down, right) for s in signals], measured_nm, both, figures)
    terms, factors, sigmas = found.terms, found.factors, found.sigma
    model[both] = terms @ factors
    measured, plane = measured_nm[both], terms[:, len(signals) :]
    own = measured - plane @ np.linalg.lstsq(plane, measured, rcond=None)[0]
    left = measured - model[both]
    energy = float(terms[:, 0] @ terms[:, 0])
    explained = 1 - float(left @ left) / float(own @ own) if own.any() else 0.0
    correlation = float(np.sign(factors[0]) * np.sqrt(max(explained, 0.0)))
    rate, x, y = figures(factors)
    if len(signals) > 1:
        sigmas[1:] = np.where(_shows_shift(terms[:, :3]), sigmas[1:], np.inf)
    excess = float(left @ left) / 2 / energy if energy > 0 else float("inf")
    return Fit(
        rate=float(rate),
        rate_sigma=float(sigmas[0]),
        rate_scatter=float(found.scatter[0]),
        rate_excess=excess,
        shift_mm=(right * pitch_mm + float(x), -down * pitch_mm + float(y)),
        shift_sigma_mm=(float(sigmas[1]), float(sigmas[2])),
        correlation=correlation,
        model_nm=model,
    )


def unknown_fit(correlation: float, model_nm: FloatArray) -> Fit:
    """Return a fit with unknown rate and shift."""
    unknown = float("inf")
    return Fit(float("nan"), unknown, unknown, unknown, (0.0, 0.0), (unknown, unknown), correlation, model_nm)


def compare_predictions(
    other_nm: FloatArray, own_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray
) -> tuple[float, float]:
    """Compare another prediction with the present one by fitting both to the measured removal.

    The right one of two has a factor of about the rate, the wrong one of about 0 (J. R. Davidson, J. G. MacKinnon,
    Econometrica 49, 1981), whatever they have in common: the common part supports neither, and widens the error.

    Args:
        other_nm: (ny, nx) the other prediction, where it explains best.
        own_nm: (ny, nx) the present one.
        measured_nm: (ny, nx).
        mask: (ny, nx) where all three have data.

    Returns:
        The other's factor less the own one's, and its standard error; infinite where too little overlaps.
    """
    if np.count_nonzero(mask) < FEWEST:
        return 0.0, float("inf")

    def gap(factors: FloatArray) -> FloatArray:
        return np.asarray(factors[..., :1] - factors[..., 1:2], dtype=np.float64)

    found = regress_signals([other_nm, own_nm], measured_nm, mask, gap)
    return float(gap(found.factors)[0]), float(found.sigma[0])


def _shows_shift(signals: FloatArray) -> BoolArray:
    """(2,) whether a shift along x, along y shows: a removal that is even along a line does not show it."""
    slopes = signals[:, 1:]
    energy = (slopes**2).sum(axis=0)
    if np.linalg.eigvalsh(slopes.T @ slopes)[0] > EVEN * energy.max() or energy.min() <= EVEN * energy.max():
        return np.asarray(energy > EVEN * energy.max(), dtype=np.bool_)
    return np.zeros(2, dtype=np.bool_)


def shift_samples(array: NDArray[Any], down: int, right: int) -> NDArray[Any]:
    """Shift an array by whole samples and fill with zeros."""
    put = np.zeros_like(array)
    ny, nx = array.shape
    to = (slice(max(down, 0), ny + min(down, 0)), slice(max(right, 0), nx + min(right, 0)))
    come = (slice(max(-down, 0), ny + min(-down, 0)), slice(max(-right, 0), nx + min(-right, 0)))
    put[to] = array[come]
    return put


def _plane(rows: np.ndarray, columns: np.ndarray) -> FloatArray:
    return np.column_stack([np.ones(rows.size), rows - rows.mean(), columns - columns.mean()])


def _tiles(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(m,) number of the tile of the samples' box that each lies in."""
    down, right = ((v - v.min()) * TILES // (np.ptp(v) + 1) for v in (rows, columns))
    return np.asarray(down * TILES + right)


def _drift(terms: FloatArray, measured: FloatArray, rows: np.ndarray, columns: np.ndarray) -> FloatArray:
    """(m,) nm power and astigmatism that fit beside the terms, limited to MOST_DRIFT_NM.

    Temperature and mount bend a part and its reference between two maps. All tiles bend alike, so the scatter between
    tiles does not show it.
    """
    x, y = (v - v.mean() for v in (columns.astype(np.float64), rows.astype(np.float64)))
    modes = np.linalg.qr(np.column_stack([_plane(rows, columns), x**2 + y**2, x**2 - y**2, x * y]))[0][:, 3:]
    found = np.linalg.lstsq(np.column_stack([terms, modes]), measured, rcond=None)[0][terms.shape[1] :]
    most = MOST_DRIFT_NM * np.sqrt(rows.size)
    return np.asarray(modes @ np.clip(found, -most, most), dtype=np.float64)


def _rate_and_shift(signals: int) -> Callable[[FloatArray], FloatArray]:
    """Return a function of (..., k) factors: (..., 3) rate, x and y mm by predicted(p - s) = predicted - s . slope."""

    def figures(factors: FloatArray) -> FloatArray:
        rate = factors[..., :1]
        if signals == 1:
            return np.concatenate([rate, np.zeros((*rate.shape[:-1], 2))], axis=-1)
        return np.concatenate([rate, -factors[..., 1:3] / np.where(rate == 0, np.nan, rate)], axis=-1)

    return figures


class Regression(NamedTuple):
    """Linear fit, with standard errors of figures computed from its factors."""

    terms: FloatArray
    """(m, k): the signals, and a plane."""
    factors: FloatArray
    scatter: FloatArray
    """Standard errors from the fits without each tile."""
    drift: FloatArray
    """Change of the figures by drift."""

    @property
    def sigma(self) -> FloatArray:
        """Return the standard errors from scatter and drift."""
        return np.hypot(self.scatter, self.drift)


def regress_signals(
    signals: Sequence[FloatArray],
    measured_nm: FloatArray,
    mask: BoolArray,
    figures: Callable[[FloatArray], FloatArray],
    *,
    with_drift: bool = True,
) -> Regression:
    """Fit (ny, nx) signals and a plane over a mask by normal equations, whole and without each tile.

    ``with_drift`` False: power and astigmatism are among the signals, so drift adds no error.
    """
    rows, columns = np.nonzero(mask)
    terms, measured = np.column_stack([*(s[mask] for s in signals), _plane(rows, columns)]), measured_nm[mask]
    tile = _tiles(rows, columns)
    order = np.argsort(tile, kind="stable")
    tiles = np.split(np.column_stack([terms, measured])[order], np.flatnonzero(np.diff(tile[order])) + 1)
    products = np.stack([own.T @ own for own in tiles])
    normal, right = products[:, :-1, :-1], products[:, :-1, -1]
    inverse = np.linalg.pinv(normal.sum(0), hermitian=True)
    factors = inverse @ right.sum(0)
    without = (np.linalg.pinv(normal.sum(0) - normal, hermitian=True) @ (right.sum(0) - right)[..., None])[..., 0]
    scatter = figures(without)
    drifted = _drift(terms, measured, rows, columns) if with_drift else np.zeros_like(measured)
    drift = figures(factors - inverse @ (terms.T @ drifted)) - figures(factors)
    square = (len(tiles) - 1) * np.mean((scatter - scatter.mean(axis=0)) ** 2, axis=0)
    return Regression(terms, np.asarray(factors), np.sqrt(square), drift)


# Estimate of the removal rate from a pass. The removal check decides whether map and machine agree on orientation.

REST = 0.03
"""Relative random walk of a rate in a day; in n days sqrt(n) times this."""
SIGNIFICANT = 2.0
"""Standard errors by which a rate must differ from the present estimate to be applied."""


def learn_rate(evidence: PassEvidence) -> EstimateUpdate:
    """Estimate the removal rate by the fit of the removal check, ``measured = rate * predicted + piston + tilt``.

    The rate stays where the change is not significant, and where this pass cannot show a wrong rate. ``found`` has
    ``rate``, the factor applied to the present estimate; ``measured_rate`` as fitted (NaN without a signal) and
    ``rate_sigma``, its standard error; ``correlation`` of measured with predicted removal; and ``explained``, the share
    of the measured removal's variance that the scaled prediction explains.
    """
    mask, believed = evidence.mask, evidence.beliefs.rate
    predicted, measured = (remove_plane(v, mask) for v in (evidence.predicted_nm, evidence.measured_nm))
    own = fit(predicted, measured, mask, None, evidence.pitch_mm)
    signal = float(np.sqrt(np.mean(predicted[mask] ** 2)))
    factor, notes = _applied(own, signal, tells_rate=evidence.tells_rate)
    low, high = evidence.rates
    rate = min(max(believed.value * factor, low), high)  # beyond the limits by less than its error
    if rate != believed.value * factor:
        notes += (f"the fitted rate {believed.value * factor:.3f} is limited to {rate:.3f} by limits.max_rate_change",)
    has_signal = signal >= MIN_SIGNAL_NM
    how = {
        "rate": factor,
        "measured_rate": own.rate if has_signal else float("nan"),
        "rate_sigma": own.rate_scatter if has_signal else float("inf"),
        "correlation": own.correlation,
        "explained": own.correlation**2 if has_signal else 0.0,
    }
    if has_signal and evidence.tells_rate:
        believed = replace(believed, sigma=believed.value * own.rate_scatter)
    return EstimateUpdate(replace(evidence.beliefs, rate=replace(believed, value=rate)), how, notes)


def rate_for_next_part(beliefs: Estimates, days: float) -> Estimates:
    """Return the estimates for a job ``days`` after the last pass: the rate less certain by a random walk."""
    rate = beliefs.rate
    if rate.sigma is None:
        return beliefs
    walked = rate.value * REST * max(days, 0.0) ** 0.5
    return replace(beliefs, rate=replace(rate, sigma=float(np.hypot(rate.sigma, walked))))


def _applied(own: Fit, signal_nm: float, *, tells_rate: bool) -> tuple[float, tuple[str, ...]]:
    """Return the factor to apply to the present rate, 1 where it stays, and the reason."""
    if signal_nm < MIN_SIGNAL_NM:
        note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: the rate stays"
        return 1.0, (note,)
    fitted = f"a rate of {with_error(own.rate, own.rate_scatter)}"
    if not abs(own.rate - 1) > SIGNIFICANT * own.rate_scatter:
        return 1.0, (f"{fitted} is not significant: the rate stays",)
    if not tells_rate:
        return 1.0, (f"{fitted} was fitted, but this pass cannot show a wrong rate: the rate stays",)
    return own.rate, ()
