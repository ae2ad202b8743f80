"""A step of `spectral`: of two dwells that are drawn together, one goes down and the other keeps to its bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective
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
from polishd.process.removal.spread_effect import SpreadEffect
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

RELAXATION = 1.7
PULL, HARDER = 1.0, 1.5
"""How strongly the two dwells are drawn together at first, over the geometric mean of the objective's least and most
curvature; and how many times as strongly where they come no nearer. The weaker, the fewer steps, down to where a step
down does not follow any more: between 0.5 and 2, as path, part and spot are."""
LOOK_APART = 20
"""Steps between two looks at how far they are apart."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the most curvature is taken for this, in the pull only."""


@dataclass(frozen=True, slots=True)
class StepMetric:
    """About the objective's curvature and so much more, inverted; made by `metric`."""

    effect: SpreadEffect
    """In float32."""
    least: float
    """Curvature that no spot gives: the regularisation's."""
    square: FloatArray
    """(ny, nx // 2 + 1) curvature that a point on a node gives each frequency; on nodes of the effect's layout."""
    density: float
    """Points to a node."""
    pull: float
    """What is added to the curvature."""

    @property
    def held(self) -> float:
        """Curvature that no spot gives, and the pull."""
        return self.least + self.pull

    @property
    def share(self) -> NDArray[np.float32]:
        """What of each frequency the spots hold, over ``held``."""
        return (self.square / (self.held + self.density * self.square)).astype(np.float32)

    def inverse(self, slope: FloatArray) -> FloatArray:
        """(n,) -> (n,): ``(held + S K* K S')^-1``, exact where the path lays down the same on every node."""
        where, weights, share = self.effect.where, self.effect.weights, self.share
        nodes = (weights.T @ slope.astype(share.dtype)).reshape(where.lattice)
        spectrum = scipy.fft.rfft2(nodes, where.size)
        back = scipy.fft.irfft2(share * spectrum, where.size)[: where.lattice[0], : where.lattice[1]]
        return np.asarray((slope - weights @ back.ravel()) / self.held, dtype=np.float64)


@dataclass(slots=True)
class AlternatingStep:
    """Where the two dwells stand; (n,) each, s."""

    problem: DwellProblem
    """Whose curvature steps are found with."""
    f: QuadraticObjective
    """Its objective."""
    near: StepMetric
    bounded: FloatArray
    free: FloatArray
    """Without bounds."""
    slope: FloatArray
    """(n,) nm^2/s: the objective's gradient at ``free``."""
    multiplier: FloatArray
    way: FloatArray
    """Of the last step."""
    bend: FloatArray
    """(n,) nm^2/s: what it did to the slope."""
    steps: int = 0
    _apart: float = np.inf

    def seen(self, gradient: FloatArray) -> None:
        """The objective's gradient at ``bounded``, exactly: what the slope was off by is put right."""
        # of what is small: float32's floor is of that
        self.slope = gradient + self.f.rough_curvature(self.free - self.bounded)

    def step(self) -> None:
        """One step down in the metric, and one towards each other; drawn harder where that leads nowhere."""
        self._go()
        self.steps += 1
        if self.steps % LOOK_APART == 0:
            apart = float(np.linalg.norm(self.free - self.bounded))
            if apart > self._apart:
                self._draw(HARDER * self.near.pull)
                apart = np.inf
            self._apart = apart

    def _draw(self, pull: float) -> None:
        self.multiplier *= self.near.pull / pull
        self.near = replace(self.near, pull=pull)

    def _go(self) -> None:
        """Down to the least of all that the metric's way and the last step's can be combined to."""
        pull = self.near.pull
        uphill = self.slope + pull * (self.free - self.bounded + self.multiplier)
        way = self.near.inverse(-uphill)
        bend = self.f.rough_curvature(way)
        sizes = step_sizes(
            (float(uphill @ way), float(uphill @ self.way)),
            (
                float(way @ bend + pull * (way @ way)),
                float(way @ self.bend + pull * (way @ self.way)),
                float(self.way @ self.bend + pull * (self.way @ self.way)),
            ),
        )
        self.way, self.bend = (sizes[0] * new + sizes[1] * old for new, old in ((way, self.way), (bend, self.bend)))
        self.free = self.free + self.way
        self.slope = self.slope + self.bend
        drawn = RELAXATION * self.free + (1 - RELAXATION) * self.bounded + self.multiplier
        self.bounded = np.clip(drawn, self.problem.lower_s, self.problem.upper_s)
        self.multiplier = drawn - self.bounded


def step_sizes(slopes: tuple[float, float], curvatures: tuple[float, float, float]) -> tuple[float, float]:
    """How far to go along two ways, down to the least of a quadratic.

    ``slopes`` along each, and ``curvatures``: of the first, of both, of the second; along the first only where the
    second is none of its own.
    """
    (a, b), (p, q, r) = slopes, curvatures
    across = p * r - q * q
    if across <= 1e-6 * p * r:
        return -a / p, 0.0
    return (q * b - r * a) / across, (q * a - p * b) / across


def step_metric(problem: DwellProblem, effect: SpreadEffect) -> StepMetric:
    """The metric of a problem of that effect, with the pull that is tried first."""
    kernel = np.tensordot(effect.coefficients.mean(axis=0), effect.spectra, axes=1)
    mask, weight = (
        problem.solve_mask,
        1.0 if problem.weight is None else float(problem.weight[problem.solve_mask].mean()),
    )
    flat = float(np.median(effect.removal_nm(np.ones(effect.n))[mask]))
    density = flat / float(kernel[0, 0].real)  # points to a node
    square = np.abs(kernel) ** 2 * (2 * weight / (np.count_nonzero(mask) * effect.finer**2))
    least, most = 2 * problem.regularisation, density * float(square.max())
    pull = PULL * float(np.sqrt(max(least, LEAST_REGULARISATION * most) * most))
    return StepMetric(effect.single(), least, square, density, pull)


# A step of `spectral` in compiled code: blocks and nodes are each gone over as rarely as can be.

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
    """What a step needs beside the effect's own nodes; as `plane` keeps it."""

    metric: Floats
    """Nodes of the metric."""
    flat: Floats
    """The same memory."""
    share: Floats
    """(blocks, ny, COUNT) the metric's, of each frequency."""
    weight: Floats
    """What a sample counts in the curvature; 0 where none does."""


class AlternatingStepScalars(NamedTuple):
    """Those of a step."""

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
    """Copies: compiled code is another one for arrays that nobody may write to."""

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
    """Which way is up, onto the metric's nodes."""
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
    """What the way does to the slope, and how far to go along it and along the last one."""
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
