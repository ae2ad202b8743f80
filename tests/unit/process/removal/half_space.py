"""Pressure of a smooth body on an elastic half space, by its true gap: conjugate gradients on an FFT of Love's squares.

Polonsky and Keer (Wear 231, 1999). Knows nothing of Hertz: the gap may have any shape.
"""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.surface import FloatArray

ROUNDS = 400
SETTLED = 1e-9


def pressure_mpa(gap_mm: FloatArray, pitch_mm: float, load_n: float, modulus_mpa: float) -> FloatArray:
    """(n, n) mean pressure of each square under a load, for (n, n) gaps at their middles, before they touch."""
    size = [2 * n for n in gap_mm.shape]
    spectrum = scipy.fft.rfft2(_influence(gap_mm.shape[0], pitch_mm, modulus_mpa), size)

    def sunk(pressure: FloatArray) -> FloatArray:
        whole = scipy.fft.irfft2(scipy.fft.rfft2(pressure, size) * spectrum, size)
        return np.asarray(whole[: gap_mm.shape[0], : gap_mm.shape[1]])

    area = pitch_mm**2
    p = np.full(gap_mm.shape, load_n / area / gap_mm.size)
    way, last, restart = np.zeros_like(p), 1.0, True
    for _ in range(ROUNDS):
        touching = p > 0
        open_mm = sunk(p) + gap_mm
        open_mm -= open_mm[touching].mean()
        norm = float((open_mm[touching] ** 2).sum())
        way = np.where(touching, open_mm + (0.0 if restart else norm / last) * way, 0.0)
        last = norm
        moved = sunk(way)
        moved -= moved[touching].mean()
        step = float((open_mm * way)[touching].sum() / (moved * way)[touching].sum())
        before = p
        p = np.clip(p - step * way, 0.0, None)
        hit = (p == 0) & (open_mm < 0)
        restart = bool(hit.any())
        p[hit] -= step * open_mm[hit]
        p *= load_n / (area * p.sum())
        if np.abs(p - before).max() <= SETTLED * p.max():
            return p
    raise AssertionError(f"not settled after {ROUNDS} rounds")


def _influence(n: int, pitch: float, modulus: float) -> FloatArray:
    """(2 n, 2 n) mm/MPa: how far a square sinks under pressure on another (Love 1929), wrapped for an FFT."""
    at = np.minimum(np.arange(2 * n), 2 * n - np.arange(2 * n)) * pitch
    low, high = at - pitch / 2, at + pitch / 2

    def corner(x: FloatArray, y: FloatArray) -> FloatArray:
        x, y = x[None, :], y[:, None]
        return np.asarray(x * np.arcsinh(y / np.abs(x)) + y * np.arcsinh(x / np.abs(y)))

    whole = corner(high, high) - corner(low, high) - corner(high, low) + corner(low, low)
    return np.asarray(whole / (np.pi * modulus))
