"""The configuration of a headless LinuxCNC: XYZ and a rotary A and C on five joints without motors.

A and C turn the tool about its tip, with joints equal to axes; or they are a tilting rotary table, whose joints
LinuxCNC computes.
"""

from __future__ import annotations

import hashlib
import math
import shutil
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polishd.config.simulator import SimRobotSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.linuxcnc.pendant import COUNT

# The sampler's data of the motion, in the form of the plant. Pure of I/O; the caller passes wall times.

LINE, RUNS, PAUSED, HELD = range(5, 9)
COLUMNS = 9
SAMPLE_S = 0.005
"""Time between two samples on LinuxCNC's clock, which catches up after a delay."""
STILL_SAMPLES = 4
"""This many equal samples are a rest; without a program under way, a standstill."""
MARK = b"(MSG,polishd "


@dataclass(frozen=True, slots=True)
class LinuxCncProgram:
    """A program file without the lines that polishd's driver inserts."""

    sha256: str
    blocks: int
    inserted: tuple[int, ...]

    @classmethod
    def read(cls, path: Path) -> LinuxCncProgram:
        """Parse the file."""
        lines = path.read_bytes().removesuffix(b"\n").split(b"\n")
        own = [line for line in lines if not line.startswith(MARK)]
        inserted = tuple(at for at, line in enumerate(lines) if line.startswith(MARK))
        return cls(hashlib.sha256(b"\n".join(own)).hexdigest(), len(own), inserted)

    def block_at(self, line: int) -> int:
        """Return the 0-based block of a 1-based line; -1 for none."""
        return line - 1 - bisect_left(self.inserted, line - 1) if line > 0 else -1


@dataclass(slots=True)
class Sampled:
    """Turn samples into rows for the plant (``bus.ROW``)."""

    pose: tuple[float, ...]
    wall_s: float
    """Time of the last samples."""
    program: LinuxCncProgram | None = None
    moving: bool = False
    running: bool = False
    seq: int = -1
    """Block of the last motion. LinuxCNC reports none for a dwell; its time is booked with the move before it."""
    _still: int = STILL_SAMPLES
    _rest: bytes = b""
    rows: list[list[float]] = field(default_factory=list)
    to_pose: Callable[[Sequence[float]], tuple[float, ...]] = tuple
    """Of joints."""

    @property
    def rests(self) -> bool:
        """At standstill while its program runs: a dwell."""
        return self.running and self._still >= STILL_SAMPLES

    def feed(self, data: bytes, now_s: float) -> None:
        """Take new samples; they are spread over the time since the last ones.

        The part is polished on LinuxCNC's own time: on a busy machine samples come late, then many at once.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        samples = [s for s in (line.split() for line in lines) if len(s) == COLUMNS]
        edges = np.linspace(self.wall_s, now_s, len(samples) + 1).tolist()
        for sample, begin, end in zip(samples, edges[:-1], edges[1:], strict=True):
            self._take([float(value) for value in sample], begin, end)
        if samples:
            self.wall_s = now_s

    def take_rows(self) -> FloatArray:
        """Return (n, 9) since the last call."""
        rows, self.rows = self.rows, []
        return np.array(rows).reshape(-1, 9)

    def _take(self, sample: list[float], begin_s: float, end_s: float) -> None:
        here = self.to_pose(sample[:5])
        changed = here != self.pose
        self.running = bool(sample[RUNS]) and not sample[PAUSED] and not sample[HELD]
        self._still = 0 if changed else self._still + 1
        self.moving = self.running or self._still < STILL_SAMPLES
        if self.moving:
            self.seq = self._block(int(sample[LINE]))
            middle = [(a + b) / 2 for a, b in zip(self.pose, here, strict=True)]
            self.rows.append([self.seq, begin_s, end_s, SAMPLE_S, *middle])
        self.pose = here

    def _block(self, line: int) -> int:
        if self.program is None or not (line or self.running):
            return -1
        return self.program.block_at(line) if line else self.seq


MOUNT = Path("/mnt")
"""Path of its folder, as the process sees it."""
PROGRAMS = "nc"
PENDANT = "pendant"
MOTION = "motion"
SHELL_PORT = 5007
"""Port of linuxcncrsh; the gate in front of it has the robot's port."""
AXES = "XYZAC"
KINEMATICS = {"tool": "trivkins coordinates=XYZAC", "table": "xyzac-trt-kins"}
TURN_MM_S = 100.0
ANY_DEG = 36000.0
Vector = tuple[float, float, float]
Pose = tuple[float, ...]

