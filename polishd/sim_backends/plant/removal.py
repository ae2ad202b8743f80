"""The plant's own removal law: Hertz's contact and Preston's equation with the true values at each moment.

Units: mm, N, MPa, s, rad; removal in nm. Deflection of the robot, and the depth lost by it: `giving`.

Speeds are signed: positive turns counterclockwise, seen from above the part. Pressure times sliding speed is the same
in both directions, as the feed is far below the spin and omitted. A reversed spindle slides the other way, which
mirrors a spot across the plane of its normal and axis: ``skew``, friction's drag and a measured spot change sides. The
viscous shift of the pressure (paper eq. 29, 1 um), which changes sides too, is omitted here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from polishd.config.simulator import CLOSEST
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray, Grid

CHUNK = 192
"""Steps worn at once: enough to hide Python's overhead between two arrays, and few enough for the cache."""
NODES, WEIGHTS = (0.5 + 0.5 * np.polynomial.legendre.leggauss(3)[0], 0.5 * np.polynomial.legendre.leggauss(3)[1])
"""Of lines through a cell: with three a cell is right to 0.4 % of the peak, at its rim."""


def plane_strain_modulus_mpa(tool: ToolProcess) -> float:
    """E* of the pair."""
    soft = (1.0 - tool.tool_poisson**2) / tool.tool_modulus_mpa
    hard = (1.0 - tool.part_poisson**2) / tool.part_modulus_mpa
    return 1.0 / (soft + hard)


def contact_radius_mm(tool: ToolProcess, curvature_per_mm: FloatArray) -> FloatArray:
    """(n,) radius of the sphere that presses on a flat as the bonnet does on a part so curved, positive where concave.

    For two different curvatures the mean is taken: the contact is an ellipse of nearly that area.
    """
    own = 1.0 / tool.tool_radius_mm
    return np.asarray(1.0 / (own - np.minimum(curvature_per_mm, CLOSEST * own)))


def hertz_depth_mm(tool: ToolProcess, force_n: FloatArray, radius_mm: FloatArray | None = None) -> FloatArray:
    """Indentation of the bonnet under a force, (n,); ``radius_mm`` (n,) of the contact; omitted: on a flat."""
    radius = tool.tool_radius_mm if radius_mm is None else radius_mm
    stiff = 4.0 / 3.0 * plane_strain_modulus_mpa(tool) * np.sqrt(radius)
    return np.asarray((np.maximum(force_n, 0.0) / stiff) ** (2.0 / 3.0))


def worn_depth_mm(
    tool: ToolProcess,
    force_n: FloatArray,
    axis: FloatArray,
    compliance: FloatArray,
    radius_mm: FloatArray | None = None,
) -> FloatArray:
    """Depth that is left after the robot's deflection: gamma d, gamma = 1 - c F / (d cos(dip)), (n,); 0 at worst.

    ``axis`` (n, 3) in a frame whose z is the surface normal.
    """
    cosine = np.maximum(axis[:, 2], 1e-3)
    depth = hertz_depth_mm(tool, force_n if tool.normal_force == "axial" else force_n / cosine, radius_mm)
    lost = compliance * force_n / cosine
    return np.asarray(np.maximum(depth - lost, 0.0))


def wear(
    surface_nm: FloatArray,
    grid: Grid,
    tool: ToolProcess,
    *,
    centre_mm: FloatArray,
    axis: FloatArray,
    depth_mm: FloatArray,
    rpm: FloatArray,
    seconds: FloatArray,
    radius_mm: FloatArray | None = None,
    stretch: FloatArray | None = None,
    skew: float = 0.0,
) -> None:
    """Take material off ``surface_nm`` in place: n contacts at ``centre_mm`` (n, 2) for ``seconds`` (n,) each.

    ``seconds`` contains the rate factor too. ``rpm`` is signed. ``radius_mm`` (n,) is that of the contact, and
    ``stretch`` (n, 2, 2) turns offsets in x and y into those along the surface, the frame of ``axis``; omitted: as on a
    flat. ``skew`` is the relative excess of removal at the rim towards which the bonnet slides. Cell averages, by three
    lines through each cell.
    """
    n = len(centre_mm)
    radius = np.full(n, tool.tool_radius_mm) if radius_mm is None else radius_mm
    along = np.tile(np.eye(2), (n, 1, 1)) if stretch is None else stretch
    active = (depth_mm > 0.0) & (seconds > 0.0) & (rpm != 0.0)
    index = np.flatnonzero(active)
    for start in range(0, len(index), CHUNK):
        take = index[start : start + CHUNK]
        _wear_chunk(
            surface_nm,
            grid,
            tool,
            centre_mm=centre_mm[take],
            axis=axis[take],
            depth_mm=depth_mm[take],
            turns=rpm[take] * seconds[take],
            radius_mm=radius[take],
            stretch=along[take],
            skew=skew,
        )


