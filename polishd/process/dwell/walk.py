"""A step of `spectral`: of two dwells that are drawn together, one goes down and the other keeps to its bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import Quadratic
from polishd.process.spreading.effect import SpreadEffect

RELAXATION = 1.7
PULL = 3.0
"""How strongly the two dwells are drawn together, over the geometric mean of the objective's least and most curvature.
At 1.5 a KKT residual of 1e-4 takes a quarter more steps, at 0.7 half as many again."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the most curvature is taken for this, in the pull only."""


@dataclass(frozen=True, slots=True)
class Metric:
    """About the objective's curvature and so much more, inverted; made by `metric`."""

    effect: SpreadEffect
    """In float32."""
    held: float
    """Curvature that no spot gives: regularisation and pull."""
    share: FloatArray
    """What of each frequency the spots hold, over ``held``; on nodes of the effect's layout."""

    def inverse(self, slope: FloatArray) -> FloatArray:
        """(n,) -> (n,): ``(held + S K* K S')^-1``, exact where the path lays down the same on every node."""
        where, weights = self.effect.where, self.effect.weights
        nodes = (weights.T @ slope.astype(self.share.dtype)).reshape(where.lattice)
        spectrum = scipy.fft.rfft2(nodes, where.size)
        back = scipy.fft.irfft2(self.share * spectrum, where.size)[: where.lattice[0], : where.lattice[1]]
        return np.asarray((slope - weights @ back.ravel()) / self.held, dtype=np.float64)


@dataclass(slots=True)
class Walk:
    """Where the two dwells stand; (n,) each, s."""

    problem: DwellProblem
    """Whose curvature steps are found with."""
    f: Quadratic
    """Its objective."""
    near: Metric
    pull: float
    """Between the two, nm^2/s^2."""
    bounded: FloatArray
    free: FloatArray
    """Without bounds."""
    slope: FloatArray
    """(n,) nm^2/s: the objective's gradient at ``free``."""
    multiplier: FloatArray

    def seen(self, gradient: FloatArray) -> None:
        """The objective's gradient at ``bounded``, exactly: what the slope was off by is put right."""
        # of what is small: float32's floor is of that
        self.slope = gradient + self.f.rough_curvature(self.free - self.bounded)

    def step(self) -> None:
        """One step down in the metric, and one towards each other."""
        uphill = self.slope + self.pull * (self.free - self.bounded + self.multiplier)
        way = self.near.inverse(-uphill)
        bend = self.f.rough_curvature(way)
        size = -float(uphill @ way) / float(way @ bend + self.pull * (way @ way))
        self.free = self.free + size * way
        self.slope = self.slope + size * bend
        drawn = RELAXATION * self.free + (1 - RELAXATION) * self.bounded + self.multiplier
        self.bounded = np.clip(drawn, self.problem.lower_s, self.problem.upper_s)
        self.multiplier = drawn - self.bounded


def metric(problem: DwellProblem, effect: SpreadEffect) -> tuple[Metric, float]:
    """The metric of a problem of that effect, and the pull between its two dwells, nm^2/s^2."""
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
    held = least + pull
    return Metric(effect.single(), held, (square / (held + density * square)).astype(np.float32)), pull
