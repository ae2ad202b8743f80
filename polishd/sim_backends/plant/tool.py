"""The tool on the part: where it touches, how deep, and what it takes off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from polishd.config.simulator import SimConfig
from polishd.model.process import ToolProcess
from polishd.model.robot import RobotModel
from polishd.model.surface import FloatArray
from polishd.sim_backends.placement import Frames
from polishd.sim_backends.plant.effects import PlantEffects
from polishd.sim_backends.plant.giving import Giving, giving
from polishd.sim_backends.plant.measured import MeasuredStamp
from polishd.sim_backends.plant.part import TruePart
from polishd.sim_backends.plant.removal import contact_radius_mm, hertz_depth_mm, sliding, wear, worn_depth_mm
from polishd.sim_backends.plant.shape import Local

GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True)
class ContactPoints:
    """n places at which the tool touches the part, in its frame."""

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
    """What it removes, where that was measured."""
    effects: PlantEffects = field(default_factory=PlantEffects)

    @classmethod
    def of(cls, config: SimConfig, robot: RobotModel, effects: PlantEffects) -> Tool:
        """As SIM.toml has it, on the robot as it truly is; ConfigError where its TIF cannot be read."""
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
        """Take material off the part, in place; ``seconds`` (n,) carry the rate factor, too; ``rpm`` (n,) is signed."""
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
        """(n, 3) by which friction pulls the tip along the surface and off it, where the normal is z.

        It acts against the way that the bonnet slides, and grows with the normal force. What the normal force itself
        does to the tip sideways is the same everywhere, and goes away as the tool is set up. ``at.axis`` is levelled.
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
    """(n, 2) places of the unit circle, one after the other all round: of a tip much faster than the path."""
    angle = GOLDEN * np.arange(count)
    return np.column_stack([np.cos(angle), np.sin(angle)])
