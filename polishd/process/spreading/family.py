"""The family of a spot for very many blocks: its basis and their coefficients from a mesh of depths and azimuths.

`tif_family` lays down each point's own window. Here a block's coefficients are splines between those of the mesh, so
that the cost does not grow with the blocks; how far the effect is off is sampled on the effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from polishd.model.surface import FloatArray
from polishd.process.spot import Spot
from polishd.process.spreading.blocks import Indices
from polishd.process.tif_family import chunks, reach_cells, smallest_basis, windows

LEAST = 9
"""Ratios or azimuths over a range, at least."""
MOST_RATIOS = 65
STEP_CELLS = 0.25
"""How far the spot's rim moves from one ratio to the next."""
TURN_STEP = np.radians(4.0)
MOST_SHAPES = 500
"""Of the mesh, that the basis is taken from: its cost grows with their square."""
NO_RANGE = 1e-12


@dataclass(frozen=True, slots=True)
class Family:
    """A basis of a spot's windows, and how n blocks are made of it."""

    kernels: FloatArray
    """(k, m, m) orthonormal windows, m odd, row 0 the top."""
    coefficients: FloatArray
    """(n, k) nm/s: the window of block i is about ``sum_k coefficients[i, k] kernels[k]``."""

    def part(self, which: Indices) -> Family:
        """Of some of the blocks."""
        return Family(self.kernels, self.coefficients[which])


def meshed_family(
    spot: Spot, pitch_mm: float, depth_ratio: FloatArray, azimuth_rad: FloatArray, tolerance: float
) -> Family:
    """The family of n > 0 blocks of a spot, on a grid of this pitch.

    ``depth_ratio`` and ``azimuth_rad`` (n,). A window of the mesh is held within ``tolerance`` of its Euclidean norm.
    """
    mean = np.angle(np.exp(1j * azimuth_rad).sum())
    turn = np.angle(np.exp(1j * (azimuth_rad - mean)))
    ratios, turns = _ratios(spot, pitch_mm, depth_ratio), _turns(turn)
    ratio, azimuth = (a.ravel() for a in np.meshgrid(ratios, mean + turns, indexing="ij"))
    reach = reach_cells(spot, pitch_mm, ratio, azimuth)
    some = np.random.default_rng(0).permutation(ratio.size)[:MOST_SHAPES]
    some = np.union1d(some, [0, ratio.size - 1])
    shapes = np.concatenate(
        [windows(spot, pitch_mm, ratio[some][p], azimuth[some][p], reach) for p in chunks(some.size)]
    )
    basis = smallest_basis(shapes / np.linalg.norm(shapes, axis=1)[:, None], tolerance)
    on_mesh = np.concatenate(
        [windows(spot, pitch_mm, ratio[p], azimuth[p], reach) @ basis for p in chunks(ratio.size)]
    ).reshape(ratios.size, turns.size, -1)
    size = 2 * reach + 1
    return Family(basis.T.reshape(-1, size, size), _between((ratios, turns), on_mesh, (depth_ratio, turn)))


def _ratios(spot: Spot, pitch_mm: float, depth_ratio: FloatArray) -> FloatArray:
    """Depth ratios over the range of the blocks', so near that the spot's rim moves by STEP_CELLS."""
    ends = np.array([depth_ratio.min(), depth_ratio.max()])
    if np.ptp(ends) <= NO_RANGE:
        return ends[:1]
    steps = int(np.ceil(np.ptp(spot.half_width_mm(ends)) / (STEP_CELLS * pitch_mm)))
    return np.linspace(ends[0], ends[1], min(max(steps + 1, LEAST), MOST_RATIOS))


def _turns(turn: FloatArray) -> FloatArray:
    """Azimuths over the range of the blocks', rad."""
    if np.ptp(turn) <= NO_RANGE:
        return turn[:1]
    return np.linspace(turn.min(), turn.max(), max(1 + int(np.ceil(np.ptp(turn) / TURN_STEP)), LEAST))


def _between(mesh: tuple[FloatArray, ...], value: FloatArray, at: tuple[FloatArray, ...]) -> FloatArray:
    """(n, k) by cubic splines along each axis of the mesh that has a range; ``value`` (ratios, turns, k)."""
    wide = [axis for axis, points in enumerate(mesh) if points.size > 1]
    if not wide:
        return np.repeat(value.reshape(1, -1), at[0].size, axis=0)
    flat = value.reshape(*(mesh[axis].size for axis in wide), value.shape[-1])
    found = RegularGridInterpolator(tuple(mesh[axis] for axis in wide), flat, method="cubic")
    # rounding may leave a block a hair outside of its own range
    place = [np.clip(at[axis], mesh[axis][0], mesh[axis][-1]) for axis in wide]
    return np.asarray(found(np.stack(place, axis=1)), dtype=np.float64)
