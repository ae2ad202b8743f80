"""Robust fit of all parameters to one map: without outliers, with the estimated noise of map and model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.identification.forward_model import BlockEffects, ForwardModel
from polishd.process.identification.parameters import PriorKnowledge, RemovalMap, RemovalNoise
from polishd.process.removal.tif import HertzSpot

# Maximum a posteriori estimate of the parameters from a removal map (Gauss-Newton, after Levenberg).

HUBER = 1.5
"""Standard deviations from which the robust fit counts a residual by its size, not its square."""
SETTLED = 0.03
"""Length of the last step, in standard errors."""
MISFIT = 1e-3
"""Relative decrease of the loss in the last step of a robust fit, or where no parameters fit the map."""
STEPS = 40
DAMPINGS = 8
LEAST_DAMPING, EASED = 1e-3, 8.0
"""Least damping after a step that does not lower the loss, and the factor by which the next step is damped less."""


@dataclass(frozen=True, slots=True)
class MapFit:
    """Most likely parameters and their normal posterior."""

    theta: FloatArray
    """(k,)"""
    covariance: FloatArray
    """(k, k)"""
    residual_nm: FloatArray
    """(N,) measured less modeled."""
    laid: BlockEffects
    """The effect at theta, or near it."""
    columns: FloatArray
    """(N, k) nm over each parameter's unit."""
    log_evidence: float
    """Natural logarithm of the data's density by this model (Laplace), up to a constant of data and noise."""


@dataclass(frozen=True, slots=True)
class FitSamples:
    """N samples, and the mask of those that count."""

    removal_nm: FloatArray
    """(N,)"""
    keep: BoolArray
    """(N,)"""
    noise: RemovalNoise
    cells: float
    """Samples that count as one (`Noise.cells`)."""


