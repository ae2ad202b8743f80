"""The parameters that a removal map and what was known before make most likely (Gauss-Newton, after Levenberg)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.identification.forward import BlockEffects, ForwardModel
from polishd.process.identification.parameters import PriorKnowledge
from polishd.process.identification.passes import RemovalNoise

HUBER = 1.5
"""Standard deviations from which the robust fit counts a residual by its size, not its square."""
SETTLED = 0.03
"""A step of so many standard errors in all is the last."""
MISFIT = 1e-3
"""Of the loss: a step that lowers it by less is the last one, too, where no parameters fit the map at all, and of a
robust fit, which is asked for outliers and noise only."""
STEPS = 40
DAMPINGS = 8
LEAST_DAMPING, EASED = 1e-3, 8.0
"""Of a step that does not lower the loss by itself, and by how much less the next one is damped."""


@dataclass(frozen=True, slots=True)
class MapFit:
    """The most likely parameters, and the normal distribution about them."""

    theta: FloatArray
    """(k,)"""
    covariance: FloatArray
    """(k, k)"""
    residual_nm: FloatArray
    """(N,) measured less modelled."""
    laid: BlockEffects
    """The effect at theta, or near it."""
    columns: FloatArray
    """(N, k) nm over each parameter's unit."""
    log_evidence: float
    """Natural logarithm of the data's density by this model (Laplace), up to a constant of data and noise."""


@dataclass(frozen=True, slots=True)
class Data:
    """N samples, and which of them count."""

    removal_nm: FloatArray
    """(N,)"""
    keep: BoolArray
    """(N,)"""
    noise: RemovalNoise
    cells: float
    """Samples that count as one (`Noise.cells`)."""


def estimate(
    model: ForwardModel,
    data: Data,
    prior: PriorKnowledge,
    *,
    robust: bool = False,
    start: FloatArray | None = None,
    near: BlockEffects | None = None,
) -> MapFit:
    """Most likely parameters of a forward model.

    Correlated noise is counted as fewer samples: right for parameters that change over more than its width, and too
    wide an error for those that change over less.

    Args:
        model: the forward model.
        data: what was measured.
        prior: what was known.
        robust: count outliers by their size (Huber); else by their square.
        start: (k,) where to begin; None: at the prior's mean.
        near: an effect whose slopes are taken for this one's; None: they are computed at the start.

    Raises:
        ComputeError: it did not settle.
    """
    aim = _Aim(model, data, prior, HUBER * data.noise.sigma_nm if robust else np.inf)
    theta = prior.mean.copy() if start is None else start.copy()
    laid = model.lay(theta, None if near is None else near.slopes)
    at = aim.at(theta, laid)
    damping = 0.0
    for _ in range(STEPS):
        columns = model.columns(at.theta, at.laid)
        weight = aim.weight(at.residual_nm)
        hessian = columns.T @ (columns * weight[:, None]) + aim.precision
        downhill = columns.T @ (weight * at.residual_nm) - aim.precision @ (at.theta - prior.mean)
        after, damping = _step(aim, at, hessian, downhill, damping)
        if damping >= LEAST_DAMPING / EASED and after is not at:  # the slopes of where it began lead no further
            after = aim.at(after.theta, model.lay(after.theta))
        moved, gained, at = after.theta - at.theta, at.loss - after.loss, after
        if float(moved @ hessian @ moved) < SETTLED**2:
            break
        if (robust or at.loss > data.removal_nm.size) and gained < MISFIT * at.loss:
            break
    else:
        raise ComputeError(f"the fit of the removal did not settle in {STEPS} steps: is this the map of this pass?")
    covariance = np.linalg.inv(hessian)
    evidence = -at.loss + (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(prior.covariance)[1]) / 2
    return MapFit(at.theta, covariance, at.residual_nm, at.laid, columns, float(evidence))


@dataclass(frozen=True, slots=True)
class _Point:
    """Parameters, with what follows of them."""

    theta: FloatArray
    laid: BlockEffects
    loss: float
    residual_nm: FloatArray


class _Aim:
    """What is to be small: half the squares of residual and of departure from the prior, in standard deviations."""

    def __init__(self, model: ForwardModel, data: Data, prior: PriorKnowledge, bend_nm: float) -> None:
        self.model, self.data, self.prior, self.bend_nm = model, data, prior, bend_nm
        self.precision = np.linalg.inv(prior.covariance)
        self.scale = 1 / (data.noise.sigma_nm**2 * data.cells)

    def at(self, theta: FloatArray, laid: BlockEffects) -> _Point:
        return _Point(theta, laid, *self.loss(theta, laid))

    def loss(self, theta: FloatArray, laid: BlockEffects) -> tuple[float, FloatArray]:
        """The loss, and the (N,) residual; 0 where a sample does not count."""
        residual = np.where(self.data.keep, self.data.removal_nm - self.model.removal_nm(theta, laid), 0.0)
        size = abs(residual)
        inner = np.minimum(size, self.bend_nm)
        off = theta - self.prior.mean
        return float(self.scale * (inner * (size - inner / 2)).sum() + off @ self.precision @ off / 2), residual

    def weight(self, residual_nm: FloatArray) -> FloatArray:
        """(N,) 1/nm^2 of each residual."""
        return np.asarray(
            self.scale * self.data.keep * np.minimum(1.0, self.bend_nm / np.maximum(abs(residual_nm), 1e-12))
        )


def _step(aim: _Aim, at: _Point, hessian: FloatArray, downhill: FloatArray, damping: float) -> tuple[_Point, float]:
    """The next point, not higher than this one, and the damping to try next."""
    for _ in range(DAMPINGS):
        damped = hessian + damping * np.diag(np.diag(hessian))
        theta = at.theta + scipy.linalg.solve(damped, downhill, assume_a="pos")
        laid = at.laid if aim.model.near(theta, at.laid) else aim.model.lay(theta, at.laid.slopes)
        after = aim.at(theta, laid)
        if after.loss <= at.loss + SETTLED**2:
            return after, damping / EASED
        damping = max(4 * damping, LEAST_DAMPING)
    if float(downhill @ scipy.linalg.solve(hessian, downhill, assume_a="pos")) < 1:
        return at, damping  # within a standard error: a measured spot turns in steps, and the loss has some of them
    raise ComputeError(f"the fit of the removal did not settle: no step from a loss of {at.loss:.6g} lowers it")
