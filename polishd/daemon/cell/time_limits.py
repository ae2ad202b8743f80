"""The chain of time limits: what devices need, from the devices; what the daemon makes of it, here and nowhere else.

A watchdog that is shorter than what it guards, or a robot that would stop before the tool is up, is refused before
anything moves: peak removal goes as force to 1/3, so that a tool that stands digs 160 nm a second under 12 N, and
still 33 nm a second under the 0.1 N that it weighs while it is being lifted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from polishd.daemon.journal.store import LATE_S
from polishd.model.devices import ActuatorTimes, LoaderTimes, RobotTimes, SensorTimes, SpindleTimes

ANSWERS_S = 3.0
"""What a device may take beyond its own action to confirm it: a link opened again, a few requests."""
LIFT_MARGIN_MM = 5.0
"""A robot that takes the tool away goes so much farther than the actuator can follow."""
LOOK_S = 0.1
"""Between two looks at a state that nobody tells of by himself."""
END_SIGMAS = 3.0
"""Standard deviations of a block's reported end that are allowed for."""
LATE_SHARE, MOST_LATE_S = 0.1, 0.1
"""Share of a block's expected time by which it may be late, and the most of that: no motion is planned more exactly."""
BEAT_S = 0.15
"""Most between two heartbeats of ours; three periods of a driver's."""


@dataclass(frozen=True, slots=True)
class ActionTimeLimit:
    """One link of the chain: how long something takes, and how long it has to be at least."""

    key: str
    """Dotted config key that changes it; empty where it only follows from others."""
    what: str
    seconds: float
    least_s: float = 0.0
    because: str = ""

    @property
    def holds(self) -> bool:
        """It is long enough."""
        return self.seconds >= self.least_s - 1e-9

    def row(self) -> dict[str, Any]:
        """JSON-ready; ``seconds`` is None for what never happens by itself."""
        return {**asdict(self), "seconds": self.seconds if math.isfinite(self.seconds) else None}


def late_s(expected_s: float) -> float:
    """Return how much longer than expected a block may take in motion."""
    return min(LATE_SHARE * expected_s, MOST_LATE_S)


def _key(port: str, times: ActuatorTimes | RobotTimes | SpindleTimes | SensorTimes, field: str) -> str:
    """Dotted config key of that field, as the device's own section has it."""
    return f"{port}.{times.keys.get(field, field)}"


def safe_within_s(times: object) -> float:
    """Longest that a device with those times may take to become safe (a robot also: to lift), and to confirm it."""
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
    """Longest until a device lets go of a client that is gone: its watchdog, its own action, and its word."""
    watchdog_s: float = getattr(times, "watchdog_s", 0.0)
    return (watchdog_s if math.isfinite(watchdog_s) else 0.0) + safe_within_s(times)


