"""The family of one spot over a range of depths and azimuths, as few cell averages as a stated tolerance needs.

On a dwell point that lies on a node of the grid a spot is a window of cell averages. The windows of all depth ratios
and azimuths lie near a space of few dimensions: its basis comes from a singular value decomposition.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import refuse_where, require_number
from polishd.process.removal.dynamic_tif import lean_azimuth_rad, positions
from polishd.process.removal.tif import Spot, cell_shares, tilt_spot

# What polishes where: blocks at rest or in motion, each with its own spot; and exact rows of their effect.

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
    """(n,) as of `tif_at_point`, sunk at the rim."""
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
        """Return the blocks with (2,) ``origin_mm`` as the origin."""
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
    """The blocks of a program; depth ratios and factors (n,) as of `tif_at_point`. ComputeError: they cannot be."""
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
    """Window of the process grid that they reach, the sample in its middle."""
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


RATIOS = 33
"""Depth ratios that the basis is taken from, evenly over their range."""
AZIMUTH_STEP = np.radians(2.0)
"""And azimuths, at most this far apart."""
CHUNK = 128
"""Windows worked on at a time: bounds memory."""


@dataclass(frozen=True, slots=True)
class TifFamily:
    """A basis of the windows of a spot, and how near each point's own window comes to it."""

    kernels: FloatArray
    """(k, m, m) orthonormal windows, m odd, row 0 the top."""
    coefficients: FloatArray
    """(n, k) nm/s: the window of point i is about ``sum_k coefficients[i, k] kernels[k]``."""
    truncation: float
    """Largest relative error of a point's window (Euclidean norm), over all n points: at most the tolerance."""


