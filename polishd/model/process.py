"""The process as configured: tool and contact, how the robot's compliance is read, the part's shape and place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model.surface import FloatArray

Correction = Literal["none", "pointwise", "linear", "power", "exact"]
"""How the dwell accounts for the robot's compliance (physics: paper eq. 45-49)."""
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
    """Where the spot's centre lies from the programmed point, in the tool's frame: y where the spindle leans."""


@dataclass(frozen=True, slots=True)
class ComplianceOptions:
    """How the robot's compliance matrix becomes one number a point (paper eq. 34-43)."""

    projection: Projection = "linear"
    """``linear`` sums lambda_k |<X_k, b>| (eq. 43), ``quadratic`` its squares, ``normal`` is b' C b."""
    frame: NormalFrame = "surface"
    """The normal b: the nominal optic's, the path's binormal (eq. 34-38), or the tool axis turned back by the dip."""
    moment: Moment = "full"
    """``full``: compliance of the tip; ``paper``: eq. 41, without the force's own moment about the wrist."""
    dip_direction: DipDirection = "inward"
    """Where the spindle leans: towards the base's z axis, one way on the part, along or across the path."""
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
    """Where the part's centre lies, in the parent's x and y from its vertex."""


FLAT = Optic()


@dataclass(frozen=True, slots=True)
class MeasuredTif:
    """A removal rate that was measured instead of modelled: map before minus map after, over the time."""

    rate_nm_s: FloatArray
    """(ny, nx) nm/s, row 0 the top, centred on the centroid; 0 beyond the rim."""
    pitch_mm: float
    azimuth_deg: float = 0.0
    """Where the spindle leaned, counterclockwise from the map's x."""
    depth_ratio: float = 1.0
    """Gamma at the place where it was measured."""
    rotates: bool = True
    """Whether it turns with the direction in which the spindle leans."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the part's frame lies in the robot's base frame: ``base = rotation @ part + origin_mm``."""

    origin_mm: tuple[float, float, float]
    rotation: FloatArray
    """(3, 3) proper rotation, part to base."""
