"""The dwell problem (paper eq. 50, with bounds): what every solver is given."""

from __future__ import annotations

from dataclasses import dataclass

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.effect import Effect


@dataclass(frozen=True, slots=True)
class DwellProblem:
    """``min ||R t - h||^2 / N_r + P ||t||^2`` over ``solve_mask``, ``lower_s <= t <= upper_s``.

    N_r is the number of samples in ``solve_mask``.
    """

    effect: Effect
    target_nm: FloatArray
    """(ny, nx) removal wanted, piston included; finite inside ``solve_mask``."""
    solve_mask: BoolArray
    """(ny, nx) samples that count in the objective (all valid data)."""
    metric_mask: BoolArray
    """(ny, nx) the clear aperture, in which figures are stated; a subset of ``solve_mask``."""
    lower_s: FloatArray
    """(n,) least time, set by motion: solved as a bound, never clipped afterwards."""
    upper_s: FloatArray
    """(n,) most time."""
    regularisation: float
    """P of eq. 50, nm^2/s^2."""
