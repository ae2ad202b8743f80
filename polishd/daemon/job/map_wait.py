"""Wait for the instrument's next map, and report each map that it refuses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import asdict

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import root_cause
from polishd.interfaces import RefusesMaps
from polishd.model.devices import MapRefusal
from polishd.model.events import Event, MapRefused
from polishd.model.surface import SurfaceMap

REMIND_S = 600.0
"""After so long without a map the last refusal is reported again."""


async def next_map(cell: Cell, publish: Callable[[Event], None], cycle: int, after: str | None) -> SurfaceMap:
    """Return the next map as ``Metrology.next_map`` does; publish an event for each refused one at once."""
    metrology = cell.metrology
    if not isinstance(metrology, RefusesMaps):
        return await metrology.next_map(after)
    reminder: asyncio.Task[None] | None = None
    try:
        async with asyncio.TaskGroup() as group:

            def report(refusal: MapRefusal) -> None:
                nonlocal reminder
                cell.map_refusal = refusal
                publish(MapRefused(cycle=cycle, **asdict(refusal)))
                if reminder is not None:
                    reminder.cancel()
                reminder = group.create_task(_remind(publish, cycle, refusal), name="remind of a refused map")

            metrology.on_refusal(report)
            try:
                return await metrology.next_map(after)
            finally:
                metrology.on_refusal(None)
                cell.map_refusal = None
                if reminder is not None:
                    reminder.cancel()
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors


async def _remind(publish: Callable[[Event], None], cycle: int, refusal: MapRefusal) -> None:
    waited_s = 0.0
    while True:
        await asyncio.sleep(REMIND_S)
        waited_s += REMIND_S
        publish(MapRefused(cycle=cycle, waited_s=waited_s, **asdict(refusal)))