def estimate(
    model: ForwardModel,
    data: FitSamples,
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
        if damping >= LEAST_DAMPING / EASED and after is not at:  # the slopes at the start lead no further
            after = aim.at(after.theta, model.lay(after.theta))
        moved, gained, at = after.theta - at.theta, at.loss - after.loss, after
        if float(moved @ hessian @ moved) < SETTLED**2:
            break
        if (robust or at.loss > data.removal_nm.size) and gained < MISFIT * at.loss:
            break
    else:
        raise ComputeError(
            f"the fit of the removal did not converge in {STEPS} steps. Check that the map is of this pass"
        )
    covariance = np.linalg.inv(hessian)
    evidence = -at.loss + (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(prior.covariance)[1]) / 2
    return MapFit(at.theta, covariance, at.residual_nm, at.laid, columns, float(evidence))


@dataclass(frozen=True, slots=True)
class _Point:
    """Parameters with their effect, loss and residual."""

    theta: FloatArray
    laid: BlockEffects
    loss: float
    residual_nm: FloatArray


class _Aim:
    """Return the loss: half the squares of residual and of departure from the prior, in standard deviations."""

    def __init__(self, model: ForwardModel, data: FitSamples, prior: PriorKnowledge, bend_nm: float) -> None:
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
    """Return the next point, not higher than this one, and the damping to try next."""
    for _ in range(DAMPINGS):
        damped = hessian + damping * np.diag(np.diag(hessian))
        theta = at.theta + scipy.linalg.solve(damped, downhill, assume_a="pos")
        laid = at.laid if aim.model.near(theta, at.laid) else aim.model.lay(theta, at.laid.slopes)
        after = aim.at(theta, laid)
        if after.loss <= at.loss + SETTLED**2:
            return after, damping / EASED
        damping = max(4 * damping, LEAST_DAMPING)
    if float(downhill @ scipy.linalg.solve(hessian, downhill, assume_a="pos")) < 1:
        return at, damping  # within a standard error: a measured spot turns in steps, so the loss has steps
    raise ComputeError(f"the fit of the removal did not converge: no step from a loss of {at.loss:.6g} lowers it")


# Residual of a fit: its size, its correlation area, and its outliers.

NORMAL = 1.4826
"""Standard deviation over the median of the magnitudes, of a normal distribution."""
OUTLIER = 4.5
"""Standard deviations from which a sample, or the mean of a window, is an outlier: 1 of 150,000 by chance."""
WINDOW = 3
"""Samples across the window, for bumps wider than a sample."""
LOCAL = 0.1
"""Largest share of outliers that is local; with more the model does not fit."""
NEGLIGIBLE = 0.05
"""Correlation below which the noise of two samples counts as independent."""


def outliers(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise, pitch_mm: float) -> BoolArray:
    """(ny, nx) outliers: pits, drop-outs read as heights, local bumps, and their rims.

    Outliers of more than `LOCAL` of the map stay, and so do single samples: they are not local.

    Args:
        residual_nm: (ny, nx) of a robust fit of all parameters.
        mask: (ny, nx) samples with data.
        noise: what is stated of the map.
        pitch_mm: of the grid.
    """
    left = np.where(mask, residual_nm - np.median(residual_nm[mask]), 0.0)
    sigma = size_nm(left, mask, noise)
    alone = mask & (abs(left) > OUTLIER * sigma)
    calm = mask & ~alone
    total = _box(np.where(calm, left, 0.0))
    count = np.rint(_box(calm.astype(np.float64)))
    apart = np.sqrt(np.maximum(count, 1) * noise.cells(pitch_mm))
    raised = (count >= WINDOW) & (abs(total) > OUTLIER * sigma * apart)
    alone = scipy.ndimage.binary_dilation(alone)
    for found in (mask & (alone | raised), mask & alone):
        if found.sum() <= LOCAL * mask.sum():
            return np.asarray(found, dtype=np.bool_)
    return np.zeros_like(mask)


def size_nm(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise) -> float:
    """Standard deviation of a residual by its median magnitude; not less than the map's stated noise."""
    return max(noise.sigma_nm, NORMAL * float(np.median(abs(residual_nm[mask]))))


def own_noise(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise, pitch_mm: float) -> RemovalNoise:
    """Return the noise of a fit: the stated noise, or the residual where that is larger.

    The area is the sum of the residual's autocorrelation over the rings of lags, out to the first that is negligible.
    """
    left = np.where(mask, residual_nm - residual_nm[mask].mean(), 0.0)
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in mask.shape]
    power, count = (
        scipy.fft.irfft2(abs(scipy.fft.rfft2(v, shape)) ** 2, shape) for v in (left, mask.astype(np.float64))
    )
    rows, columns = (np.fft.fftfreq(n, 1 / n) for n in shape)
    ring = np.rint(np.hypot(rows[:, None], columns[None, :])).astype(int)
    reach = min(mask.shape) // 4
    near = (ring <= reach) & (count > 0.5)
    pairs = np.bincount(ring[near], count[near], minlength=reach + 1)
    alike = np.bincount(ring[near], power[near], minlength=reach + 1) / np.maximum(pairs, 1)
    lags = np.bincount(ring[near], minlength=reach + 1)
    correlation = alike / alike[0] if alike[0] > 0 else np.eye(1, reach + 1)[0]
    end = int(np.argmax(correlation < NEGLIGIBLE)) or reach
    cells = float((correlation * lags)[:end].sum())
    return RemovalNoise(size_nm(left, mask, noise), max(noise.area_mm2, cells * pitch_mm**2))


def without_plane(values: FloatArray, mask: BoolArray) -> FloatArray:
    """(N,) or (N, k) values at a mask's samples, less the plane that fits each best: without piston and tilt."""
    rows, across = np.nonzero(mask)
    plane = np.linalg.qr(np.column_stack([np.ones(rows.size), rows - rows.mean(), across - across.mean()]))[0]
    return np.asarray(values - plane @ (plane.T @ values), dtype=np.float64)


