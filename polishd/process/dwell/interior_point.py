"""Primal-dual interior point on a banded Cholesky factor: exact on medium-sized problems, whatever the regularisation.

Conjugate gradients need the more rounds the worse the problem is conditioned, and a long residual-against-time curve
ends where it is badly conditioned. Here a step costs one factorisation of ``R'R`` plus a diagonal, and there are 10 to
30 of them whatever the regularisation, the price and the number of points at rest on a bound.
(Mehrotra, SIAM J. Optim. 2 (1992) 575;
the bounds as in Nocedal and Wright, Numerical Optimization, ch. 16.6.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem, TimeLimit, check
from polishd.process.dwell.quadratic import QuadraticObjective, projected_gradient, quadratic, use_32_bit_indices
from polishd.process.removal.effect import SparseEffect

Indices = NDArray[np.int64]

NAME = "interior_point"
MAX_ROUNDS = 100
# The largest band: 1 GB with its factor, and about 5 s a factorisation on one core.
MAX_ENTRIES = 70_000_000
MAX_PRODUCTS = 200_000_000_000
# How far towards a bound a step goes.
REACH = 0.995
LEAST_START_S = 1e-12
# Of the largest entry, on the diagonal: what keeps the factor of a Hessian that is singular to float64 alive. The
# gradient is exact all the same, so that it slows the last steps and does not move the minimum.
JITTER = 1e-15


def solve(problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-8) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve; its effect must be a SparseEffect. Warm starts do not help here and are not used.
        within_s: CPU seconds for the whole call (see TimeLimit), looked at before each factorisation; when they are
            over, the best dwell so far is returned. It is always inside the bounds, and its certificate says
            ``deadline``.
        kkt_tolerance: the KKT residual (see Certificate) and the relative duality gap to stop at.

    Returns:
        The dwell with its certificate; a note gives the duality gap, which bounds how far above the minimum the
        objective can be.

    Raises:
        ComputeError: the problem is malformed, its effect is no matrix, or the factor would not fit.
    """
    limit = TimeLimit(within_s)
    check(problem)
    f = quadratic(problem)
    lower, upper = problem.lower_s, problem.upper_s
    reaches = problem.effect.adjoint(problem.solve_mask.astype(np.float64)) > 0
    free = reaches & (lower < upper)  # no tolerance may spend time where nothing is removed
    best, rounds, stopped, gap = lower, 0, "converged", 0.0
    if free.any():
        hessian = BandedHessian.of(problem, free)
        inside = _Interior(f, hessian, lower, upper)
        best, rounds, stopped, gap = inside.run(kkt_tolerance, limit.expired)
    return certify_dwell(
        problem,
        best,
        solver=NAME,
        iterations=rounds,
        seconds=limit.cpu_s,
        stopped=stopped,
        notes=(f"duality gap {gap:.3g} nm^2",),
    )


