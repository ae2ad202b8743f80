"""The sections of SIM.toml that say what is physical: the part, how its tool removes, and what nobody is told."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.outline import OutlineKeys
from polishd.config.process import Poisson, Preston
from polishd.config.values import (
    ConfigSection,
    Dip,
    Force,
    NotNegative,
    Pair,
    Positive,
    ShareOrNone,
    Speed,
    Text,
    Vector,
    as_tuple,
    require_cells,
)
from polishd.model.process import FLAT, NormalForce, Projection, ToolProcess

_TOOL = ToolProcess()
CLOSEST = 0.8
"""A part that is concave by more than this share of the bonnet's own curvature is touched all round: no spot."""
MOST_OF_RADIUS = 0.99
"""So near to its end may a sphere or an ellipsoid come under the part and its ring."""


class Plant(OutlineKeys):
    """The part, where it lies, and the surface it starts with."""

    seed: int = 1
    """What all that is hidden is drawn from: the same number gives the same cell. [1]"""
    speed: Annotated[float, Field(gt=0, le=10000)] = 60.0
    """Process seconds per wall second while the robot runs. [1]"""
    part_id: str = "DEMO-100"
    """The part's name in the maps; `part.id` of the cell must be the same."""
    aperture_mm: Annotated[float, Field(gt=5, le=5000)] | None = 100.0
    """Diameter of a round part, which counts where no other key says the outline."""
    edge_mm: NotNegative = 3.0
    """Width of the rim that the true RMS and PV in the logs leave out."""
    ring_mm: Annotated[float, Field(ge=3, le=1000)] = 15.0
    """Width of the flush waster around the part: room for landing pads and overrun."""
    pitch_mm: Annotated[float, Field(gt=0.05, le=1)] = 0.5
    """Of the true surface, and of the maps."""
    rms_nm: NotNegative = 18.0
    """Of the surface at the start, in the clear aperture; 0: it starts flat."""
    pv_nm: NotNegative = 150.0
    """Peak to valley of the same; one bump makes up what the RMS does not give."""
    curvature_radius_mm: float | None = FLAT.radius_mm
    """Vertex radius of the optic, positive where it is concave; left out: flat. `part.curvature_radius_mm`."""
    conic: float = FLAT.conic
    """Conic constant: 0 a sphere, -1 a paraboloid. [1]"""
    even: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = FLAT.even
    """Even aspheric terms A4, A6, ..., positive up. [mm^-3, mm^-5, ...]"""
    off_axis_mm: Pair = FLAT.offset_mm
    """Where the part's centre lies from the vertex, in the parent's x and y."""
    origin_mm: Vector = (230.0, 160.0, 2085.0)
    """Where the part's centre truly lies in the robot's base frame; `part.origin_mm` of the cell."""
    rotation_rpy_deg: Vector = (180.0, 0.0, 0.0)
    """How it truly lies there, intrinsic x-y'-z''; `part.rotation_rpy_deg` of the cell."""
    seat_height_mm: float = 0.0
    """How much higher the part sits than all of that says, along its normal; negative: lower."""
    seat_tilt_deg: Pair = (0.0, 0.0)
    """And how it is tilted there, about its x and y."""
    seat_empty: bool = False
    """No part lies in its ring: the tool finds nothing to press on. Maps show one all the same."""
    program_offset_mm: Vector = (0.0, 0.0, 0.0)
    """Where the program's frame truly lies on the part; `program.offset_mm` of the cell."""
    program_rotation_deg: float = 0.0
    """How it truly lies there; `program.rotation_deg` of the cell."""

    @property
    def reach_mm(self) -> float:
        """From the vertex to the farthest of part and ring."""
        return math.hypot(*self.off_axis_mm) + self.outline.radius_mm + self.ring_mm

    @model_validator(mode="after")
    def _can_be_simulated(self) -> Self:
        across_mm = 2 * (self.outline.radius_mm + self.ring_mm)
        require_cells(across_mm, across_mm, self.pitch_mm, "pitch_mm")
        return self

    @model_validator(mode="after")
    def _is_a_surface(self) -> Self:
        radius = self.curvature_radius_mm
        if radius is not None and (1 + self.conic) * self.reach_mm**2 >= (MOST_OF_RADIUS * radius) ** 2:
            raise ValueError(
                f"curvature_radius_mm: {radius:g} mm is no surface out to {self.reach_mm:g} mm, where the ring ends"
            )
        return self


