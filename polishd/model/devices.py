"""Identity, status and readings of devices, and their reaction times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

RegisterTable = Literal["holding", "input", "coil", "discrete"]
"""The four tables of Modbus."""
RobotState = Literal["idle", "held", "running", "done", "fault"]


def port_of(device: str) -> str:
    """The port of a device, by its name."""
    return device.partition(".")[0]


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Identity of a device; real and simulated devices have the same fields."""

    vendor: str
    model: str
    serial: str
    firmware: str
    boot_id: str = ""
    """Changes at each power-up; empty where the device has none."""


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """A device's own word on whether it may be used. ``safe`` means: it exerts nothing and nothing moves."""

    ready: bool
    """The device can be used: no fault is set."""
    safe: bool
    state: str
    """The device's own word for it, for people and logs."""
    detail: str = ""
    """Why it is not ready."""


@dataclass(frozen=True, slots=True)
class ForceSample:
    """One reading of the force actuator; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    force_n: float
    """Force that the device measures."""
    setpoint_n: float
    """Set point of the force; 0 after retraction."""
    in_contact: bool
    """The tool is on the part, also with a set point of 0."""
    retracted: bool
    """The tool is off the part, at rest."""
    fault: int = 0
    """0: none; else the device's own number of it."""
    position_mm: float | None = None
    """Distance of the tool from its rest; None where the actuator does not report it."""


@dataclass(frozen=True, slots=True)
class SensedForce:
    """One reading of the independent force sensor; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    force_n: float
    """Pressing is positive; 0 is what it read when it was last tared."""
    fault: int = 0
    """Fault bits of the sensor: over range, no cell connected."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One reading of a monitor; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    name: str
    """Name of the monitor's signal."""
    value: float | bool | None
    """A number in the signal's unit, or a state; None: the monitor says that it does not know."""


SPEED_BAND = 0.05
"""Largest relative deviation of the spindle's speed in contact."""


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """One reading of the spindle; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    rpm: float
    """Measured speed; negative: the other direction."""
    setpoint_rpm: float
    """Set point of the speed."""
    fault: int = 0
    """0: none; else the drive's own number of it."""


@dataclass(frozen=True, slots=True)
class ExecutedBlock:
    """A block that the robot has executed: not accepted, executed. Times are the controller's own process clock."""

    seq: int
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class RobotProgress:
    """Position of the robot in its program, as the robot reports it."""

    state: RobotState
    program_sha256: str
    accepted: int
    """Blocks accepted so far: the next sequence number expected."""
    executed: int
    """Blocks executed so far."""
    buffer_s: float
    """Wall seconds of motion that are buffered ahead of the tool."""
    boot_id: str = ""
    detail: str = ""
    override: float | None = None
    """Speed override that the controller reports, as a fraction (1.0: as programmed); None: it cannot be read."""
    measured_speed: float | None = None
    """Fraction of the programmed speed at which the driver measures the tool to move, at most; None: not slow, or not
    measured."""


@dataclass(frozen=True, slots=True)
class MapRefusal:
    """Map that a metrology device refused while it waits for one."""

    file: str
    """Name of the file, as it came."""
    kind: str
    """Class of the error: ``MapError``, ``StaleMap``, ``WrongPart``."""
    reason: str
    todo: str
    """Action for the operator."""
    kept: str = ""
    """Present location of the file; empty where it could not be moved."""


# How long each device's actions may take. The device states it, from its own config; the daemon derives its limits.

Unpowered = Literal["lifts", "stays", "presses"]
"""Behavior of an actuator without power: its tool lifts off, stays in place, or continues to press."""


