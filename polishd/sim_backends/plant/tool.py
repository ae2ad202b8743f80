"""The tool on the part: contact position, depth and removal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from polishd.config.simulator import SimConfig
from polishd.model.process import HybridRobot, MeasuredCompliance, Projection, RobotModel, SerialRobot, ToolProcess
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.hidden_truth import Frames
from polishd.sim_backends.common.mechanics import tip_gives_mm_per_n
from polishd.sim_backends.plant.effects import PlantEffects
from polishd.sim_backends.plant.part import Local, TruePart
from polishd.sim_backends.plant.removal import (
    MeasuredStamp,
    contact_radius_mm,
    hertz_depth_mm,
    sliding,
    wear,
    worn_depth_mm,
)

# Deflection of the robot under the tool: its own mechanics, or a table of measured values.

THIN_MM = 1.0
"""A table that is not thicker than this in one direction has no extent there."""


@dataclass(frozen=True, slots=True)
class TipDeflection:
    """Deflection of the tip at n points, mm/N; 0 out of reach."""

    along: FloatArray
    """(n,) equivalent, along the normal."""
    matrix: FloatArray
    """(n, 3, 3) base frame; 0 where only the other value was measured."""


Giving = Callable[[FloatArray, FloatArray, FloatArray], TipDeflection]
"""Tips (n, 3) mm, tool axes (n, 3) and normals (n, 3), base frame."""


def giving(robot: RobotModel, projection: Projection) -> Giving:
    """Return it for that robot. A table without a value uses the nearest point; a model out of reach gives 0."""
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
    """Return it for a robot with mechanics. Along the surface normal it is the equivalent compliance of paper eq. 43.

    ``tip_mm``, ``axis`` (n, 3) and ``normal`` (3,) or (n, 3) in the base frame. The eigenvector nearest the tool axis
    is omitted: the voice coil gives way along it. Only ``normal`` includes it, as a loading test along the normal does.
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
    """Interpolate linearly between the points, in as many dimensions as they extend; beyond them take the nearest."""
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


GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True)
class ContactPoints:
    """n points at which the tool touches the part, in its frame."""

    place_mm: FloatArray
    """(n, 3) the tool's tip."""
    axis: FloatArray
    """(n, 3) from the tip into the spindle."""
    local: Local


@dataclass(frozen=True, slots=True)
class Tool:
    """A bonnet on its robot."""

    process: ToolProcess
    giving: Giving
    stamp: MeasuredStamp | None
    """Its measured removal, where there is one."""
    effects: PlantEffects = field(default_factory=PlantEffects)

    @classmethod
    def of(cls, config: SimConfig, robot: RobotModel, effects: PlantEffects) -> Tool:
        """Build the tool of SIM.toml on the true robot; ConfigError where its TIF cannot be read."""
        process, tif = config.process.tool(), config.measured_tif()
        stamp = None if tif is None else MeasuredStamp(tif, process)
        inflated = replace(process, tool_modulus_mpa=process.tool_modulus_mpa * effects.bonnet)
        return cls(inflated, giving(robot, config.process.projection), stamp, effects)

    def wear(
        self,
        part: TruePart,
        touches: ContactPoints,
        frames: Frames,
        *,
        force_n: FloatArray,
        rpm: FloatArray,
        seconds: FloatArray,
    ) -> None:
        """Take material off the part, in place; ``seconds`` (n,) contain the rate factor; ``rpm`` (n,) is signed."""
        local, off = touches.local, self.effects
        tips, axes = frames.in_base(touches.place_mm, touches.axis)
        axis = _leaning(local.levelled(touches.axis), off.lean.at(tips))
        given = self.giving(tips, axes, local.normal @ frames.to_base.T)
        radius = contact_radius_mm(self.process, local.curvature_per_mm)
        depth = worn_depth_mm(self.process, force_n, axis, given.along * (off.compliance * off.eq_44), radius)
        turned = _turn(-math.radians(off.turn_deg)) @ local.stretch
        centre = touches.place_mm[:, :2] + off.robot.at(tips) + _circling(len(tips)) * off.vibration_mm
        centre = centre + self._offset_mm(axis, turned) - np.array(off.seat_mm)
        if off.friction:
            dragged = self._dragged_mm(given.matrix, ContactPoints(touches.place_mm, axis, local), frames, force_n, rpm)
            centre = centre + np.linalg.solve(local.stretch, dragged[:, :2, None])[:, :, 0]
            depth = np.maximum(depth - off.eq_44 * dragged[:, 2], 0.0)
        at = {"centre_mm": centre, "axis": axis, "depth_mm": depth, "stretch": turned, "skew": off.skew}
        if self.stamp is not None:
            self.stamp.wear(part.height_nm, part.grid, turns=rpm * seconds * off.bonnet, **at)
        else:
            wear(part.height_nm, part.grid, self.process, rpm=rpm, seconds=seconds, radius_mm=radius, **at)

    def stiffness_n_per_mm(self, force_n: FloatArray, curvature_per_mm: FloatArray) -> FloatArray:
        """(n,) of the contact under forces (n,) on a part so curved: Hertz's dF/dd, 1.5 F over the depth."""
        depth = hertz_depth_mm(self.process, force_n, contact_radius_mm(self.process, curvature_per_mm))
        return np.asarray(1.5 * force_n / np.maximum(depth, 1e-9))

    def _dragged_mm(
        self, matrix: FloatArray, at: ContactPoints, frames: Frames, force_n: FloatArray, rpm: FloatArray
    ) -> FloatArray:
        """(n, 3) pull of friction on the tip along the surface and off it, where the normal is z.

        It acts against the sliding direction of the bonnet, and grows with the normal force. The sideways motion by the
        normal force itself is the same everywhere, and the tool setup removes it. ``at.axis`` is levelled.
        """
        against = at.local.raised(-sliding(at.axis, rpm)) @ frames.to_base.T
        pull_n = self.effects.friction * self.effects.compliance * force_n / np.maximum(at.axis[:, 2], 1e-3)
        moved = np.einsum("nij,nj->ni", matrix, against) * pull_n[:, None]
        return at.local.levelled(moved @ frames.to_base)

    def _offset_mm(self, axis: FloatArray, turned: FloatArray) -> FloatArray:
        """(n, 2) from the tool's tip to the spot's centre, in the part's x and y; ``turned`` (n, 2, 2) as stretch."""
        off = self.effects
        on_tool = (0.0, 0.0) if off.spot_on_part else off.spot_mm
        across, along = np.add(self.process.spot_offset_mm, on_tool)
        lean = axis[:, :2] / np.maximum(np.hypot(axis[:, 0], axis[:, 1]), 1e-12)[:, None]
        offset = across * np.column_stack([lean[:, 1], -lean[:, 0]]) + along * lean
        on_part = np.array(off.spot_mm if off.spot_on_part else (0.0, 0.0))
        return np.asarray(np.linalg.solve(turned, offset[:, :, None])[:, :, 0] + on_part)


