"""Weights of places between the nodes of a lattice on the nodes about them: those of quadratic splines.

A window laid down with them is damped by them; divided by that, `damping`, it is what a quadratic spline through its
values is between them. They keep the volume that a block removes, and reach WIDTH / 2 nodes: what the rim of a spot
makes of them stays near the rim.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from polishd.model.surface import FloatArray, Grid
from polishd.process.convolution import Layout
from polishd.process.spot import Spot
from polishd.process.spreading.blocks import PathBlocks

WIDTH = 3
CHUNK = 8192
"""Blocks worked on at a time: bounds memory."""


def spline(place: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """(m,) first node of places that are given in units of the lattice, and (m, WIDTH) weights from it on."""
    nearest = np.floor(place + 0.5).astype(np.int64)
    off = place - nearest
    weight = np.stack([(0.5 - off) ** 2 / 2, 0.75 - off**2, (0.5 + off) ** 2 / 2], axis=1)
    return nearest - WIDTH // 2, weight


def damping(frequency: FloatArray) -> FloatArray:
    """(m,) what `spline` makes of a wave of so many cycles a node along one axis: between 1 and 1/2."""
    return np.asarray(0.75 + 0.25 * np.cos(2 * np.pi * frequency))


def outermost(grid: Grid, blocks: PathBlocks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(2,) first and last row, and column, of the nodes that n > 0 blocks weigh on."""
    found = []
    for at in _rows_and_columns(grid, np.concatenate([blocks.start_mm, blocks.end_mm])):
        first, _ = spline(np.array([at.min(), at.max()]))
        found.append(first + np.array([0, WIDTH - 1]))
    return found[0], found[1]


def spread(grid: Grid, spot: Spot, blocks: PathBlocks, where: Layout) -> sparse.csr_array:
    """(n, nodes) weight of each block on each node of the layout's lattice, C order; a row's sum is 1."""
    nodes = where.lattice[0] * where.lattice[1]
    parts = [sparse.csr_array((0, nodes))]
    for chunk in range(0, blocks.n, CHUNK):
        some = blocks.part(slice(chunk, chunk + CHUNK))
        block, place, share = some.positions(spot)
        (row, down), (column, across) = (spline(at) for at in _rows_and_columns(grid, place))
        weight = share[:, None, None] * down[:, :, None] * across[:, None, :]
        rows = row[:, None, None] - where.first[0] + np.arange(WIDTH)[:, None]
        columns = column[:, None, None] - where.first[1] + np.arange(WIDTH)
        node = rows * where.lattice[1] + columns
        owner = np.broadcast_to(block[:, None, None], node.shape)
        entries = weight.ravel(), (owner.ravel().astype(np.int32), node.ravel().astype(np.int32))
        parts.append(sparse.csr_array(sparse.coo_array(entries, shape=(some.n, nodes))))
    return sparse.csr_array(sparse.vstack(parts, format="csr"))


def _rows_and_columns(grid: Grid, place_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) rows and columns of the grid's lattice, not whole."""
    return (grid.y_mm[0] - place_mm[:, 1]) / grid.pitch_mm, (place_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm
