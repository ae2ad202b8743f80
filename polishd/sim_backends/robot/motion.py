"""Execution: the controller's process clock, its blocks, the tool's position. Pure of I/O; the caller passes times."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from polishd.model.process import MeasuredCompliance
from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.common.hidden_truth import Frames, tool_axis
from polishd.sim_backends.common.mechanics import Reaching
from polishd.sim_backends.common.runtime import ROW, SimRuntime
from polishd.sim_backends.robot.program_reader import Pose, SimProgramBlock
from polishd.sim_backends.robot.trajectory import DWELL, PAUSE, BlockColumns, Cursor, Legs, Limits, braking, plan, rows

# Leaving the path along the tool's axis: a separate trapezoid, added to the remaining motion on the path.

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
        """Time of its standstill."""
        up_s, cruise_s = self._phases()
        return self.begin_s + 2.0 * up_s + cruise_s

    def offset_mm(self, process_s: FloatArray) -> FloatArray:
        """(n,) distance from the path."""
        up_s, cruise_s = self._phases()
        t = np.clip(process_s - self.begin_s, 0.0, 2.0 * up_s + cruise_s)
        down_s = np.maximum(t - up_s - cruise_s, 0.0)
        top = self.accel_mm_s2 * up_s
        rising = 0.5 * self.accel_mm_s2 * np.minimum(t, up_s) ** 2
        return np.asarray(rising + top * np.maximum(t - up_s, 0.0) - 0.5 * self.accel_mm_s2 * down_s**2)

    def poses(self, path: FloatArray, process_s: FloatArray) -> FloatArray:
        """Return poses of the path (n, 5) at those times (n,), lifted along their own tool axes."""
        axis = tool_axis(path[:, 3], path[:, 4])
        return np.column_stack([path[:, :3] + axis * self.offset_mm(process_s)[:, None], path[:, 3:]])

    def _phases(self) -> tuple[float, float]:
        """Seconds of acceleration, and at full speed."""
        up_s = min(self.speed_mm_s / self.accel_mm_s2, math.sqrt(self.distance_mm / self.accel_mm_s2))
        cruise_mm = self.distance_mm - self.accel_mm_s2 * up_s**2
        return up_s, max(cruise_mm, 0.0) / (self.accel_mm_s2 * up_s)


def standing(seq: int, pose: Pose, since_s: float, until_s: float) -> FloatArray:
    """Rows (n, 8) of a tool at standstill on its path: seq, from_s, to_s and its pose."""
    edges = np.linspace(since_s, until_s, max(math.ceil((until_s - since_s) / STEP_S), 1) + 1)
    count = len(edges) - 1
    return np.column_stack([np.full(count, float(seq)), edges[:-1], edges[1:], np.tile(pose, (count, 1))])


State = Literal["idle", "held", "running", "done"]


@dataclass(slots=True)
class SimMotion:
    """The executor. ``advance(wall)`` runs it up to the present; ``rows`` and ``executed`` collect the results."""

    limits: Limits
    pose: Pose
    state: State = "idle"
    detail: str = ""
    path: BlockColumns = field(init=False)
    until: int | None = None
    rows: list[FloatArray] = field(default_factory=list)
    """Motion since the rows were last taken, see ``bus.ROW``."""
    executed: list[tuple[int, float, float]] = field(default_factory=list)
    """(seq, start_s, end_s) of every executed block of the program."""
    stopping: str = ""
    changed_s: float = 0.0
    """Wall time of the last start or stop."""
    process_s: float = 0.0
    """The controller's process clock; it runs while the state is running, at any speed of the tool."""
    pace: float = 1.0
    """Speed of the motion as a fraction of the planned one; 0: standstill, and the state stays running."""
    reported_pace: float = 1.0
    """Speed override that the controller reports, as a fraction."""
    _legs_s: float = 0.0
    """Time of the planned motion, scaled by the pace."""
    _cursor: Cursor = field(default_factory=Cursor)
    _legs: Legs = field(init=False)
    _leg: int = 0
    _stale: bool = False
    """Blocks were accepted that the legs do not contain yet."""
    _begun_s: float | None = None
    _origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Wall time, process time and time of the planned motion at the last change of the pace."""
    _lift: Lift | None = None
    """A lift is under way or done: the program cannot continue."""

    def __post_init__(self) -> None:
        """Start without a program."""
        self.forget()

    def load(self, program: int | BlockColumns) -> None:
        """Drop the old program; expect block 0 of a new one of so many, or take one whose blocks are there."""
        self.path = program if isinstance(program, BlockColumns) else BlockColumns(program, self.pose, self.limits)
        self._cursor, self._begun_s = Cursor(), None
        self.executed, self.until, self.stopping, self._lift = [], None, "", None
        self._plan()
        self.state, self.detail = "held", "loaded"

    def forget(self) -> None:
        """Drop the program."""
        self.load(0)
        self.state, self.detail = "idle", ""

    def append(self, wall_s: float, blocks: Sequence[SimProgramBlock]) -> None:
        """Take blocks; the profile of the motion ahead is computed on demand."""
        self.advance(wall_s)
        self.path.append(blocks)
        self._stale = not self.stopping

    def resume(self, wall_s: float, until: int | None) -> None:
        """Run, to the end or up to ``until``."""
        self.advance(wall_s)
        self.until = until
        if self.state == "done":
            return
        if until is not None and until <= self._cursor.block:
            self.hold(wall_s, "until")
            return
        self.stopping, self.detail = "", ""
        if self.state != "running":
            self.state = "running"
            self._origin, self.changed_s = (wall_s, self.process_s, self._legs_s), wall_s
        self._plan()
        self.advance(wall_s)

    def set_pace(self, wall_s: float, pace: float) -> None:
        """Continue at another speed from now on: a speed override, or 0 for standstill."""
        if pace == self.pace:
            return
        self.advance(wall_s)
        self._origin, self.pace = (wall_s, self.process_s, self._legs_s), pace
        if pace == 0.0 and self.stopping and not self.lifted:
            self._brake(self.stopping)  # already at standstill

    def hold(self, wall_s: float, why: str) -> None:
        """Decelerate along the path to standstill."""
        self.advance(wall_s)
        if self.state == "held":
            self.detail = why
        if self.state != "running" or self.stopping:
            return
        self._brake(why)
        self.advance(wall_s)

    def lift(self, wall_s: float, distance_mm: float) -> None:
        """Leave the path along the tool's axis while it still moves, and stop there."""
        self.advance(wall_s)
        if self.lifted:
            return
        if self.state != "running":
            self._origin = (wall_s, self.process_s, self._legs_s)
            self.state, self.changed_s = "running", wall_s
        if not self.stopping:
            self._brake("lift")
        limits = self.limits
        self.stopping = "lift"
        self._lift = Lift(self._legs_s, distance_mm, limits.accel_mm_s2, limits.rapid_mm_s)
        self.advance(wall_s)

    @property
    def lifted(self) -> bool:
        """True while it leaves its path, and afterwards."""
        return self._lift is not None

    def _brake(self, why: str) -> None:
        self.stopping = why
        if self.pace == 0.0:
            self._cursor.speed = 0.0  # already at standstill
        if self._cursor.block < self.path.accepted:
            self._legs, self._leg = braking(self.path, self._cursor, self._legs_s), 0

    def advance(self, wall_s: float) -> None:
        """Execute up to the present."""
        if self.state != "running":
            return
        legs, since = self._planned(), (self.process_s, self._legs_s)
        process_s = max(self._origin[1] + (wall_s - self._origin[0]) * self.limits.speed, since[0])
        now = max(self._origin[2] + (process_s - self._origin[1]) * self.pace, since[1])
        end = float(legs.end_s[legs.stop]) if legs.stop >= 0 else since[1]
        if self._lift is not None:
            end = max(end, self._lift.end_s)
        self._legs_s = min(now, end)
        ends = now >= end
        self.process_s = float(self._process_at(np.array(self._legs_s))) if self.pace and ends else process_s
        reached, first = legs.reached(self._legs_s), self._leg
        self._complete(legs, reached)
        self._witness(legs, (first, reached), since)
        if ends and reached > legs.stop:
            self._stop()

    def _process_at(self, legs_s: FloatArray) -> FloatArray:
        """Process time at times of the planned motion (n,), since the last change of the pace."""
        _, process_s, since = self._origin
        return process_s + (legs_s - since) / self.pace if self.pace else np.full_like(legs_s, process_s)

    def wall_at(self, process_s: FloatArray) -> FloatArray:
        """Wall time at process times (n,) since motion began, continued, or changed its pace."""
        return self._origin[0] + (process_s - self._origin[1]) / self.limits.speed

    @property
    def waits(self) -> bool:
        """The block under way is a dwell."""
        block = self._cursor.block
        return block < self.path.accepted and bool(self.path.kind[block] == DWELL)

    @property
    def accepted(self) -> int:
        """Number of accepted blocks."""
        return self.path.accepted

    @property
    def ahead_s(self) -> float:
        """Wall seconds of motion that are accepted and not executed."""
        legs = self._planned()
        if not len(legs.end_s):
            return 0.0
        return max(float(legs.end_s[-1]) - self._legs_s, 0.0) / self.limits.speed

    def _planned(self) -> Legs:
        if self._stale:
            self._plan()
        return self._legs

    def _plan(self) -> None:
        self._legs = plan(self.path, self._cursor, self._legs_s, self.until)
        self._leg, self._stale = 0, False

    def _witness(self, legs: Legs, run: tuple[int, int], since: tuple[float, float]) -> None:
        """Book the motion since those process and motion times."""
        if self.process_s <= since[0]:
            return
        if self.pace == 0.0:
            block = min(self._cursor.block, max(self.path.blocks - 1, 0))
            cut = standing(block, self.pose, since[0], self.process_s)
        else:
            cut = rows(self.path, legs, *run, (since[1], self._legs_s))
            if self._lift is not None:
                cut = self._off_the_path(cut, since[1])
            cut[:, 1:3] = self._process_at(cut[:, 1:3])
        if not len(cut):
            return
        times = self.wall_at(cut[:, 1:3])
        self.rows.append(np.column_stack([cut[:, 0], times, cut[:, 2] - cut[:, 1], cut[:, 3:]]))

    def _off_the_path(self, cut: FloatArray, since: float) -> FloatArray:
        """Motion on the path, and the rest of the lift after it, both lifted."""
        lift = self._lift
        if lift is None:
            return cut
        stood = float(cut[-1, 2]) if len(cut) else since
        if stood < self._legs_s:
            block = min(self._cursor.block, max(self.path.blocks - 1, 0))
            cut = np.vstack([cut.reshape(-1, 8), standing(block, self._where(), stood, self._legs_s)])
        return np.column_stack([cut[:, :3], lift.poses(cut[:, 3:], cut[:, 1:3].mean(axis=1))])

    def _complete(self, legs: Legs, reached: int) -> None:
        for k in range(self._leg, reached):
            if self._begun_s is None:
                self._begun_s = float(self._process_at(legs.start_s[k]))
            if legs.completes[k]:
                ended_s = float(self._process_at(legs.end_s[k])) if self.pace else self.process_s
                self.executed.append((int(legs.block[k]), self._begun_s, ended_s))
                self._cursor, self._begun_s = Cursor(int(legs.block[k]) + 1), None
        self._leg = reached
        if reached <= legs.stop:
            if self._begun_s is None:
                self._begun_s = float(self._process_at(legs.start_s[reached]))
            done_mm, done_s, speed = legs.state(reached, self._legs_s)
            self._cursor = Cursor(int(legs.block[reached]), done_mm, done_s, speed)
        elif reached and not legs.completes[reached - 1]:
            done_mm, done_s, _ = legs.state(reached - 1, self._legs_s)
            self._cursor = Cursor(int(legs.block[reached - 1]), done_mm, done_s)
        self.pose = self._where()
        if self._lift is not None:
            x, y, z, a, c = self._lift.poses(np.array([self.pose]), np.array([self._legs_s]))[0].tolist()
            self.pose = (x, y, z, a, c)

    def _where(self) -> Pose:
        block = self._cursor.block
        if block >= self.path.accepted:
            pose = self.path.pose[block]
        else:
            total = self.path.length[block]
            share = min(self._cursor.done_mm / total, 1.0) if total > 0.0 else 0.0
            pose = self.path.pose[block] + (self.path.pose[block + 1] - self.path.pose[block]) * share
        x, y, z, a, c = (float(value) for value in pose)
        return (x, y, z, a, c)

    def _stop(self) -> None:
        """End the motion: record the reason of the standstill."""
        done = self._cursor.block
        if done >= self.path.blocks and not self.lifted:
            self.state, self.detail = "done", ""
        elif self.stopping:
            self.state, self.detail = "held", self.stopping
        elif self.until is not None and done >= self.until:
            self.state, self.detail = "held", "until"
        elif done > 0 and self.path.kind[done - 1] == PAUSE and done <= self.path.accepted and not self._starved():
            self.state, self.detail = "held", "pause"
        else:
            self.state, self.detail = "held", "underrun"
        self.changed_s = float(self.wall_at(np.array(self.process_s)))
        self.stopping, self._cursor.speed = "", 0.0
        self._plan()

    def _starved(self) -> bool:
        """True if it stopped because no blocks were left, not because of a pause."""
        return len(self._legs.block) == 0


