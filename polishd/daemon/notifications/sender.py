"""Sends what one notifier has to send, in threads of its own: only the daemon's end waits for it, and not for long."""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextvars import copy_context
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from polishd.model.events import NotificationFailed
from polishd.model.notification import Notification
from polishd.model.states import Severity
from polishd.util.files import write_atomic

# What waits to be sent by one notifier, what is only counted, and when it is tried again.

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 900.0
"""After each failure the pause is twice as long, up to this."""
KEPT_S = 7 * 86400.0
"""What could not be sent for so long is given up."""
MOST_WAITING = 100
MOST_THINGS = 12
"""More things than this within ``remind_after_s`` are one thing, by severity."""


@dataclass(slots=True)
class _Told:
    """A thing that was told, and how often it happened again since."""

    began_s: float
    again: Notification | None = None


@dataclass(slots=True)
class NotificationQueue:
    """All that one notifier has to do."""

    remind_after_s: float
    """What happens again within that time is counted."""
    waiting: list[Notification] = field(default_factory=list)
    _told: dict[str, _Told] = field(default_factory=dict)
    _failures: int = 0
    """In a row."""
    _failed_s: float = 0.0
    _tries: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, facts: Mapping[str, Any], remind_after_s: float) -> Self:
        """As ``facts`` was kept; KeyError, TypeError or ValueError where it is something else."""
        told = {
            thing: _Told(float(one["began_s"]), _notification(one["again"]) if one["again"] else None)
            for thing, one in facts["told"].items()
        }
        return cls(remind_after_s, [_notification(one) for one in facts["waiting"]], told)

    def facts(self) -> dict[str, Any]:
        """What a later run needs, JSON-ready."""
        told = {
            thing: {"began_s": one.began_s, "again": asdict(one.again) if one.again else None}
            for thing, one in self._told.items()
        }
        return {"waiting": [asdict(one) for one in self.waiting], "told": told}

    def add(self, notification: Notification, now_s: float) -> None:
        """It waits to be sent; what was told a while ago is counted."""
        self.release(now_s)
        thing = notification.thing
        if thing not in self._told and len(self._told) >= MOST_THINGS:
            thing = f"{notification.severity} others"
        if (told := self._told.get(thing)) is not None:
            told.again = notification.again(told.again)
            return
        self.waiting.append(notification)
        if self.remind_after_s > 0:
            self._told[thing] = _Told(now_s)

    def release(self, now_s: float) -> None:
        """What was counted long enough waits to be sent."""
        for thing, told in list(self._told.items()):
            if _left_s(told.began_s, self.remind_after_s, now_s):
                continue
            if told.again is None:
                del self._told[thing]
            else:
                self.waiting.append(told.again)
                self._told[thing] = _Told(now_s)

    def due(self, now_s: float) -> Notification | None:
        """What to send now: what was tried least, of those the most severe, and the oldest."""
        if not self.waiting or _left_s(self._failed_s, self._pause_s(), now_s):
            return None
        return min(self.waiting, key=lambda one: (self._tries[one.id], -one.severity.rank, one.at))

    def sent(self, notification: Notification) -> None:
        """It needs nothing more."""
        self._drop(notification)
        self._failures = 0

    def failed(self, notification: Notification, now_s: float) -> None:
        """It is tried again, after a pause and after the others; unless it was given up meanwhile."""
        self._tries[notification.id] += 1
        self._failures += 1
        self._failed_s = now_s

    def hurry(self) -> None:
        """No pause: this is the end."""
        self._failures = 0

    def give_up(self, now_s: float) -> list[Notification]:
        """What is too old, or too many of the least severe and oldest; it waits no longer."""
        old = [one for one in self.waiting if now_s - _at_s(one) > KEPT_S]
        left = sorted((one for one in self.waiting if one not in old), key=lambda one: (one.severity.rank, one.at))
        lost = old + left[: max(len(left) - MOST_WAITING, 0)]
        for one in lost:
            self._drop(one)
        return lost

    def idle_s(self, now_s: float) -> float:
        """How long there is nothing to do; a minute at most, since clocks jump."""
        until = [60.0]
        if self.waiting:
            until.append(_left_s(self._failed_s, self._pause_s(), now_s))
        until += [_left_s(told.began_s, self.remind_after_s, now_s) for told in self._told.values()]
        return min(until)

    def _pause_s(self) -> float:
        return min(FIRST_PAUSE_S * 2 ** (self._failures - 1), LONGEST_PAUSE_S) if self._failures else 0.0

    def _drop(self, notification: Notification) -> None:
        self.waiting = [one for one in self.waiting if one.id != notification.id]
        del self._tries[notification.id]


def _left_s(began_s: float, span_s: float, now_s: float) -> float:
    """What is left of a span; nothing where the clock says that it has not begun."""
    return began_s + span_s - now_s if 0 <= now_s - began_s < span_s else 0.0


def _at_s(notification: Notification) -> float:
    return datetime.fromisoformat(notification.at).timestamp()


def _notification(facts: Mapping[str, Any]) -> Notification:
    return Notification(**{**facts, "severity": Severity(facts["severity"])})


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
    remind_after_s: float
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
        self._outbox = NotificationQueue(notifier.remind_after_s)
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
        self._outbox, self._kept = read_outbox(self._path, self.notifier.remind_after_s)
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


def read_outbox(path: Path, remind_after_s: float) -> tuple[NotificationQueue, bytes]:
    """What an earlier run left, and the file's content; an empty one where there is none, or none that can be read."""
    try:
        content = path.read_bytes()
        return NotificationQueue.of(json.loads(content), remind_after_s), content
    except FileNotFoundError:
        return NotificationQueue(remind_after_s), b""
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        log.error("%s cannot be read, and what waited in it is not sent: %s", path, error)
        return NotificationQueue(remind_after_s), b""
