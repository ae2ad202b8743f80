"""Sections of SIM.toml for the physics: part, surface, tool, contact, hidden truth, and errors of the instrument."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.fields import (
    ConfigSection,
    Dip,
    Force,
    NotNegative,
    OpticKeys,
    Pair,
    Positive,
    ShareOrNone,
    Speed,
    Text,
    Vector,
    as_tuple,
    require_cells,
)
from polishd.config.process_sections import ContactKeys
from polishd.model.process import Projection, ToolProcess

# What else is wrong with tool, contact and robot: ranges, each off by default.


class Effects(ConfigSection):
    """What the controller assumes and the machine does not do; sizes have no source but the shop's experience."""

    rate_field: ShareOrNone = 0.0
    """Largest change of the removal rate from the part's center to its rim, in either direction: a smooth field. [1]"""
    pad_half_life_s: Positive | None = None
    """Contact time in which the pad loses half of its rate; left out: it does not wear."""
    warm_up: ShareOrNone = 0.0
    """Share of the rate that a cold tool lacks. [1]"""
    warm_up_s: Positive = 300.0
    """Contact time in which that falls to 37 %."""
    spot_shift_mm: NotNegative = 0.0
    """How far the spot lies off where the tool says; its direction is drawn."""
    spot_frame: Literal["tool", "part"] = "tool"
    """Whether that direction turns with the lean of the spindle, or stays with the part."""
    spot_turn_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """How far the spot is turned about the normal, either way."""
    spot_skew: ShareOrNone = 0.0
    """How much more is removed at the rim that the bonnet slides towards, and less where it comes from, or the other
    way round. [1]"""
    bonnet_pressure: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """How far the bonnet's pressure, and with it its modulus, is off, either way, relative: a soft one makes a wide and
    flat spot. [1]"""
    robot_error_mm: NotNegative = 0.0
    """How far the tool's tip lies off where the robot says, across the normal: a smooth field of its workspace. An arm
    that was not calibrated has some 0.3 mm (ISO 9283 accuracy of pose)."""
    robot_error_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How far the spindle leans off, likewise; some 0.02."""
    robot_error_wave_mm: Positive = 400.0
    """Length of the shortest wave of that field; the longest is three times as long."""
    vibration_mm: NotNegative = 0.0
    """Radius of a fast circle that the tool's tip runs: it smears the spot."""
    seat_shift_mm: NotNegative = 0.0
    """How far the part lies off its seat, across its normal; its direction is drawn."""
    compliance: ShareOrNone = 0.0
    """How far the compliance along the normal is off the robot's, either way, relative. [1]"""
    eq_44: Pair = (0.0, 1.0)
    """How much of what paper eq. 44 says is lost as depth where the robot gives way: 1 all of it; 0 constant depth,
    which statics gives for an actuator that holds its force. One with friction or a stiff guide is between; drawn
    between the two. [1]"""
    friction: Pair = (0.2, 0.5)
    """Coefficient of friction between bonnet and part: it pulls the tip sideways as far as the robot gives way; drawn
    between the two. [1]"""
    speed_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the spindle's speed, relative. [1]"""
    speed_ripple_s: Positive = 2.0
    """Its period, contact time."""
    force_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the force, which no sensor sees, relative. [1]"""
    force_ripple_s: Positive = 3.0
    """Its period, contact time."""
    force_lag_s: NotNegative = 0.0
    """Process time by which the true force lags behind what the actuator exerts and measures: when the tool lands, and
    where the part comes or goes, by its tilt or the robot's error along the normal (`robot_error_mm`). 0: it
    follows."""
    guide_friction_n: NotNegative = 0.0
    """Dry friction of the actuator's guide, which it does not measure: the true force is so much smaller where the part
    goes and larger where it comes, by the same causes."""

    @model_validator(mode="after")
    def _are_ranges(self) -> Self:
        for name, (least, most), end in (("eq_44", self.eq_44, 1.0), ("friction", self.friction, 2.0)):
            if not 0.0 <= least <= most <= end:
                raise ValueError(
                    f"{name}: [{least:g}, {most:g}] is no range within 0 to {end:g}; give the lower one first"
                )
        return self


# What the interferometer adds to the part's true heights: all off by default.


class InstrumentErrors(ConfigSection):
    """Errors of the instrument in every map. Sizes in nm are RMS over the circle about the part."""

    tilt_nm: NotNegative = 0.0
    """Largest tilt of the part in each set-up, along x and along y."""
    power_nm: float = 0.0
    """Power of its reference."""
    astigmatism_nm: NotNegative = 0.0
    """Astigmatism of its reference, ..."""
    astigmatism_deg: float = 20.0
    """... high along this direction."""
    coma_nm: NotNegative = 0.0
    """Coma of its reference, along x."""
    mount_nm: NotNegative = 0.0
    """Print-through of three points of the mount: a trefoil, ..."""
    mount_turns: bool = False
    """... which turns with the part, or stays with the instrument."""
    mount_anew: bool = False
    """... whose size and direction are drawn again for each map, with `mount_nm` as their RMS; nothing turns."""
    magnification: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """Relative error of the stated magnification. [1]"""
    distortion: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """Relative error of the magnification at the part's rim, which grows with the square of the radius. [1]"""
    retrace_nm_per_urad: float = 0.0
    """Height error of a slope along x, because the reflected beam takes another way. [nm/urad]"""
    slope_noise_nm_per_urad: NotNegative = 0.0
    """Noise of a sample by the slope there, beside `hidden_truth.map_noise_nm`. [nm/urad]"""
    dead_pixels: ShareOrNone = 0.0
    """Share of the samples that never have data. [1]"""


