"""Ripple of a path: what its lines and points leave on the surface at periods that the process grid averages away.

The removal is summed on fine patches of the part, spread over the path, on a lattice of a twentieth of the spot's
radius. In each patch the harmonics of the local line distance are fitted (period p / n across the lines; l / m along
them where the tool rests on points), of all lines that cross there, for the spot as modelled, for one that is wider or
narrower by what its radius is uncertain by, and for a tool that trails its path. The line distance is often chosen at a
null of the spot's transfer function (Dunn and Walker 2008): there the nominal ripple is next to nothing, and a spot
that is off by 3 % leaves several times as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import require_number
from polishd.process.removal.path_lines import PERIODS, ParallelLines, PatchFrame, patch_frames, travel_ways
from polishd.process.removal.removal_patch import RemovalPatch, removal_patches, widened
from polishd.process.removal.ripple import (
    ALIGNED,
    EQUAL_DEG,
    MODELLED,
    SIGMAS_OF_95,
    ActingSpots,
    Direction,
    PathErrors,
    Ripple,
    RippleLine,
)
from polishd.process.removal.transfer_function import modulus_along

PATCHES = 40
"""Patches a path: the RMS is within 5 % of that with 400 on rasters of 100 mm whose removal varies by half."""
HARMONICS = 3
STRAIGHT = 0.05
"""Lines have a phase where each lies within this share of their distance from its place in a regular row."""
MOSTLY = 2 / 3
"""Share of the patches with regular lines from which these count alone: in the others, lines are farther apart."""
STEADY = 0.996
"""Cosine of the angle that the lines of one direction stay within where others cross them."""
APART = 0.25
"""Waves of a patch whose frequencies differ by less, over half its side, are one."""
LONG = 1.5
"""Periods beyond this many line distances count as figure, where no line is regular."""

FREQUENCIES = 48
"""Frequencies of the spectrum of lines that are out of place."""
SHORTEST = 0.4
"""Shortest period of that spectrum, over the spot's radius: a Hertz spot has 1 % of its mean square beyond."""


def ripple_of(
    acting: ActingSpots,
    time_s: FloatArray,
    grid: Grid,
    clear: BoolArray,
    *,
    errors: PathErrors = MODELLED,
    patches: int = PATCHES,
) -> Ripple:
    """Forecast the ripple of a dwell.

    Args:
        acting: n spots along the path.
        time_s: (n,) dwell.
        grid: process grid; what it keeps of each harmonic is stated.
        clear: (ny, nx) clear aperture.
        errors: what the 95 % value contains.
        patches: number of patches.

    Returns:
        The harmonics that have any amplitude; none where no block lies in the clear aperture.

    Raises:
        ComputeError: an error that cannot be.
    """
    require_number("the error of the spot's radius", errors.radius, "", above=-1e-12, below=0.5)
    for what, value in (("the error of a line's place", errors.line_mm), ("the lag", errors.lag_mm)):
        require_number(what, value, "mm", above=-1e-12)
    frames = patch_frames(acting, time_s, grid, clear, patches)
    if not frames:
        return Ripple(errors=errors)
    factors = (1.0,) if errors.radius == 0 else (1.0, 1.0 - errors.radius, 1.0 + errors.radius)
    spots = [widened(acting.spot, factor) for factor in factors]
    shift_mm = errors.lag_mm * travel_ways(acting.blocks) if errors.lag_mm else None
    found = [removal_patches(spots, acting.blocks, time_s, frame, shift_mm) for frame in frames]
    regular = [k for k, frame in enumerate(frames) if frame.own.pitch_mm is not None]
    some = regular if len(regular) >= MOSTLY * len(frames) else None
    chosen = list(range(len(frames))) if some is None else some
    frames, found = [frames[k] for k in chosen], [found[k] for k in chosen]
    own = [of[: len(spots)] for of in found]
    lines = _broad(frames, own, grid.pitch_mm) if some is None else _harmonics(frames, own, grid.pitch_mm)
    if shift_mm is not None:
        lines += _lagging(frames, [(of[0], of[-1]) for of in found], grid.pitch_mm, regular=some is not None)
    if errors.line_mm:
        across_mm = 2 * float(np.sqrt(np.count_nonzero(clear) / np.pi)) * grid.pitch_mm
        lines += _out_of_place(acting, frames, [of[0] for of in found], errors.line_mm, (across_mm, grid.pitch_mm))
    return Ripple(lines, errors)


_Kind = tuple[int, Direction, int]
"""Which of the directions of the path's lines a harmonic belongs to, its direction, and its number."""


class _Wave(NamedTuple):
    """A harmonic of the lines of a patch."""

    direction: Direction
    number: int
    way: FloatArray
    """(2,) unit vector."""
    period_mm: float
    along: FloatArray = np.zeros(2)
    """(2,) unit vector of its lines."""


