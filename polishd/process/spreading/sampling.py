"""How far an effect without a matrix is from the matrix: exact rows of it at samples taken at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray, Grid
from polishd.process.effect import Effect
from polishd.process.spot import Spot
from polishd.process.spreading.blocks import Blocks, Indices, effect_row

ROUNDS = 8
SAMPLES = 4
"""At most, in a round."""
TRIALS = 40
SIGMAS = 4.0
"""About the largest of ten thousand."""
MARGIN_CELLS = 4.0
"""About a spot, where weights on nodes make it reach further than it does."""


@dataclass(frozen=True, slots=True)
class SampledRows:
    """Rows of an effect matrix, and the blocks that enter any of them."""

    which: Indices
    """(b,) these blocks, rising."""
    sample: Indices
    """(r, 2) row and column on the grid of each sample; so far apart that no block enters two rows."""
    row: Indices
    """(b,) the row that each block enters."""
    rate: FloatArray
    """(b,) nm/s, what it enters it with."""

    def off(self, effect: Effect) -> FloatArray:
        """(b,) nm/s: how much more than it should each of these b blocks removes at its sample."""
        weight = np.zeros(effect.grid.shape)
        weight[self.sample[:, 0], self.sample[:, 1]] = 1.0
        return np.asarray(effect.adjoint(weight) - self.rate, dtype=np.float64)


def misses(rounds: Sequence[SampledRows], effects: Sequence[Effect]) -> tuple[float, float]:
    """How far effects, one for the blocks of each round, are off: the removal, and the worst entry of a column.

    The removal's error is SIGMAS standard deviations over the samples, for dwells that vary from block to block by as
    much as they are long, independently; over the largest removal of a flat dwell at a sample. The entry's is over the
    largest entry.
    """
    square, entry = [], 0.0
    for rows, effect in zip(rounds, effects, strict=True):
        off, count = rows.off(effect), len(rows.sample)
        square.append(np.bincount(rows.row, off, count) ** 2 + np.bincount(rows.row, off**2, count))
        entry = max(entry, float(np.abs(off).max()))
    flat = max(float(np.bincount(rows.row, rows.rate).max()) for rows in rounds)
    deviation = float(np.sqrt(np.concatenate(square).mean()))
    return SIGMAS * deviation / flat, entry / max(float(rows.rate.max()) for rows in rounds)


def sampled_rounds(grid: Grid, spot: Spot, blocks: Blocks) -> list[SampledRows]:
    """Exact rows at samples under blocks chosen at random: up to ROUNDS; none where no block touches the grid."""
    found = (sampled_rows(grid, spot, blocks, seed) for seed in range(ROUNDS))
    return [rows for rows in found if rows is not None]


def sampled_rows(grid: Grid, spot: Spot, blocks: Blocks, seed: int) -> SampledRows | None:
    """Exact rows at up to SAMPLES samples under blocks chosen at random; None where no block touches the grid."""
    rng = np.random.default_rng(seed)
    middle = (blocks.start_mm + blocks.end_mm) / 2
    reach = blocks.reach_mm(spot) + MARGIN_CELLS * grid.pitch_mm
    free = np.ones(blocks.n, dtype=bool)
    found: list[tuple[Indices, tuple[int, int], FloatArray]] = []
    for k in rng.integers(blocks.n, size=TRIALS) if blocks.n else ():
        x_mm, y_mm = middle[k] + rng.uniform(-0.5, 0.5, 2) * reach[k]
        row, column = round((grid.y_mm[0] - y_mm) / grid.pitch_mm), round((x_mm - grid.x_mm[0]) / grid.pitch_mm)
        if not (0 <= row < grid.ny and 0 <= column < grid.nx) or len(found) == SAMPLES:
            continue
        at = np.array([grid.x_mm[column], grid.y_mm[row]])
        near = np.flatnonzero(np.linalg.norm(middle - at, axis=1) <= reach)
        if free[near].all():
            free[near] = False
            found.append((near, (row, column), effect_row(spot, blocks.part(near), at, grid.pitch_mm)))
    found = [one for one in found if one[2].any()]
    if not found:
        return None
    which, sample, rate = zip(*found, strict=True)
    order = np.argsort(np.concatenate(which))
    row_of = np.repeat(np.arange(len(which)), [len(near) for near in which])
    return SampledRows(np.concatenate(which)[order], np.array(sample), row_of[order], np.concatenate(rate)[order])
