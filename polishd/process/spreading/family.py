"""The family of a spot for very many blocks: its basis and their coefficients from a mesh of depths and azimuths.

`tif_family` lays down each point's own window. Here a block's coefficients are splines between those of the mesh, so
that the cost does not grow with the blocks; how far the effect is off is sampled on the effect.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

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
NO_BEND = 1e-4
"""Half a range of widths, over a flat's, and of how askew contacts are, below which their middle is taken for all."""


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
    spot: Spot,
    pitch_mm: float,
    depth_ratio: FloatArray,
    azimuth_rad: FloatArray,
    tolerance: float,
    *,
    bent: FloatArray | None = None,
) -> Family:
    """The family of n > 0 blocks of a spot, on a grid of this pitch.

    ``depth_ratio`` and ``azimuth_rad`` (n,), ``bent`` (n, 3) as of `Blocks`. A window of the mesh is held within
    ``tolerance`` of its Euclidean norm.
    """
    mean = np.angle(np.exp(1j * azimuth_rad).sum())
    turn = np.angle(np.exp(1j * (azimuth_rad - mean)))
    ratios, turns = _ratios(spot, pitch_mm, depth_ratio), _turns(turn)
    ratio, azimuth = (a.ravel() for a in np.meshgrid(ratios, mean + turns, indexing="ij"))
    bends, share = (np.empty((1, 0)), np.ones((len(turn), 1))) if bent is None else _star(bent)
    reach = reach_cells(spot, pitch_mm, ratio, azimuth, 1.0 if bent is None else float(bends[:, :2].max()))

    def shapes(which: Indices) -> Iterator[FloatArray]:
        """Windows of the mesh, that of one bend after that of the other."""
        for p in chunks(which.size):
            bend, at = np.divmod(which[p], ratio.size)
            yield windows(spot, pitch_mm, ratio[at], azimuth[at], reach, bent=None if bent is None else bends[bend])

    every = np.arange(len(bends) * ratio.size)
    some = np.union1d(np.random.default_rng(0).permutation(every)[:MOST_SHAPES], [0, ratio.size - 1])
    shape = np.concatenate(list(shapes(some)))
    basis = smallest_basis(shape / np.linalg.norm(shape, axis=1)[:, None], tolerance)
    on_mesh = np.concatenate([window @ basis for window in shapes(every)])
    on_mesh = on_mesh.reshape(len(bends), ratios.size, turns.size, -1)
    coefficients = np.zeros((len(turn), basis.shape[1]))
    for bend, own in zip(on_mesh, share.T, strict=True):
        coefficients += own[:, None] * _between((ratios, turns), bend, (depth_ratio, turn))
    size = 2 * reach + 1
    return Family(basis.T.reshape(-1, size, size), coefficients)


def _star(bent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(q, 3) bends that stand for those of n blocks, and (n, q) each one's share in each: quadratic along each axis.

    The axes are how wide in the mean, how much wider along x than along y, and how askew: all are small beside one, so
    that what two of them do together is left out; the error that is sampled knows.
    """
    axes = np.stack([bent[:, :2].mean(axis=1), (bent[:, 0] - bent[:, 1]) / 2, bent[:, 2]], axis=1)
    middle, half = (axes.max(axis=0) + axes.min(axis=0)) / 2, np.ptp(axes, axis=0) / 2
    found, shares = [middle], [np.ones(len(axes))]
    for axis in np.flatnonzero(half > NO_BEND):
        place = (axes[:, axis] - middle[axis]) / half[axis]
        for way in (-1, 1):
            found.append(middle + way * half * (np.arange(3) == axis))
            shares.append(place * (place + way) / 2)
        shares[0] = shares[0] - place**2
    wide, longer, askew = np.transpose(found)
    return np.stack([wide + longer, wide - longer, askew], axis=1), np.stack(shares, axis=1)


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
    found = scipy.interpolate.RegularGridInterpolator(tuple(mesh[axis] for axis in wide), flat, method="cubic")
    # rounding may leave a block a hair outside of its own range
    place = [np.clip(at[axis], mesh[axis][0], mesh[axis][-1]) for axis in wide]
    return np.asarray(found(np.stack(place, axis=1)), dtype=np.float64)
