"""How far the robot gives way under the tool: a model's compliance, or a table of what was measured."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from polishd.model.process import Projection
from polishd.model.robot import MeasuredCompliance, RobotModel
from polishd.model.surface import FloatArray
from polishd.sim_backends.plant.removal import equivalent_compliance

THIN_MM = 1.0
"""A table that is not thicker than this one way has no extent there."""

Giving = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Tips (n, 3) mm, tool axes (n, 3) and normals (n, 3), base frame: compliance along the normal (n,), mm/N."""


def giving(robot: RobotModel, projection: Projection) -> Giving:
    """Of that robot. Where a table has nothing it gives as at the nearest place; where a model cannot be: 0."""
    if isinstance(robot, MeasuredCompliance):
        return _by_table(robot)
    return lambda tip, axis, normal: equivalent_compliance(robot, tip, axis, normal, projection)


def _by_table(table: MeasuredCompliance) -> Giving:
    """Linear between the places, in as many dimensions as they extend; beyond them as the nearest."""
    centre = table.tip_mm.mean(axis=0)
    directions = np.linalg.svd(table.tip_mm - centre, full_matrices=False)[2]
    along = directions[np.ptp((table.tip_mm - centre) @ directions.T, axis=0) > THIN_MM]
    place, value = (table.tip_mm - centre) @ along.T, table.compliance_um_per_n * 1e-3
    nearest = NearestNDInterpolator(place, value)
    if len(along) == 1:
        order = np.argsort(place[:, 0])
        return lambda tip, _axis, _normal: np.interp((tip - centre) @ along[0], place[order, 0], value[order])
    between = LinearNDInterpolator(place, value)

    def at(tip: FloatArray, _axis: FloatArray, _normal: FloatArray) -> FloatArray:
        where = (tip - centre) @ along.T
        found = between(where)
        return np.asarray(np.where(np.isnan(found), nearest(where), found))

    return at
