"""What a controller tells of itself in one RTDE sample, and why it would run nothing. Sans-IO."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import ProtocolError
from polishd.drivers.universal_robots.rtde import Value

STILL_M_S = 1e-5
"""A tool that stands is meant to have no speed at all."""
FULL, MOST = 0.999, 1.001
"""Of the speed slider: 1, but for rounding."""


class UrRuntimeState(IntEnum):
    """``runtime_state``."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ScriptPhase(IntEnum):
    """What our own program does, by its own word."""

    NONE = 0
    WAITS = 1
    RUNS = 2
    HELD = 3
    LIFTED = 4
    DONE = 5
    ENDS = 6
    """It brakes, or lifts."""


ROBOT_MODES = {
    -1: "the controller is not up", 0: "it is disconnected", 1: "its safety configuration waits to be confirmed",
    2: "it is booting", 3: "it is switched off", 4: "it is on, its brakes are not released",
    5: "its brakes are not released", 6: "somebody moves it by hand (backdrive)", 8: "its firmware is being updated",
}  # fmt: skip
"""``robot_mode`` other than 7, running."""
SAFETY_MODES = {
    2: "the safety system limits its speed (reduced mode)", 3: "protective stop", 4: "recovery mode",
    5: "safeguard stop", 6: "emergency stop of the system", 7: "emergency stop of the robot",
    8: "safety violation", 9: "safety fault", 10: "a joint is being validated", 11: "unknown safety mode",
}  # fmt: skip
"""``safety_mode`` other than 1, normal."""
OUTPUTS = (
    "timestamp", "runtime_state", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
    "target_TCP_speed",
)  # fmt: skip
RUNNING, NORMAL = 7, 1


@dataclass(frozen=True, slots=True)
class UrRegisters:
    """Which of the controller's integer registers are ours: five inputs and four outputs from ``first`` on."""

    first: int = 24

    def inputs(self) -> tuple[str, ...]:
        """Beat, token, until, order, lift in um."""
        return tuple(f"input_int_register_{self.first + at}" for at in range(5))

    def outputs(self) -> tuple[str, ...]:
        """Token, block, phase, turns."""
        return tuple(f"output_int_register_{self.first + at}" for at in range(4))


@dataclass(frozen=True, slots=True)
class RtdeSample:
    """One sample. Times are the controller's own clock, since it was switched on."""

    time_s: float
    runtime: int
    robot_mode: int
    safety_mode: int
    slider: float
    """Speed slider, 1 is all."""
    scaling: float
    """Scaling of the trajectory limiter, 1: none."""
    speed_m_s: float
    """Of the tool, as it is meant to be: without the noise of encoders."""
    token: int
    """Of the program that spoke last."""
    block: int
    """Block of it that is under way."""
    phase: int
    turns: int
    """Grows with each period in which our program runs."""

    @classmethod
    def of(cls, values: Mapping[str, Value], registers: UrRegisters) -> RtdeSample:
        """From a data package's values. ProtocolError where the speed slider or the scaling is where it cannot be."""
        one = {name: value[0] for name, value in values.items()}
        if not 0.0 <= one["target_speed_fraction"] <= MOST:
            raise ProtocolError(f"RTDE: a speed slider at {100.0 * one['target_speed_fraction']:.3g} %, of 0 to 100 %")
        if not 0.0 <= one["speed_scaling"] <= MOST:
            raise ProtocolError(f"RTDE: speed_scaling is {one['speed_scaling']:.3g}, of 0 to 1")
        token, block, phase, turns = (int(one[name]) for name in registers.outputs())
        return cls(
            time_s=one["timestamp"],
            runtime=int(one["runtime_state"]),
            robot_mode=int(one["robot_mode"]),
            safety_mode=int(one["safety_mode"]),
            slider=one["target_speed_fraction"],
            scaling=one["speed_scaling"],
            speed_m_s=max(abs(part) for part in values["target_TCP_speed"][:6]),
            token=token,
            block=block,
            phase=phase,
            turns=turns,
        )

    @property
    def override(self) -> float:
        """Fraction of the programmed speed: the speed slider, times the trajectory limiter's scaling in motion."""
        return self.slider * (self.scaling if self.runtime == UrRuntimeState.PLAYING else 1.0)

    @property
    def plays(self) -> bool:
        """A program of anybody's is under way, or the robot moves."""
        return self.runtime not in (UrRuntimeState.STOPPED, UrRuntimeState.PAUSED) or self.speed_m_s > STILL_M_S

    def obstacle(self) -> str:
        """Why it would not run a program as it is written; empty where it would."""
        if self.robot_mode != RUNNING:
            return ROBOT_MODES.get(self.robot_mode, f"robot mode {self.robot_mode}")
        if self.safety_mode != NORMAL:
            return SAFETY_MODES.get(self.safety_mode, f"safety mode {self.safety_mode}")
        if self.slider < FULL:
            return f"its speed slider is at {100.0 * self.slider:.5g} %: set it to 100 %"
        return ""
