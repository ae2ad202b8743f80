"""Raster paths over flat parts: lines to and fro, turns outside the part, a way in and a way out."""

from __future__ import annotations

import numpy as np

from polishd.model.surface import BoolArray, FloatArray, Grid

NORMAL = (0.0, 0.0, 1.0)


def raster(
    radius_mm: float,
    step_mm: float,
    block_mm: float,
    *,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
    lead_in_mm: float = 5.0,
) -> FloatArray:
    """Ends of the blocks of a raster over a disc, in running order.

    Lines run along x at every multiple of ``step_mm`` in y, the topmost first and to the right. Each begins and ends
    outside the disc by ``overrun_mm`` at least, and turns run along y: so no turn marks the part.

    Args:
        radius_mm: radius of the disc to cover.
        step_mm: distance of the lines.
        block_mm: wanted length of the blocks; each stretch is cut into equal blocks of about this length.
        overrun_mm: how far the lines go beyond the disc.
        landing_mm: the first and the last point lie at least this far outside the disc.
        lead_in_mm: length of the straight way in and out, at least.

    Returns:
        (n + 1, 3) mm, z = 0, part frame: n blocks.

    Raises:
        ValueError: a length that is not positive (overrun, landing and lead-in may be 0).
    """
    _check(radius_mm, step_mm, block_mm, overrun_mm, landing_mm, lead_in_mm)
    reach = radius_mm + overrun_mm
    count = int(np.floor(reach / step_mm + 1e-9))
    y = np.arange(count, -count - 1, -1) * step_mm
    half = np.sqrt(np.maximum(reach**2 - y**2, 0.0))
    way_in = _lead(half[0], y[0], radius_mm + landing_mm, lead_in_mm)
    way_out = _lead(half[-1], y[-1], radius_mm + landing_mm, lead_in_mm)
    return _to_and_fro(np.array([y, -half, half]), block_mm, (way_in, way_out))


def raster_over_mask(
    grid: Grid,
    mask: BoolArray,
    step_mm: float,
    block_mm: float,
    *,
    overrun_mm: float = 1.0,
    landing_mm: float = 5.0,
) -> FloatArray:
    """The same over any mask without gaps along x: each line spans the mask within ``overrun_mm`` of its y.

    Args:
        grid: the mask's grid.
        mask: (ny, nx) the part.
        step_mm: distance of the lines.
        block_mm: wanted length of the blocks.
        overrun_mm: how far the lines go beyond the mask.
        landing_mm: the first and the last point lie at least this far outside the mask.

    Returns:
        (n + 1, 3) mm, z = 0, part frame: n blocks.

    Raises:
        ValueError: an empty mask, or a length that is not positive.
    """
    _check(grid.pitch_mm, step_mm, block_mm, overrun_mm, landing_mm)
    rows = np.flatnonzero(mask.any(axis=1))
    if rows.size == 0:
        raise ValueError("the mask is empty: there is nothing to cover")
    left = grid.x_mm[mask[rows].argmax(axis=1)] - grid.pitch_mm / 2
    right = grid.x_mm[grid.nx - 1 - mask[rows, ::-1].argmax(axis=1)] + grid.pitch_mm / 2
    at = grid.y_mm[rows]
    margin = overrun_mm + grid.pitch_mm / 2
    top, bottom = at[0] + margin, at[-1] - margin
    y = np.linspace(top, bottom, max(int(np.ceil((top - bottom) / step_mm - 1e-9)), 1) + 1)
    near = np.abs(at[None, :] - y[:, None]) <= margin + step_mm
    begin = np.where(near, left[None, :], np.inf).min(axis=1) - overrun_mm
    end = np.where(near, right[None, :], -np.inf).max(axis=1) + overrun_mm
    lines = np.array([y, begin, end])
    backwards = len(y) % 2 == 0  # the last line
    far = -1 if backwards else 1
    ways = (
        _clear(at - y[0], begin[0] - left, landing_mm),
        _clear(at - y[-1], far * ((left if backwards else right) - (begin if backwards else end)[-1]), landing_mm),
    )
    return _to_and_fro(lines, block_mm, ways)


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


def normals(points_mm: FloatArray) -> FloatArray:
    """(n, 3) unit surface normals of a flat part at its points (n, 3): +z."""
    return np.tile(np.array(NORMAL), (len(points_mm), 1))


def _check(first: float, step: float, block: float, *others: float) -> None:
    if not (min(first, step, block) > 0 and np.isfinite([first, step, block, *others]).all()):
        raise ValueError("radius, pitch, step and block must be positive lengths")
    if min(others) < 0:
        raise ValueError("overrun, landing and lead-in must not be negative")


def _lead(x: float, y: float, outside: float, lead_in: float) -> float:
    """Length of a way along x from (x, y) outwards that ends at least this far from the origin."""
    return max(lead_in, float(np.sqrt(max(outside**2 - y**2, 0.0))) - x)


def _clear(across: FloatArray, along: FloatArray, landing: float) -> float:
    """Length of a way along x that ends ``landing`` from edges (rows,) this far across and ahead of its start."""
    near = np.sqrt(np.maximum(landing**2 - across**2, 0.0))
    return max(0.0, float(np.where(np.abs(across) < landing, along + near, 0.0).max()))


def _to_and_fro(lines: FloatArray, block: float, ways: tuple[float, float]) -> FloatArray:
    """Lines (y, left end, right end), odd ones back, joined by turns along y at the outer end of each pair."""
    (y, left, right), (way_in, way_out) = lines, ways
    corners = [(left[0] - way_in, y[0])]
    for k in range(len(y)):
        forth, last = k % 2 == 0, k == len(y) - 1
        if last:
            x = right[k] + way_out if forth else left[k] - way_out
        else:
            x = max(right[k], right[k + 1]) if forth else min(left[k], left[k + 1])
            corners.append((x, y[k]))
        corners.append((x, y[k] if last else y[k + 1]))
    return _cut(np.array(corners), block)


def _cut(corners: FloatArray, block: float) -> FloatArray:
    """The polyline's corners with equal blocks of about this length between them."""
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    parts = np.maximum(np.rint(length / block).astype(int), 1)
    stretch = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[stretch]
    plane = corners[stretch] + share[:, None] * np.diff(corners, axis=0)[stretch]
    plane = np.vstack([plane, corners[-1]])
    return np.column_stack([plane, np.zeros(len(plane))])
