"""A controller's variables as they are read and written, and files as they are delivered, for whoever records the cell.

Libraries hide their wires. Of a file its name, size and sha256 are told: a shop's program is nobody else's.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from contextvars import Context, copy_context

from polishd.api import DeviceIdentity, DeviceRefused, LinkError
from polishd.config.controller_profile import Value
from polishd.drivers.handover.delivery import Delivery
from polishd.drivers.handover.variables import Variables, VariableSnapshot
from polishd.ports.tap import Tap, tap

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
        self._tap: Tap | None = None

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
