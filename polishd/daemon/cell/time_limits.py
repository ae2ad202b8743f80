"""Chain of time limits: the devices state their times; the daemon derives its limits from them in this module only.

A watchdog that is shorter than the action that it guards, or a robot that would stop before the tool is up, is refused
before anything moves: peak removal is proportional to force to the power 1/3, so that a tool that stands digs 160 nm/s
at 12 N, and still 33 nm/s at the 0.1 N of its weight during the lift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from polishd.daemon.journal.store import LATE_S
from polishd.model.devices import ActuatorTimes, LoaderTimes, RobotTimes, SensorTimes, SpindleTimes
from polishd.model.surface import FloatArray

ANSWERS_S = 3.0
"""Longest time beyond a device's action until it confirms: a link opened again, a few requests."""
LIFT_MARGIN_MM = 5.0
"""Lift by the robot beyond the stroke of the actuator."""
LOOK_S = 0.1
"""Interval of polling a state."""
END_SIGMAS = 3.0
"""Tolerated error of a block's reported end, in standard deviations."""
LATE_SHARE, MOST_LATE_S = 0.1, 0.1
"""Tolerated lateness of a block as a share of its expected time, and its maximum: accuracy of the planned motion."""
BEAT_S = 0.15
"""Longest interval of two heartbeats of the daemon: three periods of a driver."""


@dataclass(frozen=True, slots=True)
class ActionTimeLimit:
    """One entry of the chain: the time of an action and its lower limit."""

    key: str
    """Dotted config key of the time; empty if it only follows from others."""
    what: str
    seconds: float
    least_s: float = 0.0
    because: str = ""

    @property
    def holds(self) -> bool:
        """Whether it is long enough."""
        return self.seconds >= self.least_s - 1e-9

    def row(self) -> dict[str, Any]:
        """Return a JSON-ready row; ``seconds`` is None for an action that never happens without a command."""
        return {**asdict(self), "seconds": self.seconds if math.isfinite(self.seconds) else None}


def late_s(expected_s: float) -> float:
    """Return the tolerated lateness of a block in motion."""
    return min(LATE_SHARE * expected_s, MOST_LATE_S)


def _key(port: str, times: ActuatorTimes | RobotTimes | SpindleTimes | SensorTimes, field: str) -> str:
    """Return the dotted config key of that field in the device's section."""
    return f"{port}.{times.keys.get(field, field)}"


def safe_within_s(times: object) -> float:
    """Return the longest time of a device to become safe, or of a robot to lift, and to confirm."""
    match times:
        case ActuatorTimes():
            return times.lifted_s + ANSWERS_S
        case RobotTimes() | LoaderTimes():
            return times.stop_s + ANSWERS_S
        case SpindleTimes():
            return times.spin_s + ANSWERS_S
        case _:
            return ANSWERS_S


def released_within_s(times: object) -> float:
    """Return the longest time until a device releases a client that is gone: watchdog, action, confirmation."""
    watchdog_s: float = getattr(times, "watchdog_s", 0.0)
    return (watchdog_s if math.isfinite(watchdog_s) else 0.0) + safe_within_s(times)


