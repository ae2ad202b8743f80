"""Sections with the inputs of the physics: robot, compliance, tool and removal."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_serializer, model_validator

from polishd.config.cell_sections import PartSection
from polishd.config.fields import (
    Angle,
    ConfigSection,
    Dip,
    FileNames,
    Force,
    NotNegative,
    Pair,
    Positive,
    Range,
    Speed,
    Text,
    Vector,
    as_tuple,
)
from polishd.config.table_files import read_compliance_table, read_polygon
from polishd.config.toml_loader import Location, TomlDocument, TomlSource
from polishd.model.errors import ConfigError
from polishd.model.outline import Outline
from polishd.model.process import (
    SHIPPED_OPTIONS,
    Beam,
    Branch,
    ComplianceOptions,
    Correction,
    DhConvention,
    DipDirection,
    HybridRobot,
    Moment,
    NormalForce,
    NormalFrame,
    Optic,
    Placement,
    Projection,
    RobotModel,
    SerialRobot,
    ToolProcess,
)
from polishd.process.frames import rotation_from_rpy_deg

_ROBOT = HybridRobot()
_TOOL = ToolProcess()
Poisson = Annotated[float, Field(ge=0, le=0.5)]
Tuple = BeforeValidator(as_tuple)
Joints = Annotated[tuple[Vector, Vector, Vector], Tuple]
Six = Field(min_length=6, max_length=6)

CM2_PER_N = {"cm2/N": 1.0, "mm2/N": 1e-2, "m2/N": 1e4, "1/Pa": 1e4, "1/kPa": 10.0, "1/MPa": 1e-2, "1/GPa": 1e-5}
"""Units of a Preston constant. The paper prints none; a wrong unit is a factor of 100."""


class HybridSection(ConfigSection):
    """The paper's 3UPS-UP with a C/A wrist. Defaults are a fit to the paper's ranges (docs/explanation/robot.md)."""

    type: Literal["hybrid"] = "hybrid"
    base_radius_mm: Positive = _ROBOT.base_radius_mm
    """Radius of the circle of the limbs' base ends, 120 deg apart."""
    platform_radius_mm: Positive = _ROBOT.platform_radius_mm
    """Radius of the circle of their platform ends."""
    first_limb_deg: Angle = _ROBOT.first_limb_deg
    """Angle of the first limb on both circles, from the base's x towards its y."""
    base_joints_mm: Joints | None = _ROBOT.base_joints_mm
    """The limbs' base ends one by one (`b_i` of eq. 1) instead of a circle. [mm]"""
    platform_joints_mm: Joints | None = _ROBOT.platform_joints_mm
    """Their platform ends from its center (`a_i`), when the UP limb points along z. [mm]"""
    outer_axis: Vector = _ROBOT.outer_axis
    """Direction of the U joint's outer axis, fixed to the base. Not parallel to z; any length but 0. [1]"""
    wrist_length_mm: Positive = _ROBOT.wrist_length_mm
    """Distance along the UP limb from the platform's center to the wrist's center, the intersection of C and A."""
    tool_length_mm: Positive = _ROBOT.tool_length_mm
    """Distance from the wrist's center to the tool's tip."""
    c_zero_deg: Angle = _ROBOT.c_zero_deg
    """Reading of the machine's C when the A joint lies along the platform's u axis."""
    a_zero_deg: Angle = _ROBOT.a_zero_deg
    """Reading of the machine's A when the tool points along the UP limb."""
    a_branch: Branch = _ROBOT.a_branch
    """Sign of A at a path's first point. From there the branch is continuous."""
    stroke_mm: Range = _ROBOT.stroke_mm
    """Shortest and longest length of a limb. A pose beyond it is refused."""
    joint_height_mm: float = _ROBOT.joint_height_mm
    """Height of the U joint's center above height 0 of the workspace."""
    workspace_radius_mm: Positive = _ROBOT.workspace_radius_mm
    """Largest distance of the tip from the base's z axis. A pose beyond it is refused."""
    workspace_height_mm: Range = _ROBOT.workspace_height_mm
    """Lowest and highest tip position above height 0: `joint_height_mm` minus its z."""
    limb_stiffness_n_per_mm: Positive = _ROBOT.limb_stiffness_n_per_mm
    """Axial stiffness of a limb of any length."""
    limb_ea_n: Positive | None = _ROBOT.limb_ea_n
    """E A of a limb. Its stiffness is then this value divided by its length, and `limb_stiffness_n_per_mm` is not
    used."""
    up_bending_n_mm2: Positive = _ROBOT.up_bending_n_mm2
    """Bending stiffness E I of the UP limb."""
    up_torsion_n_mm2: Positive = _ROBOT.up_torsion_n_mm2
    """Torsional stiffness G J of the UP limb."""
    beam: Beam = _ROBOT.beam
    """Model of the UP limb: an Euler-Bernoulli beam whose U joint carries no moment, or the paper's eq. 6-8."""
    a_stiffness_n_mm_per_rad: Positive = _ROBOT.a_stiffness_n_mm_per_rad
    """Stiffness of the wrist's A joint about its axis."""
    c_stiffness_n_mm_per_rad: Positive = _ROBOT.c_stiffness_n_mm_per_rad
    """Stiffness of the wrist's C joint about its axis."""


