"""Lines of a FANUC TP program (.ls) as instructions of the Remote Motion Interface.

Only what the interface can execute is read: ``L``, ``J``, ``WAIT`` and comments. Other lines are refused with a remedy.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from polishd.api import DeviceRefused
from polishd.drivers.fanuc_rmi.motion_speed import MOST_TURN_DEG_S, StraightMove

LONGEST_LINE = 1000
"""Longest line of a program, bytes."""
Triple = tuple[float, float, float]

_LINE = re.compile(r"\s*\d*\s*:(.*)")
_LABEL = r"P\s*\[\s*(\d+)\s*(?::[^\]]*)?\]"
_LINEAR = re.compile(rf"L\s+{_LABEL}\s+([0-9.]+)\s*(mm/sec|cm/min|inch/min|sec|msec)\s+(\S+)(.*)")
_JOINT = re.compile(rf"J\s+{_LABEL}\s+([0-9.]+)\s*%\s+(\S+)(.*)")
_ZONE = re.compile(r"FINE|(CNT|CR)\s*(\d{1,3})")
_ACCELERATION = re.compile(r"\s*ACC\s*(\d{1,3})\s*")
_WAIT = re.compile(r"WAIT\s+([0-9.]+)\s*\(\s*sec\s*\)")
_NEUTRAL = re.compile(r"!.*|//.*|--eg:.*|LBL\s*\[[^\]]*\]|MESSAGE\s*\[[^\]]*\]|")
_FRAME = re.compile(r"(UFRAME_NUM|UTOOL_NUM)\s*=\s*(\d+)")
_POSITION = re.compile(rf"\s*{_LABEL}\s*\{{")
_FRAMES = re.compile(r"\bUF\s*:\s*(\d+)\s*,\s*UT\s*:\s*(\d+)")
_CONFIG = re.compile(r"\bCONFIG\s*:\s*'([^']*)'")
_ARM = re.compile(  # a CONFIG without its blanks
    r"(?P<flip>[NF])(?P<left>[LR]?)(?P<up>[UD])(?P<front>[TB])"
    r",(?P<turn4>[-+]?\d+),(?P<turn5>[-+]?\d+),(?P<turn6>[-+]?\d+)"
)
_VALUE = re.compile(r"\b([XYZWPR])\s*=\s*([-+]?[0-9.]+)\s*(?:mm|deg)")
_MM_S = {"cm/min": 1.0 / 6.0, "inch/min": 25.4 / 60.0, "mm/sec": 1.0}
_S = {"sec": 1.0, "msec": 1e-3}


@dataclass(frozen=True, slots=True)
class TpPosition:
    """A position of the program: what a motion instruction says of its target."""

    configuration: Mapping[str, int]
    """UTOOL and UFRAME numbers, flip, turns."""
    values: Mapping[str, float]
    """X, Y, Z in mm and W, P, R in deg."""

    @property
    def xyz_mm(self) -> Triple:
        """The place of the tool."""
        return self.values["X"], self.values["Y"], self.values["Z"]

    @property
    def frames(self) -> tuple[int, int]:
        """Numbers of user frame and user tool."""
        return self.configuration["UFrameNumber"], self.configuration["UToolNumber"]


@dataclass(frozen=True, slots=True)
class RmiInstruction:
    """One instruction, without its sequence number."""

    block: int
    """The program's line that it executes."""
    fields: Mapping[str, Any]
    seconds: float
    """Least time that it takes, s."""
    move: StraightMove | None = None
    """Of a linear move that turns the tool slowly."""


def positions_of(lines: Sequence[bytes]) -> dict[int, TpPosition]:
    """Return the positions behind ``/POS``, by number. DeviceRefused for one that cannot be read."""
    found: dict[int, TpPosition] = {}
    text = b"\n".join(lines).decode("latin-1")
    line, at = 1, 0
    for match in re.finditer(rf"^{_POSITION.pattern}([^}}]*)\}}", text, re.MULTILINE):
        line, at = line + text.count("\n", at, match.start(2)), match.start(2)
        found[int(match[1])] = _position(int(match[1]), match[2], line)
    return found


