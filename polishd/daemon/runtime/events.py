"""The event bus: what happens is told to the log, to subscribers, and to the plugins, who cannot hold it up."""

from __future__ import annotations

import asyncio
import json
import logging
import queue
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import copy_context
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.exit_record import RECORD_NAME, EndCause, safety_sentence
from polishd.model.errors import PolishdError
from polishd.model.events import Event, StateChanged
from polishd.model.states import DaemonState
from polishd.util.files import write_atomic

log = logging.getLogger(__name__)

Sink = Callable[[Event], None]

SUBSCRIBER_EVENTS = 1000
"""A subscriber that is this far behind is dropped."""
DRAIN_S = 120.0
"""Longest that ``close`` waits for the plugins: a report with pictures takes a while."""


class EventBus:
    """Where events are published; ``publish`` returns at once. Use it on the event loop's thread.

    ``listeners`` (``hooks.on_event``, a person's terminal) hear of events in a thread of their own each, one after
    another, in order; ``sinks`` (such as ``journal.record_event``) are called on the spot.
    """

    def __init__(self, *listeners: Sink, sinks: tuple[Sink, ...] = ()) -> None:
        self._sinks = sinks
        self._subscribers: set[asyncio.Queue[Event | None]] = set()
        self._closed = False
        self._listeners = [_Listener(listener) for listener in listeners]

    def publish(self, event: Event) -> None:
        """Tell everybody. Only a sink's own error (a lost journal) is raised, after all have been told."""
        log.info("%s", event.name, extra={"event": event.facts()})
        for subscriber in tuple(self._subscribers):
            if subscriber.qsize() >= SUBSCRIBER_EVENTS:
                log.warning("a subscriber is %d events behind and was dropped", SUBSCRIBER_EVENTS)
                self._end(subscriber)
            else:
                subscriber.put_nowait(event)
        if not self._closed:
            for listener in self._listeners:
                listener.told.put(event)
        for sink in self._sinks:
            sink(event)

    @contextmanager
    def subscription(self) -> Iterator[AsyncIterator[Event]]:
        """Events from now on; the iterator ends when the bus closes, or when its reader falls far behind."""
        waiting: asyncio.Queue[Event | None] = asyncio.Queue()
        if self._closed:
            waiting.put_nowait(None)
        else:
            self._subscribers.add(waiting)
        try:
            yield _until_none(waiting)
        finally:
            self._subscribers.discard(waiting)

    async def close(self, within_s: float = DRAIN_S) -> None:
        """End the subscriptions and wait until the listeners have heard everything; idempotent."""
        for subscriber in tuple(self._subscribers):
            self._end(subscriber)
        if not self._closed:
            self._closed = True
            for listener in self._listeners:
                listener.told.put(None)
        async with asyncio.TaskGroup() as group:
            for listener in self._listeners:
                group.create_task(asyncio.to_thread(listener.end, within_s), name="listener ends")

    def _end(self, subscriber: asyncio.Queue[Event | None]) -> None:
        self._subscribers.discard(subscriber)
        while subscriber.qsize() >= SUBSCRIBER_EVENTS:
            subscriber.get_nowait()
        subscriber.put_nowait(None)


class _Listener:
    """Whoever may take its time over an event, and the thread in which it does."""

    def __init__(self, hear: Sink) -> None:
        self.told: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._hear = hear
        self._thread = threading.Thread(target=copy_context().run, args=(self._listen,), name="listener", daemon=True)
        self._thread.start()

    def end(self, within_s: float) -> None:
        """Wait until all is heard."""
        self._thread.join(within_s)
        if self._thread.is_alive():
            log.error("a plugin is still busy with an event after %g s; it is left behind", within_s)

    def _listen(self) -> None:
        while (event := self.told.get()) is not None:
            try:
                self._hear(event)
            except Exception:
                log.exception("telling the plugins of %s failed", event.name)


async def _until_none(waiting: asyncio.Queue[Event | None]) -> AsyncIterator[Event]:
    while (event := await waiting.get()) is not None:
        yield event


# What a person must know who finds a cell held, or its daemon gone.


def safety_of(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> StateChanged:
    """As an event; see ``stands``."""
    return StateChanged(state=state, reason=reason, standing=safety_sentence(state, unsafe, queue=queue))


def killed_safety(names: Iterable[str]) -> tuple[str, ...]:
    """What is known of those devices should the daemon be killed while it polishes."""
    return tuple(f"{name}: no daemon lived to ask it" for name in names)


def causes(journal: Journal, failure: Exception | None) -> tuple[EndCause, ...]:
    """All of this job, in time order, those of earlier runs of the daemon too; only ``failure`` of a lost journal."""
    found: list[EndCause] = []
    try:
        told = journal.errors()
    except PolishdError:  # its loss is, or follows, the failure
        return (EndCause(utc_now(), type(failure).__name__, str(failure), ended=True),) if failure else ()
    for at_s, name, data in told:
        cause = EndCause(_iso(at_s), str(data["kind"]), str(data["error"]), ended=name == "daemon_failed")
        if cause.ended and found and replace(found[-1], ended=True, at=cause.at) == cause:
            found[-1] = replace(found[-1], ended=True)  # held over it, and then stopped: one cause
        else:
            found.append(cause)
    return tuple(found)


def recording_exit(
    state_dir: Path, run_dir: Callable[[], Path | None], *, queue: bool = False
) -> Callable[[Event], None]:
    """A sink for the bus that keeps what each change of state says, for the case that the daemon is killed."""

    def keep(event: Event) -> None:
        if isinstance(event, StateChanged) and event.state != DaemonState.FINISHED:
            record_exit(state_dir, {**event.data, "run_dir": str(run_dir() or ""), "queue": queue})

    return keep


def record_exit(state_dir: Path, facts: Mapping[str, Any]) -> None:
    """Make it what ``last_ending`` tells; a disk that takes no more is logged, and keeps nobody from the end."""
    path = state_dir / RECORD_NAME
    try:
        write_atomic(path, json.dumps({**facts, "at": utc_now()}, indent=2).encode() + b"\n")
    except OSError:
        log.exception("%s cannot be written", path)
        with suppress(OSError):
            path.unlink()  # an older one would tell what is no longer so


def utc_now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")
