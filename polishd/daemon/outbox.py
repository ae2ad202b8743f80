"""What waits to be sent by one notifier, what is only counted, and when it is tried again.

No thread, no file and no clock: ``now_s`` is the time of day, s since 1970, which may jump. A span that the clock does
not bear out is over.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any, Self

from polishd.model.concern import Severity
from polishd.model.notification import Notification

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 900.0
"""After each failure the pause is twice as long, up to this."""
KEPT_S = 7 * 86400.0
"""What could not be sent for so long is given up."""
MOST_WAITING = 100
MOST_THINGS = 12
"""More things than this within ``repeat_s`` are one thing, by severity."""


@dataclass(slots=True)
class _Told:
    """A thing that was told, and how often it happened again since."""

    began_s: float
    again: Notification | None = None


@dataclass(slots=True)
class NotificationQueue:
    """All that one notifier has to do."""

    repeat_s: float
    """What happens again within that time is counted."""
    waiting: list[Notification] = field(default_factory=list)
    _told: dict[str, _Told] = field(default_factory=dict)
    _failures: int = 0
    """In a row."""
    _failed_s: float = 0.0
    _tries: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, facts: Mapping[str, Any], repeat_s: float) -> Self:
        """As ``facts`` was kept; KeyError, TypeError or ValueError where it is something else."""
        told = {
            thing: _Told(float(one["began_s"]), _notification(one["again"]) if one["again"] else None)
            for thing, one in facts["told"].items()
        }
        return cls(repeat_s, [_notification(one) for one in facts["waiting"]], told)

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
        if self.repeat_s > 0:
            self._told[thing] = _Told(now_s)

    def release(self, now_s: float) -> None:
        """What was counted long enough waits to be sent."""
        for thing, told in list(self._told.items()):
            if _left_s(told.began_s, self.repeat_s, now_s):
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
        until += [_left_s(told.began_s, self.repeat_s, now_s) for told in self._told.values()]
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
