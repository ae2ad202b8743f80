"""Ripple of a path: what its lines and points leave on the surface at periods that the process grid averages away.

The removal is summed on fine patches of the part, spread over the path, on a lattice of a twentieth of the spot's
radius. In each patch the harmonics of the local line distance are fitted (period p / n across the lines; l / m along
them where the tool rests on points), for the spot as modelled and for one that is wider or narrower by what its radius
is uncertain by. The line distance is often chosen at a null of the spot's transfer function (Dunn and Walker 2008):
there the nominal ripple is next to nothing, and a spot that is off by 3 % leaves several times as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import require_number
from polishd.process.removal.spread_effect import WIDTH, damping, spline
from polishd.process.removal.tif import HertzSpot, Spot, WiderSpot
from polishd.process.removal.tif_family import Indices, PathBlocks, reach_cells, windows
from polishd.process.removal.transfer_function import modulus_along

RADIUS_ERROR = 0.03
"""Default of what 95 % of spots stay within, of their radius: a TIF that was measured once."""
PATCHES = 40
"""Patches a path: the RMS is within 5 % of that with 400 on rasters of 100 mm whose removal varies by half."""
FINER = 20
"""Cells of a patch to the spot's radius."""
FINEST = 64
"""And at most: of lines that are so near to each other a spot leaves nothing."""
CELLS_A_PERIOD = 12
"""Cells of a patch to the shorter of line distance and point distance, at least."""
PERIODS = 3.0
"""Half the side of a patch, in the longer of both."""
HARMONICS = 3
REGULAR = 0.2
"""Lines count as regular where their distances differ by less than this share of them."""
LEAST_LINES = 4
ACROSS = 4.0
"""Mean line distances across a line within which others are looked for."""
ALIGNED = 0.94
"""Cosine of the angle to a line from which a block counts to another direction."""
RATIO_STEP, AZIMUTH_STEP, BEND_STEP = 0.01, np.radians(3.0), 0.01
"""Spots of a patch that differ by less share one window; RATIO_STEP moves a spot's rim by 0.5 % of its radius."""
RESTING = 0.2
"""Blocks are points at rest where they are shorter than this share of the distance between them."""
JUMP = 3.0
"""Points that are farther apart than this many mean distances follow no line."""
LONG = 1.5
"""Periods beyond this many line distances count as figure, where no line is regular."""
SQUARES = 128
"""Squares across a modelled spot: their width must not show beside a patch's cells."""

Direction = Literal["across", "along", "every"]


@dataclass(frozen=True, slots=True)
class RippleLine:
    """A harmonic of the pattern that a path leaves."""

    direction: Direction
    """"across" the lines, "along" them (distance of points at rest), or "every" where lines have no common distance."""
    period_mm: float
    amplitude_nm: float
    """Zero to peak, as modelled: the RMS over the patches."""
    rms_nm: float
    """RMS over the clear aperture, as modelled."""
    rms_high_nm: float
    """With a spot whose radius is off by the stated share, the worse of both signs; at least ``rms_nm``."""
    on_grid: float
    """Share of its mean square that the process grid's cells keep."""


@dataclass(frozen=True, slots=True)
class Ripple:
    """Forecast of the ripple that one pass adds."""

    lines: tuple[RippleLine, ...] = ()
    radius_error: float = RADIUS_ERROR

    @property
    def rms_nm(self) -> float:
        """RMS of all lines, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 for one in self.lines)))

    @property
    def rms_high_nm(self) -> float:
        """RMS of all lines with a spot whose radius is off."""
        return float(np.sqrt(sum(one.rms_high_nm**2 for one in self.lines)))

    @property
    def finer_nm(self) -> float:
        """RMS of what the process grid averages away, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 * (1 - one.on_grid) for one in self.lines)))

    def shown_nm(self, sample_mm: float | None, *, high: bool = False) -> float:
        """RMS that a map's samples show beyond the process grid; ``sample_mm`` None: all of it."""
        square = 0.0
        for one in self.lines:
            rms = one.rms_high_nm if high else one.rms_nm
            kept = 1.0 if sample_mm is None else float(np.sinc(sample_mm / one.period_mm)) ** 2
            square += max(kept * rms**2 - one.on_grid * one.rms_nm**2, 0.0)
        return float(np.sqrt(square))

    @property
    def words(self) -> str:
        """Return the largest line as text."""
        if not self.lines:
            return "no lines"
        one = max(self.lines, key=lambda line: line.rms_high_nm)
        return f"{one.period_mm:.2f} mm {one.direction}, amplitude {one.amplitude_nm:.2f} nm"

    def facts(self) -> list[dict[str, Any]]:
        """Return the lines for JSON."""
        return [asdict(one) for one in self.lines]


