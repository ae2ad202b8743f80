"""How far an effect without a matrix is from the matrix: exact rows of it at samples taken at random."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray, Grid
from polishd.process.spot import Spot
from polishd.process.spreading.blocks import Indices, PathBlocks, effect_row

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


def misses(rows: Iterable[SampledRow], found: Iterable[FloatArray]) -> tuple[float, float]:
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
