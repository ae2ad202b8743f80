"""A step of `spectral`: of two dwells that are drawn together, one goes down and the other keeps to its bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective
from polishd.process.spreading.effect import SpreadEffect

RELAXATION = 1.7
PULL, HARDER = 1.0, 1.5
"""How strongly the two dwells are drawn together at first, over the geometric mean of the objective's least and most
curvature; and how many times as strongly where they come no nearer. The weaker, the fewer steps, down to where a step
down does not follow any more: between 0.5 and 2, as path, part and spot are."""
LOOK_APART = 20
"""Steps between two looks at how far they are apart."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the most curvature is taken for this, in the pull only."""


@dataclass(frozen=True, slots=True)
class StepMetric:
    """About the objective's curvature and so much more, inverted; made by `metric`."""

    effect: SpreadEffect
    """In float32."""
    least: float
    """Curvature that no spot gives: the regularisation's."""
    square: FloatArray
    """(ny, nx // 2 + 1) curvature that a point on a node gives each frequency; on nodes of the effect's layout."""
    density: float
    """Points to a node."""
    pull: float
    """What is added to the curvature."""

    @property
    def held(self) -> float:
        """Curvature that no spot gives, and the pull."""
        return self.least + self.pull

    @property
    def share(self) -> NDArray[np.float32]:
        """What of each frequency the spots hold, over ``held``."""
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
    """Where the two dwells stand; (n,) each, s."""

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
    """Of the last step."""
    bend: FloatArray
    """(n,) nm^2/s: what it did to the slope."""
    steps: int = 0
    _apart: float = np.inf

    def seen(self, gradient: FloatArray) -> None:
        """The objective's gradient at ``bounded``, exactly: what the slope was off by is put right."""
        # of what is small: float32's floor is of that
        self.slope = gradient + self.f.rough_curvature(self.free - self.bounded)

    def step(self) -> None:
        """One step down in the metric, and one towards each other; drawn harder where that leads nowhere."""
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
        """Down to the least of all that the metric's way and the last step's can be combined to."""
        pull = self.near.pull
        uphill = self.slope + pull * (self.free - self.bounded + self.multiplier)
        way = self.near.inverse(-uphill)
        bend = self.f.rough_curvature(way)
        sizes = best_sizes(
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


def best_sizes(slopes: tuple[float, float], curvatures: tuple[float, float, float]) -> tuple[float, float]:
    """How far to go along two ways, down to the least of a quadratic.

    ``slopes`` along each, and ``curvatures``: of the first, of both, of the second; along the first only where the
    second is none of its own.
    """
    (a, b), (p, q, r) = slopes, curvatures
    across = p * r - q * q
    if across <= 1e-6 * p * r:
        return -a / p, 0.0
    return (q * b - r * a) / across, (q * a - p * b) / across


def metric(problem: DwellProblem, effect: SpreadEffect) -> StepMetric:
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
