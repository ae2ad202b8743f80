"""The equivalent compliance over the workspace (paper fig. 10): what a place of the cell is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.process import ComplianceOptions, Placement, ToolProcess
from polishd.model.robot import HybridRobot, MeasuredCompliance, RobotModel
from polishd.model.surface import FloatArray
from polishd.process import frames
from polishd.process.compliance import complex_eigenvalues, equivalent_compliance
from polishd.process.contact import hertz_depth_mm
from polishd.process.robot import reachable, tip_compliance_mm_per_n
from polishd.process.robot.measured import measured_compliance, measured_reachable

AROUND_MM = 300.0
"""Half the side of the cube about the part that stands for the workspace of a robot which states none."""


@dataclass(frozen=True, slots=True)
class ComplianceField:
    """Equivalent compliance and gamma on horizontal planes through the workspace, NaN where there is none."""

    x_mm: FloatArray
    """(nx,) base frame, ascending."""
    y_mm: FloatArray
    """(ny,) base frame, ascending."""
    z_mm: FloatArray
    """(nz,) base frame, one a plane."""
    compliance_um_per_n: FloatArray
    """(nz, ny, nx)."""
    gamma: FloatArray
    """(nz, ny, nx); not above 0 where the robot gives way by more than the contact's depth."""
    places: int
    """Samples within the workspace."""
    out_of_reach: int
    """Those of them that the robot cannot reach: out of stroke or limits, singular."""
    undefined: int
    """Those that it reaches, but at which eq. 41 as printed has complex eigenvalues."""


def compliance_field(
    robot: RobotModel,
    process: ToolProcess,
    placement: Placement,
    options: ComplianceOptions,
    *,
    planes: int = 5,
    across: int = 67,
) -> ComplianceField:
    """Sample the workspace at ``across`` x ``across`` places on each of ``planes``, for a flat part held like this one.

    The tool is dipped as the options ask for; along or across the path means along or across the part's x, for want of
    a path. The workspace is that of the hybrid robot's limits, a cube about the part for a serial arm, and the box of
    the measured places for a table.
    """
    x, y, z = _axes(robot, placement, planes, across)
    tip = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    inside = _inside(robot, tip)
    value, undefined = np.full(len(tip), np.nan), 0
    if isinstance(robot, MeasuredCompliance):
        can = measured_reachable(robot, tip)
        value[can] = measured_compliance(robot, tip[can])
    else:
        can = inside & _has_lean(options, tip)
        normal = np.repeat(frames.surface_normals(placement, np.zeros((1, 3))), len(tip), axis=0)
        axis = np.zeros_like(tip)
        axis[can] = frames.dipped_axes(_without_path(options), placement, tip[can], normal[can], process.dip_deg)
        can[can] = reachable(robot, tip[can], axis[can])
        matrix = tip_compliance_mm_per_n(robot, tip[can], axis[can], moment=options.moment)
        complex_ones = complex_eigenvalues(matrix) if options.moment == "paper" else np.zeros(len(matrix), np.bool_)
        undefined, at = int(complex_ones.sum()), np.flatnonzero(can)[~complex_ones]
        value[at] = equivalent_compliance(matrix[~complex_ones], axis[at], normal[at], options.projection)
    gamma = 1 - value * process.force_n / np.cos(np.radians(process.dip_deg)) / hertz_depth_mm(process)
    shape = (len(z), len(y), len(x))
    places = int(inside.sum())
    return ComplianceField(
        x, y, z, value.reshape(shape) * 1e3, gamma.reshape(shape), places, places - int(can.sum()), undefined
    )


def _axes(
    robot: RobotModel, placement: Placement, planes: int, across: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if isinstance(robot, HybridRobot):
        reach = robot.workspace_radius_mm
        low, high = (robot.joint_height_mm - height for height in robot.workspace_height_mm[::-1])
        return np.linspace(-reach, reach, across), np.linspace(-reach, reach, across), np.linspace(low, high, planes)
    if isinstance(robot, MeasuredCompliance):
        lows, highs = robot.tip_mm.min(axis=0), robot.tip_mm.max(axis=0)
    else:
        centre = np.asarray(placement.origin_mm)
        lows, highs = centre - AROUND_MM, centre + AROUND_MM
    x, y, z = (np.linspace(a, b, n) for a, b, n in zip(lows, highs, (across, across, planes), strict=True))
    return x, y, np.unique(z)


def _inside(robot: RobotModel, tip_mm: FloatArray) -> np.ndarray:
    """(n,) True within the workspace: the hybrid robot's is a cylinder."""
    if isinstance(robot, HybridRobot):
        return np.asarray(np.hypot(tip_mm[:, 0], tip_mm[:, 1]) <= robot.workspace_radius_mm)
    return np.ones(len(tip_mm), dtype=np.bool_)


def _has_lean(options: ComplianceOptions, tip_mm: FloatArray) -> np.ndarray:
    """(n,) False on the base's z axis, where inward has no direction."""
    return np.asarray((options.dip_direction != "inward") | (np.hypot(tip_mm[:, 0], tip_mm[:, 1]) > 1e-6))


def _without_path(options: ComplianceOptions) -> ComplianceOptions:
    azimuth = {"along": 0.0, "across": 90.0}.get(options.dip_direction)
    return options if azimuth is None else ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=azimuth)
