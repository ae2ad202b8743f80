"""What all links to a controller's variables do: all that is watched in one reading, orders in one write."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Mapping
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from typing import Protocol

from polishd.api import DeviceIdentity, DeviceRefused, LinkError, ProtocolError
from polishd.config.controller_profile import Kind, Value, Variable, VariablesTable
from polishd.drivers.plc_robot.file_delivery import Delivery
from polishd.util.wire_recording import LinkTap, tap

ORDERS = ("start", "hold", "reset", "load", "program", "heartbeat")
"""What polishd writes; the other variables are watched."""

_WHOLE = {
    "int16": (-(1 << 15), 1 << 15),
    "uint16": (0, 1 << 16),
    "int32": (-(1 << 31), 1 << 31),
    "uint32": (0, 1 << 32),
}
_MOST = sys.float_info.max
"""Beyond it are infinities, and no comparison holds of what is no number."""


@dataclass(frozen=True, slots=True)
class VariableSnapshot:
    """All that is watched, at one time."""

    time_s: float
    """On the controller's clock, or what stands for it: it only has to run evenly."""
    values: Mapping[str, Value]
    changed_s: Mapping[str, float] = field(default_factory=dict)
    """When a variable came to its value, where the link tells, on the same clock."""


class Variables(Protocol):
    """A link to a controller. Every request is answered in time, or raises LinkError and leaves the link dead.

    ProtocolError where the controller has no such variable, or one of another type.
    """

    async def open(self) -> None:
        """Connect, and find all variables. Changes nothing."""
        ...

    async def close(self) -> None:
        """Disconnect; idempotent."""
        ...

    async def identify(self) -> DeviceIdentity:
        """Who answers. ``boot_id`` where the link tells of it."""
        ...

    async def read(self) -> VariableSnapshot:
        """All that is watched."""
        ...

    async def write(self, values: Mapping[str, Value]) -> None:
        """These, in this order, in one request where the link can. Never repeated."""
        ...


def watched(table: VariablesTable) -> dict[str, Variable]:
    """The variables that are read all the time."""
    return {name: point for name, point in _named(table).items() if name not in ORDERS}


def written(table: VariablesTable) -> dict[str, Variable]:
    """The variables that are written."""
    return {name: point for name, point in _named(table).items() if name in ORDERS}


def _named(table: VariablesTable) -> dict[str, Variable]:
    return {name: point for name, point in table if point is not None}


def of_kind(kind: Kind, value: object, name: str) -> Value:
    """A value as its kind says. ProtocolError where it is none."""
    if kind == "string":
        found: Value | None = value if isinstance(value, str) else None
    elif kind == "bool":
        found = bool(value) if isinstance(value, int) else None
    elif kind in ("float", "double"):
        found = float(value) if isinstance(value, int | float) and -_MOST <= value <= _MOST else None
    else:
        low, high = _WHOLE[kind]
        fits = isinstance(value, int | float) and low <= value < high
        found = int(value) if fits and isinstance(value, int | float) and float(value).is_integer() else None
    if found is None:
        raise ProtocolError(f"variable {name}: {value!r} is no {kind}: look at its type in the controller's profile")
    return found


# A controller's variables as they are read and written, and files as they are delivered, for whoever records the
# cell.

DELIVERED = "the file is there"
"""How a delivery ends that was none in vain."""


class RecordedDelivery:
    """A Delivery that tells the tap of whoever opened the robot last."""

    def __init__(self, inner: Delivery, link: str) -> None:
        """``link``: its address, which is told without its user."""
        self._inner, self._link = inner, re.sub(r"//[^/@]*@", "//", link)
        self._context: Context = copy_context()

    def opened(self) -> None:
        """By this task: it says whose files these are."""
        self._context = copy_context()

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        told = self._context.run(tap, self._link)
        if told is not None:
            told("out", values={"file": name, "bytes": len(text), "sha256": hashlib.sha256(text).hexdigest()})
        why = "cut off"
        try:
            await self._inner.put(name, text)
            why = DELIVERED
        except DeviceRefused as error:
            why = str(error)
            raise
        finally:
            if told is not None:
                told("end", why=why)


class Recorded:
    """A Variables that tells its tap. Passwords go by another way: they are of the inner one's session."""

    def __init__(self, inner: Variables, link: str, delivery: RecordedDelivery) -> None:
        """``link``: its address. ``delivery``: that of the same robot."""
        self._inner, self._link, self._delivery = inner, link, delivery
        self._tap: LinkTap | None = None

    async def open(self) -> None:
        """See Variables."""
        self._tap = tap(self._link)
        self._delivery.opened()
        try:
            await self._inner.open()
        except LinkError as error:
            self._told(error)
            raise

    async def close(self) -> None:
        """See Variables."""
        told, self._tap = self._tap, None
        if told is not None:
            told("end", why="the connection is closed")
        await self._inner.close()

    async def identify(self) -> DeviceIdentity:
        """See Variables."""
        return await self._inner.identify()

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        try:
            found = await self._inner.read()
        except LinkError as error:
            self._told(error)
            raise
        if self._tap is not None:
            self._tap("in", values=found.values, clock_s=found.time_s, changed_s=found.changed_s)
        return found

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables."""
        if self._tap is not None:
            self._tap("out", values=values)
        try:
            await self._inner.write(values)
        except LinkError as error:
            self._told(error)
            raise

    def _told(self, error: LinkError) -> None:
        """Once: a link that is dead stays so."""
        told, self._tap = self._tap, None
        if told is not None:
            told("end", why=str(error))
