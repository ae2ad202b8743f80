"""The process as configured: tool, contact, where the part lies, and the robot that carries the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model.surface import FloatArray

Correction = Literal["none", "pointwise", "linear", "power", "exact"]
"""How the dwell accounts for the robot's compliance (physics: paper eq. 45-49)."""


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


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the part's frame lies in the robot's base frame: ``base = rotation @ part + origin_mm``."""

    origin_mm: tuple[float, float, float]
    rotation: FloatArray
    """(3, 3) proper rotation, part to base."""


@dataclass(frozen=True, slots=True)
class HybridRobot:
    """3UPS-UP parallel section with a C/A wrist (paper section II-B).

    Defaults are polishd's fit to the paper's published compliance and stroke ranges; radii and stiffnesses are not
    published, so they are not the paper's.

    The base frame's origin is the centre of the UP limb's universal joint, z down, x along the outer U axis.
    """

    base_radius_mm: float = 250.0
    platform_radius_mm: float = 120.0
    first_limb_deg: float = 90.0
    wrist_length_mm: float = 250.0
    tool_length_mm: float = 420.0
    stroke_mm: tuple[float, float] = (950.0, 1750.0)
    limb_stiffness_n_per_mm: float = 20.1e3
    up_bending_n_mm2: float = 4.4e12
    up_torsion_n_mm2: float = 1.5e12
    a_stiffness_n_mm_per_rad: float = 4.36e7
    c_stiffness_n_mm_per_rad: float = 9.0e7
