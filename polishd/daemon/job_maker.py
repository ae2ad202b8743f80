"""From an entry of the queue to a job that can be worked on a cell that may be open."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from polishd.config.cell import CellConfig
from polishd.daemon.assembly import bind_part_to_devices, require_time_limits
from polishd.daemon.cell import Cell
from polishd.daemon.compute import Compute
from polishd.daemon.desk import require_unchanged
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal
from polishd.daemon.making import make_job, read_recipes, run_folder
from polishd.daemon.queue import Queue, QueueEntry
from polishd.daemon.same_job import require_same, terms_of
from polishd.daemon.standing import require_stall_depth
from polishd.hooks.cell import hooks_of_job
from polishd.hooks.loader import Hooks
from polishd.model.events import Event
from polishd.recipe.accepting import require_acceptable
from polishd.recipe.folder import RunFolder
from polishd.recipe.making import require_commissioned
from polishd.recipe.program_fit import require_fit
from polishd.recipe.steps import read_program


@dataclass(frozen=True, slots=True)
class JobMaker:
    """Makes jobs of one cell. Its processes and devices stay; only what looks at the part is built for each."""

    config: CellConfig
    hooks: Hooks
    cell: Cell
    compute: Compute

    async def __call__(
        self, entry: QueueEntry, queue: Queue, journal: Journal, publish: Callable[[Event], None]
    ) -> tuple[Job, RunFolder]:
        """The job, journalled as under way; where an earlier run began it, with all that is known of it.

        PolishdError where anything of it is wrong; nothing has moved then. The numbers are worked in the compute
        worker, and files are read in threads: other cells of this process may be in contact.
        """
        lay = require_unchanged if entry.begun_s is None else _laid_over
        config = await asyncio.to_thread(lay, self.config, entry)
        hooks = await asyncio.to_thread(hooks_of_job, self.config, self.hooks, config)
        recipes = await asyncio.to_thread(read_recipes, config, hooks)
        require_commissioned(config, recipes[0].instrument)
        require_acceptable(recipes[0])
        programs = []
        for tool, recipe in zip(config.turns, recipes, strict=True):
            programs.append(await self.compute(read_program, recipe, tool.program_path))
            await self.compute(require_fit, tool, recipe, programs[-1])
            require_stall_depth(tool, self.cell, recipe)
        require_time_limits(config, self.cell)
        terms = await asyncio.to_thread(terms_of, config, programs[0].sha256)
        queue.require_held(entry)  # or the journal would have a job that another cell may be given now
        own = journal.of_job(entry.name, entry.part_id, terms, queue.begin_row(entry))
        require_same(config, terms, own)
        queue.begin(entry, own.number)
        await bind_part_to_devices(self.cell, config, hooks)
        folder = run_folder(config, own, entry.content)
        job = make_job(
            config, hooks, recipes, programs, journal=own, folder=folder, compute=self.compute, publish=publish
        )
        await job.load()
        return job, folder


def _laid_over(cell: CellConfig, entry: QueueEntry) -> CellConfig:
    """Of a job that is under way: ``require_same`` says what may have changed since."""
    return entry.file.laid_over(cell)
