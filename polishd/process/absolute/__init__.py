"""The instrument's own error and the part's, told apart by turning and shifting the part between maps."""

from __future__ import annotations

from polishd.process.absolute.design import Design, Unknown, design
from polishd.process.absolute.next_poses import NextPoses, PoseOptions, next_poses
from polishd.process.absolute.poses import Pose
from polishd.process.absolute.separate import Separated, separate
from polishd.process.absolute.solution import PlaceError
from polishd.process.absolute.told import SystemMap, Told

__all__ = [
    "Design",
    "NextPoses",
    "PlaceError",
    "Pose",
    "PoseOptions",
    "Separated",
    "SystemMap",
    "Told",
    "Unknown",
    "design",
    "next_poses",
    "separate",
]
