"""Rasters: lines to and fro over an aperture, turns outside it, a way in and a way out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.process import FLAT, Optic
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.process.checks import require_number
from polishd.process.optic_surface import is_flat, unit_normals
from polishd.process.toolpath.apertures import (
    TOWARDS,
    Aperture,
    along_polyline,
    on_optic,
    require_points,
    resample_evenly,
)

LEAD_IN_MM = 5.0
"""Length of the straight way in and out, at least."""
MOST_LINES = 100_000
SECTION = 64
"""Samples a pitch along the section in which the lines' distance is measured on a curved optic."""


def raster(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    *,
    optic: Optic = FLAT,
    direction_deg: float = 0.0,
    phase: float = 0.0,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
) -> FloatArray:
    """Points of a raster over an aperture, in running order; the hole of an annulus is crossed.

    One line passes through the centre, the others lie beside it, ``pitch_mm`` apart along the optic where the plane
    through the centre and across the lines cuts it. Seen from above with the lines along x the topmost comes first,
    to the right. Each begins and ends outside the aperture by ``overrun_mm`` at least, and turns lie there, too.

    Args:
        aperture: what is to be covered.
        pitch_mm: distance of the lines.
        step_mm: wanted length of the moves; each stretch is cut into equal moves of about this length.
        optic: the surface that the points lie on.
        direction_deg: where the first line runs, counterclockwise from the part's x.
        phase: shift of all lines across, in pitches: a second pass with 0.5 runs between the lines of the first.
        overrun_mm: how far the lines go beyond the aperture.
        landing_mm: the first and the last point lie at least this far outside the aperture.

    Returns:
        (n + 1, 3) mm, part frame: n moves.

    Raises:
        ComputeError: a length that is none, or an optic that ends before the path does.
    """
    check_lengths(pitch_mm, step_mm, overrun_mm, landing_mm)
    turn = np.radians(direction_deg)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    seen = aperture.turned(-direction_deg) if direction_deg else aperture
    covered = seen.larger(overrun_mm)
    y = line_heights(optic, axes[1], pitch_mm, covered.heights_mm, phase)
    left, right = covered.spans_mm(y)
    backwards = len(y) % 2 == 0  # the last line
    ways = (
        _lead(seen.larger(landing_mm), float(left[0]), float(y[0]), -1),
        _lead(seen.larger(landing_mm), float((left if backwards else right)[-1]), float(y[-1]), -1 if backwards else 1),
    )
    return along_polyline(optic, _to_and_fro(y, left, right, ways) @ axes, step_mm)


def crossed_raster(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    *,
    cross_deg: float = 90.0,
    optic: Optic = FLAT,
    direction_deg: float = 0.0,
    phase: float = 0.0,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
) -> FloatArray:
    """Points of two rasters, one after the other, the second turned by an angle: each does half of the removal.

    Between them the path runs round the part, as far outside as it lands. Each pattern has half the height that one
    raster leaves, at another direction: together their RMS is that of one over the root of 2.

    Args:
        aperture: as `raster`, as all other arguments.
        pitch_mm: distance of the lines of each raster.
        step_mm: wanted length of the moves.
        cross_deg: angle from the first raster to the second.
        optic: the surface that the points lie on.
        direction_deg: of the first raster.
        phase: of both rasters.
        overrun_mm: as `raster`.
        landing_mm: as `raster`.

    Returns:
        (n + 1, 3) mm, part frame: n moves.

    Raises:
        ComputeError: as `raster`; an angle below 1 or above 179 degrees: both patterns would add up.
    """
    require_number("the angle between both rasters", cross_deg, "deg", above=1.0 - 1e-9, below=179.0 + 1e-9)
    first, second = (
        raster(
            aperture, pitch_mm, step_mm, optic=optic, direction_deg=turn, phase=phase, overrun_mm=overrun_mm,
            landing_mm=landing_mm,
        )
        for turn in (direction_deg, direction_deg + cross_deg)
    )  # fmt: skip
    way = _round_mm(aperture.larger(max(landing_mm, overrun_mm)), first[-1, :2], second[0, :2])
    return np.concatenate([first[:-1], along_polyline(optic, way, step_mm), second[1:]])


def _round_mm(outside: Aperture, start: FloatArray, end: FloatArray) -> FloatArray:
    """(k, 2) corners of the shorter way round an aperture, from a place beside it to another."""
    begin, turn = np.arctan2(start[1], start[0]), np.arctan2(end[1], end[0])
    swing = (turn - begin + np.pi) % (2 * np.pi) - np.pi
    azimuth = begin + np.linspace(0.0, 1.0, max(int(abs(swing) / ROUND_RAD), 1) + 1) * swing
    rim = outside.rim_mm(azimuth) / np.cos(ROUND_RAD / 2)  # chords touch the aperture at most
    return np.concatenate([start[None], rim[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1), end[None]])


