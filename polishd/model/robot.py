"""Robots as configured: geometry and stiffness, or a table of what a loading test measured.

The base frame of the hybrid robot has its origin at the centre of the UP limb's universal joint, z down. The others
have the frame that their numbers are given in; the part is placed in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model.surface import FloatArray

Vector = tuple[float, float, float]
Beam = Literal["exact", "paper"]
Branch = Literal["positive", "negative"]
DhConvention = Literal["standard", "modified"]


@dataclass(frozen=True, slots=True)
class HybridRobot:
    """3UPS-UP parallel section with a C/A wrist (paper section II-B).

    Defaults are polishd's fit to the paper's published compliance and stroke ranges, which anyone can run again
    (``python -m benchmarks.fit_robot``); radii and stiffnesses are not published, so they are not the paper's.

    The C axis lies on the line from the U joint to the wrist centre, the A axis meets it there, and the tool axis meets
    A there without offset: no other wrist can be stated.
    """

    base_radius_mm: float = 250.0
    platform_radius_mm: float = 120.0
    first_limb_deg: float = 90.0
    base_joints_mm: tuple[Vector, Vector, Vector] | None = None
    """Base ends of the limbs, ``b_i`` of eq. 1; None: on the circle of ``base_radius_mm``, 120 deg apart."""
    platform_joints_mm: tuple[Vector, Vector, Vector] | None = None
    """Platform ends from its centre, ``a_i``, as they lie when the UP limb points along z; None: on a circle."""
    outer_axis: Vector = (1.0, 0.0, 0.0)
    """Outer axis of the U joint, fixed to the base; the inner one is fixed to the platform, perpendicular to w."""
    wrist_length_mm: float = 250.0
    tool_length_mm: float = 420.0
    c_zero_deg: float = 0.0
    """What the machine's C reads where the A joint lies along u."""
    a_zero_deg: float = 0.0
    """What the machine's A reads where the tool points along w."""
    a_branch: Branch = "positive"
    """Sign of A at a path's first point; from there the branch is continuous."""
    stroke_mm: tuple[float, float] = (950.0, 1750.0)
    joint_height_mm: float = 2535.0
    """Height of the U joint's centre above height 0 of the workspace."""
    workspace_radius_mm: float = 660.0
    workspace_height_mm: tuple[float, float] = (200.0, 910.0)
    """Table I; heights of the tool tip: ``joint_height_mm - z``."""
    limb_stiffness_n_per_mm: float = 20.1e3
    limb_ea_n: float | None = None
    """E A of a limb, N: then a limb has EA / length, and ``limb_stiffness_n_per_mm`` is not used."""
    up_bending_n_mm2: float = 4.4e12
    up_torsion_n_mm2: float = 1.5e12
    beam: Beam = "exact"
    """The UP limb: an Euler-Bernoulli beam with a released U joint, or eq. 6-8 as the paper ties them."""
    a_stiffness_n_mm_per_rad: float = 4.36e7
    c_stiffness_n_mm_per_rad: float = 9.0e7


@dataclass(frozen=True, slots=True)
class SerialRobot:
    """A six-axis arm: Denavit-Hartenberg rows and joint stiffnesses.

    The flange's z points out of the flange; the tool tip lies ``tool_length_mm`` along it, and the tool axis (from the
    tip into the spindle) is opposite to it. The turn about the tool axis, which polishing leaves free, is fixed by
    turning the flange's x as near to ``flange_x`` (base frame) as it goes.
    """

    dh: tuple[tuple[float, float, float, float], ...]
    """Six rows ``(a_mm, alpha_deg, d_mm, theta_zero_deg)``."""
    joint_stiffness_n_mm_per_rad: tuple[float, ...]
    joint_limits_deg: tuple[tuple[float, float], ...]
    home_deg: tuple[float, ...]
    """Joint angles from which the inverse kinematics starts: it takes the branch that lies nearest."""
    tool_length_mm: float
    convention: DhConvention = "standard"
    flange_x: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MeasuredCompliance:
    """A cell that was only loaded and measured: the equivalent compliance at places of the workspace.

    Interpolated linearly between them; outside of their hull it is unknown, and refused.
    """

    tip_mm: FloatArray
    """(m, 3) tool tips, base frame."""
    compliance_um_per_n: FloatArray
    """(m,) along the surface normal, at the process's dip."""
    source: str = ""
    """Where the table came from, for messages."""


RobotModel = HybridRobot | SerialRobot | MeasuredCompliance
"""What a cell's compliance is computed from."""
