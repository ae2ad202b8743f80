"""Rasters: lines to and fro over an aperture, turns outside it, a way in and a way out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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
    y = _lines(optic, axes[1], pitch_mm, covered.heights_mm)
    left, right = covered.spans_mm(y)
    backwards = len(y) % 2 == 0  # the last line
    ways = (
        _lead(seen.larger(landing_mm), float(left[0]), float(y[0]), -1),
        _lead(seen.larger(landing_mm), float((left if backwards else right)[-1]), float(y[-1]), -1 if backwards else 1),
    )
    return along_polyline(optic, _to_and_fro(y, left, right, ways) @ axes, step_mm)


def check_lengths(pitch_mm: float, step_mm: float, overrun_mm: float, landing_mm: float) -> None:
    """Raise ComputeError unless pitch and step are above 0, overrun and landing at least 0, and all finite."""
    for what, value in (("the pitch", pitch_mm), ("the step", step_mm)):
        require_number(what, value, "mm", above=0.0)
    for what, value in (("the overrun", overrun_mm), ("the landing's distance", landing_mm)):
        require_number(what, value, "mm", above=-1e-12)


def _lines(optic: Optic, across: FloatArray, pitch: float, reach: tuple[float, float]) -> FloatArray:
    """(m,) distances of the lines from the centre within the reach, the topmost first."""
    require_number("the number of lines", (reach[1] - reach[0]) / pitch, "", above=0.0, below=MOST_LINES)
    sides = []
    for end, sign in zip(reach, (-1.0, 1.0), strict=True):
        far = max(sign * end, 0.0)
        t = np.linspace(0.0, far, max(int(np.ceil(far / pitch * SECTION)), 1) + 1)
        height = on_optic(optic, sign * t[:, None] * across)[:, 2]
        way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(t), np.diff(height)))])
        wanted = np.arange(1, int(np.floor(way[-1] / pitch + 1e-9)) + 1) * pitch
        sides.append(sign * np.interp(wanted, way, t))
    below, above = sides
    return np.concatenate([above[::-1], [0.0], below])


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
SMALL_RAD = 1e-6
"""Two points of the curve that are so far apart tell its direction."""


def spiral(
    aperture: Aperture,
    pitch_mm: float,
    step_mm: float,
    *,
    optic: Optic = FLAT,
    inwards: bool = False,
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
    curve = _Spiral(covered, optic, *_turns(covered, optic, pitch_mm))
    first, last = (2 * np.pi * np.interp([covered.hole_mm, covered.radius_mm], curve.radius_mm, curve.turns)).tolist()
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

    def __call__(self, angle_rad: FloatArray) -> FloatArray:
        return on_optic(self.optic, self.plane(angle_rad))

    def plane(self, angle_rad: FloatArray) -> FloatArray:
        """(n, 2) points seen from above."""
        share = np.interp(angle_rad / (2 * np.pi), self.turns, self.radius_mm) / self.radius_mm[-1]
        way = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
        return np.asarray(way * (share * self.covered.rim_mm(angle_rad))[:, None], dtype=np.float64)

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
