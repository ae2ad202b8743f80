"""Text and numbers that the run report and the certificate share, and the names of passes and measurements.

An interrupted pass has no number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from polishd.rendering.document import DASH, Verdict

Rows = Sequence[Mapping[str, Any]]


VERDICTS: Mapping[str, Verdict] = {
    "in_tolerance": Verdict("good", "In tolerance"),
    "cycles_used": Verdict("bad", "Not in tolerance: all passes used"),
    "as_programmed": Verdict("good", "Polished as programmed, to estimate parameters"),
    "diverged": Verdict("bad", "Diverged: the surface got worse"),
    "stalled": Verdict("bad", "Stalled: the passes removed too little error"),
    "stopped": Verdict("bad", "Stopped before the end"),
    "failed": Verdict("bad", "Ended by an error: see the notes"),
    "planned": Verdict("plain", "Plan: nothing moved"),
    "": Verdict("bad", "Unfinished: there is no summary"),
}


def duration(rows: Rows, key: str) -> str:
    """Return the sum of seconds as hours and minutes, or minutes and seconds."""
    values = [row[key] for row in rows if isinstance(row.get(key), int | float)]
    if not values:
        return ""
    return _long(sum(values))


def phase_durations(phase_times_s: Any) -> str:
    """Return the duration of each phase; empty if it is not recorded."""
    times = phase_times_s.items() if isinstance(phase_times_s, Mapping) else ()
    durations = [f"{name.replace('_', '-')} {_long(value)}" for name, value in times if isinstance(value, int | float)]
    return ", ".join(durations)


def _long(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {seconds:02d} s"


def figure(value: Any, form: str) -> str:
    """Format a number; empty if there is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    return format(value, form)


def plain(value: Any) -> str:
    """Format a value of an optimality certificate."""
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, list):
        return "; ".join(map(str, value)) or "none"
    return "none" if value is None else text(value)


def when(value: Any) -> str:
    """Format a time: seconds since 1970, or ISO 8601 to the second."""
    if isinstance(value, int | float):
        return f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return text(value)[:19].replace("T", " ")


def text(value: Any) -> str:
    """Return the value as text; None is empty."""
    return "" if value is None else str(value)


def interrupted(row: Mapping[str, Any]) -> bool:
    """True if the pass after a measurement was not executed to its end."""
    return row.get("how") not in (None, "done")


def share(row: Mapping[str, Any]) -> str:
    """Return the executed share of an interrupted pass and its uncertain blocks; empty for any other pass."""
    if not interrupted(row):
        return ""
    blocks = ", ".join(f"{first} to {last}" for first, last in row.get("uncertain") or ())
    uncertain = f"; blocks {blocks} uncertain" if blocks else ""
    match row.get("executed_s"), row.get("dwell_s"):
        case (int() | float()) as executed, (int() | float()) as planned if planned > 0:
            return f"interrupted at {executed / planned:.0%}{uncertain}"
        case _:
            return f"interrupted{uncertain}"


def passes(rows: Rows) -> str:
    """Return the number of whole passes, and of interrupted ones."""
    interrupted_n = sum(map(interrupted, rows))
    whole = len(rows) - 1 - sum(map(interrupted, rows[:-1]))
    return f"{whole}, and {interrupted_n} interrupted" if interrupted_n else str(whole)


def lines(rows: Rows) -> list[list[str]]:
    """Return a row for each line of the tolerance: name, limit, value of each measurement, result of the last.

    Empty for a single line that is judged as measured: the table of measurements shows it.
    """
    judged = [[one for one in row.get("judged") or () if isinstance(one, Mapping)] for row in rows]
    if not judged or (
        len(judged[-1]) < 2 and not any(figure(one.get("bound"), "g") or _ripple(one) for one in judged[-1])
    ):
        return []
    values = [{one.get("what"): one for one in measured} for measured in judged]
    return [
        [
            text(line.get("what")),
            f"{figure(line.get('limit'), 'g')} {text(line.get('unit'))}",
            *(figure(found.get(line.get("what"), {}).get("value"), ".3g") or DASH for found in values),
            ("yes" if line.get("holds") else "no") + _uncertainty(line),
        ]
        for line in judged[-1]
    ]


def tolerance(rows: Rows) -> str:
    """Return the number of lines that the last measurement is within."""
    judged = [one for one in (rows[-1].get("judged") or () if rows else ()) if isinstance(one, Mapping)]
    return f"{sum(bool(one.get('holds')) for one in judged)} of {len(judged)} lines hold" if judged else ""


def accepted(summary: Mapping[str, Any], rows: Rows) -> str:
    """Return the criterion of acceptance, and the system map that is subtracted; empty for a summary without them."""
    by = {
        "figure": "as measured",
        "bound": "by the 95 % bound of the true RMS, as its mount holds it",
        "bound_without_power": "by the 95 % bound of the true RMS, as its mount holds it, power removed",
    }.get(text(summary.get("accept")), "")
    system = text(rows[-1].get("system")) if rows else ""
    return f"{by}; the instrument's system map {system[:12]} is subtracted" if by and system else by


def rms_limit(rows: Rows) -> Any:
    """Return the limit of the RMS of the whole surface; None if the tolerance has no such line."""
    judged = (rows[-1].get("judged") or ()) if rows else ()
    return next((one.get("limit") for one in judged if isinstance(one, Mapping) and one.get("what") == "RMS"), None)


def _uncertainty(line: Mapping[str, Any]) -> str:
    """Return the bound that a line was judged by, or else the uncertainty of the instrument if it is known."""
    unit, removed = text(line.get("unit")), text(line.get("removed"))
    if bound := figure(line.get("bound"), ".3g"):
        without = f", {removed} removed" if removed else ""
        return f" (at most {bound} {unit} truly, 95 %; guard band {figure(line.get('guard'), '.2g')} {unit}{without})"
    sigma = figure(line.get("uncertainty"), ".2g")
    return _ripple(line) + (f" (± {sigma} {unit})" if sigma else "")


def _ripple(line: Mapping[str, Any]) -> str:
    """Return the figure with the ripple that the map does not show; empty where that is no difference."""
    value, rippled, high = (figure(line.get(key), ".3g") for key in ("value", "with_ripple", "with_ripple_high"))
    if not high or high == value:
        return ""
    return f" ({rippled} {text(line.get('unit'))} with ripple that the map does not show, up to {high})"


def measurement(rows: Rows, index: int) -> str:
    """Return ``start``, or after which pass the map was taken."""
    if index == 0:
        return "start"
    if index <= len(rows) and interrupted(rows[index - 1]):
        return "after an interrupted pass"
    return f"after pass {index - sum(map(interrupted, rows[:index]))}"


def pass_after(rows: Rows, index: int) -> str:
    """Return the name of the pass after a measurement."""
    if index < len(rows) and interrupted(rows[index]):
        return f"Pass that was {share(rows[index])}"
    return f"Pass {index + 1 - sum(map(interrupted, rows[:index]))}"
