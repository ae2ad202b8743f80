"""What devices say of themselves and of what they do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

RegisterTable = Literal["holding", "input", "coil", "discrete"]
"""The four tables of Modbus."""
RobotState = Literal["idle", "held", "running", "done", "fault"]


def port_of(device: str) -> str:
    """The port of a device, by its name."""
    return device.partition(".")[0]


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Who answered: the same for real and simulated devices."""

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
    """It can be used: no fault is set."""
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
    """As measured, by the device's own word."""
    setpoint_n: float
    """What it regulates to; 0 once it was retracted."""
    in_contact: bool
    """The tool is on the part, also where no force is asked for."""
    retracted: bool
    """The tool is off the part, at rest."""
    fault: int = 0
    """0: none; else the device's own number of it."""
    position_mm: float | None = None
    """How far the tool is out, from its rest; None where the actuator does not say."""


@dataclass(frozen=True, slots=True)
class SensedForce:
    """One reading of the independent force sensor; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    force_n: float
    """Pressing is positive; 0 is what it read when it was last tared."""
    fault: int = 0
    """Bits of its own: over its range, no cell connected."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One reading of a monitor; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    name: str
    """As the monitor calls it."""
    value: float | bool | None
    """A number in the signal's unit, or a state; None: the monitor says that it does not know."""


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """One reading of the spindle; ``at_s`` is the daemon's monotonic clock."""

    at_s: float
    rpm: float
    """As measured; negative: the other way."""
    setpoint_rpm: float
    """What it was asked for."""
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
    """Where the robot is in its program, as the robot itself says."""

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


@dataclass(frozen=True, slots=True)
class MapRefusal:
    """Map that a metrology device refused while it waits for one."""

    file: str
    """Name of the file, as it came."""
    kind: str
    """Class of the error: ``MapError``, ``StaleMap``, ``WrongPart``."""
    reason: str
    todo: str
    """What the operator can do."""
    kept: str = ""
    """Where the file is kept now; empty where it could not be moved."""
