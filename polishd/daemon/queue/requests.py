"""Requests to the queue, over the socket of a running daemon or from a command without a daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.job.resume_checks import file_terms
from polishd.daemon.queue.queue import NewJob, Queue, QueueEntry
from polishd.daemon.socket.server import Handler
from polishd.model.errors import ConfigError
from polishd.model.events import CommandReceived, Event, ShopRateReceived
from polishd.plugin_loader import Hooks, hooks_of_job


def new_job(cell: CellConfig, hooks: Hooks, file: JobFile) -> NewJob:
    """Return the job of a file for the queue; ConfigError where its values, or the files that it names, are wrong.

    It reads those files: in a daemon call it in a thread. It does not check the program: the caller does
    (``daemon.checks``), and the daemon when the job begins.
    """
    config = file.laid_over(cell)
    formats = hooks_of_job(cell, hooks, config).program_formats()
    return NewJob(config.job.id, config.part.id, file, file_terms(config, formats, file.names()))


def require_unchanged(cell: CellConfig, hooks: Hooks, entry: QueueEntry) -> CellConfig:
    """Return the cell's config with that job; ConfigError where a file that the job names has changed since.

    The job was checked with that content; with another content it is another job.
    """
    config = entry.file.laid_over(cell)
    formats = hooks_of_job(cell, hooks, config).program_formats()
    for key, now in file_terms(config, formats, entry.file.names()).items():
        if now != (then := entry.files.get(key)):
            used = formats.get(config.program.format)
            beside = " or the file that declares its positions" if "program" in key and used and used.data_file else ""
            raise config.error(
                key, f"{_file(now)}{beside} has changed since the job was added ({_hash(then)}). Add the job again"
            )
    return config


def _file(terms: Any) -> str:
    return ", ".join(map(_file, terms)) if isinstance(terms, list) else f"{terms['file']} ({_hash(terms)})"


def _hash(terms: Any) -> str:
    if isinstance(terms, list):
        return ", ".join(map(_hash, terms))
    return f"sha256 {terms['sha256'][:12]}" if terms else "without it"


class QueueRequests:
    """Requests to the queue of one cell. They run in threads: a tool may be in contact, and disks are slow."""

    def __init__(
        self,
        cell: CellConfig,
        hooks: Hooks,
        queue: Queue,
        changed: Callable[[], None] = lambda: None,
        publish: Callable[[Event], None] = lambda _: None,
    ) -> None:
        """``changed`` is called after an addition or removal, ``publish`` with the event of each change."""
        self._cell, self._hooks, self._queue, self._changed, self._publish = cell, hooks, queue, changed, publish
        self._turn = asyncio.Lock()

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of the socket's commands."""
        return {"queue_list": self.list, "queue_add": self.add, "queue_move": self.move, "queue_remove": self.remove}

    async def list(self) -> Mapping[str, Any]:
        """Return all jobs."""

        def facts() -> Sequence[Mapping[str, Any]]:
            return [entry.facts() for entry in self._queue.entries()]

        return {"jobs": await asyncio.to_thread(facts)}

    async def add(self, files: Sequence[Any], by: str = "", claim: str = "") -> Mapping[str, Any]:
        """Add jobs at the end, all or none. ``claim``: by which a shop gave this part to the cell."""
        named = [_job_file(file) for file in files]
        if claim and len(named) != 1:
            raise ConfigError("a claim belongs to one job. Name one file")

        def judged() -> Sequence[NewJob]:
            return [replace(new_job(self._cell, self._hooks, file), claim=claim) for file in named]

        async with self._turn:
            jobs = await asyncio.to_thread(judged)
            await asyncio.to_thread(self._queue.add, jobs)
        self._changed()
        self._report("queue_add", ", ".join(job.name for job in jobs), by)
        return {"added": [job.name for job in jobs], "waiting": len(self._queue.to_do())}

    async def move(self, job: str, where: str, other: str = "", by: str = "") -> Mapping[str, Any]:
        """Change the order."""
        async with self._turn:
            await asyncio.to_thread(self._queue.move, job, where, other)
        self._report("queue_move", " ".join(filter(None, (job, where, other))), by)
        return await self.list()

    async def remove(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Remove a waiting job; without a daemon also the job under way, which is set aside."""
        async with self._turn:
            await asyncio.to_thread(self._queue.remove, job, reason)
        self._report("queue_remove", ": ".join(filter(None, (job, reason))), by)
        return await self.list()

    async def remove_waiting(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Remove a waiting job."""
        async with self._turn:
            await asyncio.to_thread(self._queue.remove_waiting, job, reason)
        self._changed()
        self._report("queue_remove", ": ".join(filter(None, (job, reason))), by)
        return await self.list()

    def _report(self, order: str, reason: str, by: str) -> None:
        self._publish(CommandReceived(order=order, reason=reason, by=by))


def _job_file(given: Any) -> JobFile:
    match given:
        case {"path": str(path), "content": str(content), **more} if not more and Path(path).is_absolute():
            return JobFile(Path(path), content)
        case _:
            raise ConfigError('a job\'s file must be {"path": ..., "content": ...}, with an absolute path and the text')


# Parts that a shop gave to this cell. None begins before the shop confirms its claim.

BACK = "returned to the shop, where it was released"
LOST = "the shop gave the part to another cell because an operator removed this cell. polishd shop list shows by whom"
OFFER = {"recipe": str, "cell": str, "job": str, "of_cycle": int, "at_s": float, "rate": float, "sigma": float}
"""Fields of an offer and their types."""


class ShopAssignments:
    """Claims that the shop confirmed or withdrew in this run of the daemon. Use it on the event loop's thread."""

    def __init__(self, queue: Queue, changed: Callable[[], None]) -> None:
        """``changed`` is called where another part may begin now."""
        self._queue, self._changed = queue, changed
        self._stands: set[str] = set()
        self._lost: set[str] = set()
        self._received = asyncio.Event()

    def handlers(self, publish: Callable[[Event], None]) -> dict[str, Handler]:
        """Handlers of the shop's commands; ``publish`` is called with each offered rate."""

        async def offered(offers: Sequence[Any]) -> Mapping[str, Any]:
            for event in [_offer(one) for one in offers]:
                publish(event)
            return {"offers": len(offers)}

        return {"shop_assignments": self.update, "shop_rates": offered}

    async def update(
        self, stands: Sequence[Any] = (), back: Sequence[Any] = (), lost: Sequence[Any] = ()
    ) -> Mapping[str, Any]:
        """Apply the shop's report on these claims. Waiting jobs that this cell has lost leave the queue."""
        self._lost |= set(map(str, lost))
        self._stands = (self._stands | set(map(str, stands))) - self._lost
        for claims, why in ((back, BACK), (lost, LOST)):
            for claim in map(str, claims):
                await asyncio.to_thread(self._take_out, claim, why)
        self._received.set()
        self._changed()
        return {"waiting": len(self._queue.waiting())}

    def first(self) -> QueueEntry | None:
        """Return the first waiting job that may begin."""
        return self._queue.next(self.stands)

    def stands(self, entry: QueueEntry) -> bool:
        """Return whether the job has no claim, or the shop confirmed the claim."""
        return not entry.claim or entry.claim in self._stands

    async def settled(self, entry: QueueEntry | None) -> str:
        """Wait for the shop's report on the job under way. Return why it may not continue; empty where it may."""
        claim = "" if entry is None else entry.claim
        while claim and claim not in self._stands | self._lost:
            self._received.clear()
            await self._received.wait()
        return LOST if claim in self._lost else ""

    def facts(self) -> dict[str, str]:
        """Return, for ``status``, the jobs that wait for the shop's report; empty where none does."""
        waiting = [one.name for one in self._queue.to_do() if one.claim and one.claim not in self._stands | self._lost]
        if not waiting:
            return {}
        names = ", ".join(waiting)
        return {"shop": f"has not confirmed since this start: {names}. Check that polishd shop connect runs"}

    def _take_out(self, claim: str, why: str) -> None:
        entry = self._queue.of_claim(claim)
        if entry is not None and entry.state == "waiting":
            with suppress(ConfigError):  # it begins at the same moment: the next report shows that
                self._queue.remove_waiting(entry.name, why)


def _offer(given: Any) -> ShopRateReceived:
    """Return the event of an offer; ConfigError where its fields are wrong."""
    if not isinstance(given, dict) or {key: type(one) for key, one in given.items()} != OFFER:
        raise ConfigError(f"an offer must have the fields {', '.join(OFFER)}, as polishd shop connect sends them")
    return ShopRateReceived(**given)