def check_lengths(pitch_mm: float, step_mm: float, overrun_mm: float, landing_mm: float) -> None:
    """Raise ComputeError unless pitch and step are above 0, overrun and landing at least 0, and all finite."""
    for what, value in (("the pitch", pitch_mm), ("the step", step_mm)):
        require_number(what, value, "mm", above=0.0)
    for what, value in (("the overrun", overrun_mm), ("the landing's distance", landing_mm)):
        require_number(what, value, "mm", above=-1e-12)


def line_heights(
    optic: Optic, across: FloatArray, pitch: float, reach: tuple[float, float], phase: float = 0.0
) -> FloatArray:
    """(m,) distances of the lines from the centre within the reach, the topmost first; without a phase one is there."""
    require_number("the phase of the lines", phase, "", above=-MOST_LINES, below=MOST_LINES)
    shift = phase - np.floor(phase)
    require_number("the number of lines", (reach[1] - reach[0]) / pitch, "", above=0.0, below=MOST_LINES)
    sides = []
    for end, sign in zip(reach, (-1.0, 1.0), strict=True):
        far = max(sign * end, 0.0)
        t = np.linspace(0.0, far, max(int(np.ceil(far / pitch * SECTION)), 1) + 1)
        height = on_optic(optic, sign * t[:, None] * across)[:, 2]
        way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(t), np.diff(height)))])
        own = shift if sign > 0 else 1.0 - shift  # the line at the centre, without a shift, counts as above it
        wanted = (own + np.arange(max(int(np.floor(way[-1] / pitch - own + 1e-9)) + 1, 0))) * pitch
        sides.append(sign * np.interp(wanted, way, t))
    below, above = sides
    return np.concatenate([above[::-1], below])


def _lead(outside: Aperture, x: float, y: float, sign: int) -> float:
    """Return the end of a line along x from (x, y) out of this aperture; -1 is to the left."""
    way, (lowest, highest) = LEAD_IN_MM, outside.heights_mm
    if lowest <= y <= highest:
        left, right = (float(end[0]) for end in outside.spans_mm(np.array([y])))
        way = max(way, sign * ((left if sign < 0 else right) - x))
    return x + sign * way


def _to_and_fro(y: FloatArray, left: FloatArray, right: FloatArray, ways: tuple[float, float]) -> FloatArray:
    """Corners (2 m, 2) of lines from left to right, odd ones back, joined at the outer end of each pair."""
    x = np.empty((len(y), 2))
    x[0, 0], x[-1, 1] = ways
    forth = np.arange(len(y) - 1) % 2 == 0
    turn = np.where(forth, np.maximum(right[:-1], right[1:]), np.minimum(left[:-1], left[1:]))
    x[:-1, 1] = x[1:, 0] = turn
    return np.stack([x.ravel(), y.repeat(2)], axis=1)


# Archimedean spirals over an aperture, at constant steps.

MERIDIANS = 32
"""On a curved optic the pitch is the mean over so many sections through the centre."""
NEAR_RAD = 0.1
"""Most angle between two samples of the way along the curve, which counts near the centre."""
SAMPLES = 2049
"""Samples along each of them."""
ROUND_RAD = 0.03
"""Angle between two corners of the way round a part."""
RING_CHANGE = 1 / 8
"""Share of a turn that leads from a ring to the next."""
SMALL_RAD = 1e-6
"""Two points of the curve that are so far apart tell its direction."""


