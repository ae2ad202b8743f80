"""The removal of a path on a fine patch: a direct sum on a lattice, of several spots at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from polishd.model.surface import FloatArray
from polishd.process.removal.path_lines import PatchFrame
from polishd.process.removal.spread_effect import WIDTH, damping, spline
from polishd.process.removal.tif import HertzSpot, Spot, WiderSpot
from polishd.process.removal.tif_family import Indices, PathBlocks, reach_cells, windows

RATIO_STEP, AZIMUTH_STEP, BEND_STEP = 0.01, np.radians(3.0), 0.01
"""Spots of a patch that differ by less share one window; RATIO_STEP moves a spot's rim by 0.5 % of its radius."""
SQUARES = 128
"""Squares across a modelled spot: their width must not show beside a patch's cells."""


class RemovalPatch(NamedTuple):
    """The removal on a patch."""

    height_nm: FloatArray
    """(m, m), row 0 at the largest y."""
    at_mm: FloatArray
    """(m,) of its columns, from its centre; rows fall from the largest."""


def removal_patches(
    spots: Sequence[Spot], blocks: PathBlocks, time_s: FloatArray, frame: PatchFrame, shift_mm: FloatArray | None
) -> list[RemovalPatch]:
    """Sum the removal of the blocks near by: with each spot, and with the first one on a path shifted by (n, 2) back.

    The dwell is laid on the lattice once for all spots.
    """
    near = blocks.part(frame.near).seen_from(frame.centre_mm)
    bent, h, cells = near.bent, frame.cell_mm, frame.cells
    wider = 1.0 if bent is None else float(bent[:, :2].max())
    kinds, kind = _kinds(near)
    reach = max(reach_cells(spot, h, kinds.depth_ratio, kinds.azimuth_rad, wider) for spot in spots)
    size, edge = 2 * cells + 1, cells + reach + 1
    fast = scipy.fft.next_fast_len(2 * edge + 1, real=True)
    seconds = near.factor * time_s[frame.near]
    dwell = _on_lattice(near, seconds, kind, spots[0], (h, edge))
    at = np.asarray((np.arange(size) - cells) * h, dtype=np.float64)
    undamped = 1 / (damping(scipy.fft.fftfreq(fast))[:, None] * damping(scipy.fft.rfftfreq(fast)))
    middle = slice(2 * reach + 1, 2 * reach + 1 + size)
    spectrum = scipy.fft.rfft2(dwell, (fast, fast))
    kernels = []
    for spot in spots:
        window = windows(spot, h, kinds.depth_ratio, kinds.azimuth_rad, reach, bent=kinds.bent)
        kernels.append(scipy.fft.rfft2(window.reshape(-1, 2 * reach + 1, 2 * reach + 1), (fast, fast)) * undamped)
    pairs = [(spectrum, kernel) for kernel in kernels]
    if shift_mm is not None:
        back = shift_mm[frame.near]
        trailing = replace(near, start_mm=near.start_mm - back, end_mm=near.end_mm - back)
        late = scipy.fft.rfft2(_on_lattice(trailing, seconds, kind, spots[0], (h, edge)), (fast, fast))
        pairs.append((late, kernels[0]))
    total = [scipy.fft.irfft2(np.einsum("kij,kij->ij", *pair), (fast, fast))[middle, middle] for pair in pairs]
    return [RemovalPatch(np.asarray(height, dtype=np.float64), at) for height in total]


def _on_lattice(
    near: PathBlocks, seconds: FloatArray, kind: Indices, spot: Spot, lattice: tuple[float, int]
) -> FloatArray:
    """(kinds, nodes, nodes) seconds of the blocks on the nodes of a lattice, for each kind of spot.

    ``lattice``: distance of its nodes, and their number from the centre to each side.
    """
    h, edge = lattice
    nodes = 2 * edge + 1
    block, place, share = near.positions(spot)
    inside = (np.abs(place) < (edge - 1) * h).all(axis=1)  # the rest does not reach the patch
    block, place, share = block[inside], place[inside], share[inside]
    (row, down), (column, side) = (spline(v) for v in (edge - place[:, 1] / h, place[:, 0] / h + edge))
    weight = (share * seconds[block])[:, None, None] * down[:, :, None] * side[:, None]
    node = (kind[block] * nodes + row)[:, None, None] * nodes + column[:, None, None]
    node = node + np.arange(WIDTH)[:, None] * nodes + np.arange(WIDTH)
    count = int(kind.max(initial=0)) + 1
    total = np.bincount(node.ravel(), weight.ravel(), count * nodes * nodes)
    return np.asarray(total, dtype=np.float64).reshape(count, nodes, nodes)


def _kinds(blocks: PathBlocks) -> tuple[PathBlocks, Indices]:
    """Blocks that represent others with nearly the same spot, and (n,) which of them represents each."""
    keys = [np.log(blocks.depth_ratio) / RATIO_STEP, blocks.azimuth_rad / AZIMUTH_STEP]
    keys += [] if blocks.bent is None else list(blocks.bent.T / BEND_STEP)
    step = np.zeros(blocks.n, dtype=np.int64)
    for key in keys:
        whole = np.round(key).astype(np.int64)
        step = step * (np.ptp(whole) + 1) + whole - whole.min()
    _, first, kind = np.unique(step, return_index=True, return_inverse=True)
    return blocks.part(first), kind.ravel()


def widened(spot: Spot, factor: float) -> Spot:
    """Return a spot that is so many times as wide, of the same volume; a modelled one in at least SQUARES squares."""
    fine = HertzSpot(spot.process, max(SQUARES, spot.squares)) if isinstance(spot, HertzSpot) else spot
    return fine if factor == 1.0 else WiderSpot(fine, factor)
