"""Measured removal as the predicted one, scaled and moved a little: rate and shift with their standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray

TILES = 4
"""The mask is cut into this many tiles a side for the standard errors: residuals are correlated over a spot."""
FEWEST = 50
EVEN = 1e-6
"""Share of the slopes' energy below which there is no slope."""


@dataclass(frozen=True, slots=True)
class Fit:
    """``measured(p) = rate * predicted(p - shift) + plane``."""

    rate: float
    rate_sigma: float
    shift_mm: tuple[float, float]
    """(x, y)"""
    shift_sigma_mm: tuple[float, float]
    correlation: float
    """Of the fitted and the measured removal, both without the plane."""
    model_nm: FloatArray
    """(ny, nx) the fit; NaN where the moved prediction has no data."""


def levelled(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    """(ny, nx) without the least-squares plane over the mask; zero outside it."""
    rows, columns = np.nonzero(mask)
    plane = _plane(rows, columns)
    level = np.zeros(mask.shape)
    level[mask] = height_nm[mask] - plane @ np.linalg.lstsq(plane, height_nm[mask], rcond=None)[0]
    return level


def fit(
    predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, samples: tuple[int, int] | None, pitch_mm: float
) -> Fit:
    """Least squares of rate, plane and, about a shift of whole samples, of what is left of the shift.

    Args:
        predicted_nm: (ny, nx) levelled, zero outside its mask.
        measured_nm: (ny, nx) levelled.
        mask: (ny, nx) where both have data.
        samples: (down, right) that the prediction is moved by first; None: as it is, and no shift is fitted.
        pitch_mm: of the grid.
    """
    down, right = samples or (0, 0)
    x_slope, y_slope = np.gradient(predicted_nm, axis=1) / pitch_mm, -np.gradient(predicted_nm, axis=0) / pitch_mm
    inner = mask if samples is None else scipy.ndimage.binary_erosion(mask)  # slopes need both neighbours
    known = _moved(inner.astype(np.float64), down, right) > 0
    both = known & mask
    model = np.full(mask.shape, np.nan)
    if np.count_nonzero(both) < FEWEST:
        return Fit(float("nan"), float("inf"), (0.0, 0.0), (float("inf"),) * 2, 0.0, model)
    signals = (predicted_nm,) if samples is None else (predicted_nm, x_slope, y_slope)
    rows, columns = np.nonzero(both)
    terms = np.column_stack([*(_moved(s, down, right)[both] for s in signals), _plane(rows, columns)])
    measured = measured_nm[both]
    factors, sigmas = _jackknifed(terms, measured, _tiles(rows, columns, mask.shape), len(signals))
    model[both] = terms @ factors
    plane = terms[:, len(signals) :]
    own = measured - plane @ np.linalg.lstsq(plane, measured, rcond=None)[0]
    left = measured - model[both]
    explained = 1 - float(left @ left) / float(own @ own) if own.any() else 0.0
    correlation = float(np.sign(factors[0]) * np.sqrt(max(explained, 0.0)))
    x, y = _shift(factors, len(signals))
    if len(signals) > 1:
        sigmas[1:] = np.where(_told(terms[:, :3]), sigmas[1:], np.inf)
    return Fit(
        float(factors[0]), float(sigmas[0]), (right * pitch_mm + float(x), -down * pitch_mm + float(y)),
        (float(sigmas[1]), float(sigmas[2])), correlation, model,
    )  # fmt: skip


def _told(signals: FloatArray) -> BoolArray:
    """(2,) whether a shift along x, along y shows at all: a removal that is even along a line does not show it."""
    slopes = signals[:, 1:]
    energy = (slopes**2).sum(axis=0)
    if np.linalg.eigvalsh(slopes.T @ slopes)[0] > EVEN * energy.max() or energy.min() <= EVEN * energy.max():
        return np.asarray(energy > EVEN * energy.max(), dtype=np.bool_)
    return np.zeros(2, dtype=np.bool_)


def _moved(array: FloatArray, down: int, right: int) -> FloatArray:
    """The array moved by whole samples; zeros come in."""
    moved = np.zeros_like(array)
    ny, nx = array.shape
    to = (slice(max(down, 0), ny + min(down, 0)), slice(max(right, 0), nx + min(right, 0)))
    come = (slice(max(-down, 0), ny + min(-down, 0)), slice(max(-right, 0), nx + min(-right, 0)))
    moved[to] = array[come]
    return moved


def _plane(rows: np.ndarray, columns: np.ndarray) -> FloatArray:
    return np.column_stack([np.ones(rows.size), rows - rows.mean(), columns - columns.mean()])


def _tiles(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.asarray((rows * TILES // shape[0]) * TILES + columns * TILES // shape[1])


def _shift(factors: FloatArray, signals: int) -> FloatArray:
    """(..., 2) mm: predicted(p - s) = predicted - s . slope, to first order."""
    if signals == 1:
        return np.zeros((*factors.shape[:-1], 2))
    rate = np.where(factors[..., :1] == 0, np.nan, factors[..., :1])
    return np.asarray(-factors[..., 1:3] / rate, dtype=np.float64)


def _jackknifed(
    terms: FloatArray, measured: FloatArray, tile: np.ndarray, signals: int
) -> tuple[FloatArray, FloatArray]:
    """Factors, and the standard errors of the rate and of both shifts: the fit is repeated without each tile."""
    tiles = np.unique(tile)
    normal = np.stack([terms[tile == k].T @ terms[tile == k] for k in tiles])
    right = np.stack([terms[tile == k].T @ measured[tile == k] for k in tiles])
    factors = np.linalg.pinv(normal.sum(0), hermitian=True) @ right.sum(0)
    without = (np.linalg.pinv(normal.sum(0) - normal, hermitian=True) @ (right.sum(0) - right)[..., None])[..., 0]
    figures = np.column_stack([without[:, 0], _shift(without, signals)])
    sigmas = np.sqrt((len(tiles) - 1) * np.mean((figures - figures.mean(axis=0)) ** 2, axis=0))
    return np.asarray(factors), np.asarray(sigmas)