def spiral(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    *,
    optic: Optic = FLAT,
    inwards: bool = False,
    rings: bool = False,
    phase: float = 0.0,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
    way_in: bool = True,
) -> FloatArray:
    """Points of a spiral about the part's centre, counterclockwise seen from above (inwards: the same run back).

    Over a disc the turns are ``pitch_mm`` apart along the optic. Over any other aperture they keep the rim's shape:
    so far apart where the rim is farthest, and closer elsewhere. It comes straight in from ``landing_mm`` outside to
    the centre, which is one point, or to ``overrun_mm`` inside the rim of the hole, runs round until it has left the
    rim by ``overrun_mm``, and then straight on to ``landing_mm`` outside.

    Args:
        aperture: what is to be covered.
        pitch_mm: distance of the turns.
        step_mm: wanted length of the moves: all are equal but for the way in or out.
        optic: the surface that the points lie on.
        inwards: from outside to the centre.
        rings: concentric rings instead, the innermost half a pitch from the centre. An eighth of each turn leads to the
            next ring; there the distance of neighbors is the same.
        phase: shift of all turns outwards, in pitches: a second pass with 0.5 runs between the turns of the first.
        overrun_mm: how far it goes beyond the aperture.
        landing_mm: the ends lie at least this far outside the aperture.
        way_in: False: without the way in; it begins at the centre or in the hole, where the tool must not stand.

    Returns:
        (n + 1, 3) mm, part frame: n moves.

    Raises:
        ComputeError: a length that is none, a centre outside the aperture, or an optic that ends before the path does.
    """
    check_lengths(pitch_mm, step_mm, overrun_mm, landing_mm)
    covered = aperture.larger(overrun_mm)
    require_number("the phase of the turns", phase, "", above=-MOST_LINES, below=MOST_LINES)
    turns, radius = _turns(covered, optic, pitch_mm)
    first, last = (2 * np.pi * np.interp([covered.hole_mm, covered.radius_mm], radius, turns)).tolist()
    curve = _Spiral(covered, optic, turns, radius, 2 * np.pi * (phase - np.floor(phase)))
    if rings:
        # turn k runs on ring k; of the hole's rim and the part's, the rings next to them are whole
        shift = (0.5 + phase) % 1.0
        curve = replace(curve, azimuth_rad=0.0, ring_shift=shift)
        first = 2 * np.pi * max(np.ceil(first / (2 * np.pi) - shift - 1e-9), 0.0 if shift > 0.1 else 1.0)
        last = 2 * np.pi * max(np.ceil(last / (2 * np.pi) - shift), first / (2 * np.pi) + 1.0)
    count = pitch_mm * (last**2 - first**2) / (4 * np.pi * step_mm)
    require_points(count)
    far = np.sqrt(np.linspace(first**2, last**2, 2 * int(count) + 2))
    knots = np.union1d(far, np.linspace(first, last, int((last - first) / NEAR_RAD) + 2))
    points = resample_evenly(curve, knots, np.array([0, len(knots) - 1]), step_mm)
    outside = aperture.larger(landing_mm)
    way_out = _straight(optic, points[-1, :2], curve.heading(last - SMALL_RAD), outside, step_mm)
    points = np.concatenate([points, way_out[1:]])
    if way_in:
        lead = _straight(optic, points[0, :2], -curve.heading(first), outside, step_mm)
        points = np.concatenate([lead[:0:-1], points])
    return np.ascontiguousarray(points[::-1]) if inwards else points


@dataclass(frozen=True, slots=True)
class _Spiral:
    """The curve: the angle run through, rad, to points on the optic."""

    covered: Aperture
    optic: Optic
    turns: FloatArray
    """(k,) turns run through, from 0, at ..."""
    radius_mm: FloatArray
    """... (k,) distances from the axis where the rim is farthest."""
    azimuth_rad: float = 0.0
    """Where it begins, counterclockwise from x."""
    ring_shift: float | None = None
    """Of concentric rings, the innermost one's distance from the centre in turns; None: a spiral."""

    def __call__(self, angle_rad: FloatArray) -> FloatArray:
        return on_optic(self.optic, self.plane(angle_rad))

    def plane(self, angle_rad: FloatArray) -> FloatArray:
        """(n, 2) points seen from above."""
        turn = angle_rad / (2 * np.pi)
        if self.ring_shift is not None:
            ring = np.floor(turn)
            beyond = np.maximum(turn - ring - (1 - RING_CHANGE), 0.0) / RING_CHANGE
            turn = self.ring_shift + ring + beyond**2 * (3 - 2 * beyond)
        # beyond the rim it goes on as far apart as the last turns are
        far = (turn - self.turns[-1]) * (self.radius_mm[-1] - self.radius_mm[-2]) / (self.turns[-1] - self.turns[-2])
        radius = np.interp(turn, self.turns, self.radius_mm) + np.maximum(far, 0.0)
        azimuth = angle_rad + self.azimuth_rad
        way = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        rim = self.covered.rim_mm(azimuth)
        return np.asarray(way * (radius / self.radius_mm[-1] * rim)[:, None], dtype=np.float64)

    def heading(self, angle_rad: float) -> FloatArray:
        """(2,) unit direction of the run just after it."""
        here, after = self.plane(np.array([angle_rad, angle_rad + SMALL_RAD]))
        return np.asarray((after - here) / np.linalg.norm(after - here), dtype=np.float64)