def _position(number: int, text: str, line: int) -> TpPosition:
    """Read what stands between the braces of a position, which begins in that line."""
    frames, config = _FRAMES.search(text), _CONFIG.search(text)
    values = {name: float(value) for name, value in _VALUE.findall(text)}
    if frames is None or config is None or set(values) != set("XYZWPR"):
        raise DeviceRefused(
            f"P[{number}] lacks UF, UT, CONFIG or one of X, Y, Z, W, P, R. Have it posted as a Cartesian position."
        )
    posture = _ARM.fullmatch(re.sub(r"\s", "", config[1]))
    if posture is None:
        line += text.count("\n", 0, config.start())
        raise DeviceRefused(
            f"line {line}: the CONFIG of P[{number}] is '{config[1]}', not N or F, L or R (or neither), U or D, T or "
            "B, and three turn numbers. Have it posted as in CONFIG : 'N U T, 0, 0, 0': with another arm configuration "
            "the robot may flip its arm."
        )
    configuration = {
        "UToolNumber": int(frames[2]),
        "UFrameNumber": int(frames[1]),
        "Front": int(posture["front"] == "T"),
        "Up": int(posture["up"] == "U"),
        "Left": int(posture["left"] == "L"),
        "Flip": int(posture["flip"] == "F"),
        **{f"Turn{axis}": int(posture[f"turn{axis}"]) for axis in (4, 5, 6)},
    }
    return TpPosition(configuration, values)


