"""Clear apertures, by how far they reach in each direction: so that one that is larger all round is exact, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Outline
from polishd.model.process import ComplianceOptions, Optic, Placement
from polishd.model.program import IntArray
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process import frames
from polishd.process.checks import require_number
from polishd.process.optic_surface import sag_mm

DIRECTIONS = 4096
UP, DOWN = DIRECTIONS // 4, DIRECTIONS // 4 * 3
STEP_RAD = 2 * np.pi / DIRECTIONS
AZIMUTH_RAD = np.arange(DIRECTIONS) * STEP_RAD
TOWARDS = np.stack([np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD)], axis=1)


@dataclass(frozen=True, slots=True)
class Aperture:
    """A convex aperture in the part's plane, which holds the part's centre; a hole is round and central."""

    reach_mm: FloatArray
    """(DIRECTIONS,) distance of the straight edge that touches it from outside, facing each azimuth from +x."""
    hole_mm: float = 0.0
    """Radius of the hole; 0 where there is none."""

    def __post_init__(self) -> None:
        """ComputeError where the part's centre lies outside."""
        require_number("the least way from the part's centre to the rim", float(self.reach_mm.min()), "mm", above=0.0)

    @property
    def radius_mm(self) -> float:
        """Radius of the circle about the centre that holds it."""
        return float(self.reach_mm.max())

    def larger(self, by_mm: float) -> Aperture:
        """Return the aperture with its rim moved outwards, corners rounded, and its hole made smaller."""
        return replace(self, reach_mm=self.reach_mm + by_mm, hole_mm=max(self.hole_mm - by_mm, 0.0))

    def turned(self, by_deg: float) -> Aperture:
        """Return the aperture turned counterclockwise about the center."""
        azimuth = AZIMUTH_RAD - np.radians(by_deg)
        return replace(self, reach_mm=np.interp(azimuth, AZIMUTH_RAD, self.reach_mm, period=2 * np.pi))

    def outline_mm(self) -> FloatArray:
        """(DIRECTIONS, 2) corners of the polygon around it, counterclockwise; corner j ends the edge that faces j."""
        following = np.roll(self.reach_mm, -1)
        along = (following - self.reach_mm * np.cos(STEP_RAD)) / np.sin(STEP_RAD)
        across = np.stack([-TOWARDS[:, 1], TOWARDS[:, 0]], axis=1)
        return np.asarray(self.reach_mm[:, None] * TOWARDS + along[:, None] * across, dtype=np.float64)

    @property
    def heights_mm(self) -> tuple[float, float]:
        """Y of its lowest and of its highest point."""
        return -float(self.reach_mm[DOWN]), float(self.reach_mm[UP])

    def spans_mm(self, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) left and right ends of its cuts along y = (n,); above and below it those of its top and bottom."""
        outline = self.outline_mm()
        right = np.concatenate([outline[DOWN:], outline[:UP]])
        left = outline[UP:DOWN][::-1]
        ends = [np.interp(y_mm, np.maximum.accumulate(side[:, 1]), side[:, 0]) for side in (left, right)]
        return ends[0], ends[1]

    def rim_mm(self, azimuth_rad: FloatArray) -> FloatArray:
        """(n,) distance of the rim from the centre in the directions (n,)."""
        outline = self.outline_mm()
        corner = np.unwrap(np.arctan2(outline[:, 1], outline[:, 0]))
        past = (np.asarray(azimuth_rad) - corner[0]) % (2 * np.pi)
        facing = np.searchsorted(corner - corner[0], past, side="right") % DIRECTIONS
        return np.asarray(self.reach_mm[facing] / np.cos(azimuth_rad - AZIMUTH_RAD[facing]), dtype=np.float64)


def circle(diameter_mm: float) -> Aperture:
    """A disc."""
    return ellipse(diameter_mm, diameter_mm)


def annulus(outer_mm: float, inner_mm: float) -> Aperture:
    """A disc with a round hole in its centre, by their diameters."""
    require_number("the diameter of the hole", inner_mm, "mm", above=0.0, below=outer_mm)
    return replace(circle(outer_mm), hole_mm=inner_mm / 2)


def ellipse(width_mm: float, height_mm: float) -> Aperture:
    """An ellipse of these diameters along x and y."""
    half = np.array([_length("width", width_mm), _length("height", height_mm)]) / 2
    return Aperture(np.linalg.norm(TOWARDS * half, axis=1))


def rectangle(width_mm: float, height_mm: float) -> Aperture:
    """A rectangle of these lengths along x and y."""
    half = np.array([_length("width", width_mm), _length("height", height_mm)]) / 2
    return Aperture(np.asarray(np.abs(TOWARDS) @ half, dtype=np.float64))


def over_outline(outline: Outline) -> Aperture:
    """The smallest convex aperture that holds an outline: itself where that is convex."""
    if isinstance(outline, Circle):
        return annulus(2 * outline.radius_mm, 2 * outline.hole_mm) if outline.hole_mm else circle(2 * outline.radius_mm)
    return Aperture(np.asarray((outline.corners() @ TOWARDS.T).max(axis=0), dtype=np.float64))


def over_mask(grid: Grid, mask: BoolArray) -> Aperture:
    """The smallest convex aperture that holds the samples (ny, nx) of a mask, each as large as its pixel."""
    if not mask.any():
        raise ComputeError("the mask is empty: there is nothing to cover")
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), grid.nx - 1 - mask[rows, ::-1].argmax(axis=1)
    ends = np.concatenate([np.stack([grid.x_mm[column], grid.y_mm[rows]], axis=1) for column in (first, last)])
    pixel = np.abs(TOWARDS).sum(axis=1) * grid.pitch_mm / 2
    return Aperture(np.asarray((ends @ TOWARDS.T).max(axis=0) + pixel, dtype=np.float64))


def _length(what: str, value_mm: float) -> float:
    require_number(f"the aperture's {what}", value_mm, "mm", above=0.0)
    return value_mm


# Points at equal steps along a curve on the optic, measured on the surface.

Curve = Callable[[FloatArray], FloatArray]
"""(k,) parameters to (k, 3) points, mm."""
MOST_POINTS = 20_000_000


def on_optic(optic: Optic, plane_mm: FloatArray) -> FloatArray:
    """(n, 3) points of the optic over (n, 2) of the part's plane."""
    return np.column_stack([plane_mm, sag_mm(optic, plane_mm)])


