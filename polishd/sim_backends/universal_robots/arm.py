"""The arm: the tool's pose, frame by frame. Lengths are mm; the trajectory's time stretches with the speed slider.

A line is a trapezoid of speed from rest to rest. A blend begins the next line as this one begins to decelerate, within
the blend radius, and adds both: straight on the speed stays. Without a motion command the arm brakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from polishd.config.simulator_devices import SimRobotSection
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.universal_robots.urscript import RunningScript

# Orientations: rotation vectors as URScript writes them, quaternions between, A and C for the plant.

Quaternion = tuple[float, float, float, float]
Triple = tuple[float, float, float]


def from_vector(vector: Sequence[float]) -> Quaternion:
    """Return the quaternion (w, x, y, z) of a rotation vector, rad."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    share = math.sin(angle / 2.0) / angle if angle > 1e-12 else 0.5
    return math.cos(angle / 2.0), x * share, y * share, z * share


def to_vector(quaternion: Quaternion) -> Triple:
    """Return the rotation vector, rad, of at most pi."""
    w, x, y, z = quaternion if quaternion[0] >= 0.0 else tuple(-part for part in quaternion)
    length = math.sqrt(x * x + y * y + z * z)
    share = 2.0 * math.atan2(length, w) / length if length > 1e-12 else 2.0
    return x * share, y * share, z * share


