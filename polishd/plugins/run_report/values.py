"""Numbers, times and texts as the page shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any


def duration(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    """Summed seconds as hours and minutes, or minutes and seconds."""
    values = [row[key] for row in rows if isinstance(row.get(key), int | float)]
    if not values:
        return ""
    minutes, seconds = divmod(round(sum(values)), 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {seconds:02d} s"


def figure(value: Any, shape: str) -> str:
    """A number as text, empty where there is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    return format(value, shape)


def plain(value: Any) -> str:
    """A certificate's value as text."""
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, list):
        return "; ".join(map(str, value)) or "none"
    return "none" if value is None else text(value)


def when(value: Any) -> str:
    """A time as people read it: seconds since 1970, or ISO 8601 to the second."""
    if isinstance(value, int | float):
        return f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return text(value)[:19].replace("T", " ")


def text(value: Any) -> str:
    """Anything as one text, None as nothing."""
    return "" if value is None else str(value)
