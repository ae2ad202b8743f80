"""Lines with a checksum, and what the answers mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import re
from functools import reduce
from operator import xor

from polishd.api import Identity, ProtocolError
from polishd.drivers.voice_coil.device import Reading, State

LONGEST = 120
_LINE = re.compile(rb"\$([ -)+-~]*)\*([0-9A-F]{2})\r?")
_STATUS = re.compile(r"ST,([0-4]),(-?\d+\.\d\d),(\d+\.\d\d),(\d+),(\d+)")


def encode(number: int, body: str) -> bytes:
    """A numbered request as a line."""
    text = f"{number},{body}".encode("ascii")
    return b"$%b*%02X\r\n" % (text, _checksum(text))


def decode(line: bytes) -> tuple[int, str] | None:
    """Number and body of a line without its LF; None where it is broken: such lines are dropped."""
    start = line.rfind(b"$")
    match = _LINE.fullmatch(line[start:]) if start >= 0 and len(line) - start <= LONGEST else None
    if match is None or int(match[2], 16) != _checksum(match[1]):
        return None
    number, comma, body = match[1].decode("ascii").partition(",")
    if not (comma and number.isdigit() and len(number) <= 5):
        return None
    return int(number), body


def status(body: str) -> Reading:
    """The answer to ``ST?``."""
    match = _STATUS.fullmatch(body)
    if match is None:
        raise ProtocolError(f"no answer to ST?: {body!r}")
    state, force, setpoint, position, fault = match.groups()
    return Reading(State(int(state)), float(force), float(setpoint), int(position), int(fault))


def identity(body: str) -> Identity:
    """The answer to ``ID?``."""
    parts = body.split(",")
    if len(parts) != 6 or parts[0] != "ID":
        raise ProtocolError(f"no answer to ID?: {body!r}")
    return Identity(parts[1], parts[2], parts[3], parts[4], boot_id=parts[5])


def _checksum(text: bytes) -> int:
    return reduce(xor, text, 0)
