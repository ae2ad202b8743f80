"""What is wrong with a measured map: noise, the instrument's terms as they are known, those that nothing has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.ndimage

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.told import AbsoluteTestResult

REACH = 4.0
"""Correlation lengths to which a kernel is computed: e^-8 is left."""
Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class MapNoise:
    """Of a map: a white part, and one that is alike in neighbours, as of air; independent of each other."""

    white_nm: float
    """Standard deviation of a sample."""
    correlated_nm: float = 0.0
    """Likewise."""
    length_mm: float = 0.0
    """L of the correlation exp(-d^2 / 2 L^2) of samples at a distance d."""

    def alike(self, pitch_mm: float) -> float:
        """Samples of which the correlated part is one piece: the sum of squares of its correlation, at least 1."""
        return max(1.0, float(np.pi * (self.length_mm / pitch_mm) ** 2))

    def term_covariance(self, weights: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
        """(k, k) nm^2 of sums of samples of the noise.

        Args:
            weights: (k, p) of each sum, of the p samples in ``mask``.
            mask: (ny, nx)
            pitch_mm: distance of samples.
        """
        found = self.white_nm**2 * weights @ weights.T
        if self.correlated_nm and self.length_mm:
            spread = np.zeros(mask.shape)
            near = np.empty_like(weights)
            for index, own in enumerate(weights):
                spread[mask] = own
                near[index] = _along_both(spread, _kernel(self.length_mm / pitch_mm))[mask]
            found = found + self.correlated_nm**2 * (near @ weights.T)
        return np.asarray((found + found.T) / 2)

    def draw(self, shape: tuple[int, ...], pitch_mm: float, rng: np.random.Generator) -> FloatArray:
        """(ny, nx) nm of such noise."""
        found = rng.normal(0.0, self.white_nm, shape) if self.white_nm else np.zeros(shape)
        if self.correlated_nm and self.length_mm:
            kernel = _kernel(self.length_mm / pitch_mm / np.sqrt(2))
            kernel /= np.linalg.norm(kernel)
            edge = len(kernel) // 2
            whole = _along_both(rng.normal(0.0, self.correlated_nm, tuple(n + 2 * edge for n in shape)), kernel)
            found = found + whole[edge : edge + shape[0], edge : edge + shape[1]]
        return found


@dataclass(frozen=True, slots=True)
class MapErrors:
    """Of a map that the instrument's known error was taken off."""

    noise: MapNoise
    degree: int = 10
    """Radial order up to which terms are looked at one by one."""
    terms: tuple[Term, ...] = ()
    """(n, m) of the instrument's terms: RMS norm, angles from x towards y."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(j, j) nm^2 of them, as far as they were measured."""
    unseen_nm: Mapping[Term, float] = field(default_factory=dict)
    """Prior of terms that nothing has seen: one standard deviation each about 0, nm RMS."""
    unseen_rest_nm: float = 0.0
    """Prior RMS of what the terms leave of the instrument and nothing has seen."""


def errors_from_system_map(
    told: AbsoluteTestResult, noise: MapNoise, unseen_nm: Mapping[Term, float], unseen_rest_nm: float | None = None
) -> MapErrors:
    """Errors of a map less the instrument's map that a set of poses gave.

    Args:
        told: what the poses told of the instrument.
        noise: of the map that is judged, not of those that told the instrument.
        unseen_nm: priors of the instrument's terms; those that the poses told take no part.
        unseen_rest_nm: prior of its shorter waves that the poses leave; None: as what they tell of them has it.
    """
    unseen = {
        term: prior * float(np.sqrt(told.unknown[term])) for term, prior in unseen_nm.items() if term in told.unknown
    }
    rest = told.rest_nm if unseen_rest_nm is None else unseen_rest_nm
    return MapErrors(noise, told.degree, told.terms, told.covariance, unseen, rest)


def _kernel(length_px: float) -> FloatArray:
    far = int(np.ceil(REACH * length_px))
    return np.asarray(np.exp(-0.5 * (np.arange(-far, far + 1) / length_px) ** 2))


def _along_both(height: FloatArray, kernel: FloatArray) -> FloatArray:
    for axis in (0, 1):
        height = scipy.ndimage.correlate1d(height, kernel, axis=axis, mode="constant")
    return height
