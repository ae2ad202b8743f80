"""Sends what one notifier has to send, in threads of its own: only the daemon's end waits for it, and not for long."""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
from collections.abc import Callable
from contextvars import copy_context
from dataclasses import dataclass
from pathlib import Path

from polishd.daemon.outbox import NotificationQueue
from polishd.files import write_atomic
from polishd.model.concern import Severity
from polishd.model.events import NotificationFailed
from polishd.model.notification import Notification

log = logging.getLogger(__name__)

SEND_S = 60.0
"""Whoever takes longer to send is taken for hung; nothing else is sent through it until it comes back."""
HUNG = f"it has not come back for {SEND_S:g} s"


@dataclass(frozen=True, slots=True)
class Notifier:
    """A way to reach a person, as the config wants it."""

    name: str
    type: str
    least: Severity
    repeat_s: float
    send: Callable[[Notification], None]


class Attempt:
    """One call of a plugin, which may raise anything, or never come back."""

    def __init__(self, notifier: Notifier, notification: Notification, done: Callable[[Attempt], None]) -> None:
        self.notification = notification
        self.error = ""
        """Why it was not sent; empty where it was."""
        self.overdue = False
        """It was told to have failed already."""
        self.began_s = time.monotonic()
        self._send = notifier.send
        self._done = done
        self._thread = threading.Thread(
            target=copy_context().run, args=(self._run,), name=f"notify {notifier.name}", daemon=True
        )
        self._thread.start()

    def left_s(self) -> float:
        """Until it is taken for hung."""
        return max(self.began_s + SEND_S - time.monotonic(), 0.0)

    def wait(self) -> str:
        """Until it comes back, or is taken for hung: why it was not sent."""
        self._thread.join(self.left_s())
        return HUNG if self._thread.is_alive() else self.error

    def _run(self) -> None:
        try:
            self._send(self.notification)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - it is told, as an event
            self.error = " ".join(f"{type(error).__name__}: {error}".split())
        self._done(self)


@dataclass(frozen=True, slots=True)
class _End:
    """The daemon ends: what waits is tried once more until then, of the monotonic clock."""

    until_s: float


