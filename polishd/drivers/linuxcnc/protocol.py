"""Connection to linuxcncrsh: one request at a time; LinkError without an answer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, cast

from polishd.api import ByteStream, DeviceBusy, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import RequestQueue
from polishd.drivers.transport.streams import LineReader, open_stream

# Requests and answers of linuxcncrsh (docs/protocols/linuxcnc.md). Sans-IO.

MOST_PERCENT = 1000.0
"""More feed override than any [DISPLAY] MAX_FEED_OVERRIDE allows."""
Status = Literal["idle", "running", "paused"]
AXES = 6
"""X Y Z A B C: the axes of a position in linuxcncrsh, whatever axes the machine has."""
STILL = 1e-6
"""Resolution of linuxcncrsh's output, mm or deg."""


@dataclass(frozen=True, slots=True)
class RshReply:
    """Line of linuxcncrsh: its request (``get estop``, ``set run``, ``hello``), acceptance, and value."""

    to: str
    ok: bool
    value: str = ""


@dataclass(frozen=True, slots=True)
class RshSnapshot:
    """State of LinuxCNC at one poll."""

    time_s: float
    """Time on LinuxCNC's clock."""
    line: int
    """Line of the motion under way, 1-based; undefined while no program runs."""
    status: Status
    position: tuple[float, ...]
    """Commanded position, mm and deg: without encoder noise; the axes follow within FERROR."""
    display: str
    """Operator message since the last poll, or empty."""
    override: float = 1.0
    """Feed override as a fraction."""

    def moved_since(self, other: RshSnapshot) -> bool:
        """Whether the position differs."""
        return any(abs(a - b) > STILL for a, b in zip(self.position, other.position, strict=True))


def asks(request: str) -> str:
    """Return the value of ``RshReply.to`` in the answer to this request."""
    words = request.lower().split()
    return words[0] if words[0] == "hello" else " ".join(words[:2])


def parse(line: bytes) -> RshReply | None:
    """Parse a line; None for echoes, blank lines and invalid data."""
    try:
        text = line.decode("ascii").strip(" \r\n")
    except UnicodeDecodeError:
        return None
    if not text.replace("\t", " ").isprintable():  # some unprintable characters would count as space
        return None
    words = text.split(" ", 2)
    match words:
        case ["HELLO", ("ACK" | "NAK") as word, *rest]:
            return RshReply("hello", word == "ACK", " ".join(rest))
        case [("GET" | "SET") as verb, name, ("ACK" | "NAK") as word]:
            return RshReply(f"{verb.lower()} {name.lower()}", word == "ACK")
        case [name, *rest] if name.isupper() and rest:
            return RshReply(f"get {name.lower()}", ok=True, value=" ".join(rest))
    return None


def status_of(value: str) -> Status:
    """Parse ``RUNNING`` and the other states; ProtocolError for an unknown one."""
    if value.lower() not in ("idle", "running", "paused"):
        raise ProtocolError(f"linuxcncrsh: PROGRAM_STATUS {value!r}")
    return cast("Status", value.lower())


def line_of(value: str) -> int:
    """Parse a line number; ProtocolError if it is invalid."""
    if not value.isdecimal():
        raise ProtocolError(f"linuxcncrsh: PROGRAM_LINE {value!r}")
    return int(value)


def override_of(value: str) -> float:
    """Parse a feed override in percent to a fraction; ProtocolError if it is invalid."""
    (percent,) = numbers_of(value, 1)
    if not 0.0 <= percent <= MOST_PERCENT:
        raise ProtocolError(f"linuxcncrsh: FEED_OVERRIDE {value!r}, not 0 to {MOST_PERCENT:g} %")
    return percent / 100.0


def numbers_of(value: str, count: int) -> tuple[float, ...]:
    """Parse ``count`` numbers; ProtocolError if they are invalid."""
    try:
        found = tuple(map(float, value.split()))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ProtocolError(f"linuxcncrsh: {value!r} is not {count} numbers")
    return found


CONNECT_S = 0.8
SILENCE_S = 0.6
"""Longest wait: linuxcncrsh answers a query within a millisecond, a command after 0.1 s."""
MESSAGES = 50
"""Most old messages to drain: more indicate a fault."""