# The moving part of any simulated robot: its hidden truth, its reach, and its motion reports to the plant.


class SimRobotBody:
    """Commands of a controller."""

    def __init__(self, runtime: SimRuntime) -> None:
        start, robot = runtime.start, runtime.start.config.robot
        hidden = hidden_truth.draw(start.config.hidden_truth, start.seed)
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

    def set_pace(self, now_s: float, slider: float = 1.0, *, is_slowed: bool = True) -> None:
        """Move from now on as fast as the faults of the script and the slider allow, and report it to the plant.

        ``is_slowed``: False while the controller only waits, which takes its time whatever they are.
        """
        pace = slider * self._override.actual(now_s) if is_slowed else 1.0
        if pace != self.motion.pace:
            self.motion.set_pace(now_s, pace)
            self._runtime.link.pace(pace, now_s)
        self.motion.reported_pace = self._override.reported(now_s)

    def reach(self, blocks: list[SimProgramBlock]) -> BoolArray:
        """True for blocks that end within reach; a robot known only by measurements has no limit."""
        poses = np.array([block.end for block in blocks]).reshape(-1, 5)
        if self._reaching is None:
            return np.ones(len(poses), dtype=np.bool_)
        return self._reaching.reached(*self._frames.in_base(*self._frames.in_part(poses)))

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Log an event, after the motion that came before."""
        self.report()
        self._runtime.link.event(name, at_s, **data)

    def report(self) -> None:
        """Send the motion since the last call, and vouch for it."""
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
