"""What polishes where: blocks at rest or in motion, each with its own spot; and exact rows of their effect."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import refuse_where
from polishd.process.removal.dynamic_tif import lean_azimuth_rad, positions
from polishd.process.removal.tif import Spot, cell_shares, tilt_spot

Indices = NDArray[np.int64]

BLOCK_CHUNK = 256
"""Blocks worked on at a time: bounds memory."""


@dataclass(frozen=True, slots=True)
class PathBlocks:
    """n blocks of a path, and what the spot is in each of them."""

    start_mm: FloatArray
    """(n, 2) part's x and y."""
    end_mm: FloatArray
    """(n, 2)"""
    azimuth_rad: FloatArray
    """(n,) where the spindle leans."""
    depth_ratio: FloatArray
    """(n,) as of `corrected_spot`, sunk at the rim."""
    factor: FloatArray
    """(n,) on the removal."""
    bent: FloatArray | None = None
    """(n, 3) how the part's curvature makes each contact wider along x and y, and askew (`curved.Curved`); None: as on
    a flat."""

    @property
    def n(self) -> int:
        """Number of blocks."""
        return len(self.factor)

    def part(self, which: Indices | slice) -> PathBlocks:
        """Some of them."""
        return PathBlocks(
            self.start_mm[which], self.end_mm[which], self.azimuth_rad[which], self.depth_ratio[which],
            self.factor[which], None if self.bent is None else self.bent[which],
        )  # fmt: skip

    def seen_from(self, origin_mm: FloatArray) -> PathBlocks:
        """The same, (2,) ``origin_mm`` at their origin."""
        return replace(self, start_mm=self.start_mm - origin_mm, end_mm=self.end_mm - origin_mm)

    def positions(self, spot: Spot) -> tuple[Indices, FloatArray, FloatArray]:
        """The places that stand for the blocks, as in `effect_columns`: (m,) block, (m, 2) mm, (m,) share of it."""
        length = np.linalg.norm(self.end_mm - self.start_mm, axis=1)
        if self.bent is not None:
            length = length / self.bent[:, :2].min(axis=1)
        pieces = np.ceil(length / spot.step_mm(self.depth_ratio)).astype(np.int64)
        block, place = positions(self.start_mm, self.end_mm, pieces)
        return block, place, 1 / np.bincount(block, minlength=self.n)[block]

    def half_mm(self, spot: Spot) -> FloatArray:
        """(n, 2) half the sides of each patch, along x and y."""
        half = spot.half_width_mm(self.depth_ratio)[:, None]
        return np.asarray(half * (np.ones(2) if self.bent is None else self.bent[:, :2]), dtype=np.float64)

    def reach_mm(self, spot: Spot) -> FloatArray:
        """(n,) radius about the middle of each block outside which it removes nothing."""
        offset = np.linalg.norm(spot.offset_mm(self.depth_ratio, self.azimuth_rad), axis=1)
        length = np.linalg.norm(self.end_mm - self.start_mm, axis=1)
        return np.asarray(np.linalg.norm(self.half_mm(spot), axis=1) + offset + length / 2, dtype=np.float64)


def blocks_of(
    program: Program, depth_ratio: FloatArray, factor: FloatArray, bent: FloatArray | None = None
) -> PathBlocks:
    """The blocks of a program; depth ratios and factors (n,) as of `corrected_spot`. ComputeError: they cannot be."""
    refuse_where(~((factor >= 0) & np.isfinite(factor)), factor, "the factor on the removal", "", "it must be finite")
    impossible = ~((depth_ratio > 0) & np.isfinite(depth_ratio))
    refuse_where(impossible, depth_ratio, "the depth ratio gamma", "", "it must be above 0")
    ends = program.start_mm[:, :2], program.end_mm[:, :2]
    return PathBlocks(*ends, lean_azimuth_rad(program), depth_ratio, factor, bent)


def effect_row(spot: Spot, blocks: PathBlocks, sample_mm: FloatArray, pitch_mm: float) -> FloatArray:
    """(n,) nm/s: the row of `effect_columns` for the cell about (2,) ``sample_mm``, and nothing else of it."""
    reached = _touching(spot, blocks, sample_mm, pitch_mm)
    rates = np.zeros(blocks.n)
    for which in np.split(reached, range(BLOCK_CHUNK, reached.size, BLOCK_CHUNK)):
        some = blocks.part(which)
        block, place, share = some.positions(spot)
        half = some.half_mm(spot)[block]
        away = place + spot.offset_mm(some.depth_ratio, some.azimuth_rad)[block] - sample_mm
        patch = spot.patch(some.depth_ratio, some.azimuth_rad)
        centre = pitch_mm / 2 + away * [1, -1]
        (column, across), (row, down) = (
            _inside(cell_shares(at, wide, pitch_mm, 1, patch.shape[1]))
            for at, wide in zip(centre.T, half.T, strict=True)
        )
        if some.bent is None:
            squares = patch[block[:, None, None], row[:, :, None], column[:, None, :]]
        else:  # of a spot that is large against the cell only these rows are made askew: that is most of the work
            strip = tilt_spot(patch[block[:, None], row], some.bent[block, 2], row)
            squares = np.take_along_axis(strip, column[:, None, :], axis=2)
        rate = np.einsum("mi,mij,mj->m", down, squares, across) / pitch_mm**2
        rates[which] = np.bincount(block, share * rate, some.n) * some.factor
    return rates


