"""What a pass's removal shows of the tool beside its rate: that it wore while it polished, or that its spot changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.edge.correctable import SpotTransferFunction
from polishd.process.removal_fit import FEWEST, MIN_SIGNAL_NM, levelled, regressed


@dataclass(frozen=True, slots=True)
class WearIndicators:
    """Each relative, with its standard error; infinite where the pass does not show it."""

    fade: float = 0.0
    """By how much the removal rate changed from the pass's begin to its end, of its mean."""
    fade_sigma: float = float("inf")
    width: float = 0.0
    """By how much the spot is wider than the predicted one, volume aside."""
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
    """Both by least squares, beside rate, shift and plane: ``measured = rate (predicted + fade late + width s^2 L)``.

    A spot that is wider by a little smooths what it removes, as diffusion does: L is the prediction's Laplacian. All
    are smoothed by the spot's size first: what is shorter is noise, and ripple of the raster, which grids take unlike.

    Args:
        predicted_nm: (ny, nx) removal predicted of what was executed, positive = removed; also beside the mask.
        late_nm: (ny, nx) the same, each point's time weighted with its place in the pass, -1/2 at the begin, 1/2 at the
            end.
        measured_nm: (ny, nx) map before less map after.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        spot_mm: the spot's RMS half width along one direction, s.
    """
    signal = levelled(predicted_nm, mask)[mask]
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

    found = regressed([predicted, late, bent, *slopes], measured, mask, figures)
    (fade, width), (fade_sigma, width_sigma) = figures(found.factors), found.sigma
    return WearIndicators(float(fade), float(fade_sigma), float(width), float(width_sigma))


def half_width_mm(transfer: SpotTransferFunction) -> float:
    """RMS half width of a spot along one direction: a transfer function falls from 1 by ``(2 pi s f)^2 / 2``."""
    frequency, modulus = transfer.frequency_per_mm, transfer.modulus
    few = (frequency > 0) & (modulus > 0.9)
    if not few.any():
        return 0.0
    return float(np.sqrt(np.mean(2 * (1 - modulus[few]) / (2 * np.pi * frequency[few]) ** 2)))
