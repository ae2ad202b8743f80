"""Sender of one notifier's notifications, in threads. Only the daemon's end waits for it, within a time limit."""

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

# Queue of one notifier: waiting notifications, counted repetitions, and pauses after a failure.

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 900.0
"""The pause doubles after each failure, up to this."""
KEPT_S = 7 * 86400.0
"""A notification that could not be sent for so long is discarded."""
MOST_WAITING = 100
MOST_THINGS = 12
"""Where there are more different things within ``remind_after_s``, they count as one by severity."""


@dataclass(slots=True)
class _Recent:
    """A recent notification, and the count of its repetitions since."""

    began_s: float
    again: Notification | None = None


@dataclass(slots=True)
class NotificationQueue:
    """Notifications of one notifier."""

    remind_after_s: float
    """A repetition within this time is counted, not sent."""
    waiting: list[Notification] = field(default_factory=list)
    _recent: dict[str, _Recent] = field(default_factory=dict)
    _failures: int = 0
    """Number of failures in a row."""
    _failed_s: float = 0.0
    _tries: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, facts: Mapping[str, Any], remind_after_s: float) -> Self:
        """Load stored ``facts``; KeyError, TypeError or ValueError where they are invalid."""
        recent = {
            thing: _Recent(float(one["began_s"]), _notification(one["again"]) if one["again"] else None)
            for thing, one in facts.get("recent", {}).items()
        }
        return cls(remind_after_s, [_notification(one) for one in facts["waiting"]], recent)

    def facts(self) -> dict[str, Any]:
        """Return the state for a later run, JSON-ready."""
        recent = {
            thing: {"began_s": one.began_s, "again": asdict(one.again) if one.again else None}
            for thing, one in self._recent.items()
        }
        return {"waiting": [asdict(one) for one in self.waiting], "recent": recent}

    def add(self, notification: Notification, now_s: float) -> None:
        """Queue a notification; count it where the same one is recent."""
        self.release(now_s)
        thing = notification.thing
        if thing not in self._recent and len(self._recent) >= MOST_THINGS:
            thing = f"{notification.severity} others"
        if (recent := self._recent.get(thing)) is not None:
            recent.again = notification.again(recent.again)
            return
        self.waiting.append(notification)
        if self.remind_after_s > 0:
            self._recent[thing] = _Recent(now_s)

    def release(self, now_s: float) -> None:
        """Queue the counted repetitions whose ``remind_after_s`` is over."""
        for thing, recent in list(self._recent.items()):
            if _left_s(recent.began_s, self.remind_after_s, now_s):
                continue
            if recent.again is None:
                del self._recent[thing]
            else:
                self.waiting.append(recent.again)
                self._recent[thing] = _Recent(now_s)

    def due(self, now_s: float) -> Notification | None:
        """Return the next notification: the one with fewest attempts, then the most severe, then the oldest."""
        if not self.waiting or _left_s(self._failed_s, self._pause_s(), now_s):
            return None
        return min(self.waiting, key=lambda one: (self._tries[one.id], -one.severity.rank, one.at))

    def sent(self, notification: Notification) -> None:
        """Remove a sent notification."""
        self._drop(notification)
        self._failures = 0

    def failed(self, notification: Notification, now_s: float) -> None:
        """Try a notification again, after a pause and after the others, unless it is discarded meanwhile."""
        self._tries[notification.id] += 1
        self._failures += 1
        self._failed_s = now_s

    def hurry(self) -> None:
        """End the pause: the daemon ends."""
        self._failures = 0

    def give_up(self, now_s: float) -> list[Notification]:
        """Discard and return notifications that are too old, or too many (the least severe and oldest first)."""
        old = [one for one in self.waiting if now_s - _at_s(one) > KEPT_S]
        left = sorted((one for one in self.waiting if one not in old), key=lambda one: (one.severity.rank, one.at))
        lost = old + left[: max(len(left) - MOST_WAITING, 0)]
        for one in lost:
            self._drop(one)
        return lost

    def idle_s(self, now_s: float) -> float:
        """Return the time until there is something to do; at most a minute, because clocks may be set."""
        until = [60.0]
        if self.waiting:
            until.append(_left_s(self._failed_s, self._pause_s(), now_s))
        until += [_left_s(recent.began_s, self.remind_after_s, now_s) for recent in self._recent.values()]
        return min(until)

    def _pause_s(self) -> float:
        return min(FIRST_PAUSE_S * 2 ** (self._failures - 1), LONGEST_PAUSE_S) if self._failures else 0.0

    def _drop(self, notification: Notification) -> None:
        self.waiting = [one for one in self.waiting if one.id != notification.id]
        del self._tries[notification.id]


def _left_s(began_s: float, span_s: float, now_s: float) -> float:
    """Return the rest of a time span; 0 where the clock was set back before its begin."""
    return began_s + span_s - now_s if 0 <= now_s - began_s < span_s else 0.0


def _at_s(notification: Notification) -> float:
    return datetime.fromisoformat(notification.at).timestamp()


def _notification(facts: Mapping[str, Any]) -> Notification:
    return Notification(**{**facts, "severity": Severity(facts["severity"])})


log = logging.getLogger(__name__)

SEND_S = 60.0
"""Time limit of a notifier's call. Until an overdue call returns, nothing else is sent through the notifier."""
HUNG = f"no return within {SEND_S:g} s"


@dataclass(frozen=True, slots=True)
class Notifier:
    """A configured way to notify people."""

    name: str
    type: str
    least: Severity
    remind_after_s: float
    send: Callable[[Notification], None]


