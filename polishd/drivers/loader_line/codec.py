"""What the loader's answers mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from urllib.parse import quote, unquote

from polishd.api import ProtocolError

FAULTS = {1: "jammed", 2: "it has dropped a part", 4: "its guard is open", 8: "drive"}
_STATUS = re.compile(r"ST,([0-3]),(\d{1,5}),([\w.~%-]*)", re.ASCII)


class LoaderState(IntEnum):
    """The loader's states, as the wire numbers them."""

    IDLE = 0
    """Clear of the cell."""
    MOVING = 1
    STOPPED = 2
    """Amid a change, by an order or its watchdog."""
    FAULT = 3


@dataclass(frozen=True, slots=True)
class LoaderReading:
    """What the loader says of itself."""

    state: LoaderState
    fault: int
    seat: str | None
    """The part on the seat; None: it is empty."""

    @property
    def faults(self) -> str:
        """Fault bits in words."""
        return ", ".join(text for bit, text in FAULTS.items() if self.fault & bit)


def load(part_id: str) -> str:
    """The request to put a part on; any name fits, percent-encoded."""
    return f"LD,{quote(part_id, safe='')}"


def status(body: str) -> LoaderReading:
    """The answer to ``ST?``."""
    match = _STATUS.fullmatch(body)
    if match is None:
        raise ProtocolError(f"no answer to ST?: {body!r}")
    state, fault, seat = match.groups()
    return LoaderReading(LoaderState(int(state)), int(fault), unquote(seat) or None)