class SerialSection(ConfigSection):
    """A six-axis arm."""

    type: Literal["serial"]
    dh: Annotated[tuple[Annotated[tuple[float, float, float, float], Tuple], ...], Tuple, Six]
    """Six Denavit-Hartenberg rows from base to flange: a, alpha, d, and theta at joint angle 0. [mm, deg, mm, deg]"""
    joint_stiffness_n_mm_per_rad: Annotated[tuple[Positive, ...], Tuple, Six]
    """Stiffness of each joint about its axis."""
    joint_limits_deg: Annotated[tuple[Range, ...], Tuple, Six]
    """Range of each joint. A pose beyond it is refused."""
    home_deg: Annotated[tuple[Angle, ...], Tuple, Six]
    """Joint angles at which the inverse kinematics starts. It takes the nearest branch."""
    tool_length_mm: Positive
    """Distance from the flange along its z to the tool's tip."""
    convention: DhConvention = "standard"
    """Convention of the rows: `modified` is Craig's."""
    flange_x: Vector = (1.0, 0.0, 0.0)
    """Direction in the base frame for the flange's x. The rotation about the tool's axis, which polishing leaves free,
    brings the flange's x as near to it as possible. [1]"""


class MeasuredSection(ConfigSection):
    """A measured robot: a table of compliance instead of a model."""

    type: Literal["measured"]
    table: Text
    """CSV file with the columns `x_mm, y_mm, z_mm` (tip, robot's base frame) and `compliance_um_per_n`. Values are
    linear between these points; a pose outside them is refused."""


def _kind_of_robot(value: Any) -> Any:
    """Return ``type``, which decides the other keys; the hybrid robot by default."""
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


class ComplianceSection(ConfigSection):
    """Evaluation of the robot's compliance (docs/explanation/robot.md)."""

    projection: Projection = SHIPPED_OPTIONS.projection
    """Projection of the compliance matrix to one number: the sum of each eigenvalue times the component of b along its
    eigenvector (eq. 43), the same with squared components, or b' C b, which a static loading test measures."""
    frame: NormalFrame = SHIPPED_OPTIONS.frame
    """The normal b: the nominal optic's, the path's binormal (eq. 34-38), or the tool's axis rotated back by the
    dip."""
    moment: Moment = SHIPPED_OPTIONS.moment
    """Compliance at the tip, or eq. 41, which neglects the moment of the force about the wrist."""
    dip_direction: DipDirection = SHIPPED_OPTIONS.dip_direction
    """Direction of the spindle's inclination: towards the base's z axis, fixed on the part, along the path or across
    it."""
    dip_azimuth_deg: Angle = SHIPPED_OPTIONS.dip_azimuth_deg
    """Direction for `fixed`, counter-clockwise from the part's x."""


def _cm2_per_n(value: Any) -> Any:
    """Convert a Preston constant with its unit, such as "1.49e-9 cm2/N", to cm2/N."""
    number, _, unit = str(value).strip().partition(" ")
    unit = re.sub(r"\s|\^", "", unit).replace("²", "2")
    try:
        found = float(number)
        if unit:
            return found * CM2_PER_N[unit]
    except (ValueError, KeyError):
        units = ", ".join(CM2_PER_N)
        raise ValueError(f"{value!r} is not a Preston constant; write a number and one of {units}") from None
    raise ValueError(f'{number} has no unit; write "{number} cm2/N", or another unit')


Preston = Annotated[
    float, BeforeValidator(_cm2_per_n), Field(gt=0, lt=1e-3, json_schema_extra={"range": "> 0, < 0.001 cm2/N"})
]
"""A Preston constant, cm2/N; with its unit in a file."""


LIMITS_OF_PROCESS = ("process.force_max_n",)
"""Keys of ``[process]`` that are limits: neither removal nor estimates depend on them."""
LEAST_FORCE_MARGIN_N = 2.0
FORCE_MARGIN = 1.5