def _harmonics(
    frames: Sequence[PatchFrame], found: Sequence[Sequence[RemovalPatch]], grid_mm: float
) -> tuple[RippleLine, ...]:
    """The harmonics across the lines, and along them where the tool rests on points; ``found``: by frame and spot."""
    squares: dict[_Kind, list[FloatArray]] = {}
    periods: dict[_Kind, list[float]] = {}
    shares: dict[_Kind, list[float]] = {}
    ways = _directions(frames)

    def nearest(along: FloatArray) -> int:
        return int(np.argmax(np.abs(ways @ along)))

    for frame, patches in zip(frames, found, strict=True):
        waves = _waves(frame)
        for wave, values in zip(waves, _fitted(frame, patches, waves), strict=True):
            kind = (nearest(wave.along), wave.direction, wave.number)
            periods.setdefault(kind, []).append(wave.period_mm)
            shares.setdefault(kind, []).append(float(_kept(wave.way / wave.period_mm, grid_mm) ** 2))
            squares.setdefault(kind, []).append(values**2)
    rows = [_row([frame for frame in frames if nearest(frame.own.along) == way]) for way in range(len(ways))]
    lines = []
    for kind, values in squares.items():
        way, direction, number = kind
        # over all patches: what is not in some of them leaves nothing there
        rms = [float(v) for v in np.sqrt(np.sum(values, axis=0) / len(frames) / 2)]
        period, share, row = float(np.median(periods[kind])), float(np.mean(shares[kind])), rows[way]
        line = RippleLine(direction, period, rms[0] * 2**0.5, rms[0], max(rms), share)
        if direction == "across" and row is not None:
            line = replace(line, azimuth_deg=row.azimuth_deg, phase=(number * row.phase) % 1.0)
        lines.append(line)
    if any(kind[1] == "along" for kind in squares):
        # points of several lines make patterns askew, by how those of one line lie beside those of the next
        every = _short_of(frames, found, grid_mm)
        known = np.sum([np.sum(values, axis=0) for values in squares.values()], axis=0) / len(frames) / 2
        left = np.maximum(every[:, 0] - known, 0.0)
        if left[0] > 0:
            on_grid = every[0, 1] - sum(one.on_grid * one.rms_nm**2 for one in lines)
            share = float(np.clip(on_grid / left[0], 0.0, 1.0))
            lines.append(_broad_line(left, float(every[0, 0] / every[0, 2]), share))
    return tuple(lines)


def _directions(frames: Sequence[PatchFrame]) -> FloatArray:
    """(k, 2) unit vectors of lines that cross, where those of each keep their direction over the part; else one."""
    found: list[FloatArray] = []
    if any(frame.crossing for frame in frames):
        for line in (line for frame in frames for line in frame.lines):
            if not any(abs(line.along @ one) > STEADY for one in found):
                found.append(line.along)
    apart = all(abs(one @ two) < ALIGNED for k, one in enumerate(found) for two in found[:k])
    return np.array(found) if found and apart else np.eye(1, 2)


class _Row(NamedTuple):
    """A regular row of straight lines."""

    azimuth_deg: float
    phase: float
    """Line distances from the part's center to a line."""


def _row(frames: Sequence[PatchFrame]) -> _Row | None:
    """The row of the lines through the patches' centres; None where they are bent, or not equally far apart."""
    pitches = [frame.own.pitch_mm for frame in frames if frame.own.pitch_mm is not None]
    if not pitches or len(pitches) < len(frames):
        return None
    ways = np.array([frame.own.along[0] + 1j * frame.own.along[1] for frame in frames])
    azimuth_deg = round(float(np.degrees(np.angle((ways**2).sum()) / 2)), 3) % 180.0
    along = np.exp(1j * np.radians(azimuth_deg))
    if np.abs((ways * along.conjugate()).imag).max() > np.radians(EQUAL_DEG):
        return None
    at = np.array([frame.centre_mm for frame in frames]) @ np.array([-along.imag, along.real])
    pitch = float(np.median(pitches))
    number = np.round((at - at[np.argmin(np.abs(at))]) / pitch)
    if np.ptp(number) > 0:
        pitch, first = np.polyfit(number, at, 1)
    else:
        first = float(at.mean())
    if np.abs(at - first - number * pitch).max() > STRAIGHT * pitch:
        return None
    return _Row(azimuth_deg, float(first / pitch))


