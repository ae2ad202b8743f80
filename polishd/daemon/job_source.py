"""Where the jobs of the daemon come from: the one job of the cell's own file, or the jobs of the queue.

A source has the job under way, journals how it ends, and leaves a summary in its run folder. Nothing in it grows with
the number of jobs.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from polishd.daemon.assembly import NoJob, figures
from polishd.daemon.job.job import Job
from polishd.daemon.journal.journal import Journal, over_row
from polishd.daemon.queue.queue import JobResult, Queue, QueueEntry, judge
from polishd.daemon.queue.requests import ShopAssignments
from polishd.daemon.runtime.events import EventBus, utc_now
from polishd.daemon.socket.server import Handler
from polishd.model import events
from polishd.model.errors import PolishdError
from polishd.model.events import Event
from polishd.model.states import CellSafety, Outcome
from polishd.pipeline.run_folder import RunFolder

log = logging.getLogger(__name__)


class JobSource:
    """What both sources have."""

    of_queue: ClassVar[bool]
    """Jobs follow one another: each one has a verdict at its end, and its part is put in before it begins."""

    def __init__(self, journal: Journal, folder: RunFolder | None = None) -> None:
        """``journal``: of the job under way, or of the cell between jobs."""
        self.queue = Queue(journal.store)
        self.job: Job | NoJob = NoJob(journal)
        self.entry: QueueEntry | None = None
        """Row of the queue of the job under way."""
        self.folder = folder
        self.bus: EventBus | None = None
        """The source is one of its sinks, so it is set once both exist."""
        self._started = utc_now()

    def run_dir(self) -> Path | None:
        """Run folder of the job under way."""
        return None if self.folder is None else self.folder.path

    @property
    def ready(self) -> bool:
        """A job is under way, and it is sure that this cell has its part."""
        return isinstance(self.job, Job)

    def handlers(self) -> dict[str, Handler]:
        """Handlers of verbs of the socket."""
        return {}

    def added(self) -> None:
        """A job was added or taken out, or one that waits may begin now."""

    def status(self) -> dict[str, Any]:
        """The source's part of ``status``."""
        return {}

    def last_words(self, _: Outcome, /) -> dict[str, Any]:
        """What the exit record has instead, where no error ended the daemon."""
        return {}

    def record(self, event: Event) -> None:
        """Journal an event, with the job under way if there is one."""
        self.job.journal.record_event(event)

    def tell(self, event: Event) -> None:
        """Publish an event."""
        if self.bus is not None:
            self.bus.publish(event)

    async def _leave(self, summary: Mapping[str, Any], standing: CellSafety | None = None) -> list[Exception]:
        """Write summary and journal of the job under way into its run folder, and publish that. Returns what failed."""
        folder, failed = self.folder, list[Exception]()
        if folder is None:
            return failed
        try:
            await asyncio.to_thread(folder.json, "summary.json", summary)
            await asyncio.to_thread(self.job.journal.copy_to, folder.path / "journal.sqlite")
        except (OSError, PolishdError) as error:
            log.error("the run folder is not complete: %s: %s; the journal has all of it", folder.path, error)
            failed.append(error)
        outcome, reason, path = str(summary["outcome"]), str(summary["reason"]), str(folder.path)
        try:
            self.tell(events.RunFolderCompleted(run_dir=path, outcome=outcome, reason=reason, standing=standing))
        except PolishdError as error:  # the journal is lost
            failed.append(error)
        return failed


class SingleJob(JobSource):
    """The job of the cell's own file: a queue of one, whose part an operator put in before the start."""

    of_queue = False

    def __init__(self, journal: Journal, folder: RunFolder, job: Job | None = None) -> None:
        """``journal`` is the job's."""
        super().__init__(journal, folder)
        if job is not None:
            self.job = job

    async def resume(self) -> None:
        """Take up what an earlier run of the daemon knew of the job."""
        if isinstance(self.job, Job):
            await self.job.load()

    async def close(self, last: Mapping[str, Any], *, failed: bool) -> dict[str, Any]:
        """Journal the outcome, leave the summary in the run folder, and return it. ``last``: the exit record."""
        facts = {key: value for key, value in last.items() if key != "state"}
        summary = {
            "outcome": last["state"],
            "job": self.job.names()["job"],
            **figures(self.job),
            "started": self._started,
            "ended": utc_now(),
            **facts,
        }
        problems: list[Exception] = []
        if not failed and last["state"] != Outcome.STOPPED:
            try:
                self.job.journal.record_outcome(Outcome(last["state"]))
            except PolishdError as error:
                problems.append(error)
        problems += await self._leave(summary, CellSafety.of(summary))
        for problem in problems:
            summary["notes"] = [*summary["notes"], f"{summary['run_dir']} is not complete: {problem}"]
            summary["exit_code"] = summary["exit_code"] or getattr(problem, "exit_code", 1)
        return summary


MakeJob = Callable[[QueueEntry, Queue, Journal, Callable[[Event], None]], Awaitable[tuple[Job, RunFolder]]]
"""Makes an entry's job, journals it as under way, and makes its run folder; see ``assembly.JobMaker``."""
EMPTY = "the queue is empty: polishd queue add CELL.toml JOB.toml adds to it, polishd run CELL.toml --queue goes on"
GOES_ON = "no job was under way: polishd run CELL.toml --queue goes on with those that wait; held, if it was held"