@dataclass(slots=True)
class TpReader:
    """Reads the lines of one program in order."""

    positions: Mapping[int, TpPosition]
    frames: tuple[int, int] | None = None
    """Numbers of user frame and user tool that the program works in; None: it has not moved yet."""
    _in_header: bool = False
    _ended: bool = False
    _here: TpPosition | None = None
    _owed_s: float = 0.0
    """Rounding that the next time of a move corrects."""

    @classmethod
    def of(cls, lines: Sequence[bytes]) -> TpReader:
        """Prepare to read a program from its first line. DeviceRefused where a position cannot be read."""
        positions = positions_of(lines)
        frames = {position.frames for position in positions.values()}
        if len(frames) > 1:
            pairs = ", ".join(f"UF {uframe} UT {utool}" for uframe, utool in sorted(frames))
            raise DeviceRefused(f"the positions are in several frames ({pairs}). Have them posted in one.")
        return cls(positions, next(iter(frames), None), any(line.strip() == b"/MN" for line in lines))

    def read(self, block: int, line: bytes) -> RmiInstruction | None:
        """Return the instruction of a line; None for one that neither moves nor waits. DeviceRefused by line."""
        text = line.decode("latin-1").strip()
        if self._in_header:
            self._in_header = text != "/MN"
            return None
        if self._ended or text == "/POS":
            self._ended = True
            return None
        if not text or text == "/END":
            return None
        match = _LINE.fullmatch(text)
        statement = match[1].strip() if match else ""
        if match is None or not (statement.endswith(";") or statement.startswith("!")):
            raise self._refused(block, text, "is no statement of a TP program", "Check [program] format")
        return self._statement(block, statement.removesuffix(";").strip())

    def _statement(self, block: int, text: str) -> RmiInstruction | None:
        if match := _LINEAR.fullmatch(text):
            return self._linear(block, text, match)
        if match := _JOINT.fullmatch(text):
            return self._joint(block, text, match)
        if match := _WAIT.fullmatch(text):
            seconds = float(match[1])
            return RmiInstruction(block, {"Instruction": "FRC_WaitTime", "Time": seconds}, seconds)
        if match := _FRAME.fullmatch(text):
            self._require_frame(block, text, match)
            return None
        if _NEUTRAL.fullmatch(text):
            return None
        raise self._refused(
            block, text, "cannot be sent over RMI", "Have the program posted with L, J, WAIT and comments only"
        )

    def _require_frame(self, block: int, text: str, match: re.Match[str]) -> None:
        """DeviceRefused where a frame is selected that the positions are not in."""
        used = None if self.frames is None else self.frames[match[1] == "UTOOL_NUM"]
        if used not in (None, int(match[2])):
            raise self._refused(block, text, f"selects another frame than the positions' {used}", "Select that one")

    def _linear(self, block: int, text: str, match: re.Match[str]) -> RmiInstruction:
        before = self._here
        position, length_mm = self._target(block, text, match[1])
        speed, seconds = self._speed(block, text, float(match[2]), match[3], length_mm)
        fields = {"Instruction": "FRC_LinearMotion", **_target_fields(position), **speed}
        move = None if before is None else _straight(before, position, seconds)
        return RmiInstruction(block, {**fields, **self._end(block, text, match[4], match[5])}, seconds, move)

    def _joint(self, block: int, text: str, match: re.Match[str]) -> RmiInstruction:
        position, _ = self._target(block, text, match[1])
        speed = {"SpeedType": "Percent", "Speed": max(round(float(match[2])), 1)}
        fields = {"Instruction": "FRC_JointMotion", **_target_fields(position), **speed}
        return RmiInstruction(block, {**fields, **self._end(block, text, match[3], match[4])}, 0.0)

    def _target(self, block: int, text: str, number: str) -> tuple[TpPosition, float]:
        position = self.positions.get(int(number))
        if position is None:
            raise self._refused(block, text, f"names P[{number}], which the program lacks", "Have it posted anew")
        length_mm = math.nan if self._here is None else math.dist(self._here.xyz_mm, position.xyz_mm)
        self._here = position
        return position, length_mm

    def _speed(self, block: int, text: str, number: float, unit: str, length_mm: float) -> tuple[dict[str, Any], float]:
        """Return the fields of a speed, and the least time of the move.

        RMI takes whole mm/s and ms. A speed with a fraction becomes the time of the move, and the rounding goes into
        the next one.
        """
        if unit in _S:
            return self._time(block, text, number * _S[unit])
        speed_mm_s = number * _MM_S[unit]
        if speed_mm_s <= 0.0:
            raise self._refused(block, text, "has no speed", "Give it one above 0")
        seconds = 0.0 if math.isnan(length_mm) else length_mm / speed_mm_s
        if speed_mm_s.is_integer() or not seconds:
            return {"SpeedType": "mmSec", "Speed": max(math.floor(speed_mm_s), 1)}, seconds
        return self._time(block, text, seconds)

    def _time(self, block: int, text: str, seconds: float) -> tuple[dict[str, Any], float]:
        if seconds <= 0.0:
            raise self._refused(block, text, "has no time", "Give it one above 0")
        wanted_s = seconds + self._owed_s
        ms = max(round(wanted_s * 1000.0), 1)
        self._owed_s = wanted_s - ms / 1000.0
        return {"SpeedType": "mSec", "Speed": ms}, ms / 1000.0

    def _end(self, block: int, text: str, zone: str, options: str) -> dict[str, Any]:
        """Return the fields of the move's end and its acceleration."""
        match = _ZONE.fullmatch(zone)
        if match is None:
            raise self._refused(block, text, f"ends in {zone}, which is not read", "Have it posted with FINE or CNT")
        end = {"TermType": match[1] or "FINE", "TermValue": int(match[2] or 0)}
        if not options.strip():
            return end
        acceleration = _ACCELERATION.fullmatch(options)
        if acceleration is None:
            raise self._refused(block, text, f"has the option {options.strip()}", "Have it posted without")
        return {**end, "ACC": int(acceleration[1])}

    @staticmethod
    def _refused(block: int, text: str, problem: str, remedy: str) -> DeviceRefused:
        return DeviceRefused(f"block {block} ({text[:60]}): {problem}. {remedy}.")


def _straight(begin: TpPosition, end: TpPosition, seconds: float) -> StraightMove | None:
    """Return the move; None where it has no length, or where turning the tool may take longer than moving it."""
    length_mm = math.dist(begin.xyz_mm, end.xyz_mm)
    steps_deg = [abs(end.values[axis] - begin.values[axis]) for axis in "WPR"]
    turn_deg = sum(min(step, 360.0 - step) for step in steps_deg)
    if not length_mm or not seconds or turn_deg > MOST_TURN_DEG_S * seconds:
        return None
    return StraightMove(begin.xyz_mm, end.xyz_mm, length_mm / seconds)


def _target_fields(position: TpPosition) -> dict[str, Any]:
    return {"Configuration": dict(position.configuration), "Position": dict(position.values)}


def instructions_of(lines: Sequence[bytes]) -> Iterator[RmiInstruction]:
    """Yield the instructions of a whole program. DeviceRefused by line for what the interface cannot execute."""
    reader = TpReader.of(lines)
    for block, line in enumerate(lines):
        if (instruction := reader.read(block, line)) is not None:
            yield instruction
