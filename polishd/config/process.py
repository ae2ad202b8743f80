"""The sections that say what the physics is computed from: robot, compliance, tool and removal."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_serializer, model_validator

from polishd.config.values import (
    Angle,
    Dip,
    Force,
    NotNegative,
    Pair,
    Positive,
    Range,
    Section,
    Speed,
    Text,
    Vector,
    as_tuple,
)
from polishd.model.process import (
    SHIPPED_OPTIONS,
    Correction,
    DipDirection,
    Moment,
    NormalForce,
    NormalFrame,
    Projection,
    ToolProcess,
)
from polishd.model.robot import Beam, Branch, DhConvention, HybridRobot

_ROBOT = HybridRobot()
_TOOL = ToolProcess()
Poisson = Annotated[float, Field(ge=0, le=0.5)]
Tuple = BeforeValidator(as_tuple)
Joints = Annotated[tuple[Vector, Vector, Vector], Tuple]
Six = Field(min_length=6, max_length=6)

CM2_PER_N = {"cm2/N": 1.0, "mm2/N": 1e-2, "m2/N": 1e4, "1/Pa": 1e4, "1/kPa": 10.0, "1/MPa": 1e-2, "1/GPa": 1e-5}
"""Units of a Preston constant. The paper prints none, and the unit is worth a factor of 100."""


class HybridSection(Section):
    """The hybrid robot: the keys and defaults of ``model.robot.HybridRobot``."""

    type: Literal["hybrid"] = "hybrid"
    base_radius_mm: Positive = _ROBOT.base_radius_mm
    platform_radius_mm: Positive = _ROBOT.platform_radius_mm
    first_limb_deg: Angle = _ROBOT.first_limb_deg
    base_joints_mm: Joints | None = _ROBOT.base_joints_mm
    platform_joints_mm: Joints | None = _ROBOT.platform_joints_mm
    outer_axis: Vector = _ROBOT.outer_axis
    wrist_length_mm: Positive = _ROBOT.wrist_length_mm
    tool_length_mm: Positive = _ROBOT.tool_length_mm
    c_zero_deg: Angle = _ROBOT.c_zero_deg
    a_zero_deg: Angle = _ROBOT.a_zero_deg
    a_branch: Branch = _ROBOT.a_branch
    stroke_mm: Range = _ROBOT.stroke_mm
    joint_height_mm: float = _ROBOT.joint_height_mm
    workspace_radius_mm: Positive = _ROBOT.workspace_radius_mm
    workspace_height_mm: Range = _ROBOT.workspace_height_mm
    limb_stiffness_n_per_mm: Positive = _ROBOT.limb_stiffness_n_per_mm
    limb_ea_n: Positive | None = _ROBOT.limb_ea_n
    up_bending_n_mm2: Positive = _ROBOT.up_bending_n_mm2
    up_torsion_n_mm2: Positive = _ROBOT.up_torsion_n_mm2
    beam: Beam = _ROBOT.beam
    a_stiffness_n_mm_per_rad: Positive = _ROBOT.a_stiffness_n_mm_per_rad
    c_stiffness_n_mm_per_rad: Positive = _ROBOT.c_stiffness_n_mm_per_rad


class SerialSection(Section):
    """A six-axis arm: the keys of ``model.robot.SerialRobot``."""

    type: Literal["serial"]
    dh: Annotated[tuple[Annotated[tuple[float, float, float, float], Tuple], ...], Tuple, Six]
    joint_stiffness_n_mm_per_rad: Annotated[tuple[Positive, ...], Tuple, Six]
    joint_limits_deg: Annotated[tuple[Range, ...], Tuple, Six]
    home_deg: Annotated[tuple[Angle, ...], Tuple, Six]
    tool_length_mm: Positive
    convention: DhConvention = "standard"
    flange_x: Vector = (1.0, 0.0, 0.0)


class MeasuredSection(Section):
    """A cell that was only loaded and measured: a CSV file with ``x_mm, y_mm, z_mm, compliance_um_per_n``."""

    type: Literal["measured"]
    table: Text


def _kind_of_robot(value: Any) -> Any:
    """``type``, which says what keys follow; the hybrid robot where it is not given."""
    return value.get("type", "hybrid") if isinstance(value, dict) else getattr(value, "type", "hybrid")


KinematicsSection = Annotated[
    Annotated[HybridSection, Tag("hybrid")]
    | Annotated[SerialSection, Tag("serial")]
    | Annotated[MeasuredSection, Tag("measured")],
    Discriminator(
        _kind_of_robot,
        custom_error_type="robot_type",
        custom_error_message="must be 'hybrid', 'serial' or 'measured'",
    ),
]


class ComplianceSection(Section):
    """How the robot's compliance is read: the keys and defaults of ``model.process.ComplianceOptions``."""

    projection: Projection = SHIPPED_OPTIONS.projection
    frame: NormalFrame = SHIPPED_OPTIONS.frame
    moment: Moment = SHIPPED_OPTIONS.moment
    dip_direction: DipDirection = SHIPPED_OPTIONS.dip_direction
    dip_azimuth_deg: Angle = SHIPPED_OPTIONS.dip_azimuth_deg


def _cm2_per_n(value: Any) -> Any:
    """A Preston constant with its unit, such as "1.49e-9 cm2/N", in cm2/N."""
    number, _, unit = str(value).strip().partition(" ")
    unit = re.sub(r"\s|\^", "", unit).replace("²", "2")
    try:
        found = float(number)
        if unit:
            return found * CM2_PER_N[unit]
    except (ValueError, KeyError):
        units = ", ".join(CM2_PER_N)
        raise ValueError(f"{value!r} is no Preston constant; write a number and one of {units}") from None
    raise ValueError(f'{number} has no unit, which is worth a factor of 100; write "{number} cm2/N", or which it is')


class ProcessSection(Section):
    """The process: the keys and defaults of ``model.process.ToolProcess``, and how removal is computed."""

    removal_model: Text = "hertz_preston"
    correction: Correction = "exact"
    grid_mm: Annotated[float, Field(gt=0, le=20)] = 0.5
    tif: Text | None = None
    tool_radius_mm: Positive = _TOOL.tool_radius_mm
    force_n: Force = _TOOL.force_n
    normal_force: NormalForce = _TOOL.normal_force
    rpm: Speed = _TOOL.rpm
    dip_deg: Dip = _TOOL.dip_deg
    preston: Annotated[float, BeforeValidator(_cm2_per_n), Field(gt=0, lt=1e-3)] = _TOOL.preston_cm2_per_n
    depth_exponent: Annotated[float, Field(gt=0, le=4)] = _TOOL.depth_exponent
    spot_offset_mm: Pair = _TOOL.spot_offset_mm
    tool_modulus_mpa: Positive = _TOOL.tool_modulus_mpa
    tool_poisson: Poisson = _TOOL.tool_poisson
    part_modulus_mpa: Positive = _TOOL.part_modulus_mpa
    part_poisson: Poisson = _TOOL.part_poisson
    viscosity_mpa_s: NotNegative = _TOOL.viscosity_mpa_s
    second_viscosity_mpa_s: NotNegative = _TOOL.second_viscosity_mpa_s
    lame_mpa: Positive = _TOOL.lame_mpa

    @field_serializer("preston")
    def _with_unit(self, value: float) -> str:
        return f"{value!r} cm2/N"

    @model_validator(mode="after")
    def _has_its_tif(self) -> Self:
        if self.removal_model == "measured_tif" and self.tif is None:
            raise ValueError("tif: the removal model 'measured_tif' needs it; name the file of polishd calibrate tif")
        return self