def _turns(covered: Aperture, optic: Optic, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Turns run through at distances from the axis: the mean way along the optic from the centre, in pitches."""
    radius = np.linspace(0.0, covered.radius_mm, 2 if is_flat(optic) else SAMPLES)
    azimuth = np.linspace(0.0, 2 * np.pi, MERIDIANS, endpoint=False)
    share = covered.rim_mm(azimuth) / covered.radius_mm
    across = (share * [np.cos(azimuth), np.sin(azimuth)])[:, :, None] * radius
    height = on_optic(optic, across.reshape(2, -1).T)[:, 2].reshape(MERIDIANS, -1)
    moves = np.hypot(share[:, None] * np.diff(radius), np.diff(height, axis=1)) / share[:, None]
    return np.concatenate([[0.0], np.cumsum(moves.mean(axis=0))]) / pitch, radius


def _straight(optic: Optic, start: FloatArray, heading: FloatArray, outside: Aperture, step_mm: float) -> FloatArray:
    """(m, 3) points from there straight on until out of that aperture; one where it has been left."""
    ahead = TOWARDS @ heading
    facing = ahead > 1e-9
    beyond = float(((outside.reach_mm - TOWARDS @ start)[facing] / ahead[facing]).min())
    if beyond <= 0:
        return on_optic(optic, start[None])
    return along_polyline(optic, np.stack([start, start + beyond * heading]), step_mm)


# Short tracks over a part, each with its lean, joined to one path that stays in contact.

TURN_DEG = 20.0
"""Most that the lean turns in one move of the way to the next track."""
HERE_MM = 1.0
BETWEEN = -1
"""The track of a move that is on none."""


@dataclass(frozen=True, slots=True)
class Track:
    """A straight line to be polished slowly."""

    middle_mm: tuple[float, float]
    along_deg: float
    """Its direction, counterclockwise from x."""
    length_mm: float
    turn_deg: float = 0.0
    """Turn of the spindle's lean about the normal from its direction on the path, counterclockwise."""

    def ends_mm(self, *, backwards: bool = False) -> FloatArray:
        """(2, 2) first and last point."""
        angle = np.radians(self.along_deg)
        half = self.length_mm / 2 * np.array([np.cos(angle), np.sin(angle)])
        ends = np.array([self.middle_mm - half, self.middle_mm + half])
        return ends[::-1] if backwards else ends


@dataclass(frozen=True, slots=True)
class Joined:
    """A path of m points."""

    points_mm: FloatArray
    """(m, 3) on the optic."""
    turn_deg: FloatArray
    """(m,) of the lean."""
    track: IntArray
    """(m - 1,) which track each move is of, by its place in the sequence; `BETWEEN`: none."""

    def axes(self, optic: Optic, own: FloatArray) -> FloatArray:
        """(m, 3) tool axes: ``own`` (m, 3), the axes without a turn, turned about the normals."""
        normals = unit_normals(optic, self.points_mm[:, :2])
        return np.asarray(
            scipy.spatial.transform.Rotation.from_rotvec(np.radians(self.turn_deg)[:, None] * normals).apply(own)
        )


def join_tracks(optic: Optic, tracks: Sequence[Track], landing_mm: float, step_mm: float) -> Joined:
    """Return a path from a landing point at this distance over all tracks to another; moves of at most ``step_mm``."""
    places, turns, owners = _corners(tracks, landing_mm)
    plane, turn, track = [places[:1]], [turns[:1]], []
    for k, owner in enumerate(owners):
        length, swing = np.linalg.norm(places[k + 1] - places[k]), abs(turns[k + 1] - turns[k])
        count = max(int(np.ceil(length / step_mm)), int(np.ceil(swing / TURN_DEG)), 1)
        share = np.arange(1, count + 1)[:, None] / count
        plane.append(places[k] + share * (places[k + 1] - places[k]))
        turn.append(turns[k] + share[:, 0] * (turns[k + 1] - turns[k]))
        track.append(np.full(count, owner))
    return Joined(on_optic(optic, np.vstack(plane)), np.concatenate(turn), np.concatenate(track))


def _corners(tracks: Sequence[Track], landing_mm: float) -> tuple[FloatArray, FloatArray, list[int]]:
    """Of the path: (2 t + 2, 2) places, (2 t + 2,) turns, and the track of each way between.

    The nearer end of a track comes first, but for one that is where the path is: a way needs its length.
    """
    places: list[FloatArray] = []
    for track in tracks:
        ends = track.ends_mm()
        first, last = (float(np.linalg.norm(end - places[-1])) for end in ends) if places else (0.0, np.inf)
        back = (last < first and last > HERE_MM) or (bool(places) and first <= HERE_MM)
        places += list(track.ends_mm(backwards=back))
    way = [_outside(places[0], landing_mm), *places, _outside(places[-1], landing_mm)]
    own = [track.turn_deg for track in tracks for _ in range(2)]
    return np.array(way), np.array([own[0], *own, own[-1]]), list(_owners(len(tracks)))


def _owners(count: int) -> Iterator[int]:
    for k in range(count):
        yield from (BETWEEN, k)
    yield BETWEEN


def _outside(place: FloatArray, landing_mm: float) -> FloatArray:
    """The nearest landing point."""
    away = float(np.linalg.norm(place))
    return np.asarray(place / away * landing_mm) if away > 0 else np.array([landing_mm, 0.0])