def require_points(count: float) -> None:
    """Raise ComputeError where the number of points is out of range."""
    require_number("the number of points", count, "", above=0.0, below=MOST_POINTS)


def resample_evenly(curve: Curve, knots: FloatArray, corners: IntArray, step_mm: float) -> FloatArray:
    """(m, 3) points of a curve at equal ways along it between its corners, of about ``step_mm`` each.

    Args:
        curve: smooth from knot to knot.
        knots: (n,) increasing parameters, the curve's ends among them; about two a step give 1e-4 of a step.
        corners: indices of the knots that become points: the first, the last, and any between.
        step_mm: wanted way from point to point.
    """
    lengths, first_halves = _cells(curve, knots)
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    at = way[corners]
    count = np.maximum(np.rint(np.diff(at) / step_mm), 1)
    require_points(float(count.sum()))
    count = count.astype(np.int64)
    first = np.cumsum(count) - count
    within = np.arange(count.sum()) - first.repeat(count)
    wanted = at[:-1].repeat(count) + within * (np.diff(at) / count).repeat(count)
    cell = np.clip(np.searchsorted(way, wanted, side="right") - 1, 0, len(lengths) - 1)
    share = _share(wanted - way[cell], lengths[cell], first_halves[cell])
    parameter = knots[cell] + share * np.diff(knots)[cell]
    parameter[first] = knots[corners[:-1]]
    return curve(np.append(parameter, knots[-1]))


def along_polyline(optic: Optic, corners_mm: FloatArray, step_mm: float) -> FloatArray:
    """(m, 3) points of the optic over a polyline through (n, 2) corners, which become points, as `resample_evenly`."""
    length = np.linalg.norm(np.diff(corners_mm, axis=0), axis=1)
    require_points(float(length.sum() / step_mm))
    cells = np.maximum(np.ceil(2 * length / step_mm).astype(np.int64), 2)
    index = np.arange(len(corners_mm))

    def curve(parameter: FloatArray) -> FloatArray:
        return on_optic(optic, np.stack([np.interp(parameter, index, axis) for axis in corners_mm.T], axis=1))

    first = np.concatenate([[0], np.cumsum(cells)])
    return resample_evenly(curve, np.interp(np.arange(first[-1] + 1.0), first, index), first, step_mm)


def _cells(curve: Curve, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1,) lengths from knot to knot, and of their first halves: from one chord and two (Richardson)."""
    ends, middle = curve(knots), curve((knots[:-1] + knots[1:]) / 2)
    whole, first, second = _norm(np.diff(ends, axis=0)), _norm(middle - ends[:-1]), _norm(ends[1:] - middle)
    both = np.maximum(first + second, 1e-300)
    length = (4 * both - whole) / 3
    return length, length * first / both


def _share(way: FloatArray, length: FloatArray, first_half: FloatArray) -> FloatArray:
    """Share of the parameter's step at this way into a cell: the way is a quadratic of it through its three values."""
    slope, bend = 4 * first_half - length, 2 * length - 4 * first_half
    return 2 * way / np.maximum(slope + np.sqrt(np.maximum(slope**2 + 4 * bend * way, 0.0)), 1e-300)


