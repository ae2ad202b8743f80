"""The controller: sessions, commands, instructions and their execution. Pure of I/O; the caller passes wall times.

The tool moves from one target to the next with the look-ahead of what is held, at most 8 instructions. It stops at a
target with FINE and at a corner; with CNT or CR it moves on at the lower of both speeds.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import DeviceRefused
from polishd.sim_backends.fanuc_rmi.section import SimFanucRmiSection
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.program_reader import Pose, Reach, SimProgramBlock

HELD = 8
CAPACITY = 200_000
"""Instructions after one FRC_Initialize."""
LONGEST = 8192
FRAMES, TOOLS, PORTS = 9, 10, 512
RUNNING, PAUSED, ABORTED = 1, 2, 3
_RMIT = 2556928
INTERNAL, BAD_TOOL, BAD_FRAME, BAD_OVERRIDE, CANNOT_RUN = _RMIT + 1, _RMIT + 2, _RMIT + 3, _RMIT + 5, _RMIT + 6
SERVO_OFF, PENDANT_ON, NOT_RUNNING, NOT_PAUSED = _RMIT + 7, _RMIT + 8, _RMIT + 9, _RMIT + 10
NO_RESET, BAD_COMMAND, WRONG_STATE = _RMIT + 12, _RMIT + 13, _RMIT + 15
BAD_INSTRUCTION, BAD_VALUE, BAD_POSITION, IN_HOLD = _RMIT + 20, _RMIT + 21, _RMIT + 23, _RMIT + 24
CONNECTED, TOO_MANY, BAD_SEQUENCE = _RMIT + 26, _RMIT + 28, _RMIT + 29
BAD_SPEED_TYPE, BAD_SPEED, BAD_TERM_TYPE, BAD_TERM = _RMIT + 30, _RMIT + 31, _RMIT + 32, _RMIT + 33
OUT_OF_REACH, BAD_PORT = _RMIT + 36, _RMIT + 38
FLAT = dict.fromkeys("XYZWPR", 0.0)
Message = dict[str, Any]


def wrist_of(w_deg: float, p_deg: float, r_deg: float) -> tuple[float, float]:
    """Return A and C of the plant, deg: turned about the fixed X, Y, Z; the tool frame's z points into the part."""
    w, p, r = map(math.radians, (w_deg, p_deg, r_deg))
    x = math.cos(r) * math.sin(p) * math.cos(w) + math.sin(r) * math.sin(w)
    y = math.sin(r) * math.sin(p) * math.cos(w) - math.cos(r) * math.sin(w)
    z = math.cos(p) * math.cos(w)
    a = math.acos(max(-1.0, min(-z, 1.0)))
    return math.degrees(a), math.degrees(math.atan2(-x, y)) if a > 1e-9 else 0.0


def turns_of(a_deg: float, c_deg: float) -> tuple[float, float, float]:
    """Return W, P, R, deg, of a tool with that A and C."""
    return _half_turn(a_deg + 180.0), 0.0, _half_turn(c_deg)


