"""Robots that carry the tool: kinematics and compliance (paper section II-B). Of polishd it imports only model."""

from polishd.process.robot.interface import reachable, tip_compliance_mm_per_n
from polishd.process.robot.measured import measured_compliance

__all__ = ["measured_compliance", "reachable", "tip_compliance_mm_per_n"]