@dataclass(frozen=True, slots=True)
class TimeLimits:
    """Limits of the daemon, derived from the times that the job's devices state."""

    actuator: ActuatorTimes
    robot: RobotTimes
    spindle: SpindleTimes
    sensor: SensorTimes | None = None
    """Times of the independent force sensor, if there is one."""

    @property
    def reading_s(self) -> float:
        """Longest interval of two readings of the actuator: a heartbeat and a reading, each answered in time."""
        return 2 * self.actuator.silence_s + BEAT_S

    @property
    def buffer_s(self) -> float:
        """Motion that must be left in contact: within it an actuator without commands lifts.

        An actuator with unpowered = "stays" does not lift: within it the robot detects that and lifts the tool.
        """
        return max(self.actuator.alone_s, self.taken_off_s if self.actuator.unpowered == "stays" else 0.0)

    @property
    def taken_off_s(self) -> float:
        """Longest time from the last answer of an actuator until the robot has lifted the tool."""
        return self.reading_s + self.robot.stop_s

    @property
    def unseen_s(self) -> float:
        """Longest time that the tool can stay on the part after the end of the last recorded block.

        Sum of the delay of the robot's report, two samples, the commit, and then the lift by command or watchdog. An
        actuator with unpowered = "stays" does not lift: then contact ends with the robot's watchdog at the latest.
        """
        stays = self.actuator.unpowered == "stays"
        on_s = max(self.actuator.alone_s, self.robot.watchdog_s + self.robot.stop_s if stays else 0.0)
        return self.robot.silence_s + 2 * self.reading_s + LATE_S + 2 * LOOK_S + on_s

    @property
    def held_motion_s(self) -> float:
        """Motion that a robot with few instructions must hold beyond the one under way, at any time in contact.

        An executed instruction is reported late, and only then replaced.
        """
        return self.buffer_s + self.robot.report_s

    def held_motion(self, encoding: str, time_s: FloatArray) -> ActionTimeLimit | None:
        """Return the limit of the motion in the instructions that the robot holds; None for a robot without it.

        Args:
            encoding: of the program: with dwells a point is two instructions.
            time_s: (n,) time of each timed point.
        """
        points = self.held_points(encoding)
        if not self.robot.held_instructions:
            return None
        sums = np.convolve(time_s, np.ones(points), "valid") if len(time_s) > points else [float(time_s.sum())]
        return ActionTimeLimit(
            "machine.least_point_s",
            f"motion in the {self.robot.held_instructions} instructions that the robot holds: {points} whole points",
            round(float(np.min(sums)), 3),
            self.held_motion_s,
            f"to lift the tool if the actuator stops answering: {self.held_motion_s / points:.3f} s a point",
        )

    def held_points(self, encoding: str) -> int:
        """Return the number of whole points in the instructions that the robot holds beyond the one under way."""
        return max((self.robot.held_instructions - 1) // (2 if encoding == "dwell" else 1), 1)

    @property
    def end_blur_s(self) -> float:
        """Largest error of the reported end of a block."""
        return END_SIGMAS * self.robot.block_end_s

    @property
    def no_progress_s(self) -> float:
        """Time beyond a block's expected time after which a robot without progress counts as standing."""
        return self.robot.report_s + self.end_blur_s + 2 * LOOK_S

    @property
    def lift_mm(self) -> float:
        """Lift by the robot if the actuator does not lift."""
        return self.actuator.stroke_mm + LIFT_MARGIN_MM

    @property
    def safe_s(self) -> float:
        """Longest time from leaving contact until all devices are safe: lift, lift by the robot, stop."""
        lift_s, stop_s, rest_s = map(safe_within_s, (self.actuator, self.robot, self.spindle))
        return max(rest_s, lift_s + max(stop_s, self.buffer_s) + stop_s)

    def chain(
        self, stream_ahead_s: float, *, apart_s: float = math.inf, force_s: float = math.inf
    ) -> tuple[ActionTimeLimit, ...]:
        """Return the limits in the order in which they act, each with its lower limit.

        Actuator and force sensor may disagree for ``apart_s``; the force may be off its set point for ``force_s``.
        """
        coil, robot, spindle = self.actuator, self.robot, self.spindle
        of_coil, of_robot = partial(_key, "actuator", coil), partial(_key, "robot", robot)
        of_spindle = partial(_key, "spindle", spindle)
        lost_s = robot.silence_s + coil.lifted_s
        held_s = 2.0 * self.held_motion_s if robot.held_instructions else 0.0
        stays = [ActionTimeLimit("", "tool lifted by the robot if the actuator has no power", self.taken_off_s)]
        return (
            *self._of_sensor(apart_s, force_s),
            ActionTimeLimit(
                of_coil("silence_s"),
                "actuator counts as silent",
                coil.silence_s,
                BEAT_S,
                "of three heartbeats",
            ),
            ActionTimeLimit(
                of_coil("watchdog_s"),
                "watchdog of the actuator",
                coil.watchdog_s,
                coil.silence_s + BEAT_S,
                "of silence and a heartbeat: the daemon leaves contact first",
            ),
            ActionTimeLimit(of_coil("landing_s"), "landing, at most", coil.landing_s),
            ActionTimeLimit(of_coil("release_s"), "force off, at most", coil.release_s),
            ActionTimeLimit(of_coil("retract_s"), "lift, at most", coil.retract_s),
            ActionTimeLimit("", "tool up after a command", coil.lifted_s),
            ActionTimeLimit("", "tool up after the last command, by watchdog", coil.alone_s),
            *(stays if coil.unpowered == "stays" else []),
            ActionTimeLimit(
                of_spindle("watchdog_s"),
                "watchdog of the spindle",
                spindle.watchdog_s,
                3 * BEAT_S,
                "of its commands",
            ),
            ActionTimeLimit(of_spindle("spin_s"), "spindle to speed or to rest, at most", spindle.spin_s),
            ActionTimeLimit(of_robot("silence_s"), "robot counts as lost", robot.silence_s),
            ActionTimeLimit(
                of_robot("watchdog_s"),
                "watchdog of the robot",
                robot.watchdog_s,
                max(coil.alone_s, lost_s, held_s),
                f"until the tool is up: actuator's watchdog and lift {coil.alone_s:g} s, "
                f"robot's silence and lift {lost_s:g} s"
                + (f", twice the motion in its instructions {held_s:g} s" if held_s else ""),
            ),
            ActionTimeLimit(of_robot("stop_s"), "robot stops or lifts, at most", robot.stop_s),
            ActionTimeLimit(
                "job.stream_ahead_s",
                "motion held by the robot",
                stream_ahead_s,
                self.buffer_s,
                "of motion: contact is left when less is held, and the tool is up when that is used up",
            ),
            ActionTimeLimit("", "all safe after leaving contact, at most", self.safe_s),
        )

    def _of_sensor(self, apart_s: float, force_s: float) -> tuple[ActionTimeLimit, ...]:
        """Return the limits of the force sensor, which act first: a landing must not count as a wrong force."""
        if self.sensor is None:
            return ()
        late_s = self.sensor.delay_s + 2 * BEAT_S
        because = f"of the sensor's delay {self.sensor.delay_s:g} s and two readings: a landing would end contact"
        silence_s, silence_key = self.sensor.silence_s, _key("force_sensor", self.sensor, "silence_s")
        return (
            ActionTimeLimit(
                silence_key,
                "force sensor counts as silent",
                silence_s,
                BEAT_S,
                "of its readings",
            ),
            ActionTimeLimit(
                "force_sensor.alarm_delay_s", "actuator and force sensor may disagree for", apart_s, late_s, because
            ),
            ActionTimeLimit(
                "limits.force_alarm_delay_s", "force may be off its set point for", force_s, late_s - BEAT_S, because
            ),
        )


def stays_on(actuator: ActuatorTimes, robot: RobotTimes) -> str:
    """Return why the tool would stay on the part after a power failure of the actuator; empty if it would not."""
    if actuator.unpowered == "presses":
        return (
            "an actuator that presses without power is refused: the tool would stay on the part. Add a spring, a "
            'counterweight or a valve that lifts, and set unpowered = "lifts"'
        )
    if actuator.unpowered == "stays" and not robot.lifts:
        return (
            "a tool that stays on the part without power needs a robot that lifts it, and the job's robot cannot. Use "
            "another robot or an actuator that lifts"
        )
    return ""


def too_short(chain: Sequence[ActionTimeLimit]) -> list[tuple[str, str]]:
    """Return the key and a message for each limit that does not hold."""
    advice = "Increase it, or reduce the time that it guards (polishd check prints the chain)"
    return [
        (limit.key, f"{limit.what}: {limit.seconds:g} s; at least {limit.least_s:g} s {limit.because}. {advice}")
        for limit in chain
        if not limit.holds
    ]
