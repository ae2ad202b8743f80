"""Archimedean spirals over an aperture, at constant steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray
from polishd.process.optics import is_flat
from polishd.process.paths.apertures import TOWARDS, Aperture
from polishd.process.paths.raster import check_lengths
from polishd.process.paths.spacing import along_polyline, evenly, on_optic, require_points

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
    points = evenly(curve, knots, np.array([0, len(knots) - 1]), step_mm)
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
