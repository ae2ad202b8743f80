"""A controller's variables as they are read and written, for whoever records the cell. Libraries hide their wires."""

from __future__ import annotations

from collections.abc import Mapping

from polishd.api import Identity, LinkError
from polishd.config.controller_profile import Value
from polishd.drivers.handover.variables import Reading, Variables
from polishd.ports.tap import Tap, tap


class Recorded:
    """A Variables that tells its tap. Passwords go by another way: they are of the inner one's session."""

    def __init__(self, inner: Variables, link: str) -> None:
        """``link``: its address."""
        self._inner, self._link = inner, link
        self._tap: Tap | None = None

    async def open(self) -> None:
        """See Variables."""
        self._tap = tap(self._link)
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

    async def identify(self) -> Identity:
        """See Variables."""
        return await self._inner.identify()

    async def read(self) -> Reading:
        """See Variables."""
        try:
            found = await self._inner.read()
        except LinkError as error:
            self._told(error)
            raise
        if self._tap is not None:
            self._tap("in", values=found.values)
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
