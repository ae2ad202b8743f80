"""Rasters of bent lines that do not cross: pseudo-random ones that spread their ripple, and ones dense where much goes.

The lines are ``y = Y(x, v)`` at evenly spaced ``v``, and Y rises with v: neighbors never meet. A pattern of lines has
its power where the gradient of their phase is (Woodward's theorem), so lines whose slope and distance vary at random
have no peak. Paths that turn on a lattice of cells (Dunn and Walker 2008) spread it, too, but bend with half a cell's
radius, and their density varies within the spot. Bent lines turn beyond the rim only, so the machine stays fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import require_number
from polishd.process.toolpath.apertures import Aperture, on_optic, require_points, resample_evenly
from polishd.process.toolpath.paths import LEAD_IN_MM, check_lengths, line_heights

MIN_RADIUS_MM = 3.0
"""Default of the smallest radius of the path on the part: 50 mm/s at 0.8 m/s^2."""
WAVES = 24
"""Plane waves that the lines are displaced by."""
SLOPE, SPACING = 0.5, 0.2
"""RMS slope of the lines, and RMS of their distance over its mean."""
MOST_SPACING = 0.45
"""Largest difference of the distance of two lines along y from its mean, over the mean."""
WAVE_PITCHES = 12.0
"""Shortest mean wave, in line distances: the feed levels out a density that varies over more than the spot."""
CHECKS, MOST_CHECKS = 100, 250
"""Samples along x and along v at which curvature and distance of the lines are checked, at least and at most ..."""
CHECK_PITCHES = 2.0
"""... so many line distances apart."""
FIRST, FITS = 0.6, 60
"""First wave number tried, over the permitted curvature and the slope's inverse; most tries with longer waves."""
MARGIN = 0.97
"""Share of the permitted curvature that is aimed for: the largest lies between samples."""
SAMPLES_A_STEP = 4
LATTICE = 301
"""Nodes along x and along y at which a density is integrated."""
STEEPEST = 0.8
"""Largest slope of lines that follow a density."""
SMOOTHING, SMOOTHER = 3.0, 1.25
"""The density is smoothed over so many mean line distances, then over a length that rises by this ratio ..."""
SMOOTHINGS = 24
"""... at most so many times; after them the lines are straight."""
DENSITY_RANGE = (0.6, 1.7)
"""Line density over its mean, at least and at most: at the least the lines are 1.7 times as far apart."""

LineField = Callable[[FloatArray, FloatArray], FloatArray]
"""x and v, mm, of one shape -> y, mm; rises with v."""


@dataclass(frozen=True, slots=True)
class LineDensity:
    """How dense the lines of a raster are to be, relative to their mean."""

    grid: Grid
    relative: FloatArray
    """(ny, nx) above 0, row 0 at the largest y."""

    @classmethod
    def of_removal(cls, grid: Grid, removal_nm: FloatArray, mask: BoolArray) -> LineDensity:
        """Return the density for a removal: as its square root, within `DENSITY_RANGE` of the mean.

        The ripple of a line pattern goes as the removal times the square of the line distance, so that it is even; the
        feed varies as the square root of the removal instead of as the removal.

        Args:
            grid: grid of the removal.
            removal_nm: (ny, nx) removal wanted, finite inside the mask.
            mask: (ny, nx) samples that count; elsewhere the nearest one does.

        Raises:
            ComputeError: an empty mask, or no sample with any removal.
        """
        inside = mask & np.isfinite(removal_nm)
        if not inside.any() or not removal_nm[inside].max() > 0:
            raise ComputeError("nothing is to be removed, so no line density follows it. Use even lines")
        root = np.sqrt(np.maximum(np.where(inside, removal_nm, 0.0), 0.0))
        nearest = scipy.ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
        relative = np.clip(root[tuple(nearest)] / root[inside].mean(), *DENSITY_RANGE)
        return cls(grid, np.asarray(relative, dtype=np.float64))

    def at(self, x_mm: FloatArray, y_mm: FloatArray, smoothing_mm: float) -> FloatArray:
        """Return the density, smoothed over a length, at places of one shape; beyond the grid that of its rim."""
        smooth = scipy.ndimage.gaussian_filter(self.relative, smoothing_mm / self.grid.pitch_mm, mode="nearest")
        row, column = (self.grid.y_mm[0] - y_mm) / self.grid.pitch_mm, (x_mm - self.grid.x_mm[0]) / self.grid.pitch_mm
        return np.asarray(scipy.ndimage.map_coordinates(smooth, [row, column], order=1, mode="nearest"))


