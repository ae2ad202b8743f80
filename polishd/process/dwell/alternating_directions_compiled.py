"""A step of `alternating_directions` compiled by numba: each step reads blocks and nodes as rarely as possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.dwell.alternating_step import RELAXATION, AlternatingStep, step_sizes
from polishd.process.fft.simd import COUNT, load, store
from polishd.process.fft.transforms import (
    FftPlanArrays,
    columns_back,
    columns_forth,
    inline,
    kernel,
    rows_back,
    rows_forth,
)
from polishd.process.removal import spread_effect_compiled
from polishd.process.removal.spread_effect_compiled import (
    BlockWeights,
    CompiledSpread,
    Floats,
    Nodes,
    collect,
    compiled_spread,
    remove,
    restore,
    spread_blocks,
)

sizes = inline(step_sizes)

_NONE = np.float32(0)


class DwellBuffers(NamedTuple):
    """The walk's, (n,) each, float64, and what a step finds."""

    lower: FloatArray
    upper: FloatArray
    bounded: FloatArray
    free: FloatArray
    slope: FloatArray
    multiplier: FloatArray
    last_way: FloatArray
    last_bend: FloatArray
    uphill: FloatArray
    way: FloatArray
    bend: FloatArray


class NodeBuffers(NamedTuple):
    """Arrays of a step beside the effect's nodes, in the layout of `plane`."""

    metric: Floats
    """Nodes of the metric."""
    flat: Floats
    """Alias of the same memory."""
    share: Floats
    """(blocks, ny, COUNT) the metric's, of each frequency."""
    weight: Floats
    """Weight of a sample in the curvature; 0 outside the mask."""


class AlternatingStepScalars(NamedTuple):
    """Scalars of a step."""

    relaxation: float
    pull: float
    held: float
    regularisation: float


@dataclass(slots=True)
class CompiledAlternatingStep(AlternatingStep):
    """A Walk whose steps are compiled; its effect has nodes as wide as samples."""

    _spread: CompiledSpread | None = None
    _fields: NodeBuffers | None = None
    _bounds: tuple[FloatArray, FloatArray] | None = None
    """Copies, because numba compiles a second version for read-only arrays."""

    def _go(self) -> None:
        """See Walk."""
        self._spread = spread = self._spread or compiled_spread(self.near.effect)
        self._fields = fields = self._fields or self._made(spread)
        numbers = AlternatingStepScalars(RELAXATION, self.near.pull, self.near.held, self.problem.regularisation)
        found = (np.empty_like(self.free) for _ in range(3))
        self._bounds = bounds = self._bounds or (self.problem.lower_s.copy(), self.problem.upper_s.copy())
        dwells = DwellBuffers(
            *bounds, self.bounded, self.free, self.slope, self.multiplier, self.way, self.bend, *found
        )
        kernel(_step, spread_effect_compiled.__file__, __file__)(
            dwells, spread.laid, spread.nodes, fields, numbers, spread.plane.order
        )

    def _draw(self, pull: float) -> None:
        """See Walk."""
        super(CompiledAlternatingStep, self)._draw(pull)
        self._fields = None

    def _made(self, spread: CompiledSpread) -> NodeBuffers:
        mask, on = self.problem.solve_mask, spread.plane
        weight = np.zeros(on.size)
        weight[self.near.effect.on_grid] = np.where(
            mask, 1.0 if self.problem.weight is None else self.problem.weight, 0.0
        )
        metric = on.packed(np.zeros(on.size))
        counts = on.packed(weight * (2 / np.count_nonzero(mask)))
        return NodeBuffers(metric, metric.reshape(-1), on.spectrum(self.near.share)[0], counts)


