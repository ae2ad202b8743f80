"""What a script may call: functions that take no time, and those that take frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from polishd.model.errors import ProgramError
from polishd.sim_backends.universal_robots.arm import ToolPose
from polishd.sim_backends.universal_robots.controls import Controls, UrWatchdog
from polishd.sim_backends.universal_robots.program import Frames, RunningScript
from polishd.sim_backends.universal_robots.turning import after, from_vector, to_vector, turned


@dataclass(slots=True)
class Commands:
    """Of one program, on one machine."""

    machine: Controls
    _owed_s: float = 0.0

    def quick(self) -> dict[str, Callable[..., Any]]:
        """Those that take no time."""
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
            "textmsg": lambda *words: self.machine.said.append("".join(map(str, words))),
            "set_tcp": lambda *_: None,
            "set_payload": lambda *_: None,
            "set_digital_out": lambda *_: None,
            "set_standard_digital_out": lambda *_: None,
        }

    def slow(self) -> dict[str, Callable[..., Frames]]:
        """Those that take frames."""
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
        """The clock of a wait knows no slider."""
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
                way = math.dist(end.xyz_mm, self.machine.arm.place.xyz_mm) / 1000.0
                v = a * t / 2.0 - math.sqrt(max((a * t / 2.0) ** 2 - a * way, 0.0))
            top = min(v * 1000.0, self.machine.config.max_feed_mm_s)
            if top <= 0.0 or a <= 0.0:
                raise ProgramError("speed and acceleration must be above 0", 0)
            self.machine.arm.line(end, a * 1000.0, top)
            while not self.machine.arm.reached(r * 1000.0):
                yield

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
        """Whole frames; what is left of one is owed."""
        self._owed_s += self.machine.overhead_s
        while self._owed_s >= self.machine.frame_s:
            self._owed_s -= self.machine.frame_s
            yield


@dataclass(slots=True)
class _Busy:
    """Counts a statement that moves or waits, also where its thread is killed within."""

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
    """The second pose, as seen from the first."""
    turn = from_vector(first[3:])
    x, y, z = turned(turn, second[:3])
    return [first[0] + x, first[1] + y, first[2] + z, *to_vector(after(turn, from_vector(second[3:])))]
