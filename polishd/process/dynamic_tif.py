"""The removal spot along a path, as the robot's compliance changes it, and its effect matrix (paper eq. 45-49)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.process import Correction
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.robot.refusal import refuse_where
from polishd.process.spot import PATCH, Spot, overlap

CHUNK = 1024
"""Positions of a spot of PATCH squares across that are worked on at a time: bounds memory, keeps patches in cache."""


@dataclass(frozen=True, slots=True)
class CorrectedSpot:
    """What a correction makes of the spot at n points."""

    depth_ratio: FloatArray
    """(n,) depth of the contact over the rigid robot's."""
    factor: FloatArray
    """(n,) on its removal."""
    divide_by: FloatArray | None = None
    """(n,) what the solved dwell is divided by; None: nothing."""


def corrected_spot(
    correction: Correction, gamma: FloatArray, exponent: float = 1.5, reference: float = 1.0
) -> CorrectedSpot:
    """The spot that a correction stands for, at (n,) depth ratios gamma (eq. 48).

    "exact" takes each point's own depth (eq. 45). The others take one spot for all, that of the depth ratio
    ``reference`` (1: the rigid robot's R_0): "none" as it is, "linear" times gamma (eq. 49 as printed), "power" times
    ``gamma^exponent``, "pointwise" as it is with the solved dwell over gamma (ref. 17); gamma over the reference's.
    """
    fixed, one = np.full_like(gamma, reference), np.ones_like(gamma)
    match correction:
        case "exact":
            return CorrectedSpot(gamma, one)
        case "none":
            return CorrectedSpot(fixed, one)
        case "linear":
            return CorrectedSpot(fixed, gamma / reference)
        case "power":
            return CorrectedSpot(fixed, (gamma / reference) ** exponent)
        case "pointwise":
            return CorrectedSpot(fixed, one, gamma / reference)
        case _:
            raise ComputeError(f"no correction {correction!r}; use exact, power, linear, pointwise or none")


def effect_matrix(
    grid: Grid, spot: Spot, program: Program, depth_ratio: FloatArray, factor: FloatArray
) -> scipy.sparse.csr_array:
    """(ny * nx, n) removal rate of each timed point averaged over each sample's cell, nm/s (eq. 47).

    ``depth_ratio`` and ``factor``, (n,), as of `corrected_spot`. A block that moves spreads its removal evenly from
    start to end. What falls beyond the grid is lost; a spot that does not touch it leaves an empty column.
    A column's sum is exact; the paper's Hertz spot, at rest or in motion, is right in each cell of 0.5 mm within 1.2 %
    of the peak (half of the spots within 0.6 %), of 1 mm within 0.6 %.
    """
    ends = (program.start_mm[:, :2], program.end_mm[:, :2])
    return effect_columns(grid, spot, ends, lean_azimuth_rad(program), depth_ratio=depth_ratio, factor=factor)


def effect_columns(
    grid: Grid,
    spot: Spot,
    ends_mm: tuple[FloatArray, FloatArray],
    azimuth_rad: FloatArray,
    *,
    depth_ratio: FloatArray,
    factor: FloatArray,
) -> scipy.sparse.csr_array:
    """`effect_matrix` of blocks from (n, 2) to (n, 2) mm, the spindle leaning towards (n,) ``azimuth_rad``."""
    refuse_where(~((factor >= 0) & np.isfinite(factor)), factor, "the factor on the removal", "", "it must be finite")
    impossible = ~((depth_ratio > 0) & np.isfinite(depth_ratio))
    refuse_where(impossible, depth_ratio, "the depth ratio gamma", "", "it must be above 0")
    half = spot.half_width_mm(depth_ratio)
    offset = spot.offset_mm(depth_ratio, azimuth_rad)
    start, end = (at + offset for at in ends_mm)
    length = np.linalg.norm(end - start, axis=1)
    pieces = np.ceil(length / spot.step_mm(depth_ratio)).astype(np.int64)
    parts = []
    squares = spot.patch(depth_ratio[:1], azimuth_rad[:1]).shape[-1]
    for part in _chunks(np.maximum(2 * pieces, 1) * max(1, round((squares / PATCH) ** 2))):
        block, position = positions(start[part], end[part], pieces[part])
        patch = spot.patch(depth_ratio[part], azimuth_rad[part])
        patch *= (factor[part] / np.bincount(block, minlength=len(patch)))[:, None, None]
        parts.append(_columns(grid, block, position, half[part], patch))
    if not parts:
        return scipy.sparse.csr_array((grid.ny * grid.nx, 0))
    return scipy.sparse.csr_array(scipy.sparse.hstack(parts, format="csr"))


def lean_azimuth_rad(program: Program) -> FloatArray:
    """(n,) where the spindle leans at each timed point, counterclockwise from the part's x."""
    return np.asarray(np.arctan2(program.axis[:, 1], program.axis[:, 0]), dtype=np.float64)


def _chunks(count: NDArray[np.int64]) -> Iterator[slice]:
    """Cut blocks that hold as much as (n,) positions of a spot of PATCH squares across into runs of about CHUNK."""
    chunk = (np.cumsum(count) - count) // CHUNK
    edges = [0, *(np.flatnonzero(np.diff(chunk)) + 1).tolist(), len(count)]
    for first, last in pairwise(edges):
        if last > first:
            yield slice(first, last)


def positions(
    start_mm: FloatArray, end_mm: FloatArray, pieces: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Spot positions of blocks: the block (s,) each belongs to, and (s, 2) x and y in mm.

    Two Gauss points to each of a block's ``pieces`` (n,), each at most a step of the spot long; one at rest.
    """
    count = np.maximum(2 * pieces, 1)
    block = np.repeat(np.arange(len(count)), count)
    k = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
    gauss = np.where(k % 2 == 0, -1, 1) / np.sqrt(12)
    share = np.where(pieces[block] > 0, (k // 2 + 0.5 + gauss) / np.maximum(pieces[block], 1), 0.0)
    return block, start_mm[block] + share[:, None] * (end_mm - start_mm)[block]


def _columns(
    grid: Grid, block: NDArray[np.int64], position_mm: FloatArray, half_mm: FloatArray, patch: FloatArray
) -> scipy.sparse.csc_array:
    """(ny * nx, n) columns of n blocks: each block's patch laid down at each of its positions."""
    pitch, half, squares = grid.pitch_mm, half_mm[block], patch.shape[1]
    column, across = overlap(position_mm[:, 0] + grid.nx * pitch / 2, half, pitch, squares)
    row, down = overlap(grid.ny * pitch / 2 - position_mm[:, 1], half, pitch, squares)
    rate = down @ patch[block] @ across.transpose(0, 2, 1) / pitch**2
    rows = row[:, None, None] + np.arange(rate.shape[1])[:, None]
    columns = column[:, None, None] + np.arange(rate.shape[2])
    on = (rows >= 0) & (rows < grid.ny) & (columns >= 0) & (columns < grid.nx) & (rate > 0)
    sample = (rows * grid.nx + columns)[on].astype(np.int32)
    owner = np.broadcast_to(block[:, None, None], rate.shape)[on].astype(np.int32)
    return scipy.sparse.csc_array(
        scipy.sparse.coo_array((rate[on], (sample, owner)), shape=(grid.ny * grid.nx, len(patch)))
    )