NO_RIPPLE = Ripple()


@dataclass(frozen=True, slots=True)
class ActingSpots:
    """The spots of a program's n timed points as they act: all that a ripple follows from but the dwell."""

    spot: Spot
    blocks: PathBlocks


def ripple_of(
    acting: ActingSpots,
    time_s: FloatArray,
    grid: Grid,
    clear: BoolArray,
    *,
    radius_error: float = RADIUS_ERROR,
    patches: int = PATCHES,
) -> Ripple:
    """Forecast the ripple of a dwell.

    Args:
        acting: n spots along the path.
        time_s: (n,) dwell.
        grid: process grid; what it keeps of each harmonic is stated.
        clear: (ny, nx) clear aperture.
        radius_error: share of its radius within which 95 % of spots are.
        patches: number of patches.

    Returns:
        The harmonics that have any amplitude; none where no block lies in the clear aperture.

    Raises:
        ComputeError: an error of the radius that cannot be.
    """
    require_number("the error of the spot's radius", radius_error, "", above=-1e-12, below=0.5)
    frames = _frames(acting, time_s, grid, clear, patches)
    if not frames:
        return Ripple(radius_error=radius_error)
    factors = (1.0,) if radius_error == 0 else (1.0, 1.0 - radius_error, 1.0 + radius_error)
    spots = [_widened(acting.spot, factor) for factor in factors]
    found = [[_Patch.of(spot, acting.blocks, time_s, frame) for frame in frames] for spot in spots]
    regular = [frame.pitch_mm is not None for frame in frames]
    if sum(regular) * 2 >= len(regular):
        some = [k for k, one in enumerate(regular) if one]
        lines = _harmonics([frames[k] for k in some], [[of[k] for k in some] for of in found], grid.pitch_mm)
    else:
        lines = _broad(frames, found, grid.pitch_mm)
    return Ripple(lines, radius_error)


def _widened(spot: Spot, factor: float) -> Spot:
    fine = HertzSpot(spot.process, max(SQUARES, spot.squares)) if isinstance(spot, HertzSpot) else spot
    return fine if factor == 1.0 else WiderSpot(fine, factor)


class _Frame(NamedTuple):
    """A patch: where it is, and the lines in it."""

    centre_mm: FloatArray
    """(2,)"""
    along: FloatArray
    """(2,) unit vector of the line through its centre."""
    pitch_mm: float | None
    """Distance of the lines; None: they have no common one."""
    rest_mm: float | None
    """Distance of points at rest on the line; None: the tool moves."""
    half_mm: float
    cell_mm: float
    near: Indices
    """Blocks whose spots reach into it, rising."""

    @property
    def across(self) -> FloatArray:
        return np.array([-self.along[1], self.along[0]])

    @property
    def cells(self) -> int:
        """Cells from the centre to each side."""
        return int(np.ceil(self.half_mm / self.cell_mm))