def _waves(frame: PatchFrame) -> list[_Wave]:
    """The harmonics of a patch."""
    found = list[_Wave]()
    for lines in frame.lines:
        for direction, way, period, count in (
            ("across", lines.across, lines.pitch_mm, HARMONICS * lines.a_pitch),
            ("along", lines.along, lines.rest_mm, HARMONICS),
        ):
            if period is not None:
                found += [_Wave(direction, n, way, period / n, lines.along) for n in range(1, count + 1)]  # type: ignore[arg-type]
    return _apart(found, frame.half_mm)


def _apart(waves: Sequence[_Wave], half_mm: float) -> list[_Wave]:
    """Return the waves that a patch can tell from those before them: points at rest may lie on lines that cross."""
    found = list[_Wave]()
    for wave in waves:
        own = wave.way / wave.period_mm
        others = [sign * one.way / one.period_mm for one in found for sign in (1, -1)]
        if all(np.linalg.norm(own - other) > APART / half_mm for other in others):
            found.append(wave)
    return found


def _fitted(frame: PatchFrame, patches: Sequence[RemovalPatch], waves: Sequence[_Wave]) -> FloatArray:
    """(waves, patches) amplitude, zero to peak, nm, of each wave, beside a smooth surface.

    The fit of the waves of lines is weighted towards the centre of the patch, in a strip across these lines that is
    short along them: there a curved line is still straight, and the amplitude about the same.
    """
    amplitude = np.zeros((len(waves), len(patches)))
    for lines in frame.lines:
        mine = [k for k, wave in enumerate(waves) if wave.along is lines.along]
        amplitude[mine] = _fitted_across(frame, lines, patches, waves)[mine]
    kept = np.array([_kept(wave.way / wave.period_mm, frame.cell_mm) for wave in waves])
    return np.asarray(amplitude / kept[:, None], dtype=np.float64)


def _fitted_across(
    frame: PatchFrame, lines: ParallelLines, patches: Sequence[RemovalPatch], waves: Sequence[_Wave]
) -> FloatArray:
    """(waves, patches) amplitude of each wave as the patch's cells have it, nm, in a strip across some of its lines."""
    at = patches[0].at_mm
    half = frame.half_mm
    longest = max([lines.pitch_mm or half / PERIODS, *(one.pitch_mm for one in frame.crossing if one.pitch_mm)])
    strip = min(max(longest, 1.5 * (lines.rest_mm or 0.0)), half / 2)
    x, y = np.meshgrid(at, at[::-1])
    along, across = (x * w[0] + y * w[1] for w in (lines.along, lines.across))
    held = (np.abs(across) <= half) & (np.abs(along) <= strip)
    s, v = along[held] / half, across[held] / half
    where = np.column_stack([x[held], y[held]])
    height = np.column_stack([patch.height_nm[held] for patch in patches])
    terms = [v**k for k in range(5)] + [s, s**2, s * v, s * v**2]
    terms += [part(2 * np.pi * (where @ wave.way) / wave.period_mm) for wave in waves for part in (np.cos, np.sin)]
    weight = np.cos(np.pi * v / 2)[:, None]
    basis = np.column_stack(terms) * weight
    wanted = (height - height.mean(axis=0)) * weight
    try:  # polynomials of few orders beside waves: the normal equations are well conditioned, and half as long
        found = scipy.linalg.cho_solve(scipy.linalg.cho_factor(basis.T @ basis), basis.T @ wanted)
    except scipy.linalg.LinAlgError:
        found = np.linalg.lstsq(basis, wanted, rcond=None)[0]
    own = found[-2 * len(waves) :].reshape(len(waves), 2, -1)
    return np.asarray(np.hypot(own[:, 0], own[:, 1]), dtype=np.float64)


def _kept(frequency: FloatArray, cell_mm: float) -> float:
    """Share of a wave's amplitude that cells keep; ``frequency`` (2,) per mm."""
    return float(np.prod(np.sinc(frequency * cell_mm)))


def _broad(
    frames: Sequence[PatchFrame], found: Sequence[Sequence[RemovalPatch]], grid_mm: float
) -> tuple[RippleLine, ...]:
    """Whatever has periods of up to LONG line distances, as one line at its mean frequency."""
    squares = _short_of(frames, found, grid_mm)
    if not squares[0, 0] > 0:
        return ()
    return (_broad_line(squares[:, 0], float(squares[0, 0] / squares[0, 2]), float(squares[0, 1] / squares[0, 0])),)


def _broad_line(squares: FloatArray, period_mm: float, on_grid: float) -> RippleLine:
    """A line in all directions; ``squares`` (spots,) nm^2."""
    rms = np.sqrt(squares)
    return RippleLine("every", period_mm, float(rms[0] * 2**0.5), float(rms[0]), float(rms.max()), on_grid)


