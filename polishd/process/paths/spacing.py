"""Points at equal steps along a curve on the optic, measured on the surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polishd.model.process import Optic
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.process.optics import sag_mm
from polishd.process.robot.refusal import require_number

Curve = Callable[[FloatArray], FloatArray]
"""(k,) parameters to (k, 3) points, mm."""
MOST_POINTS = 20_000_000


def on_optic(optic: Optic, plane_mm: FloatArray) -> FloatArray:
    """(n, 3) points of the optic over (n, 2) of the part's plane."""
    return np.column_stack([plane_mm, sag_mm(optic, plane_mm)])


def require_points(count: float) -> None:
    """Raise ComputeError for so many points that nobody can want them."""
    require_number("the number of points", count, "", above=0.0, below=MOST_POINTS)


def evenly(curve: Curve, knots: FloatArray, corners: IntArray, step_mm: float) -> FloatArray:
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
    """(m, 3) points of the optic over a polyline through (n, 2) corners, which become points, as `evenly`."""
    length = np.linalg.norm(np.diff(corners_mm, axis=0), axis=1)
    require_points(float(length.sum() / step_mm))
    cells = np.maximum(np.ceil(2 * length / step_mm).astype(np.int64), 2)
    index = np.arange(len(corners_mm))

    def curve(parameter: FloatArray) -> FloatArray:
        return on_optic(optic, np.stack([np.interp(parameter, index, axis) for axis in corners_mm.T], axis=1))

    first = np.concatenate([[0], np.cumsum(cells)])
    return evenly(curve, np.interp(np.arange(first[-1] + 1.0), first, index), first, step_mm)


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