@dataclass(frozen=True, slots=True)
class BandedHessian:
    """``2 R'R / N_r + 2 regularisation`` of k points, in an order of small bandwidth; factorised with any diagonal."""

    order: Indices
    """(k,) the points, as they stand in the band."""
    band: FloatArray
    """(b + 1, k) nm^2/s^2 in LAPACK's lower form: ``band[i - j, j]``."""

    @classmethod
    def of(cls, problem: DwellProblem, points: BoolArray) -> BandedHessian:
        """Of the points (n,) that may move; from the effect matrix over ``solve_mask``, weighted.

        Raises:
            ComputeError: the effect is no matrix, or this would not fit into memory or time.
        """
        effect = problem.effect
        if not isinstance(effect, SparseEffect):
            raise ComputeError(f"{NAME} needs an effect matrix, not a {type(effect).__name__}: use another solver")
        where = np.flatnonzero(points)
        rows = sparse.csr_array(sparse.csr_array(effect.matrix)[np.flatnonzero(problem.solve_mask.ravel())][:, where])
        _refuse_above(MAX_PRODUCTS, float((np.diff(rows.indptr).astype(np.float64) ** 2).sum()), where.size)
        weight = np.ones(rows.shape[0]) if problem.weight is None else problem.weight[problem.solve_mask]
        rows = use_32_bit_indices(sparse.csr_array(sparse.diags_array(np.sqrt(2 * weight / weight.size)) @ rows))
        product = sparse.csr_array(rows.T @ rows)
        if problem.feed_change is not None:
            change = sparse.csr_array(problem.feed_change[:, where])
            product = sparse.csr_array(product + 2 * (change.T @ change))
        order, row, column = _in_order(product)
        width = int(np.abs(row - column).max(initial=0)) + 1
        _refuse_above(MAX_ENTRIES, float(where.size * width), where.size)
        _refuse_above(MAX_PRODUCTS, float(where.size * width**2), where.size)
        band, below = np.zeros((width, where.size)), row >= column
        band[(row - column)[below], column[below]] = product.data[below]
        band[0] += 2 * problem.regularisation
        return cls(where[order], band)

    def factor(self, diagonal: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """The solver of ``(H + diag) x = y``, all (k,) in this order."""
        matrix = self.band.copy()
        matrix[0] += diagonal
        jitter = JITTER * float(self.band[0].max())
        while True:
            try:
                factor = scipy.linalg.cholesky_banded(matrix, lower=True, check_finite=False)
            except scipy.linalg.LinAlgError:
                matrix[0] += jitter
                jitter *= 10
                continue
            return lambda y: np.asarray(scipy.linalg.cho_solve_banded((factor, True), y, check_finite=False))


def _in_order(matrix: sparse.csr_array) -> tuple[Indices, Indices, Indices]:
    """(k,) an order that keeps what is coupled close together, and each entry's row and column in it."""
    row, column = matrix.tocoo().coords

    def placed(order: Indices) -> tuple[Indices, Indices, Indices]:
        place = np.empty_like(order)
        place[order] = np.arange(order.size)
        return order, place[row], place[column]

    as_given = np.arange(matrix.shape[0])
    found = np.asarray(scipy.sparse.csgraph.reverse_cuthill_mckee(matrix, symmetric_mode=True), dtype=np.int64)
    return min(placed(as_given), placed(found), key=lambda o: int(np.abs(o[1] - o[2]).max(initial=0)))


def _refuse_above(most: float, needed: float, points: int) -> None:
    if needed > most:
        raise ComputeError(
            f"{NAME} would need {needed:.3g} entries or products for these {points} points, "
            f"it takes {most:.3g} at most: use another solver"
        )


@dataclass(frozen=True, slots=True)
class _State:
    """The variables, or a direction of them: (k,) each, all above 0 inside.

    The rooms are variables of their own: as differences of dwell and bound they would vanish in rounding.
    """

    below: FloatArray
    """s, from the lower bound up to the dwell."""
    above: FloatArray
    """s, from the dwell up to the upper bound; 1 and constant where that is infinite."""
    low: FloatArray
    """nm^2/s, multiplier of the lower bound."""
    high: FloatArray
    """nm^2/s, multiplier of the upper bound; 0 and constant where that is infinite."""

    def along(self, way: _State, length: float) -> _State:
        """So far along a direction."""
        return _State(*(getattr(self, name) + length * getattr(way, name) for name in self.__slots__))

    @property
    def gap(self) -> float:
        """nm^2: the duality gap, once the gradient is balanced."""
        return float(self.low @ self.below + self.high @ self.above)


class _Interior:
    """One run: the problem in the Hessian's order."""

    def __init__(self, f: QuadraticObjective, hessian: BandedHessian, lower: FloatArray, upper: FloatArray) -> None:
        self._f, self._hessian, self._order = f, hessian, hessian.order
        self._bounds = lower, upper
        self._room = (upper - lower)[self._order]
        self._closed = np.isfinite(self._room)
        self._count = self._room.size + int(self._closed.sum())
        self._step = f.safe_step

    def run(self, tolerance: float, expired: Callable[[], bool]) -> tuple[FloatArray, int, str, float]:
        """(n,) best dwell, s; rounds; why it stopped; its duality gap, nm^2."""
        lower, upper = self._bounds
        at_lower = self._f.gradient(lower)
        enough = tolerance * float(np.abs(at_lower).max())
        now = self._start(at_lower)
        best, best_value, best_gap = lower, self._f.value(lower), float("inf")
        for rounds in range(MAX_ROUNDS):
            time_s = self._snapped(now)
            value, gradient = self._f.at(time_s)
            if value < best_value:
                best, best_value, best_gap = time_s, value, now.gap
            left = projected_gradient(gradient, time_s, lower, upper, self._step)
            if float(np.abs(left).max()) <= enough and now.gap <= tolerance * abs(value):
                return time_s, rounds, "converged", now.gap
            if expired():
                return best, rounds, "deadline", best_gap
            now = self._advance(now)
        return best, MAX_ROUNDS, "iterations", best_gap

    def _start(self, at_lower: FloatArray) -> _State:
        """Well inside the bounds: everywhere the dwell that is best where it is the same everywhere."""
        removal = self._f.forward(np.ones(at_lower.size))  # once: not worth making R'R for
        bend = 2 * (float(removal @ removal) / removal.size + self._f.regularisation * at_lower.size)
        size = max(-float(at_lower.sum()), float(np.abs(at_lower).mean())) / bend if bend > 0 else 1.0
        below = np.minimum(max(size, LEAST_START_S), self._room / 2)
        push = np.full(below.size, float(np.abs(at_lower).mean()) or 1.0)
        above = np.where(self._closed, self._room - below, 1.0)
        return _State(below, above, push, np.where(self._closed, push, 0.0))

    def _time(self, below: FloatArray) -> FloatArray:
        """(n,) s, whatever the rounding within the bounds."""
        lower, upper = self._bounds
        time_s = lower.copy()
        time_s[self._order] += below
        return np.minimum(time_s, upper)

    def _snapped(self, now: _State) -> FloatArray:
        """(n,) the dwell, with what is about to reach a bound put on it: its multiplier outweighs its room there."""
        bend = 1 / self._step
        below = np.where(now.low > bend * now.below, 0.0, now.below)
        return self._time(np.where(now.high > bend * now.above, self._room, below))

    def _advance(self, now: _State) -> _State:
        """Mehrotra's predictor and corrector, one factorisation for both."""
        dual = self._f.gradient(self._time(now.below))[self._order] - now.low + now.high
        back = self._hessian.factor(now.low / now.below + now.high / now.above)

        def direction(low: FloatArray, high: FloatArray) -> _State:
            """The Newton step that brings ``multiplier * room`` to these products."""
            to_low, to_high = low / now.below - now.low, np.where(self._closed, high / now.above - now.high, 0.0)
            x = back(-dual + to_low - to_high)
            return _State(
                below=x,
                above=np.where(self._closed, -x, 0.0),
                low=to_low - now.low / now.below * x,
                high=to_high + now.high / now.above * x,
            )

        zero = np.zeros_like(now.below)
        ahead = direction(zero, zero)
        mean = now.gap / self._count
        reached = now.along(ahead, self._longest(now, ahead)).gap / self._count
        centre = mean * (reached / mean) ** 3
        way = direction(centre - ahead.below * ahead.low, centre - ahead.above * ahead.high)
        return now.along(way, min(1.0, REACH * self._longest(now, way)))

    def _longest(self, now: _State, way: _State) -> float:
        """Return the largest step along ``way``, at most 1, that keeps everything above 0."""
        shares = [-way.below / now.below, -way.above / now.above, -way.low / now.low]
        shares.append(-way.high[self._closed] / now.high[self._closed])
        return 1 / max(1.0, *(float(share.max(initial=0.0)) for share in shares))
