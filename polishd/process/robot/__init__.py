"""The 3UPS-UP + C/A hybrid robot: kinematics and compliance (paper section II-B). Of polishd it imports only model."""

from polishd.process.robot.compliance import platform_stiffness, tip_compliance, tip_compliance_mm_per_n
from polishd.process.robot.kinematics import Pose, forward_kinematics, inverse_kinematics, limb_lengths_mm, reachable

__all__ = [
    "Pose",
    "forward_kinematics",
    "inverse_kinematics",
    "limb_lengths_mm",
    "platform_stiffness",
    "reachable",
    "tip_compliance",
    "tip_compliance_mm_per_n",
]
