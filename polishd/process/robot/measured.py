"""Compliance of a cell that was only loaded and measured: a table of places, linear between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredCompliance
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where, require_vectors

FLAT_MM = 1.0
"""A table that is not thicker than this either way is flat, and holds for points as near to it."""

_SAME_MM = 1e-6
_RIM = 1e-9
"""How far beyond its simplex, in parts of it, a point still belongs to it."""


@dataclass(frozen=True, slots=True)
class _Table:
    """The places in their own dimension."""

    centre_mm: FloatArray
    """(3,)."""
    along: FloatArray
    """(dim, 3) directions in which the table extends."""
    local_mm: FloatArray
    """(m, dim) the places in these directions, sorted along a line."""
    value: FloatArray
    """(m,) compliance, mm/N."""

    def off_mm(self, tip: FloatArray) -> FloatArray:
        """(n,) distance of (n, 3) points from the line, the plane or the space that the table lies in."""
        arm = tip - self.centre_mm
        return np.asarray(np.linalg.norm(arm - arm @ self.along.T @ self.along, axis=1), dtype=np.float64)

    def interpolate(self, tip: FloatArray) -> FloatArray:
        """(n,) compliance, mm/N; NaN outside of the hull."""
        local = (tip - self.centre_mm) @ self.along.T
        if len(self.along) == 1:
            place, ends = self.local_mm[:, 0], self.local_mm[[0, -1], 0]
            inside = (local[:, 0] >= ends[0] - _SAME_MM) & (local[:, 0] <= ends[1] + _SAME_MM)
            return np.where(inside, np.interp(local[:, 0], place, self.value), np.nan)
        mesh = scipy.spatial.Delaunay(self.local_mm)
        simplex = mesh.find_simplex(local, tol=_RIM)
        affine = mesh.transform[simplex]
        weight = np.einsum("nij,nj->ni", affine[:, :-1], local - affine[:, -1])
        weight = np.column_stack([weight, 1.0 - weight.sum(axis=1)])
        value = (weight * self.value[mesh.simplices[simplex]]).sum(axis=1)
        return np.where(simplex >= 0, value, np.nan)


def measured_compliance(table: MeasuredCompliance, tip_mm: FloatArray) -> FloatArray:
    """(n,) equivalent compliance, mm/N, at (n, 3) tool tips, mm, linear between the places of the table.

    Linear on the simplices of the places' Delaunay triangulation, in three dimensions, or in the plane or on the line
    that the places lie in. Raises ComputeError for a table that cannot be one, and for the first point that is more
    than 1 mm off the table's plane or line, or outside of its hull.
    """
    known = _require_table(table)
    tip = require_vectors("tool tip", tip_mm, "mm")
    off, kind = known.off_mm(tip), ("", "line", "plane", "space")[len(known.along)]
    source = f"the table {table.source}".rstrip()
    refuse_where(off > FLAT_MM, off, f"the tool tip's distance from the {kind} of {source}", "mm", "at most 1 mm")
    value = known.interpolate(tip)
    nearest = scipy.spatial.cKDTree(table.tip_mm).query(tip)[0]
    what = "the tool tip's distance from the nearest place measured"
    refuse_where(np.isnan(value), nearest, what, "mm", f"and it is outside of the hull of {source}: not extrapolated")
    return value


def measured_reachable(table: MeasuredCompliance, tip_mm: FloatArray) -> BoolArray:
    """(n,) True where `measured_compliance` would accept the point; arguments as there."""
    known = _require_table(table)
    tip = require_vectors("tool tip", tip_mm, "mm")
    return np.asarray((known.off_mm(tip) <= FLAT_MM) & ~np.isnan(known.interpolate(tip)), dtype=np.bool_)


def _require_table(table: MeasuredCompliance) -> _Table:
    """The table in its own dimension; raise ComputeError where it cannot be one."""
    tip = require_vectors("place measured", table.tip_mm, "mm")
    value = np.asarray(table.compliance_um_per_n, dtype=np.float64)
    if value.shape != (len(tip),):
        raise ComputeError(f"the table has {len(tip)} places and compliances of the shape {value.shape}")
    wrong = ~(np.isfinite(value) & (value > 0))
    refuse_where(wrong, value, "the compliance measured", "um/N", "it must be finite and above 0")
    if len(tip) < 2:
        raise ComputeError(f"the table {table.source} has {len(tip)} places: at least 2 are needed")
    centre = tip.mean(axis=0)
    directions = np.linalg.svd(tip - centre, full_matrices=False)[2]
    extent = np.ptp((tip - centre) @ directions.T, axis=0)
    along = directions[extent > FLAT_MM]
    if not len(along):
        says = f"extends over {extent.max():.3g} mm, it must be above {FLAT_MM:g} mm"
        raise ComputeError(f"the table {table.source} {says}")
    local = (tip - centre) @ along.T
    _refuse_contradictions(local, value)
    order = np.argsort(local[:, 0])
    return _Table(centre, along, local[order], value[order] * 1e-3)


def _refuse_contradictions(place: FloatArray, value: FloatArray) -> None:
    """Raise ComputeError for the first place that was measured before, with another compliance."""
    earlier, later = scipy.spatial.cKDTree(place).query_pairs(_SAME_MM, output_type="ndarray").T
    differ = np.zeros(len(place), dtype=np.bool_)
    differ[later] = np.abs(value[later] - value[earlier]) > 1e-9 * value[later]
    refuse_where(differ, value, "the compliance of a place that was measured before", "um/N", "and differs from then")
