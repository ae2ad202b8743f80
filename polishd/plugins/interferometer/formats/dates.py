"""Dates in words, and those that a library has read: what is no instant dates no map.

A header without a zone has the instrument's local time; it is taken to be in the zone of this computer.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import NamedTuple

from polishd.model.surface import DateFrom

TIMES = ("%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
DAYS = ("%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d", "%d.%m.%Y", "%d %b %Y", "%d-%b-%Y", "%b %d %Y", "%b %d, %Y")
FORMATS = ("%a %b %d %H:%M:%S %Y", *DAYS, *(f"{day} {time}" for day in DAYS for time in TIMES))
"""Both orders of month and day: what only one of them fits is meant."""
NOT_DATED = "its date, {}, {}: the map counts as not dated"


class Date(NamedTuple):
    """A date, who says it, and what to warn of."""

    at: datetime | None = None
    by: DateFrom = "header"
    warnings: tuple[str, ...] = ()


def date_of(text: str, *, utc: bool = False) -> Date:
    """What a header says, with a zone; nothing where it says nothing.

    One that has no time of day, or can be read in two ways, is "guessed"; one that cannot be read is none. ``utc``: a
    date that names no zone is UTC by the format.
    """
    words = " ".join(text.split())
    if not words:
        return Date()
    found = {at for form in (None, *FORMATS) if (at := _parsed(words, form))}
    if not found:
        return Date(warnings=(NOT_DATED.format(repr(words[:40]), "is not understood"),))
    at = min(found).replace(tzinfo=UTC) if utc and min(found).tzinfo is None else _zoned(min(found))
    if len(found) == 1 and ":" in words:
        return Date(at)
    why = "gives no time of day" if len(found) == 1 else "may have the month or the day first"
    return Date(at, "guessed", (NOT_DATED.format(repr(words[:40]), why),))


def instant(at: datetime, now: datetime) -> Date:
    """A date that a library has read, which fills in what is not there: today's, midnight and the future are nobody's.

    ``now``: with the local zone.
    """
    known = _zoned(at)
    if at.date() in {now.date(), now.astimezone(UTC).date()}:
        why = "is today's, as if filled in"
    elif known > now:
        why = "is in the future, as if filled in"
    elif (at.hour, at.minute, at.second) == (0, 0, 0):
        why = "gives no time of day"
    else:
        return Date(known)
    return Date(known, "guessed", (NOT_DATED.format(known.isoformat(), why),))


def _parsed(words: str, form: str | None) -> datetime | None:
    """As it stands; ``form`` None: ISO 8601."""
    try:
        return datetime.fromisoformat(words) if form is None else datetime.strptime(words, form)  # noqa: DTZ007
    except ValueError:
        return None


def _zoned(at: datetime) -> datetime:
    try:
        return at if at.tzinfo else at.astimezone()
    except (OverflowError, ValueError, OSError):  # at the ends of what a date can hold: none of a map
        return at.replace(tzinfo=UTC)