def _wear_chunk(
    surface_nm: FloatArray,
    grid: Grid,
    tool: ToolProcess,
    *,
    centre_mm: FloatArray,
    axis: FloatArray,
    depth_mm: FloatArray,
    turns: FloatArray,
    radius_mm: FloatArray,
    stretch: FloatArray,
    skew: float,
) -> None:
    pitch = grid.pitch_mm
    reach = math.sqrt(float((radius_mm * depth_mm).max())) / pitch
    cells = math.floor(2.0 * reach) + 2  # that a length of twice the reach can touch
    first_col = np.floor((centre_mm[:, 0] - grid.x_mm[0]) / pitch - reach + 0.5).astype(np.int64)
    first_row = np.floor((grid.y_mm[0] - centre_mm[:, 1]) / pitch - reach + 0.5).astype(np.int64)
    edges = (np.arange(cells + 1) - 0.5) * pitch
    x = (grid.x_mm[0] + first_col * pitch - centre_mm[:, 0])[:, None] + edges
    y = (grid.y_mm[0] - first_row * pitch - centre_mm[:, 1])[:, None] - edges
    ellipse = _Ellipse.of(tool, depth_mm, radius_mm, stretch)
    # lines that end where the contact does: across its rim the rate is no polynomial
    inside_y = np.clip(y, -ellipse.top_mm, ellipse.top_mm)
    high = np.maximum(inside_y[:, :-1] - inside_y[:, 1:], 0.0)
    lines = inside_y[:, 1:, None] + high[:, :, None] * NODES
    skewed = skew * sliding(axis, turns) / np.sqrt(radius_mm * depth_mm)[:, None]
    rate = _rate(
        x, lines.reshape(len(x), -1), ellipse, axis=axis, down_mm=depth_mm - tool.tool_radius_mm, skewed=skewed
    )
    # preston cm^2/N = 100 mm^2/N; 1e6 nm/mm; rpm * s = 60 turns, one turn = 2 pi rad
    turned = (tool.preston_cm2_per_n * 100.0 * 1e6 * math.tau / 60.0 / pitch**2) * np.abs(turns)[:, None, None]
    mean = np.einsum("nrjc,nrj->nrc", rate.reshape(*lines.shape, cells), high[:, :, None] * turned * WEIGHTS)
    rows = (first_row[:, None] + np.arange(cells))[:, :, None]
    cols = (first_col[:, None] + np.arange(cells))[:, None, :]
    inside = (rows >= 0) & (rows < grid.ny) & (cols >= 0) & (cols < grid.nx)
    flat = np.where(inside, rows * grid.nx + cols, 0)
    np.subtract.at(surface_nm.reshape(-1), flat.ravel(), np.where(inside, mean, 0.0).ravel())


