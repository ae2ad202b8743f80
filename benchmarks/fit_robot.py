"""The fit behind the default `HybridRobot`; run it again with ``python -m benchmarks.fit_robot``.

Published are the linear compliance over the workspace (fig. 10), the limbs' stroke and the workspace (Table I). Radii,
lengths and stiffnesses are not. The shipped geometry is taken: proportions that put the workspace into the stroke
except for its lower rim. The stiffnesses are fitted to the ends of the compliance's range. Two figures do not determine
five stiffnesses: each is held near an engineer's guess, as far as the range leaves it free. In effect the limbs' and
A's are fitted, and the others are guesses.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import optimize

from polishd.model.process import HybridRobot, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.robot.compliance import depth_ratio, equivalent_compliance, reachable, tip_compliance_mm_per_n
from polishd.process.robot.hybrid import geometry_of, solve_pose

PUBLISHED_UM_PER_N = np.array([1.04, 1.97])
ROUNDING_UM_PER_N = 0.005
GUESS: dict[str, Any] = {
    "limb_stiffness_n_per_mm": 20e3,  # ball screw and two joints
    "up_bending_n_mm2": 4.4e12,  # steel tube, 160 mm over 120 mm
    "up_torsion_n_mm2": 1.5e12,  # less than half of the tube's, for its sliding key
    "a_stiffness_n_mm_per_rad": 5e7,  # geared drives
    "c_stiffness_n_mm_per_rad": 9e7,
}
GUESSED_WITHIN = 0.3
"""Standard deviation of a guess's logarithm."""
PROCESS = ToolProcess()


@dataclass(frozen=True)
class Sample:
    """Poses of the workspace."""

    tip_mm: FloatArray
    axis: FloatArray
    out_of_stroke: int
    """Number of further points that longer limbs would reach."""


def main() -> int:
    """0 if both the fitted and the shipped robot have the published range within its rounding."""
    sample = workspace(25)
    shipped = HybridRobot()
    fitted = fit(dataclasses.replace(shipped, **GUESS), sample)
    table = Table("", "guess", "fitted", "shipped")
    for name, guess in GUESS.items():
        table.add_row(name, f"{guess:.3g}", *(f"{getattr(robot, name):.3g}" for robot in (fitted, shipped)))
    robots = (dataclasses.replace(shipped, **GUESS), fitted, shipped)
    ranges = [range_um_per_n(robot, sample) for robot in robots]
    table.add_row("compliance, um/N (published 1.04-1.97)", *(f"{low:.3f}-{high:.3f}" for low, high in ranges))
    table.add_row("gamma", *("{:.3f}-{:.3f}".format(*gamma(limits)) for limits in ranges))
    Console().print(table)
    limb = solve_pose(shipped, geometry_of(shipped), sample.tip_mm.T, sample.axis.T).parallel.limb_mm
    low, high = shipped.stroke_mm
    Console().print(f"limbs {limb.min():.0f}-{limb.max():.0f} mm (published stroke {low:g}-{high:g})")
    whole = len(sample.tip_mm) + sample.out_of_stroke
    Console().print(f"{sample.out_of_stroke} of {whole} points of the workspace are out of stroke, and not counted")
    return int(any(np.abs(np.subtract(limits, PUBLISHED_UM_PER_N)).max() > ROUNDING_UM_PER_N for limits in ranges[1:]))


def fit(start: HybridRobot, sample: Sample) -> HybridRobot:
    """The stiffnesses that give the published range, near those of ``start``."""
    names = list(GUESS)
    guess = np.array([getattr(start, name) for name in names])

    def robot(change: FloatArray) -> HybridRobot:
        stiffnesses: dict[str, Any] = dict(zip(names, (guess * np.exp(change)).tolist(), strict=True))
        return dataclasses.replace(start, **stiffnesses)

    def misses(change: FloatArray) -> FloatArray:
        off = (range_um_per_n(robot(change), sample) - PUBLISHED_UM_PER_N) / ROUNDING_UM_PER_N
        return np.concatenate([off, change / GUESSED_WITHIN])

    return robot(optimize.least_squares(misses, np.zeros(len(names)), diff_step=1e-4).x)


def range_um_per_n(robot: HybridRobot, sample: Sample) -> FloatArray:
    """Return least and greatest linear compliance along the vertical, at the process's dip."""
    matrix = tip_compliance_mm_per_n(robot, sample.tip_mm, sample.axis)
    up = np.tile([0.0, 0.0, -1.0], (len(matrix), 1))
    compliance = equivalent_compliance(matrix, sample.axis, up) * 1e3
    return np.array([compliance.min(), compliance.max()])


def gamma(limits_um_per_n: FloatArray) -> FloatArray:
    """Return the share of the contact's depth that is left, least first."""
    return np.sort(depth_ratio(limits_um_per_n / 1e3, PROCESS, float(hertz_depth_mm(PROCESS))))


def workspace(n: int) -> Sample:
    """n x n x n points of Table I's cylinder, the spindle leaning inward; on the base's z axis in all directions."""
    robot, dip = HybridRobot(), np.radians(PROCESS.dip_deg)
    grid = np.linspace(-robot.workspace_radius_mm, robot.workspace_radius_mm, n)
    x, y, height = (a.ravel() for a in np.meshgrid(grid, grid, np.linspace(*robot.workspace_height_mm, n)))
    radius = np.hypot(x, y)
    ring = (radius > 0) & (radius <= robot.workspace_radius_mm)
    inward = -np.stack([x, y], axis=1)[ring] / radius[ring][:, None]
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    heights, way = (a.ravel() for a in np.meshgrid(np.linspace(*robot.workspace_height_mm, n), around))
    tip = np.vstack([np.stack([x, y, height], axis=1)[ring], np.stack([0 * heights, 0 * heights, heights], axis=1)])
    lean = np.vstack([inward, np.stack([np.cos(way), np.sin(way)], axis=1)]) * np.sin(dip)
    tip[:, 2] = robot.joint_height_mm - tip[:, 2]
    axis = np.column_stack([lean, np.full(len(tip), -np.cos(dip))])
    reach = reachable(robot, tip, axis)
    return Sample(tip[reach], axis[reach], int((~reach).sum()))


if __name__ == "__main__":
    sys.exit(main())
