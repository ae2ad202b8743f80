"""The dwell problem (paper eq. 50, with bounds): what every solver is given."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polishd.model.dwell import Start
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.removal.effect import Effect, SparseEffect


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
    """Price of a second of total time: the multiplier of a time budget and the parameter of a residual curve."""
    band_period_mm: float | None = None
    """The certificate states the RMS of periods above it, too."""
    warm: Start | None = field(default=None, repr=False)
    """A solution of a problem much like this one (the last cycle's, the last point of a curve) to start from."""


# What a dwell problem must satisfy before any solver sees it: one clear ComputeError each.

NEGLIGIBLE = 1e-3
"""Share of the strongest by which an effect without a matrix may be wrong where it has nothing."""


def negligible_share(effect: Effect) -> float:
    """Share of the strongest removal up to which it is taken for none: 0 of a matrix, which is exact."""
    return 0.0 if isinstance(effect, SparseEffect) else NEGLIGIBLE


def without_traces(removal_nm: FloatArray, share: float) -> FloatArray:
    """The removal, (ny, nx) nm, with nothing where it is below zero by at most that share of the largest.

    An effect without a matrix leaves such traces where a path ends. What is farther below zero stays, to be refused.
    """
    trace = (removal_nm < 0) & (removal_nm >= -share * removal_nm.max(initial=0.0))
    return np.where(trace, 0.0, removal_nm)


def check(problem: DwellProblem) -> None:
    """Refuse a problem that has no meaningful answer, naming what is wrong and where.

    Args:
        problem: the problem as a solver would be given it.

    Raises:
        ComputeError: shapes that do not fit, masks without samples, non-finite or contradicting numbers, or an effect
            that is negative, or zero all over ``solve_mask``.
    """
    _check_shapes(problem)
    _check_masks(problem)
    _check_bounds(problem)
    if not (np.isfinite(problem.regularisation) and problem.regularisation >= 0):
        raise ComputeError(f"regularisation must be finite and not negative, not {problem.regularisation}")
    if not (np.isfinite(problem.price_nm2_per_s) and problem.price_nm2_per_s >= 0):
        raise ComputeError(f"the price of time must be finite and not negative, not {problem.price_nm2_per_s}")
    _check_weight(problem)
    _check_effect(problem)


def _check_weight(problem: DwellProblem) -> None:
    if problem.weight is None:
        return
    if problem.weight.shape != problem.effect.grid.shape:
        raise ComputeError(f"weight is {problem.weight.shape}, the effect's grid is {problem.effect.grid.shape}")
    inside = problem.weight[problem.solve_mask]
    if not (np.isfinite(inside).all() and (inside >= 0).all() and inside.any()):
        raise ComputeError("weight must be finite, not negative, and above 0 somewhere in solve_mask")


def _check_shapes(problem: DwellProblem) -> None:
    shape, n = problem.effect.grid.shape, problem.effect.n
    if n == 0:
        raise ComputeError("the effect has no dwell points")
    for name in ("target_nm", "solve_mask", "metric_mask"):
        if getattr(problem, name).shape != shape:
            raise ComputeError(f"{name} is {getattr(problem, name).shape}, the effect's grid is {shape}")
    for name in ("lower_s", "upper_s"):
        if getattr(problem, name).shape != (n,):
            raise ComputeError(f"{name} is {getattr(problem, name).shape}, the effect has {n} dwell points")


def _check_masks(problem: DwellProblem) -> None:
    if not problem.solve_mask.any():
        raise ComputeError("solve_mask is empty: no surface sample to polish")
    if not problem.metric_mask.any():
        raise ComputeError("metric_mask is empty: the clear aperture holds no sample")
    outside = int(np.count_nonzero(problem.metric_mask & ~problem.solve_mask))
    if outside:
        raise ComputeError(f"{outside} samples of metric_mask lie outside solve_mask")
    bad = int(np.count_nonzero(~np.isfinite(problem.target_nm[problem.solve_mask])))
    if bad:
        raise ComputeError(f"target_nm is not finite at {bad} samples of solve_mask")


def _check_bounds(problem: DwellProblem) -> None:
    lower, upper = problem.lower_s, problem.upper_s
    for trouble, wrong in (
        ("lower_s is not finite", ~np.isfinite(lower)),
        ("upper_s is NaN", np.isnan(upper)),
        ("lower_s is negative", lower < 0),
        ("lower_s is above upper_s", lower > upper),
    ):
        if wrong.any():
            point = int(np.argmax(wrong))
            where = f"at point {point} (lower {lower[point]:g} s, upper {upper[point]:g} s)"
            raise ComputeError(f"{trouble} {where}, {np.count_nonzero(wrong)} points in all")


def _check_effect(problem: DwellProblem) -> None:
    effect = problem.effect
    strength = effect.adjoint(problem.solve_mask.astype(np.float64))
    if strength.shape != (effect.n,):
        raise ComputeError(f"the effect's adjoint answers {strength.shape} for {effect.n} dwell points")
    entries = effect.matrix.data if isinstance(effect, SparseEffect) else strength
    least = -negligible_share(effect) * float(np.abs(strength).max())
    if not np.isfinite(entries).all():
        raise ComputeError("the effect is not finite")
    if (entries < least).any():
        raise ComputeError("the effect is negative somewhere: dwelling can only remove material")
    if not strength.any():
        raise ComputeError("the effect is zero at every sample of solve_mask: path and part do not meet")
