"""The sections that say what the physics is computed from: robot, compliance, tool and removal."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_serializer, model_validator

from polishd.config.sections import (
    Angle,
    NotNegative,
    Positive,
    Range,
    Section,
    Text,
    Vector,
    as_tuple,
    as_tuples,
)
from polishd.model.process import Correction, DipDirection, Moment, NormalForce, NormalFrame, Projection
from polishd.model.robot import Beam, Branch, DhConvention

Poisson = Annotated[float, Field(ge=0, le=0.5)]
Point = Annotated[tuple[float, float], BeforeValidator(as_tuple)]
Joints = Annotated[tuple[Vector, Vector, Vector], BeforeValidator(as_tuples)]

CM2_PER_N = {"cm2/N": 1.0, "mm2/N": 1e-2, "m2/N": 1e4, "1/Pa": 1e4, "1/kPa": 10.0, "1/MPa": 1e-2, "1/GPa": 1e-5}
"""Units of a Preston constant. The paper prints none, and the unit is worth a factor of 100."""


class HybridSection(Section):
    """The hybrid robot: the keys and defaults of ``model.robot.HybridRobot``."""

    type: Literal["hybrid"] = "hybrid"
    base_radius_mm: Positive = 250.0
    platform_radius_mm: Positive = 120.0
    first_limb_deg: Angle = 90.0
    base_joints_mm: Joints | None = None
    platform_joints_mm: Joints | None = None
    outer_axis: Vector = (1.0, 0.0, 0.0)
    wrist_length_mm: Positive = 250.0
    tool_length_mm: Positive = 420.0
    c_zero_deg: Angle = 0.0
    a_zero_deg: Angle = 0.0
    a_branch: Branch = "positive"
    stroke_mm: Range = (950.0, 1750.0)
    joint_height_mm: float = 2535.0
    workspace_radius_mm: Positive = 660.0
    workspace_height_mm: Range = (200.0, 910.0)
    limb_stiffness_n_per_mm: Positive = 20.1e3
    limb_ea_n: Positive | None = None
    up_bending_n_mm2: Positive = 4.4e12
    up_torsion_n_mm2: Positive = 1.5e12
    beam: Beam = "exact"
    a_stiffness_n_mm_per_rad: Positive = 4.36e7
    c_stiffness_n_mm_per_rad: Positive = 9.0e7


class SerialSection(Section):
    """A six-axis arm: the keys of ``model.robot.SerialRobot``."""

    type: Literal["serial"]
    dh: Annotated[
        tuple[Annotated[tuple[float, float, float, float], BeforeValidator(as_tuple)], ...],
        BeforeValidator(as_tuples),
        Field(min_length=6, max_length=6),
    ]
    joint_stiffness_n_mm_per_rad: Annotated[
        tuple[Positive, ...], BeforeValidator(as_tuple), Field(min_length=6, max_length=6)
    ]
    joint_limits_deg: Annotated[tuple[Range, ...], BeforeValidator(as_tuples), Field(min_length=6, max_length=6)]
    home_deg: Annotated[tuple[Angle, ...], BeforeValidator(as_tuple), Field(min_length=6, max_length=6)]
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

    projection: Projection = "linear"
    frame: NormalFrame = "surface"
    moment: Moment = "full"
    dip_direction: DipDirection = "inward"
    dip_azimuth_deg: Angle = 0.0


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
    tool_radius_mm: Positive = 20.0
    force_n: Annotated[float, Field(gt=0, le=500)] = 12.0
    normal_force: NormalForce = "axial"
    rpm: Annotated[float, Field(gt=0, le=20000)] = 1000.0
    dip_deg: Annotated[float, Field(ge=0, lt=90)] = 15.0
    preston: Annotated[float, BeforeValidator(_cm2_per_n), Field(gt=0, lt=1e-3)] = 1.49e-9
    depth_exponent: Annotated[float, Field(gt=0, le=4)] = 1.5
    spot_offset_mm: Point = (0.0, 0.0)
    tool_modulus_mpa: Positive = 29.6
    tool_poisson: Poisson = 0.40
    part_modulus_mpa: Positive = 70.5e3
    part_poisson: Poisson = 0.16
    viscosity_mpa_s: NotNegative = 2.0e-4
    second_viscosity_mpa_s: NotNegative = 0.8e-4
    lame_mpa: Positive = 42.29

    @field_serializer("preston")
    def _with_unit(self, value: float) -> str:
        return f"{value!r} cm2/N"

    @model_validator(mode="after")
    def _has_its_tif(self) -> Self:
        if self.removal_model == "measured_tif" and self.tif is None:
            raise ValueError("tif: the removal model 'measured_tif' needs it; name the file of polishd calibrate tif")
        return self
