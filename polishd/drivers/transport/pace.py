"""A loop that goes round at a steady pace."""

from __future__ import annotations

import asyncio
import time


class PeriodicTimer:
    """One round a period. A round that took longer is not made up for by the next ones."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = time.monotonic()

    async def next(self) -> None:
        """Wait until the next round is due."""
        self._due_s = max(self._due_s + self._period_s, time.monotonic())
        await asyncio.sleep(self._due_s - time.monotonic())