class ContactKeys(ConfigSection):
    """Tool and contact of Hertz's and Preston's equations. The defaults are the paper's Table II."""

    tool_radius_mm: Positive = _TOOL.tool_radius_mm
    """Radius of the bonnet's sphere."""
    normal_force: NormalForce = _TOOL.normal_force
    """Force of the Hertz contact: the actuator's force, or that force divided by the cosine of the dip (eq. 44)."""
    preston: Preston = _TOOL.preston_cm2_per_n
    """Preston's constant with its unit, such as `"1.49e-9 cm2/N"`: cm2/N, mm2/N, m2/N, 1/Pa, 1/kPa, 1/MPa or 1/GPa.
    The estimated removal rate multiplies it from pass to pass. [as written]"""
    spot_offset_mm: Pair = _TOOL.spot_offset_mm
    """Position of the spot's center from the programmed point, in the tool's frame: y is the direction in which the
    spindle leans."""
    tool_modulus_mpa: Positive = _TOOL.tool_modulus_mpa
    """Young's modulus of the bonnet."""
    tool_poisson: Poisson = _TOOL.tool_poisson
    """Poisson's ratio of the bonnet. [1]"""
    part_modulus_mpa: Positive = _TOOL.part_modulus_mpa
    """Young's modulus of the part."""
    part_poisson: Poisson = _TOOL.part_poisson
    """Poisson's ratio of the part. [1]"""


class ProcessSection(ContactKeys):
    """Tool, contact and removal. The defaults are the paper's Table II and its main process."""

    removal_model: Text = "hertz_preston"
    """Name of the removal model of a plugin: `hertz_preston` computes a spot, `measured_tif` uses `tif`."""
    estimates: Text = "rate"
    """Quantities estimated from a pass. `rate`: the removal rate, or all parameters of a removal model with an
    estimator; `machine`: with polishd's models all parameters of identification
    (docs/explanation/identification.md): its field over the part, the spot's position and width, compliance, seat."""
    correction: Correction = "exact"
    """Correction of the dwell for the robot's compliance: none, point by point after the solution, by gamma (eq. 49),
    by gamma to the power `depth_exponent`, or by the spot at the depth of each point. Set `none` unless eq. 44 was
    measured on this machine (docs/explanation/correction.md)."""
    grid_mm: Annotated[float, Field(ge=0.01, le=20)] = 0.5
    """Pitch of the grid on which the dwell is solved. Use at most half of the raster's step; a coarser grid hides
    ripple of the lines. Time and memory grow with the inverse square of the pitch."""
    tif: Text | None = None
    """File of a measured TIF, made by `polishd calibrate tif`, for `removal_model = "measured_tif"`."""
    force_n: Force = _TOOL.force_n
    """Force along the actuator in contact."""
    force_max_n: Force | None = None
    """Largest force that any device may read in contact and while landing. One reading above it, or a rise that would
    exceed it before the next reading, makes the daemon leave contact at once. Left out: 1.5 times `force_n`, at least
    2 N above it."""
    rpm: Speed = _TOOL.rpm
    """Speed of the spindle in contact."""
    dip_deg: Dip = _TOOL.dip_deg
    """Angle between the spindle and the surface's normal. At 0 the contact's center does not slide."""
    depth_exponent: Annotated[float, Field(gt=0, le=4)] = _TOOL.depth_exponent
    """Exponent m of the correction `power`: removal is proportional to gamma to this power. 1.5 for Hertz, or the
    result of `polishd calibrate exponent`. [1]"""
    viscosity_mpa_s: NotNegative = _TOOL.viscosity_mpa_s
    """Shear viscosity of the bonnet, for the dissipative stress; 0: none."""
    second_viscosity_mpa_s: NotNegative = _TOOL.second_viscosity_mpa_s
    """Its second viscosity."""
    lame_mpa: Positive = _TOOL.lame_mpa
    """Lame's first constant of the bonnet, for the dissipative stress."""

    @property
    def most_force_n(self) -> float:
        """``force_max_n``, or its default."""
        if self.force_max_n is not None:
            return self.force_max_n
        return max(FORCE_MARGIN * self.force_n, self.force_n + LEAST_FORCE_MARGIN_N)

    @field_serializer("preston")
    def _with_unit(self, value: float) -> str:
        return f"{value!r} cm2/N"

    @model_validator(mode="after")
    def _has_its_tif(self) -> Self:
        if self.removal_model == "measured_tif" and self.tif is None:
            raise ValueError("tif: is missing; name a file of polishd calibrate tif for removal_model 'measured_tif'")
        return self


# From a section about a robot to the robot.


def robot_of(section: KinematicsSection, resolve: Callable[[str], Path]) -> RobotModel:
    """Return the robot's model; ``resolve`` finds its table. Raise ConfigError if the table cannot be read."""
    values = {name: value for name, value in section if name != "type"}
    if isinstance(section, HybridSection):
        return HybridRobot(**values)
    if isinstance(section, SerialSection):
        return SerialRobot(**values)
    return read_compliance_table(resolve(section.table))