@dataclass(frozen=True, slots=True)
class ActuatorTimes:
    """The longest that a force actuator takes, wall time, and how far its tool can follow the part."""

    silence_s: float = 0.3
    """Without an answer for so long, the actuator counts as silent."""
    watchdog_s: float = 1.0
    """Without a message for so long, the actuator takes the force off and lifts."""
    landing_s: float = 10.0
    """From engaging until the force is reached."""
    release_s: float = 0.2
    """From the command, or the watchdog, until the force is off."""
    retract_s: float = 5.0
    """From force off until it reports that the tool is up."""
    stroke_mm: float = 10.0
    unpowered: Unpowered = "lifts"
    """Beside its watchdog, which needs power: one that stays leaves it to the robot to take the tool away."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""

    @property
    def lifted_s(self) -> float:
        """From the command until the lift is confirmed."""
        return self.release_s + self.retract_s

    @property
    def alone_s(self) -> float:
        """From the last message that reaches it until its watchdog has lifted the tool."""
        return self.watchdog_s + self.lifted_s


@dataclass(frozen=True, slots=True)
class RobotTimes:
    """The longest that a robot takes, wall time."""

    silence_s: float = 1.5
    """Without a valid message for so long, the link counts as lost."""
    watchdog_s: float = 8.0
    """Without a message for so long, the robot stops. Infinite for a robot that runs its program to the end."""
    stop_s: float = 5.0
    """From the command to standstill; also for lifting along the tool's axis."""
    lifts: bool = True
    """The robot can lift the tool off the part in motion (``Robot.lift``)."""
    unseen_stop_s: float = 0.0
    """Longest that it stands, held by an operator, before anybody knows; 0: no longer than its link takes."""
    block_end_s: float = 0.0
    """Standard deviation of when it says that a block ended; 0: it says so exactly. Such errors do not add up."""
    report_s: float = 0.1
    """Greatest age of a report of executed blocks: the period of the link's reports and their way."""
    reports_dwells: bool = True
    """It reports the end of a move before the dwell after it; LinuxCNC reports the line of its last motion."""
    held_instructions: int = 0
    """Most instructions that it holds, the one under way among them: it stops after them. 0: no such limit."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class SpindleTimes:
    """The longest that a spindle takes, wall time."""

    silence_s: float = 0.8
    watchdog_s: float = 1.0
    """Without a message for so long, the spindle stops."""
    spin_s: float = 8.0
    """From standstill to speed, or back."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class LoaderTimes:
    """The longest that a loader takes, wall time."""

    silence_s: float = 2.0
    """No answer for so long: its link counts as lost."""
    change_s: float = 120.0
    """From the command to remove or load a part until the loader is clear of the cell."""
    stop_s: float = 5.0
    """From the command to standstill."""


@dataclass(frozen=True, slots=True)
class SensorTimes:
    """The longest that an independent force sensor takes, wall time."""

    silence_s: float = 0.3
    """No new reading for so long: it counts as silent."""
    delay_s: float = 0.1
    """From a force to its reading: filter, conversion and link."""
    tare_s: float = 1.0
    """From the command until the reading is 0."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class MonitorTimes:
    """The longest that a monitor takes, wall time."""

    silence_s: float = 2.0
    """Nothing of a signal for so long: it is not known any more."""


# What a signal of the cell must be, and what it leads to where it is not.

SignalAction = Literal["notify", "hold", "lift", "estop"]


@dataclass(frozen=True, slots=True)
class SignalRange:
    """A state, or a range; None: no bound."""

    min: float | None = None
    max: float | None = None
    state: bool | None = None

    def broken(self, value: float | bool | None, unit: str = "") -> str:
        """Return the deviation of a value in words; empty within the limits. None: unknown."""
        return "" if self._holds(value) else f"is {in_words(value, unit)}, must be {self.words(unit)}"

    def words(self, unit: str = "") -> str:
        """Return the required value in words."""
        if self.state is not None:
            return in_words(self.state)
        low = "" if self.min is None else f"at least {in_words(self.min, unit)}"
        high = "" if self.max is None else f"at most {in_words(self.max, unit)}"
        return " and ".join(filter(None, [low, high]))

    def _holds(self, value: float | bool | None) -> bool:
        if value is None or isinstance(value, bool) or self.state is not None:
            return value is not None and value is self.state
        return (-math.inf if self.min is None else self.min) <= value <= (math.inf if self.max is None else self.max)


def in_words(value: float | bool | None, unit: str = "") -> str:
    """A number with its unit, a state, or that it is not known."""
    if value is None or isinstance(value, bool):
        return {None: "not known", True: "on", False: "off"}[value]
    return f"{value:g} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class SignalLimits:
    """A signal that is watched, and its limits."""

    name: str
    """Name of its section, `[signals.NAME]`."""
    monitor: str
    """The device that reports it."""
    signal: str
    """Name of the signal at the monitor."""
    unit: str
    before: SignalRange | None
    """Required value before contact."""
    wait_s: float
    """So long that is waited for."""
    in_contact: SignalRange | None
    alarm_delay_s: float
    """So long it may be outside in contact."""
    action: SignalAction
    on_start: SignalRange | None = None
    """Required value when the operator commands motion."""
    measures_force: bool = False
    """The signal is the force on the part, N."""

    def said(self, value: float | bool | None) -> str:
        """A value in words."""
        return in_words(value, self.unit)

    def __str__(self) -> str:
        """With its limits and what they lead to."""
        said = ["force on the part"] if self.measures_force else []
        if self.before is not None:
            said.append(f"before contact {self.before.words(self.unit)} (waited for {self.wait_s:g} s)")
        if self.in_contact is not None:
            said.append(
                f"in contact {self.in_contact.words(self.unit)} (else {self.action} after {self.alarm_delay_s:g} s)"
            )
        if self.on_start is not None:
            said.append(f"when motion is ordered {self.on_start.words(self.unit)}")
        return f"{self.name} of {self.monitor}: {', '.join(said)}"
