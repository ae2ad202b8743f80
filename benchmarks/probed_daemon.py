"""``python -m benchmarks.probed_daemon NOTE run CELL.toml``: polishd, whose loop records how late it wakes.

A line of NOTE is the due time of a wake after 5 ms (``time.monotonic``), and its lateness in ms.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TextIO

from polishd.cli import app
from polishd.daemon.health import Health

EVERY_S = 0.005


async def note_on(note: TextIO) -> None:
    """Run until it is cancelled."""
    while True:
        due_s = time.monotonic() + EVERY_S
        await asyncio.sleep(EVERY_S)
        note.write(f"{due_s:.6f} {1e3 * (time.monotonic() - due_s):.4f}\n")


def probe(path: Path) -> None:
    """Make each loop with a health monitor record its lateness."""
    watching = Health.watching

    @asynccontextmanager
    async def probed(self: Health, danger: Callable[[str], None]) -> AsyncIterator[None]:
        with path.open("a", buffering=1) as note:
            task = asyncio.ensure_future(note_on(note))
            try:
                async with watching(self, danger):
                    yield
            finally:
                task.cancel()

    Health.watching = probed  # type: ignore[method-assign]


if __name__ == "__main__":
    probe(Path(sys.argv.pop(1)))
    app.main()
