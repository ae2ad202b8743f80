"""The robot's compliance along a program's path, in the direction of the surface normal (paper eq. 34-44)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, SHIPPED_OPTIONS, ComplianceOptions, Optic, Placement, ToolProcess
from polishd.model.program import Program
from polishd.model.robot import MeasuredCompliance, RobotModel
from polishd.model.surface import FloatArray
from polishd.process import frames
from polishd.process.compliance import equivalent_compliance, jumps
from polishd.process.robot import measured_compliance, tip_compliance_mm_per_n
from polishd.process.robot.refusal import refuse_where, require_unit_vectors, require_vectors

DIP_TOLERANCE_DEG = 0.5
"""How far the program's tool axis may be from the dip that the process states."""


@dataclass(frozen=True, slots=True)
class PathCompliance:
    """Linear equivalent compliance at n timed points, and how sure it is."""

    compliance_mm_per_n: FloatArray
    """(n,) mm/N."""
    jumps: int
    """Neighbours between which the projection jumps and the robot does not (see `compliance.jumps`)."""
    fallbacks: int
    """Points at which the path has no Frenet frame, and the surface normal was taken."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of it."""
        n = len(self.compliance_mm_per_n)
        found = []
        if self.jumps:
            found.append(
                f"the linear equivalent compliance jumps {self.jumps} times by over 5 % where the robot's does not"
            )
        if self.fallbacks:
            found.append(f"no Frenet frame at {self.fallbacks} of {n} points (straight path): surface normal taken")
        return tuple(found)


def path_compliance(
    program: Program,
    process: ToolProcess,
    robot: RobotModel,
    placement: Placement,
    *,
    options: ComplianceOptions = SHIPPED_OPTIONS,
    optic: Optic = FLAT,
) -> PathCompliance:
    """Linear equivalent compliance at the timed points of a program in the part's frame.

    The pose is the block's middle with the axis at its end. Raises ComputeError for a point that is out of reach or
    whose axis is not dipped as the process says.
    """
    start = require_vectors("start of block", program.start_mm, "mm")
    end = require_vectors("end of block", program.end_mm, "mm")
    if not len(start) == len(end) == len(program.axis):
        raise ComputeError(f"the program has {len(start)} starts, {len(end)} ends and {len(program.axis)} axes")
    middle = (start + end) / 2
    return compliance_at(middle, program.axis, process, robot, placement, options=options, optic=optic)


def compliance_at(
    point_mm: FloatArray,
    axis: FloatArray,
    process: ToolProcess,
    robot: RobotModel,
    placement: Placement,
    *,
    options: ComplianceOptions = SHIPPED_OPTIONS,
    optic: Optic = FLAT,
) -> PathCompliance:
    """The same at points along a path: (n, 3) tool tips, mm, and (n, 3) unit tool axes, both in the part's frame."""
    tip = frames.points_to_base(placement, point_mm)
    base_axis = frames.directions_to_base(placement, require_unit_vectors("tool axis", axis))
    surface = frames.surface_normals(placement, point_mm, optic)
    dip = frames.dips_deg(base_axis, surface)
    off = ~(np.abs(dip - process.dip_deg) <= DIP_TOLERANCE_DEG)
    refuse_where(off, dip, "the program's tool axis is dipped: the dip", "deg", f"the process says {process.dip_deg:g}")
    if isinstance(robot, MeasuredCompliance):
        return PathCompliance(measured_compliance(robot, tip), 0, 0)
    normal, fallbacks = _normals(options, placement, process.dip_deg, tip=tip, axis=base_axis, surface=surface)
    matrix = tip_compliance_mm_per_n(robot, tip, base_axis, moment=options.moment, path=True)
    compliance = equivalent_compliance(matrix, base_axis, normal, options.projection)
    return PathCompliance(compliance, int(jumps(compliance, matrix).sum()), fallbacks)


def _normals(
    options: ComplianceOptions,
    placement: Placement,
    dip_deg: float,
    *,
    tip: FloatArray,
    axis: FloatArray,
    surface: FloatArray,
) -> tuple[FloatArray, int]:
    """(n, 3) unit normals b that the options ask for, base frame, and at how many points it fell back."""
    if options.frame == "surface":
        return surface, 0
    if options.frame == "frenet":
        binormal, defined = frames.frenet_binormals(tip)
        facing = np.where(np.einsum("ni,ni->n", binormal, surface) < 0, -1.0, 1.0)
        return np.where(defined[:, None], binormal * facing[:, None], surface), int((~defined).sum())
    lean = frames.lean_directions(options, placement, tip, surface)
    return frames.turned_back(axis, lean, dip_deg), 0
