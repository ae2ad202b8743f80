"""Text and numbers that the run report and the certificate share, and the names of passes and measurements.

An interrupted pass has no number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from polishd.model.tolerance import LineResult, line_results
from polishd.rendering.document import DASH, Cell, DocumentSection, ReportValue, Table, Verdict

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


# The drawing's requirement and the result, as all reports state them.

FORM_FIGURES = ("3/A", "3/B", "3/C")
RMS_FIGURES = ("RMSt", "RMSi", "RMSa")
PSD_NOTE = (
    "A PSD line is the A of A / f^B by ISO 10110-8:2010, for the radially averaged two-dimensional PSD, not for "
    "profiles."
)


def requirement(
    last: Sequence[LineResult], key: str, before: Sequence[LineResult] = (), before_key: str = ""
) -> Iterator[DocumentSection]:
    """Yield a section with limit, value, uncertainty and result of each line; nothing without a tolerance.

    Args:
        last: results of the map that decides.
        key: of their list in the report's JSON.
        before: results of the first map; empty: the part was measured once.
        before_key: of those.
    """
    if not last:
        return
    first = {one.what: _value(one.value, f"{before_key}.{at}.value") for at, one in enumerate(before)}
    rippled = any(one.ripple_words for one in last)
    rows = [
        (
            symbols(one.what),
            symbols(one.unit),
            ReportValue(f"{one.limit:g}", f"{key}.{at}.limit", one.limit),
            *((first.get(one.what, DASH),) if before else ()),
            _value(one.value, f"{key}.{at}.value"),
            *((_value(one.with_ripple, f"{key}.{at}.with_ripple"),) if rippled else ()),
            _uncertainty(one, f"{key}.{at}"),
            "undecided, " * one.unsure + ("pass" if one.holds else "fail"),
        )
        for at, one in enumerate(last)
    ]
    measured = (*(("before", "after") if before else ("measured",)), *(("with ripple",) if rippled else ()))
    table = Table(("requirement", "unit", "limit", *measured, "±, or bound", "result"), rows)
    yield DocumentSection("Requirement and result", [table], list(_requirement_notes(last)))


def _value(value: float | None, key: str) -> Cell:
    return DASH if value is None else ReportValue(f"{value:.4g}", key, value)


def _uncertainty(one: LineResult, key: str) -> Cell:
    """Return the bound that a line was judged by, or else the uncertainty of the instrument."""
    if one.bound is not None:
        return f"at most {one.bound:.3g}"
    known = one.uncertainty
    return "not known" if known is None else ReportValue(f"{known:.2g}", f"{key}.uncertainty", known)


def _requirement_notes(last: Sequence[LineResult]) -> Iterator[str]:
    if drawn := indication(last):
        yield f"In the notation of ISO 10110-5:2015, nm of surface: {drawn}"
    if any(one.what.startswith("PSD") for one in last):
        yield PSD_NOTE
    for one in last:
        if one.bound is not None:
            yield f"{symbols(one.what)}: {symbols(one.bound_words)}; judged by this bound."
    if any(one.ripple_words for one in last):
        yield "With ripple: with the forecast ripple of the path that the map does not show. It decides."
    if any(one.unsure for one in last):
        yield "Undecided: the limit lies within the uncertainty, and either result is possible."


def indication(lines: Sequence[LineResult]) -> str:
    """Return the limits of form as a drawing has them, ``3/A(B/C); RMSi < 5``; empty if no line is of ISO 10110-5."""
    limits = {one.what: f"{one.limit:g}" for one in lines}
    a, b, c = (limits.get(name, "-") for name in FORM_FIGURES)
    inner = f"({b}/{c})" if c != "-" else f"({b})" if b != "-" else ""
    form = [f"3/{a}{inner}"] if {*FORM_FIGURES} & {*limits} else []
    return "; ".join([*form, *(f"{name} < {limits[name]}" for name in RMS_FIGURES if name in limits)])


def symbols(text: str) -> str:
    """Return units and formulas with their symbols: µrad, nm², f², ×, ±."""
    text = re.sub(r"\^([23])(?![\d.])", lambda found: {"2": "²", "3": "³"}[found[1]], text)
    for plain, symbol in (("urad", "µrad"), (" x ", " × "), ("+-", "±")):
        text = text.replace(plain, symbol)
    return text


def results(row: Mapping[str, Any]) -> tuple[LineResult, ...]:
    """Return the results of the tolerance's lines of a measurement; empty if the summary has none, or no numbers."""
    try:
        found = line_results(row)
    except (AttributeError, LookupError, TypeError):
        return ()
    return found if all(figure(one.value, "g") and figure(one.limit, "g") for one in found) else ()


def tolerance(rows: Rows) -> str:
    """Return the number of lines that the last measurement is within."""
    judged = results(rows[-1]) if rows else ()
    return f"{sum(one.holds for one in judged)} of {len(judged)} lines hold" if judged else ""


def accepted(summary: Mapping[str, Any], rows: Rows) -> str:
    """Return the criterion of acceptance, and the system map that is subtracted; empty for a summary without them."""
    by = {
        "figure": "as measured",
        "bound": "by the 95 % bound of the true RMS, as its mount holds it",
        "bound_without_power": "by the 95 % bound of the true RMS, as its mount holds it, power removed",
    }.get(text(summary.get("accept")), "")
    system = text(rows[-1].get("system")) if rows else ""
    return f"{by}; the instrument's system map {system[:12]} is subtracted" if by and system else by


def rms_limit(judged: Sequence[LineResult]) -> float | None:
    """Return the limit of the RMS of the whole surface; None if the tolerance has no such line."""
    return next((one.limit for one in judged if one.what == "RMS"), None)


def psd_limits(summary: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the PSD lines of a summary's tolerance; empty for a summary of an earlier polishd."""
    lines = summary.get("tolerance")
    found = [one for one in lines if isinstance(one, Mapping)] if isinstance(lines, list) else []
    return [one for one in found if one.get("figure") == "psd"]


def number(row: Mapping[str, Any], key: str) -> float:
    """Return a positive figure of a row; NaN if there is none."""
    value = row.get(key)
    return float(value) if isinstance(value, int | float) and value > 0 else math.nan


def ripple(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the harmonics that the pass after a measurement adds; empty without a forecast."""
    lines = row.get("ripple")
    return [one for one in lines if isinstance(one, Mapping)] if isinstance(lines, list) else []


def ripple_section(rows: Rows) -> Iterator[DocumentSection]:
    """Yield the ripple that each pass adds, by line and in sum; nothing without a forecast."""
    keys = ("period_mm", "amplitude_nm", "rms_nm", "rms_high_nm")
    cells: list[tuple[str, ...]] = []
    for index, lines in [(index, ripple(row)) for index, row in enumerate(rows) if ripple(row)]:
        name = pass_after(rows, index)
        for one in lines:
            cause = text(one.get("cause")).replace("_", " ") or "path"
            figures = [figure(one.get(key), ".2f") or DASH for key in keys]
            cells.append((name, f"{plain(one.get('direction'))}, {cause}", *figures))
        values = [[number(one, key) for one in lines] for key in keys[2:]]
        whole = [f"{math.hypot(*(value for value in some if value > 0)):.2f}" for some in values]
        cells.append((name, "all", "", "", *whole))
    if cells:
        head = ("pass", "direction, cause", "period, mm", "amplitude, nm", "RMS, nm", "at most (95 %), nm")
        note = (
            "Forecast of what the path leaves. The 95 % value contains errors of spot radius, line positions and lag."
        )
        yield DocumentSection("Ripple that the path adds", [Table(head, cells)], [note])


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
