"""Six-axis arms whose rows are published, by the name that an answer gives.

Rows come from makers' dimensions: Universal Robots publishes them as rows; of the others, ROS-Industrial and ARTE have
the dimensions of the data sheets. Each was held to the reach that its maker states. The base frame is the controller's.
Angles count about the rows' axes; the source names joints that count the other way at the pendant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Row = tuple[float, float, float, float]
Limits = tuple[tuple[float, float], ...]

GIVES_MM_PER_N = 1e-3
"""Deflection of the outstretched arm's tip by an unmeasured joint: less than that of any arm."""
UNKNOWN_N_MM_PER_RAD = 1e9
"""Joint stiffness of an arm without known rows, for a reach of 1 m."""
UR = "Universal Robots, 'DH Parameters for calculations of kinematics and dynamics'"
ROS_I = "dimensions of the data sheet in {} of ROS-Industrial"
AT_AXIS_2 = "the base frame lies at the height of axis 2, as the controller has it"


@dataclass(frozen=True, slots=True)
class ArmModel:
    """A maker's arm."""

    title: str
    dh: tuple[Row, ...]
    """Rows ``(a_mm, alpha_deg, d_mm, theta_zero_deg)``, base to flange, the standard convention."""
    home_deg: tuple[float, ...]
    """Joint angles at which the flange looks down, well away from singular poses."""
    limits_deg: Limits
    source: str

    def keys(self) -> Mapping[str, Any]:
        """Return its keys of [kinematics]."""
        return {"type": "serial", "dh": self.dh, "joint_limits_deg": self.limits_deg, "home_deg": self.home_deg}


def as_if_rigid(dh: Sequence[Sequence[float]], tool_length_mm: float) -> tuple[float, ...]:
    """Return joint stiffnesses, N mm/rad, of an arm with these rows and unmeasured stiffness."""
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
    return ArmModel(
        f"Universal Robots {model}", rows, (0.0, -110.0, 110.0, -90.0, -90.0, 0.0), ((-360.0, 360.0),) * 6, UR
    )


def _elbow(*lengths_mm: float, d5: float = 0.0, turn_deg: float = 0.0) -> tuple[Row, ...]:
    """Rows of an upright upper arm and a level forearm with all joints at 0, from a1, d1, a2, a3, d4, d6.

    ``turn_deg``: 180 where the flange's x then points down, 0 where it points up.
    """
    a1, d1, a2, a3, d4, d6 = lengths_mm
    return (
        (a1, -90.0, d1, 0.0),
        (a2, 0.0, 0.0, -90.0),
        (a3, -90.0, 0.0, 0.0),
        (0.0, 90.0, d4, 0.0),
        (0.0, -90.0, d5, 0.0),
        (0.0, 0.0, d6, turn_deg),
    )


def _kuka(*lengths_mm: float) -> tuple[Row, ...]:
    """The same with KUKA's zeros: A2 = -90 is upright, A3 = 90 is level."""
    first, upper, fore, *wrist = _elbow(*lengths_mm, turn_deg=180.0)
    return first, (*upper[:3], 0.0), (*fore[:3], -90.0), *wrist


def _both(*most_deg: float | tuple[float, float]) -> Limits:
    """Ranges of the joints; one number: to either side."""
    return tuple(one if isinstance(one, tuple) else (-one, one) for one in most_deg)


LEVEL = (0.0, 0.0, 0.0, 0.0, 90.0, 0.0)
OTHER_WAY = "joints {} count the other way at the pendant"

