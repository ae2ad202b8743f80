"""Turn events that need an operator into notifications, and queue them for each notifier."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any
from uuid import uuid4

from polishd.config.cell import CellConfig
from polishd.daemon.notifications.sender import Attempt, NotificationSender, Notifier, outbox_path, read_outbox
from polishd.daemon.runtime.events import EventBus, Sink, utc_now
from polishd.daemon.runtime.exit_record import for_cell
from polishd.model.errors import PolishdError
from polishd.model.events import Event, NotificationFailed
from polishd.model.notification import Notification
from polishd.model.states import OperatorNotice, Severity

log = logging.getLogger(__name__)

END_S = 10.0
"""Longest time that the daemon's end waits for the last notifications. Those not sent wait for the next start."""
SEND_TO_THE_END_S = 8.0
"""Part of that time for sending."""
EVENT_FIELDS = {"job": "job", "part": "part_id", "run_dir": "run_dir"}
"""Fields of a notification about the job, with their names in events."""


class Notifications:
    """Notifications of a cell to its configured notifiers. ``on_event`` is a listener of the event bus."""

    def __init__(self, config: CellConfig, known: Mapping[str, str]) -> None:
        self._config = config
        self._known = dict(known)
        """``job``, ``part`` and ``run_dir`` of the current job, updated by events that have them."""
        self._senders: tuple[NotificationSender, ...] = ()

    def start(self, notifiers: Sequence[Notifier], publish: Callable[[Event], None]) -> None:
        """Start the senders, with the notifications of an earlier run first. They call ``publish`` on a failure."""

        def failed(event: NotificationFailed) -> None:
            self._queue(event)  # not over the bus, which may be closed already
            publish(event)

        self._senders = tuple(NotificationSender(notifier, self._config.state_dir, failed) for notifier in notifiers)
        for sender in self._senders:
            sender.start()
        ours = {outbox_path(self._config.state_dir, notifier.name) for notifier in notifiers}
        for path in sorted(set(outbox_path(self._config.state_dir, "").parent.glob("*.json")) - ours):
            if left := len(read_outbox(path, 0.0)[0].waiting):
                log.warning("%s: %d notifications wait for a notifier that is not in the config any more", path, left)

    def on_event(self, event: Event) -> None:
        """Queue the event for the senders where it needs an operator."""
        if self._senders and not isinstance(event, NotificationFailed):
            self._queue(event)

    def _queue(self, event: Event) -> None:
        data = event.data
        self._known |= {key: data[name] for key, name in EVENT_FIELDS.items() if name in data}
        concern = event.concern()
        if concern is None:
            return
        notification = _notification(event.name, event.cycle, concern, self._config, self._known)
        for sender in self._senders:
            if not (isinstance(event, NotificationFailed) and event.notifier == sender.notifier.name):
                sender.take(notification)

    async def close(self) -> None:
        """Send the waiting notifications, or store them, within ``END_S`` seconds. No event may follow."""
        began_s = time.monotonic()
        for sender in self._senders:
            sender.end(began_s + SEND_TO_THE_END_S)
        for sender in self._senders:
            await asyncio.to_thread(sender.join, began_s + END_S - time.monotonic())


@asynccontextmanager
async def notifying(
    config: CellConfig,
    notifiers: Sequence[Notifier],
    known: Mapping[str, str],
    listeners: Sequence[Sink],
    sinks: Sequence[Sink],
) -> AsyncIterator[EventBus]:
    """Yield an event bus with these listeners and sinks, and the notifications. All events are delivered at its end."""
    notifications = Notifications(config, known)
    bus = EventBus(*listeners, notifications.on_event, sinks=tuple(sinks))
    notifications.start(notifiers, _publish_from_threads(bus))
    try:
        yield bus
    finally:
        await bus.close()
        await notifications.close()


def _publish_from_threads(bus: EventBus) -> Sink:
    """Return a function that other threads call to publish an event."""
    loop = asyncio.get_running_loop()

    def publish(event: Event) -> None:
        with suppress(PolishdError):  # a lost journal ends the daemon anyway
            bus.publish(event)

    def call(event: Event) -> None:
        try:
            loop.call_soon_threadsafe(publish, event)
        except RuntimeError:  # the thread outlived the event loop
            log.warning("the event bus is closed; not published: %s", event.facts())

    return call


def try_out(config: CellConfig, notifiers: Sequence[Notifier]) -> list[dict[str, Any]]:
    """Send a test through each notifier in parallel.

    Return for each ``notifier``, ``type``, ``severity``, ``error`` and ``waiting``.
    """
    concern = OperatorNotice(Severity.INFO, "this is a test by polishd notify", "unchanged", "nothing")
    known = {"job": config.job.id, "part": config.part.id, "run_dir": ""}
    test = _notification("test", None, concern, config, known)
    attempts = [Attempt(notifier, test, lambda _: None) for notifier in notifiers]
    return [
        {
            "notifier": notifier.name,
            "type": notifier.type,
            "severity": notifier.least.value,
            "error": attempt.wait(),
            "waiting": len(
                read_outbox(outbox_path(config.state_dir, notifier.name), notifier.remind_after_s)[0].waiting
            ),
        }
        for notifier, attempt in zip(notifiers, attempts, strict=True)
    ]


def _notification(
    event: str, cycle: int | None, concern: OperatorNotice, config: CellConfig, known: Mapping[str, Any]
) -> Notification:
    """Return the notification of a notice; ``known`` has ``job``, ``part`` and ``run_dir``."""
    return Notification(
        id=uuid4().hex,
        event=event,
        severity=concern.severity,
        what=for_cell(concern.what, config.path),
        now=for_cell(concern.now, config.path),
        todo=for_cell(concern.todo, config.path),
        cell=config.cell.name,
        cycle=cycle,
        at=utc_now(),
        **known,
    )
