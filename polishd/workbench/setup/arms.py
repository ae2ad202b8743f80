"""Six-axis arms whose makers publish their Denavit-Hartenberg rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

UR = "Universal Robots, 'DH Parameters for calculations of kinematics and dynamics'"
GIVES_MM_PER_N = 1e-3
"""A joint that nobody has measured lets the tip of the outstretched arm give way by so much: less than any arm does."""
UNKNOWN_N_MM_PER_RAD = 1e9
"""The same of an arm of which not even the rows are known: its reach is taken for 1 m."""


@dataclass(frozen=True, slots=True)
class ArmModel:
    """A maker's arm."""

    title: str
    dh: tuple[tuple[float, float, float, float], ...]
    """Rows ``(a_mm, alpha_deg, d_mm, theta_zero_deg)``, base to flange, the standard convention."""
    home_deg: tuple[float, ...]
    """Joint angles at which the flange looks down, well away from singular poses."""
    turn_deg: float
    """How far each joint turns to either side, deg."""
    source: str

    def keys(self) -> Mapping[str, Any]:
        """What [kinematics] says of it."""
        return {
            "type": "serial",
            "dh": self.dh,
            "joint_limits_deg": ((-self.turn_deg, self.turn_deg),) * len(self.dh),
            "home_deg": self.home_deg,
        }


def as_if_rigid(dh: Sequence[Sequence[float]], tool_length_mm: float) -> tuple[float, ...]:
    """Joint stiffnesses, N mm/rad, of an arm with these rows whose stiffness nobody has measured."""
    reach_mm = sum(math.hypot(row[0], row[2]) for row in dh) + tool_length_mm
    return (float(f"{reach_mm**2 / GIVES_MM_PER_N:.2g}"),) * len(dh)


def _universal_robots(model: str, *lengths_mm: float) -> ArmModel:
    """Its rows from the six lengths in which its arms differ: d1, a2, a3, d4, d5, d6."""
    d1, a2, a3, d4, d5, d6 = lengths_mm
    rows = (
        (0.0, 90.0, d1, 0.0),
        (a2, 0.0, 0.0, 0.0),
        (a3, 0.0, 0.0, 0.0),
        (0.0, 90.0, d4, 0.0),
        (0.0, -90.0, d5, 0.0),
        (0.0, 0.0, d6, 0.0),
    )
    return ArmModel(f"Universal Robots {model}", rows, (0.0, -110.0, 110.0, -90.0, -90.0, 0.0), 360.0, UR)


ARMS: Mapping[str, ArmModel] = {
    "ur5": _universal_robots("UR5", 89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": _universal_robots("UR10", 127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
    "ur5e": _universal_robots("UR5e", 162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "ur10e": _universal_robots("UR10e", 180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur16e": _universal_robots("UR16e", 180.7, -478.4, -360.0, 174.15, 119.85, 116.55),
}
"""By the name that an answer gives. Further arms need a data sheet whose rows are sure."""
