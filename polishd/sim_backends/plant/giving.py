"""How far the robot gives way under the tool: its own mechanics, or a table of what was measured.

What of that is lost as depth is a matter of statics. A robot of compliance C is pushed back by the normal force N, and
the actuator between robot and tool extends by s. What the bonnet is pressed in less is what the actuator does not take
up: ``lost = b'C b N - s``, b the normal. Its spring of stiffness k_s (guide, hoses, a force constant that falls off
along the stroke) takes from the force what it extends by, and the bonnet gives that back with its own contact stiffness
k = dF/dd = 2 E* sqrt(R d): ``k lost = k_s s``. So ``lost = b'C b N k_s / (k_s + k)``: two springs in parallel.

- Free, k_s = 0: nothing is lost. The depth is constant.
- Friction f in the guide holds it as if it were locked until ``k lost = f``.
- Locked: all is lost, which is ``projection = "normal"`` with a share of 1.

Paper eq. 44 with eq. 43 ("linear") loses more than a locked actuator would: `Effects.eq_44` is a share of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from polishd.model.process import Projection
from polishd.model.robot import HybridRobot, MeasuredCompliance, RobotModel, SerialRobot
from polishd.model.surface import FloatArray
from polishd.sim_backends.mechanics import tip_gives_mm_per_n

THIN_MM = 1.0
"""A table that is not thicker than this one way has no extent there."""


@dataclass(frozen=True, slots=True)
class TipDeflection:
    """By how much the tip gives way at n places, mm/N; 0 where the robot cannot be."""

    along: FloatArray
    """(n,) equivalent, along the normal."""
    matrix: FloatArray
    """(n, 3, 3) base frame; 0 where only the other was measured."""


Giving = Callable[[FloatArray, FloatArray, FloatArray], TipDeflection]
"""Tips (n, 3) mm, tool axes (n, 3) and normals (n, 3), base frame."""


def giving(robot: RobotModel, projection: Projection) -> Giving:
    """Of that robot. Where a table has nothing it gives as at the nearest place; where a model cannot be: 0."""
    if isinstance(robot, MeasuredCompliance):
        table = _by_table(robot)
        return lambda tip, _axis, _normal: TipDeflection(table(tip), np.zeros((len(tip), 3, 3)))
    return lambda tip, axis, normal: given_way(robot, tip, axis, normal, projection)


def given_way(
    robot: HybridRobot | SerialRobot,
    tip_mm: FloatArray,
    axis: FloatArray,
    normal: FloatArray,
    projection: Projection = "linear",
) -> TipDeflection:
    """Of a robot with mechanics; its compliance along the surface normal is the equivalent one of paper eq. 43.

    ``tip_mm``, ``axis`` (n, 3) and ``normal`` (3,) or (n, 3) in the base frame. The eigenvector nearest the tool axis
    is left out: the voice coil gives way along it; but for ``normal``, what a loading test along the normal measures.
    """
    can, matrix = tip_gives_mm_per_n(robot, tip_mm, axis)
    normal = np.broadcast_to(normal, tip_mm.shape)
    if projection == "normal":
        return TipDeflection(np.einsum("ni,nij,nj->n", normal, matrix, normal, optimize=True), matrix)
    values, vectors = np.linalg.eigh(matrix)
    nearest = np.argmax(np.abs(np.einsum("nik,ni->nk", vectors, axis)), axis=1)
    shown = np.abs(np.einsum("nik,ni->nk", vectors, normal))
    share = values * (shown if projection == "linear" else shown**2)
    share[np.arange(len(share)), nearest] = 0.0
    return TipDeflection(np.where(can, share.sum(axis=1), 0.0), matrix)


def _by_table(table: MeasuredCompliance) -> Callable[[FloatArray], FloatArray]:
    """Linear between the places, in as many dimensions as they extend; beyond them as the nearest."""
    centre = table.tip_mm.mean(axis=0)
    directions = np.linalg.svd(table.tip_mm - centre, full_matrices=False)[2]
    along = directions[np.ptp((table.tip_mm - centre) @ directions.T, axis=0) > THIN_MM]
    place, value = (table.tip_mm - centre) @ along.T, table.compliance_um_per_n * 1e-3
    nearest = NearestNDInterpolator(place, value)
    if len(along) == 1:
        order = np.argsort(place[:, 0])
        return lambda tip: np.interp((tip - centre) @ along[0], place[order, 0], value[order])
    between = LinearNDInterpolator(place, value)

    def at(tip: FloatArray) -> FloatArray:
        where = (tip - centre) @ along.T
        found = between(where)
        return np.asarray(np.where(np.isnan(found), nearest(where), found))

    return at