# The part, how its tool removes, and the hidden truth.

_TOOL = ToolProcess()
CLOSEST = 0.8
"""A part that is concave by more than this share of the bonnet's own curvature is touched all round: no spot."""
MOST_OF_RADIUS = 0.99
"""So near to its end may a sphere or an ellipsoid come under the part and its ring."""


class Plant(OpticKeys):
    """The part, its position, and its surface at the start."""

    seed: int = 1
    """Seed of all hidden values: the same number gives the same cell. [1]"""
    speed: Annotated[float, Field(gt=0, le=10000)] = 60.0
    """Process seconds per wall second while the robot runs. [1]"""
    part_id: str = "DEMO-100"
    """The part's name in the maps; `part.id` of the cell must be the same."""
    aperture_mm: Annotated[float, Field(gt=5, le=5000)] | None = 100.0
    """Diameter of a round part, if no other key states the outline."""
    edge_mm: NotNegative = 3.0
    """Width of the edge zone that the true RMS and PV in the logs exclude."""
    ring_mm: Annotated[float, Field(ge=3, le=1000)] = 15.0
    """Width of the flush waster around the part: room for landing pads and overrun."""
    pitch_mm: Annotated[float, Field(gt=0.05, le=1)] = 0.5
    """Of the true surface, and of the maps."""
    patch_mm: Annotated[tuple[float, float, Positive], BeforeValidator(as_tuple)] | None = None
    """Center (x, y) and side of a square of the part that is kept on samples of `patch_pitch_mm`, too, where the lines
    of the path show. The plant writes its map, as an instrument with that magnification takes it, to `patch.dat` of the
    state folder with each map. Left out: none is kept."""
    patch_pitch_mm: Annotated[float, Field(ge=0.005, le=1)] = 0.08
    """Of the samples of `patch_mm`: a twentieth of the spot's radius shows three harmonics of the lines."""
    rms_nm: NotNegative = 18.0
    """Of the surface at the start, in the clear aperture; 0: it starts flat."""
    pv_nm: NotNegative = 150.0
    """Peak to valley of the same; one bump makes up what the RMS does not give."""
    origin_mm: Vector = (230.0, 160.0, 2085.0)
    """True position of the part's center in the robot's base frame. The cell assumes `part.origin_mm`."""
    rotation_rpy_deg: Vector = (180.0, 0.0, 0.0)
    """How it truly lies there, intrinsic x-y'-z''; `part.rotation_rpy_deg` of the cell."""
    seat_height_mm: float = 0.0
    """How much higher the part sits than all of that says, along its normal; negative: lower."""
    seat_tilt_deg: Pair = (0.0, 0.0)
    """And how it is tilted there, about its x and y."""
    part_missing: bool = False
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
        if self.patch_mm is not None:
            x, y, side = self.patch_mm
            require_cells(side, side, self.patch_pitch_mm, "patch_pitch_mm")
            if math.hypot(x, y) + side > self.outline.radius_mm + self.ring_mm:
                raise ValueError(f"patch_mm: {side:g} mm about {x:g}, {y:g} mm is not all on the part and its ring")
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
    tool_wear: ShareOrNone = 0.0
    """Share of its removal rate that the tool has lost. [1]"""
    drift_period_s: Positive = 3000.0
    """Period of that drift, process time; drawn within 20 % of it."""
    force_noise: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    """Scatter of the force, relative. [1]"""
    force_noise_s: Positive = 0.05
    """Correlation time of that scatter, process time."""
    map_noise_nm: NotNegative = 0.3
    """Scatter of each sample of a map."""
    thermal_nm: float = 0.0
    """Height of the warm part's rim above its center right after a pass."""
    thermal_s: Positive = 300.0
    """Time in which that falls to 37 %, simulated clock."""
    accel_mm_s2: Positive = 1000.0
    """What the robot truly accelerates with."""
    accel_spread: ShareOrNone = 0.05
    """How far off that it is drawn, either way, relative. [1]"""
    overhead_s: NotNegative = 0.005
    """Time that a block takes beyond its motion."""
    overhead_spread: ShareOrNone = 0.10
    """How far off that it is drawn, either way, relative. [1]"""


class SimContactSection(ContactKeys):
    """The tool, and how it removes: Hertz's contact and Preston's equation, or a spot that was measured."""

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
