"""Somebody hears of it: events that concern a person become notifications, and each notifier's courier takes them."""

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
"""Longest that the daemon's end waits until the last notifications are sent; what is not is kept for the next start."""
SEND_TO_THE_END_S = 8.0
"""Of that, for sending."""
SAID = {"job": "job", "part": "part_id", "run_dir": "run_dir"}
"""What is told of the job under way, and how events call it."""


class Notifications:
    """Tells whomever a cell's config names; ``hear`` is a listener of the event bus."""

    def __init__(self, config: CellConfig, known: Mapping[str, str]) -> None:
        self._config = config
        self._known = dict(known)
        """Of the job under way: ``job``, ``part`` and ``run_dir``. Events that say one of them say it anew."""
        self._couriers: tuple[NotificationSender, ...] = ()

    def start(self, notifiers: Sequence[Notifier], tell: Callable[[Event], None]) -> None:
        """Begin to send, what an earlier run left first; ``tell`` is called by other threads when that fails."""

        def failed(event: NotificationFailed) -> None:
            self._hand(event)  # and not by way of the bus, which may be closed already
            tell(event)

        self._couriers = tuple(NotificationSender(notifier, self._config.state_dir, failed) for notifier in notifiers)
        for courier in self._couriers:
            courier.start()
        ours = {outbox_path(self._config.state_dir, notifier.name) for notifier in notifiers}
        for path in sorted(set(outbox_path(self._config.state_dir, "").parent.glob("*.json")) - ours):
            if left := len(read_outbox(path, 0.0)[0].waiting):
                log.warning("%s: %d wait in it for a notifier that the config does not name any more", path, left)

    def hear(self, event: Event) -> None:
        """Hand it to the couriers where it concerns a person."""
        if self._couriers and not isinstance(event, NotificationFailed):
            self._hand(event)

    def _hand(self, event: Event) -> None:
        data = event.data
        self._known |= {key: data[said] for key, said in SAID.items() if said in data}
        concern = event.concern()
        if concern is None:
            return
        notification = _notification(event.name, event.cycle, concern, self._config, self._known)
        for courier in self._couriers:
            if not (isinstance(event, NotificationFailed) and event.notifier == courier.notifier.name):
                courier.take(notification)

    async def close(self) -> None:
        """Send what waits, or keep it: within ``END_S`` seconds. Nothing may be heard after it."""
        began_s = time.monotonic()
        for courier in self._couriers:
            courier.end(began_s + SEND_TO_THE_END_S)
        for courier in self._couriers:
            await asyncio.to_thread(courier.join, began_s + END_S - time.monotonic())


@asynccontextmanager
async def notifying(
    config: CellConfig,
    notifiers: Sequence[Notifier],
    known: Mapping[str, str],
    listeners: Sequence[Sink],
    sinks: Sequence[Sink],
) -> AsyncIterator[EventBus]:
    """An event bus of these listeners and sinks, and of people; at its end all have heard everything, within limits."""
    people = Notifications(config, known)
    bus = EventBus(*listeners, people.hear, sinks=tuple(sinks))
    people.start(notifiers, _publishing(bus))
    try:
        yield bus
    finally:
        await bus.close()
        await people.close()


def _publishing(bus: EventBus) -> Sink:
    """For threads that have something to tell."""
    loop = asyncio.get_running_loop()

    def publish(event: Event) -> None:
        with suppress(PolishdError):  # a lost journal: that is what ends the daemon
            bus.publish(event)

    def tell(event: Event) -> None:
        try:
            loop.call_soon_threadsafe(publish, event)
        except RuntimeError:  # who tells was left behind, and the loop is closed
            log.warning("nobody hears any more of: %s", event.facts())

    return tell


def try_out(config: CellConfig, notifiers: Sequence[Notifier]) -> list[dict[str, Any]]:
    """Send a test through each notifier, side by side; how it went: ``notifier``, ``type``, ``error``, ``waiting``."""
    concern = OperatorNotice(Severity.INFO, "this is a test: somebody called polishd notify", "as it was", "nothing")
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
    """A concern in the words of a person who is not there; ``known`` has ``job``, ``part`` and ``run_dir``."""
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
