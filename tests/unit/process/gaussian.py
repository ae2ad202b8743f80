"""Shared helpers of the process tests: dwell problems with a Gaussian spot, programs and synthetic surfaces."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from polishd.model.program import Encoding, Envelope, Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.removal.effect import SparseEffect
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster


def spot_effect(
    grid: Grid, points_mm: FloatArray, sigma_mm: float = 0.9, rate_nm_s: float | FloatArray = 100.0
) -> SparseEffect:
    """Return a Gaussian spot of this size, cut at three sigmas, at each point (n, 2 or 3)."""
    reach = int(np.ceil(3 * sigma_mm / grid.pitch_mm))
    row = np.rint((grid.y_mm[0] - points_mm[:, 1]) / grid.pitch_mm).astype(int)
    column = np.rint((points_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm).astype(int)
    shift = np.arange(-reach, reach + 1)
    i = (row[:, None, None] + shift[:, None] + 0 * shift).reshape(len(points_mm), -1)
    j = (column[:, None, None] + 0 * shift[:, None] + shift).reshape(len(points_mm), -1)
    on = (i >= 0) & (i < grid.ny) & (j >= 0) & (j < grid.nx)
    x = grid.x_mm[np.clip(j, 0, grid.nx - 1)] - points_mm[:, :1]
    y = grid.y_mm[np.clip(i, 0, grid.ny - 1)] - points_mm[:, 1:2]
    near = np.hypot(x, y) <= 3 * sigma_mm
    value = np.exp(-(x**2 + y**2) / (2 * sigma_mm**2)) * np.reshape(rate_nm_s, (-1, 1))
    point = np.broadcast_to(np.arange(len(points_mm))[:, None], i.shape)
    keep = on & near
    entries = (value[keep], ((i * grid.nx + j)[keep], point[keep]))
    return SparseEffect(grid, sparse.csr_array(sparse.coo_array(entries, shape=(grid.ny * grid.nx, len(points_mm)))))


def rough(grid: Grid, rms_nm: float = 18.5, seed: int = 0, cut_mm: float = 6.0) -> FloatArray:
    """Return a random surface (ny, nx) whose spectrum falls towards short periods and ends at ``cut_mm``."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(grid.ny, grid.pitch_mm), np.fft.rfftfreq(grid.nx, grid.pitch_mm)
    f = np.hypot(fy[:, None], fx[None, :])
    size = np.where((f > 0) & (f < 1 / cut_mm), 1 / (1 + (40 * f) ** 2), 0.0)
    height = np.fft.irfft2(size * np.exp(2j * np.pi * rng.random(f.shape)), grid.shape)
    return np.asarray(height * rms_nm / height.std(), dtype=np.float64)


def dwell_problem(
    radius_mm: float = 12.0, seed: int = 0, rho: float = 1e-4, unreachable: float = 0.02, feed_mm_s: float = 50.0
) -> DwellProblem:
    """Return the problem of a disc and a raster at 1 mm: 110 x 110 pixels and 8,000 points at radius 50."""
    n = int(2 * radius_mm + 10)
    grid = Grid(n, n, 1.0)
    points = raster(circle(2 * radius_mm - 2), 1.0, 1.0)
    middle, length = (points[1:] + points[:-1]) / 2, np.linalg.norm(np.diff(points, axis=0), axis=1)
    effect = spot_effect(grid, middle, rate_nm_s=100 * (1 + 0.05 * np.sin(middle[:, 0] / 20)))
    solve, metric = grid.radius_mm() <= radius_mm, grid.radius_mm() <= radius_mm - 3
    lower, upper = length / feed_mm_s, length / 0.5
    height = rough(grid, seed=seed)
    piston = choose_piston_nm(height, solve, effect.removal_nm(lower), unreachable)
    return DwellProblem(
        effect, height + piston, solve, metric, lower, upper, regularisation_from_rho(effect, solve, rho)
    )


def program(points_mm: FloatArray, time_s: float | FloatArray = 0.1, encoding: Encoding = "feed") -> Program:
    """Return the program of a path through these points (n + 1, 3), or of a dwell at each of (n, 3)."""
    start, end = (points_mm, points_mm) if encoding == "dwell" else (points_mm[:-1], points_mm[1:])
    n = len(start)
    axis = np.tile([0.0, 0.0, 1.0], (n, 1))
    time = np.broadcast_to(np.asarray(time_s, dtype=np.float64), (n,))
    lines = np.arange(n)
    return Program(b"", "", "test", "rs274", encoding, lines + 1, lines, start, end, axis, time, n, 3000.0)


def scaled(effect: SparseEffect, factor: float) -> SparseEffect:
    """Return the effect with a rate that is ``factor`` times as high."""
    return SparseEffect(effect.grid, effect.matrix * factor)


def envelope(**changes: float) -> Envelope:
    """Return the demo cell's envelope with changes."""
    limits: dict[str, float] = {
        "max_feed_mm_s": 50.0,
        "min_feed_mm_s": 0.5,
        "accel_mm_s2": 800.0,
        "block_overhead_s": 0.0,
        "corner_deg": 30.0,
        "max_removal_nm": 1000.0,
        "max_pass_s": 7200.0,
    }
    return Envelope(**(limits | changes), x_mm=(-90, 90), y_mm=(-90, 90), z_mm=(-1, 60))