class RshConnection:
    """Connection from hello to the end of the link; never reopened.

    Requests never overlap: linuxcncrsh splits words with strtok in one thread per connection, and its answers have no
    number. A late or cut answer therefore ends the link and is never taken for the next request's.
    """

    def __init__(self, address: Tcp, passwords: tuple[str, str], silence_s: float = SILENCE_S) -> None:
        self._address = address
        self._silence_s = silence_s
        self._passwords = passwords
        self._queue = RequestQueue(str(address))
        self._stream: ByteStream | None = None
        self._lines: LineReader | None = None
        self._controls = False
        self.server = ""

    async def open(self) -> None:
        """Connect and send hello. Does not request control: see ``control``."""
        self._stream = await open_stream(self._address, CONNECT_S)
        self._lines = LineReader(self._stream, longest=1024)
        try:
            await self._queue.start()
            self.server = (await self._queue.ask(lambda: self._ask(f"hello {self._passwords[0]} polishd 1.0"))).value
            await self._queue.ask(lambda: self._tell("set echo off"))
            await self.set("set verbose on")
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; idempotent."""
        await self._queue.stop()
        if self._stream is not None:
            await self._stream.close()

    async def get(self, name: str) -> str:
        """Return a value; ProtocolError if linuxcncrsh does not have it."""
        return (await self._queue.ask(lambda: self._ask(f"get {name}"))).value

    async def set(self, command: str, *, urgent: bool = False, within_s: float | None = None) -> None:
        """Send a command and wait until LinuxCNC has received it. DeviceRefused if LinuxCNC refuses it."""
        await self._queue.ask(lambda: self._ask(command, within_s), urgent=urgent)

    async def set_if(self, wanted: Callable[[], bool], command: str) -> None:
        """Like ``set``, if the command is still wanted in its turn: urgent commands overtake it."""

        async def order() -> None:
            if wanted():
                await self._ask(command)

        await self._queue.ask(order)

    async def control(self, *, anew: bool = False) -> None:
        """Request control and confirm it, once per connection; ``anew``: another client may have taken it since.

        DeviceBusy if another client has control. The gateway refuses a second client; linuxcncrsh lets it take over.
        """
        if self._controls and not anew:
            return
        try:
            await self.set(f"set enable {self._passwords[1]}", urgent=True)
        except DeviceRefused as error:
            raise self._not_ours() from error
        if (await self._queue.ask(lambda: self._ask("get enable"), urgent=True)).value != "ON":
            raise self._not_ours()
        await self.set("set set_wait received", urgent=True)
        self._controls = True

    def _not_ours(self) -> DeviceBusy:
        return DeviceBusy(
            f"{self._address}: another client controls LinuxCNC, or linuxcncrsh has another enable password. "
            "Stop that client, or set robot.enable_password."
        )

    async def look(self) -> RshSnapshot:
        """Return LinuxCNC's present state."""
        return await self._queue.ask(self._looked)

    async def errors(self) -> str:
        """Return LinuxCNC's errors since the last call; also drops operator messages."""
        return await self._queue.ask(self._drain)

    async def _looked(self) -> RshSnapshot:
        try:
            return await self._look()
        except ProtocolError:
            if self._stream is not None:
                await self._stream.close()  # the late answer could be taken for the next request of that name
            raise

    async def _look(self) -> RshSnapshot:
        time_s = numbers_of(await self._get("time"), 1)[0]
        # line before status: after an abort the line jumps to the last one read, and the status shows the abort
        line = line_of(await self._get("program_line"))
        position = numbers_of(await self._get("abs_cmd_pos"), AXES)
        status = status_of(await self._get("program_status"))
        # after the status: a message arrives before the pause that it announces
        display = await self._get("operator_display")
        override = override_of(await self._get("feed_override"))
        return RshSnapshot(time_s, line, status, position, "" if display == "OK" else display, override)

    async def _drain(self) -> str:
        found: list[str] = []
        for _ in range(MESSAGES):
            said = [await self._get(name) for name in ("error", "operator_text", "operator_display")]
            if said[0] != "OK":
                found.append(said[0])
            if said == ["OK"] * 3:
                break
        return "; ".join(found)

    async def _get(self, name: str) -> str:
        return (await self._ask(f"get {name}")).value

    async def _tell(self, request: str) -> None:
        if self._stream is None:
            raise LinkError(f"{self._address}: is not open")
        await self._stream.write(request.encode() + b"\r\n")

    async def _ask(self, request: str, within_s: float | None = None) -> RshReply:
        """Send and wait for the answer; any error ends the link."""
        try:
            if self._lines is not None:
                await self._lines.restart()  # an answer that arrived twice
            await self._tell(request)
            answer = await self._answer(asks(request), self._silence_s if within_s is None else within_s)
        except LinkError:
            if self._stream is not None:
                await self._stream.close()
            raise
        if not answer.ok:
            verb, name = (*asks(request).split(), "")[:2]
            error = ProtocolError if verb == "get" else DeviceRefused
            raise error(f"{self._address}: LinuxCNC refuses {verb} {name}".rstrip())
        return answer

    async def _answer(self, to: str, within_s: float) -> RshReply:
        deadline = time.monotonic() + within_s
        while self._lines is not None:
            line = await self._lines.next(max(deadline - time.monotonic(), 0.0))
            answer = parse(line)
            if answer is not None and answer.to == to:
                return answer
        raise LinkError(f"{self._address}: is not open")