def _inside(share: FloatArray) -> tuple[Indices, FloatArray]:
    """(m, 1, squares) shares in a cell -> (m, few) the squares that may have any, and theirs."""
    some = share[:, 0] > 0
    width = max(int(some.sum(axis=1).max(initial=0)), 1)
    which = np.minimum(np.argmax(some, axis=1), some.shape[1] - width)[:, None] + np.arange(width)
    return which, np.take_along_axis(share[:, 0], which, axis=1)


def _touching(spot: Spot, blocks: PathBlocks, sample_mm: FloatArray, pitch_mm: float) -> Indices:
    """The blocks whose patch touches the cell from any of their positions."""
    block, place, _ = blocks.positions(spot)
    away = place + spot.offset_mm(blocks.depth_ratio, blocks.azimuth_rad)[block] - sample_mm
    half = blocks.half_mm(spot)[block] + pitch_mm / 2
    return np.unique(block[(np.abs(away) < half).all(axis=1)])


# How far an effect without a matrix is from the matrix: exact rows of it at samples taken at random.

SAMPLES = 24
SIGMAS = 4.0
"""About the largest of ten thousand."""
MARGIN_CELLS = 4.0
"""About a spot, where weights on nodes make it reach further than it does."""


@dataclass(frozen=True, slots=True)
class SampledRow:
    """A row of an effect matrix, seen from its sample."""

    which: Indices
    """(b,) the blocks that enter it, rising, and others near by."""
    blocks: PathBlocks
    """These, the sample at their origin."""
    grid: Grid
    """As much of the process grid as they reach, the sample in its middle."""
    rate: FloatArray
    """(b,) nm/s, what each enters the row with."""

    @property
    def only_sample(self) -> FloatArray:
        """(ny, nx) of its grid: 1 at the sample, 0 elsewhere."""
        weight = np.zeros(self.grid.shape)
        weight[self.grid.ny // 2, self.grid.nx // 2] = 1.0
        return weight


def sampled_rows(grid: Grid, spot: Spot, blocks: PathBlocks, seed: int = 0) -> list[SampledRow]:
    """Exact rows at up to SAMPLES samples under blocks chosen at random; none where no block touches the grid."""
    rng = np.random.default_rng(seed)
    middle = (blocks.start_mm + blocks.end_mm) / 2
    reach = blocks.reach_mm(spot) + MARGIN_CELLS * grid.pitch_mm
    found: list[SampledRow] = []
    for k in rng.integers(blocks.n, size=2 * SAMPLES) if blocks.n else ():
        x_mm, y_mm = middle[k] + rng.uniform(-0.5, 0.5, 2) * reach[k]
        row, column = round((grid.y_mm[0] - y_mm) / grid.pitch_mm), round((x_mm - grid.x_mm[0]) / grid.pitch_mm)
        if not (0 <= row < grid.ny and 0 <= column < grid.nx) or len(found) == SAMPLES:
            continue
        at = np.array([grid.x_mm[column], grid.y_mm[row]])
        near = np.flatnonzero(np.linalg.norm(middle - at, axis=1) <= reach)
        some = blocks.part(near).seen_from(at)
        rate = effect_row(spot, some, np.zeros(2), grid.pitch_mm)
        if rate.any():
            side = 2 * int(np.ceil(reach[near].max() / grid.pitch_mm)) + 1
            found.append(SampledRow(near, some, Grid(side, side, grid.pitch_mm), rate))
    return found


def effect_errors(rows: Iterable[SampledRow], found: Iterable[FloatArray]) -> tuple[float, float]:
    """How far an effect is off that gives these rows, (b,) nm/s each: the removal, and the worst entry of a column.

    The removal's error is SIGMAS standard deviations over the samples, for dwells that vary from block to block by as
    much as they are long, independently; over the largest removal of a flat dwell at a sample. The entry's is over the
    largest entry.
    """
    square, entry, flat, largest = [], 0.0, 0.0, 0.0
    for row, rate in zip(rows, found, strict=True):
        off = rate - row.rate
        square.append(float(off.sum() ** 2 + off @ off))
        entry, largest = max(entry, float(np.abs(off).max())), max(largest, float(row.rate.max()))
        flat = max(flat, float(row.rate.sum()))
    return SIGMAS * float(np.sqrt(np.mean(square))) / flat, entry / largest
