"""Dates of headers: what is one instant, and what is none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone

import pytest

from polishd.plugins.interferometer.formats.common import date_of, instant

LOCAL = datetime(2019, 3, 14, 10, 22, 33).astimezone()


@pytest.mark.parametrize(
    "text",
    [
        "2019-03-14 10:22:33", "2019-03-14T10:22:33", "Thu Mar 14 10:22:33 2019", "03/14/2019 10:22:33",
        "3/14/2019 10:22:33 AM", "14/03/2019  10:22:33", "14.03.2019 10:22:33", "14 Mar 2019 10:22:33",
        "14-Mar-2019 10:22:33", "Mar 14, 2019 10:22:33",
    ],
)  # fmt: skip
def test_one_instant_in_the_instruments_words(text: str) -> None:
    assert date_of(text) == (LOCAL, "header", ())
    assert date_of(text, utc=True).at == datetime(2019, 3, 14, 10, 22, 33, tzinfo=UTC)


def test_a_zone_that_is_named_is_kept() -> None:
    zone = timezone(timedelta(hours=-7))
    assert date_of("2019-03-14T10:22:33-07:00").at == datetime(2019, 3, 14, 10, 22, 33, tzinfo=zone)


@pytest.mark.parametrize(
    ("text", "why"),
    [("2019-03-14", "no time of day"), ("03/14/2019", "no time of day"), ("03/04/2019 10:22", "month or the day")],
)
def test_what_is_no_instant_is_guessed(text: str, why: str) -> None:
    date = date_of(text)
    assert date.at is not None
    assert date.by == "guessed"
    assert why in date.warnings[0]


@pytest.mark.parametrize("text", ["02:15:18", "yesterday", "32.01.2019 10:00", "1/2/3", "\xff", "9" * 5000])
def test_what_is_no_date_is_none(text: str) -> None:
    assert (date_of(text).at, len(date_of(text).warnings)) == (None, 1)


def test_nothing_is_nothing() -> None:
    assert date_of("") == date_of(" \n") == (None, "header", ())


@pytest.mark.parametrize("hours", [-11, 0, 13])
def test_a_librarys_today_midnight_and_future_are_no_measurement_times(hours: int) -> None:
    now = datetime(2026, 11, 22, 20, 5, tzinfo=timezone(timedelta(hours=hours)))
    filled_in = (datetime(2026, 11, 22, 2, 15, 18), now.astimezone(UTC), datetime(2018, 2, 15), datetime(2027, 5, 1, 9))  # noqa: DTZ001
    for at in filled_in:
        assert instant(at, now).by == "guessed"
    old = datetime(2018, 2, 15, 10, 32, 11, tzinfo=UTC)
    assert instant(old, now) == (old, "header", ())


def test_the_ends_of_time_are_no_error() -> None:
    for at in (datetime.min, datetime.max):  # noqa: DTZ901
        assert instant(at, datetime.now(UTC)).at is not None


@pytest.fixture
def in_central_europe(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patched:
        patched.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")  # needs no database of zones
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("in_central_europe")
@pytest.mark.parametrize(
    ("text", "by"),
    [
        ("2026-10-25 02:30:00", "guessed"),  # at 0:30 UTC and at 1:30 UTC
        ("2026-03-29 02:30:00", "guessed"),  # never
        ("2026-10-25 03:30:00", "header"),
        ("2026-10-25T02:30:00+01:00", "header"),
    ],
)
def test_a_time_that_the_local_clocks_show_twice_or_never_is_guessed(text: str, by: str) -> None:
    found = date_of(text)
    assert (found.by, len(found.warnings)) == (by, by == "guessed")
    assert date_of(text, utc=True).by == "header"
    later = instant(datetime.fromisoformat(text), datetime(2027, 1, 1, tzinfo=UTC))
    assert later.by == by