def _norm(move: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", move, move)), dtype=np.float64)


# Tool axes along a path, and whether a wrist can follow them.

TURN_LIMIT_DEG = 95.0
"""Most turn of the wrist in one move. Beside the point where the normal is the C axis, C turns by up to 90 degrees."""


def tool_axes(
    points_mm: FloatArray, optic: Optic, dip_deg: float, options: ComplianceOptions, placement: Placement
) -> FloatArray:
    """(n, 3) unit tool axes at points (n, 3) mm, in the part's frame: the optic's normals, dipped as the options ask.

    Raises ComputeError for a point where the optic or the direction of the dip is not defined.
    """
    base = frames.points_to_base(placement, points_mm)
    normals = frames.surface_normals(placement, points_mm, optic)
    axes = frames.dipped_axes(options, placement, base, normals, dip_deg)
    return np.asarray(axes @ placement.rotation, dtype=np.float64)  # base to part: transposed, on rows


def largest_turn_deg(axis: FloatArray, limit_deg: float = TURN_LIMIT_DEG) -> float:
    """The largest turn of A or C from one of (n, 3) tool axes to the next; ComputeError names one above the limit."""
    a_deg, c_deg = frames.angles_from_axis(axis)
    turn = np.maximum(np.abs(np.diff(a_deg)), np.abs(np.diff(c_deg)))
    largest = float(turn.max(initial=0.0))
    if largest > limit_deg:
        k = int(np.argmax(turn > limit_deg))
        raise ComputeError(
            f"from point {k} to {k + 1} the wrist turns by {turn[k]:.4g} deg (A {a_deg[k]:.4g} to {a_deg[k + 1]:.4g}, "
            f"C {c_deg[k]:.5g} to {c_deg[k + 1]:.5g}), at most {limit_deg:g}: so at "
            f"{np.count_nonzero(turn > limit_deg)} moves. To do: lean more or elsewhere, or take shorter steps"
        )
    return largest


# How a path lies on a part: how far it reaches, and what of the clear aperture it never touches.

ACROSS = 200
"""Samples along x and along y across the clear aperture."""
STEPS = 4
"""Samples of the path a radius of the spot."""


@dataclass(frozen=True, slots=True)
class PathCoverage:
    """Coverage of a part by a path."""

    reach_mm: float
    """Distance from the part's center to the farthest point of the path."""
    outside: float
    """Share of the path farther beyond the part's rim than landing takes, by its length; of points, by number."""
    unreachable: float
    """Share of the clear aperture that lies farther from the path than the spot's radius."""


def coverage(
    start_mm: FloatArray, end_mm: FloatArray, *, spot_mm: float, outline: Outline, edge_mm: float, landing_mm: float
) -> PathCoverage:
    """Return the coverage of a path of blocks, (n, 3) mm in the part's frame.

    Args:
        start_mm: (n, 3) where each begins.
        end_mm: (n, 3) where each ends.
        spot_mm: radius of the spot.
        outline: of the part.
        edge_mm: width of the rim that the clear aperture leaves out.
        landing_mm: so far beyond the rim a path may run.
    """
    path = _samples(start_mm[:, :2], end_mm[:, :2], spot_mm / STEPS)
    outside = ~outline.contains(path[:, 0], path[:, 1], -landing_mm)
    x, y = (np.linspace(edge_mm - half, half - edge_mm, ACROSS) for half in outline.half_mm)
    aperture = outline.contains(*np.meshgrid(x, y), edge_mm)
    reached = _reached(path, spot_mm, x, y)
    return PathCoverage(
        float(np.linalg.norm(path, axis=1).max()), float(np.mean(outside)), float(np.mean(~reached[aperture]))
    )


def _reached(path_mm: FloatArray, spot_mm: float, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
    """(ny, nx) whether a sample, of even steps in (nx,) x and (ny,) y, lies within a spot of (k, 2) points of a path.

    Of each row that a spot meets it covers the samples from one to another: +1 and -1 there, summed along the rows.
    A tree of the points would take `scipy.spatial`, whose import takes longer than all of this.
    """
    step_mm = x_mm[1] - x_mm[0]
    change = np.zeros((len(y_mm), len(x_mm) + 1), dtype=np.int64)
    order = np.argsort(path_mm[:, 1], kind="stable")
    path = path_mm[order]
    first, last = (np.searchsorted(path[:, 1], y_mm + side * spot_mm) for side in (-1, 1))
    for row, (begin, end) in enumerate(zip(first, last, strict=True)):
        from_row = path[begin:end, 1] - y_mm[row]
        half = np.sqrt(np.maximum(spot_mm**2 - from_row**2, 0.0))
        ends = ((path[begin:end, 0] + side * half - x_mm[0]) / step_mm for side in (-1, 1))
        left, right = (np.clip(np.ceil(at), 0, len(x_mm)).astype(np.int64) for at in ends)
        change[row] = np.bincount(left, minlength=len(x_mm) + 1) - np.bincount(right, minlength=len(x_mm) + 1)
    return np.asarray(np.cumsum(change, axis=1)[:, :-1] > 0)


def _samples(start_mm: FloatArray, end_mm: FloatArray, step_mm: float) -> FloatArray:
    """(k, 2) points along all blocks, at most a step apart; of a block without length its end."""
    counts = np.maximum(np.ceil(np.linalg.norm(end_mm - start_mm, axis=1) / step_mm), 1).astype(np.int64)
    block = np.repeat(np.arange(counts.size), counts)
    number = np.arange(block.size) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    along = (number / counts[block])[:, None]
    return np.asarray(start_mm[block] + along * (end_mm - start_mm)[block], dtype=np.float64)
