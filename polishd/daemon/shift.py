"""The jobs of a queue on one cell, one at a time: begun, and ended with their verdict."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from polishd.daemon.claims import ShopAssignments
from polishd.daemon.endings import utc_now
from polishd.daemon.events import EventBus
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal, over_row
from polishd.daemon.making import NoJob
from polishd.daemon.queue import Queue, QueueEntry
from polishd.daemon.verdicts import JobResult
from polishd.model import events
from polishd.model.errors import PolishdError
from polishd.model.events import Event
from polishd.recipe.folder import RunFolder

log = logging.getLogger(__name__)

Begin = Callable[[QueueEntry, Queue, Journal, Callable[[Event], None]], Awaitable[tuple[Job, RunFolder]]]
"""Makes an entry's job ready, journals it as under way, and makes its run folder; see ``job_maker.JobMaker``."""


class QueueRunner:
    """What the daemon of a queue knows of its jobs; nothing in it grows with their number."""

    def __init__(self, journal: Journal, make: Begin) -> None:
        """``journal`` is that of the cell, between jobs."""
        self.queue = Queue(journal.store)
        self.claims = ShopAssignments(self.queue, self.added)
        """What a shop has said of the parts that it gave to this cell."""
        self.ended: Counter[str] = Counter()
        """How many jobs ended so, in this run of the daemon."""
        self.entry: QueueEntry | None = None
        """The job that is under way in this run."""
        self.job: Job | NoJob = NoJob(journal)
        self.folder: RunFolder | None = None
        self.bus: EventBus | None = None
        """Who is told; made with this shift as one that hears."""
        self._of_cell, self._make = journal, make
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
        """Something was added to the queue, or taken out, or may begin now."""
        self._news.set()

    async def next(self, *, until_empty: bool = False) -> QueueEntry | None:
        """The job that was begun by an earlier run, or the first that waits and may begin, as soon as there is one.

        None with ``until_empty``, where nothing waits at all.
        """
        while (entry := self.queue.under_way() or self.claims.first()) is None:
            if until_empty and self.first() is None:
                break
            self._news.clear()
            await self._news.wait()
        return entry

    def first(self) -> QueueEntry | None:
        """The one under way, or the first that waits, whether it may begin or not; None where the queue is empty."""
        return next(iter(self.queue.to_do()), None)

    async def begin(self, entry: QueueEntry) -> Job:
        """Its job is under way; PolishdError where anything of it is wrong: nothing has moved then."""
        job, self.folder = await self._make(entry, self.queue, self._of_cell, self.tell)
        self.job, self.entry, self._began = job, entry, utc_now()
        self.tell(events.JobStarted(job=entry.name, part_id=entry.part_id, run_dir=str(self.folder.path)))
        return job

    async def end(self, verdict: JobResult, summary: Mapping[str, Any]) -> None:
        """The job under way is over: first in the journal, then in its run folder, then told."""
        entry, job, folder = self.entry, self.job, self.folder
        if entry is None or folder is None:
            raise RuntimeError("a fault of polishd: no job is under way; please report it")
        self.queue.end(entry, verdict, over_row(job.journal.number, _outcome(verdict), verdict.reason))
        await self.leave(summary)
        self._told_end(entry, verdict, str(folder.path))
        self.job, self.entry, self.folder = NoJob(self._of_cell), None, None

    async def leave(self, summary: Mapping[str, Any]) -> None:
        """What is known of the job under way is left in its run folder, and told; nothing where there is none.

        ``summary`` has ``outcome`` and ``reason``.
        """
        folder = self.folder
        if folder is None:
            return
        told = {**summary, "run_dir": str(folder.path), "started": self._began, "ended": utc_now()}
        try:
            await asyncio.to_thread(folder.json, "summary.json", told)
            await asyncio.to_thread(self.job.journal.copy_to, folder.path / "journal.sqlite")
        except (OSError, PolishdError) as error:
            log.error("%s is not whole: %s; the journal has it all", folder.path, error)
        outcome, reason = str(summary["outcome"]), str(summary["reason"])
        self.tell(events.RunFolderCompleted(run_dir=str(folder.path), outcome=outcome, reason=reason))

    def refuse(self, entry: QueueEntry, verdict: JobResult) -> None:
        """A job that could not begin is over."""
        entry = next((one for one in self.queue.to_do() if one.id == entry.id), entry)
        also = [over_row(entry.job, _outcome(verdict), verdict.reason)] if entry.job else []
        self.queue.end(entry, verdict, *also)
        self._told_end(entry, verdict, "")

    def _told_end(self, entry: QueueEntry, verdict: JobResult, run_dir: str) -> None:
        self.ended[verdict.how] += 1
        said: dict[str, Any] = {"verdict": verdict.how, "reason": verdict.reason, "stops": verdict.stops}
        self.tell(events.QueueJobEnded(job=entry.name, part_id=entry.part_id, run_dir=run_dir, **said))


def _outcome(verdict: JobResult) -> str:
    """As the journal's jobs have it."""
    return {"accepted": "in_tolerance", "put aside": "put aside"}.get(verdict.how, verdict.fault)


async def resume_open_job(shift: QueueRunner) -> None:
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
