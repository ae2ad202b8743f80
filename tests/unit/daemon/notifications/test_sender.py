"""Queue of notifications: repetitions are counted, failures are retried with longer pauses, and each loss is logged."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.daemon.notifications.sender import KEPT_S, LONGEST_PAUSE_S, MOST_THINGS, MOST_WAITING, NotificationQueue
from polishd.model.notification import Notification
from polishd.model.states import Severity

NOON_S = 1_800_000_000.0
HALF_HOUR_S = 1800.0


def notification(what: str = "held: LinkError: cut", at_s: float = NOON_S, **changes: Any) -> Notification:
    made = Notification(
        id=f"{what} {at_s}",
        event="state",
        severity=Severity.WARNING,
        what=what,
        now="held",
        todo="resume",
        cell="c",
        job="j",
        part="P-1",
        cycle=0,
        run_dir="run",
        at=datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds"),
    )
    return replace(made, **changes)


def flush(outbox: NotificationQueue, now_s: float) -> list[Notification]:
    """All that is due, sent."""
    found = []
    outbox.release(now_s)
    while (due := outbox.due(now_s)) is not None:
        outbox.sent(due)
        found.append(due)
    return found


def test_a_night_of_a_flapping_device_is_two_dozen_notifications_and_each_time_is_counted() -> None:
    """Every ten seconds for twelve hours, and each time with another figure in the text."""
    outbox, sent = NotificationQueue(HALF_HOUR_S), []
    for n in range(4320):
        now_s = NOON_S + 10.0 * n
        outbox.add(notification(f"held: LinkError: no answer for {n / 100:.2f} s", now_s), now_s)
        sent += flush(outbox, now_s)
    sent += flush(outbox, NOON_S + 13 * 3600)
    assert len(sent) == 25
    assert sum(one.times for one in sent) == 4320
    assert (sent[1].times, sent[1].since) == (179, notification(at_s=NOON_S + 10).at)
    assert sent[1].what == "held: LinkError: no answer for 1.79 s", "the last one is sent"


def test_a_night_of_things_that_are_never_the_same_is_bounded_too() -> None:
    outbox, sent = NotificationQueue(HALF_HOUR_S), []
    for n in range(4320):
        now_s = NOON_S + 10.0 * n
        word = "".join(chr(ord("a") + int(digit)) for digit in str(n))
        outbox.add(notification(f"held: {word}", now_s), now_s)
        sent += flush(outbox, now_s)
    sent += flush(outbox, NOON_S + 13 * 3600)
    assert len(sent) <= 25 * (MOST_THINGS + 1)
    assert sum(one.times for one in sent) == 4320


def test_another_thing_or_a_worse_one_is_reported_at_once() -> None:
    outbox = NotificationQueue(HALF_HOUR_S)
    different = (
        notification(),
        notification("held: MapError: holes"),
        notification(severity=Severity.ALARM, id="worse"),
    )
    for one in (*different, notification(part="P-2", id="other part")):
        outbox.add(one, NOON_S)
    assert len(flush(outbox, NOON_S)) == 4


def test_without_a_time_each_is_reported() -> None:
    outbox = NotificationQueue(0.0)
    for n in range(3):
        outbox.add(notification(id=str(n)), NOON_S)
    assert [one.id for one in flush(outbox, NOON_S)] == ["0", "1", "2"]


def test_pauses_grow_and_end_with_a_success() -> None:
    outbox, now_s, tries = NotificationQueue(HALF_HOUR_S), NOON_S, []
    outbox.add(notification(), now_s)
    while now_s < NOON_S + 3 * LONGEST_PAUSE_S:
        if (due := outbox.due(now_s)) is not None:
            outbox.failed(due, now_s)
            tries.append(now_s - NOON_S)
        now_s += 1.0
    assert tries[:6] == [0, 10, 30, 70, 150, 310]
    later = [second - first for first, second in pairwise(tries[6:])]
    assert set(later) <= {640.0, LONGEST_PAUSE_S}
    outbox.add(notification("held: other"), now_s)
    now_s += LONGEST_PAUSE_S
    due = outbox.due(now_s)
    assert due is not None
    outbox.sent(due)
    assert outbox.due(now_s) is not None, "the next one without a pause"


def test_one_that_is_never_taken_does_not_hold_up_the_others() -> None:
    outbox = NotificationQueue(HALF_HOUR_S)
    poison, other = notification("held: poison"), notification("held: other", NOON_S + 1)
    outbox.add(poison, NOON_S)
    outbox.add(other, NOON_S)
    assert outbox.due(NOON_S) == poison
    outbox.failed(poison, NOON_S)
    assert outbox.due(NOON_S + 10) == other


def test_an_alarm_goes_first() -> None:
    outbox = NotificationQueue(HALF_HOUR_S)
    outbox.add(notification(), NOON_S)
    alarm = notification("failed", NOON_S + 5, severity=Severity.ALARM)
    outbox.add(alarm, NOON_S + 5)
    assert outbox.due(NOON_S + 5) == alarm


def test_what_waits_too_long_or_is_too_much_is_given_up_the_least_severe_first() -> None:
    outbox = NotificationQueue(0.0)
    outbox.add(notification("alarm", severity=Severity.ALARM), NOON_S)
    for n in range(MOST_WAITING + 3):
        outbox.add(notification(id=str(n), at_s=NOON_S + n), NOON_S)
    assert [one.id for one in outbox.give_up(NOON_S + 200)] == ["0", "1", "2", "3"]
    assert len(outbox.waiting) == MOST_WAITING
    assert len(outbox.give_up(NOON_S + KEPT_S + 1000)) == MOST_WAITING
    assert outbox.waiting == []


def test_what_was_given_up_while_it_was_sent_is_over_all_the_same() -> None:
    outbox = NotificationQueue(HALF_HOUR_S)
    outbox.add(notification(), NOON_S)
    due = outbox.due(NOON_S)
    assert due is not None
    assert outbox.give_up(NOON_S + 2 * KEPT_S) == [due]
    outbox.failed(due, NOON_S)
    outbox.sent(due)
    assert outbox.waiting == []


@pytest.mark.parametrize("jump_s", [-365 * 86400.0, 365 * 86400.0])
def test_a_clock_that_jumps_silences_no_notifier(jump_s: float) -> None:
    outbox = NotificationQueue(HALF_HOUR_S)
    outbox.add(notification(), NOON_S)
    due = outbox.due(NOON_S)
    assert due is not None
    outbox.failed(due, NOON_S)
    assert outbox.due(NOON_S + 1) is None
    now_s = NOON_S + 1 + jump_s
    assert outbox.due(now_s) is not None, "the pause is over"
    outbox.add(notification(at_s=now_s), now_s)
    assert len(outbox.waiting) == 2, "the half hour is over"
    assert 0 <= outbox.idle_s(now_s) <= 60


def test_a_daemon_that_is_started_again_each_minute_counts_as_well() -> None:
    outbox, sent = NotificationQueue(HALF_HOUR_S), 0
    for minute in range(60):
        now_s = NOON_S + 60.0 * minute
        outbox = NotificationQueue.of(json.loads(json.dumps(outbox.facts())), HALF_HOUR_S)
        outbox.add(notification(at_s=now_s), now_s)
        sent += len(flush(outbox, now_s))
    assert sent == 2


@given(st.lists(st.tuples(st.integers(0, 5), st.booleans(), st.floats(0.0, 4000.0)), max_size=60))
def test_each_event_is_sent_or_counted_once(steps: list[tuple[int, bool, float]]) -> None:
    """Whatever comes, fails, and passes in between; also over restarts."""
    outbox, now_s, added, sent = NotificationQueue(HALF_HOUR_S), NOON_S, 0, 0
    for word, works, pause_s in steps:
        now_s += pause_s
        outbox.add(notification(f"held: {'abcdef'[word]}", now_s, id=str(added)), now_s)
        added += 1
        outbox = NotificationQueue.of(json.loads(json.dumps(outbox.facts())), HALF_HOUR_S)
        if works:
            sent += sum(one.times for one in flush(outbox, now_s))
        elif (due := outbox.due(now_s)) is not None:
            outbox.failed(due, now_s)
    assert sent + sum(one.times for one in flush(outbox, now_s + 1e5)) == added


@pytest.mark.parametrize(
    "facts", [{}, {"waiting": [{}], "recent": {}}, {"waiting": [], "recent": {"a": {"began_s": "x"}}}]
)
def test_what_is_no_outbox_is_refused(facts: dict[str, Any]) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        NotificationQueue.of(facts, 1.0)