# Base classes of files about a process, and about a part: their sections as inputs of the physics.


class ProcessDocument(TomlDocument):
    """A file about a process."""

    process: ProcessSection = ProcessSection()

    def tool_process(self) -> ToolProcess:
        """Return tool, contact and Preston constant."""
        shared = {item.name for item in fields(ToolProcess)} & set(ProcessSection.model_fields)
        values = {name: getattr(self.process, name) for name in shared}
        return ToolProcess(preston_cm2_per_n=self.process.preston, **values)


class PartDocument(ProcessDocument):
    """A file about a process on a part, by a robot."""

    part: PartSection
    kinematics: KinematicsSection = HybridSection()
    compliance: ComplianceSection = ComplianceSection()

    def robot_model(self) -> RobotModel:
        """Return the robot's geometry and stiffness; raise ConfigError if its table cannot be read."""
        return robot_of(self.kinematics, self.resolve)

    def compliance_options(self) -> ComplianceOptions:
        """Return the options of the compliance."""
        return ComplianceOptions(**dict(self.compliance))

    def outline(self) -> Outline:
        """Return the part's outline about its center; raise ConfigError if its file has none."""
        if self.part.polygon_file is None:
            return self.part.outline
        try:
            found = read_polygon(self.resolve(self.part.polygon_file))
        except ConfigError as error:
            raise self.error("part.polygon_file", str(error)) from error
        for wrong, problem in self.part.misfits(found):
            raise self.error(f"part.{wrong}", problem)
        return found

    def optic(self) -> Optic:
        """Return the nominal surface."""
        return Optic(self.part.curvature_radius_mm, self.part.conic, self.part.even, self.part.off_axis_mm)

    def placement(self) -> Placement:
        """Return the part's pose in the robot's base frame."""
        return Placement(self.part.origin_mm, rotation_from_rpy_deg(*self.part.rotation_rpy_deg))


# Several tools for one part: the keys of the cell's file that differ for each.


class ToolSection(ConfigSection):
    """A tool, `[tools.NAME]`. The tools polish one part in the order of the file (docs/how-to/tools.md).

    Keys that are left out have the values of `[process]`, `[kinematics]` and `[touch_off]`.
    """

    program: FileNames | None = None
    """The part program of its passes, or a list of programs that take turns. Left out: `program.path`."""
    passes: Annotated[int, Field(ge=1, le=100)] = 1
    """Number of its passes, each followed by a measurement, before the next tool. The last tool continues to the job's
    end. [1]"""
    change_s: NotNegative = 0.0
    """Machine time of the change to this tool, which counts in a plan's total."""
    position_mm: Positive | None = None
    """`touch_off.position_mm` with this tool."""
    tool_length_mm: Positive | None = None
    """`kinematics.tool_length_mm` with this tool."""
    removal_model: Text | None = None
    """`process.removal_model` with this tool, as all keys below."""
    tif: Text | None = None
    """File of its measured TIF."""
    tool_radius_mm: Positive | None = None
    """Radius of its sphere."""
    force_n: Force | None = None
    """Force on it."""
    force_max_n: Force | None = None
    """`process.force_max_n` with this tool."""
    rpm: Speed | None = None
    """Speed of the spindle."""
    dip_deg: Dip | None = None
    """Angle between the spindle and the surface's normal."""
    preston: Preston | None = None
    """Its Preston constant with unit. [as written]"""
    depth_exponent: Annotated[float, Field(gt=0, le=4)] | None = None
    """Exponent m of the correction `power`. [1]"""
    spot_offset_mm: Pair | None = None
    """Position of its spot's center from the programmed point."""
    tool_modulus_mpa: Positive | None = None
    """Its Young's modulus."""
    tool_poisson: Poisson | None = None
    """Its Poisson's ratio. [1]"""


ELSEWHERE = {
    "program": ("program", "path"),
    "position_mm": ("touch_off", "position_mm"),
    "tool_length_mm": ("kinematics", "tool_length_mm"),
}
"""Keys of a tool that replace keys outside of ``[process]``."""
OF_THE_TURN = ("passes", "change_s")


def tool_overlay(raw: Mapping[str, Any], source: TomlSource, name: str) -> tuple[dict[str, Any], TomlSource]:
    """Return the cell's values as written, with only that tool on its spindle, and their source."""
    values = copy.deepcopy(dict(raw))
    written = list[tuple[Location, Location]]()
    for key, value in values.pop("tools")[name].items():
        if key not in OF_THE_TURN:
            section, replaced = ELSEWHERE.get(key, ("process", key))
            values.setdefault(section, {})[replaced] = value
            written.append(((section, replaced), ("tools", name, key)))
    values.setdefault("estimates", {})["tool"] = name
    return values, replace(source, written_at=tuple(written))
