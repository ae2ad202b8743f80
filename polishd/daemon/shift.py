"""The jobs of a queue on one cell: made from the queue's entries, one at a time, and ended with their verdict."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Mapping
from typing import Any

from polishd.config.cell import CellConfig
from polishd.daemon.assembly import look_for_part, require_time_limits
from polishd.daemon.cell import Cell
from polishd.daemon.compute import Compute
from polishd.daemon.desk import require_unchanged
from polishd.daemon.endings import now
from polishd.daemon.events import EventBus
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal, over_row
from polishd.daemon.making import NoJob, make_job, run_folder
from polishd.daemon.queue import Entry, Queue
from polishd.daemon.same_job import require_same, terms_of
from polishd.daemon.verdicts import Verdict
from polishd.hooks.cell import hooks_of_job
from polishd.hooks.loader import Hooks
from polishd.model import events
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.events import Event
from polishd.recipe.folder import RunFolder
from polishd.recipe.making import make_recipe, require_commissioned
from polishd.recipe.program_fit import require_fit
from polishd.recipe.steps import read_program

log = logging.getLogger(__name__)


class Shift:
    """What the daemon of a queue knows of its jobs; nothing in it grows with their number."""

    def __init__(self, config: CellConfig, hooks: Hooks, cell: Cell, journal: Journal, compute: Compute) -> None:
        self.queue = Queue(journal.store)
        self.ended: Counter[str] = Counter()
        """How many jobs ended so, in this run of the daemon."""
        self.entry: Entry | None = None
        """The job that is under way in this run."""
        self.job: Job | NoJob = NoJob(journal)
        self.folder: RunFolder | None = None
        self.bus: EventBus | None = None
        """Who is told; made with this shift as one that hears."""
        self._config, self._hooks, self._cell, self._of_cell, self._compute = config, hooks, cell, journal, compute
        self._began = ""
        self._news = asyncio.Event()

    def record(self, event: Event) -> None:
        """Keep it with the job under way, or with none."""
        self.job.journal.record_event(event)

    def tell(self, event: Event) -> None:
        """Publish an event."""
        if self.bus is not None:
            self.bus.publish(event)

    def added(self) -> None:
        """Something was added to the queue."""
        self._news.set()

    async def next(self) -> Entry:
        """The job that was begun by an earlier run, or the first that waits, as soon as there is one."""
        while (entry := self.first()) is None:
            self._news.clear()
            await self._news.wait()
        return entry

    def first(self) -> Entry | None:
        """The same, as of now; None where the queue is empty."""
        return self.queue.under_way() or self.queue.next()

    async def begin(self, entry: Entry) -> Job:
        """Its job, journalled as under way; where an earlier run began it, with all that is known of it.

        PolishdError where anything of it is wrong; nothing has moved then. The numbers are worked in the compute
        worker, and files are read in threads: other cells of this process may be in contact.
        """
        new = entry.begun_s is None
        lay = require_unchanged if new else _laid_over
        config = await asyncio.to_thread(lay, self._config, entry)
        hooks = await asyncio.to_thread(hooks_of_job, self._config, self._hooks, config)
        recipe = await asyncio.to_thread(make_recipe, config, hooks)
        require_commissioned(config, recipe)
        program = await self._compute(read_program, recipe, config.program_path)
        await self._compute(require_fit, config, recipe, program)
        require_time_limits(config, self._cell)
        terms = await asyncio.to_thread(terms_of, config, program.sha256)
        journal = self._of_cell.of_job(entry.name, entry.part_id, terms)
        require_same(config, terms, journal)
        self.queue.begin(entry, journal.number)
        await look_for_part(self._cell, config, hooks)
        self.folder = run_folder(config, journal, entry.content)
        job = make_job(
            config,
            hooks,
            recipe,
            program,
            journal=journal,
            folder=self.folder,
            compute=self._compute,
            publish=self.tell,
        )
        await job.load()
        self.job, self.entry, self._began = job, entry, now()
        return job

    async def end(self, verdict: Verdict, summary: Mapping[str, Any]) -> None:
        """The job under way is over: first in the journal, then in its run folder, then told."""
        entry, job, folder = self.entry, self.job, self.folder
        if entry is None or folder is None:
            raise RuntimeError("a fault of polishd: no job is under way; please report it")
        self.queue.end(entry, verdict, job.journal.outcome_row(_outcome(verdict), verdict.reason))
        told = {**summary, "run_dir": str(folder.path), "started": self._began, "ended": now()}
        try:
            await asyncio.to_thread(folder.json, "summary.json", told)
            await asyncio.to_thread(job.journal.copy_to, folder.path / "journal.sqlite")
        except (OSError, ConfigError) as error:
            log.error("%s is not whole: %s; the journal has it all", folder.path, error)
        self.tell(events.JobFinished(run_dir=str(folder.path), outcome=str(summary["outcome"])))
        self._told_end(entry, verdict, str(folder.path))
        self.job, self.entry, self.folder = NoJob(self._of_cell), None, None

    def refuse(self, entry: Entry, verdict: Verdict) -> None:
        """A job that could not begin is over."""
        entry = next((one for one in self.queue.to_do() if one.id == entry.id), entry)
        also = [over_row(entry.job, _outcome(verdict), verdict.reason)] if entry.job else []
        self.queue.end(entry, verdict, *also)
        self._told_end(entry, verdict, "")

    def _told_end(self, entry: Entry, verdict: Verdict, run_dir: str) -> None:
        self.ended[verdict.how] += 1
        said: dict[str, Any] = {"verdict": verdict.how, "reason": verdict.reason, "stops": verdict.stops}
        self.tell(events.JobEnded(job=entry.name, part_id=entry.part_id, run_dir=run_dir, **said))


def _laid_over(cell: CellConfig, entry: Entry) -> CellConfig:
    """Of a job that is under way: ``require_same`` says what may have changed since."""
    return entry.file.laid_over(cell)


def _outcome(verdict: Verdict) -> str:
    """As the journal's jobs have it."""
    return {"accepted": "in_tolerance", "put aside": "put aside"}.get(verdict.how, verdict.fault)


async def taken_up(shift: Shift) -> None:
    """Make the job ready that an earlier run left under way; before any device is opened.

    Raises PolishdError where it cannot go on like this.
    """
    entry = shift.queue.under_way()
    if entry is None:
        return
    try:
        await shift.begin(entry)
    except PolishdError as error:
        aside = f"or put it aside: polishd job remove CELL.toml {entry.name}"
        raise type(error)(f"{error}\nthe job {entry.name!r} of the queue is under way; mend that, {aside}") from error
