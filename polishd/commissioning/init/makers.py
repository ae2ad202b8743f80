"""Robots by their makers: driver, language and arms of each, and the part's frame in the maker's terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from polishd.model.program import Encoding

MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class FrameForm:
    """How a maker states a frame in the robot's base frame."""

    key: str
    """Key of the answers."""
    what: str
    count: int
    turn: Callable[[Sequence[float]], Rotation]
    """Rotation of the numbers after the position."""
    mm: float = 1.0
    """Of one unit of its position."""

    def check(self, values: Sequence[float]) -> None:
        """ValueError for another count of numbers, or for a quaternion that is none."""
        if len(values) != self.count:
            raise ValueError(f"{self.key}: has {len(values)} numbers, not {self.count}: {self.what}")
        if self.count == 7 and abs(np.linalg.norm(values[3:]) - 1.0) > 1e-3:
            raise ValueError(f"{self.key}: q1 to q4 are no rotation, their squares must add up to 1")

    def placement(self, values: Sequence[float]) -> tuple[list[float], list[float]]:
        """Return `part.origin_mm` and `part.rotation_rpy_deg`, intrinsic about x, y' and z''."""
        rpy = self.turn(values[3:]).as_euler("XYZ", degrees=True)
        origin = [round(self.mm * value, 6) + 0.0 for value in values[:3]]
        return origin, [round(float(value), 6) + 0.0 for value in rpy]


def _euler(axes: str) -> Callable[[Sequence[float]], Rotation]:
    return lambda values: Rotation.from_euler(axes, values, degrees=True)


_FIXED = "rotations in deg about the fixed X, Y, Z"
FRAMES: Mapping[str, FrameForm] = {
    form.key: form
    for form in (
        FrameForm("wobj", "x, y, z in mm and q1 to q4", 7, lambda q: Rotation.from_quat([*q[1:], q[0]])),
        FrameForm("base", "X, Y, Z in mm and A, B, C in deg", 6, _euler("ZYX")),
        FrameForm("uframe", f"X, Y, Z in mm and W, P, R, {_FIXED}", 6, _euler("xyz")),
        FrameForm("user_frame", f"X, Y, Z in mm and Rx, Ry, Rz, {_FIXED}", 6, _euler("xyz")),
        FrameForm("frame", "x, y, z in mm and rx, ry, rz in deg about X, Y', Z''", 6, _euler("XYZ")),
        FrameForm("feature", "x, y, z in m and the rotation vector in rad", 6, Rotation.from_rotvec, MM_PER_M),
    )
}
"""By key of the answers."""


@dataclass(frozen=True, slots=True)
class RobotMaker:
    """What a cell with such a robot begins with."""

    title: str
    device: Mapping[str, Any]
    """Keys of [robot]."""
    format: str
    """Of its programs."""
    program: str
    """File of the program."""
    arms: tuple[str, ...] = ()
    """Known ones, the usual one first; none: no six-axis arm."""
    frame: FrameForm | None = None
    assumed: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    """Other keys by dotted name, with what has to be looked at about them."""
    encoding: Encoding = "feed"
    """Of a made program's times."""
    dwell_s: float | None = None
    """Of each point, if its encoding is dwell."""


WHERE = "where the controller is reached"
LIFTS_SOON = "an actuator that lifts within 1.1 s of the last message: the controller holds 8 instructions only"
FEED_HOLD_NM = (
    150.0,
    "what a feed hold at the controller may dig: report, link and actuator.release_s times the rate; shorten them",
)
"""A controller that is seen by its reports."""

MAKERS: Mapping[str, RobotMaker] = {
    "abb": RobotMaker(
        "ABB, by Robot Web Services",
        {"type": "abb_rws", "address": "tcp://192.168.125.1:80", "watchdog_s": 10.0},
        "rapid",
        "program.mod",
        ("irb4600-40-255", "irb6700-200-260"),
        FRAMES["wobj"],
        encoding="time",
    ),
    "fanuc": RobotMaker(
        "FANUC, by the Remote Motion Interface",
        {"type": "fanuc_rmi", "address": "tcp://192.168.0.10:16001"},
        "fanuc-tp",
        "part.ls",
        ("m20ia", "crx10ia-l"),
        FRAMES["uframe"],
        {
            "actuator.silence_s": (0.2, LIFTS_SOON),
            "actuator.watchdog_ms": (400, LIFTS_SOON),
            "actuator.release_s": (0.2, LIFTS_SOON),
            "actuator.retract_s": (0.5, LIFTS_SOON),
            "machine.least_point_s": (0.18, "the shortest point: 7 of them last longer than a lift"),
            "job.stream_ahead_s": (1.2, "motion that is ahead when contact begins: less than 7 points last"),
        },
        encoding="time",  # with waits only 3 points are in the 8 instructions
    ),
    "kuka": RobotMaker(
        "KUKA, behind C3 Bridge",
        {
            "type": "kuka_kvp",
            "address": "tcp://192.168.10.21:7000",
            "delivery": "folder:kuka/R1/Program",
        },
        "krl",
        "program.src",
        ("kr10-r1100", "kr30-3"),
        FRAMES["base"],
    ),
    "yaskawa": RobotMaker(
        "Yaskawa, INFORM jobs by FTP and variables by OPC UA",
        {
            "type": "plc_robot",
            "profile": "yaskawa-inform",
            "address": "opc.tcp://192.168.1.20:4840",
            "delivery": "ftp://rcmaster@192.168.1.21/JOB",
        },
        "inform",
        "POLISH.JBI",
        ("gp25",),
        FRAMES["user_frame"],
        {"limits.max_stall_removal_nm": FEED_HOLD_NM},
        encoding="dwell",  # V= has steps of 0.1 mm/s, too coarse for corrections of short moves
        dwell_s=0.3,
    ),
    "staubli": RobotMaker(
        "Staubli, VAL3 programs by FTP and variables by OPC UA",
        {
            "type": "plc_robot",
            "profile": "staubli-val3",
            "address": "opc.tcp://192.168.1.20:4840",
            "delivery": "ftp://maintenance@192.168.1.20/usrapp/polishd",
        },
        "val3",
        "polish.pgx",
        ("tx2-90",),
        FRAMES["frame"],
        {"limits.max_stall_removal_nm": FEED_HOLD_NM},
    ),
    "ur": RobotMaker(
        "Universal Robots",
        {"type": "universal_robots", "address": "tcp://192.168.0.3:30004"},
        "urscript",
        "program.script",
        ("ur10e", "ur5e", "ur16e", "ur10", "ur5"),
        FRAMES["feature"],
    ),
    "linuxcnc": RobotMaker(
        "LinuxCNC",
        {"type": "linuxcnc", "address": "tcp://192.168.1.30:5007", "program_dir": "nc"},
        "rs274",
        "program.ngc",
    ),
}
"""By the name of an answer."""