def _leaning(axis: FloatArray, by: FloatArray) -> FloatArray:
    """(n, 3) axes, more (n, 2) radians to x and y."""
    if not by.any():
        return axis
    leaning = axis.copy()
    leaning[:, :2] += by
    return np.asarray(leaning / np.linalg.norm(leaning, axis=1)[:, None])


def _turn(radians: float) -> FloatArray:
    c, s = math.cos(radians), math.sin(radians)
    return np.array([[c, -s], [s, c]])


def _circling(count: int) -> FloatArray:
    """(n, 2) points of the unit circle, evenly all round: of a tip much faster than the path."""
    angle = GOLDEN * np.arange(count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


# The true force behind the actuator's: a damped coil on a springy contact; the part may go and come back.

TOGETHER_S = 1e-3
"""Process time between contacts beyond which the tool has lifted and lands again."""


@dataclass(slots=True)
class ForceDynamics:
    """The force between tool and part, continued from contact to contact."""

    lag_s: float
    """tau, process time."""
    friction_n: float = 0.0
    """f."""
    _force_n: float = 0.0
    """Of the contact and of the friction, together."""
    _held_n: float = 0.0
    """Caused by the friction, positive where it takes from the contact."""
    _gap_mm: float = 0.0
    _middle_s: float = 0.0
    _until_s: float = -math.inf

    def lift(self) -> None:
        """The tool leaves the part: the next contact is a landing."""
        self._until_s = -math.inf

    def truly(
        self, force_n: FloatArray, *, begin_s: FloatArray, lasts_s: FloatArray, gap_mm: FloatArray, stiff: FloatArray
    ) -> FloatArray:
        """(n,) mean forces of contacts in which the coil exerts ``force_n``; 0 at least.

        ``begin_s``, ``lasts_s`` process time; ``gap_mm`` from the part out along the tool to where the robot holds it,
        in the middle of each; ``stiff`` the contact's stiffness, N/mm.
        """
        means = np.empty(len(force_n))
        columns = (force_n, begin_s, lasts_s, gap_mm, stiff)
        for row, (coil, begin, lasts, gap, k) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            middle = begin + lasts / 2.0
            pushed = 0.0
            if begin - self._until_s > TOGETHER_S:
                self._force_n, self._held_n = 0.0, self.friction_n  # it comes out, and is held back
            elif middle > self._middle_s:
                before, way_n = self._held_n, k * (gap - self._gap_mm)
                self._held_n = min(max(before + way_n, -self.friction_n), self.friction_n)
                pushed = self.lag_s * (self._held_n - before - way_n) / (middle - self._middle_s)
            settled = max(coil + pushed, self._held_n)  # nothing pulls
            ratio = lasts / self.lag_s if self.lag_s else math.inf
            behind = (self._force_n - settled) * -math.expm1(-ratio)
            mean = settled + (behind / ratio if ratio > 0.0 else self._force_n - settled)
            means[row] = max(mean - self._held_n, 0.0)
            self._force_n -= behind
            self._gap_mm, self._middle_s, self._until_s = gap, middle, begin + lasts
        return means
