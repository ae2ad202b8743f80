"""What the answers on the line mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import re

from polishd.api import Identity, ProtocolError
from polishd.drivers.voice_coil.device import Reading, State

_STATUS = re.compile(r"ST,([0-4]),(-?\d+\.\d\d),(\d+\.\d\d),(\d+),(\d+)")


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
