"""The moving part of any simulated robot: its hidden truth, its reach, and what it tells the plant of its motion."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from polishd.model.robot import MeasuredCompliance
from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends import truth
from polishd.sim_backends.bus import ROW
from polishd.sim_backends.faults.override import SpeedOverride
from polishd.sim_backends.mechanics import Reaching
from polishd.sim_backends.placement import Frames
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.path import Limits
from polishd.sim_backends.robot.rnc import SimProgramBlock
from polishd.sim_backends.runtime import SimRuntime


class SimRobotBody:
    """What a controller orders."""

    def __init__(self, runtime: SimRuntime) -> None:
        start, robot = runtime.start, runtime.start.config.robot
        hidden = truth.draw(start.config.truth, start.seed)
        limits = Limits(
            accel_mm_s2=hidden.accel_mm_s2,
            overhead_s=hidden.overhead_s,
            corner_deg=robot.corner_deg,
            rapid_mm_s=robot.rapid_mm_s,
            max_feed_mm_s=robot.max_feed_mm_s,
            speed=start.speed,
        )
        x, y, z, a, c = runtime.link.welcome.get("pose") or robot.home
        self.motion = SimMotion(limits, (x, y, z, a, c))
        self._runtime = runtime
        self._override = SpeedOverride()
        runtime.script.suffer = self._override.suffer
        self.blocks_of: Callable[[FloatArray], FloatArray] = lambda blocks: blocks
        """The program's blocks (n,) of the motion's, where the controller's file has more lines."""
        self._frames = Frames(start.config.plant)
        model = start.config.robot_model()
        self._reaching = None if isinstance(model, MeasuredCompliance) else Reaching(model)

    def set_pace(self, now_s: float) -> None:
        """Move from now on as fast as the faults of the script allow, and tell the plant."""
        pace = self._override.actual(now_s)
        if pace != self.motion.pace:
            self.motion.set_pace(now_s, pace)
            self._runtime.link.pace(pace, now_s)
        self.motion.reported_pace = self._override.reported(now_s)

    def reach(self, blocks: list[SimProgramBlock]) -> BoolArray:
        """Which blocks end where the robot can be; of one that was only measured nobody knows."""
        poses = np.array([block.end for block in blocks]).reshape(-1, 5)
        if self._reaching is None:
            return np.ones(len(poses), dtype=np.bool_)
        return self._reaching.reached(*self._frames.in_base(*self._frames.in_part(poses)))

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Tell the witness, after the motion that came before."""
        self.report()
        self._runtime.link.event(name, at_s, **data)

    def report(self) -> None:
        """Send what moved since the last time, and vouch for it."""
        motion = self.motion
        now = time.monotonic()
        motion.advance(now)
        rows = np.concatenate(motion.rows) if motion.rows else np.zeros((0, len(ROW)))
        motion.rows.clear()
        mark = now
        if motion.state == "running" and len(rows):
            mark = float(rows[-1, 2])
        rows[:, 0] = self.blocks_of(rows[:, 0])
        self._runtime.link.rows(rows, mark, motion.pose)
