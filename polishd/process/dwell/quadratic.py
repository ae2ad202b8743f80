"""The dwell objective as a quadratic in t: value, gradient and Hessian products without ever forming the Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy import sparse

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.effect import Effect, SparseEffect
from polishd.process.several import single

Product = Callable[[FloatArray], FloatArray]
GRAM_SHARE = 0.4
"""Points that reach a sample over samples that a point reaches, at most, that R'R is worth having: it has about four
times the former a point, R and R' the latter each."""
GRAM_MOST = 32
"""Such points at most: to make R'R takes so many passes over R, and a solve some hundreds."""


@dataclass(frozen=True)
class QuadraticObjective:
    """``f(t) = |R t - h|^2 / N_r + regularisation |t|^2 + price sum(t)`` (eq. 50, with its square outside the sum).

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
    """Of a second of total time, nm^2/s."""
    gram: Product | None = None
    """(n,) s -> (n,): R'R, where that is quicker than R and R' one after the other."""
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
        """The same to float32, some 1e-6 of what they are at the lower bound, where that is quicker."""
        return self._at(time_s, *(self.roughly or (self.forward, self.backward)))

    def _at(self, time_s: FloatArray, forward: Product, backward: Product) -> tuple[float, FloatArray]:
        miss = forward(time_s) - self.target
        slope = 2 / self.target.size * backward(miss) + 2 * self.regularisation * time_s + self.price
        return self._value(time_s, miss), slope

    def _value(self, time_s: FloatArray, miss: FloatArray) -> float:
        held = self.regularisation * float(time_s @ time_s) + self.price * float(time_s.sum())
        return float(miss @ miss) / self.target.size + held

    @cached_property
    def safe_step(self) -> float:
        """s^2/nm^2: 1 / an upper bound of the Hessian's eigenvalues (its largest row sum: R is not negative)."""
        rows = self.backward(self.forward(np.ones(self.n)))  # once: not worth making R'R for
        largest = 2 / self.target.size * float(rows.max()) + 2 * self.regularisation
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
        """What R'R makes of a direction, in place made what the Hessian makes of it."""
        image *= 2 / self.target.size
        image += 2 * self.regularisation * direction
        return image


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
        rows = narrow(sparse.csr_array(sparse.csr_array(effect.matrix)[np.flatnonzero(mask.ravel())]))
        if problem.weight is not None:
            rows = narrow(sparse.csr_array(sparse.diags_array(root) @ rows))
        columns = narrow(sparse.csr_array(rows.T))
        return QuadraticObjective(
            rows.__matmul__, columns.__matmul__, target, effect.n, *rest, gram=_gram(rows, columns)
        )

    rough = single(effect)
    roughly = None if rough is effect else _products(rough, mask, root)
    return QuadraticObjective(*_products(effect, mask, root), target, effect.n, *rest, roughly=roughly)


def _gram(rows: sparse.csr_array, columns: sparse.csr_array) -> Product | None:
    """R'R of R and its transpose, where conjugate gradients are quicker by it; made when it is first asked for."""
    met = float((np.diff(rows.indptr).astype(np.float64) ** 2).sum()) / max(rows.nnz, 1)
    if met > min(GRAM_MOST, GRAM_SHARE * rows.nnz / max(rows.shape[1], 1)):
        return None
    made = cache(lambda: narrow(sparse.csr_array(columns @ rows)))
    return lambda direction: np.asarray(made() @ direction, dtype=np.float64)


def _products(effect: Effect, mask: BoolArray, root: FloatArray) -> tuple[Product, Product]:
    """R at the m samples of the mask, its rows times (m,) ``root``, and R transposed."""

    def backward(weight: FloatArray) -> FloatArray:
        spread = np.zeros(mask.shape)
        spread[mask] = root * weight
        return np.array(effect.adjoint(spread), dtype=np.float64)

    return lambda time_s: root * effect.removal_nm(time_s)[mask], backward


def narrow(matrix: sparse.csr_array) -> sparse.csr_array:
    """The same matrix with 32-bit indices where they suffice: a third less to read for each product."""
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