def _frames(acting: ActingSpots, time_s: FloatArray, grid: Grid, clear: BoolArray, patches: int) -> list[_Frame]:
    blocks = acting.blocks
    middle = (blocks.start_mm + blocks.end_mm) / 2
    room_mm = scipy.ndimage.distance_transform_edt(np.pad(clear, 1))[1:-1, 1:-1] * grid.pitch_mm
    row = np.round((grid.y_mm[0] - middle[:, 1]) / grid.pitch_mm).astype(np.int64)
    column = np.round((middle[:, 0] - grid.x_mm[0]) / grid.pitch_mm).astype(np.int64)
    on_grid = (row >= 0) & (row < grid.ny) & (column >= 0) & (column < grid.nx)
    room = np.zeros(blocks.n)
    room[on_grid] = room_mm[row[on_grid], column[on_grid]]
    inside = np.flatnonzero((room > 0) & (time_s > 0) & (blocks.factor > 0))
    if inside.size < LEAST_LINES:
        return []
    step_mm = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    length_mm = float(step_mm[inside[inside < blocks.n - 1]].sum())
    area_mm2 = float(np.count_nonzero(clear)) * grid.pitch_mm**2
    # the distance of lines, or of points that no line joins
    mean_mm = max(area_mm2 / max(length_mm, grid.pitch_mm), (area_mm2 / inside.size) ** 0.5)
    wanted = np.flatnonzero(room >= PERIODS * mean_mm)
    some = np.intersect1d(inside, wanted)
    some = inside[room[inside] >= 0.9 * room[inside].max()] if some.size < LEAST_LINES else some
    count = min(patches, some.size)
    offsets = np.random.default_rng(0).uniform(size=count)
    chosen = some[((np.arange(count) + offsets) * some.size / count).astype(np.int64)]
    tree = scipy.spatial.cKDTree(middle)
    reach_mm = float(blocks.reach_mm(acting.spot)[time_s > 0].max()) * (1 + RADIUS_ERROR)
    found = [_frame(acting, tree, int(k), mean_mm, reach_mm) for k in chosen]
    return [one for one in found if one is not None]


def _frame(acting: ActingSpots, tree: scipy.spatial.cKDTree, at: int, mean_mm: float, reach_mm: float) -> _Frame | None:
    """The patch about one block; None where the path has no direction there.

    ``reach_mm``: how far from its middle any block polishes.
    """
    middle = np.asarray(tree.data)
    blocks, spot = acting.blocks, acting.spot
    before, after = max(at - 1, 0), min(at + 1, blocks.n - 1)
    own = blocks.end_mm[at] - blocks.start_mm[at]
    length = float(np.linalg.norm(own))
    gap = float(np.linalg.norm(middle[after] - middle[before])) / max(after - before, 1)
    way = own if length > RESTING * gap else middle[after] - middle[before]
    if not np.linalg.norm(way) > 0:
        return None
    along = way / np.linalg.norm(way)
    rests = length <= RESTING * gap <= RESTING * JUMP * mean_mm
    pitch = _line_distance(middle, tree, at, along, (max(gap, mean_mm / 2), ACROSS * mean_mm))
    longest = max(pitch or mean_mm, gap if rests else 0.0)
    shortest = min(pitch or mean_mm, gap if rests else np.inf)
    radius = float(spot.half_width_mm(blocks.depth_ratio[at : at + 1])[0])
    half = PERIODS * longest
    cell = max(min(radius / FINER, shortest / CELLS_A_PERIOD), radius / FINEST)
    near = np.sort(np.array(tree.query_ball_point(middle[at], 2**0.5 * half + reach_mm), dtype=np.int64))
    return _Frame(middle[at], along, pitch, gap if rests else None, half, cell, near)


def _line_distance(
    middle: FloatArray, tree: scipy.spatial.cKDTree, at: int, along: FloatArray, reach_mm: tuple[float, float]
) -> float | None:
    """Distance of the lines that are parallel to the one through a block; None where it is not regular.

    ``reach_mm``: how far along and across the line others are looked for.
    """
    near = np.sort(np.array(tree.query_ball_point(middle[at], sum(reach_mm)), dtype=np.int64))
    last = np.minimum(near + 1, len(middle) - 1)
    way = middle[last] - middle[np.maximum(near - 1, 0)]
    size = np.linalg.norm(way, axis=1)
    parallel = np.abs(way @ along) > ALIGNED * size
    place = middle[near] - middle[at]
    across = np.array([-along[1], along[0]])
    strip = near[parallel & (np.abs(place @ along) <= 0.75 * reach_mm[0])]
    if strip.size == 0:
        return None
    runs = np.split(strip, np.flatnonzero(np.diff(strip) > 1) + 1)
    # the point of a run that is nearest to the cut across the lines: on a curved line the mean lies beside it
    cut = [run[np.argmin(np.abs((middle[run] - middle[at]) @ along))] for run in runs]
    lines = np.sort((middle[cut] - middle[at]) @ across)
    if lines.size < LEAST_LINES:
        return None
    distance = np.diff(lines)
    pitch = float(np.median(distance))
    return pitch if pitch > 0 and np.abs(distance - pitch).max() <= REGULAR * pitch else None


