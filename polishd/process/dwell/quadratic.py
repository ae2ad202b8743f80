"""The dwell objective as a quadratic in t: value, gradient and Hessian products without ever forming the Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.removal.combined_effect import to_float32
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.process.removal.spread_effect import SpreadEffect

Product = Callable[[FloatArray], FloatArray]
GRAM_SHARE = 0.4
"""Points that reach a sample over samples that a point reaches, at most, that R'R is worth having: it has about four
times the former a point, R and R' the latter each."""
GRAM_MOST = 32
"""Such points at most: to make R'R takes so many passes over R, and a solve some hundreds."""


@dataclass(frozen=True)
class QuadraticObjective:
    """``f(t) = |R t - h|^2 / N_r + regularisation |t|^2 + price sum(t) + |D t|^2`` (eq. 50, squared outside the sum).

    R is restricted to the m = N_r samples that count; with weights its rows, and h, carry their square roots.
    """

    forward: Product
    """(n,) s -> (m,) nm: R t."""
    backward: Product
    """(m,) -> (n,): R transposed."""
    target: FloatArray
    """(m,) nm: h."""
    n: int
    """Number of timed points."""
    regularisation: float
    """The P of eq. 50, nm^2/s^2."""
    price: float = 0.0
    """Price of a second of total time, nm^2/s."""
    gram: Product | None = None
    """(n,) s -> (n,): R'R, where that is quicker than R and R' one after the other."""
    feed_change: sparse.csr_array | None = None
    """(k, n) D, nm/s: ``|D t|^2`` adds to the objective."""
    roughly: tuple[Product, Product] | None = None
    """Both products in float32, where that is quicker: good for directions to search in, and for nothing else."""

    def value(self, time_s: FloatArray) -> float:
        """f(t), nm^2."""
        return self._value(time_s, self.forward(time_s) - self.target)

    def gradient(self, time_s: FloatArray) -> FloatArray:
        """(n,) nm^2/s: ``2 R'(R t - h) / N_r + 2 regularisation t + price``."""
        return self.at(time_s)[1]

    def at(self, time_s: FloatArray) -> tuple[float, FloatArray]:
        """`value` and `gradient`, by one product with R and one with R'."""
        return self._at(time_s, self.forward, self.backward)

    def rough_at(self, time_s: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient in float32 where that is faster; error some 1e-6 of the values at the lower bound."""
        return self._at(time_s, *(self.roughly or (self.forward, self.backward)))

    def _at(self, time_s: FloatArray, forward: Product, backward: Product) -> tuple[float, FloatArray]:
        miss = forward(time_s) - self.target
        slope = 2 / self.target.size * backward(miss) + 2 * self.regularisation * time_s + self.price
        if self.feed_change is not None:
            slope += 2 * (self.feed_change.T @ (self.feed_change @ time_s))
        return self._value(time_s, miss), slope

    def _value(self, time_s: FloatArray, miss: FloatArray) -> float:
        held = self.regularisation * float(time_s @ time_s) + self.price * float(time_s.sum())
        return float(miss @ miss) / self.target.size + held + feed_change_nm2(self.feed_change, time_s)

    @cached_property
    def safe_step(self) -> float:
        """s^2/nm^2: 1 / an upper bound of the Hessian's eigenvalues (its largest row sum: R is not negative)."""
        rows = self.backward(self.forward(np.ones(self.n)))  # once: not worth making R'R for
        largest = 2 / self.target.size * float(rows.max()) + 2 * self.regularisation
        if self.feed_change is not None:
            size = abs(self.feed_change)
            largest += 2 * float((size.T @ (size @ np.ones(self.n))).max())
        return 1 / largest if largest > 0 else 1.0

    def curvature(self, direction: FloatArray) -> FloatArray:
        """(n,) Hessian times a direction: ``2 R'R d / N_r + 2 regularisation d``."""
        if self.gram is not None:
            return self._bent(self.gram(direction), direction)
        return self._bent(self.backward(self.forward(direction)), direction)

    def rough_curvature(self, direction: FloatArray) -> FloatArray:
        """(n,) the same to float32 where that is quicker."""
        if self.roughly is None:
            return self.curvature(direction)
        forward, backward = self.roughly
        return self._bent(backward(forward(direction)), direction)

    def _bent(self, image: FloatArray, direction: FloatArray) -> FloatArray:
        """Turn R'R of a direction into the Hessian's product, in place."""
        image *= 2 / self.target.size
        image += 2 * self.regularisation * direction
        if self.feed_change is not None:
            image += 2 * (self.feed_change.T @ (self.feed_change @ direction))
        return image


def feed_change_nm2(rows: sparse.csr_array | None, time_s: FloatArray) -> float:
    """Return the change of feed in the objective, nm^2; 0 without one."""
    change = np.zeros(0) if rows is None else rows @ time_s
    return float(change @ change)


def quadratic(problem: DwellProblem) -> QuadraticObjective:
    """The objective of a problem that ``validation.check`` has passed.

    A SparseEffect is cut to the samples that count, with narrow indices: its products are memory traffic. Any other
    effect is used through its own two products.
    """
    mask, effect = problem.solve_mask, problem.effect
    root = np.ones(int(mask.sum())) if problem.weight is None else np.sqrt(problem.weight[mask])
    target = root * problem.target_nm[mask]
    rest = (problem.regularisation, problem.price_nm2_per_s)
    if isinstance(effect, SparseEffect):
        rows = use_32_bit_indices(sparse.csr_array(sparse.csr_array(effect.matrix)[np.flatnonzero(mask.ravel())]))
        if problem.weight is not None:
            rows = use_32_bit_indices(sparse.csr_array(sparse.diags_array(root) @ rows))
        columns = use_32_bit_indices(sparse.csr_array(rows.T))
        return QuadraticObjective(
            rows.__matmul__, columns.__matmul__, target, effect.n, *rest, _gram(rows, columns), problem.feed_change
        )

    rough = to_float32(effect)
    roughly = None if rough is effect else _products(rough, mask, root)
    products = _products(effect, mask, root)
    return QuadraticObjective(*products, target, effect.n, *rest, None, problem.feed_change, roughly)


def _gram(rows: sparse.csr_array, columns: sparse.csr_array) -> Product | None:
    """R'R of R and its transpose, where conjugate gradients are quicker by it; made when it is first asked for."""
    met = float((np.diff(rows.indptr).astype(np.float64) ** 2).sum()) / max(rows.nnz, 1)
    if met > min(GRAM_MOST, GRAM_SHARE * rows.nnz / max(rows.shape[1], 1)):
        return None
    made = cache(lambda: use_32_bit_indices(sparse.csr_array(columns @ rows)))
    return lambda direction: np.asarray(made() @ direction, dtype=np.float64)


def _products(effect: Effect, mask: BoolArray, root: FloatArray) -> tuple[Product, Product]:
    """R at the m samples of the mask, its rows times (m,) ``root``, and R transposed."""

    def backward(weight: FloatArray) -> FloatArray:
        spread = np.zeros(mask.shape)
        spread[mask] = root * weight
        return np.array(effect.adjoint(spread), dtype=np.float64)

    return lambda time_s: root * effect.removal_nm(time_s)[mask], backward


def use_32_bit_indices(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return the matrix with 32-bit indices where they suffice: a third less memory traffic for each product."""
    if max(matrix.nnz, *matrix.shape) >= np.iinfo(np.int32).max:
        return matrix
    parts = (matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32))
    return sparse.csr_array(parts, shape=matrix.shape)


def projected_gradient(
    gradient: FloatArray, time_s: FloatArray, lower: FloatArray, upper: FloatArray, step: float
) -> FloatArray:
    """(n,) nm^2/s: the gradient without what the bounds hold back, zero everywhere exactly at the minimum (KKT).

    It is how far a gradient step of length ``step`` (s^2/nm^2, at most 1 / largest curvature) leads within the bounds,
    over that length: so a point a hair off its bound counts for the hair, which an interior solution needs.
    """
    return (time_s - np.clip(time_s - step * gradient, lower, upper)) / step


def warm_start_s(problem: DwellProblem, f: QuadraticObjective) -> FloatArray | None:
    """(n,) s of the problem's warm start, within the bounds; None without one, or where the lower bound is better."""
    if problem.warm is None or problem.warm.time_s.shape != problem.lower_s.shape:
        return None
    start = np.clip(problem.warm.time_s, problem.lower_s, problem.upper_s)
    if not np.isfinite(start).all() or f.value(start) > f.value(problem.lower_s):
        return None
    return np.asarray(start, dtype=np.float64)


# What to ask for: the mean removal, and how strongly to hold the dwell down.

# Beyond it, float64 leaves fewer than four digits of what the regularisation alone holds.
ILL_CONDITIONED = 1e12


def choose_piston_nm(
    height_nm: FloatArray, solve_mask: BoolArray, least_removal_nm: FloatArray, unreachable: float = 0.005
) -> float:
    """The mean removal to add to a surface so that it can be reached by removing only.

    The rule: the smallest piston p such that the removal wanted, ``height + p``, is not below what motion at the lower
    bound already removes, save at the fraction ``unreachable`` of the samples (the deepest pits: to wait for a single
    scratch costs time over the whole part). How much to remove overall moves the residual more than any solver does:
    more piston buys more reach, and costs time in proportion.

    Args:
        height_nm: (ny, nx) surface, positive = high, finite in ``solve_mask``.
        solve_mask: (ny, nx) samples that count.
        least_removal_nm: (ny, nx) removal at the lower bound, ``effect.removal_nm(lower_s)``.
        unreachable: fraction of the samples that may lie too deep, 0 <= unreachable < 1.

    Returns:
        nm to add to ``height_nm`` to get the target.

    Raises:
        ComputeError: no samples, heights that are not finite, or a fraction out of range.
    """
    if not 0 <= unreachable < 1:
        raise ComputeError(f"the fraction left unreachable must be at least 0 and below 1, not {unreachable}")
    needed = (least_removal_nm - height_nm)[solve_mask]
    if needed.size == 0:
        raise ComputeError("solve_mask is empty: no surface sample to polish")
    if not np.isfinite(needed).all():
        raise ComputeError("the surface is not finite everywhere in solve_mask")
    return float(np.quantile(needed, 1 - unreachable, method="inverted_cdf"))


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
    return float(np.sqrt(_largest(to_float32(effect), solve_mask.astype(np.float64), rounds, tolerance)[1]))


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
    """Return the certificate's note on a regularization that is too small for float64; None where it is not."""
    number = condition(problem, f)
    if number <= ILL_CONDITIONED:
        return None
    return (
        f"ill-conditioned: a regularisation of {problem.regularisation:.3g} nm^2/s^2 gives a condition number of "
        f"{number:.3g} (above {ILL_CONDITIONED:.0e}); where the residual hardly depends on a dwell, its time is "
        "arbitrary"
    )
