"""The process: LinuxCNC in private namespaces, its operator, and reports to the plant.

The configuration of a headless LinuxCNC has XYZ and a rotary A and C on five joints without motors. A and C turn the
tool about its tip, with joints equal to axes; or they are a tilting rotary table, whose joints LinuxCNC computes.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import math
import os
import shutil
import socket
import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from polishd.config import simulator_faults
from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ConfigError, DeviceFault
from polishd.model.surface import FloatArray
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import LOOPBACK, SimRuntime
from polishd.sim_backends.linuxcnc import pendant
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


# The process: LinuxCNC in private namespaces, its operator, and reports to the plant.

TICK_S = 0.01
TURN_S = 0.05
"""Time between two changes at the pendant: LinuxCNC's task takes each as a command."""
START_S = 90.0
ISOLATE = (
    *("setpriv", "--pdeathsig", "KILL", "unshare", "--map-root-user", "--mount", "--ipc", "--pid", "--fork"),
    *("--kill-child", "--mount-proc", "sh", "-c"),
)
"""A private process namespace: the script ``linuxcnc`` ends other instances by name. All processes end with ours."""
INSIDE = (
    'mount --bind "$1" {mount} && mount -t tmpfs none /tmp && cd {mount} && HOME={mount} '
    "exec unshare --map-user=1000 --map-group=1000 linuxcnc -r {mount}/machine.ini"
)
"""LinuxCNC refuses root, keeps its lock in /tmp, and allows short socket names only."""


class LinuxCncServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        start = runtime.start
        pose = tuple(runtime.link.welcome.get("pose") or start.config.robot.home)
        hidden = hidden_truth.draw(start.config.hidden_truth, start.seed)
        self.folder = start.state / "linuxcnc"
        self.machine = LinuxCncConfig(start.config.robot, pose, hidden.accel_mm_s2)
        self.sampled = Sampled(pose, time.monotonic(), to_pose=partial(pose_of, start.config.robot.rotary_axes_carry))
        self._runtime = runtime
        self._process: asyncio.subprocess.Process | None = None
        self._moved = self._rested = False
        self._override = SpeedOverride()
        self._turned = (1.0, False)
        """Wheel and interlock of the pendant, ..."""
        self._turned_s = 0.0
        """... and the time of their last change."""
        runtime.script.suffer = self._override.suffer

    async def run(self) -> None:
        """Run until it is cancelled."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.machine.write(self.folder)
        os.mkfifo(self.folder / MOTION)
        fifo = os.open(self.folder / MOTION, os.O_RDWR | os.O_NONBLOCK)  # opened for writing too: never at its end
        loop = asyncio.get_running_loop()
        loop.add_reader(fifo, lambda: self.sampled.feed(os.read(fifo, 1 << 16), time.monotonic()))
        try:
            await self._start()
            await switch_on(SHELL_PORT)
            self._runtime.ready(f"tcp://{LOOPBACK}:{self.machine.robot.port}")
            self._runtime.begin_script()
            while True:
                await asyncio.sleep(TICK_S)
                self._turn(time.monotonic())
                self.report()
        finally:
            loop.remove_reader(fifo)
            os.close(fifo)
            if self._process is not None and self._process.returncode is None:
                self._process.kill()

    def report(self) -> None:
        """Report the motion since the last call to the plant."""
        sampled, link = self.sampled, self._runtime.link
        rows = sampled.take_rows()
        if sampled.moving and not self._moved:
            self._see_program()
            link.event("motion_started", sampled.wall_s if not len(rows) else float(rows[0, 1]))
        link.rows(rows, sampled.wall_s, sampled.pose)
        if sampled.rests != self._rested:
            link.event("rest_begun" if sampled.rests else "rest_ended", sampled.wall_s, at_seq=sampled.seq)
        if self._moved and not sampled.moving:
            link.event("motion_stopped", sampled.wall_s)
        self._moved, self._rested = sampled.moving, sampled.rests

    def _turn(self, now_s: float) -> None:
        """Work the pendant as the faults of the script demand."""
        turned = self._override.reported(now_s), self._override.stands
        if turned != self._turned and now_s >= self._turned_s + TURN_S:
            self._turned, self._turned_s = turned, now_s
            self._runtime.link.pace(self._override.actual(now_s), now_s)
            pendant.write(self.folder / PENDANT, turned[0], inhibit=turned[1])

    def _see_program(self) -> None:
        found = sorted((self.folder / PROGRAMS).glob("*.ngc"), key=lambda path: path.stat().st_mtime_ns)
        program = LinuxCncProgram.read(found[-1]) if found else None
        if program is not None and program != self.sampled.program:
            self._runtime.link.event("program_loaded", sha256=program.sha256, blocks=program.blocks)
            self.sampled.seq = -1
        self.sampled.program = program

    async def _start(self) -> None:
        with (self.folder / "linuxcnc.log").open("wb") as log:
            self._process = await asyncio.create_subprocess_exec(
                *ISOLATE,
                INSIDE.format(mount=MOUNT),
                "sh",
                str(self.folder),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )


async def switch_on(port: int) -> None:
    """Act as the operator: out of e-stop, on, homed. DeviceFault where LinuxCNC does not come up."""
    try:
        async with asyncio.timeout(START_S):
            reader, writer = await _connect(port)
            for order in ("hello EMC operator 1.0", "set echo off", "set verbose on", "set enable EMCTOO"):
                writer.write(order.encode() + b"\r\n")
                await reader.readline()
            for order in ("set estop off", "set machine on", "set home -1"):
                writer.write(order.encode() + b"\r\n")
                while b"ACK" not in await reader.readline():
                    pass
            homed = b""
            while homed.count(b"YES") < len("XYZAC"):
                writer.write(b"get joint_homed\r\n")
                while b"JOINT_HOMED" not in (homed := await reader.readline()):
                    pass
                await asyncio.sleep(TICK_S)
            writer.close()
    except TimeoutError:
        raise DeviceFault(f"LinuxCNC was not up, on and homed within {START_S:g} s; see linuxcnc.log") from None


async def _connect(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    while True:
        with contextlib.suppress(OSError):
            return await asyncio.open_connection(LOOPBACK, port)
        await asyncio.sleep(0.05)


def require_alone(path: Path = Path("/proc/self/ns/net")) -> None:
    """ConfigError where another computer can reach linuxcncrsh, which listens on every interface without protection."""
    others = [name for _, name in socket.if_nameindex() if name != "lo"]
    if others:
        raise ConfigError(
            f"robot.kind = 'linuxcnc' listens on every interface, and this network ({path}) has {', '.join(others)}. "
            "To do: unshare --map-root-user --net sh -c 'ip link set lo up; exec polishd sim SIM.toml'"
        )


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    require_alone()
    if runtime.start.speed != 1.0:
        raise ConfigError("robot.kind = 'linuxcnc' runs in real time. To do: plant.speed = 1, or --speed 1")
    if shutil.which("linuxcnc") is None:
        raise ConfigError("linuxcnc is not installed. To do: apt-get install linuxcnc-uspace")
    await LinuxCncServer(runtime).run()


SIM_DEVICES = [
    SimDevice(
        name="linuxcnc",
        device="robot",
        section=SimRobotSection,
        links={"linuxcnc": {}},
        main=main,
        faults=simulator_faults.MOTION,
    )
]