class QueuedJobs(JobSource):
    """The jobs of the queue, one after another."""

    of_queue = True

    def __init__(self, journal: Journal, make: MakeJob) -> None:
        """``journal`` is that of the cell, between jobs."""
        super().__init__(journal)
        self.claims = ShopAssignments(self.queue, self.added)
        self.ended: Counter[str] = Counter()
        """Number of jobs of this run of the daemon, by verdict."""
        self._of_cell, self._make = journal, make
        self._began = ""
        self._news = asyncio.Event()

    def handlers(self) -> dict[str, Handler]:
        """Of the shop's link."""
        return self.claims.handlers(self.tell)

    def status(self) -> dict[str, Any]:
        """What waits."""
        waiting = self.queue.waiting()
        next_job = f"{waiting[0].name} (part {waiting[0].part_id})" if waiting else ""
        return {"waiting": len(waiting), "next_job": next_job, **self.claims.facts()}

    def added(self) -> None:
        """End the wait for a job."""
        self._news.set()

    async def resume(self) -> None:
        """Make the job that an earlier run left under way, before any device is opened.

        Raises PolishdError where it cannot go on with the cell as it is now.
        """
        entry = self.queue.under_way()
        if entry is None:
            return
        try:
            await self.begin(entry)
        except PolishdError as error:
            aside = f"or put it aside: polishd queue remove CELL.toml {entry.name}"
            raise type(error)(
                f"{error}\nthe job {entry.name!r} of the queue is under way; mend that, {aside}"
            ) from error

    @property
    def ready(self) -> bool:
        """The shop has confirmed it, of a part that a shop gave."""
        return self.entry is not None and self.claims.stands(self.entry)

    async def next(self, *, until_empty: bool = False) -> QueueEntry | None:
        """The job that an earlier run began, or the first one that may begin, as soon as there is one.

        None with ``until_empty`` where no job waits at all.
        """
        while (entry := self.queue.under_way() or self.claims.first()) is None:
            if until_empty and not self.queue.to_do():
                break
            self._news.clear()
            await self._news.wait()
        return entry

    async def begin(self, entry: QueueEntry) -> None:
        """Begin a job. PolishdError where anything in it is wrong: nothing has moved then."""
        job, self.folder = await self._make(entry, self.queue, self._of_cell, self.tell)
        self.job, self.entry, self._began = job, entry, utc_now()
        self.tell(events.JobStarted(job=entry.name, part_id=entry.part_id, run_dir=str(self.folder.path)))

    def judge(self, end: Outcome | PolishdError, *, torn: bool = False) -> JobResult | None:
        """The verdict on the job under way, or on the one that could not begin; None where the job is not over.

        ``torn``: the end cut off a pass, and every device has confirmed since that it is safe.
        """
        before = self.queue.last_ended()
        tool = "; ".join(found.what for found in self.job.findings if found.stops == "cell")
        return judge(end, torn=torn, previous=before.fault if before else "", tool=tool)

    async def end(self, verdict: JobResult, summary: Mapping[str, Any]) -> None:
        """End the job under way: first in the journal, then in its run folder, then as an event."""
        entry, job, folder = self.entry, self.job, self.folder
        if entry is None or folder is None:
            raise RuntimeError("a fault of polishd: no job is under way; please report it")
        self.queue.end(entry, verdict, over_row(job.journal.number, _outcome(verdict), verdict.reason))
        await self._leave_job(summary)
        self._tell_end(entry, verdict, str(folder.path))
        self.job, self.entry, self.folder = NoJob(self._of_cell), None, None

    def refuse(self, entry: QueueEntry, verdict: JobResult) -> None:
        """End a job that could not begin."""
        entry = next((one for one in self.queue.to_do() if one.id == entry.id), entry)
        also = [over_row(entry.job, _outcome(verdict), verdict.reason)] if entry.job else []
        self.queue.end(entry, verdict, *also)
        self._tell_end(entry, verdict, "")

    def last_words(self, outcome: Outcome, /) -> dict[str, Any]:
        """Of a daemon that ended between jobs: no failure if all parts were accepted."""
        stopped = outcome is Outcome.STOPPED
        if self.entry is not None or not (stopped or not self.queue.to_do()):
            return {}
        state = {} if stopped else {"state": "empty"}
        return {
            **state,
            "next": GOES_ON if stopped else EMPTY,
            "exit_code": int(set(self.ended) - {"accepted"} != set()),
        }

    async def close(self, last: Mapping[str, Any], *, failed: bool) -> dict[str, Any]:
        """Leave a summary of a job that stays open, publish the end of the queue, and return the run's summary."""
        if self.entry is not None:
            job = {"outcome": last["state"], "job": self.entry.name}
            await self._leave_job({**last, **figures(self.job), **job})
        if not failed:  # `DaemonFailed` was published
            jobs = ", ".join(f"{count} {how}" for how, count in self.ended.items()) or "none"
            word, reason, standing = str(last["state"]), str(last["reason"]), CellSafety.of(last)
            with suppress(PolishdError):  # the journal is lost, and that was published
                self.tell(events.QueueStopped(outcome=word, reason=reason, jobs=jobs, standing=standing))
        facts = {key: value for key, value in last.items() if key != "state"}
        times = {"started": self._started, "ended": utc_now()}
        return {"outcome": last["state"], "jobs": dict(self.ended), **times, **facts}

    async def _leave_job(self, summary: Mapping[str, Any]) -> None:
        times = {"started": self._began, "ended": utc_now()}
        await self._leave({**summary, "run_dir": str(self.run_dir()), **times})

    def _tell_end(self, entry: QueueEntry, verdict: JobResult, run_dir: str) -> None:
        self.ended[verdict.how] += 1
        facts: dict[str, Any] = {"verdict": verdict.how, "reason": verdict.reason, "stops": verdict.stops}
        self.tell(events.QueueJobEnded(job=entry.name, part_id=entry.part_id, run_dir=run_dir, **facts))


def _outcome(verdict: JobResult) -> str:
    """As the journal's jobs have it."""
    return {"accepted": "in_tolerance", "set aside": "set aside"}.get(verdict.how, verdict.fault)
