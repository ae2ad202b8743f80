"""Write the run folder for people, off the event loop, from the journal."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polishd.daemon.journal.journal import Journal
from polishd.model.errors import ConfigError
from polishd.pipeline.records import table
from polishd.pipeline.run_folder import RunFolder

MEASUREMENT = ("map.*", "surface.npz", "registration.json")
"""Files of a measurement in its cycle's folder."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunFolderWriter:
    """Writer of a job's run folder. A file that cannot be written does not end the job."""

    folder: RunFolder
    journal: Journal

    async def keep(self, write: Callable[..., None], *arguments: Any) -> None:
        """Call a function that writes, in a thread."""
        try:
            await asyncio.to_thread(write, *arguments)
        except (OSError, ConfigError) as error:
            log.error("the run folder cannot be written: %s; the job continues without it", error)

    async def leave(self, cycle: int, name: str, content: Any) -> None:
        """Write a JSON file to the cycle's folder."""
        await self.keep(self.folder.cycle(cycle).json, name, content)

    async def set_aside(self, cycle: int, number: int) -> None:
        """Move the map's files aside for another map of the same cycle; the journal has both maps."""
        await self.keep(self.folder.cycle(cycle).set_aside, f"settling-{number:02d}", MEASUREMENT)

    async def executed(self, cycle: int) -> None:
        """Write ``executed.csv`` of that cycle's pass."""
        await self.keep(self._executed, cycle)

    async def remake(self) -> None:
        """Write the files that the report reads again where they were deleted."""
        await self.keep(self._remake)

    def _executed(self, cycle: int) -> None:
        """Write the executed blocks; of an interrupted pass also the numbers of those that it may have reached."""
        blocks = self.journal.executed(cycle)
        record = next(found for found in self.journal.passes if found.cycle == cycle)
        reached = np.arange(*(record.uncertain or (0, 0)))
        columns: dict[str, NDArray[Any]] = {
            "start_s": blocks.start_s,
            "end_s": blocks.end_s,
            "contact": blocks.touched,
            "force_n": blocks.force_n,
            "rpm": blocks.rpm,
            "sensor_force_n": blocks.sensor_force_n,
        }
        whole: dict[str, NDArray[Any]] = {"seq": blocks.seq, **columns}
        if reached.size:
            unknown = np.full(reached.size, np.nan)
            whole = {name: np.concatenate([column, unknown]) for name, column in columns.items()}
            whole = {"seq": np.concatenate([blocks.seq, reached]), **whole}
        content = table(whole)
        self.folder.cycle(cycle).bytes("executed.csv", content)

    def _remake(self) -> None:
        store = self.journal.arrays
        for found in self.journal.history:
            folder = self.folder.cycle(found.cycle)
            if not folder.holds("surface.npz"):
                folder.bytes("surface.npz", store.content(found.arrays))
        passes = self.journal.passes
        for record in passes:
            folder = self.folder.cycle(record.cycle)
            if not folder.holds("plan.npz"):
                folder.bytes("plan.npz", store.content(record.plan))
                folder.json("certificate.json", record.facts["certificate"])
            may_have_more = record is passes[-1] and record.how != "done"  # the robot reported more blocks afterwards
            if may_have_more or not folder.holds("executed.csv"):
                self._executed(record.cycle)
