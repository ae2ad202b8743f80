"""A person's word that a plan may run (``job.approve``)."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from polishd.model.errors import DeviceRefused


@dataclass(slots=True)
class Approval:
    """What waits for a person's word."""

    wanted: str = ""
    """Hash of the program; empty: nothing waits."""
    _given: asyncio.Event = field(default_factory=asyncio.Event)

    async def until_given(self, program_sha256: str) -> None:
        """Wait for it; whatever ends the wait, the plan waits no more."""
        self._given.clear()
        self.wanted = program_sha256
        try:
            await self._given.wait()
        finally:
            self.wanted = ""

    def give(self, program_sha256: str) -> None:
        """DeviceRefused where none waits, or another one: a word is for what its giver has looked at."""
        if not self.wanted:
            raise DeviceRefused("approve is refused: no plan waits for it")
        if program_sha256 != self.wanted:
            raise DeviceRefused("approve is refused: another plan waits now; look at it, and approve that one")
        self._given.set()