def turned(quaternion: Quaternion, vector: Sequence[float]) -> Triple:
    """Turn a vector."""
    w, x, y, z = quaternion
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def after(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return ``first`` times ``second``: turned by the second, then by the first."""
    a, b, c, d = first
    e, f, g, h = second
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def between(begin: Quaternion, end: Quaternion, share: float) -> Quaternion:
    """Interpolate between the two at constant angular speed."""
    dot = sum(a * b for a, b in zip(begin, end, strict=True))
    sign = 1.0 if dot >= 0.0 else -1.0
    angle = math.acos(min(abs(dot), 1.0))
    if angle < 1e-9:
        return end
    low, high = math.sin((1.0 - share) * angle) / math.sin(angle), sign * math.sin(share * angle) / math.sin(angle)
    w, x, y, z = (low * a + high * b for a, b in zip(begin, end, strict=True))
    return w, x, y, z


def angle(begin: Quaternion, end: Quaternion) -> float:
    """Return the angle between two orientations, rad."""
    return 2.0 * math.acos(min(abs(sum(a * b for a, b in zip(begin, end, strict=True))), 1.0))


def wrist_deg(quaternion: Quaternion) -> tuple[float, float]:
    """Return A and C of the plant, deg: the tool axis points from the tip into the spindle, against the frame's z."""
    x, y, z = (-part for part in turned(quaternion, (0.0, 0.0, 1.0)))
    a = math.acos(max(-1.0, min(z, 1.0)))
    return math.degrees(a), math.degrees(math.atan2(x, -y)) if a > 1e-9 else 0.0


def from_wrist(a_deg: float, c_deg: float) -> Quaternion:
    """Return an orientation that has these A and C."""
    half_a, half_c = math.radians(a_deg) / 2.0, math.radians(c_deg) / 2.0
    dip = after((math.cos(half_c), 0.0, 0.0, math.sin(half_c)), (math.cos(half_a), math.sin(half_a), 0.0, 0.0))
    return after(dip, (0.0, 1.0, 0.0, 0.0))


BRAKE_MM_S2 = 1200.0
TURN_RAD_S = 3.2
STILL_MM_S = 1e-6
REST: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ToolPose:
    """A pose of the tool, in the program's frame."""

    xyz_mm: Triple
    turn: Quaternion


@dataclass(slots=True)
class LinearMove:
    """A straight line with a trapezoid of speed."""

    begin: ToolPose
    end: ToolPose
    accel_mm_s2: float
    speed_mm_s: float
    done_s: float = 0.0
    length_mm: float = field(init=False)
    _top: float = field(init=False)

    def __post_init__(self) -> None:
        """A turn in place takes time, too."""
        way = math.dist(self.begin.xyz_mm, self.end.xyz_mm)
        self.length_mm = max(way, angle(self.begin.turn, self.end.turn) * self.speed_mm_s / TURN_RAD_S)
        self._top = min(self.speed_mm_s, math.sqrt(self.accel_mm_s2 * self.length_mm))

    @property
    def takes_s(self) -> float:
        """From rest to rest."""
        if not self.length_mm:
            return 0.0
        return self._top / self.accel_mm_s2 + self.length_mm / self._top

    @property
    def left_mm(self) -> float:
        """Length of its path."""
        return self.length_mm - self._along()

    def late_s(self, within_mm: float) -> float:
        """Time since the deceleration that takes at most this length began; negative before."""
        decelerates_s = math.sqrt(2.0 * within_mm / self.accel_mm_s2)
        return self.done_s - self.takes_s + min(decelerates_s, self._top / self.accel_mm_s2)

    def share(self) -> float:
        """Length of the path that is done."""
        return min(self._along() / self.length_mm, 1.0) if self.length_mm else 1.0

    def _along(self) -> float:
        up_s, t = self._top / self.accel_mm_s2, min(self.done_s, self.takes_s)
        down_s = max(t - (self.takes_s - up_s), 0.0)
        rise = 0.5 * self.accel_mm_s2 * min(t, up_s) ** 2
        return rise + self._top * max(t - up_s, 0.0) - 0.5 * self.accel_mm_s2 * down_s**2


@dataclass(slots=True)
class UrArm:
    """The arm, moved by one command at a time."""

    place: ToolPose
    velocity: Triple = REST
    """mm/s, wall time of the controller: with the slider."""
    _line: LinearMove | None = None
    _running_out: list[LinearMove] = field(default_factory=list)
    """Lines that were left within their blend radius."""
    _target: Triple | None = None
    """Commanded speed, ..."""
    _accel: float = BRAKE_MM_S2
    """... and acceleration."""

    @classmethod
    def at(cls, pose: tuple[float, ...]) -> UrArm:
        """Start at standstill at X Y Z A C of the plant."""
        x, y, z, a, c = pose
        return cls(ToolPose((x, y, z), from_wrist(a, c)))

    @property
    def stands(self) -> bool:
        """True at rest without a target."""
        return not self.moves and self._line is None and self._target is None

    @property
    def moves(self) -> bool:
        """True with a speed."""
        return math.hypot(*self.velocity) >= STILL_MM_S

    @property
    def follows(self) -> bool:
        """True on a line, at the trajectory's pace."""
        return self._line is not None

    @property
    def driven(self) -> bool:
        """True on a line or at a commanded speed; False while braking."""
        return self._line is not None or (self._target is not None and self._target != REST)

    def pose_m(self) -> list[float]:
        """The pose as URScript writes it: m and a rotation vector."""
        return [*(part / 1000.0 for part in self.place.xyz_mm), *to_vector(self.place.turn)]

    @property
    def commanded(self) -> ToolPose:
        """Where the present line ends, or the place."""
        return self.place if self._line is None else self._line.end

    def line(self, end: ToolPose, accel_mm_s2: float, speed_mm_s: float, late_s: float = 0.0) -> None:
        """Go there; the rest of an earlier line is added, from ``late_s`` ago: a blend loses no part of a frame."""
        begin = self.commanded
        if self._line is not None:
            self._running_out.append(self._line)
        else:
            late_s = 0.0
        self._line, self._target = LinearMove(begin, end, accel_mm_s2, speed_mm_s, late_s), None

    def reached(self, within_mm: float = 0.0) -> float | None:
        """Time since the line is done, or decelerates in at most this length, s; None before."""
        line = self._line
        if line is None:
            return 0.0
        late_s = line.late_s(within_mm) if within_mm > 0.0 else -1.0
        return late_s if late_s >= 0.0 else None

    def aim(self, velocity: Triple, accel_mm_s2: float) -> None:
        """Change to that velocity, mm/s, from the present one."""
        self._line, self._running_out = None, []
        self._target, self._accel = velocity, accel_mm_s2

    def brake(self, accel_mm_s2: float = BRAKE_MM_S2) -> None:
        """Come to rest."""
        self.aim(REST, accel_mm_s2)

    def step(self, dt_s: float, pace: float) -> None:
        """Move for one frame; ``pace`` is the speed of the trajectory, 1 is full speed."""
        before = self.place.xyz_mm
        if self._line is not None:
            self._follow(self._line, dt_s * pace)
            going = self._line is not None
            self.velocity = _scaled(_minus(self.place.xyz_mm, before), 1.0 / dt_s) if going else REST
        elif self._target is not None:
            self._approach(self._target, dt_s)

    def stand(self) -> None:
        """Stand for one frame, whatever drives the arm; braking is complete."""
        self.velocity = REST
        if self._target == REST:
            self._target = None

    def _follow(self, line: LinearMove, dt_s: float) -> None:
        for one in (line, *self._running_out):
            one.done_s += dt_s
        self._running_out = [one for one in self._running_out if one.left_mm > 1e-9]
        at = _between(line.begin.xyz_mm, line.end.xyz_mm, line.share())
        for one in self._running_out:
            at = _minus(at, _scaled(_minus(one.end.xyz_mm, one.begin.xyz_mm), 1.0 - one.share()))
        self.place = ToolPose(at, between(line.begin.turn, line.end.turn, line.share()))
        if line.done_s >= line.takes_s and not self._running_out:
            self._line = None

    def _approach(self, target: Triple, dt_s: float) -> None:
        lacking = _minus(target, self.velocity)
        change = math.hypot(*lacking)
        share = min(1.0, self._accel * dt_s / change) if change else 1.0
        new = _plus(self.velocity, _scaled(lacking, share))
        mean = _scaled(_plus(self.velocity, new), 0.5)
        self.place = ToolPose(_plus(self.place.xyz_mm, _scaled(mean, dt_s)), self.place.turn)
        self.velocity = new
        if share >= 1.0 and target == REST:
            self._target = None


def _plus(a: Triple, b: Triple) -> Triple:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(a: Triple, by: float) -> Triple:
    return a[0] * by, a[1] * by, a[2] * by


def _between(a: Triple, b: Triple, share: float) -> Triple:
    return _plus(a, _scaled(_minus(b, a), share))


# The state of a controller at one moment.

STOPPING, STOPPED, PLAYING, PAUSING, PAUSED, RESUMING = range(6)
NORMAL, PROTECTIVE_STOP, ROBOT_EMERGENCY_STOP = 1, 3, 7
POWER_OFF, RUNNING = 3, 7
REGISTERS = 48
BLOCK_REGISTER = 25
"""Register in which polishd's scripts report the block under way: the event log books by it."""
Rows = list[list[float]]


@dataclass(slots=True)
class UrWatchdog:
    """``rtde_set_watchdog``: an input that must be written at this rate."""

    longest_s: float
    action: str
    written_s: float


@dataclass(slots=True)
class Controls:
    """Modes, registers, clock, arm and program: shown by its servers, used by its scripts."""

    config: SimRobotSection
    arm: UrArm
    frame_s: float
    overhead_s: float
    """Extra time of each motion and each wait."""
    speed: float
    """Seconds of the controller in one wall second."""
    began_s: float
    """Wall time at which its clock was 0."""
    complain: Callable[[int, str], None] = lambda _line, _text: None
    """Send to the clients of the primary interface: line, message."""
    time_s: float = 0.0
    runtime: int = STOPPED
    safety_mode: int = NORMAL
    robot_mode: int = RUNNING
    slider: float = 1.0
    pace: float = 1.0
    """Speed of the trajectory: falls to 0 in a pause."""
    override: SpeedOverride = field(default_factory=SpeedOverride)
    """Faults of the script: an operator's slider, or a standstill that the robot does not report."""
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
    """Motion since the rows were last taken, see ``bus.ROW``."""
    shares: list[tuple[float, float]] = field(default_factory=list)
    """(wall time, planned motion within a second of motion from then on) since the pairs were last taken; ..."""
    share: float = 1.0
    """... and the last value."""
    messages: list[str] = field(default_factory=list)
    """Text of ``textmsg``."""
    program: RunningScript | None = None
    stops: int = 0
    """Number of the stop. A script that is still being received when it changes is dropped."""
