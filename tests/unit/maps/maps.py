"""Write maps for the tests of ``polishd map``, as the simulator's instrument writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polishd.model.surface import FloatArray
from polishd.sim_backends.common.metropro import DatMap, pack

PITCH_MM = 0.5
TAKEN_S = 1_760_000_000


def surface(rows: int = 60, columns: int = 48, seed: int = 3) -> FloatArray:
    """Return heights (rows, columns) in nm: tilt, an off-center bump and a little noise, within an ellipse."""
    y, x = np.meshgrid(np.linspace(1, -1, rows), np.linspace(-1, 1, columns), indexing="ij")
    bump = 30 * np.exp(-((x - 0.3) ** 2 + (y - 0.2) ** 2) / 0.05)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, x.shape)
    return np.where(x**2 + y**2 <= 1, 12 * x - 7 * y + bump + noise, np.nan)


def dat(path: Path, height_nm: FloatArray, pitch_mm: float = PITCH_MM, part: str = "blank-7") -> Path:
    """Write a MetroPro file of the heights; pitch 0: not calibrated."""
    path.write_bytes(pack(DatMap(height_nm, pitch_mm, part=part, taken_s=TAKEN_S)))
    return path