class Attempt:
    """One call of a plugin, which may raise any exception, or never return."""

    def __init__(self, notifier: Notifier, notification: Notification, done: Callable[[Attempt], None]) -> None:
        self.notification = notification
        self.error = ""
        """Why it was not sent; empty where it was."""
        self.overdue = False
        """It exceeded the time limit and was reported as failed."""
        self.began_s = time.monotonic()
        self._send = notifier.send
        self._done = done
        self._thread = threading.Thread(
            target=copy_context().run, args=(self._run,), name=f"notify {notifier.name}", daemon=True
        )
        self._thread.start()

    def left_s(self) -> float:
        """Return the time until it is overdue."""
        return max(self.began_s + SEND_S - time.monotonic(), 0.0)

    def wait(self) -> str:
        """Wait until it returns or is overdue; return why it was not sent."""
        self._thread.join(self.left_s())
        return HUNG if self._thread.is_alive() else self.error

    def _run(self) -> None:
        try:
            self._send(self.notification)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - reported as an event
            self.error = " ".join(f"{type(error).__name__}: {error}".split())
        self._done(self)


@dataclass(frozen=True, slots=True)
class _End:
    """The daemon ends: waiting notifications have one more attempt until this time of the monotonic clock."""

    until_s: float


class NotificationSender:
    """Sends notifications, or stores them in ``state_dir/notify/NAME.json``.

    ``report`` is called in the sender's thread when sending begins to fail, and when notifications are discarded.
    """

    def __init__(self, notifier: Notifier, state_dir: Path, report: Callable[[NotificationFailed], None]) -> None:
        self.notifier = notifier
        self._path = outbox_path(state_dir, notifier.name)
        self._report = report
        self._inbox: queue.SimpleQueue[Notification | Attempt | _End] = queue.SimpleQueue()
        self._outbox = NotificationQueue(notifier.remind_after_s)
        self._attempt: Attempt | None = None
        self._failing = False
        self._end: _End | None = None
        self._last_failed = False
        """The last attempt failed."""
        self._kept = b""
        self._thread = threading.Thread(
            target=copy_context().run, args=(self._work,), name=f"sender {notifier.name}", daemon=True
        )

    def start(self) -> None:
        """Start, with the notifications of an earlier run."""
        self._thread.start()

    def take(self, notification: Notification) -> None:
        """Queue a notification where it is severe enough."""
        if notification.severity.rank >= self.notifier.least.rank:
            self._inbox.put(notification)

    def end(self, until_s: float) -> None:
        """Try the waiting ones once more until then (``time.monotonic``); store the rest for the next start."""
        self._inbox.put(_End(until_s))

    def join(self, within_s: float) -> None:
        """Wait for its end."""
        self._thread.join(max(within_s, 0.0))
        if self._thread.is_alive():
            log.error("the sender of %r has not ended in time: its disk is slow", self.notifier.name)

    def _work(self) -> None:
        try:
            self._until_over()
        except Exception:
            log.exception("the sender of %r failed and sends nothing until the next start", self.notifier.name)

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
            self._process(item)
        self._keep()
        if left := len(self._outbox.waiting):
            log.error("%r: %d notifications wait for the next start in %s", self.notifier.name, left, self._path)

    def _process(self, item: Notification | Attempt | _End) -> None:
        match item:
            case Notification():
                self._outbox.add(item, time.time())
            case Attempt():
                self._complete(item)
            case _End():
                self._end = item
                self._outbox.hurry()

    def _over(self) -> bool:
        """At the end each notifier has one more attempt."""
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

    def _complete(self, attempt: Attempt) -> None:
        self._attempt = None
        if not attempt.error:
            self._outbox.sent(attempt.notification)
            self._failing = self._failing and bool(self._outbox.waiting)
            log.info("sent to %r: %s", self.notifier.name, attempt.notification.title)
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
            self._publish(error)

    def _give_up(self, now_s: float) -> None:
        lost = self._outbox.give_up(now_s)
        for notification in lost:
            log.error("not sent to %r: %s", self.notifier.name, notification.text)
        if lost:
            self._publish("waiting notifications are too old or too many", len(lost))

    def _publish(self, error: str, given_up: int = 0) -> None:
        name, waiting = self.notifier.name, len(self._outbox.waiting)
        self._report(NotificationFailed(notifier=name, error=error, waiting=waiting, given_up=given_up))

    def _keep(self) -> None:
        content = json.dumps(self._outbox.facts(), indent=1).encode()
        if content == self._kept:
            return
        try:
            self._path.parent.mkdir(exist_ok=True)
            write_atomic(self._path, content)
            self._kept = content
        except OSError as error:
            log.error("%s cannot be written: %s; a kill of the daemon loses the waiting ones", self._path, error)


def outbox_path(state_dir: Path, name: str) -> Path:
    """Return the file of a notifier's waiting notifications."""
    return state_dir / "notify" / f"{name}.json"


def read_outbox(path: Path, remind_after_s: float) -> tuple[NotificationQueue, bytes]:
    """Return the queue of an earlier run, and the file's content; an empty one where no file can be read."""
    try:
        content = path.read_bytes()
        return NotificationQueue.of(json.loads(content), remind_after_s), content
    except FileNotFoundError:
        return NotificationQueue(remind_after_s), b""
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        log.error("%s cannot be read; its notifications are not sent: %s", path, error)
        return NotificationQueue(remind_after_s), b""
