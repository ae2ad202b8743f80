"""Maps of a known part in a known instrument: as formulas, turned by complex numbers, by nothing of polishd's."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrology.absolute_poses import PartPose

RADIUS_MM, PITCH_MM, SIDE = 38.0, 1.0, 89
Shape = Callable[[FloatArray, FloatArray], FloatArray]
"""Heights, nm, at x and y in radii of the part."""

ALONG = np.arange(SIDE) - (SIDE - 1) / 2
PLANE = (ALONG[None, :] - 1j * ALONG[:, None]) * PITCH_MM
"""x + iy of each sample, mm, y up."""


def part_nm(x: FloatArray, y: FloatArray) -> FloatArray:
    """No direction like another: astigmatism, trefoil, power, waves of a fifth of the part and of its 16th."""
    low = 6 * (x * x - y * y) + 8 * x * y + 10 * x * (x * x - 3 * y * y) + 4 * (x * x + y * y)
    return np.asarray(low + 6 * np.sin(5 * x + 1) * np.cos(4 * y) + np.sin(25 * x) * np.cos(20 * y))


def instrument_nm(x: FloatArray, y: FloatArray) -> FloatArray:
    """3 nm of astigmatism at the edge, coma, and a print of 0.6 nm: nothing round, nothing of four folds."""
    return np.asarray(3 * (x * x - y * y) + 1.5 * (3 * (x * x + y * y) - 2) * y + 0.6 * np.sin(31 * x + 25 * y))


def maps(
    poses: Sequence[PartPose],
    noise_nm: float = 0.3,
    *,
    part: Shape = part_nm,
    instrument: Shape = instrument_nm,
    seed: int = 1,
    sense: int = 1,
) -> list[FloatArray]:
    """Return the map of each pose with noise, piston and tilt; ``sense`` -1: turned the other way."""
    rng = np.random.default_rng(seed)
    found = []
    for pose in poses:
        shifted = (PLANE - complex(pose.x_mm, pose.y_mm)) * np.exp(-1j * sense * np.radians(pose.angle_deg))
        own = shifted / RADIUS_MM
        height = part(own.real, own.imag) + instrument(PLANE.real / RADIUS_MM, PLANE.imag / RADIUS_MM)
        height += rng.normal(0, noise_nm, height.shape) + rng.normal(0, 50)
        height += rng.normal(0, 1) * PLANE.real + rng.normal(0, 1) * PLANE.imag
        found.append(np.where(np.abs(own) <= 1, height, np.nan))
    return found


def true_nm(shape: Shape) -> FloatArray:
    """(ny, nx) over all samples."""
    return shape(PLANE.real / RADIUS_MM, PLANE.imag / RADIUS_MM)


def rms_nm(height_nm: FloatArray, inside: float = 0.95, *, without: Sequence[Shape] = ()) -> float:
    """Without piston, tilt and other shapes, within a share of the radius: the rim's splines are not judged."""
    mask: BoolArray = np.isfinite(height_nm) & (np.abs(PLANE) < inside * RADIUS_MM)
    x, y = PLANE.real[mask] / RADIUS_MM, PLANE.imag[mask] / RADIUS_MM
    away = np.column_stack([np.ones_like(x), x, y, *(shape(x, y) for shape in without)])
    values = height_nm[mask]
    return float(np.std(values - away @ np.linalg.lstsq(away, values, rcond=None)[0]))


def turns(count: int) -> list[PartPose]:
    """Return this number of equal maps."""
    return [PartPose(360 * k / count) for k in range(count)]
