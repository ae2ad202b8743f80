"""The Remote Motion Interface: a session, its commands one at a time, and the answers to executed instructions.

``FRC_Connect`` on the first port returns the port of the session. Each message is a JSON object on a line that ends
with CR LF. A command is answered at once, an instruction when it has been executed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from polishd.api import ByteStream, DeviceBusy, DeviceRefused, LinkError, ProtocolError, RobotTimes
from polishd.drivers.fanuc_rmi.motion_speed import PoseTimes
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready, RequestQueue
from polishd.drivers.transport.claims import claim_address
from polishd.drivers.transport.streams import LineReader, connect_unclaimed, open_stream
from polishd.util.address_claims import Claim

MOST_OUTSTANDING = 8
"""Instructions that the controller holds, the one under way among them."""
LONGEST_ANSWER = 4096
LONGEST_ERROR = 120
LARGEST = 1e9
"""Largest number in an answer."""
CONNECT_S = 1.0
DISCONNECT_S = 0.3
BUSY_S, BUSY_PAUSE_S = 1.0, 0.1
"""A controller notices the end of a session a moment after its connection is closed."""
IDLE_READ_S = 3600.0
"""The reader has no time limit: the commands that are sent all the time have one."""
FIRST_ERROR = 2556928
ALREADY_CONNECTED, NOT_RUNNING, IN_HOLD = FIRST_ERROR + 26, FIRST_ERROR + 9, FIRST_ERROR + 24
INVALID_STATE = FIRST_ERROR + 15
BAD_TOOL, BAD_FRAME, CANNOT_RUN = FIRST_ERROR + 2, FIRST_ERROR + 3, FIRST_ERROR + 6
PROGRAM_IN_USE, PROGRAM_EXISTS = 7004, 7015
_ERRORS = {
    BAD_TOOL: "invalid user tool number",
    BAD_FRAME: "invalid user frame number",
    CANNOT_RUN: "the TP program cannot be executed",
    FIRST_ERROR + 7: "the servos are off",
    FIRST_ERROR + 8: "the teach pendant is enabled",
    NOT_RUNNING: "RMI is not running",
    FIRST_ERROR + 10: "the TP program is not paused",
    FIRST_ERROR + 11: "the TP program cannot be resumed",
    FIRST_ERROR + 12: "the controller cannot be reset",
    FIRST_ERROR + 13: "invalid RMI command",
    INVALID_STATE: "the controller is in the wrong state",
    FIRST_ERROR + 18: "invalid motion option",
    FIRST_ERROR + 20: "invalid RMI instruction",
    FIRST_ERROR + 21: "invalid value",
    FIRST_ERROR + 23: "invalid position data",
    IN_HOLD: "RMI is in the HOLD state",
    ALREADY_CONNECTED: "another client is connected",
    FIRST_ERROR + 29: "invalid sequence number",
    FIRST_ERROR + 30: "invalid speed type",
    FIRST_ERROR + 31: "invalid speed",
    FIRST_ERROR + 32: "invalid termination type",
    FIRST_ERROR + 33: "invalid termination value",
    FIRST_ERROR + 36: "the target cannot be reached",
    FIRST_ERROR + 43: "single-step mode is on",
    PROGRAM_IN_USE: "the program RMI_MOVE is in use",
    PROGRAM_EXISTS: "the program RMI_MOVE is selected at the teach pendant",
}
_REMEDIES = {
    BAD_TOOL: "Set up the user tool of the program at the controller, or have the program posted in another",
    BAD_FRAME: "Set up the user frame of the program at the controller, or have the program posted in another",
    CANNOT_RUN: "Set the controller to remote, and release its hold and fence inputs",
    PROGRAM_IN_USE: "End the other program at the pendant",
    PROGRAM_EXISTS: "Select another program at the pendant",
}
RUNNING, PAUSED = 1, 2
"""``ProgramStatus`` of RMI_MOVE."""


def error_text(number: int) -> str:
    """Return an ErrorID as ``RMIT-029, invalid sequence number (2556957)``, with a remedy where it has one."""
    text = _ERRORS.get(number, "see the controller's manual")
    code = f"RMIT-{number - FIRST_ERROR:03d}, " if 0 < number - FIRST_ERROR < 100 else ""
    remedy = f". {_REMEDIES[number]}." if number in _REMEDIES else ""
    return f"{code}{text} ({number}){remedy}"


@dataclass(frozen=True, slots=True)
class RmiStatus:
    """Answer to ``FRC_GetStatus``."""

    servo_ready: bool
    pendant_enabled: bool
    rmi_runs: bool
    program: int
    single_step: bool
    next_sequence: int
    override: float | None
    """As a fraction; None: this controller version does not report it."""

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> RmiStatus:
        """Parse an answer; KeyError or ValueError if it is none."""
        percent = answer.get("Override")
        return cls(
            bool(_whole(answer, "ServoReady")),
            bool(_whole(answer, "TPMode")),
            bool(_whole(answer, "RMIMotionStatus")),
            _whole(answer, "ProgramStatus"),
            bool(_whole(answer, "SingleStepMode")),
            _whole(answer, "NextSequenceID"),
            None if percent is None else _real(answer, "Override") / 100.0,
        )

    def obstacle(self, mode: str = "") -> str:
        """Return why the controller would not run a program; empty if it would. ``mode`` is empty if unknown."""
        if self.pendant_enabled:
            return "the teach pendant is enabled (switch it off and the controller to AUTO)"
        if mode not in ("", "AUTO"):
            return f"the controller is in {mode} (turn the mode switch to AUTO)"
        if not self.servo_ready:
            return "the servos are not ready (release the emergency stop, reset the fault at the pendant)"
        if self.single_step:
            return "single-step mode is on (switch it off at the pendant)"
        return ""


@dataclass(frozen=True, slots=True)
class RmiSnapshot:
    """Status and pose of the controller at one moment."""

    time_s: float
    """Time of the request."""
    pose_times: PoseTimes
    status: RmiStatus
    pose: tuple[float, ...]
    """X, Y, Z in mm, W, P, R in deg."""
    busy: bool
    """The controller may hold instructions that it has not executed."""

    @property
    def runs(self) -> bool:
        """It executes instructions."""
        return self.busy and self.status.rmi_runs and self.status.program == RUNNING


class RmiSession(Background):
    """One session, from ``FRC_Connect`` to its end. It is never opened again; waiting calls get LinkError."""

    def __init__(
        self,
        address: Tcp,
        times: RobotTimes,
        on_executed: Callable[[int, int], None] = lambda _sequence, _error: None,
        on_fault: Callable[[], Awaitable[None]] | None = None,
        on_credit: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        """``on_executed`` gets the sequence number and the ErrorID of each answered instruction.

        ``on_credit`` is awaited afterwards, and ``on_fault`` after a fault of the robot, in tasks of the session.
        """
        super().__init__(str(address))
        self.firmware = ""
        self.outstanding: deque[int] = deque()
        """Sequence numbers of the instructions that were sent and are not answered."""
        self._unknown_until_s = 0.0
        """Until then it may hold instructions of an earlier session."""
        self._address = address
        self._silence_s, self._watchdog_s = times.silence_s, times.watchdog_s
        self._on_executed, self._on_fault, self._on_credit = on_executed, on_fault, on_credit
        self._has_credit, self._has_fault = asyncio.Event(), asyncio.Event()
        self._queue = RequestQueue(self.name)
        self._stream: ByteStream | None = None
        self._claim = Claim()
        self._reports_override = False
        self._expected = ""
        self._answer: asyncio.Future[dict[str, Any]] | None = None

    @property
    def is_busy(self) -> bool:
        """The controller may hold instructions that it has not executed."""
        return bool(self.outstanding) or time.monotonic() < self._unknown_until_s

    async def open(self) -> None:
        """Connect. DeviceBusy while another client has the session."""
        self._claim = await claim_address(self._address)
        try:
            port = await self._session_port()
            self._stream = await open_stream(Tcp(self._address.host, port), CONNECT_S)
            await self.start(self._run, CONNECT_S)
            await self._queue.start()
            status = await self.status()
            if status.rmi_runs and status.program == RUNNING:
                self._unknown_until_s = time.monotonic() + self._watchdog_s
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; idempotent. A session that holds no instructions is ended as the manual demands."""
        stream, self._stream = self._stream, None
        if stream is not None and self.alive and not self.is_busy:
            with contextlib.suppress(LinkError, ProtocolError):  # it has ended already, or ends with the answer
                await stream.write(_line({"Communication": "FRC_Disconnect"}))
                await self.until(lambda: False, DISCONNECT_S)
        await self._queue.stop()
        await self.stop()
        if stream is not None:
            await stream.close()
        self._claim.release()

    async def command(
        self, name: str, *, within_s: float | None = None, urgent: bool = False, allow: int = 0, **fields: Any
    ) -> dict[str, Any]:
        """Return the answer to a command. DeviceRefused for an ErrorID other than 0 and ``allow``."""
        self.check()
        limit_s = within_s or self._silence_s
        answer = await self._queue.ask(lambda: self._exchange(name, fields, limit_s), urgent=urgent)
        error = self._error_of(answer)
        if error not in (0, allow):
            raise DeviceRefused(f"{self.name}: {name} was refused: {error_text(error)}")
        return answer

    async def status(self) -> RmiStatus:
        """Return the present status. ProtocolError for an answer without its fields, or one that it had before."""
        answer = await self.command("FRC_GetStatus")
        try:
            status = RmiStatus.of(answer)
        except (KeyError, ValueError) as error:
            raise ProtocolError(f"{self.name}: FRC_GetStatus was answered without {error}") from error
        if self._reports_override and status.override is None:
            raise ProtocolError(f"{self.name}: FRC_GetStatus was answered without Override, which it had before")
        self._reports_override = status.override is not None
        return status

    async def control_mode(self) -> str:
        """Return ``AUTO``, ``T1`` or ``T2``; empty where the controller does not report it."""
        try:
            answer = await self.command("FRC_GetExtStatus")
        except DeviceRefused:  # older versions have no such command
            return ""
        return str(answer.get("ControlMode") or "")

    async def latest_error(self) -> str:
        """Return the latest error of the controller as it words it; empty if it has none."""
        try:
            answer = await self.command("FRC_ReadError", urgent=True, Count=1)
        except DeviceRefused:
            return ""
        return str(answer.get("ErrorData") or "").strip()[:LONGEST_ERROR]

    async def look(self) -> RmiSnapshot:
        """Return status and pose."""
        began_s = time.monotonic()
        status = await self.status()
        asked_s = time.monotonic()
        answer = await self.command("FRC_ReadCartesianPosition")
        tag = answer.get("TimeTag")
        times = PoseTimes(asked_s, time.monotonic(), tag if type(tag) is int else None)
        try:
            position = answer["Position"]
            pose = tuple(_real(position, axis) for axis in "XYZWPR")
        except (KeyError, TypeError, ValueError) as error:
            raise ProtocolError(f"{self.name}: FRC_ReadCartesianPosition was answered without {error}") from error
        return RmiSnapshot(began_s, times, status, pose, self.is_busy)

    async def send(self, sequence: int, fields: Mapping[str, Any]) -> None:
        """Send an instruction, once. Its answer goes to ``on_executed``."""
        self.check()
        self.outstanding.append(sequence)
        if self._stream is not None:
            head = {"Instruction": fields["Instruction"], "SequenceID": sequence}
            await self._stream.write(_line({**head, **fields}))

    def forget(self) -> None:
        """No instruction is outstanding any more: the controller has dropped them."""
        self.outstanding.clear()
        self._unknown_until_s = 0.0

    async def _session_port(self) -> int:
        """Return the port of the new session."""
        deadline = time.monotonic() + BUSY_S
        while True:
            answer = await self._connect()
            error = self._error_of(answer)
            if not error:
                break
            if error != ALREADY_CONNECTED:
                raise DeviceRefused(f"{self.name}: FRC_Connect was refused: {error_text(error)}")
            if time.monotonic() > deadline:
                raise DeviceBusy(f"{self.name}: another client has the RMI session. End that client.")
            await asyncio.sleep(BUSY_PAUSE_S)
        self.firmware = f"RMI {answer.get('MajorVersion', '?')}.{answer.get('MinorVersion', '?')}"
        port = answer.get("PortNumber")
        if type(port) is not int or not 0 < port < 65536:
            raise ProtocolError(f"{self.name}: FRC_Connect was answered without PortNumber")
        return port

    async def _connect(self) -> dict[str, Any]:
        stream = await connect_unclaimed(self._address, CONNECT_S)
        try:
            await stream.write(_line({"Communication": "FRC_Connect"}))
            lines, line = LineReader(stream, LONGEST_ANSWER), b""
            while not line.strip():
                line = await lines.next(self._silence_s)
            return self._parsed(line)
        finally:
            await stream.close()

    async def _exchange(self, name: str, fields: Mapping[str, Any], within_s: float) -> dict[str, Any]:
        stream = self._stream
        if stream is None:
            raise LinkError(f"{self.name}: is not open")
        self._expected, self._answer = name, asyncio.get_running_loop().create_future()
        await stream.write(_line({"Command": name, **fields}))
        try:
            return await self.result(self._answer, within_s)
        except LinkError:
            await stream.close()  # its late answer would be taken for the next one's
            raise
        finally:
            self._expected = ""

    async def _run(self, ready: Ready) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._receive(ready))
            group.create_task(_each(self._has_credit, self._on_credit))
            group.create_task(_each(self._has_fault, self._on_fault))

    async def _receive(self, ready: Ready) -> None:
        stream = self._stream
        if stream is None:
            raise LinkError(f"{self.name}: is not open")
        lines = LineReader(stream, LONGEST_ANSWER)
        ready()
        while True:
            line = await lines.next(IDLE_READ_S)
            if line.strip():
                self._take(self._parsed(line))
                self.fire()

    def _error_of(self, answer: Mapping[str, Any]) -> int:
        try:
            return _whole(answer, "ErrorID")
        except (KeyError, ValueError) as error:
            raise ProtocolError(f"{self.name}: an answer has no valid ErrorID") from error

    def _parsed(self, line: bytes) -> dict[str, Any]:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            raise ProtocolError(f"{self.name}: not a JSON object: {line[:60]!r}. Check the address.")
        return message

    def _take(self, message: dict[str, Any]) -> None:
        if "Instruction" in message:
            self._executed(message)
        elif message.get("Command") == self._expected and self._answer is not None and not self._answer.done():
            self._answer.set_result(message)
        elif message.get("Communication") == "FRC_SystemFault":
            self._has_fault.set()
        elif message.get("Communication") in ("FRC_Terminate", "FRC_Disconnect"):
            raise LinkError(f"{self.name}: the controller ended the session")
        elif self._expected and self._answer is not None and not self._answer.done() and "Command" not in message:
            raise ProtocolError(f"{self.name}: {self._expected} was answered by {json.dumps(message)[:80]}")

    def _executed(self, message: Mapping[str, Any]) -> None:
        try:
            sequence, error = _whole(message, "SequenceID"), _whole(message, "ErrorID")
        except (KeyError, ValueError) as problem:
            raise ProtocolError(f"{self.name}: an answer to an instruction lacks SequenceID or ErrorID") from problem
        if sequence not in self.outstanding:
            return  # of an earlier program
        if not error and sequence != self.outstanding[0]:
            raise ProtocolError(f"{self.name}: instruction {sequence} was executed before {self.outstanding[0]}")
        self.outstanding.remove(sequence)
        self._on_executed(sequence, error)
        self._has_credit.set()


def _whole(message: Mapping[str, Any], name: str) -> int:
    """Return a whole number; KeyError without it, ValueError where it is none."""
    value = message[name]
    if type(value) is not int:
        raise ValueError(name)
    return value


def _real(message: Mapping[str, Any], name: str) -> float:
    """Return a finite number; KeyError without it, ValueError where it is none."""
    value = message[name]
    if type(value) not in (int, float) or not abs(value) <= LARGEST:
        raise ValueError(name)
    return float(value)


async def _each(event: asyncio.Event, action: Callable[[], Awaitable[None]] | None) -> None:
    """Act whenever the event is set."""
    while action is not None:
        await event.wait()
        event.clear()
        await action()


def _line(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":")).encode("ascii") + b"\r\n"
