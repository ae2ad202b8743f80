"""The process as configured: tool and contact, how the robot's compliance is read, the part's shape and place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model.surface import FloatArray

Correction = Literal["none", "pointwise", "linear", "power", "exact"]
"""Correction of the dwell for the robot's compliance (physics: paper eq. 45-49)."""
NormalForce = Literal["axial", "resolved"]
"""Force that Hertz is given: the actuator's, or ``force / cos(dip)`` (eq. 44)."""
Projection = Literal["linear", "quadratic", "normal"]
NormalFrame = Literal["surface", "frenet", "tool_axis"]
Moment = Literal["full", "paper"]
DipDirection = Literal["inward", "fixed", "along", "across"]


@dataclass(frozen=True, slots=True)
class ToolProcess:
    """Bonnet, contact and Preston constant. Defaults are the paper's Table II and its main process."""

    tool_radius_mm: float = 20.0
    force_n: float = 12.0
    rpm: float = 1000.0
    dip_deg: float = 15.0
    preston_cm2_per_n: float = 1.49e-9
    """Preston constant; the paper prints no unit, cm^2/N is the reading that gives published bonnet rates."""
    tool_modulus_mpa: float = 29.6
    tool_poisson: float = 0.40
    part_modulus_mpa: float = 70.5e3
    part_poisson: float = 0.16
    viscosity_mpa_s: float = 2.0e-4
    second_viscosity_mpa_s: float = 0.8e-4
    lame_mpa: float = 42.29
    normal_force: NormalForce = "axial"
    depth_exponent: float = 1.5
    """m of the correction "power": volume goes as depth to this power, 1.5 for Hertz."""
    spot_offset_mm: tuple[float, float] = (0.0, 0.0)
    """Offset of the spot's center from the programmed point in the tool's frame; y towards the spindle's lean."""


@dataclass(frozen=True, slots=True)
class ComplianceOptions:
    """Reduction of the robot's compliance matrix to one number a point (paper eq. 34-43)."""

    projection: Projection = "linear"
    """``linear`` sums ``lambda_k |<X_k, b>|`` (eq. 43), ``quadratic`` its squares, ``normal`` is ``b' C b``."""
    frame: NormalFrame = "surface"
    """The normal b: the nominal optic's, the path's binormal (eq. 34-38), or the tool axis turned back by the dip."""
    moment: Moment = "full"
    """``full``: compliance of the tip; ``paper``: eq. 41, without the force's own moment about the wrist."""
    dip_direction: DipDirection = "inward"
    """Direction of the spindle's lean: towards the base's z axis, fixed on the part, along or across the path."""
    dip_azimuth_deg: float = 0.0
    """For ``fixed``: counterclockwise from the part's x."""


SHIPPED_OPTIONS = ComplianceOptions()


@dataclass(frozen=True, slots=True)
class Optic:
    """The nominal surface: flat, sphere, conic or even asphere, about its own axis or a piece off it.

    The parent's height over its vertex is ``r^2 / (R (1 + sqrt(1 - (1 + k) (r / R)^2))) + A4 r^4 + A6 r^6 ...``.
    The part's frame has its origin on the surface, at the part's centre, and its z along the normal there; its x and
    y are the parent's, turned with z the short way. So a piece on the axis keeps the parent's frame.
    """

    radius_mm: float | None = None
    """Vertex radius of curvature R, positive = concave (the rim rises towards +z); None is flat."""
    conic: float = 0.0
    even: tuple[float, ...] = ()
    """A4, A6, ...: mm^-3, mm^-5, ..., positive = up."""
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """Position of the part's center in the parent's x and y from its vertex."""


FLAT = Optic()


@dataclass(frozen=True, slots=True)
class MeasuredTif:
    """A removal rate that was measured instead of modelled: map before minus map after, over the time."""

    rate_nm_s: FloatArray
    """(ny, nx) nm/s, row 0 the top, centred on the centroid; 0 beyond the rim."""
    pitch_mm: float
    azimuth_deg: float = 0.0
    """Direction of the spindle's lean, counterclockwise from the map's x."""
    depth_ratio: float = 1.0
    """Gamma at the place where it was measured."""
    rotates: bool = True
    """The spot turns with the spindle's lean."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Position of the part's frame in the robot's base frame: ``base = rotation @ part + origin_mm``."""

    origin_mm: tuple[float, float, float]
    rotation: FloatArray
    """(3, 3) proper rotation, part to base."""


# Robots as configured: geometry and stiffness, or a table of what a loading test measured.

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
    """The machine's C reading where the A joint lies along u."""
    a_zero_deg: float = 0.0
    """The machine's A reading where the tool points along w."""
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
    """Source of the table, for messages."""


RobotModel = HybridRobot | SerialRobot | MeasuredCompliance
"""Model of a cell's compliance."""
