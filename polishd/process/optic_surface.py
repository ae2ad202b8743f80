"""The nominal surface: exact heights and unit normals of flats, spheres, conics and even aspheres, off axis too."""

from __future__ import annotations

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import Optic
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where

ITERATIONS = 30
"""Most Newton steps along a point's line; four are usual."""


def sag_mm(optic: Optic, plane_mm: FloatArray) -> FloatArray:
    """(n,) heights of the optic over points (n, 2) of the part's frame (see `Optic`), mm.

    Raises ComputeError for an optic that is none, and for a point that it does not reach.
    """
    if is_flat(optic):
        return np.zeros(len(plane_mm))
    height, _ = _lifted(optic, np.asarray(plane_mm, dtype=np.float64))
    return height


def unit_normals(optic: Optic, plane_mm: FloatArray) -> FloatArray:
    """(n, 3) unit normals, out of the part, over points (n, 2) of the part's frame; raises as `sag_mm`."""
    normal = np.tile([0.0, 0.0, 1.0], (len(plane_mm), 1))
    if is_flat(optic):
        return normal
    _, parent = _lifted(optic, np.asarray(plane_mm, dtype=np.float64))
    normal[:, :2] = -_slopes(optic, parent)
    normal /= np.sqrt(np.einsum("ni,ni->n", normal, normal))[:, None]
    return normal @ _frame(optic)[1] if any(optic.offset_mm) else normal


def is_flat(optic: Optic) -> bool:
    """Return whether the surface is a plane; ComputeError for impossible figures."""
    radius = optic.radius_mm
    if radius is not None and not (np.isfinite(radius) and radius != 0):
        raise ComputeError(f"the part's radius of curvature is {radius} mm, it must be finite and not 0")
    if not np.isfinite([optic.conic, *optic.even, *optic.offset_mm]).all():
        raise ComputeError(
            f"conic {optic.conic}, even coefficients {optic.even} and offset {optic.offset_mm} mm must be finite"
        )
    return radius is None and not any(optic.even)


def _lifted(optic: Optic, plane: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) heights in the part's frame over (n, 2), and the (n, 2) points of the parent's frame that they belong to."""
    if not any(optic.offset_mm):
        return _height(optic, plane), plane
    centre, axes = _frame(optic)
    at = centre + plane @ axes[:, :2].T
    height = _along(optic, at, axes[:, 2], plane)
    return height, at[:, :2] + height[:, None] * axes[:2, 2]


def _frame(optic: Optic) -> tuple[FloatArray, FloatArray]:
    """Origin (3,) and axes (3, 3, in columns) of the part's frame in the parent's."""
    offset = np.array([optic.offset_mm], dtype=np.float64)
    a, b = -_slopes(optic, offset)[0]
    size = np.sqrt(1 + a * a + b * b)
    a, b, c = a / size, b / size, 1 / size
    axes = [[1 - a * a / (1 + c), -a * b / (1 + c), a], [-a * b / (1 + c), 1 - b * b / (1 + c), b], [-a, -b, c]]
    return np.append(offset[0], _height(optic, offset)), np.array(axes)


def _height(optic: Optic, parent: FloatArray) -> FloatArray:
    """(n,) heights over (n, 2) in the parent's frame."""
    square = np.einsum("ni,ni->n", parent, parent)
    conic = _curvature(optic) * square / (1 + np.sqrt(_radicand(optic, parent)))
    return np.asarray(conic + _even(optic)(square), dtype=np.float64)


def _slopes(optic: Optic, parent: FloatArray) -> FloatArray:
    """(n, 2) derivatives of the height along the parent's x and y."""
    square = np.einsum("ni,ni->n", parent, parent)
    over_r = _curvature(optic) / np.sqrt(_radicand(optic, parent)) + 2 * _even(optic).deriv()(square)
    return np.asarray(parent * over_r[:, None], dtype=np.float64)


def _radicand(optic: Optic, parent: FloatArray) -> FloatArray:
    """(n,) ``1 - (1 + k) (r / R)^2``, above 0."""
    square = np.einsum("ni,ni->n", parent, parent)
    inside = 1 - (1 + optic.conic) * _curvature(optic) ** 2 * square
    _refuse_beyond(optic, inside <= 0, parent, "the part's axis")
    return np.asarray(inside, dtype=np.float64)


def _along(optic: Optic, at: FloatArray, way: FloatArray, plane: FloatArray) -> FloatArray:
    """(n,) heights at which lines from points (n, 3) of the parent's frame along the unit (3,) way meet the surface.

    In closed form for the conic; Newton's steps from there where the asphere has more terms.
    """
    c, stretch = _curvature(optic), np.array([1.0, 1.0, 1 + optic.conic])
    a, b = c * (way * stretch @ way), c * (at * stretch @ way) - way[2]
    constant = c * np.einsum("ni,i,ni->n", at, stretch, at) - 2 * at[:, 2]
    root = b * b - a * constant
    _refuse_beyond(optic, root <= 0, plane, "the part's centre")
    height = np.asarray(constant / (np.sqrt(root) - b), dtype=np.float64)
    far = 1 - c * (1 + optic.conic) * (at[:, 2] + height * way[2]) <= 0
    _refuse_beyond(optic, far, plane, "the part's centre")
    return _settled(optic, height, at, way) if any(optic.even) else height


def _settled(optic: Optic, height: FloatArray, at: FloatArray, way: FloatArray) -> FloatArray:
    step = np.full(len(height), np.inf)
    least = 1e-13 * (1 + np.abs(at).max())
    for _ in range(ITERATIONS):
        if np.abs(step).max(initial=0.0) < least:
            return height
        there = at + height[:, None] * way
        rise = way[2] - _slopes(optic, there[:, :2]) @ way[:2]
        refuse_where(rise <= 1e-6, rise, "the cosine to the normal at the part's centre", "", "the surface turns away")
        step = (there[:, 2] - _height(optic, there[:, :2])) / rise
        height = height - step
    refuse_where(np.abs(step) >= least, step, "the asphere's height is still moving by", "mm", "it must settle")
    return height


def _even(optic: Optic) -> np.polynomial.Polynomial:
    """The terms from r^4 on, as a polynomial of r^2."""
    return np.polynomial.Polynomial([0.0, 0.0, *optic.even])


def _curvature(optic: Optic) -> float:
    return 0.0 if optic.radius_mm is None else 1 / optic.radius_mm


def _refuse_beyond(optic: Optic, beyond: BoolArray, plane: FloatArray, origin: str) -> None:
    """Refuse points (n, 2) beyond the optic's rim, with where the first of them lies."""
    if beyond.any():
        x, y = plane[int(np.argmax(beyond))]
        ends = "the nominal optic ends before it"
        if optic.conic > -1:
            ends += f", {1 / abs(_curvature(optic)) / np.sqrt(1 + optic.conic):.6g} mm from its axis"
        distance = np.hypot(plane[:, 0], plane[:, 1])
        refuse_where(beyond, distance, f"the distance from {origin}", "mm", f"{ends}; at x {x:.6g}, y {y:.6g} mm")
