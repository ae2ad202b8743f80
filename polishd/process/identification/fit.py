"""All parameters fitted to one map: outliers left out, with the noise that the map and the model really have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.identification.beginning import beginning
from polishd.process.identification.estimate import Data, MapFit, estimate
from polishd.process.identification.forward import ForwardModel
from polishd.process.identification.parameters import PriorKnowledge
from polishd.process.identification.passes import RemovalMap, RemovalNoise
from polishd.process.identification.residual import NORMAL, outliers, own_noise, without_plane
from polishd.process.spot import HertzSpot

ROUNDS = 4
HOME, SOME = 0.7, 0.01
"""A fit that leaves less than this share of the noise that it reckoned with, or of the outliers where they were more
than so many of the samples, began too far off to tell them: once more, with those that this one leaves."""
LAYING, HERTZ_LAYING = 1e-3, 2e-3
"""Of the removal's standard deviation: by what spots of squares, laid on cells, miss the same spots summed exactly; the
second of Hertz's, whose rim is steep."""


def fit(model: ForwardModel, removed: RemovalMap, prior: PriorKnowledge) -> tuple[Data, dict[str, MapFit], BoolArray]:
    """All parameters by each projection, robustly; then without what is none of the pass, with the noise that is left.

    Outliers, noise and the slopes of the second fit are those of the projection that fits best: what another leaves
    says nothing of the map.
    """
    mask, pitch = removed.mask, removed.grid.pitch_mm
    measured = removed.removal_nm[mask]
    stated = removed.noise.with_another(laying(model, removed), pitch)
    all_of_it = Data(measured, np.ones(measured.size, dtype=bool), stated, stated.cells(pitch))
    own = estimate(model, all_of_it, prior, robust=True, start=beginning(model, removed, prior))
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
    model: ForwardModel, found: Mapping[str, MapFit], data: Data, prior: PriorKnowledge
) -> dict[str, MapFit]:
    """By squares, with slopes laid anew.

    Those of the geometry that a fit began at lead to the right place, but what they say of its errors is not that
    place's.
    """
    best = _best(found)
    final = {best: estimate(model.of(best), data, prior, start=found[best].theta)}
    for name, one in found.items():
        if name != best:
            final[name] = estimate(model.of(name), data, prior, start=one.theta, near=final[best].laid)
    return final


def _far_off(data: Data, after: Data) -> bool:
    """Whether a fit began too far from where the spot was to tell noise and outliers, as what it leaves says."""
    out, still_out = (int(np.count_nonzero(~one.keep)) for one in (data, after))
    fewer = out > SOME * data.keep.size and still_out < HOME * out
    return fewer or after.noise.sigma_nm < HOME * data.noise.sigma_nm


def _cleaned(model: ForwardModel, found: Mapping[str, MapFit], removed: RemovalMap, stated: RemovalNoise) -> Data:
    """Without what is none of the pass, and with the noise that the best of these fits leaves."""
    best = _best(found)
    mask, pitch = removed.mask, removed.grid.pitch_mm
    residual = np.zeros(mask.shape)
    residual[mask] = removed.removal_nm[mask] - model.of(best).removal_nm(found[best].theta, found[best].laid)
    rejected = outliers(residual, mask, stated, pitch)
    keep = mask & ~rejected
    noise = own_noise(residual, keep, stated, pitch)
    return Data(removed.removal_nm[mask], keep[mask], noise, noise.cells(pitch))


def laying(model: ForwardModel, removed: RemovalMap) -> RemovalNoise:
    """What the effect matrix itself is off by: in proportion to how the removal varies, and as wide as the spot."""
    varies = abs(without_plane(removed.removal_nm[removed.mask], removed.mask))
    share = HERTZ_LAYING if isinstance(model.spot, HertzSpot) else LAYING
    return RemovalNoise(share * NORMAL * float(np.median(varies)), _core_mm2(model, np.zeros(len(model.parameters))))


def _core_mm2(model: ForwardModel, theta: FloatArray) -> float:
    """Area of the spot's core."""
    return np.pi * float(np.median(2 * model.spot.step_mm(model.gamma(theta)))) ** 2


def followed_rate(model: ForwardModel, found: MapFit, data: Data) -> float:
    """By how much the rate may be too high: half the map's noise is also what the plan followed, as far as it could.

    Noise finer than the spot is not polished in: of white noise a spot follows the share of a sample in its core.
    """
    rate = without_plane(found.columns[:, [p.name for p in model.parameters].index("rate")], model.mask)
    energy = float((rate[data.keep] ** 2).mean())
    share = min(1.0, data.cells * model.grid.pitch_mm**2 / _core_mm2(model, found.theta))
    return share * data.noise.sigma_nm**2 / 2 / max(energy, 1e-12)