def tif_family(
    spot: Spot, pitch_mm: float, depth_ratio: FloatArray, azimuth_rad: FloatArray, tolerance: float
) -> TifFamily:
    """The smallest basis that holds the spot within ``tolerance`` over the range of the points' ratios and azimuths.

    ``depth_ratio`` and ``azimuth_rad`` (n,). The basis is taken from a mesh over the range; where a point's own window
    is still missed by more than the tolerance, what is missed is added to it.
    """
    require_number("the tolerance of the TIF's family", tolerance, "", above=0.0, below=1.0)
    require_number("the grid's pitch", pitch_mm, "mm", above=0.0)
    impossible = ~((depth_ratio > 0) & np.isfinite(depth_ratio))
    refuse_where(impossible, depth_ratio, "the depth ratio gamma", "", "it must be above 0")
    reach = reach_cells(spot, pitch_mm, depth_ratio, azimuth_rad)
    size = 2 * reach + 1
    if depth_ratio.size == 0:
        return TifFamily(np.zeros((1, size, size)), np.zeros((0, 1)), 0.0)

    def project(basis: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """Coefficients, the largest relative error, and what is left, relative, of windows missed by too much."""
        parts, worst, missed = [], 0.0, []
        for part in chunks(depth_ratio.size):
            window = windows(spot, pitch_mm, depth_ratio[part], azimuth_rad[part], reach)
            parts.append(window @ basis)
            left = (window - parts[-1] @ basis.T) / np.linalg.norm(window, axis=1)[:, None]
            error = np.linalg.norm(left, axis=1)
            worst = max(worst, float(error.max()))
            missed.append(left[error > tolerance])
        return np.concatenate(parts), worst, np.concatenate(missed)

    ratio, azimuth = _samples(depth_ratio, azimuth_rad)
    mesh = np.concatenate([windows(spot, pitch_mm, ratio[p], azimuth[p], reach) for p in chunks(ratio.size)])
    basis = smallest_basis(mesh / np.linalg.norm(mesh, axis=1)[:, None], tolerance)
    coefficients, worst, missed = project(basis)
    if len(missed):
        # what was missed is orthogonal to the basis only as far as rounding allows
        basis = np.linalg.qr(np.hstack([basis, smallest_basis(missed, tolerance)]))[0]
        coefficients, worst, _ = project(basis)
    return TifFamily(basis.T.reshape(-1, size, size), coefficients, worst)


def patches(spot: Spot, depth_ratio: FloatArray, azimuth_rad: FloatArray, bent: FloatArray | None) -> FloatArray:
    """(n, squares, squares) of a spot, on a curved part askew; ``bent`` as of `Blocks`."""
    patch = spot.patch(depth_ratio, azimuth_rad)
    return patch if bent is None else tilt_spot(patch, bent[:, 2])


def windows(
    spot: Spot,
    pitch_mm: float,
    depth_ratio: FloatArray,
    azimuth_rad: FloatArray,
    reach: int,
    *,
    bent: FloatArray | None = None,
) -> FloatArray:
    """(n, (2 reach + 1)^2) nm/s averages over cells round a point that lies in the middle of one, row 0 the top.

    ``bent`` (n, 3) as of `Blocks`.
    """
    half, wider = spot.half_width_mm(depth_ratio), np.ones((len(depth_ratio), 2)) if bent is None else bent[:, :2]
    offset = spot.offset_mm(depth_ratio, azimuth_rad)
    patch = np.ascontiguousarray(patches(spot, depth_ratio, azimuth_rad, bent))
    size, middle = 2 * reach + 1, (reach + 0.5) * pitch_mm
    across = cell_shares(middle + offset[:, 0], half * wider[:, 0], pitch_mm, size, patch.shape[2])
    down = cell_shares(middle - offset[:, 1], half * wider[:, 1], pitch_mm, size, patch.shape[1])
    return np.asarray(down @ patch @ across.transpose(0, 2, 1) / pitch_mm**2).reshape(len(patch), -1)


def reach_cells(
    spot: Spot, pitch_mm: float, depth_ratio: FloatArray, azimuth_rad: FloatArray, wider: float = 1.0
) -> int:
    """Cells on either side of a point that hold every spot, whichever way it lies, so many times as wide."""
    offset = np.linalg.norm(spot.offset_mm(depth_ratio, azimuth_rad), axis=1)
    return int(np.ceil((wider * spot.half_width_mm(depth_ratio) + offset).max(initial=0.0) / pitch_mm - 0.5 + 1e-9))


def _samples(depth_ratio: FloatArray, azimuth_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Depth ratios and azimuths, (s,) each, of a mesh over the range of the points'."""
    mean = np.angle(np.exp(1j * azimuth_rad).sum())
    turn = np.angle(np.exp(1j * (azimuth_rad - mean)))
    count = 1 + int(np.ceil(np.ptp(turn) / AZIMUTH_STEP - 1e-9))
    ratios = RATIOS if np.ptp(depth_ratio) > 1e-12 else 1
    ratio = np.linspace(depth_ratio.min(), depth_ratio.max(), ratios)
    azimuth = mean + np.linspace(turn.min(), turn.max(), count)
    return np.repeat(ratio, count), np.tile(azimuth, ratios)


def smallest_basis(shape: FloatArray, tolerance: float) -> FloatArray:
    """(m^2, k) orthonormal columns with which each of the (s, m^2) shapes is held within the tolerance (absolute)."""
    square = np.linalg.qr(shape, mode="r")  # has the shapes' right singular vectors, and no more rows than it needs
    vectors = np.linalg.svd(square, full_matrices=False)[2].T
    # what is left of a shape after k vectors, summed from the small end: no cancellation
    left = np.sqrt(np.cumsum((shape @ vectors)[:, ::-1] ** 2, axis=1)[:, ::-1])
    enough = np.append(left[:, 1:].max(axis=0), 0.0) <= tolerance
    return np.asarray(vectors[:, : int(enough.argmax()) + 1], dtype=np.float64)


def chunks(n: int, size: int = CHUNK) -> Iterator[slice]:
    """Slices of at most ``size`` that make up n."""
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


# The family of a spot for very many blocks: its basis and their coefficients from a mesh of depths and azimuths.

LEAST = 9
"""Ratios or azimuths over a range, at least."""
MOST_RATIOS = 65
STEP_CELLS = 0.25
"""Step of the spot's rim from one ratio to the next."""
TURN_STEP = np.radians(4.0)
MOST_SHAPES = 500
"""Number of mesh shapes for the basis; the cost grows with its square."""
NO_RANGE = 1e-12
NO_BEND = 1e-4
"""Half a range of widths, over a flat's, and of how askew contacts are, below which their middle is taken for all."""
BEND_DEGREE = 3
"""Of the polynomials between bends. With slopes up to 18 degrees and a spot of 10 mm radius on 0.25 mm the removal is
off by 2.7e-4 of its peak with degree 3, by 2.4e-4 with 4, which takes twice as long."""
BEND_BLOCKS = 10_000
"""Blocks, at most, of which those are taken that stand for all; and worked on at a time."""
SAME = 1e-4
"""Singular value, over the largest, below which polynomials are the same over a part: on a sphere the mean width is a
function of the two others."""


@dataclass(frozen=True, slots=True)
class Family:
    """A basis of a spot's windows, and how n blocks are made of it."""

    kernels: FloatArray
    """(k, m, m) orthonormal windows, m odd, row 0 the top."""
    coefficients: FloatArray
    """(n, k) nm/s: the window of block i is about ``sum_k coefficients[i, k] kernels[k]``."""

    def part(self, which: Indices) -> Family:
        """Return the family for some of the blocks."""
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
    bends, share = (np.empty((1, 0)), np.ones((len(turn), 1))) if bent is None else _representative_bends(bent)
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


def _representative_bends(bent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(q, 3) bends of some blocks that stand for those of all n, and (n, q) each one's share in each.

    The shares interpolate polynomials of total degree BEND_DEGREE in the three coordinates: how wide in the mean, how
    much wider along x than along y, and how askew. Interpolation is at approximate Fekete points (Sommariva & Vianello
    2009, doi:10.1016/j.camwa.2008.11.011): a QR decomposition with pivots takes, of blocks at random, those that the
    polynomials are best determined at. A row of shares sums to 1. ``bent`` (n, 3) as of `PathBlocks`.
    """
    axes = np.stack([bent[:, :2].mean(axis=1), (bent[:, 0] - bent[:, 1]) / 2, bent[:, 2]], axis=1)
    middle, half = (axes.max(axis=0) + axes.min(axis=0)) / 2, np.ptp(axes, axis=0) / 2
    place = np.where(half > NO_BEND, (axes - middle) / np.maximum(half, NO_BEND), 0.0)
    some = np.random.default_rng(0).permutation(len(place))[:BEND_BLOCKS]
    _, size, mix = np.linalg.svd(_polynomials(place[some]), full_matrices=False)
    mix = mix[size > SAME * size[0]].T
    pivot = scipy.linalg.qr((_polynomials(place[some]) @ mix).T, mode="r", pivoting=True)[1]
    found = some[pivot[: mix.shape[1]]]
    to_share = mix @ np.linalg.inv(_polynomials(place[found]) @ mix)
    return bent[found], np.concatenate([_polynomials(place[p]) @ to_share for p in chunks(len(place), BEND_BLOCKS)])


def _polynomials(place: FloatArray) -> FloatArray:
    """(n, terms) products of Chebyshev's polynomials of (n, 3) coordinates in [-1, 1], up to degree BEND_DEGREE."""
    x, y, z = np.moveaxis(np.polynomial.chebyshev.chebvander(place, BEND_DEGREE), 1, 0)
    powers = [at for at in np.ndindex((BEND_DEGREE + 1,) * 3) if sum(at) <= BEND_DEGREE]
    return np.stack([x[:, i] * y[:, j] * z[:, k] for i, j, k in powers], axis=1)


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
    # rounding may leave a block just outside its range
    place = [np.clip(at[axis], mesh[axis][0], mesh[axis][-1]) for axis in wide]
    return np.asarray(found(np.stack(place, axis=1)), dtype=np.float64)
