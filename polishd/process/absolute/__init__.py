"""The instrument's own error and the part's, told apart by turning and shifting the part between maps."""

from __future__ import annotations

from polishd.process.absolute.design import Design, UnobservedTerm, design
from polishd.process.absolute.next_poses import NextPoses, PoseOptions, next_poses
from polishd.process.absolute.poses import PartPose
from polishd.process.absolute.separate import AbsoluteSolution, separate
from polishd.process.absolute.solution import PlaceError
from polishd.process.absolute.told import AbsoluteTestResult, SystemMap

__all__ = [
    "Design",
    "NextPoses",
    "PlaceError",
    "PartPose",
    "PoseOptions",
    "AbsoluteSolution",
    "SystemMap",
    "AbsoluteTestResult",
    "UnobservedTerm",
    "design",
    "next_poses",
    "separate",
]