class Truth(ConfigSection):
    """Ranges that the hidden truth is drawn from; 0 makes a perfect machine."""

    rate: Pair = (-0.10, 0.0)
    """Lowest and highest of what the removal rate is off Preston's nominal constant, relative. [1]"""
    stiffness: ShareOrNone = 0.10
    """How far each stiffness of the robot is off its nominal value, either way, relative. [1]"""
    drift: ShareOrNone = 0.01
    """Amplitude of a slow sine of the removal rate, relative. [1]"""
    worn: ShareOrNone = 0.0
    """Share of its removal rate that the tool has lost. [1]"""
    drift_period_s: Positive = 3000.0
    """Period of that drift, process time; drawn within 20 % of it."""
    force_noise: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    """Scatter of the force, relative. [1]"""
    force_noise_s: Positive = 0.05
    """Correlation time of that scatter, process time."""
    map_noise_nm: NotNegative = 0.3
    """Scatter of each sample of a map."""
    warm_nm: float = 0.0
    """How much higher the part's rim than its centre stands right after a pass, for it is warm."""
    warm_s: Positive = 300.0
    """Time in which that falls to 37 %, simulated clock."""
    accel_mm_s2: Positive = 1000.0
    """What the robot truly accelerates with."""
    accel_spread: ShareOrNone = 0.05
    """How far off that it is drawn, either way, relative. [1]"""
    overhead_s: NotNegative = 0.005
    """Time that a block takes beyond its motion."""
    overhead_spread: ShareOrNone = 0.10
    """How far off that it is drawn, either way, relative. [1]"""


class SimContactSection(ConfigSection):
    """The tool, and how it removes: Hertz's contact and Preston's equation, or a spot that was measured."""

    tool_radius_mm: Positive = _TOOL.tool_radius_mm
    """Radius of the bonnet's sphere."""
    preston: Preston = _TOOL.preston_cm2_per_n
    """Preston's constant with its unit, as a cell has it; `truth.rate` says how far off it the truth may be.
    [as written]"""
    normal_force: NormalForce = _TOOL.normal_force
    """What Hertz is given: the actuator's force, or that over the cosine of the dip."""
    spot_offset_mm: Pair = _TOOL.spot_offset_mm
    """Where the spot's centre lies from the tool's tip, in the tool's frame: y where the spindle leans."""
    tool_modulus_mpa: Positive = _TOOL.tool_modulus_mpa
    """Young's modulus of the bonnet."""
    tool_poisson: Poisson = _TOOL.tool_poisson
    """Poisson's ratio of the bonnet. [1]"""
    part_modulus_mpa: Positive = _TOOL.part_modulus_mpa
    """Young's modulus of the part."""
    part_poisson: Poisson = _TOOL.part_poisson
    """Poisson's ratio of the part. [1]"""
    tif: Text | None = None
    """File of a measured TIF, as `polishd calibrate tif` writes it: the tool removes that instead of Hertz's spot."""
    force_n: Force = _TOOL.force_n
    """Force at which that TIF was measured."""
    rpm: Speed = _TOOL.rpm
    """Speed of the spindle at which it was measured."""
    dip_deg: Dip = _TOOL.dip_deg
    """Angle between spindle and normal at which it was measured."""
    projection: Projection = "linear"
    """How the robot's compliance becomes the way that it gives along the normal: `compliance.projection` of a cell."""

    def tool(self) -> ToolProcess:
        """As the plant takes it."""
        given = {name: value for name, value in self if name not in {"preston", "tif", "projection"}}
        return ToolProcess(preston_cm2_per_n=self.preston, **given)
