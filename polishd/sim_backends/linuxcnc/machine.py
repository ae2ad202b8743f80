"""The configuration of a headless LinuxCNC: XYZ and a rotary A and C on five joints without motors."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from polishd.config.simulator import Robot

MOUNT = Path("/mnt")
"""Where the process sees its folder."""
PROGRAMS = "nc"
MOTION = "motion"
SHELL_PORT = 5007
"""linuxcncrsh's own; the gate in front of it has the robot's."""
SAMPLE_S = 0.005
AXES = "XYZAC"
TURN_MM_S = 100.0
ANY_DEG = 36000.0

_INI = """[EMC]
VERSION = 1.1
MACHINE = polishd-sim
[DISPLAY]
DISPLAY = linuxcncrsh --port {shell_port}
PROGRAM_PREFIX = {mount}/{programs}
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
KINEMATICS = trivkins coordinates=XYZAC
JOINTS = 5
"""
_AXIS = """[AXIS_{axis}]
MIN_LIMIT = {low:g}
MAX_LIMIT = {high:g}
MAX_VELOCITY = {speed:g}
MAX_ACCELERATION = {accel:g}
[JOINT_{joint}]
TYPE = {kind}
MIN_LIMIT = {low:g}
MAX_LIMIT = {high:g}
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
loadrt threads name1=slow-thread period1={period_ns}
loadrt sampler depth=8000 cfg=fffffsbbb
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf sampler.0 slow-thread
{joints}
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
net line motion.program-line => sampler.0.pin.5
net running halui.program.is-running => sampler.0.pin.6
net paused halui.program.is-paused => sampler.0.pin.7
loadusr -Wn polishd-gate /usr/bin/python3 {mount}/gate.py 127.0.0.1:{port} 127.0.0.1:{shell_port} {watchdog_s:g}
net idle halui.program.is-idle => polishd-gate.idle
net hold polishd-gate.hold => motion.feed-hold sampler.0.pin.8
loadusr stdbuf -oL halsampler {mount}/{motion}
"""


@dataclass(frozen=True, slots=True)
class Machine:
    """What is to be configured."""

    robot: Robot
    pose: tuple[float, ...]
    """X Y Z (mm) A C (deg): where it stands when it is switched on."""
    accel_mm_s2: float

    def write(self, folder: Path) -> None:
        """All files, into an empty folder."""
        (folder / PROGRAMS).mkdir(parents=True, exist_ok=True)
        (folder / "machine.ini").write_text(self.ini())
        (folder / "machine.hal").write_text(self.hal())
        (folder / "machine.tbl").write_text("")
        shutil.copy(Path(__file__).with_name("gate.py"), folder)

    def ini(self) -> str:
        """``machine.ini``."""
        robot = self.robot
        top = max(robot.max_feed_mm_s, robot.rapid_mm_s)
        head = _INI.format(shell_port=SHELL_PORT, rapid=robot.rapid_mm_s, top=top, mount=MOUNT, programs=PROGRAMS)
        ranges = (robot.x_mm, robot.y_mm, robot.z_mm, robot.a_deg, (-ANY_DEG, ANY_DEG))
        for joint, (axis, (low, high), home) in enumerate(zip(AXES, ranges, self.pose, strict=True)):
            turns = axis in "AC"
            head += _AXIS.format(
                axis=axis,
                joint=joint,
                kind="ANGULAR" if turns else "LINEAR",
                low=low,
                high=high,
                speed=TURN_MM_S if turns else top,
                accel=self.accel_mm_s2,
                home=home,
            )
        return head

    def hal(self) -> str:
        """``machine.hal``: motors that are where they are told, a sampler that tells where, the gate."""
        joints = "\n".join(
            f"net motor{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb\n"
            f"net joint{joint} joint.{joint}.pos-fb => sampler.0.pin.{joint}"
            for joint in range(len(AXES))
        )
        return _HAL.format(
            joints=joints,
            period_ns=round(SAMPLE_S * 1e9),
            mount=MOUNT,
            motion=MOTION,
            port=self.robot.port,
            shell_port=SHELL_PORT,
            watchdog_s=self.robot.watchdog_s,
        )
