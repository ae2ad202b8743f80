"""How removal goes with the depth that the robot leaves to the contact: the exponent of the correction "power"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.calibration.loading import PercentErrors, percent_errors
from polishd.process.robot.refusal import refuse_where

TOO_UNCERTAIN = 0.5
"""Uncertainty at which the exponent says nothing: Hertz (1.5) and the paper's linear mode (1) differ by as much."""
BEST_SPOT = 1e-3
"""No spot's volume is taken to be better known than this (relative), however well they lie on the line."""


@dataclass(frozen=True, slots=True)
class ExponentFit:
    """``volume = scale * gamma ** exponent``."""

    exponent: float
    """1.5 for a Hertz contact (volume), 1 for the paper's linear mode (eq. 49)."""
    uncertainty: float
    """1 sigma of the exponent."""
    scale: float
    """Volume, or rate, at gamma = 1: that of a rigid robot; in the unit given."""
    errors: PercentErrors
    """Of the fit on the spots."""


def fit_exponent(gamma: FloatArray, volume: FloatArray) -> ExponentFit:
    """Fit the exponent of the depth ratio (paper eq. 48) to spots: least squares of the logarithms.

    Args:
        gamma: (n,) depth ratios at which the spots were taken, above 0; n at least 3.
        volume: (n,) volume rates, or peak rates, of the spots, above 0, one unit for all.

    Raises:
        ComputeError: names the first spot that is none; too few spots; a span of gamma too small to tell.
    """
    gamma, volume = _positive("depth ratio gamma", gamma), _positive("spot volume", volume)
    if len(gamma) != len(volume):
        raise ComputeError(f"{len(gamma)} depth ratios, {len(volume)} volumes")
    if len(gamma) < 3:
        raise ComputeError(f"{len(gamma)} spots are too few for an exponent and its uncertainty: at least 3 are needed")
    x, y = np.log(gamma), np.log(volume)
    spread = float(((x - x.mean()) ** 2).sum())
    span = f"gamma from {gamma.min():.4g} to {gamma.max():.4g}"
    if spread == 0:
        raise ComputeError(f"{span} is no span: an exponent needs spots at several depth ratios")
    exponent, level = (float(value) for value in np.polyfit(x, y, 1))
    variance = max(float(((y - level - exponent * x) ** 2).sum()) / (len(x) - 2), BEST_SPOT**2)
    uncertainty = float(np.sqrt(variance / spread))
    if uncertainty > TOO_UNCERTAIN:
        says = f"the exponent would be {exponent:.2f} +- {uncertainty:.2g}, it must be known to {TOO_UNCERTAIN:g}"
        raise ComputeError(f"{span} is too small a span for spots of this scatter: {says}")
    scale = float(np.exp(level))
    return ExponentFit(exponent, uncertainty, scale, percent_errors(scale * gamma**exponent / volume - 1))


def _positive(what: str, value: FloatArray) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 1:
        raise ComputeError(f"{what} has the shape {array.shape}, it must be (n,)")
    refuse_where(~(np.isfinite(array) & (array > 0)), array, what, "", "it must be finite and above 0")
    return array
