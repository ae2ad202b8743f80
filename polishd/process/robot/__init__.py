"""Robots that carry the tool: kinematics and compliance (paper section II-B). Of polishd it imports only model."""

from polishd.process.robot.interface import reachable, tip_compliance_mm_per_n
from polishd.process.robot.kinematics import Pose, forward_kinematics, inverse_kinematics
from polishd.process.robot.measured import measured_compliance
from polishd.process.robot.stiffness import platform_stiffness, tip_compliance

__all__ = [
    "Pose",
    "forward_kinematics",
    "inverse_kinematics",
    "measured_compliance",
    "platform_stiffness",
    "reachable",
    "tip_compliance",
    "tip_compliance_mm_per_n",
]
