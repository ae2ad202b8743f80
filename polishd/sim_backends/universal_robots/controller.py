"""The controller: modes, registers, the running program and the arm. Pure of I/O; the caller passes wall times."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from polishd.model.errors import ProgramError
from polishd.sim_backends.universal_robots.arm import (
    BLOCK_REGISTER,
    NORMAL,
    PAUSED,
    PAUSING,
    PLAYING,
    POWER_OFF,
    PROTECTIVE_STOP,
    RESUMING,
    ROBOT_EMERGENCY_STOP,
    RUNNING,
    STOPPED,
    STOPPING,
    Controls,
    ToolPose,
    UrWatchdog,
    after,
    from_vector,
    to_vector,
    turned,
    wrist_deg,
)
from polishd.sim_backends.universal_robots.urscript import Frames, RunningScript, parsing

# The functions of a script: those that take no time, and those that take frames.


@dataclass(slots=True)
class Commands:
    """The functions of one program on one machine."""

    machine: Controls
    _owed_s: float = 0.0
    _late_s: float = 0.0
    """Part of a frame by which the last blend began late."""

    def quick(self) -> dict[str, Callable[..., Any]]:
        """Return the functions that take no time."""
        return {
            "read_input_integer_register": self.machine.ints_in.__getitem__,
            "read_input_float_register": self.machine.doubles_in.__getitem__,
            "write_output_integer_register": self.machine.ints_out.__setitem__,
            "write_output_float_register": self.machine.doubles_out.__setitem__,
            "rtde_set_watchdog": self._set_watchdog,
            "get_target_tcp_pose": self.machine.arm.pose_m,
            "get_actual_tcp_pose": self.machine.arm.pose_m,
            "get_steptime": lambda: self.machine.frame_s,
            "pose_trans": _pose_trans,
            "textmsg": lambda *values: self.machine.messages.append("".join(map(str, values))),
            "set_tcp": lambda *_: None,
            "set_payload": lambda *_: None,
            "set_digital_out": lambda *_: None,
            "set_standard_digital_out": lambda *_: None,
        }

    def slow(self) -> dict[str, Callable[..., Frames]]:
        """Return the functions that take frames."""
        return {
            "sync": self._sync,
            "sleep": self._sleep,
            "movel": self._movel,
            "movep": self._movel,
            "movej": self._movel,
            "speedl": self._speedl,
            "stopl": self._stopl,
        }

    def _set_watchdog(self, name: str, rate_hz: float, action: str = "pause") -> None:
        self.machine.watchdogs[name] = UrWatchdog(1.0 / rate_hz, action, self.machine.time_s)

    def _sync(self) -> Frames:
        yield

    def _sleep(self, seconds: float) -> Frames:
        """The slider does not slow the clock of a wait."""
        with _Busy(self.machine, drives=False):
            yield from self._overhead()
            for _ in range(math.ceil(seconds / self.machine.frame_s - 1e-9)):
                while self.machine.override.stands:
                    yield
                yield

    def _movel(self, pose: list[float], a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Frames:
        x, y, z, *turn = pose
        end = ToolPose((x * 1000.0, y * 1000.0, z * 1000.0), from_vector(turn))
        with _Busy(self.machine):
            yield from self._overhead()
            if t > 0.0:
                way = math.dist(end.xyz_mm, self.machine.arm.commanded.xyz_mm) / 1000.0
                rests = r <= 0.0  # else the next move begins as this one decelerates
                v = a * t / 2.0 - math.sqrt(max((a * t / 2.0) ** 2 - a * way, 0.0)) if rests else way / t
            top = min(v * 1000.0, self.machine.config.max_feed_mm_s)
            if top <= 0.0 or a <= 0.0:
                raise ProgramError("speed and acceleration must be above 0", 0)
            self.machine.arm.line(end, a * 1000.0, top, self._late_s)
            while (late_s := self.machine.arm.reached(r * 1000.0)) is None:
                yield
            self._late_s = late_s

    def _speedl(self, velocity: list[float], a: float, t: float = 0.0) -> Frames:
        x, y, z = (part * 1000.0 for part in velocity[:3])
        with _Busy(self.machine):
            self.machine.arm.aim((x, y, z), a * 1000.0)
            yield
            for _ in range(round(t / self.machine.frame_s) - 1):
                yield

    def _stopl(self, a: float, _turn: float = 0.0) -> Frames:
        with _Busy(self.machine):
            self.machine.arm.brake(a * 1000.0)
            while not self.machine.arm.stands:
                yield

    def _overhead(self) -> Frames:
        """Return whole frames; carry the rest over."""
        self._owed_s += self.machine.overhead_s
        while self._owed_s >= self.machine.frame_s:
            self._owed_s -= self.machine.frame_s
            yield


@dataclass(slots=True)
class _Busy:
    """Count a statement that moves or waits, also where its thread is killed within it."""

    machine: Controls
    drives: bool = True
    program: RunningScript | None = None

    def __enter__(self) -> None:
        self.program = self.machine.program
        self._count(1)

    def __exit__(self, *_error: object) -> None:
        if self.machine.program is self.program:
            self._count(-1)

    def _count(self, by: int) -> None:
        self.machine.busy += by
        self.machine.driven_by += by * self.drives


def _pose_trans(first: list[float], second: list[float]) -> list[float]:
    """Return the second pose in the frame of the first."""
    turn = from_vector(first[3:])
    x, y, z = turned(turn, second[:3])
    return [first[0] + x, first[1] + y, first[2] + z, *to_vector(after(turn, from_vector(second[3:])))]


RAMP_S = 0.1
"""Time in which a pause reduces the trajectory's pace from full to zero."""
LATE_S = 30.0
"""A process that was delayed catches up with at most this time."""