ARMS: Mapping[str, ArmModel] = {
    "ur5": _universal_robots("UR5", 89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": _universal_robots("UR10", 127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
    "ur5e": _universal_robots("UR5e", 162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "ur10e": _universal_robots("UR10e", 180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur16e": _universal_robots("UR16e", 180.7, -478.4, -360.0, 174.15, 119.85, 116.55),
    "irb4600-40-255": ArmModel(
        "ABB IRB 4600-40/2.55",
        _elbow(175.0, 495.0, 1095.0, 175.0, 1270.0, 135.0, turn_deg=180.0),
        LEVEL,
        _both(180.0, (-90.0, 150.0), (-180.0, 75.0), 400.0, (-125.0, 120.0), 400.0),
        ROS_I.format("abb, irb4600_40_255_macro.xacro"),
    ),
    "irb6700-200-260": ArmModel(
        "ABB IRB 6700-200/2.60",
        _elbow(320.0, 780.0, 1125.0, 200.0, 1142.5, 200.0, turn_deg=180.0),
        LEVEL,
        _both(170.0, (-65.0, 85.0), (-180.0, 70.0), 300.0, 130.0, 360.0),
        ROS_I.format("abb, irb6700_200_260_macro.xacro"),
    ),
    "m20ia": ArmModel(
        f"FANUC M-20iA; {AT_AXIS_2}",
        _elbow(150.0, 0.0, 790.0, 250.0, 835.0, 100.0),
        LEVEL,
        _both(170.0, (-100.0, 160.0), (-273.0, 185.0), 200.0, 140.0, 270.0),
        f"{ROS_I.format('fanuc, m20ia_macro.xacro')}; {OTHER_WAY.format('3 to 6')}, and joint 3 counts from the "
        "horizontal",
    ),
    "crx10ia-l": ArmModel(
        f"FANUC CRX-10iA/L; {AT_AXIS_2}",
        _elbow(0.0, 0.0, 710.0, 0.0, 540.0, 160.0, d5=-150.0),
        LEVEL,
        _both(180.0, 180.0, 270.0, 190.0, 180.0, 190.0),
        f"{ROS_I.format('fanuc, crx10ial_macro.xacro')}; {OTHER_WAY.format('3 to 6')}, and joint 3 counts from the "
        "horizontal",
    ),
    "kr10-r1100": ArmModel(
        "KUKA KR 10 R1100 sixx",
        _kuka(25.0, 400.0, 560.0, 35.0, 515.0, 80.0),
        (0.0, -90.0, 90.0, 0.0, 90.0, 0.0),
        _both(170.0, (-190.0, 45.0), (-120.0, 156.0), 185.0, 120.0, 350.0),
        f"{ROS_I.format('kuka_experimental, kr10r1100sixx_macro.xacro')}; {OTHER_WAY.format('1, 4 and 6')}",
    ),
    "kr30-3": ArmModel(
        "KUKA KR 30-3",
        _kuka(350.0, 815.0, 850.0, 145.0, 820.0, 170.0),
        (0.0, -90.0, 90.0, 0.0, 90.0, 0.0),
        _both(185.0, (-125.0, 35.0), (-120.0, 158.0), 350.0, 119.0, 350.0),
        f"ARTE, robots/KUKA/KR30_3, with its reach of 2033 mm; {OTHER_WAY.format('1, 4 and 6')}",
    ),
    "gp25": ArmModel(
        f"Yaskawa GP25; {AT_AXIS_2}",
        _elbow(150.0, 0.0, 760.0, 200.0, 795.0, 100.0),
        LEVEL,
        _both(180.0, (-105.0, 155.0), (-160.0, 86.0), 200.0, (-150.0, 155.0), 455.0),
        f"{ROS_I.format('motoman, gp25_macro.xacro')}; {OTHER_WAY.format('U, R, B and T')}",
    ),
    "tx2-90": ArmModel(
        f"Staubli TX2-90; {AT_AXIS_2}",
        (
            (50.0, -90.0, 0.0, 0.0),
            (425.0, 0.0, 50.0, -90.0),
            (0.0, 90.0, 0.0, 90.0),
            (0.0, -90.0, 425.0, 0.0),
            (0.0, 90.0, 0.0, 0.0),
            (0.0, 0.0, 100.0, 0.0),
        ),
        (0.0, 0.0, 90.0, 0.0, 90.0, 0.0),
        _both(180.0, (-130.0, 147.5), 145.0, 270.0, (-115.0, 140.0), 270.0),
        ROS_I.format("staubli_experimental, tx2_90_macro.xacro"),
    ),
}
"""Further arms need a source whose dimensions give the maker's reach."""
