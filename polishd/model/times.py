"""How long each device's actions may take. The device states it, from its own config; the daemon derives its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Unpowered = Literal["lifts", "stays", "presses"]
"""What an actuator does without power: its tool comes off the part, stays where it is, or goes on pressing."""


@dataclass(frozen=True, slots=True)
class ActuatorTimes:
    """The longest that a force actuator takes, wall time, and how far its tool can follow the part."""

    silence_s: float = 0.3
    """No answer for so long: it counts as silent."""
    watchdog_s: float = 1.0
    """It hears nothing for so long: it takes the force off and lifts, by itself."""
    landing_s: float = 10.0
    """From engaging to the force."""
    release_s: float = 0.2
    """From the order, or its watchdog, to force off."""
    retract_s: float = 5.0
    """From force off until it tells that the tool is up."""
    stroke_mm: float = 10.0
    unpowered: Unpowered = "lifts"
    """Beside its watchdog, which needs power: one that stays leaves it to the robot to take the tool away."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""

    @property
    def lifted_s(self) -> float:
        """From the order until the lift is confirmed."""
        return self.release_s + self.retract_s

    @property
    def alone_s(self) -> float:
        """From the last word that reached it until it has lifted by itself."""
        return self.watchdog_s + self.lifted_s


@dataclass(frozen=True, slots=True)
class RobotTimes:
    """The longest that a robot takes, wall time."""

    silence_s: float = 1.5
    """No sound word for so long: its link counts as lost."""
    watchdog_s: float = 8.0
    """It hears nothing for so long: it stops by itself. Infinite for one that runs its program to the end."""
    stop_s: float = 5.0
    """From the order to standstill; also for lifting along the tool's axis."""
    lifts: bool = True
    """It can take the tool off the part, in motion (``Robot.lift``)."""
    unseen_stop_s: float = 0.0
    """Longest that it stands, held by an operator, before anybody knows; 0: no longer than its link takes."""
    block_end_s: float = 0.0
    """Standard deviation of when it says that a block ended; 0: it says so exactly. Such errors do not add up."""
    report_s: float = 0.1
    """Greatest age of a report of executed blocks: the period of the link's reports and their way."""
    reports_dwells: bool = True
    """It reports the end of a move before the dwell after it is over; LinuxCNC reports the line of its last motion."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class SpindleTimes:
    """The longest that a spindle takes, wall time."""

    silence_s: float = 0.8
    watchdog_s: float = 1.0
    """It hears nothing for so long: it stops by itself."""
    spin_s: float = 8.0
    """From standstill to its speed, or back."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class LoaderTimes:
    """The longest that a loader takes, wall time."""

    silence_s: float = 2.0
    """No answer for so long: its link counts as lost."""
    change_s: float = 120.0
    """From the order to take a part off, or to put one on, until it is clear of the cell."""
    stop_s: float = 5.0
    """From the order to standstill."""


@dataclass(frozen=True, slots=True)
class SensorTimes:
    """The longest that an independent force sensor takes, wall time."""

    silence_s: float = 0.3
    """No new reading for so long: it counts as silent."""
    delay_s: float = 0.1
    """From a force that acts to its reading: filter, conversion and link."""
    tare_s: float = 1.0
    """From the order until what it read then is 0."""
    keys: Mapping[str, str] = field(default_factory=dict)
    """Fields whose key in the device's section has another name: its name there, by field."""


@dataclass(frozen=True, slots=True)
class MonitorTimes:
    """The longest that a monitor takes, wall time."""

    silence_s: float = 2.0
    """Nothing of a signal for so long: it is not known any more."""