def _box(values: FloatArray) -> FloatArray:
    """Sums over the window about each sample."""
    means = scipy.ndimage.uniform_filter(values, WINDOW, mode="constant")
    return np.asarray(means * WINDOW**2, dtype=np.float64)


# Initial guess of a fit: the prior or, where that does not fit, a search for the spot.

LOST = 0.3
"""Share of the removal's variation: with a larger residual of the prior, at any rate, its slopes may mislead."""
SHOWS = 3.0
"""Least residual, in standard deviations of the noise, for a search."""
MOVES = 10
"""Most steps of the spot in a search: five millimeters and more, for any tool."""
PLACES = (("offset_x", "offset_y"), ("shift_x", "shift_y"))
"""Parameters that shift a spot, in the tool's frame or in the part's."""


def initial_guess(model: ForwardModel, removed: RemovalMap, prior: PriorKnowledge) -> FloatArray:
    """(k,) parameters to begin a fit at: the prior's mean, moved step by step to where the removal is."""
    here, measured = prior.mean, without_plane(removed.removal_nm[removed.mask], removed.mask)
    left_nm = _left_nm(model, here, measured)
    if left_nm < max(LOST * float(measured.std()), SHOWS * removed.noise.sigma_nm):
        return here
    ways = [_walked(model, here, left_nm, measured, place) for place in PLACES if set(place) <= set(prior.names)]
    return min(ways, key=lambda way: way[1], default=(here, left_nm))[0]


def _walked(
    model: ForwardModel, here: FloatArray, left_nm: float, measured: FloatArray, place: tuple[str, str]
) -> tuple[FloatArray, float]:
    """Descend from here, one step of the spot at a time: (k,) parameters, and their residual."""
    for _ in range(MOVES):
        looked = [(there, _left_nm(model, there, measured)) for there in _beside(model, here, place)]
        there, less_nm = min(looked, key=lambda one: one[1])
        if less_nm >= left_nm:
            break
        here, left_nm = there, less_nm
    return here, left_nm


def _beside(model: ForwardModel, here: FloatArray, place: tuple[str, str]) -> Iterator[FloatArray]:
    """(k,) parameters with the spot a step further along each axis."""
    names = [p.name for p in model.parameters]
    for name in place:
        for way in (-1, 1):
            there = here.copy()
            there[names.index(name)] += way * model.step_mm(here)
            yield there


def _left_nm(model: ForwardModel, theta: FloatArray, measured: FloatArray) -> float:
    """RMS of a leveled removal (N,) less the model of these parameters at the best rate."""
    modelled = without_plane(model.matrix(theta) @ model.block_s(theta), model.mask)
    rate = max(float(modelled @ measured) / float(modelled @ modelled), 0.0)
    return float(np.sqrt(np.mean((measured - rate * modelled) ** 2)))


ROUNDS = 4
HOME, SOME = 0.7, 0.01
"""A fit is repeated with its residual where that is below a share of the assumed noise, or where less than this share
of the outliers is left and they exceeded so many of the samples. It began too far off to estimate them."""
LAYING, HERTZ_LAYING = 1e-3, 2e-3
"""Error of spots of squares averaged over cells against exact sums, over the removal's standard deviation; the second
for Hertz spots, whose rim is steep."""


