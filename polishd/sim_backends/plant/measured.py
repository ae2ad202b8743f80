"""A spot that was measured, as the plant removes with it: turned with the spindle, scaled as Hertz's contact is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.sim_backends.plant.removal import hertz_depth_mm, sliding

TOGETHER_MM = 0.1
"""Contacts nearer to each other than that are one: a map shows no less."""
FINE_MM = 1.0 / 6.0
"""Between the points of which a cell's mean is made, at most; two of them at least along each of its sides."""


@dataclass(frozen=True, slots=True)
class MeasuredStamp:
    """The TIF, and the contact at which it was measured: that of ``tool`` with its force, speed and dip."""

    tif: MeasuredTif
    tool: ToolProcess
    _half_mm: float = field(init=False)
    """From its centre to its farthest corner."""
    _depth_mm: float = field(init=False)
    """Of the contact there."""

    def __post_init__(self) -> None:
        """How large, and how deep."""
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
        """nm/s at offsets (2, ny, nx) along the surface, for the spindle that leans as ``axis`` (3,) says."""
        turn = math.atan2(axis[1], axis[0]) - math.radians(self.tif.azimuth_deg) if self.tif.rotates else 0.0
        x = math.cos(turn) * offset_mm[0] + math.sin(turn) * offset_mm[1]
        y = math.cos(turn) * offset_mm[1] - math.sin(turn) * offset_mm[0]
        ny, nx = self.tif.rate_nm_s.shape
        at = np.stack([(ny - 1) / 2.0 - y / self.tif.pitch_mm, (nx - 1) / 2.0 + x / self.tif.pitch_mm])
        return np.asarray(ndimage.map_coordinates(self.tif.rate_nm_s, at, order=1, mode="constant"))


def _mirrored(offset_mm: FloatArray, axis: FloatArray) -> FloatArray:
    """Offsets (2, ny, nx) mirrored across where an axis (3,) leans; as they are where it does not."""
    lean = math.hypot(axis[0], axis[1])
    if lean == 0.0:
        return offset_mm
    x, y = axis[0] / lean, axis[1] / lean
    return np.asarray(2.0 * np.multiply.outer([x, y], x * offset_mm[0] + y * offset_mm[1]) - offset_mm)


def _together(centre_mm: FloatArray, turns: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Where each group of contacts begins that follow one another within `TOGETHER_MM`, and the weight of each (n,).

    All of a group turn the same way.
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
