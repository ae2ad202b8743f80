"""What linuxcncrsh is asked and answers (docs/protocols/linuxcnc.md). Sans-IO: lines in, facts out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast

from polishd.api import ProtocolError

MOST_PERCENT = 1000.0
"""More feed override than any [DISPLAY] MAX_FEED_OVERRIDE allows."""
Status = Literal["idle", "running", "paused"]
AXES = 6
"""X Y Z A B C: what linuxcncrsh tells of a position, whatever axes the machine has."""
STILL = 1e-6
"""mm or deg: what linuxcncrsh prints."""


@dataclass(frozen=True, slots=True)
class RshReply:
    """One line of linuxcncrsh: to which request (``get estop``, ``set run``, ``hello``), whether it obeys, the rest."""

    to: str
    ok: bool
    value: str = ""


@dataclass(frozen=True, slots=True)
class RshSnapshot:
    """What LinuxCNC was doing when it was looked at."""

    time_s: float
    """Its own clock."""
    line: int
    """Line of the motion under way, 1-based; where nothing runs it means nothing."""
    status: Status
    position: tuple[float, ...]
    """Where it means to be, mm and deg: without the noise of the encoders, which it follows within FERROR."""
    display: str
    """The operator message that came since the last look, or empty."""
    override: float = 1.0
    """Its feed override, as a fraction."""

    def moved_since(self, other: RshSnapshot) -> bool:
        """It was elsewhere then."""
        return any(abs(a - b) > STILL for a, b in zip(self.position, other.position, strict=True))


def asks(request: str) -> str:
    """What an answer to this request names in ``Answer.to``."""
    words = request.lower().split()
    return words[0] if words[0] == "hello" else " ".join(words[:2])


def parse(line: bytes) -> RshReply | None:
    """Read one line; None for echoes, blank lines and garbage."""
    try:
        text = line.decode("ascii").strip(" \r\n")
    except UnicodeDecodeError:
        return None
    if not text.replace("\t", " ").isprintable():  # some of what does not print would count as space
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
    """``RUNNING`` and its like; ProtocolError for what is none of them."""
    if value.lower() not in ("idle", "running", "paused"):
        raise ProtocolError(f"linuxcncrsh: PROGRAM_STATUS {value!r}")
    return cast("Status", value.lower())


def line_of(value: str) -> int:
    """A line number; ProtocolError where it is none."""
    if not value.isdecimal():
        raise ProtocolError(f"linuxcncrsh: PROGRAM_LINE {value!r}")
    return int(value)


def override_of(value: str) -> float:
    """A feed override in percent, as a fraction; ProtocolError where it is none."""
    (percent,) = numbers_of(value, 1)
    if not 0.0 <= percent <= MOST_PERCENT:
        raise ProtocolError(f"linuxcncrsh: FEED_OVERRIDE {value!r}, not 0 to {MOST_PERCENT:g} %")
    return percent / 100.0


def numbers_of(value: str, count: int) -> tuple[float, ...]:
    """So many numbers; ProtocolError where they are not."""
    try:
        found = tuple(map(float, value.split()))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ProtocolError(f"linuxcncrsh: {value!r} is not {count} numbers")
    return found