@dataclass(slots=True)
class UrController(Controls):
    """Events of the controller, frame by frame, on its own clock."""

    def load(self, text: str) -> None:
        """Take a script: it stops the running one; while one is paused, it only stops that one."""
        for _ in self.loading(text):
            pass

    def loading(self, text: str) -> Iterator[None]:
        """Take a script, a few statements at a turn; a stop of the robot in the meantime drops the script."""
        if self.robot_mode != RUNNING or self.safety_mode != NORMAL or not self.remote:
            return
        paused = self.runtime in {PAUSING, PAUSED}
        self.stop()
        if paused:
            return
        stops = self.stops
        try:
            routine = yield from parsing(text)
            yield
            if self.stops != stops or self.safety_mode != NORMAL:
                return
            commands = Commands(self)
            self.program = RunningScript(routine, commands.quick(), commands.slow())
        except ProgramError as error:
            self.complain(int(error.args[1]), str(error.args[0]))
            return
        self.runtime, self.watchdogs = PLAYING, {}

    def stop(self) -> bool:
        """End the program and brake the arm; True if one ran."""
        self.stops += 1
        ran = self.runtime != STOPPED
        self.program, self.watchdogs, self.busy, self.driven_by = None, {}, 0, 0
        if not self.arm.stands:
            self.arm.brake()
        self.runtime, self.pace = STOPPING if ran else STOPPED, 1.0
        return ran

    def pause(self) -> bool:
        """Pause, as the pendant's button does."""
        if self.runtime == PLAYING:
            self.runtime = PAUSING
        return self.runtime in {PAUSING, PAUSED}

    def play(self) -> bool:
        """Continue after a pause; False where nothing is paused."""
        able = self.runtime == PAUSED and self.safety_mode == NORMAL
        self.runtime = RESUMING if able else self.runtime
        return able

    def protective_stop(self) -> None:
        """Enter a protective stop, after a collision or an unreachable command."""
        self.safety_mode = PROTECTIVE_STOP
        if self.program is not None:
            self.runtime = PAUSING
        if self.program is None or not self.driven_by:
            self.arm.brake()

    def unlock(self) -> None:
        """Leave a protective stop; the program stays paused."""
        if self.safety_mode == PROTECTIVE_STOP:
            self.safety_mode = NORMAL

    def emergency_stop(self) -> None:
        """Press the emergency stop: power off, brakes on, the program is over."""
        self.safety_mode, self.robot_mode = ROBOT_EMERGENCY_STOP, POWER_OFF
        self.stop()

    def power_off(self) -> None:
        """Act as the operator at the pendant."""
        self.robot_mode = POWER_OFF
        self.stop()

    def written(self, name: str) -> None:
        """Take an input of RTDE."""
        if name in self.watchdogs:
            self.watchdogs[name].written_s = self.time_s

    def due(self, wall_s: float) -> range:
        """Run one turn for each frame up to the present."""
        behind_s = (wall_s - self.began_s) * self.speed - self.time_s
        if behind_s > LATE_S * self.speed:
            self.began_s += behind_s / self.speed - LATE_S
            behind_s = LATE_S * self.speed
        return range(int(behind_s / self.frame_s))

    def wall_s(self) -> float:
        """Wall time of its clock."""
        return self.began_s + self.time_s / self.speed

    @property
    def active(self) -> bool:
        """True while it moves, or while a statement that moves or waits is under way."""
        return self.arm.moves or bool(self.busy and self.runtime == PLAYING)

    def frame(self) -> None:
        """Run one period of its control."""
        self._watch()
        self._ramp()
        if self.program is not None and self.runtime == PLAYING:
            self._run(self.program)
        if self.arm.driven and not self.driven_by:
            self.arm.brake()  # the thread that drove it was killed
        speed = self.slider * self.override.actual(self.wall_s())
        share = 0.0 if self.override.stands else speed if self.arm.follows else 1.0
        if share != (self.shares[-1][1] if self.shares else self.share):
            self.shares.append((self.wall_s(), share))
        if self.override.stands:
            self.arm.stand()
        else:
            self.arm.step(self.frame_s, speed * self.pace)
        x, y, z = self.arm.place.xyz_mm
        if self.arm.moves and self._outside() and self.safety_mode == NORMAL:
            self.protective_stop()
        if self.active:
            begin_s = self.wall_s()
            end_s = begin_s + self.frame_s / self.speed
            self.rows.append(
                [self.ints_out[BLOCK_REGISTER], begin_s, end_s, self.frame_s, x, y, z, *wrist_deg(self.arm.place.turn)]
            )
        self.time_s += self.frame_s
        if self.runtime == STOPPING and self.arm.stands:
            self.runtime = STOPPED

    def _outside(self) -> bool:
        ranges = (self.config.x_mm, self.config.y_mm, self.config.z_mm)
        return any(not low <= at <= high for at, (low, high) in zip(self.arm.place.xyz_mm, ranges, strict=True))

    def _run(self, program: RunningScript) -> None:
        try:
            program.frame()
        except ProgramError as error:
            self.complain(int(error.args[1]) or program.line, str(error.args[0]))
            self.stop()
        except (TypeError, ValueError, IndexError, ZeroDivisionError) as error:
            self.complain(program.line, f"runtime error: {error}")
            self.stop()
        if program.over and self.program is program:
            self.stop()

    def _watch(self) -> None:
        for name, dog in list(self.watchdogs.items()):
            if self.runtime != PLAYING or self.time_s - dog.written_s <= dog.longest_s:
                continue
            if dog.action == "stop":
                self.stop()
            elif dog.action == "pause":
                self.pause()
            self.watchdogs.pop(name, None)

    def _ramp(self) -> None:
        step = self.frame_s / RAMP_S
        if self.runtime == PAUSING:
            self.pace = max(self.pace - step, 0.0)
            if self.program is not None and self.pace == 0.0:
                self.runtime = PAUSED
        elif self.runtime == RESUMING:
            self.pace = min(self.pace + step, 1.0)
            if self.pace == 1.0:
                self.runtime = PLAYING
