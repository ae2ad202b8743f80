"""Dwell problems of full size: discs at 1 mm with a dwell point on every sample, and an analytic tool influence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.removal.convolution import ConvolutionEffect, sum_of_convolutions

PEAK_NM_S = 160.0
FINE = 8
"""Squares across a sample over which the spot is averaged."""
GAMMAS = 33
UNREACHED = 0.02
RMS_NM, NOISE_NM = 18.0, 0.5
CORRELATION_MM = 100.0
"""With it a spot of 20 mm radius leaves 1.4 nm RMS, one of 1.7 mm 1.0 nm: both can correct the figure."""


@dataclass(frozen=True)
class Case:
    """A disc and a spot."""

    diameter_mm: float
    spot_radius_mm: float
    rho: float

    @property
    def name(self) -> str:
        return f"phi {self.diameter_mm:g} mm, TIF radius {self.spot_radius_mm:g} mm"


def build(case: Case, rank: int = 0, change: float = 0.0, seed: int = 1) -> DwellProblem:
    """The problem with a static spot times gamma (rank 0), or with each point's own spot at that rank.

    ``change`` moves gamma by up to that share, differently over the part.
    """
    n = int(case.diameter_mm)
    grid = Grid(n, n, 1.0)
    disc = grid.radius_mm() <= case.diameter_mm / 2
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    gamma = 0.874 + 0.03 * np.sin(x / 60 + 1) + 0.014 * np.cos(y / 45)  # 0.83 to 0.918
    gamma *= 1 + change * np.sin(x / 80 + y / 110)
    effect = convolutions(grid, np.flatnonzero(disc.ravel()), gamma[disc], case.spot_radius_mm, rank)
    height = surface(grid, disc, seed)
    target = height + choose_piston_nm(height, disc, np.zeros(grid.shape), UNREACHED)
    points = effect.n
    p = regularisation_from_rho(effect, disc, case.rho)
    clear = grid.radius_mm() <= case.diameter_mm / 2 - 3
    return DwellProblem(effect, target, disc, clear, np.zeros(points), np.full(points, np.inf), p)


def surface(grid: Grid, inside: BoolArray, seed: int) -> FloatArray:
    """(ny, nx) nm: a figure that falls with the fourth power of the frequency, and noise."""
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(grid.ny)[:, None], np.fft.rfftfreq(grid.nx)[None, :]) / grid.pitch_mm
    size = np.where(f > 0, (1 + (CORRELATION_MM * f) ** 2) ** -2.0, 0.0)
    height = np.fft.irfft2(size * np.exp(2j * np.pi * rng.random(f.shape)), grid.shape)
    height = (height - height[inside].mean()) * RMS_NM / height[inside].std()
    return np.asarray(height + NOISE_NM * rng.standard_normal(grid.shape), dtype=np.float64)


def convolutions(
    grid: Grid, node: NDArray[np.int64], gamma: FloatArray, radius_mm: float, rank: int
) -> ConvolutionEffect:
    """The effect of spots at these nodes: rank 0 is one spot times gamma, else each one's own, to that rank."""
    reach = int(np.ceil(radius_mm))
    if rank == 0:
        kernels, coefficients = spot(float(gamma.mean()), radius_mm, reach)[None] / gamma.mean(), gamma[:, None]
    else:
        mesh = np.linspace(gamma.min(), gamma.max(), GAMMAS)
        shapes = np.stack([spot(value, radius_mm, reach).ravel() for value in mesh])
        _, _, basis = np.linalg.svd(shapes, full_matrices=False)
        kernels = basis[:rank].reshape(rank, 2 * reach + 1, 2 * reach + 1)
        coefficients = np.stack([np.interp(gamma, mesh, column) for column in (shapes @ basis[:rank].T).T], axis=1)
    return sum_of_convolutions(grid, np.divmod(node, grid.nx), kernels, coefficients)


def spot(gamma: float, radius_mm: float, reach: int) -> FloatArray:
    """(2 reach + 1, ...) nm/s: Hertz pressure under a dipped spindle, whose speed grows across the contact."""
    fine = (np.arange((2 * reach + 1) * FINE) + 0.5) / FINE - reach - 0.5
    x, y = np.meshgrid(fine, fine)
    contact_mm = radius_mm * np.sqrt(gamma)
    pressure = np.sqrt(np.maximum(1 - (x**2 + y**2) / contact_mm**2, 0.0) * gamma)
    rate = PEAK_NM_S * pressure * np.hypot(1 + 0.3 * y / radius_mm, 0.3 * x / radius_mm)
    side = 2 * reach + 1
    return np.asarray(rate.reshape(side, FINE, side, FINE).mean(axis=(1, 3)))
