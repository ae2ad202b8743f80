"""Sources of the daemon's jobs: the single job of the cell's file, or the jobs of the queue.

A source has the job under way, journals its end, and writes a summary into its run folder. Its memory does not grow
with the number of jobs.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from polishd.daemon.job.job import Job
from polishd.daemon.job_assembly import NoJob, figures
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
    """Base of both sources."""

    of_queue: ClassVar[bool]
    """Whether jobs follow one another: each has a verdict at its end, and its part is put in before it begins."""

    def __init__(self, journal: Journal, folder: RunFolder | None = None) -> None:
        """``journal``: that of the job under way, or of the cell between jobs."""
        self.queue = Queue(journal.store)
        self.job: Job | NoJob = NoJob(journal)
        self.entry: QueueEntry | None = None
        """Queue entry of the job under way."""
        self.folder = folder
        self.bus: EventBus | None = None
        """Event bus, set once both exist, because the source is one of its sinks."""
        self._started = utc_now()

    def run_dir(self) -> Path | None:
        """Return the run folder of the job under way."""
        return None if self.folder is None else self.folder.path

    @property
    def ready(self) -> bool:
        """Whether a job is under way and this cell surely has its part."""
        return isinstance(self.job, Job)

    def handlers(self) -> dict[str, Handler]:
        """Return handlers of commands of the socket."""
        return {}

    def added(self) -> None:
        """Handle an added or removed job, or a waiting job that may begin now."""

    def status(self) -> dict[str, Any]:
        """Return the source's part of ``status``."""
        return {}

    def exit_facts(self, _: Outcome, /) -> dict[str, Any]:
        """Return entries that replace those of the exit record if no error ended the daemon."""
        return {}

    def record(self, event: Event) -> None:
        """Journal an event, with the job under way if there is one."""
        self.job.journal.record_event(event)

    def publish(self, event: Event) -> None:
        """Publish an event."""
        if self.bus is not None:
            self.bus.publish(event)

    async def _leave(self, summary: Mapping[str, Any], standing: CellSafety | None = None) -> list[Exception]:
        """Write summary and journal of the job under way into its run folder and publish that; return the errors."""
        folder, failed = self.folder, list[Exception]()
        if folder is None:
            return failed
        try:
            await asyncio.to_thread(folder.json, "summary.json", summary)
            await asyncio.to_thread(self.job.journal.copy_to, folder.path / "journal.sqlite")
        except (OSError, PolishdError) as error:
            log.error("the run folder is not complete: %s: %s; the journal is", folder.path, error)
            failed.append(error)
        outcome, reason, path = str(summary["outcome"]), str(summary["reason"]), str(folder.path)
        try:
            self.publish(events.RunFolderCompleted(run_dir=path, outcome=outcome, reason=reason, standing=standing))
        except PolishdError as error:  # the journal is lost
            failed.append(error)
        return failed


class SingleJob(JobSource):
    """The job of the cell's file: a queue of one, whose part an operator put in before the start."""

    of_queue = False

    def __init__(self, journal: Journal, folder: RunFolder, job: Job | None = None) -> None:
        """``journal`` is the job's."""
        super().__init__(journal, folder)
        if job is not None:
            self.job = job

    async def resume(self) -> None:
        """Restore the state of the job from an earlier run of the daemon."""
        if isinstance(self.job, Job):
            await self.job.load()

    async def close(self, last: Mapping[str, Any], *, failed: bool) -> dict[str, Any]:
        """Journal the outcome, write the summary into the run folder and return it. ``last``: the exit record."""
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
"""Makes an entry's job and run folder and journals it as under way; see ``job_assembly.JobMaker``."""
EMPTY = "the queue is empty: add jobs with polishd queue add CELL.toml JOB.toml, then polishd run CELL.toml --queue"
GOES_ON = "no job was under way: polishd run CELL.toml --queue runs the waiting jobs; a held cell starts held"


