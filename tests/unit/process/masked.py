"""Masked surfaces whose content is known, for the tests of the metrics."""

from __future__ import annotations

import numpy as np

from polishd.model.surface import BoolArray, FloatArray, Grid

EDGES_MM = (33.0, 5.0)


def shapes(grid: Grid) -> dict[str, BoolArray]:
    """A circle, an annulus, an ellipse and a rectangle, each off the middle and with two holes."""
    x, y = np.meshgrid(grid.x_mm - grid.pitch_mm, grid.y_mm + 2 * grid.pitch_mm)
    reach = 0.46 * grid.nx * grid.pitch_mm
    radius = np.hypot(x, y)
    holes = (np.hypot(x - 0.5 * reach, y) < 2 * grid.pitch_mm) | (np.hypot(x, y + 0.4 * reach) < 3 * grid.pitch_mm)
    found = {
        "circle": radius <= reach,
        "annulus": (radius <= reach) & (radius >= 0.3 * reach),
        "ellipse": np.hypot(x, y / 0.6) <= reach,
        "rectangle": (np.abs(x) <= 0.9 * reach) & (np.abs(y) <= 0.6 * reach),
    }
    return {name: mask & ~holes for name, mask in found.items()}


def band(grid: Grid, periods_mm: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Noise of periods between these (longest first), falling as their power 1.5, not periodic on the grid itself."""
    n = 2 * max(grid.shape)
    f = np.hypot(np.fft.fftfreq(n, grid.pitch_mm)[:, None], np.fft.rfftfreq(n, grid.pitch_mm)[None, :])
    some = (f > 0) & (f >= 1 / periods_mm[0]) & (f <= 1 / periods_mm[1])
    size = np.where(some, np.where(some, f, 1.0) ** -1.5, 0.0)
    spectrum = size * (rng.standard_normal(f.shape) + 1j * rng.standard_normal(f.shape))
    return np.asarray(np.fft.irfft2(spectrum, (n, n))[: grid.ny, : grid.nx], dtype=np.float64)


def three_bands(grid: Grid, mask: BoolArray, seed: int) -> tuple[FloatArray, ...]:
    """LSF, MSF and HSF of 40, 8 and 2 nm RMS inside the mask, with a fifth between them and the edges."""
    rng = np.random.default_rng(seed)
    long, short = EDGES_MM
    periods = ((1e4, long * 1.2), (long / 1.2, short * 1.2), (short / 1.2, 2 * grid.pitch_mm))
    parts = (band(grid, each, rng) for each in periods)
    return tuple(part / part[mask].std() * rms for part, rms in zip(parts, (40.0, 8.0, 2.0), strict=True))
