"""Frames: program to part to the robot's base, and the tool axis that A and C mean."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import Plant
from polishd.model.surface import FloatArray


def rotation_z(deg: float) -> FloatArray:
    """Rotation about z."""
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_rpy(rpy_deg: tuple[float, float, float]) -> FloatArray:
    """Intrinsic x-y'-z''."""
    (ca, sa), (cb, sb) = [(math.cos(math.radians(v)), math.sin(math.radians(v))) for v in rpy_deg[:2]]
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    return np.asarray(about_x @ about_y @ rotation_z(rpy_deg[2]))


def tool_axis(a_deg: FloatArray, c_deg: FloatArray) -> FloatArray:
    """(n,) A and C -> (n, 3) tool axis in the program's frame, from the tip into the spindle."""
    a, c = np.radians(a_deg), np.radians(c_deg)
    return np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=1)


@dataclass(frozen=True, slots=True)
class Frames:
    """Where the part and the program lie."""

    plant: Plant
    to_part: FloatArray = field(init=False)
    to_base: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Fix the rotations."""
        object.__setattr__(self, "to_part", rotation_z(self.plant.program_rotation_deg))
        object.__setattr__(self, "to_base", rotation_rpy(self.plant.rotation_rpy_deg))

    def in_part(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 5) X Y Z A C of the program -> tips (n, 3) in mm and tool axes (n, 3), part frame."""
        tips = pose[:, :3] @ self.to_part.T + np.array(self.plant.program_offset_mm)
        return tips, tool_axis(pose[:, 3], pose[:, 4]) @ self.to_part.T

    def in_base(self, tips: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tips and tool axes of the part's frame in the robot's base frame."""
        return tips @ self.to_base.T + np.array(self.plant.origin_mm), axes @ self.to_base.T