class QueuedJobs(JobSource):
    """The jobs of the queue, one after another."""

    of_queue = True

    def __init__(self, journal: Journal, make: MakeJob) -> None:
        """``journal`` is that of the cell, between jobs."""
        super().__init__(journal)
        self.claims = ShopAssignments(self.queue, self.added)
        self.ended: Counter[str] = Counter()
        """Number of ended jobs of this run of the daemon, by verdict."""
        self._of_cell, self._make = journal, make
        self._began = ""
        self._news = asyncio.Event()

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of the shop's link."""
        return self.claims.handlers(self.publish)

    def status(self) -> dict[str, Any]:
        """Return the number of waiting jobs, the next job and the shop's assignments."""
        waiting = self.queue.waiting()
        next_job = f"{waiting[0].name} (part {waiting[0].part_id})" if waiting else ""
        return {"waiting": len(waiting), "next_job": next_job, **self.claims.facts()}

    def added(self) -> None:
        """End the wait for a job."""
        self._news.set()

    async def resume(self) -> None:
        """Make the job that an earlier run left under way, before any device is opened.

        Raises PolishdError if the job cannot go on with the present cell.
        """
        entry = self.queue.under_way()
        if entry is None:
            return
        try:
            await self.begin(entry)
        except PolishdError as error:
            aside = f"or set it aside: polishd queue remove CELL.toml {entry.name}"
            raise type(error)(
                f"{error}\nthe job {entry.name!r} of the queue is under way. Correct the cause, {aside}"
            ) from error

    @property
    def ready(self) -> bool:
        """Whether a job is under way and, if a shop assigned its part, the shop has confirmed it."""
        return self.entry is not None and self.claims.stands(self.entry)

    async def next(self, *, until_empty: bool = False) -> QueueEntry | None:
        """Wait for and return the job that an earlier run began, or the first one that may begin.

        With ``until_empty`` return None if no job waits.
        """
        while (entry := self.queue.under_way() or self.claims.first()) is None:
            if until_empty and not self.queue.to_do():
                break
            self._news.clear()
            await self._news.wait()
        return entry

    async def begin(self, entry: QueueEntry) -> None:
        """Begin a job. PolishdError if anything in it is wrong; nothing has moved then."""
        job, self.folder = await self._make(entry, self.queue, self._of_cell, self.publish)
        self.job, self.entry, self._began = job, entry, utc_now()
        self.publish(events.JobStarted(job=entry.name, part_id=entry.part_id, run_dir=str(self.folder.path)))

    def judge(self, end: Outcome | PolishdError, *, torn: bool = False) -> JobResult | None:
        """Return the verdict on the job under way, or on one that could not begin; None if the job goes on.

        ``torn``: the end interrupted a pass, and every device has confirmed since that it is safe.
        """
        before = self.queue.last_ended()
        tool = "; ".join(found.what for found in self.job.findings if found.stops == "cell")
        return judge(end, torn=torn, previous=before.fault if before else "", tool=tool)

    async def end(self, verdict: JobResult, summary: Mapping[str, Any]) -> None:
        """End the job under way: first in the journal, then in its run folder, then by an event."""
        entry, job, folder = self.entry, self.job, self.folder
        if entry is None or folder is None:
            raise RuntimeError("a fault of polishd: no job is under way. Please report it")
        self.queue.end(entry, verdict, over_row(job.journal.number, _outcome(verdict), verdict.reason))
        await self._leave_job(summary)
        self._publish_end(entry, verdict, str(folder.path))
        self.job, self.entry, self.folder = NoJob(self._of_cell), None, None

    def refuse(self, entry: QueueEntry, verdict: JobResult) -> None:
        """End a job that could not begin."""
        entry = next((one for one in self.queue.to_do() if one.id == entry.id), entry)
        also = [over_row(entry.job, _outcome(verdict), verdict.reason)] if entry.job else []
        self.queue.end(entry, verdict, *also)
        self._publish_end(entry, verdict, "")

    def exit_facts(self, outcome: Outcome, /) -> dict[str, Any]:
        """Return the entries of a daemon that ended between jobs; exit code 0 if all parts were accepted."""
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
        """Write a summary of a job that stays open, publish the end of the queue, return the run's summary."""
        if self.entry is not None:
            job = {"outcome": last["state"], "job": self.entry.name}
            await self._leave_job({**last, **figures(self.job), **job})
        if not failed:  # `DaemonFailed` was published
            jobs = ", ".join(f"{count} {how}" for how, count in self.ended.items()) or "none"
            word, reason, standing = str(last["state"]), str(last["reason"]), CellSafety.of(last)
            with suppress(PolishdError):  # the journal is lost, which was published
                self.publish(events.QueueStopped(outcome=word, reason=reason, jobs=jobs, standing=standing))
        facts = {key: value for key, value in last.items() if key != "state"}
        times = {"started": self._started, "ended": utc_now()}
        return {"outcome": last["state"], "jobs": dict(self.ended), **times, **facts}

    async def _leave_job(self, summary: Mapping[str, Any]) -> None:
        times = {"started": self._began, "ended": utc_now()}
        await self._leave({**summary, "run_dir": str(self.run_dir()), **times})

    def _publish_end(self, entry: QueueEntry, verdict: JobResult, run_dir: str) -> None:
        self.ended[verdict.how] += 1
        facts: dict[str, Any] = {"verdict": verdict.how, "reason": verdict.reason, "stops": verdict.stops}
        self.publish(events.QueueJobEnded(job=entry.name, part_id=entry.part_id, run_dir=run_dir, **facts))


def _outcome(verdict: JobResult) -> str:
    """Return the outcome as written in the journal."""
    return {"accepted": "in_tolerance", "set aside": "set aside"}.get(verdict.how, verdict.fault)