def _half_turn(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


@dataclass(slots=True)
class FanucController:
    """The controller behind both ports."""

    config: SimFanucRmiSection
    motion: SimMotion
    reach: Reach
    report: Callable[..., None]
    """Write to the event log: (event, at_s=now, **data)."""
    session_port: int = 0
    servo_ready: bool = True
    estop: bool = False
    pendant_enabled: bool = False
    mode: str = "AUTO"
    """Of the mode switch: AUTO, T1, T2."""
    remote: bool = True
    """Programs may be started from outside."""
    frame_follows: bool = True
    """It selects the frames that it is asked for."""
    program: int = ABORTED
    initialized: bool = False
    in_hold: bool = False
    """It takes no instruction before FRC_Reset."""
    slider: float = 1.0
    """Speed override of the operator, or of FRC_SetOverRide."""
    next_sequence: int = 1
    send: Callable[[bytes], None] | None = None
    """To the client of the session; None while there is none."""
    _held: deque[tuple[int, str]] = field(default_factory=deque)
    """Sequence number and name of each instruction that is not executed."""
    _answered: int = 0
    """Executed instructions of the motion that were answered."""
    _target: dict[str, float] = field(default_factory=lambda: dict(FLAT))
    """Target of the last instruction."""
    _stops: bool = True
    _frames: tuple[int, int] = (0, 1)
    _frame_data: dict[tuple[str, int], dict[str, float]] = field(default_factory=dict)
    _outputs: dict[int, str] = field(default_factory=dict)
    """Each is wired to the input of the same number."""
    _errors: list[str] = field(default_factory=list)
    _later: list[tuple[Callable[[], bool], Message]] = field(default_factory=list)
    """Answers that wait for a condition."""
    _is_orphan: bool = False
    """Its client is gone."""
    _was: str = "idle"

    # The first port and the session.

    def on_connect_line(self, line: bytes) -> Message:
        """Answer a line of the first port."""
        if _parsed(line).get("Communication") != "FRC_Connect":
            return {"Communication": "Unknown", "ErrorID": BAD_COMMAND}
        if self.send is not None:
            return {"Communication": "FRC_Connect", "ErrorID": CONNECTED}
        version = {"MajorVersion": 5, "MinorVersion": 0}
        return {"Communication": "FRC_Connect", "ErrorID": 0, "PortNumber": self.session_port, **version}

    def begin(self, send: Callable[[bytes], None]) -> bool:
        """Begin a session; False while another client has it."""
        if self.send is not None:
            return False
        self.send, self._is_orphan = send, False
        self.report("client", client="rmi")
        return True

    def end(self, now_s: float) -> None:
        """The client is gone: RMI_MOVE ends when the instructions that it holds are executed."""
        self.motion.advance(now_s)
        self.send, self._is_orphan = None, True
        self._later.clear()

    def on_line(self, line: bytes, now_s: float) -> None:
        """Act on a line of the session."""
        self.motion.advance(now_s)
        message = _parsed(line)
        kind = next((kind for kind in ("Communication", "Command", "Instruction") if kind in message), "")
        if kind == "Instruction":
            self._take(message, now_s)
        elif kind == "Command":
            self._command(message, now_s)
        elif message.get("Communication") == "FRC_Disconnect":
            self._abort(now_s)
            self.next_sequence = 1
            self._say({"Communication": "FRC_Disconnect", "ErrorID": 0})
        else:
            self._say({"Communication": "Unknown", "ErrorID": BAD_COMMAND})

    # Time.

    def tick(self, now_s: float) -> None:
        """Execute up to the present, and answer what is done."""
        self.motion.advance(now_s)
        self._answer_executed()
        if self.program == RUNNING and self.motion.state == "held" and self._held and not self.motion.stopping:
            self.motion.resume(now_s, None)
        if self._is_orphan and self.initialized and not self._held:
            self._abort(now_s)
        due, self._later = self._later, []
        for condition, answer in due:
            if condition():
                self._say(answer)
            else:
                self._later.append((condition, answer))
        self._changes()

    def press(self, button: str, now_s: float) -> None:
        """Press ``emergency stop``, ``pause`` or ``teach pendant``; pressed again it is released."""
        self.motion.advance(now_s)
        if button == "emergency stop":
            self.estop = not self.estop
            self.servo_ready = not self.estop
            self._interrupt(now_s, "SRVO-001 Operator panel E-stop", on=self.estop)
        elif button == "teach pendant":
            self.pendant_enabled = not self.pendant_enabled
            self._interrupt(now_s, "SYST-045 TP is enabled", on=self.pendant_enabled)
        elif self.program == RUNNING:
            self._pause(now_s, button)
        self._changes()

    def _interrupt(self, now_s: float, text: str, *, on: bool) -> None:
        if not on:
            return
        self._errors.insert(0, text)
        self._pause(now_s, text)
        if self.initialized:
            sequence = self._held[0][0] if self._held else 0
            self._say({"Communication": "FRC_SystemFault", "SequenceID": sequence})

    def _pause(self, now_s: float, why: str) -> None:
        if self.program == RUNNING:
            self.program = PAUSED
        self.motion.hold(now_s, why)

    def _abort(self, now_s: float) -> None:
        """End RMI_MOVE: the tool comes to rest, and the instructions that it holds are dropped."""
        self.motion.hold(now_s, "abort")
        self._held.clear()
        self.program, self.initialized = ABORTED, False

    def _answer_executed(self) -> None:
        for _ in self.motion.executed[self._answered :]:
            self._answered += 1
            if self._held:
                sequence, name = self._held.popleft()
                self._say({"Instruction": name, "ErrorID": 0, "SequenceID": sequence})

    def _changes(self) -> None:
        """Report starts and stops."""
        motion = self.motion
        while (state := motion.state) != (was := self._was):
            self._was = state
            name = "motion_started" if state == "running" else "motion_stopped"
            if "running" in {state, was}:
                self.report(name, motion.changed_s, detail=motion.detail or state, executed=len(motion.executed))

    # Commands.

    def _command(self, message: Message, now_s: float) -> None:
        name = message["Command"]
        known: dict[Any, Callable[[Message, float], Message]] = {
            "FRC_Initialize": self._initialize,
            "FRC_Abort": self._aborted,
            "FRC_Pause": self._paused,
            "FRC_Continue": self._continue,
            "FRC_Reset": self._reset,
            "FRC_GetStatus": self._status,
            "FRC_GetExtStatus": self._extended_status,
            "FRC_SetOverRide": self._set_override,
            "FRC_ReadCartesianPosition": self._position,
            "FRC_ReadError": self._read_error,
            "FRC_GetUFrameUTool": self._get_frames,
            "FRC_SetUFrameUTool": self._set_frames,
            "FRC_ReadUFrameData": self._frame_read,
            "FRC_WriteUFrameData": self._frame_written,
            "FRC_ReadUToolData": self._frame_read,
            "FRC_WriteUToolData": self._frame_written,
            "FRC_ReadDIN": self._read_input,
            "FRC_WriteDOUT": self._write_output,
        }
        try:
            if name not in known:
                raise DeviceRefused(BAD_COMMAND)
            answer = {"Command": name, "ErrorID": 0, **known[name](message, now_s)}
        except DeviceRefused as refusal:
            answer = {"Command": name, "ErrorID": refusal.args[0]}
        except (KeyError, TypeError, ValueError):
            answer = {"Command": name, "ErrorID": BAD_VALUE}
        if name == "FRC_Abort" and not answer["ErrorID"]:
            self._later.append((lambda: self.motion.state != "running", answer))
        else:
            self._say(answer)

    def _initialize(self, message: Message, _now_s: float) -> Message:
        if self.pendant_enabled:
            raise DeviceRefused(PENDANT_ON)
        if not self.servo_ready:
            raise DeviceRefused(SERVO_OFF)
        if self.mode != "AUTO" or not self.remote:
            raise DeviceRefused(CANNOT_RUN)
        if self.in_hold:
            raise DeviceRefused(IN_HOLD)
        if self.initialized or self.motion.state == "running":
            raise DeviceRefused(WRONG_STATE)
        self.motion.load(CAPACITY)
        self._was, self._answered, self._stops = self.motion.state, 0, True
        self._target = self._pose()
        self.initialized, self.program = True, RUNNING
        self.report("initialized")
        return {"GroupMask": int(message.get("GroupMask", 1))}

    def _aborted(self, _message: Message, now_s: float) -> Message:
        if not self.initialized:
            raise DeviceRefused(NOT_RUNNING)
        self._abort(now_s)
        return {}

    def _paused(self, _message: Message, now_s: float) -> Message:
        if self.program != RUNNING:
            raise DeviceRefused(NOT_RUNNING)
        self._pause(now_s, "pause")
        return {}

    def _continue(self, _message: Message, _now_s: float) -> Message:
        if self.program != PAUSED:
            raise DeviceRefused(NOT_PAUSED)
        if self.pendant_enabled or not self.servo_ready:
            raise DeviceRefused(WRONG_STATE)
        self.program = RUNNING
        return {}

    def _reset(self, _message: Message, _now_s: float) -> Message:
        if self.estop:
            raise DeviceRefused(NO_RESET)
        self.servo_ready, self.in_hold = True, False
        self._errors.clear()
        return {}

    def _status(self, _message: Message, _now_s: float) -> Message:
        return {
            "ServoReady": int(self.servo_ready),
            "TPMode": int(self.pendant_enabled),
            "RMIMotionStatus": int(self.initialized),
            "ProgramStatus": self.program,
            "SingleStepMode": 0,
            "NumberUTool": TOOLS,
            "NumberUFrame": FRAMES,
            "NextSequenceID": self.next_sequence,
            "Override": self._percent(),
        }

    def _extended_status(self, _message: Message, _now_s: float) -> Message:
        return {
            "InMotion": int(self.motion.state == "running"),
            "DrivesPowered": int(self.servo_ready),
            "GenOverride": self._percent(),
            "ControlMode": self.mode,
            "ErrorCode": self._errors[0] if self._errors else "",
        }

    def _percent(self) -> int:
        return round(100.0 * self.slider * self.motion.reported_pace)

    def _set_override(self, message: Message, _now_s: float) -> Message:
        percent = int(message["Value"])
        if not 1 <= percent <= 100:
            raise DeviceRefused(BAD_OVERRIDE)
        self.slider = percent / 100.0
        return {}

    def _pose(self) -> dict[str, float]:
        x, y, z, a, c = self.motion.pose
        return dict(zip("XYZWPR", (x, y, z, *turns_of(a, c)), strict=True))

    def _position(self, message: Message, now_s: float) -> Message:
        position = {axis: round(value, 4) for axis, value in self._pose().items()}
        uframe, utool = self._frames
        configuration = {"UToolNumber": utool, "UFrameNumber": uframe, "Front": 1, "Up": 1, "Left": 0, "Flip": 0}
        configuration |= {"Turn4": 0, "Turn5": 0, "Turn6": 0}
        ext = {"Ext1": 0.0, "Ext2": 0.0, "Ext3": 0.0}
        tag, group = int(now_s * 1000.0) & 0x7FFFFFFF, int(message.get("Group", 1))
        return {"TimeTag": tag, "Configuration": configuration, "Position": {**position, **ext}, "Group": group}

    def _read_error(self, message: Message, _now_s: float) -> Message:
        count = min(max(int(message.get("Count", 1)), 1), 5)
        texts = self._errors[:count] or [""]
        names = ("ErrorData", *(f"ErrorData{number}" for number in range(2, 6)))
        return {"Count": len(self._errors[:count]), **dict(zip(names, texts, strict=False))}

    def _get_frames(self, message: Message, _now_s: float) -> Message:
        uframe, utool = self._frames
        return {"UFrameNumber": uframe, "UToolNumber": utool, "Group": int(message.get("Group", 1))}

    def _set_frames(self, message: Message, _now_s: float) -> Message:
        uframe, utool = int(message["UFrameNumber"]), int(message["UToolNumber"])
        _require(0 <= uframe <= FRAMES, BAD_FRAME)
        _require(1 <= utool <= TOOLS, BAD_TOOL)
        if self.frame_follows:
            self._frames = (uframe, utool)
        return {"Group": int(message.get("Group", 1))}

    def _frame_read(self, message: Message, _now_s: float) -> Message:
        kind, number = _frame_of(message)
        return {f"{kind}Number": number, "Frame": self._frame_data.get((kind, number), FLAT)}

    def _frame_written(self, message: Message, _now_s: float) -> Message:
        self._frame_data[_frame_of(message)] = {axis: float(message["Frame"][axis]) for axis in "XYZWPR"}
        return {}

    def _read_input(self, message: Message, _now_s: float) -> Message:
        number = int(message["PortNumber"])
        _require(1 <= number <= PORTS, BAD_PORT)
        return {"PortNumber": number, "PortValue": int(self._outputs.get(number) == "ON")}

    def _write_output(self, message: Message, _now_s: float) -> Message:
        number = int(message["PortNumber"])
        _require(1 <= number <= PORTS, BAD_PORT)
        _require(message["PortValue"] in {"ON", "OFF"}, BAD_VALUE)
        self._outputs[number] = message["PortValue"]
        return {}

    # Instructions.

    def _take(self, message: Message, now_s: float) -> None:
        name, sequence = str(message["Instruction"]), message.get("SequenceID", 0)
        try:
            _require(self.initialized, NOT_RUNNING)
            _require(not self.pendant_enabled, PENDANT_ON)
            _require(not self.in_hold, IN_HOLD)
            _require(sequence == self.next_sequence, BAD_SEQUENCE)
            _require(len(self._held) < HELD, TOO_MANY)
            _require(self.motion.accepted < CAPACITY, INTERNAL)
            self._append(name, message, now_s)
        except DeviceRefused as refusal:
            self._refuse(name, sequence, refusal.args[0])
            return
        except (KeyError, TypeError, ValueError):
            self._refuse(name, sequence, BAD_VALUE)
            return
        self.next_sequence += 1
        self._held.append((sequence, name))

    def _refuse(self, name: str, sequence: Any, error: int) -> None:
        """Refuse an instruction: RMI holds, and what it has is executed to its end."""
        if error not in (NOT_RUNNING, PENDANT_ON):
            self.in_hold = True
        self._errors.insert(0, f"RMIT-{error - _RMIT:03d}")
        self._say({"Instruction": name, "ErrorID": error, "SequenceID": sequence})

    def _append(self, name: str, message: Message, now_s: float) -> None:
        motion = self.motion
        if name in {"FRC_SetUFrame", "FRC_SetUTool"}:
            number = int(message["FrameNumber" if name == "FRC_SetUFrame" else "ToolNumber"])
            _require(0 <= number <= FRAMES, BAD_FRAME)
            block, stops = SimProgramBlock("none", self._end()), self._stops
        elif name == "FRC_WaitTime":
            seconds = float(message["Time"])
            _require(0.0 <= seconds <= 1e5, BAD_VALUE)
            block, stops = SimProgramBlock("dwell", self._end(), seconds), True
        else:
            block, stops = self._move(name, message)
        before = self._stops
        motion.append(now_s, [block])
        if before:
            motion.path.entry[motion.accepted - 1] = 0.0
        self._stops = stops

    def _end(self) -> Pose:
        """Where the last instruction that was taken ends."""
        path = self.motion.path
        x, y, z, a, c = (float(value) for value in path.pose[path.accepted])
        return x, y, z, a, c

    def _move(self, name: str, message: Message) -> tuple[SimProgramBlock, bool]:
        _require(name in {"FRC_LinearMotion", "FRC_LinearRelative", "FRC_JointMotion"}, BAD_INSTRUCTION)
        given = {axis: float(message["Position"][axis]) for axis in "XYZWPR"}
        _require(all(map(math.isfinite, given.values())), BAD_POSITION)
        configuration = message["Configuration"]
        _require((int(configuration["UFrameNumber"]), int(configuration["UToolNumber"])) == self._frames, BAD_FRAME)
        target = given
        if name == "FRC_LinearRelative":
            target = {axis: self._target[axis] + given[axis] for axis in "XYZWPR"}
        begin = self._end()
        a, c = wrist_of(target["W"], target["P"], target["R"])
        c = begin[4] if a < 1e-6 else begin[4] + _half_turn(c - begin[4])
        end = (target["X"], target["Y"], target["Z"], a, c)
        rate, inverse = self._speed(name, message)
        block = SimProgramBlock("move", end, rate, inverse)
        ranges = (self.config.x_mm, self.config.y_mm, self.config.z_mm)
        within = all(low <= value <= high for value, (low, high) in zip(end[:3], ranges, strict=True))
        _require(within and bool(self.reach([block])[0]), OUT_OF_REACH)
        self._target = target
        return block, self._stop_of(message)

    def _speed(self, name: str, message: Message) -> tuple[float, bool]:
        """Return the speed in mm/s, or the time of the move in s, and whether it is the time."""
        kind, number = message["SpeedType"], float(message["Speed"])
        _require(number > 0.0 and math.isfinite(number), BAD_SPEED)
        if name == "FRC_JointMotion":
            _require(kind in {"Percent", "%"}, BAD_SPEED_TYPE)
            _require(number <= 100.0, BAD_SPEED)
            return self.config.rapid_mm_s * number / 100.0, False
        whole: Mapping[str, tuple[float, bool]] = {
            "mmSec": (1.0, False), "InchMin": (25.4 / 60.0, False), "Time": (0.1, True), "mSec": (1e-3, True),
        }  # fmt: skip
        _require(kind in whole, BAD_SPEED_TYPE)
        factor, is_time = whole[kind]
        return factor * (math.floor(number) if number >= 1.0 else number), is_time

    @staticmethod
    def _stop_of(message: Message) -> bool:
        """Whether the tool stops at the target."""
        kind, number = message["TermType"], int(message.get("TermValue", 0))
        _require(kind in {"FINE", "CNT", "CR"}, BAD_TERM_TYPE)
        _require(0 <= number <= 1000, BAD_TERM)
        return kind == "FINE" or (kind == "CNT" and number == 0)

    def _say(self, message: Message) -> None:
        if self.send is not None:
            self.send(line_of(message))


def line_of(message: Message) -> bytes:
    """Return a message as it is sent."""
    return json.dumps(message).encode("ascii") + b"\r\n"


def _parsed(line: bytes) -> Message:
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _require(condition: bool, error: int) -> None:
    if not condition:
        raise DeviceRefused(error)


def _frame_of(message: Message) -> tuple[str, int]:
    """Return the kind and the number of a frame that a command names."""
    is_tool = "UTool" in message["Command"]
    number = int(message["ToolNumber" if is_tool else "FrameNumber"])
    _require(1 <= number <= (TOOLS if is_tool else FRAMES), BAD_TOOL if is_tool else BAD_FRAME)
    return ("UTool" if is_tool else "UFrame"), number