_INI = """[EMC]
VERSION = 1.1
MACHINE = polishd-sim
[DISPLAY]
DISPLAY = linuxcncrsh --port {shell_port}
PROGRAM_PREFIX = {mount}/{programs}
MAX_FEED_OVERRIDE = 2.0
[FILTER]
[RS274NGC]
PARAMETER_FILE = machine.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.005
[HAL]
HALUI = halui
HALFILE = machine.hal
[TRAJ]
COORDINATES = X Y Z A C
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = {rapid:g}
MAX_LINEAR_VELOCITY = {top:g}
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = machine.tbl
[KINS]
KINEMATICS = {kinematics}
JOINTS = 5
"""
_AXIS = """[AXIS_{axis}]
MIN_LIMIT = {low:g}
MAX_LIMIT = {high:g}
MAX_VELOCITY = {speed:g}
MAX_ACCELERATION = {accel:g}
[JOINT_{joint}]
TYPE = {kind}
MIN_LIMIT = {joint_low:g}
MAX_LIMIT = {joint_high:g}
MAX_VELOCITY = {speed:g}
MAX_ACCELERATION = {accel:g}
HOME = {home:.6f}
HOME_OFFSET = {home:.6f}
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
FERROR = 10
MIN_FERROR = 10
"""
_HAL = """loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt siggen num_chan=1
loadrt wcomp count=1
loadrt sampler depth=8000 cfg=fffffsbbb
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf siggen.0.update servo-thread
addf wcomp.0 servo-thread
addf sampler.0 servo-thread
setp siggen.0.frequency {samples_hz:g}
setp siggen.0.amplitude 1
setp wcomp.0.min 0.4
setp wcomp.0.max 0.8
net saw siggen.0.sawtooth => wcomp.0.in
net sample wcomp.0.out => sampler.0.enable
{joints}
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
net line motion.program-line => sampler.0.pin.5
net running halui.program.is-running => sampler.0.pin.6
net paused halui.program.is-paused => sampler.0.pin.7
loadusr -Wn polishd-gate /usr/bin/python3 {mount}/hal_gate.py 127.0.0.1:{port} 127.0.0.1:{shell_port} {watchdog_s:g}
net idle halui.program.is-idle => polishd-gate.idle
net hold polishd-gate.hold => motion.feed-hold sampler.0.pin.8
loadusr -Wn polishd-pendant /usr/bin/python3 {mount}/pendant.py {mount}/{pendant}
setp halui.feed-override.scale {count:g}
setp halui.feed-override.direct-value 1
setp halui.feed-override.count-enable 1
net override polishd-pendant.counts => halui.feed-override.counts
net inhibit polishd-pendant.inhibit => motion.feed-inhibit
loadusr stdbuf -oL halsampler {mount}/{motion}
"""


@dataclass(frozen=True, slots=True)
class LinuxCncConfig:
    """The values to be configured."""

    robot: SimRobotSection
    pose: tuple[float, ...]
    """X Y Z (mm) A C (deg) at power-up."""
    accel_mm_s2: float

    def write(self, folder: Path) -> None:
        """Write all files into an empty folder."""
        (folder / PROGRAMS).mkdir(parents=True, exist_ok=True)
        (folder / "machine.ini").write_text(self.ini())
        (folder / "machine.hal").write_text(self.hal())
        (folder / "machine.tbl").write_text("")
        for component in ("hal_gate.py", "pendant.py"):
            shutil.copy(Path(__file__).with_name(component), folder)

    def ini(self) -> str:
        """Return ``machine.ini``."""
        robot = self.robot
        top = max(robot.max_feed_mm_s, robot.rapid_mm_s)
        head = _INI.format(
            shell_port=SHELL_PORT,
            rapid=robot.rapid_mm_s,
            top=top,
            mount=MOUNT,
            programs=PROGRAMS,
            kinematics=KINEMATICS[robot.rotary_axes_carry],
        )
        ranges = (robot.x_mm, robot.y_mm, robot.z_mm, self._tilt_deg, (-ANY_DEG, ANY_DEG))
        homes = joints_of(robot.rotary_axes_carry, self.pose)
        reach = math.hypot(*(max(map(abs, limits)) for limits in ranges[:3]))
        for joint, (axis, (low, high), home) in enumerate(zip(AXES, ranges, homes, strict=True)):
            turns = axis in "AC"
            wide = robot.rotary_axes_carry == "table" and not turns
            head += _AXIS.format(
                axis=axis,
                joint=joint,
                kind="ANGULAR" if turns else "LINEAR",
                low=low,
                high=high,
                joint_low=-reach if wide else low,
                joint_high=reach if wide else high,
                speed=TURN_MM_S if turns else top,
                accel=self.accel_mm_s2,
                home=home,
            )
        return head

    @property
    def _tilt_deg(self) -> tuple[float, float]:
        low, high = self.robot.a_deg
        return (low, high) if self.robot.rotary_axes_carry == "tool" else (-high, -low)

    def hal(self) -> str:
        """Return ``machine.hal``: motors that follow commands exactly, a sampler of the position, the gate.

        It samples one servo cycle of five within the thread that moves: after a delay, a separate thread would catch
        up and report one position many times.
        """
        joints = "\n".join(
            f"net motor{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb\n"
            f"net joint{joint} joint.{joint}.pos-fb => sampler.0.pin.{joint}"
            for joint in range(len(AXES))
        )
        return _HAL.format(
            joints=joints,
            samples_hz=1.0 / SAMPLE_S,
            mount=MOUNT,
            motion=MOTION,
            port=self.robot.port,
            shell_port=SHELL_PORT,
            watchdog_s=self.robot.watchdog_s,
            pendant=PENDANT,
            count=COUNT,
        )


def joints_of(turns: str, pose: Sequence[float]) -> Pose:
    """Return joints (X Y Z mm, A C deg) for a pose: tip on the part, and A and C as of a head that turns the tool."""
    if turns == "tool":
        return tuple(pose)
    x, y, z, a, c = pose
    return (*_turn(_turn((x, y, z), 2, -c), 0, -a), -a, -c)


def pose_of(turns: str, joints: Sequence[float]) -> Pose:
    """Return the pose of joints."""
    if turns == "tool":
        return tuple(joints)
    x, y, z, a, c = joints
    return (*_turn(_turn((x, y, z), 0, -a), 2, -c), -a, -c)


def _turn(point: Vector, about: int, degrees: float) -> Vector:
    """Turn about that axis, counterclockwise."""
    one, other = (about + 1) % 3, (about + 2) % 3
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    found = list(point)
    found[one], found[other] = cosine * point[one] - sine * point[other], sine * point[one] + cosine * point[other]
    return (found[0], found[1], found[2])
