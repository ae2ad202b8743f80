"""The removal spot along a path, as the robot's compliance changes it, and its effect matrix (paper eq. 45-49)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.process import Correction, HybridRobot, Placement, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.compliance import equivalent_compliance, jumps
from polishd.process.contact import contact_radius_mm, dissipative_shift_mm
from polishd.process.frames import dips_deg, directions_to_base, points_to_base, surface_normals
from polishd.process.robot import tip_compliance_mm_per_n
from polishd.process.robot.refusal import refuse_where, require_unit_vectors, require_vectors
from polishd.process.spot import overlap, spot_patch

HERTZ_EXPONENT = 1.5
"""Volume goes as depth to this power: what the correction "power" assumes."""
DIP_TOLERANCE_DEG = 0.5
"""How far the program's tool axis may be from the dip that the process states."""
CHUNK = 1024
"""Spot positions worked on at a time: bounds memory, and keeps the patches in the processor's cache."""


def path_compliance(
    program: Program, process: ToolProcess, robot: HybridRobot, placement: Placement
) -> tuple[FloatArray, int]:
    """(n,) linear equivalent compliance at the timed points, mm/N, and how often it jumps (see `compliance.jumps`).

    The pose is the block's middle with the axis at its end; the surface normal is that of a flat part.
    Raises ComputeError for a point that is out of reach or whose axis is not dipped as the process says.
    """
    start = require_vectors("start of block", program.start_mm, "mm")
    end = require_vectors("end of block", program.end_mm, "mm")
    axis = require_unit_vectors("tool axis", program.axis)
    if not len(start) == len(end) == len(axis):
        raise ComputeError(f"the program has {len(start)} starts, {len(end)} ends and {len(axis)} axes")
    base_axis, normal = directions_to_base(placement, axis), surface_normals(placement, len(axis))
    dip = dips_deg(base_axis, normal)
    off = ~(np.abs(dip - process.dip_deg) <= DIP_TOLERANCE_DEG)
    refuse_where(off, dip, "the program's tool axis is dipped: the dip", "deg", f"the process says {process.dip_deg:g}")
    matrix = tip_compliance_mm_per_n(robot, points_to_base(placement, (start + end) / 2), base_axis)
    compliance = equivalent_compliance(matrix, base_axis, normal)
    return compliance, int(jumps(compliance, matrix).sum())


def corrected_spot(correction: Correction, depth_mm: float, gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Depth (n,) mm of the contact and factor (n,) on its removal that a correction stands for, at depth ratios gamma.

    "exact" takes each point's own depth (eq. 45), "linear" eq. 49 as printed, "power" ``gamma^1.5``, "none" R_0.
    "pointwise" is not a change of the effect, and is refused: it is R_0 ("none") with the solved dwell over gamma.
    """
    rigid, one = np.full_like(gamma, depth_mm), np.ones_like(gamma)
    match correction:
        case "exact":
            return gamma * depth_mm, one
        case "none":
            return rigid, one
        case "linear":
            return rigid, gamma
        case "power":
            return rigid, gamma**HERTZ_EXPONENT
        case _:
            raise ComputeError(
                f"the correction {correction!r} has no effect matrix of its own; use exact, linear, power or none"
            )


def effect_matrix(
    grid: Grid, process: ToolProcess, program: Program, depth_mm: FloatArray, factor: FloatArray
) -> sparse.csr_array:
    """(ny * nx, n) removal rate of each timed point averaged over each sample's cell, nm/s (eq. 47).

    ``depth_mm`` and ``factor``, (n,), as of `corrected_spot`. A block that moves spreads its removal evenly from start
    to end. What falls beyond the grid is lost; a spot that does not touch it leaves an empty column.
    A column's sum is exact; a cell of 0.5 mm or more is right within 0.6 % of the peak (0.3 % in motion).
    """
    refuse_where(~((factor >= 0) & np.isfinite(factor)), factor, "the factor on the removal", "", "it must be finite")
    refuse_where(~((depth_mm > 0) & np.isfinite(depth_mm)), depth_mm, "the depth", "mm", "it must be above 0")
    azimuth = np.arctan2(program.axis[:, 1], program.axis[:, 0])
    radius = contact_radius_mm(process, depth_mm)
    across = np.stack([np.sin(azimuth), -np.cos(azimuth)], axis=1)
    shift = dissipative_shift_mm(process, depth_mm)[:, None] * across
    start, end = program.start_mm[:, :2] + shift, program.end_mm[:, :2] + shift
    pieces = np.ceil(2 * program.length_mm / radius).astype(np.int64)
    parts = []
    for part in _chunks(np.maximum(2 * pieces, 1)):
        block, position = _positions(start[part], end[part], pieces[part])
        patch = spot_patch(process, depth_mm[part], azimuth[part])
        patch *= (factor[part] / np.bincount(block, minlength=len(patch)))[:, None, None]
        parts.append(_columns(grid, block, position, radius[part], patch))
    if not parts:
        return sparse.csr_array((grid.ny * grid.nx, 0))
    return sparse.csr_array(sparse.hstack(parts, format="csr"))


def _chunks(count: NDArray[np.int64]) -> Iterator[slice]:
    """Cut blocks with (n,) spot positions each into runs of about CHUNK positions."""
    chunk = (np.cumsum(count) - count) // CHUNK
    edges = [0, *(np.flatnonzero(np.diff(chunk)) + 1).tolist(), len(count)]
    for first, last in pairwise(edges):
        if last > first:
            yield slice(first, last)


def _positions(
    start_mm: FloatArray, end_mm: FloatArray, pieces: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Spot positions of blocks: the block (s,) each belongs to, and (s, 2) x and y in mm.

    Two Gauss points to each of a block's ``pieces`` (n,), each at most half the contact's radius long; one at rest.
    """
    count = np.maximum(2 * pieces, 1)
    block = np.repeat(np.arange(len(count)), count)
    k = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
    gauss = np.where(k % 2 == 0, -1, 1) / np.sqrt(12)
    share = np.where(pieces[block] > 0, (k // 2 + 0.5 + gauss) / np.maximum(pieces[block], 1), 0.0)
    return block, start_mm[block] + share[:, None] * (end_mm - start_mm)[block]


def _columns(
    grid: Grid, block: NDArray[np.int64], position_mm: FloatArray, radius_mm: FloatArray, patch: FloatArray
) -> sparse.csc_array:
    """(ny * nx, n) columns of n blocks: each block's (PATCH, PATCH) spot laid down at each of its positions."""
    pitch, radius = grid.pitch_mm, radius_mm[block]
    column, across = overlap(position_mm[:, 0] + grid.nx * pitch / 2, radius, pitch)
    row, down = overlap(grid.ny * pitch / 2 - position_mm[:, 1], radius, pitch)
    rate = down @ patch[block] @ across.transpose(0, 2, 1) / pitch**2
    rows = row[:, None, None] + np.arange(rate.shape[1])[:, None]
    columns = column[:, None, None] + np.arange(rate.shape[2])
    on = (rows >= 0) & (rows < grid.ny) & (columns >= 0) & (columns < grid.nx) & (rate > 0)
    sample = (rows * grid.nx + columns)[on].astype(np.int32)
    owner = np.broadcast_to(block[:, None, None], rate.shape)[on].astype(np.int32)
    return sparse.csc_array(sparse.coo_array((rate[on], (sample, owner)), shape=(grid.ny * grid.nx, len(patch))))