def random_raster(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    *,
    seed: int = 0,
    min_radius_mm: float = MIN_RADIUS_MM,
    density: LineDensity | None = None,
    optic: Optic = FLAT,
    direction_deg: float = 0.0,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
) -> FloatArray:
    """Points of a pseudo-random raster: one line to and fro that wanders, never crosses, and covers the aperture.

    The lines are displaced by a sum of plane waves that the seed draws. Their slope (RMS 0.5) and their distance (RMS a
    fifth) vary, as slowly as the radius demands. Turns lie outside the aperture, with corners as those of `raster`.

    Args:
        aperture: area to cover.
        pitch_mm: mean distance of the lines: the path is as long as that of a raster of this pitch.
        step_mm: wanted length of the moves.
        seed: the same one gives the same path.
        min_radius_mm: smallest radius of curvature on the part, seen from above. A machine follows it at its largest
            feed where it is that feed squared over the acceleration.
        density: where lines are to be denser; None: evenly.
        optic: surface of the points.
        direction_deg: mean direction of the first line, counterclockwise from x.
        overrun_mm: distance that the lines go beyond the aperture.
        landing_mm: least distance of the first and the last point outside the aperture.

    Returns:
        (n + 1, 3) mm, part frame: n moves.

    Raises:
        ComputeError: an invalid length or seed, a radius that is too large for the aperture, too many points.
    """
    check_lengths(pitch_mm, step_mm, overrun_mm, landing_mm)
    require_number("the seed", float(seed), "", above=-1.0, below=2.0**63)
    _require_path(aperture, pitch_mm, step_mm, min_radius_mm)
    frame = _Frame.of(aperture, direction_deg, pitch_mm, overrun_mm, landing_mm)
    curvature = 1 / min_radius_mm
    base = straight if density is None else _dense_lines(frame, density, curvature / 2)
    return _points(frame, _wandering(frame, base, seed, curvature), step_mm, optic)


def adaptive_raster(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    density: LineDensity,
    *,
    min_radius_mm: float = MIN_RADIUS_MM,
    optic: Optic = FLAT,
    direction_deg: float = 0.0,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
) -> FloatArray:
    """Points of a raster whose lines lie denser where the density says so, as far as radius and slope permit.

    Arguments, result and errors as of `random_raster`.
    """
    check_lengths(pitch_mm, step_mm, overrun_mm, landing_mm)
    _require_path(aperture, pitch_mm, step_mm, min_radius_mm)
    frame = _Frame.of(aperture, direction_deg, pitch_mm, overrun_mm, landing_mm)
    return _points(frame, _dense_lines(frame, density, 1 / min_radius_mm), step_mm, optic)


def _require_path(aperture: Aperture, pitch_mm: float, step_mm: float, min_radius_mm: float) -> None:
    """Raise ComputeError where there are too many points, or bends of this radius do not fit into the aperture."""
    require_points(4 * aperture.radius_mm**2 / (pitch_mm * step_mm))
    require_number("the smallest radius of the path", min_radius_mm, "mm", above=0.0)
    if 2 * min_radius_mm > aperture.radius_mm:
        raise ComputeError(
            f"bends of {min_radius_mm:.3g} mm radius do not fit into a part of {aperture.radius_mm:.3g} mm radius, at "
            f"most {aperture.radius_mm / 2:.3g} mm do. Set a smaller radius, and a feed at which the machine follows it"
        )


def straight(x_mm: FloatArray, v_mm: FloatArray) -> FloatArray:
    """Return the lines of a raster."""
    return v_mm + 0 * x_mm


