"""The dwell problem (paper eq. 50, with bounds) and its time limit: what every solver is given.

The limit is in CPU seconds, which a busy machine does not use up, with a wall-clock backstop.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import scipy

from polishd.model.dwell import Start
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.removal.effect import Effect, SparseEffect


@dataclass(frozen=True, slots=True)
class DwellProblem:
    """``min sum_k weight_k (R t - h)_k^2 / N_r + regularisation ||t||^2 + price sum(t)`` over ``solve_mask``, bounded.

    N_r is the number of samples in ``solve_mask``; without weights and price it is paper eq. 50 with bounds. The square
    of the change of feed between neighboring blocks may add to it.
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
    feed_change: scipy.sparse.csr_array | None = field(default=None, repr=False)
    """(k, n) nm/s: the squares of its products with the dwell add to the objective (`feed_change_rows`); None: none."""
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
    _check_feed_change(problem)
    _check_effect(problem)


def require_no_feed_change(problem: DwellProblem, solver: str) -> None:
    """ComputeError where the problem has a term that the solver does not know."""
    if problem.feed_change is not None:
        raise ComputeError(
            f"{solver} does not know the change of feed in the objective: use auto, newton_cg, interior_point or qp, "
            "or set dwell.feed_change = 0"
        )


def _check_feed_change(problem: DwellProblem) -> None:
    rows = problem.feed_change
    if rows is None:
        return
    if rows.shape[1] != problem.effect.n:
        raise ComputeError(f"feed_change is of {rows.shape[1]} dwell points, the effect has {problem.effect.n}")
    if not np.isfinite(rows.data).all():
        raise ComputeError("feed_change is not finite")


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


# Time limit of a solve.

SLOWEST = 10.0
"""Wall seconds for each CPU second that a busy machine may take."""
IDLE_S = 60.0
"""And so many more for what uses no CPU: a licence server that is asked, memory that was swapped out."""


def backstop_s(within_s: float) -> float:
    """Wall seconds after which a limit of so many CPU seconds is over, whatever was computed."""
    return SLOWEST * within_s + IDLE_S


class TimeLimit:
    """CPU seconds of the thread that makes it and asks it, counted from then on; `backstop_s` stands behind them.

    Of the thread and not of the process: how many threads BLAS lets spin beside it depends on the computer.
    """

    def __init__(self, within_s: float) -> None:
        self._within_s = within_s
        self._cpu, self._wall = time.thread_time(), time.monotonic()

    @property
    def cpu_s(self) -> float:
        """CPU seconds used."""
        return time.thread_time() - self._cpu

    @property
    def wall_s(self) -> float:
        """Wall seconds gone by."""
        return time.monotonic() - self._wall

    @property
    def left_s(self) -> float:
        """CPU seconds left; 0 when the limit is over."""
        return 0.0 if self.expired() else self._within_s - self.cpu_s

    def expired(self) -> bool:
        """Return whether the limit is over."""
        return self.cpu_s >= self._within_s or self.wall_s >= backstop_s(self._within_s)

    def __str__(self) -> str:
        """Return the used times as text."""
        return f"{self.cpu_s:.1f} s of CPU time and {self.wall_s:.1f} s of wall time"
