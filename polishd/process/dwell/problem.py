"""The dwell problem (paper eq. 50, with bounds): what every solver is given."""

from __future__ import annotations

from dataclasses import dataclass, field

from polishd.model.dwell import Start
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.effect import Effect


@dataclass(frozen=True, slots=True)
class DwellProblem:
    """``min sum_k weight_k (R t - h)_k^2 / N_r + regularisation ||t||^2 + price sum(t)`` over ``solve_mask``, bounded.

    N_r is the number of samples in ``solve_mask``; without weights and price it is paper eq. 50 with bounds.
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
    """Regularisation of eq. 50, nm^2/s^2."""
    weight: FloatArray | None = None
    """(ny, nx) how much a sample counts, not negative; None: all alike."""
    price_nm2_per_s: float = 0.0
    """What a second of total time costs: the multiplier of a time budget, and what walks a residual-time curve."""
    band_period_mm: float | None = None
    """The certificate states the RMS of periods above it, too."""
    warm: Start | None = field(default=None, repr=False)
    """A solution of a problem much like this one (the last cycle's, the last point of a curve) to start from."""