def _step(
    dwells: DwellBuffers,
    laid: BlockWeights,
    nodes: Nodes,
    fields: NodeBuffers,
    numbers: AlternatingStepScalars,
    order: FftPlanArrays,
) -> None:
    _lay_uphill(dwells, laid, fields, numbers)
    _measure(nodes, fields, order)
    _lay_way(dwells, laid, nodes, fields, numbers)
    remove(nodes, order)
    _weigh(nodes, fields, order)
    restore(nodes, order)
    new, old = _bend(dwells, laid, nodes, numbers)
    for i in range(len(dwells.free)):
        way = new * dwells.way[i] + old * dwells.last_way[i]
        bend = new * dwells.bend[i] + old * dwells.last_bend[i]
        free, lower, upper = dwells.free[i] + way, dwells.lower[i], dwells.upper[i]
        drawn = numbers.relaxation * free + (1 - numbers.relaxation) * dwells.bounded[i] + dwells.multiplier[i]
        bounded = min(max(drawn, lower), upper)
        dwells.free[i], dwells.bounded[i], dwells.multiplier[i] = free, bounded, drawn - bounded
        dwells.slope[i] += bend
        dwells.last_way[i], dwells.last_bend[i] = way, bend


@inline
def _lay_uphill(dwells: DwellBuffers, laid: BlockWeights, fields: NodeBuffers, numbers: AlternatingStepScalars) -> None:
    """Spread the uphill direction onto the metric's nodes."""
    fields.flat[:] = 0
    for i in range(len(dwells.free)):
        apart = dwells.free[i] - dwells.bounded[i] + dwells.multiplier[i]
        uphill = dwells.slope[i] + numbers.pull * apart
        dwells.uphill[i] = uphill
        for j in range(laid.first[i], laid.first[i + 1]):
            fields.flat[laid.node[j]] += laid.weight[j] * np.float32(uphill)


@inline
def _measure(nodes: Nodes, fields: NodeBuffers, order: FftPlanArrays) -> None:
    """The metric's nodes, by its share of each frequency."""
    columns = nodes.columns[0]
    for slab in range(order.slabs):
        rows_forth(fields.metric, slab, order)
    for block in range(order.blocks):
        columns_forth(fields.metric, block, columns, order)
        for row in range(order.column.n):
            i = row * COUNT
            share = nodes.scale * load(fields.share[block], i)
            store(columns[0], i, share * load(columns[0], i))
            store(columns[1], i, share * load(columns[1], i))
        columns_back(fields.metric, block, columns, order)
    for slab in range(order.slabs):
        rows_back(fields.metric, slab, order)


@inline
def _lay_way(
    dwells: DwellBuffers, laid: BlockWeights, nodes: Nodes, fields: NodeBuffers, numbers: AlternatingStepScalars
) -> None:
    """The way down in the metric, onto each convolution's nodes."""
    nodes.flat[:] = 0
    for i in range(len(dwells.way)):
        near = _NONE
        for j in range(laid.first[i], laid.first[i + 1]):
            near += laid.weight[j] * fields.flat[laid.node[j]]
        dwells.way[i] = (near - dwells.uphill[i]) / numbers.held
        spread_blocks(i, dwells.way[i], laid, nodes)


@inline
def _weigh(nodes: Nodes, fields: NodeBuffers, order: FftPlanArrays) -> None:
    """Sample by sample: what the removal there counts."""
    removal = nodes.fields[0]
    for slab in range(order.slabs):
        rows_back(removal, slab, order)
        for half in range(2):
            for x in range(order.row.n):
                i = x * COUNT
                store(removal[half, slab], i, load(fields.weight[half, slab], i) * load(removal[half, slab], i))
        rows_forth(removal, slab, order)


@inline
def _bend(
    dwells: DwellBuffers, laid: BlockWeights, nodes: Nodes, numbers: AlternatingStepScalars
) -> tuple[float, float]:
    """Compute the change of the slope and the step sizes along this and the last direction."""
    down = last_down = p = q = r = 0.0
    for i in range(len(dwells.way)):
        way, last = dwells.way[i], dwells.last_way[i]
        bend = collect(i, laid, nodes) + 2 * numbers.regularisation * way
        last_bend = dwells.last_bend[i] + numbers.pull * last
        dwells.bend[i] = bend
        down += dwells.uphill[i] * way
        last_down += dwells.uphill[i] * last
        p += way * (bend + numbers.pull * way)
        q += way * last_bend
        r += last * last_bend
    return sizes((down, last_down), (p, q, r))