def fit(
    model: ForwardModel, removed: RemovalMap, prior: PriorKnowledge
) -> tuple[FitSamples, dict[str, MapFit], BoolArray]:
    """Fit all parameters by each projection, robustly; then without outliers, with the estimated noise.

    Outliers, noise and the slopes of the second fit are those of the projection that fits best: what another leaves
    says nothing of the map.
    """
    mask, pitch = removed.mask, removed.grid.pitch_mm
    measured = removed.removal_nm[mask]
    stated = removed.noise.with_another(cell_average_error(model, removed), pitch)
    all_of_it = FitSamples(measured, np.ones(measured.size, dtype=bool), stated, stated.cells(pitch))
    own = estimate(model, all_of_it, prior, robust=True, start=initial_guess(model, removed, prior))
    first = {model.projection: own}
    for name in model.blocks.depth_ratio:
        if name != model.projection:
            first[name] = estimate(model.of(name), all_of_it, prior, robust=True, near=own.laid)
    data = _cleaned(model, first, removed, stated)
    found = _once_more(model, first, data, prior)
    for _ in range(ROUNDS):
        after = _cleaned(model, found, removed, stated)
        if not _far_off(data, after):
            break
        data, found = after, _once_more(model, found, after, prior)
    rejected = np.zeros(mask.shape, dtype=bool)
    rejected[mask] = ~data.keep
    return data, found, rejected


def _best(found: Mapping[str, MapFit]) -> str:
    return max(found, key=lambda name: found[name].log_evidence)


def _once_more(
    model: ForwardModel, found: Mapping[str, MapFit], data: FitSamples, prior: PriorKnowledge
) -> dict[str, MapFit]:
    """Fit by least squares with updated slopes.

    Those of the geometry that a fit began at lead to the right place, but what they say of its errors is not that
    place's.
    """
    best = _best(found)
    final = {best: estimate(model.of(best), data, prior, start=found[best].theta)}
    for name, one in found.items():
        if name != best:
            final[name] = estimate(model.of(name), data, prior, start=one.theta, near=final[best].laid)
    return final


def _far_off(data: FitSamples, after: FitSamples) -> bool:
    """Return whether a fit began too far off to estimate noise and outliers, from its residual."""
    out, still_out = (int(np.count_nonzero(~one.keep)) for one in (data, after))
    fewer = out > SOME * data.keep.size and still_out < HOME * out
    return fewer or after.noise.sigma_nm < HOME * data.noise.sigma_nm


def _cleaned(model: ForwardModel, found: Mapping[str, MapFit], removed: RemovalMap, stated: RemovalNoise) -> FitSamples:
    """Return the samples without outliers, with the noise of the best of these fits."""
    best = _best(found)
    mask, pitch = removed.mask, removed.grid.pitch_mm
    residual = np.zeros(mask.shape)
    residual[mask] = removed.removal_nm[mask] - model.of(best).removal_nm(found[best].theta, found[best].laid)
    rejected = outliers(residual, mask, stated, pitch)
    keep = mask & ~rejected
    noise = own_noise(residual, keep, stated, pitch)
    return FitSamples(removed.removal_nm[mask], keep[mask], noise, noise.cells(pitch))


def cell_average_error(model: ForwardModel, removed: RemovalMap) -> RemovalNoise:
    """Error of the effect matrix: proportional to the variation of the removal, and as wide as the spot."""
    varies = abs(without_plane(removed.removal_nm[removed.mask], removed.mask))
    share = HERTZ_LAYING if isinstance(model.spot, HertzSpot) else LAYING
    return RemovalNoise(share * NORMAL * float(np.median(varies)), _core_mm2(model, np.zeros(len(model.parameters))))


def _core_mm2(model: ForwardModel, theta: FloatArray) -> float:
    """Area of the spot's core."""
    return np.pi * float(np.median(2 * model.spot.step_mm(model.gamma(theta)))) ** 2


def rate_bias(model: ForwardModel, found: MapFit, data: FitSamples) -> float:
    """Return the bias of the rate: half the map's noise is also in the plan, as far as the spot can follow it.

    Noise finer than the spot is not polished in: of white noise a spot follows the share of a sample in its core.
    """
    rate = without_plane(found.columns[:, [p.name for p in model.parameters].index("rate")], model.mask)
    energy = float((rate[data.keep] ** 2).mean())
    share = min(1.0, data.cells * model.grid.pitch_mm**2 / _core_mm2(model, found.theta))
    return share * data.noise.sigma_nm**2 / 2 / max(energy, 1e-12)
