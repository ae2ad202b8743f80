"""The queue's desk: what is asked of the queue, over the socket of a running daemon or, where none runs, by hand."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.job import JobFile
from polishd.daemon.job.resume_checks import file_terms
from polishd.daemon.queue.queue import NewJob, Queue, QueueEntry
from polishd.daemon.socket.server import Handler
from polishd.model.errors import ConfigError
from polishd.model.events import CommandReceived, Event, ShopRateReceived


def new_job(cell: CellConfig, file: JobFile) -> NewJob:
    """The job of a file, as the queue takes it; ConfigError where its values, or the files that it names, are wrong.

    Reads those files: in a daemon call it in a thread. Whether its program fits is judged by who adds it
    (``checking.check_jobs``), and again when it begins.
    """
    config = file.laid_over(cell)
    return NewJob(config.job.id, config.part.id, file, file_terms(config, file.names()))


def require_unchanged(cell: CellConfig, entry: QueueEntry) -> CellConfig:
    """The cell with that job laid over it; ConfigError where a file that it names is not what it was when it was added.

    It was judged with that content. Another one is another job: polishing with it would be nobody's decision.
    """
    config = entry.file.laid_over(cell)
    for key, now in file_terms(config, entry.file.names()).items():
        if now != (then := entry.files.get(key)):
            raise config.error(key, f"{_file(now)} was changed since the job was added ({_hash(then)}): add it again")
    return config


def _file(terms: Any) -> str:
    return ", ".join(map(_file, terms)) if isinstance(terms, list) else f"{terms['file']} ({_hash(terms)})"


def _hash(terms: Any) -> str:
    if isinstance(terms, list):
        return ", ".join(map(_hash, terms))
    return f"sha256 {terms['sha256'][:12]}" if terms else "without it"


class QueueRequests:
    """Answers for the queue of one cell, from threads: a tool may be in contact meanwhile, and disks are slow."""

    def __init__(
        self,
        cell: CellConfig,
        queue: Queue,
        changed: Callable[[], None] = lambda: None,
        tell: Callable[[Event], None] = lambda _: None,
    ) -> None:
        """``changed`` is called when something was added or taken out; ``tell`` is told who changed what."""
        self._cell, self._queue, self._changed, self._tell = cell, queue, changed, tell
        self._turn = asyncio.Lock()

    @property
    def handlers(self) -> dict[str, Handler]:
        """Who obeys the verbs of the socket."""
        return {"queue_list": self.list, "queue_add": self.add, "queue_move": self.move, "queue_remove": self.remove}

    async def list(self) -> Mapping[str, Any]:
        """All jobs."""

        def facts() -> Sequence[Mapping[str, Any]]:
            return [entry.facts() for entry in self._queue.entries()]

        return {"jobs": await asyncio.to_thread(facts)}

    async def add(self, files: Sequence[Any], by: str = "", claim: str = "") -> Mapping[str, Any]:
        """Put them at the end, all or none; ``claim``: the one by which a shop gave this part to the cell."""
        named = [_job_file(file) for file in files]
        if claim and len(named) != 1:
            raise ConfigError("a claim is of one job; name its file alone")

        def judged() -> Sequence[NewJob]:
            return [replace(new_job(self._cell, file), claim=claim) for file in named]

        async with self._turn:
            jobs = await asyncio.to_thread(judged)
            await asyncio.to_thread(self._queue.add, jobs)
        self._changed()
        self._told("queue_add", ", ".join(job.name for job in jobs), by)
        return {"added": [job.name for job in jobs], "waiting": len(self._queue.to_do())}

    async def move(self, job: str, where: str, other: str = "", by: str = "") -> Mapping[str, Any]:
        """Change the order."""
        async with self._turn:
            await asyncio.to_thread(self._queue.move, job, where, other)
        self._told("queue_move", " ".join(filter(None, (job, where, other))), by)
        return await self.list()

    async def remove(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Take one out that waits; where no daemon works the queue the one under way, too, which is set aside."""
        async with self._turn:
            await asyncio.to_thread(self._queue.remove, job, reason)
        self._told("queue_remove", ": ".join(filter(None, (job, reason))), by)
        return await self.list()

    async def remove_waiting(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Take one out that waits."""
        async with self._turn:
            await asyncio.to_thread(self._queue.remove_waiting, job, reason)
        self._changed()
        self._told("queue_remove", ": ".join(filter(None, (job, reason))), by)
        return await self.list()

    def _told(self, order: str, reason: str, by: str) -> None:
        self._tell(CommandReceived(order=order, reason=reason, by=by))


def _job_file(given: Any) -> JobFile:
    match given:
        case {"path": str(path), "content": str(content), **more} if not more and Path(path).is_absolute():
            return JobFile(Path(path), content)
        case _:
            raise ConfigError('a job\'s file is {"path": ..., "content": ...}: its absolute path, and its text')


# Parts that a shop gave to this cell, and what it says of them: none begins before the shop has said that it may.

BACK = "given back to the shop, where it was released"
LOST = "the shop gave it away, as somebody said that this cell is gone; polishd shop list says who"
OFFER = {"recipe": str, "cell": str, "job": str, "of_cycle": int, "at_s": float, "rate": float, "sigma": float}
"""What an offer is made of."""


class ShopAssignments:
    """What was heard in this run of the daemon; used on the event loop's thread."""

    def __init__(self, queue: Queue, changed: Callable[[], None]) -> None:
        """``changed`` is called where another part may begin now."""
        self._queue, self._changed = queue, changed
        self._stands: set[str] = set()
        self._lost: set[str] = set()
        self._heard = asyncio.Event()

    def handlers(self, tell: Callable[[Event], None]) -> dict[str, Handler]:
        """Who obeys the verbs of the shop's link; ``tell`` is told what is offered."""

        async def offered(offers: Sequence[Any]) -> Mapping[str, Any]:
            for event in [_offer(one) for one in offers]:
                tell(event)
            return {"offers": len(offers)}

        return {"shop_assignments": self.told, "shop_rates": offered}

    async def told(
        self, stands: Sequence[Any] = (), back: Sequence[Any] = (), lost: Sequence[Any] = ()
    ) -> Mapping[str, Any]:
        """The shop's word on these claims. What waits and is not this cell's any more is taken out of the queue."""
        self._lost |= set(map(str, lost))
        self._stands = (self._stands | set(map(str, stands))) - self._lost
        for claims, why in ((back, BACK), (lost, LOST)):
            for claim in map(str, claims):
                await asyncio.to_thread(self._take_out, claim, why)
        self._heard.set()
        self._changed()
        return {"waiting": len(self._queue.waiting())}

    def first(self) -> QueueEntry | None:
        """The first that waits and may begin."""
        return self._queue.next(self.stands)

    def stands(self, entry: QueueEntry) -> bool:
        """Whether no shop gave its part, or the shop has said that the part is this cell's."""
        return not entry.claim or entry.claim in self._stands

    async def settled(self, entry: QueueEntry | None) -> str:
        """Why the job under way may not go on, once that is known; empty where it may."""
        claim = "" if entry is None else entry.claim
        while claim and claim not in self._stands | self._lost:
            self._heard.clear()
            await self._heard.wait()
        return LOST if claim in self._lost else ""

    def facts(self) -> dict[str, str]:
        """For ``status``: what waits for the shop's word; empty where nothing does."""
        unheard = [one.name for one in self._queue.to_do() if one.claim and one.claim not in self._stands | self._lost]
        if not unheard:
            return {}
        said = (
            f"it has not said since this start that these are ours: {', '.join(unheard)}; is polishd shop connect up?"
        )
        return {"shop": said}

    def _take_out(self, claim: str, why: str) -> None:
        entry = self._queue.of_claim(claim)
        if entry is not None and entry.state == "waiting":
            with suppress(ConfigError):  # it begins in the same moment: the next report says so
                self._queue.remove_waiting(entry.name, why)


def _offer(given: Any) -> ShopRateReceived:
    """ConfigError where it is none."""
    if not isinstance(given, dict) or {key: type(one) for key, one in given.items()} != OFFER:
        raise ConfigError(f"an offer has {', '.join(OFFER)}, as polishd shop connect sends them")
    return ShopRateReceived(**given)