@dataclass(frozen=True, slots=True)
class TimeLimits:
    """The daemon's own limits, derived from what the job's devices state."""

    actuator: ActuatorTimes
    robot: RobotTimes
    spindle: SpindleTimes
    sensor: SensorTimes | None = None
    """The independent force sensor's, where there is one."""

    @property
    def reading_s(self) -> float:
        """Longest between two readings of the actuator: a heartbeat and a reading, each answered in time."""
        return 2 * self.actuator.silence_s + BEAT_S

    @property
    def buffer_s(self) -> float:
        """Motion that must be left in contact: an actuator that hears nothing more lifts within it.

        One that stays where it is without power does not: within it the robot has noticed, and taken the tool away.
        """
        return max(self.actuator.alone_s, self.taken_off_s if self.actuator.unpowered == "stays" else 0.0)

    @property
    def taken_off_s(self) -> float:
        """Longest from the last word of an actuator that fell silent until the robot has taken the tool off."""
        return self.reading_s + self.robot.stop_s

    @property
    def unseen_s(self) -> float:
        """Longest that the tool can stay on the part after the end of the last block that is recorded.

        The robot tells late, two samples are waited for, then the commit; then the actuator hears nothing more, or is
        told to lift. One without power that stays where it is does not: then the robot stops by itself, at the latest.
        """
        stays = self.actuator.unpowered == "stays"
        on_s = max(self.actuator.alone_s, self.robot.watchdog_s + self.robot.stop_s if stays else 0.0)
        return self.robot.silence_s + 2 * self.reading_s + LATE_S + 2 * LOOK_S + on_s

    @property
    def end_blur_s(self) -> float:
        """How far off the reported end of a block may be."""
        return END_SIGMAS * self.robot.block_end_s

    @property
    def no_progress_s(self) -> float:
        """Time beyond a block's expected time after which a robot that reports no progress counts as standing."""
        return self.robot.report_s + self.end_blur_s + 2 * LOOK_S

    @property
    def lift_mm(self) -> float:
        """How far the robot lifts where the actuator does not."""
        return self.actuator.stroke_mm + LIFT_MARGIN_MM

    @property
    def safe_s(self) -> float:
        """Longest from leaving contact until everything is told: lift, a robot that lifts instead, the stop."""
        lift_s, stop_s, rest_s = map(safe_within_s, (self.actuator, self.robot, self.spindle))
        return max(rest_s, lift_s + max(stop_s, self.buffer_s) + stop_s)

    def chain(
        self, stream_ahead_s: float, *, apart_s: float = math.inf, force_s: float = math.inf
    ) -> tuple[ActionTimeLimit, ...]:
        """Each limit in the order in which they act, with what it must outlast.

        Actuator and force sensor may disagree for ``apart_s``, and the force be off its set point for ``force_s``.
        """
        coil, robot, spindle = self.actuator, self.robot, self.spindle
        of_coil, of_robot = partial(_key, "actuator", coil), partial(_key, "robot", robot)
        of_spindle = partial(_key, "spindle", spindle)
        lost_s = robot.silence_s + coil.lifted_s
        stays = [ActionTimeLimit("", "tool taken off by the robot where the actuator has no power", self.taken_off_s)]
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
                "actuator lets go by itself",
                coil.watchdog_s,
                coil.silence_s + BEAT_S,
                "of silence and a heartbeat: the daemon leaves contact first",
            ),
            ActionTimeLimit(of_coil("landing_s"), "landing, at most", coil.landing_s),
            ActionTimeLimit(of_coil("release_s"), "force off, at most", coil.release_s),
            ActionTimeLimit(of_coil("retract_s"), "lift, at most", coil.retract_s),
            ActionTimeLimit("", "tool up after an order", coil.lifted_s),
            ActionTimeLimit("", "tool up after the last word", coil.alone_s),
            *(stays if coil.unpowered == "stays" else []),
            ActionTimeLimit(
                of_spindle("watchdog_s"),
                "spindle stops by itself",
                spindle.watchdog_s,
                3 * BEAT_S,
                "of its commands",
            ),
            ActionTimeLimit(of_spindle("spin_s"), "spindle to speed or to rest, at most", spindle.spin_s),
            ActionTimeLimit(of_robot("silence_s"), "robot counts as lost", robot.silence_s),
            ActionTimeLimit(
                of_robot("watchdog_s"),
                "robot stops by itself",
                robot.watchdog_s,
                max(coil.alone_s, lost_s),
                f"until the tool is up: actuator's watchdog and lift {coil.alone_s:g} s, "
                f"robot's silence and lift {lost_s:g} s",
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
        """What comes first of all where there is one: a force that is wrong is noticed, and a landing is none."""
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
    """Why a tool would stay on the part where its actuator's power fails; empty where it does not."""
    if actuator.unpowered == "presses":
        return (
            "an actuator that presses without power is refused: nothing takes its tool off the part then; give it a "
            'spring, a counterweight or a valve that lifts, and write unpowered = "lifts"'
        )
    if actuator.unpowered == "stays" and not robot.lifts:
        return (
            "a tool that stays on the part without power needs a robot that takes it away, and the job's cannot; take "
            "another robot, or an actuator that lifts"
        )
    return ""


def too_short(chain: Sequence[ActionTimeLimit]) -> list[tuple[str, str]]:
    """(key, what is wrong and what to do) of each limit that does not hold."""
    advice = "lengthen it, or shorten what it guards (polishd check prints the chain)"
    return [
        (limit.key, f"{limit.what}: {limit.seconds:g} s; at least {limit.least_s:g} s {limit.because}; {advice}")
        for limit in chain
        if not limit.holds
    ]
