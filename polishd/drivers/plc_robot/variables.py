"""Links to a controller's variables: one reading of all watched variables, one write of commands."""

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
from polishd.drivers.transport.file_delivery import Delivery
from polishd.util.wire_recording import LinkTap, tap

ORDERS = ("start", "hold", "reset", "load", "program", "heartbeat")
"""Variables that polishd writes; the others are watched."""

_WHOLE = {
    "int16": (-(1 << 15), 1 << 15),
    "uint16": (0, 1 << 16),
    "int32": (-(1 << 31), 1 << 31),
    "uint32": (0, 1 << 32),
}
_MOST = sys.float_info.max
"""Largest finite value; comparisons with NaN are false."""


@dataclass(frozen=True, slots=True)
class VariableSnapshot:
    """All watched variables at one time."""

    time_s: float
    """Time on the controller's clock, or on a substitute that runs evenly."""
    values: Mapping[str, Value]
    changed_s: Mapping[str, float] = field(default_factory=dict)
    """Time at which a variable got its value on the same clock, if the link reports it."""


class Variables(Protocol):
    """A link to a controller. A request without an answer in time raises LinkError and the link is dead.

    ProtocolError if the controller has no such variable, or one of another type.
    """

    async def open(self) -> None:
        """Connect, and find all variables. Changes nothing."""
        ...

    async def close(self) -> None:
        """Disconnect; idempotent."""
        ...

    async def identify(self) -> DeviceIdentity:
        """Return the identity, with ``boot_id`` if the link reports it."""
        ...

    async def read(self) -> VariableSnapshot:
        """Read all watched variables."""
        ...

    async def write(self, values: Mapping[str, Value]) -> None:
        """Write these values in this order, in one request if the link supports it. Never repeated."""
        ...


def watched(table: VariablesTable) -> dict[str, Variable]:
    """Return the variables that are polled."""
    return {name: point for name, point in _named(table).items() if name not in ORDERS}


def written(table: VariablesTable) -> dict[str, Variable]:
    """Return the variables that are written."""
    return {name: point for name, point in _named(table).items() if name in ORDERS}


def _named(table: VariablesTable) -> dict[str, Variable]:
    return {name: point for name, point in table if point is not None}


def of_kind(kind: Kind, value: object, name: str) -> Value:
    """Return a value of its kind. ProtocolError if it is of another kind."""
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
        raise ProtocolError(f"variable {name}: {value!r} is not a {kind}. Check its type in the controller's profile.")
    return found


# Recording of variables that are read and written, and of files that are delivered.

DELIVERED = "the file is there"
"""End of a successful delivery in the recording."""


class RecordedDelivery:
    """A Delivery that records to the tap of the task that opened the robot last."""

    def __init__(self, inner: Delivery, link: str) -> None:
        """``link``: its address, recorded without its user."""
        self._inner, self._link = inner, re.sub(r"//[^/@]*@", "//", link)
        self._context: Context = copy_context()

    def opened(self) -> None:
        """Record files for this task's device from now on."""
        self._context = copy_context()

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        record = self._context.run(tap, self._link)
        if record is not None:
            record("out", values={"file": name, "bytes": len(text), "sha256": hashlib.sha256(text).hexdigest()})
        why = "cut off"
        try:
            await self._inner.put(name, text)
            why = DELIVERED
        except DeviceRefused as error:
            why = str(error)
            raise
        finally:
            if record is not None:
                record("end", why=why)


class Recorded:
    """Variables that record to a tap. Passwords are not recorded: the inner link's session sends them."""

    def __init__(self, inner: Variables, link: str, delivery: RecordedDelivery) -> None:
        """``link``: its address. ``delivery``: delivery of the same robot."""
        self._inner, self._link, self._delivery = inner, link, delivery
        self._tap: LinkTap | None = None

    async def open(self) -> None:
        """See Variables."""
        self._tap = tap(self._link)
        self._delivery.opened()
        try:
            await self._inner.open()
        except LinkError as error:
            self._record_loss(error)
            raise

    async def close(self) -> None:
        """See Variables."""
        record, self._tap = self._tap, None
        if record is not None:
            record("end", why="the connection is closed")
        await self._inner.close()

    async def identify(self) -> DeviceIdentity:
        """See Variables."""
        return await self._inner.identify()

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        try:
            found = await self._inner.read()
        except LinkError as error:
            self._record_loss(error)
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
            self._record_loss(error)
            raise

    def _record_loss(self, error: LinkError) -> None:
        """Record the loss of the link once."""
        record, self._tap = self._tap, None
        if record is not None:
            record("end", why=str(error))
