"""What to ask for: the mean removal, and how strongly to hold the dwell down."""

from __future__ import annotations

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective, quadratic
from polishd.process.effect import Effect
from polishd.process.several import single
from polishd.process.spreading.effect import SpreadEffect

# Beyond it, float64 leaves fewer than four digits of what the regularisation alone holds.
ILL_CONDITIONED = 1e12


def choose_piston_nm(
    height_nm: FloatArray, solve_mask: BoolArray, least_removal_nm: FloatArray, unreached: float = 0.005
) -> float:
    """The mean removal to add to a surface so that it can be reached by removing only.

    The rule: the smallest piston p such that the removal wanted, ``height + p``, is not below what motion at the lower
    bound removes by itself, save at the fraction ``unreached`` of the samples (the deepest pits: to wait for a single
    scratch costs time over the whole part). How much to remove overall moves the residual more than any solver does:
    more piston buys more reach, and costs time in proportion.

    Args:
        height_nm: (ny, nx) surface, positive = high, finite in ``solve_mask``.
        solve_mask: (ny, nx) samples that count.
        least_removal_nm: (ny, nx) removal at the lower bound, ``effect.removal_nm(lower_s)``.
        unreached: fraction of the samples that may lie too deep, 0 <= unreached < 1.

    Returns:
        nm to add to ``height_nm`` to get the target.

    Raises:
        ComputeError: no samples, heights that are not finite, or a fraction out of range.
    """
    if not 0 <= unreached < 1:
        raise ComputeError(f"the fraction left unreached must be at least 0 and below 1, not {unreached}")
    needed = (least_removal_nm - height_nm)[solve_mask]
    if needed.size == 0:
        raise ComputeError("solve_mask is empty: no surface sample to polish")
    if not np.isfinite(needed).all():
        raise ComputeError("the surface is not finite everywhere in solve_mask")
    return float(np.quantile(needed, 1 - unreached, method="inverted_cdf"))


def sigma_max(effect: Effect, solve_mask: BoolArray, rounds: int = 200, tolerance: float = 1e-4) -> float:
    """Largest singular value of R over ``solve_mask``, nm/s, by power iteration.

    R is not negative, so that a positive start cannot miss it. Stops where a round gains less than ``tolerance``
    relative. Where the effect has a coarser one the vector is found with that, and its value with the effect itself: an
    error of the vector enters by its square.

    Raises:
        ComputeError: the effect is zero or not finite.
    """
    if isinstance(effect, SpreadEffect) and effect.coarse is not None:
        vector, _ = _largest(effect.coarse, effect.coarsely(solve_mask.astype(np.float64)), rounds, tolerance)
        return float(np.linalg.norm(effect.removal_nm(vector)[solve_mask]))
    return float(np.sqrt(_largest(single(effect), solve_mask.astype(np.float64), rounds, tolerance)[1]))


def _largest(effect: Effect, counts: FloatArray, rounds: int, tolerance: float) -> tuple[FloatArray, float]:
    """(n,) of length 1 and the eigenvalue of ``R' diag(counts) R``."""
    vector, value = np.full(effect.n, 1 / np.sqrt(effect.n)), 0.0
    for _ in range(rounds):
        vector = effect.adjoint(counts * effect.removal_nm(vector))
        last, value = value, float(np.linalg.norm(vector))
        if not np.isfinite(value) or value == 0:
            raise ComputeError("the effect is zero or not finite over solve_mask")
        vector /= value
        if value - last <= tolerance * value:
            break
    return vector, value


def regularisation_from_rho(effect: Effect, solve_mask: BoolArray, rho: float) -> float:
    """The P of paper eq. 50, nm^2/s^2, from the dimensionless ``rho = regularisation N_r / sigma_max^2``.

    Raises:
        ComputeError: rho is negative or not finite, no sample counts, or the effect is zero.
    """
    if not (np.isfinite(rho) and rho >= 0):
        raise ComputeError(f"regularisation rho must be finite and not negative, not {rho}")
    samples = int(np.count_nonzero(solve_mask))
    if samples == 0:
        raise ComputeError("solve_mask is empty: no surface sample to polish")
    return rho * sigma_max(effect, solve_mask) ** 2 / samples


def condition(problem: DwellProblem, f: QuadraticObjective | None = None) -> float:
    """Condition number of the Hessian, ``sigma_max^2 / (N_r regularisation) + 1``, at most; infinite without it.

    sigma_max by its bound, the largest row sum of ``R'R``: one product, and a few per cent above for wide parts.
    ``f`` is the problem's objective where it is at hand.
    """
    held = 2 * problem.regularisation
    return 1 / ((f or quadratic(problem)).safe_step * held) if held > 0 else float("inf")


def conditioning_note(problem: DwellProblem, f: QuadraticObjective | None = None) -> str | None:
    """What a certificate has to say of a regularisation that is too small for float64; None where it is not."""
    number = condition(problem, f)
    if number <= ILL_CONDITIONED:
        return None
    return (
        f"ill-conditioned: a regularisation of {problem.regularisation:.3g} nm^2/s^2 gives a condition number of "
        f"{number:.3g} (above {ILL_CONDITIONED:.0e}); where the residual hardly depends on a dwell, its time is "
        "arbitrary"
    )
