"""A step of `alternating_directions`: of two dwells that are drawn together, one goes down, one keeps to its bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective
from polishd.process.removal.spread_effect import SpreadEffect

RELAXATION = 1.7
PULL, HARDER = 1.0, 1.5
"""Initial coupling of the two dwells, over the geometric mean of the objective's least and most curvature, and its
factor where they do not approach each other. A weaker coupling needs fewer steps, down to a value between 0.5 and 2
(by path, part and spot) below which the steps do not converge."""
LOOK_APART = 20
"""Steps between two checks of the distance between them."""
LEAST_REGULARISATION = 1e-5
"""Least regularization for the pull, as a share of the most curvature."""


@dataclass(frozen=True, slots=True)
class StepMetric:
    """About the objective's curvature and so much more, inverted; made by `step_metric`."""

    effect: SpreadEffect
    """Effect in float32."""
    least: float
    """Curvature that no spot gives: the regularisation's."""
    square: FloatArray
    """(ny, nx // 2 + 1) curvature that a point on a node gives each frequency; on nodes of the effect's layout."""
    density: float
    """Points to a node."""
    pull: float
    """Curvature that the coupling adds."""

    @property
    def held(self) -> float:
        """Curvature that no spot gives, and the pull."""
        return self.least + self.pull

    @property
    def share(self) -> NDArray[np.float32]:
        """Return the spots' share of the curvature at each frequency, over ``held``."""
        return (self.square / (self.held + self.density * self.square)).astype(np.float32)

    def inverse(self, slope: FloatArray) -> FloatArray:
        """(n,) -> (n,): ``(held + S K* K S')^-1``, exact where the path lays down the same on every node."""
        where, weights, share = self.effect.where, self.effect.weights, self.share
        nodes = (weights.T @ slope.astype(share.dtype)).reshape(where.lattice)
        spectrum = scipy.fft.rfft2(nodes, where.size)
        back = scipy.fft.irfft2(share * spectrum, where.size)[: where.lattice[0], : where.lattice[1]]
        return np.asarray((slope - weights @ back.ravel()) / self.held, dtype=np.float64)


@dataclass(slots=True)
class AlternatingStep:
    """State of the two dwells; (n,) each, s."""

    problem: DwellProblem
    """Whose curvature steps are found with."""
    f: QuadraticObjective
    """Its objective."""
    near: StepMetric
    bounded: FloatArray
    free: FloatArray
    """Without bounds."""
    slope: FloatArray
    """(n,) nm^2/s: the objective's gradient at ``free``."""
    multiplier: FloatArray
    way: FloatArray
    """Direction of the last step."""
    bend: FloatArray
    """(n,) nm^2/s: what it did to the slope."""
    steps: int = 0
    _apart: float = np.inf

    def correct_slope(self, gradient: FloatArray) -> None:
        """Correct the slope by the exact gradient of the objective at ``bounded``."""
        # float32 products of the small difference: their rounding error is relative to it
        self.slope = gradient + self.f.rough_curvature(self.free - self.bounded)

    def step(self) -> None:
        """Take one step down in the metric and one towards each other; increase the pull where they do not approach."""
        self._go()
        self.steps += 1
        if self.steps % LOOK_APART == 0:
            apart = float(np.linalg.norm(self.free - self.bounded))
            if apart > self._apart:
                self._draw(HARDER * self.near.pull)
                apart = np.inf
            self._apart = apart

    def _draw(self, pull: float) -> None:
        self.multiplier *= self.near.pull / pull
        self.near = replace(self.near, pull=pull)

    def _go(self) -> None:
        """Minimize over all combinations of the metric's direction and the last step's."""
        pull = self.near.pull
        uphill = self.slope + pull * (self.free - self.bounded + self.multiplier)
        way = self.near.inverse(-uphill)
        bend = self.f.rough_curvature(way)
        sizes = step_sizes(
            (float(uphill @ way), float(uphill @ self.way)),
            (
                float(way @ bend + pull * (way @ way)),
                float(way @ self.bend + pull * (way @ self.way)),
                float(self.way @ self.bend + pull * (self.way @ self.way)),
            ),
        )
        self.way, self.bend = (sizes[0] * new + sizes[1] * old for new, old in ((way, self.way), (bend, self.bend)))
        self.free = self.free + self.way
        self.slope = self.slope + self.bend
        drawn = RELAXATION * self.free + (1 - RELAXATION) * self.bounded + self.multiplier
        self.bounded = np.clip(drawn, self.problem.lower_s, self.problem.upper_s)
        self.multiplier = drawn - self.bounded


def step_sizes(slopes: tuple[float, float], curvatures: tuple[float, float, float]) -> tuple[float, float]:
    """Step sizes along two directions to the minimum of a quadratic.

    ``slopes`` along each, and ``curvatures``: of the first, of both, of the second. Only along the first where the
    second does not differ from it.
    """
    (a, b), (p, q, r) = slopes, curvatures
    across = p * r - q * q
    if across <= 1e-6 * p * r:
        return -a / p, 0.0
    return (q * b - r * a) / across, (q * a - p * b) / across


def step_metric(problem: DwellProblem, effect: SpreadEffect) -> StepMetric:
    """The metric of a problem of that effect, with the pull that is tried first."""
    kernel = np.tensordot(effect.coefficients.mean(axis=0), effect.spectra, axes=1)
    mask, weight = (
        problem.solve_mask,
        1.0 if problem.weight is None else float(problem.weight[problem.solve_mask].mean()),
    )
    flat = float(np.median(effect.removal_nm(np.ones(effect.n))[mask]))
    density = flat / float(kernel[0, 0].real)  # points to a node
    square = np.abs(kernel) ** 2 * (2 * weight / (np.count_nonzero(mask) * effect.finer**2))
    least, most = 2 * problem.regularisation, density * float(square.max())
    pull = PULL * float(np.sqrt(max(least, LEAST_REGULARISATION * most) * most))
    return StepMetric(effect.single(), least, square, density, pull)