@dataclass(frozen=True, slots=True)
class _Ellipse:
    """n contacts seen along the part's z; each (n, 1), or (n, 1, 1) where lines cross it."""

    peak_mpa: FloatArray
    """Half of the pressure at its center."""
    stretch: tuple[FloatArray, ...]
    """(ux, uy, vx, vy): along the surface is ``(ux x + uy y, vx x + vy y)``."""
    across: FloatArray
    """``1 - pressure^2`` is ``across (x + shear y)^2 + (y / top)^2``."""
    shear: FloatArray
    top_mm: FloatArray
    """Its largest y."""

    @classmethod
    def of(cls, tool: ToolProcess, depth_mm: FloatArray, radius_mm: FloatArray, stretch: FloatArray) -> _Ellipse:
        """``stretch`` (n, 2, 2)."""
        ux, uy, vx, vy = (stretch[:, i, j, None, None] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
        square = (radius_mm * depth_mm)[:, None, None]
        across = (ux**2 + vx**2) / square
        shear = (ux * uy + vx * vy) / square / across
        top = 1.0 / np.sqrt((uy**2 + vy**2) / square - across * shear**2)
        peak = plane_strain_modulus_mpa(tool) / math.pi * np.sqrt(depth_mm / radius_mm)
        return cls(peak[:, None, None], (ux, uy, vx, vy), across, shear, top[:, :, 0])


def _rate(
    x: FloatArray, y: FloatArray, ellipse: _Ellipse, *, axis: FloatArray, down_mm: FloatArray, skewed: FloatArray
) -> FloatArray:
    """Pressure times sliding speed for an angular speed of 1 between neighbors of x, MPa mm^2, (n, lines, x - 1).

    ``x`` (n, x) and ``y`` (n, lines) are offsets from the contact, ``down_mm`` (n,) the height of its center over the
    bonnet's own, ``skewed`` (n, 2) the growth of the rate along them. The pressure is integrated exactly along each
    line; the speed is taken at the center of pressure. A pass spends nearly all its time here, in few array operations.
    """
    line = y[:, :, None]
    chord = np.maximum(1.0 - (line / ellipse.top_mm[:, :, None]) ** 2, 1e-12)
    half = np.sqrt(chord / ellipse.across)
    moved = ellipse.shear * line
    share = x[:, None, :] / half
    share += moved / half
    np.clip(share, -1.0, 1.0, out=share)
    left = 1.0 - share * share
    root = np.sqrt(left)
    left *= root
    root *= share
    root += np.arcsin(share)
    pressure = root[:, :, 1:] - root[:, :, :-1]
    middle = left[:, :, :-1] - left[:, :, 1:]
    middle /= np.maximum(pressure, 1e-300)
    middle *= half * (2.0 / 3.0)
    middle -= moved
    (ux, uy, vx, vy), down = ellipse.stretch, down_mm[:, None, None]
    a, b, c = (axis[:, k, None, None] for k in range(3))
    # sliding, of the part's turned frame, is (x0 + x1 middle, y0 + y1 middle)
    x0, x1, y0, y1 = b * down - c * vy * line, -c * vx, c * uy * line - a * down, c * ux
    square = (x1**2 + y1**2) * middle
    square += 2.0 * (x0 * x1 + y0 * y1)
    square *= middle
    square += x0**2 + y0**2
    pressure *= np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    pressure *= chord / np.sqrt(ellipse.across) * ellipse.peak_mpa
    if skewed.any():
        u, v = ux * middle + uy * line, vx * middle + vy * line
        pressure *= 1.0 + skewed[:, 0:1, None] * u + skewed[:, 1:2, None] * v
    return pressure


def sliding(axis: FloatArray, speed: FloatArray) -> FloatArray:
    """(n, 2) unit directions in which the bonnet slides at the center of its contact; 0 where its axis is the normal.

    ``axis`` (n, 3) where the normal is z. Only the sign of ``speed`` (n,) matters: positive turns counterclockwise,
    seen from above.
    """
    lean = np.hypot(axis[:, 0], axis[:, 1])[:, None]
    way = np.sign(speed)[:, None] * np.column_stack([-axis[:, 1], axis[:, 0]])
    return np.asarray(np.divide(way, lean, out=np.zeros((len(axis), 2)), where=lean > 0.0))


# A measured spot, as the plant removes with it: turned with the spindle, scaled as Hertz's contact is.

TOGETHER_MM = 0.1
"""Contacts nearer to each other than this are one: a map resolves no less."""
FINE_MM = 1.0 / 6.0
"""Largest distance between the points of a cell's mean; at least two of them along each of its sides."""


@dataclass(frozen=True, slots=True)
class MeasuredStamp:
    """The TIF, and the contact in which it was measured: that of ``tool`` with its force, speed and dip."""

    tif: MeasuredTif
    tool: ToolProcess
    _half_mm: float = field(init=False)
    """From its center to its farthest corner."""
    _depth_mm: float = field(init=False)
    """Contact of that measurement."""

    def __post_init__(self) -> None:
        """Size and depth."""
        half = math.hypot(*self.tif.rate_nm_s.shape) * self.tif.pitch_mm / 2.0
        dip = 1.0 if self.tool.normal_force == "axial" else math.cos(math.radians(self.tool.dip_deg))
        rigid = hertz_depth_mm(self.tool, np.array([self.tool.force_n / dip]))
        object.__setattr__(self, "_half_mm", half)
        object.__setattr__(self, "_depth_mm", float(rigid[0]) * self.tif.depth_ratio)

    def wear(
        self,
        surface_nm: FloatArray,
        grid: Grid,
        *,
        centre_mm: FloatArray,
        axis: FloatArray,
        depth_mm: FloatArray,
        turns: FloatArray,
        stretch: FloatArray,
        skew: float = 0.0,
    ) -> None:
        """Take material off in place: n contacts, rpm times seconds in ``turns`` (n,); the rest as `removal.wear`.

        The spot was measured with ``tool.rpm``, which is positive: a reversed spindle removes with its mirror image.
        """
        active = (depth_mm > 0.0) & (turns != 0.0)
        if not active.any():
            return
        first, weight = _together(centre_mm[active], turns[active])
        shares = (_mean(values[active], first, weight) for values in (centre_mm, axis, depth_mm, stretch))
        centre_mm, axis, depth_mm, stretch = shares
        turns = np.add.reduceat(weight, first) * np.sign(turns[active][first])
        for k in range(len(first)):
            size = math.sqrt(float(depth_mm[k]) / self._depth_mm)
            reach = self._half_mm * size / grid.pitch_mm
            column = (centre_mm[k, 0] - grid.x_mm[0]) / grid.pitch_mm
            row = (grid.y_mm[0] - centre_mm[k, 1]) / grid.pitch_mm
            rows = _span(row, reach, grid.ny)
            columns = _span(column, reach, grid.nx)
            if rows.size and columns.size:
                fine = max(2, math.ceil(grid.pitch_mm / FINE_MM))
                x = _midpoints(columns - column, fine) * grid.pitch_mm
                y = _midpoints(row - rows, fine) * grid.pitch_mm
                offset = np.stack(np.meshgrid(x, y))
                along = np.einsum("ij,jyx->iyx", stretch[k], offset)
                seen = along if turns[k] > 0.0 else _mirrored(along, axis[k])
                rate = self._rate(seen / size, axis[k]) * size
                if skew:
                    rim = math.sqrt(self.tool.tool_radius_mm * float(depth_mm[k]))
                    way = sliding(axis[k : k + 1], turns[k : k + 1])[0]
                    rate *= 1.0 + skew * np.einsum("i,iyx->yx", way, along) / rim
                mean = rate.reshape(rows.size, fine, columns.size, fine).mean(axis=(1, 3))
                surface_nm[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] -= mean * (
                    abs(float(turns[k])) / self.tool.rpm
                )

    def _rate(self, offset_mm: FloatArray, axis: FloatArray) -> FloatArray:
        """nm/s at offsets (2, ny, nx) along the surface, for a spindle with that ``axis`` (3,)."""
        turn = math.atan2(axis[1], axis[0]) - math.radians(self.tif.azimuth_deg) if self.tif.rotates else 0.0
        x = math.cos(turn) * offset_mm[0] + math.sin(turn) * offset_mm[1]
        y = math.cos(turn) * offset_mm[1] - math.sin(turn) * offset_mm[0]
        ny, nx = self.tif.rate_nm_s.shape
        at = np.stack([(ny - 1) / 2.0 - y / self.tif.pitch_mm, (nx - 1) / 2.0 + x / self.tif.pitch_mm])
        return np.asarray(ndimage.map_coordinates(self.tif.rate_nm_s, at, order=1, mode="constant"))


def _mirrored(offset_mm: FloatArray, axis: FloatArray) -> FloatArray:
    """Mirror offsets (2, ny, nx) across the lean of an axis (3,); unchanged for an axis without lean."""
    lean = math.hypot(axis[0], axis[1])
    if lean == 0.0:
        return offset_mm
    x, y = axis[0] / lean, axis[1] / lean
    return np.asarray(2.0 * np.multiply.outer([x, y], x * offset_mm[0] + y * offset_mm[1]) - offset_mm)


def _together(centre_mm: FloatArray, turns: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Start of each group of successive contacts within `TOGETHER_MM`, and the weight of each contact (n,).

    All contacts of a group turn the same way.
    """
    apart = np.hypot(*np.diff(centre_mm, axis=0).T) + TOGETHER_MM * (np.diff(np.sign(turns)) != 0.0)
    way = np.concatenate([[0.0], np.cumsum(apart)])
    return np.unique(np.floor(way / TOGETHER_MM), return_index=True)[1], np.abs(turns)


def _mean(values: FloatArray, first: np.ndarray, weight: FloatArray) -> FloatArray:
    """(groups, ...) weighted means of (n, ...)."""
    wide = weight.reshape(-1, *[1] * (values.ndim - 1))
    total = np.add.reduceat(weight, first).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values * wide, first, axis=0) / total)


def _span(middle: float, reach: float, count: int) -> np.ndarray:
    """Cells of an axis that a spot there touches."""
    return np.arange(max(math.floor(middle - reach), 0), min(math.ceil(middle + reach), count - 1) + 1)


def _midpoints(cells: FloatArray, fine: int) -> FloatArray:
    """(n fine,) of n cells, in cells, in the cells' own direction."""
    step = np.sign(cells[-1] - cells[0]) if len(cells) > 1 else 1.0
    return np.asarray((cells[:, None] + step * ((np.arange(fine) + 0.5) / fine - 0.5)).ravel())
