"""The event bus: what happens is told to the log, to subscribers, and to the plugins, who cannot hold it up."""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from contextvars import copy_context

from polishd.model.events import Event

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