@dataclass(frozen=True, slots=True)
class _Frame:
    """The aperture as the lines see it, which run along x."""

    covered: Aperture
    """The aperture and the overrun."""
    landing: Aperture
    """... and the distance of the landing points."""
    axes: FloatArray
    """(2, 2) rows: unit vectors along and across the lines, in the part's plane."""
    pitch_mm: float

    @classmethod
    def of(
        cls, aperture: Aperture, direction_deg: float, pitch_mm: float, overrun_mm: float, landing_mm: float
    ) -> _Frame:
        turn = np.radians(direction_deg)
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        seen = aperture.turned(-direction_deg) if direction_deg else aperture
        return cls(seen.larger(overrun_mm), seen.larger(landing_mm), axes, pitch_mm)

    @property
    def half_mm(self) -> float:
        """Half the side of the square that lines are defined on."""
        return self.covered.radius_mm * (1 + STEEPEST)

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """(n, n) v, by rows, and x: over the square that holds all lines."""
        reach = self.covered.radius_mm
        count = int(np.clip(2 * reach / (CHECK_PITCHES * self.pitch_mm), CHECKS, MOST_CHECKS))
        x = np.linspace(-reach, reach, count)
        v, along = np.meshgrid(np.linspace(-self.half_mm, self.half_mm, count), x, indexing="ij")
        return v, along

    def holds(self, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
        """Whether what is covered holds these places."""
        distance, azimuth = np.hypot(x_mm, y_mm), np.arctan2(y_mm, x_mm)
        return np.asarray(distance <= self.covered.rim_mm(azimuth.ravel()).reshape(azimuth.shape))


@dataclass(frozen=True, slots=True)
class _Bends:
    """Extremes and means of a line field inside the aperture."""

    curvature_per_mm: float
    slope: float
    spacing_off: float
    """Largest difference of the distance of lines along y from that of v, over the latter."""
    length: float
    """Length of path over the area, times the distance of v."""

    @classmethod
    def of(cls, frame: _Frame, field: LineField) -> _Bends:
        v, x = frame.samples()
        h = frame.pitch_mm / 4
        before, y, after = (field(x + way, v) for way in (-h, 0.0, h))
        inside = frame.holds(x, y)
        slope = (after - before) / (2 * h)
        bend = (after - 2 * y + before) / h**2 / (1 + slope**2) ** 1.5
        spacing = (field(x, v + h) - field(x, v - h)) / (2 * h)
        length = np.hypot(1.0, slope)
        return cls(
            float(np.abs(bend[inside]).max()),
            float(np.abs(slope[inside]).max()),
            float(np.abs(spacing[inside] - 1).max()),
            float(length[inside].sum() / spacing[inside].sum()),
        )


@dataclass(frozen=True, slots=True)
class _Waves:
    """A sum of plane waves that displaces lines along v."""

    along: FloatArray
    """(k,) rad, relative to ``scale``."""
    across: FloatArray
    phase: FloatArray
    scale: float
    """rad/mm along the lines, of a relative one of 1."""
    scale_across: float

    @classmethod
    def drawn(cls, seed: int, scale: float) -> _Waves:
        """Draw waves with the slope and the spacing of this module."""
        rng = np.random.default_rng(seed)
        along, across, phase = (rng.uniform(low, high, WAVES) for low, high in ((0.6, 1.4), (-1, 1), (0, 2 * np.pi)))
        # of equal slope each: an amplitude goes as 1 / along
        across_over_along = float(np.sqrt(np.mean((across / along) ** 2)))
        return cls(along, across, phase, scale, scale * SPACING / (SLOPE * across_over_along))

    def shift_mm(self, x_mm: FloatArray, v_mm: FloatArray) -> FloatArray:
        """Displacement at places of one shape."""
        total = np.zeros(np.broadcast_shapes(x_mm.shape, v_mm.shape))
        for size, kx, kv, start in self._each():
            total += size * np.sin(kx * x_mm + kv * v_mm + start)
        return total

    def bends(self, x_mm: FloatArray, v_mm: FloatArray) -> tuple[float, float]:
        """Largest curvature of straight lines displaced so, at (k,) places, and largest relative change of distance."""
        slope, bend, spacing = (np.zeros(x_mm.shape) for _ in range(3))
        for size, kx, kv, start in self._each():
            angle = kx * x_mm + kv * v_mm + start
            rise = size * np.cos(angle)
            slope += kx * rise
            spacing += kv * rise
            bend -= size * kx**2 * np.sin(angle)
        return float(np.abs(bend / (1 + slope**2) ** 1.5).max()), float(np.abs(spacing).max())

    def _each(self) -> Iterator[tuple[float, float, float, float]]:
        """Amplitude, wave numbers and phase of each wave."""
        amplitude = SLOPE * (2 / WAVES) ** 0.5 / (self.scale * self.along)
        return zip(amplitude, self.scale * self.along, self.scale_across * self.across, self.phase, strict=True)

    def over(self, base: LineField) -> LineField:
        """Return the lines of another field, displaced."""
        return lambda x, v: base(x, v + self.shift_mm(x, v))


def _wandering(frame: _Frame, base: LineField, seed: int, curvature: float) -> LineField:
    """Lines displaced by the shortest waves that keep to a curvature."""
    shortest = 2 * np.pi / (WAVE_PITCHES * frame.pitch_mm)
    waves = _Waves.drawn(seed, min(FIRST * curvature / SLOPE, shortest))
    v, x = frame.samples()
    wider = np.hypot(x, v) <= frame.half_mm  # wherever lines may be moved from into what is covered
    v, x = v[wider], x[wider]
    own = curvature
    for _ in range(FITS):
        bend, spacing = waves.bends(x, v)
        over, crowded = bend / (MARGIN * own), spacing / MOST_SPACING
        if over <= 1 and crowded <= 1:
            if base is straight:
                return waves.over(base)
            whole = _Bends.of(frame, waves.over(base)).curvature_per_mm / (MARGIN * curvature)
            if whole <= 1:
                return waves.over(base)
            own *= 0.9 / whole
            continue
        scale = waves.scale * float(np.clip(1 / over, 0.6, 0.95)) if over > 1 else waves.scale
        ratio = waves.scale_across / waves.scale * (0.98 / crowded if crowded > 1 else 1.0)
        waves = replace(waves, scale=scale, scale_across=scale * ratio)
    raise ComputeError(
        f"no pseudo-random lines keep to a radius of {1 / curvature:.3g} mm here. Set a smaller radius or no density"
    )


def _dense_lines(frame: _Frame, density: LineDensity, curvature: float) -> LineField:
    """Lines that follow a density, smoothed until they keep to curvature and slope."""
    smoothing = SMOOTHING * frame.pitch_mm
    for _ in range(SMOOTHINGS):
        field = _follow(frame, density, smoothing)
        bends = _Bends.of(frame, field)
        if bends.curvature_per_mm <= MARGIN * curvature and bends.slope <= STEEPEST:
            return field
        smoothing *= SMOOTHER
    return straight


def _follow(frame: _Frame, density: LineDensity, smoothing_mm: float) -> LineField:
    """Lines whose distance along y is inverse to the density: equal steps of its integral along y."""
    at = np.linspace(-frame.half_mm, frame.half_mm, LATTICE)
    y, x = np.meshgrid(at, at, indexing="ij")
    places = np.stack([x, y], axis=-1) @ frame.axes
    relative = density.at(places[..., 0], places[..., 1], smoothing_mm)
    relative = relative / relative[frame.holds(x, y)].mean()
    v = scipy.integrate.cumulative_trapezoid(relative, at, axis=0, initial=0.0)
    # any offset of a column is free: with this one the lines are level in the mean over the middle of the column
    v -= np.average(v, axis=0, weights=np.exp(-((at / (frame.covered.radius_mm / 2)) ** 2)))
    steps = np.linspace(-frame.half_mm, frame.half_mm, 2 * LATTICE - 1)
    far = 4 * frame.half_mm
    column = np.empty((len(steps), len(at)))
    for k in range(len(at)):
        own = np.concatenate([[v[0, k] - far * relative[0, k]], v[:, k], [v[-1, k] + far * relative[-1, k]]])
        column[:, k] = np.interp(steps, own, np.concatenate([[at[0] - far], at, [at[-1] + far]]))
    spline = scipy.interpolate.RectBivariateSpline(steps, at, column)
    return lambda x_mm, v_mm: np.asarray(spline.ev(v_mm, x_mm))


def _landing_x(frame: _Frame, field: LineField, v_mm: float, x_mm: float, sign: int) -> float:
    """X at which a line that goes on beyond x has left the landing's aperture, LEAD_IN_MM farther at least."""
    beyond = max(sign * x_mm, 0.0) + LEAD_IN_MM
    ahead = sign * np.linspace(sign * x_mm + LEAD_IN_MM, max(beyond, frame.landing.radius_mm), CHECKS)
    place = np.column_stack([ahead, field(ahead, np.full_like(ahead, v_mm))])
    out = frame.landing.rim_mm(np.arctan2(place[:, 1], place[:, 0])) <= np.hypot(*place.T)
    out[-1] = True
    return float(ahead[np.argmax(out)])


def _points(frame: _Frame, field: LineField, step_mm: float, optic: Optic) -> FloatArray:
    """Points along the lines of a field, to and fro, as many as a raster of this pitch has."""
    v_pitch = frame.pitch_mm * _Bends.of(frame, field).length
    covered, reach = frame.covered, frame.covered.radius_mm
    v = line_heights(optic, frame.axes[1], v_pitch, covered.heights_mm)
    more = np.arange(1, int((frame.half_mm - min(v[0], -v[-1])) / v_pitch) + 2)
    above, below = (v[0] - v[1], v[-2] - v[-1]) if len(v) > 1 else (v_pitch, v_pitch)
    v = np.concatenate([v[0] + above * more[::-1], v, v[-1] - below * more])
    x = np.linspace(-reach, reach, int(np.ceil(2 * reach * SAMPLES_A_STEP / min(step_mm, reach / 8))) + 1)
    lines, spans = [], []
    for one in v:
        inside = np.flatnonzero(frame.holds(x, field(x, np.full_like(x, one))))
        if inside.size:
            lines.append(float(one))
            spans.append((float(x[max(inside[0] - 1, 0)]), float(x[min(inside[-1] + 1, len(x) - 1)])))
    if not lines:
        raise ComputeError(f"no line of a raster with {frame.pitch_mm:g} mm between its lines meets the aperture")
    left, right = np.array(spans).T
    first, last = left.copy(), right.copy()
    for k in range(len(lines) - 1):  # both lines of a turn go on to where the longer one ends
        end, turn = (last, max(right[k : k + 2])) if k % 2 == 0 else (first, min(left[k : k + 2]))
        end[k : k + 2] = turn
    first[0] = _landing_x(frame, field, lines[0], first[0], -1)
    if len(lines) % 2:
        last[-1] = _landing_x(frame, field, lines[-1], last[-1], 1)
    else:
        first[-1] = _landing_x(frame, field, lines[-1], first[-1], -1)
    runs = []
    for k, one in enumerate(lines):
        way = np.linspace(first[k], last[k], max(int((last[k] - first[k]) / (x[1] - x[0])), 1) + 1)
        run = np.column_stack([way, field(way, np.full_like(way, one))])
        runs.append(run if k % 2 == 0 else run[::-1])
    plane = np.concatenate(runs) @ frame.axes
    index = np.arange(len(plane))

    def curve(parameter: FloatArray) -> FloatArray:
        return on_optic(optic, np.stack([np.interp(parameter, index, axis) for axis in plane.T], axis=1))

    ends = np.cumsum([len(run) for run in runs])
    corners = np.unique(np.concatenate([[0, len(plane) - 1], ends[:-1] - 1, ends[:-1]]))
    return resample_evenly(curve, index.astype(np.float64), corners, step_mm)
