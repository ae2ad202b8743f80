"""Compliance and gamma of a long program: ours, and numpy's batched inverse of as many 6 x 6 matrices."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.harness import Progress, Row, peak_mb, race
from polishd.model.process import HybridRobot, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.robot.compliance import depth_ratio, equivalent_compliance, reachable, tip_compliance_mm_per_n

POSES = 160_000
MOST_MB = 2000.0
ROBOT, PROCESS = HybridRobot(), ToolProcess()


def rows(progress: Progress) -> Iterator[Row]:
    """CPU and memory; the inverses are a lower bound for any method with 6 x 6 stiffness matrices."""
    progress("compliance: preparing poses")
    tip, axis = poses()
    normal = np.tile([0.0, 0.0, -1.0], (POSES, 1))
    ours = partial(gamma, tip, axis, normal, float(hertz_depth_mm(PROCESS)))
    inverse = partial(np.linalg.inv, np.random.default_rng(1).standard_normal((POSES, 6, 6)))
    name, peer = f"compliance and gamma, {POSES} poses", "numpy batched inverse of 6x6"
    yield race(name, ours, {peer: inverse}, progress=progress)
    memory = Row(f"{name}, memory", peak_mb(ours), {peer: peak_mb(inverse)}, "MB")
    if memory.ours > MOST_MB:
        raise RuntimeError(f"{memory.ours:.0f} MB are more than {MOST_MB:g} MB")
    yield memory


def gamma(tip_mm: FloatArray, axis: FloatArray, normal: FloatArray, depth_mm: float) -> FloatArray:
    matrix = tip_compliance_mm_per_n(ROBOT, tip_mm, axis, path=True)
    return depth_ratio(equivalent_compliance(matrix, axis, normal), PROCESS, depth_mm)


def poses() -> tuple[FloatArray, FloatArray]:
    """A raster of 1 mm over 400 x 400 mm beside the base's z axis, the spindle leaning inward by the process's dip."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(400.0) - 200, np.arange(400.0) + 100))
    tip = np.stack([x, y, np.full(POSES, 2100.0)], axis=1)
    dip = np.radians(PROCESS.dip_deg)
    lean = -tip[:, :2] / np.hypot(x, y)[:, None] * np.sin(dip)
    axis = np.column_stack([lean, np.full(POSES, -np.cos(dip))])
    if not reachable(ROBOT, tip, axis).all():
        raise RuntimeError("the raster is out of the robot's reach")
    return tip, axis
