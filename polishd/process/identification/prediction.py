"""The removal of a planned dwell with its covariance, and how the figure that it leaves is distributed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.identification.fit import without_plane
from polishd.process.identification.forward_model import ForwardModel
from polishd.process.identification.parameters import ABERRATIONS, PriorKnowledge, RemovalNoise

SAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Prediction:
    """Removal over N samples of a mask: normal, ``mean + factor z`` with z of k independent standard normals."""

    grid: Grid
    mask: BoolArray
    mean_nm: FloatArray
    """(N,)"""
    factor_nm: FloatArray
    """(N, k) its covariance is ``factor factor'``."""

    @property
    def sigma_nm(self) -> FloatArray:
        """(N,) standard error of each sample's removal."""
        return np.asarray(np.sqrt((self.factor_nm**2).sum(axis=1)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Interval:
    """Of a figure that is not known for sure."""

    low: float
    median: float
    high: float
    level: float


def predict(model: ForwardModel, known: PriorKnowledge) -> Prediction:
    """What the blocks of a plan remove, as far as is known.

    What an instrument adds to a map is not removed, and counts for nothing.

    Args:
        model: of the planned blocks (`forward.forward`), with the knowledge's parameters.
        known: `Identified.applied` as `advanced`, with the error of all that is learned; or `Identified.learned`.
    """
    removing = np.array([p.name not in ABERRATIONS for p in known.parameters])
    theta = np.where(removing, known.mean, 0.0)
    laid = model.lay(theta)
    columns = model.columns(theta, laid) * removing
    values, vectors = np.linalg.eigh(known.covariance[np.ix_(removing, removing)])
    factor = columns[:, removing] @ (vectors * np.sqrt(np.clip(values, 0.0, None)))
    return Prediction(model.grid, model.mask, model.removal_nm(theta, laid), np.asarray(factor, dtype=np.float64))


def rms_samples(
    prediction: Prediction,
    height_nm: FloatArray,
    noise: RemovalNoise,
    rng: np.random.Generator,
    *,
    samples: int = SAMPLES,
    measured: bool = False,
) -> FloatArray:
    """(samples,) draws of the RMS that a pass leaves, less piston and tilt, nm.

    Args:
        prediction: of the pass.
        height_nm: (ny, nx) the surface before it, as measured.
        noise: of that map: the true surface is the map less it, and nothing takes it off again.
        rng: where chance comes from.
        samples: how many.
        measured: of the RMS that a next map with the same noise will show; else of the true one.
    """
    left = without_plane(height_nm[prediction.mask] - prediction.mean_nm, prediction.mask)
    factor = without_plane(prediction.factor_nm, prediction.mask)
    z = rng.standard_normal((samples, factor.shape[1]))
    gram, across = factor.T @ factor, factor.T @ left
    square = left @ left - 2 * z @ across + np.einsum("si,ij,sj->s", z, gram, z)
    free = max((left.size - 3) / noise.cells(prediction.grid.pitch_mm), 1.0)
    own = noise.sigma_nm**2 * (2 if measured else 1)
    mixed = 2 * noise.sigma_nm * np.sqrt(2 if measured else 1) * np.sqrt(np.clip(square, 0, None) / left.size / free)
    chance = own * rng.chisquare(free, samples) / free + mixed * rng.standard_normal(samples)
    return np.asarray(np.sqrt(np.clip(square / left.size + chance, 0.0, None)), dtype=np.float64)


def interval(draws: FloatArray, level: float = 0.9) -> Interval:
    """The middle share of draws, with their median."""
    low, median, high = np.quantile(draws, [(1 - level) / 2, 0.5, (1 + level) / 2])
    return Interval(float(low), float(median), float(high), level)
