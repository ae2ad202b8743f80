"""Leaving the path along the tool's axis: a trapezoid of its own, laid over what the path still does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.sim_backends.placement import tool_axis
from polishd.sim_backends.robot.rnc import Pose

STEP_S = 0.002


@dataclass(frozen=True, slots=True)
class Lift:
    """From rest to rest over a distance, from ``begin_s`` of the process clock on."""

    begin_s: float
    distance_mm: float
    accel_mm_s2: float
    speed_mm_s: float

    @property
    def end_s(self) -> float:
        """When it stands."""
        up_s, cruise_s = self._phases()
        return self.begin_s + 2.0 * up_s + cruise_s

    def offset_mm(self, process_s: FloatArray) -> FloatArray:
        """How far off the path it is, (n,)."""
        up_s, cruise_s = self._phases()
        t = np.clip(process_s - self.begin_s, 0.0, 2.0 * up_s + cruise_s)
        down_s = np.maximum(t - up_s - cruise_s, 0.0)
        top = self.accel_mm_s2 * up_s
        rising = 0.5 * self.accel_mm_s2 * np.minimum(t, up_s) ** 2
        return np.asarray(rising + top * np.maximum(t - up_s, 0.0) - 0.5 * self.accel_mm_s2 * down_s**2)

    def poses(self, path: FloatArray, process_s: FloatArray) -> FloatArray:
        """Poses of the path (n, 5) at those times (n,), lifted along their own tool axes."""
        axis = tool_axis(path[:, 3], path[:, 4])
        return np.column_stack([path[:, :3] + axis * self.offset_mm(process_s)[:, None], path[:, 3:]])

    def _phases(self) -> tuple[float, float]:
        """Seconds of acceleration, and at full speed."""
        up_s = min(self.speed_mm_s / self.accel_mm_s2, math.sqrt(self.distance_mm / self.accel_mm_s2))
        cruise_mm = self.distance_mm - self.accel_mm_s2 * up_s**2
        return up_s, max(cruise_mm, 0.0) / (self.accel_mm_s2 * up_s)


def standing(seq: int, pose: Pose, since_s: float, until_s: float) -> FloatArray:
    """Rows (n, 8) of a tool that stands on its path: seq, from_s, to_s and its pose."""
    edges = np.linspace(since_s, until_s, max(math.ceil((until_s - since_s) / STEP_S), 1) + 1)
    count = len(edges) - 1
    return np.column_stack([np.full(count, float(seq)), edges[:-1], edges[1:], np.tile(pose, (count, 1))])
