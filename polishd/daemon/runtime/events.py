"""Event bus: publish each event to the log, to subscribers and to plugins, none of which can block it."""

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
"""A subscriber with so many waiting events is dropped."""
DRAIN_S = 120.0
"""Longest time that ``close`` waits for the plugins: a report with pictures takes a while."""


class EventBus:
    """Publishes events; ``publish`` returns at once. Use it on the event loop's thread.

    Each of the ``listeners`` (``hooks.on_event``, a terminal) gets the events in order in its thread. ``sinks`` (such
    as ``journal.record_event``) are called directly.
    """

    def __init__(self, *listeners: Sink, sinks: tuple[Sink, ...] = ()) -> None:
        self._sinks = sinks
        self._subscribers: set[asyncio.Queue[Event | None]] = set()
        self._closed = False
        self._listeners = [_Listener(listener) for listener in listeners]

    def publish(self, event: Event) -> None:
        """Publish an event. Only the error of a sink (a lost journal) is raised, after all others have the event."""
        log.info("%s", event.name, extra={"event": event.facts()})
        for subscriber in tuple(self._subscribers):
            if subscriber.qsize() >= SUBSCRIBER_EVENTS:
                log.warning("a subscriber was dropped: %d events wait for it", SUBSCRIBER_EVENTS)
                self._end(subscriber)
            else:
                subscriber.put_nowait(event)
        if not self._closed:
            for listener in self._listeners:
                listener.events.put(event)
        for sink in self._sinks:
            sink(event)

    @contextmanager
    def subscription(self) -> Iterator[AsyncIterator[Event]]:
        """Yield an iterator of later events. It ends when the bus closes, or when its reader is too slow."""
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
        """End the subscriptions and wait until the listeners have processed all events; idempotent."""
        for subscriber in tuple(self._subscribers):
            self._end(subscriber)
        if not self._closed:
            self._closed = True
            for listener in self._listeners:
                listener.events.put(None)
        async with asyncio.TaskGroup() as group:
            for listener in self._listeners:
                group.create_task(asyncio.to_thread(listener.end, within_s), name="listener ends")

    def _end(self, subscriber: asyncio.Queue[Event | None]) -> None:
        self._subscribers.discard(subscriber)
        while subscriber.qsize() >= SUBSCRIBER_EVENTS:
            subscriber.get_nowait()
        subscriber.put_nowait(None)


class _Listener:
    """A function that may be slow, with its thread and its waiting events."""

    def __init__(self, function: Sink) -> None:
        self.events: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._function = function
        self._thread = threading.Thread(target=copy_context().run, args=(self._listen,), name="listener", daemon=True)
        self._thread.start()

    def end(self, within_s: float) -> None:
        """Wait until all events are processed."""
        self._thread.join(within_s)
        if self._thread.is_alive():
            log.error("a plugin still processes an event after %g s; the daemon does not wait for it", within_s)

    def _listen(self) -> None:
        while (event := self.events.get()) is not None:
            try:
                self._function(event)
            except Exception:
                log.exception("a plugin failed at the event %s", event.name)


async def _until_none(waiting: asyncio.Queue[Event | None]) -> AsyncIterator[Event]:
    while (event := await waiting.get()) is not None:
        yield event


# Records for the operator of a cell that is held, or whose daemon has ended.


def safety_of(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> StateChanged:
    """Return ``safety_sentence`` as an event."""
    return StateChanged(state=state, reason=reason, standing=safety_sentence(state, unsafe, queue=queue))


def killed_safety(names: Iterable[str]) -> tuple[str, ...]:
    """Return the unsafe devices for the record of a daemon that is killed while it polishes."""
    return tuple(f"{name}: state unknown, because the daemon was killed" for name in names)


def causes(journal: Journal, failure: Exception | None) -> tuple[EndCause, ...]:
    """Return all causes of this job in time order, also of earlier runs; of a lost journal only ``failure``."""
    found: list[EndCause] = []
    try:
        errors = journal.errors()
    except PolishdError:  # the loss of the journal is, or follows, the failure
        return (EndCause(utc_now(), type(failure).__name__, str(failure), ended=True),) if failure else ()
    for at_s, name, data in errors:
        cause = EndCause(_iso(at_s), str(data["kind"]), str(data["error"]), ended=name == "daemon_failed")
        if cause.ended and found and replace(found[-1], ended=True, at=cause.at) == cause:
            found[-1] = replace(found[-1], ended=True)  # held, then stopped, for one cause
        else:
            found.append(cause)
    return tuple(found)


def recording_exit(
    state_dir: Path, run_dir: Callable[[], Path | None], *, queue: bool = False
) -> Callable[[Event], None]:
    """Return a sink for the bus that records each change of state, for the case that the daemon is killed."""

    def keep(event: Event) -> None:
        if isinstance(event, StateChanged) and event.state != DaemonState.FINISHED:
            record_exit(state_dir, {**event.data, "run_dir": str(run_dir() or ""), "queue": queue})

    return keep


def record_exit(state_dir: Path, facts: Mapping[str, Any]) -> None:
    """Write the record for ``last_ending``. A disk that fails is logged and does not prevent the end."""
    path = state_dir / RECORD_NAME
    try:
        write_atomic(path, json.dumps({**facts, "at": utc_now()}, indent=2).encode() + b"\n")
    except OSError:
        log.exception("%s cannot be written", path)
        with suppress(OSError):
            path.unlink()  # an older record would be wrong


def utc_now() -> str:
    """Return the time in ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")
