"""What the amplifier's answers mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import ProtocolError

FAULTS = {1: "over its range", 2: "no cell connected", 4: "its converter fails"}
_FORCE = re.compile(r"F,([0-2]),(\d{1,5}),([+-]\d{1,5}\.\d{1,4}),(\d{1,5})", re.ASCII)


class ForceSensorState(IntEnum):
    """The amplifier's states, as the wire numbers them."""

    MEASURING = 0
    TARING = 1
    """What it reads meanwhile says nothing."""
    FAULT = 2


@dataclass(frozen=True, slots=True)
class ForceSensorLineReading:
    """What the amplifier says."""

    state: ForceSensorState
    count: int
    """Of its conversions, modulo 65536: the same again is no new reading."""
    force_n: float
    fault: int

    @property
    def faults(self) -> str:
        """Fault bits in words."""
        return ", ".join(text for bit, text in FAULTS.items() if self.fault & bit)


def force(body: str) -> ForceSensorLineReading:
    """The answer to ``F?``."""
    match = _FORCE.fullmatch(body)
    if match is None:
        raise ProtocolError(f"no answer to F?: {body!r}")
    state, count, force_n, fault = match.groups()
    return ForceSensorLineReading(ForceSensorState(int(state)), int(count), float(force_n), int(fault))