class _Patch(NamedTuple):
    """The removal on a patch."""

    height_nm: FloatArray
    """(m, m), row 0 at the largest y."""
    at_mm: FloatArray
    """(m,) of its columns, from its centre; rows fall from the largest."""

    @classmethod
    def of(cls, spot: Spot, blocks: PathBlocks, time_s: FloatArray, frame: _Frame) -> _Patch:
        """Sum the removal of the blocks near by, spot by spot."""
        near = blocks.part(frame.near).seen_from(frame.centre_mm)
        bent, h, cells = near.bent, frame.cell_mm, frame.cells
        wider = 1.0 if bent is None else float(bent[:, :2].max())
        reach = reach_cells(spot, h, near.depth_ratio, near.azimuth_rad, wider)
        size, edge = 2 * cells + 1, cells + reach
        nodes = 2 * edge + 1
        fast = scipy.fft.next_fast_len(nodes, real=True)
        block, place, share = near.positions(spot)
        (row, down), (column, side) = (spline(v) for v in (edge - place[:, 1] / h, place[:, 0] / h + edge))
        weight = (share * (near.factor * time_s[frame.near])[block])[:, None, None] * down[:, :, None] * side[:, None]
        rows, columns = row[:, None, None] + np.arange(WIDTH)[:, None], column[:, None, None] + np.arange(WIDTH)
        held = (rows >= 0) & (rows < nodes) & (columns >= 0) & (columns < nodes)
        node = np.where(held, rows * nodes + columns, nodes * nodes)  # what lies beyond is put behind the lattice
        kinds, kind = _kinds(near)
        total = np.zeros((fast, fast // 2 + 1), dtype=np.complex128)
        for number, one in enumerate(kinds):
            which = kind[block] == number
            dwell = np.bincount(node[which].ravel(), weight[which].ravel(), nodes * nodes + 1)[:-1]
            kernel = windows(spot, h, one.depth_ratio, one.azimuth_rad, reach, bent=one.bent)[0]
            kernel = kernel.reshape(2 * reach + 1, -1)
            total += scipy.fft.rfft2(dwell.reshape(nodes, nodes), (fast, fast)) * scipy.fft.rfft2(kernel, (fast, fast))
        total /= damping(scipy.fft.fftfreq(fast))[:, None] * damping(scipy.fft.rfftfreq(fast))
        middle = slice(2 * reach, 2 * reach + size)
        height = np.asarray(scipy.fft.irfft2(total, (fast, fast))[middle, middle], dtype=np.float64)
        at = np.asarray((np.arange(size) - cells) * h, dtype=np.float64)
        return cls(height, at)


def _kinds(blocks: PathBlocks) -> tuple[list[PathBlocks], NDArray[np.int64]]:
    """Blocks that represent others with nearly the same spot, and (n,) which of them represents each."""
    keys = [np.log(blocks.depth_ratio) / RATIO_STEP, blocks.azimuth_rad / AZIMUTH_STEP]
    keys += [] if blocks.bent is None else list(blocks.bent.T / BEND_STEP)
    steps = np.round(np.column_stack(keys)).astype(np.int64)
    _, first, kind = np.unique(steps, axis=0, return_index=True, return_inverse=True)
    return [blocks.part(slice(k, k + 1)) for k in first], kind.ravel()


def _harmonics(frames: Sequence[_Frame], found: Sequence[Sequence[_Patch]], grid_mm: float) -> tuple[RippleLine, ...]:
    """The harmonics across the lines, and along them where the tool rests on points."""
    amplitudes: dict[tuple[Direction, int], list[list[float]]] = {}
    periods: dict[tuple[Direction, int], list[float]] = {}
    shares: dict[tuple[Direction, int], list[float]] = {}
    for k, frame in enumerate(frames):
        waves = _waves(frame)
        for kind, way, period in waves:
            periods.setdefault(kind, []).append(period)
            shares.setdefault(kind, []).append(float(_kept(way / period, grid_mm) ** 2))
        for number, patches in enumerate(found):
            for (kind, _, _), value in zip(waves, _fitted(frame, patches[k], waves), strict=True):
                amplitudes.setdefault(kind, [[] for _ in found])[number].append(value)
    lines = []
    for kind, values in amplitudes.items():
        rms = [float(np.sqrt(np.mean(np.square(one)) / 2)) for one in values]
        direction, period = kind[0], float(np.median(periods[kind]))
        share = float(np.mean(shares[kind]))
        lines.append(RippleLine(direction, period, rms[0] * 2**0.5, rms[0], max(rms), share))
    return tuple(lines)


def _waves(frame: _Frame) -> list[tuple[tuple[Direction, int], FloatArray, float]]:
    """(direction, number), unit vector and period of each harmonic of a patch."""
    found: list[tuple[tuple[Direction, int], FloatArray, float]] = []
    for direction, way, period in (("across", frame.across, frame.pitch_mm), ("along", frame.along, frame.rest_mm)):
        if period is not None:
            found += [((direction, n), way, period / n) for n in range(1, HARMONICS + 1)]  # type: ignore[misc]
    return found


def _fitted(
    frame: _Frame, patch: _Patch, waves: Sequence[tuple[tuple[Direction, int], FloatArray, float]]
) -> list[float]:
    """Amplitude, zero to peak, nm, of each wave, beside a smooth surface.

    The fit is weighted towards the centre of the patch, in a strip across the lines that is short along them: there a
    curved line is still straight.
    """
    x, y = np.meshgrid(patch.at_mm, patch.at_mm[::-1])
    along, across = (x * w[0] + y * w[1] for w in (frame.along, frame.across))
    half = frame.half_mm
    pitch = frame.pitch_mm or half / PERIODS
    strip = min(max(pitch, 1.5 * (frame.rest_mm or 0.0)), half / 2)
    held = (np.abs(across) <= half) & (np.abs(along) <= strip)
    s, v, height = along[held] / half, across[held] / half, patch.height_nm[held]
    where = np.column_stack([x[held], y[held]])
    terms = [v**k for k in range(5)] + [s, s**2, s * v, s * v**2]
    terms += [part(2 * np.pi * (where @ way) / period) for _, way, period in waves for part in (np.cos, np.sin)]
    weight = np.cos(np.pi * v / 2)
    basis = np.column_stack(terms)
    found = np.linalg.lstsq(basis * weight[:, None], (height - height.mean()) * weight, rcond=None)[0]
    own = found[-2 * len(waves) :].reshape(-1, 2)
    kept = [_kept(way / period, frame.cell_mm) for _, way, period in waves]
    return [float(np.hypot(*pair) / share) for pair, share in zip(own, kept, strict=True)]


def _kept(frequency: FloatArray, cell_mm: float) -> float:
    """Share of a wave's amplitude that cells keep; ``frequency`` (2,) per mm."""
    return float(np.prod(np.sinc(frequency * cell_mm)))


def _broad(frames: Sequence[_Frame], found: Sequence[Sequence[_Patch]], grid_mm: float) -> tuple[RippleLine, ...]:
    """Whatever has periods of up to LONG line distances, as one line at its mean frequency."""
    squares = np.zeros((len(found), 3))
    for number, patches in enumerate(found):
        for frame, patch in zip(frames, patches, strict=True):
            squares[number] += _short(patch, frame.cell_mm, LONG * frame.half_mm / PERIODS, grid_mm)
    squares /= len(frames)
    if not squares[0, 0] > 0:
        return ()
    rms = np.sqrt(squares[:, 0])
    period = float(squares[0, 0] / squares[0, 2])
    share = float(squares[0, 1] / squares[0, 0])
    return (RippleLine("every", period, float(rms[0] * 2**0.5), float(rms[0]), float(rms.max()), share),)


def _short(patch: _Patch, cell_mm: float, longest_mm: float, grid_mm: float) -> FloatArray:
    """(3,) mean square of the periods up to one, what a grid keeps of it, and the sum over frequency of it."""
    size = len(patch.at_mm)
    v = np.linspace(-1, 1, size)
    legendre = np.polynomial.legendre.legvander(v, 3)
    basis = np.linalg.qr(np.einsum("ik,jl->ijkl", legendre, legendre).reshape(size**2, -1))[0]
    flat = patch.height_nm.ravel()
    left = (flat - basis @ (basis.T @ flat)).reshape(size, size)
    window = np.hanning(size + 2)[1:-1]
    weight = window[:, None] * window
    power = np.abs(scipy.fft.fft2(left * weight)) ** 2 / (size**2 * np.sum(weight**2))
    f = scipy.fft.fftfreq(size, cell_mm)
    fy, fx = np.meshgrid(f, f, indexing="ij")
    frequency = np.hypot(fx, fy)
    some = np.where(frequency >= 1 / longest_mm, power, 0.0)
    kept = (np.sinc(fx * grid_mm) * np.sinc(fy * grid_mm)) ** 2
    return np.array([some.sum(), (some * kept).sum(), (some * frequency).sum()])


# The line distance that a spot whose radius is not known exactly leaves least ripple with.

MORE_PATH = 1.15
"""Path that a quieter line distance may cost, over that of the largest one."""
CANDIDATES = 301


@dataclass(frozen=True, slots=True)
class ContactAt:
    """A contact, and the lines that it follows."""

    depth_ratio: float
    """Gamma."""
    azimuth_rad: float
    """Where the spindle leans, counterclockwise from the part's x."""
    across_rad: float = np.pi / 2
    """Direction across the lines, counterclockwise from the part's x."""


@dataclass(frozen=True, slots=True)
class QuietPitch:
    """A line distance, and the ripple that it leaves, RMS over the mean removal."""

    pitch_mm: float
    share: float
    """With the spot as modelled."""
    share_high: float
    """With a spot whose radius is off, the worse of both signs."""
    radius_error: float = RADIUS_ERROR

    @property
    def words(self) -> str:
        """Return the distance and its ripple as text."""
        high = f"{100 * self.share_high:.1f} % with a radius that is off by {100 * self.radius_error:g} %"
        return f"lines {self.pitch_mm:.3g} mm apart, ripple {100 * self.share:.1f} % of the mean removal, {high}"


def ripple_shares(
    spot: Spot, contact: ContactAt, pitch_mm: FloatArray, radius_error: float = RADIUS_ERROR
) -> tuple[FloatArray, FloatArray]:
    """RMS ripple of straight lines of even removal, over its mean, for (m,) line distances.

    Each harmonic has twice the share that the spot's spectrum has at its frequency, zero to peak.

    Args:
        spot: the spot.
        contact: how it acts, and where the lines run.
        pitch_mm: (m,) distances.
        radius_error: share of the radius that the spot may be off by.

    Returns:
        (m,) as modelled, and (m,) the largest for a spot as modelled, narrower and wider.
    """
    ratio = np.array([contact.depth_ratio])
    fine = _widened(spot, 1.0)
    patch = fine.patch(ratio, np.array([contact.azimuth_rad]))[0]
    side = 2 * float(fine.half_width_mm(ratio)[0]) / len(patch)
    order = np.arange(1, HARMONICS + 1)[:, None]
    factors = (1.0, 1.0 - radius_error, 1.0 + radius_error)
    found = []
    for factor in factors:
        frequency = (factor * order / pitch_mm).ravel()
        share = modulus_along(patch, side, frequency, contact.across_rad).reshape(HARMONICS, -1) / patch.sum()
        found.append(np.sqrt(2 * np.sum(share**2, axis=0)))
    return found[0], np.max(found, axis=0)


def quiet_pitch(
    spot: Spot,
    contact: ContactAt,
    at_most_mm: float,
    *,
    radius_error: float = RADIUS_ERROR,
    more_path: float = MORE_PATH,
) -> QuietPitch:
    """Find the line distance up to ``at_most_mm`` with the least ripple of a spot whose radius may be off.

    Its path is at most ``more_path`` times as long as that with the largest distance. Arguments as of `ripple_shares`.
    """
    require_number("the largest line distance", at_most_mm, "mm", above=0.0)
    pitch = np.linspace(at_most_mm / more_path, at_most_mm, CANDIDATES)
    share, high = ripple_shares(spot, contact, pitch, radius_error)
    best = int(np.argmin(high))
    return QuietPitch(float(pitch[best]), float(share[best]), float(high[best]), radius_error)