class NotificationSender:
    """Takes notifications, sends them or keeps them in ``state_dir/notify/NAME.json``.

    ``tell`` is called, in the courier's thread, when nothing can be sent any more, and when some is given up.
    """

    def __init__(self, notifier: Notifier, state_dir: Path, tell: Callable[[NotificationFailed], None]) -> None:
        self.notifier = notifier
        self._path = outbox_path(state_dir, notifier.name)
        self._tell = tell
        self._inbox: queue.SimpleQueue[Notification | Attempt | _End] = queue.SimpleQueue()
        self._outbox = NotificationQueue(notifier.repeat_s)
        self._attempt: Attempt | None = None
        self._failing = False
        self._end: _End | None = None
        self._last_failed = False
        """The last chance is used."""
        self._kept = b""
        self._thread = threading.Thread(
            target=copy_context().run, args=(self._work,), name=f"courier {notifier.name}", daemon=True
        )

    def start(self) -> None:
        """Begin with what an earlier run left."""
        self._thread.start()

    def take(self, notification: Notification) -> None:
        """Send it, in time."""
        if notification.severity.rank >= self.notifier.least.rank:
            self._inbox.put(notification)

    def end(self, until_s: float) -> None:
        """Try once more what waits, until then (``time.monotonic``); the rest is kept for the next start."""
        self._inbox.put(_End(until_s))

    def join(self, within_s: float) -> None:
        """Wait for its end."""
        self._thread.join(max(within_s, 0.0))
        if self._thread.is_alive():
            log.error("the courier of %r is left behind: its disk is slow", self.notifier.name)

    def _work(self) -> None:
        try:
            self._until_over()
        except Exception:
            log.exception("the courier of %r is gone: nobody is told by it until the next start", self.notifier.name)

    def _until_over(self) -> None:
        self._outbox, self._kept = read_outbox(self._path, self.notifier.repeat_s)
        while not self._over():
            now_s = time.time()
            self._outbox.release(now_s)
            self._give_up(now_s)
            self._begin(now_s)
            self._keep()
            try:
                item = self._inbox.get(timeout=self._idle_s(now_s))
            except queue.Empty:
                self._notice_overdue()
                continue
            self._heed(item)
        self._keep()
        if left := len(self._outbox.waiting):
            log.error("%r: what waits for the next start: %d, in %s", self.notifier.name, left, self._path)

    def _heed(self, item: Notification | Attempt | _End) -> None:
        match item:
            case Notification():
                self._outbox.add(item, time.time())
            case Attempt():
                self._settle(item)
            case _End():
                self._end = item
                self._outbox.hurry()

    def _over(self) -> bool:
        """At the end each notifier has one more chance, and no second one."""
        if self._end is None:
            return False
        busy = self._attempt is not None and not self._attempt.overdue
        left = self._attempt is None and self._outbox.waiting and not self._last_failed
        return not (busy or left) or time.monotonic() >= self._end.until_s

    def _idle_s(self, now_s: float) -> float:
        if self._attempt is None:
            wait_s = self._outbox.idle_s(now_s)
        else:
            wait_s = SEND_S if self._attempt.overdue else self._attempt.left_s()
        return wait_s if self._end is None else max(min(wait_s, self._end.until_s - time.monotonic()), 0.0)

    def _begin(self, now_s: float) -> None:
        if self._attempt is None and (due := self._outbox.due(now_s)) is not None:
            self._attempt = Attempt(self.notifier, due, self._inbox.put)

    def _settle(self, attempt: Attempt) -> None:
        self._attempt = None
        if not attempt.error:
            self._outbox.sent(attempt.notification)
            self._failing = self._failing and bool(self._outbox.waiting)
            log.info("%r was told: %s", self.notifier.name, attempt.notification.title)
        else:
            self._failed(attempt.notification, attempt.error)

    def _notice_overdue(self) -> None:
        attempt = self._attempt
        if attempt is not None and not attempt.overdue and not attempt.left_s():
            attempt.overdue = True
            self._failed(attempt.notification, HUNG)

    def _failed(self, notification: Notification, error: str) -> None:
        self._outbox.failed(notification, time.time())
        self._last_failed = self._end is not None
        log.warning("%r failed: %s", self.notifier.name, error)
        if not self._failing:
            self._failing = True
            self._say(error)

    def _give_up(self, now_s: float) -> None:
        lost = self._outbox.give_up(now_s)
        for notification in lost:
            log.error("%r was never told: %s", self.notifier.name, notification.text)
        if lost:
            self._say("what waits is too old, or too much", len(lost))

    def _say(self, error: str, given_up: int = 0) -> None:
        name, waiting = self.notifier.name, len(self._outbox.waiting)
        self._tell(NotificationFailed(notifier=name, error=error, waiting=waiting, given_up=given_up))

    def _keep(self) -> None:
        content = json.dumps(self._outbox.facts(), indent=1).encode()
        if content == self._kept:
            return
        try:
            self._path.parent.mkdir(exist_ok=True)
            write_atomic(self._path, content)
            self._kept = content
        except OSError as error:
            log.error("%s cannot be written: %s; a killed daemon would forget what waits", self._path, error)


def outbox_path(state_dir: Path, name: str) -> Path:
    """The file of what a notifier has to send."""
    return state_dir / "notify" / f"{name}.json"


def read_outbox(path: Path, repeat_s: float) -> tuple[NotificationQueue, bytes]:
    """What an earlier run left, and the file's content; an empty one where there is none, or none that can be read."""
    try:
        content = path.read_bytes()
        return NotificationQueue.of(json.loads(content), repeat_s), content
    except FileNotFoundError:
        return NotificationQueue(repeat_s), b""
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        log.error("%s cannot be read, and what waited in it is not sent: %s", path, error)
        return NotificationQueue(repeat_s), b""