def _short_of(frames: Sequence[PatchFrame], found: Sequence[Sequence[RemovalPatch]], grid_mm: float) -> FloatArray:
    """(spots, 3) mean over the patches of `_short`, of periods of up to LONG line distances."""
    each = [
        [_short(patch, frame.cell_mm, LONG * frame.half_mm / PERIODS, grid_mm) for patch in patches]
        for frame, patches in zip(frames, found, strict=True)
    ]
    return np.asarray(np.mean(each, axis=0), dtype=np.float64)


def _lagging(
    frames: Sequence[PatchFrame], found: Sequence[tuple[RemovalPatch, RemovalPatch]], grid_mm: float, *, regular: bool
) -> tuple[RippleLine, ...]:
    """What a tool that trails its path adds: the difference of both patches.

    Lines to and fro alternate: odd multiples of half the lines' frequency. Without lines, all periods as of `_broad`.
    """
    squares, periods = [], []
    for frame, (prompt, late) in zip(frames, found, strict=True):
        change = RemovalPatch(late.height_nm - prompt.height_nm, prompt.at_mm)
        if regular and frame.own.pitch_mm is not None:
            twice = _apart(
                [
                    _Wave("across", n, one.across, 2 * one.pitch_mm / one.a_pitch / n, one.along)
                    for one in frame.lines
                    if one.pitch_mm is not None
                    for n in (1, 3)
                ],
                frame.half_mm,
            )
            amplitude = _fitted(frame, [change], twice)[:, 0]
            periods.append(twice[0].period_mm)
            squares.append((float(amplitude @ amplitude) / 2, _kept(twice[0].way / periods[-1], grid_mm) ** 2))
        else:
            own = _short(change, frame.cell_mm, LONG * frame.half_mm / PERIODS, grid_mm)
            periods.append(float(own[0] / own[2]) if own[2] > 0 else frame.half_mm)
            squares.append((float(own[0]), float(own[1] / own[0]) if own[0] > 0 else 0.0))
    square, share = np.mean(squares, axis=0)
    if not square > 0:
        return ()
    direction: Direction = "across" if regular else "every"
    high = float(np.sqrt(square))
    return (RippleLine(direction, float(np.median(periods)), 0.0, 0.0, high, float(share), "lag"),)


def _out_of_place(
    acting: ActingSpots,
    frames: Sequence[PatchFrame],
    found: Sequence[RemovalPatch],
    line_mm: float,
    extent_mm: tuple[float, float],
) -> tuple[RippleLine, ...]:
    """What lines leave that are out of place independently of each other.

    A line whose profile across is s, out of place by d, adds ``-d s'``. Lines at a distance p therefore add a mean
    square of ``sigma^2 / p`` times the integral of ``(2 pi f |S(f)|)^2`` over all frequencies, S the spectrum of s.

    Args:
        acting: the spots.
        frames: patches; where lines have no common distance, the mean one counts.
        found: removal on them.
        line_mm: 95 % limit of the place.
        extent_mm: mean width of the clear aperture, and the process grid's pitch.
    """
    sigma_mm = line_mm / SIGMAS_OF_95
    sums, fine = np.zeros(2), widened(acting.spot, 1.0)
    pitches, periods = [], []
    for frame, patch in zip(frames, found, strict=True):
        pitch, across = frame.line_mm, frame.own.across
        ratio, azimuth = (v[frame.at : frame.at + 1] for v in (acting.blocks.depth_ratio, acting.blocks.azimuth_rad))
        squares = fine.patch(ratio, azimuth)[0]
        half = float(fine.half_width_mm(ratio)[0])
        frequency = (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES / (SHORTEST * half)
        angle = float(np.arctan2(across[1], across[0]))
        share = modulus_along(squares, 2 * half / len(squares), frequency, angle) / squares.sum()
        step = 1 / (FREQUENCIES * SHORTEST * half)
        power = 2 * step * (2 * np.pi * frequency * share * sigma_mm * float(patch.height_nm.mean())) ** 2 * pitch
        kept = np.array([_kept(across * f, extent_mm[1]) ** 2 for f in frequency])
        sums += [power.sum(), (power * kept).sum()]
        pitches.append(pitch)
        periods.append(1 / float(np.interp(power.sum() / 2, np.cumsum(power), frequency + frequency[0])))
    mean, on_grid = sums / len(frames)
    if not mean > 0:
        return ()
    lines = max(extent_mm[0] / float(np.median(pitches)), 1.0)
    scatter = float(np.sqrt(scipy.special.chdtri(lines, 0.05) / lines))  # 95 % of chi squared
    high = scatter * float(np.sqrt(mean))
    period = float(np.median(periods))  # half of the mean square is longer
    return (RippleLine("across", period, 0.0, 0.0, high, float(on_grid / mean), "line_error"),)


def _short(patch: RemovalPatch, cell_mm: float, longest_mm: float, grid_mm: float) -> FloatArray:
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
