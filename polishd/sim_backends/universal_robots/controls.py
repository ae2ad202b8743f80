"""What a controller is at one moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from polishd.config.simulator import SimRobotSection
from polishd.sim_backends.faults.override import SpeedOverride
from polishd.sim_backends.universal_robots.arm import UrArm
from polishd.sim_backends.universal_robots.program import RunningScript

STOPPING, STOPPED, PLAYING, PAUSING, PAUSED, RESUMING = range(6)
NORMAL, PROTECTIVE_STOP, ROBOT_EMERGENCY_STOP = 1, 3, 7
POWER_OFF, RUNNING = 3, 7
REGISTERS = 48
BLOCK_REGISTER = 25
"""Where polishd's scripts say which block is under way: the witness books by it."""
Rows = list[list[float]]


@dataclass(slots=True)
class UrWatchdog:
    """``rtde_set_watchdog``: an input that must be written so often."""

    longest_s: float
    action: str
    heard_s: float


@dataclass(slots=True)
class Controls:
    """Modes, registers, clock, arm and program: what its servers show, and what its scripts act on."""

    config: SimRobotSection
    arm: UrArm
    frame_s: float
    overhead_s: float
    """What each motion and each wait costs beyond itself."""
    speed: float
    """Seconds of the controller in one of the wall's."""
    began_s: float
    """Wall time at which its clock was 0."""
    complain: Callable[[int, str], None] = lambda _line, _text: None
    """Tells the clients of the primary interface: line, words."""
    time_s: float = 0.0
    runtime: int = STOPPED
    safety_mode: int = NORMAL
    robot_mode: int = RUNNING
    slider: float = 1.0
    pace: float = 1.0
    """Of the trajectory: falls to 0 in a pause."""
    override: SpeedOverride = field(default_factory=SpeedOverride)
    """Somebody has turned the slider, or the robot stands and does not report it: faults of the script."""
    remote: bool = True
    ints_in: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    ints_out: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    doubles_in: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    doubles_out: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    busy: int = 0
    """Statements under way that move or wait."""
    driven_by: int = 0
    """Those of them that move the arm."""
    watchdogs: dict[str, UrWatchdog] = field(default_factory=dict)
    rows: Rows = field(default_factory=list)
    """Motion since they were last taken, see ``bus.ROW``."""
    shares: list[tuple[float, float]] = field(default_factory=list)
    """(wall time, planned motion within a second of motion from then on) since they were last taken; ..."""
    share: float = 1.0
    """... and what it was then."""
    said: list[str] = field(default_factory=list)
    """``textmsg``."""
    program: RunningScript | None = None
    stops: int = 0
    """A script that was on its way in at one of them is forgotten."""
