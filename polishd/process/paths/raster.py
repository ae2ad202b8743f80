"""Rasters: lines to and fro over an aperture, turns outside it, a way in and a way out."""

from __future__ import annotations

import numpy as np

from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray
from polishd.process.paths.apertures import Aperture
from polishd.process.paths.spacing import along_polyline, on_optic
from polishd.process.robot.refusal import require_number

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


def quiet_step_mm(contact_radius_mm: float, at_most_mm: float) -> float:
    """The largest distance of raster lines, up to ``at_most_mm``, that leaves next to no ripple of its own.

    Lines that are a step apart leave a ripple whose depth, relative to the removal, is the spot's spectrum at the
    frequency 1 / step. Along one axis a Hertzian spot removes as ``1 - (y / a)^2``, whose spectrum is
    ``3 (sin u - u cos u) / u^3``, ``u = 2 pi a / step``: it vanishes where ``tan u = u``. At the paper's process
    a step of 1 mm leaves 4 % (3.4 nm in 75 nm), one of 0.93 mm a fifth of that.

    Args:
        contact_radius_mm: a, of the contact that really acts (the robot's compliance makes it smaller).
        at_most_mm: the step wanted.
    """
    k = np.arange(1, 200)
    centre = (k + 0.5) * np.pi
    nulls = centre - 1 / centre - 2 / (3 * centre**3)  # the roots of tan u = u, to 1e-3 from the first on
    steps = 2 * np.pi * contact_radius_mm / nulls
    return float(steps[steps <= at_most_mm].max(initial=0.0)) or at_most_mm


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
    """Where a way along x ends that starts at (x, y) and leads out of this aperture; -1 is to the left."""
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
