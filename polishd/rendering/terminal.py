"""Tables on the terminal. Programs read ``--json``."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.segment import Segment
from rich.status import Status
from rich.table import Table
from rich.text import Text

from polishd.model.text import printable
from polishd.model.tolerance import LineResult, line_results
from polishd.util.serialization import plain

# Output to the terminal. Control characters in text from outside are escaped here, and in no other module.


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text on stdout or stderr."""
    typer.echo(printable(text), err=err, nl=nl)


def escape_logs() -> None:
    """Escape log records on stderr if no log file is set up."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_Escaped())


class _Escaped(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


CUT = "…"
"""What rich puts in the place of the rest of a word."""
WIDE = 160
"""Columns if stdout is not a terminal and COLUMNS is not set: a file or a pipe has all figures."""


class Terminal(Console):
    """Rich console for text from outside: no markup, and control characters are escaped."""

    def __init__(self, **how: Any) -> None:
        # NO_COLOR removes bold and underline, too: a terminal that cannot show colors may print their codes.
        if os.environ.get("NO_COLOR"):
            how["color_system"] = None
        super().__init__(markup=False, emoji=False, **how)

    def render_str(self, text: str, **how: Any) -> Text:
        """See Console. The layout uses the escaped text."""
        return super().render_str(printable(text), **how)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """See Console. Cursor movements of rich are ``control`` segments."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def status(self, status: RenderableType, **how: Any) -> Status:
        """See Console."""
        return _Status(status, console=self, **how)


class _Status(Status):
    """Rich status without markup."""

    def __init__(self, status: RenderableType, **how: Any) -> None:
        super().__init__(_unmarked(status), **how)

    def update(self, status: RenderableType | None = None, **how: Any) -> None:
        super().update(None if status is None else _unmarked(status), **how)


def _unmarked(status: RenderableType) -> RenderableType:
    return Text(status) if isinstance(status, str) else status


stderr = Terminal(stderr=True)
stdout = Terminal(width=None if os.environ.get("COLUMNS") or (sys.stdout is not None and sys.stdout.isatty()) else WIDE)


class FittingTable(Table):
    """Table that becomes a list of names and values for each row where the terminal is too narrow for its columns."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """See Table."""
        drawn = list(super().__rich_console__(console, options))
        cut = sum(one.text.count(CUT) for one in drawn if isinstance(one, Segment))
        if cut <= sum(str(cell).count(CUT) for column in self.columns for cell in (column.header, *column.cells)):
            yield from drawn
            return
        if self.title:
            yield Text(str(self.title), style="italic")
        names = [str(column.header) for column in self.columns]
        for number, row in enumerate(zip(*(column.cells for column in self.columns), strict=True)):
            listed = key_table("", [(name, cell) for name, cell in zip(names, row, strict=True) if str(cell)])
            listed.title, listed.show_edge, listed.box = None, False, None
            if number:
                yield Text()
            yield listed


def cycle_table(summary: Mapping[str, Any]) -> Table:
    """Table with a row for each measurement, and the prediction and execution of the pass after it."""
    period = float(summary.get("tolerance_period_mm") or 0.0)
    table = FittingTable(title=f"{summary['job']}: {summary['outcome']}", title_justify="left")
    columns = {"pv_nm": "PV nm", "rms_nm": "RMS nm", "lsf_rms_nm": "LSF nm"}
    columns |= {"band_rms_nm": f"> {period:g} mm nm"} if period else {}
    columns |= {"predicted_rms_nm": "predicted nm"}
    if any(cycle.get("expected_low_nm") is not None for cycle in summary["cycles"]):
        columns |= {"expected_low_nm": "expected from", "expected_high_nm": "to nm"}
    columns |= {"dwell_s": "dwell s", "executed_s": "executed s", "rate": "rate"}
    for name in ("#", *columns.values()):
        table.add_column(name, justify="right")
    if tools := any(cycle.get("tool") for cycle in summary["cycles"]):
        table.add_column("tool")
    if programs := any(cycle.get("program") for cycle in summary["cycles"]):
        table.add_column("program")
    if interrupted := any(map(_interruption, summary["cycles"])):
        table.add_column("pass")
    for number, cycle in enumerate(summary["cycles"]):
        figures = [_figure(cycle.get(key), 3 if key == "rate" else 2) for key in columns]
        tool = [cycle.get("tool") or ""] if tools else []
        tool += [cycle.get("program") or ""] if programs else []
        table.add_row(str(number), *figures, *tool, *([_interruption(cycle)] if interrupted else []))
    return table


def outcome_tables(summary: Mapping[str, Any]) -> RenderableType:
    """Table of measurements, and of the tolerance unless it is a single limit that is judged as measured."""
    judged = [one for cycle in summary["cycles"] for one in line_results(cycle)]
    if not judged or (summary.get("tolerance_nm") is not None and all(one.judged_as_measured for one in judged)):
        return cycle_table(summary)
    return Group(cycle_table(summary), tolerance_table(summary))


def tolerance_table(summary: Mapping[str, Any]) -> Table:
    """Table with a row for each line of the tolerance, the worst of the last measurement first."""
    judged = [line_results(cycle) for cycle in summary["cycles"]]
    by_line = [{one.what: one for one in measured} for measured in judged]
    table = FittingTable(title=f"{summary['job']}: tolerance", title_justify="left")
    for name in ("line", "limit", *map(str, range(len(judged)))):
        table.add_column(name, justify="left" if name == "line" else "right")
    table.add_column("last one holds")
    for line in sorted(judged[-1], key=lambda one: -one.excess):
        values = [_figure(found[line.what].value, 2) if line.what in found else "" for found in by_line]
        table.add_row(line.what, f"{line.limit:g} {line.unit}", *values, _holding(line))
    return table


def _holding(line: LineResult) -> str:
    word = "yes" if line.holds else f"no, {line.excess:.3g} times the limit"
    word += f"; {line.ripple_words}" if line.ripple_words else ""
    if line.bound is not None:
        return f"{word}; {line.bound_words}"
    if line.uncertainty is None:
        return word
    return f"{word}; {'not ' if line.unsure else ''}sure: +- {line.uncertainty:.2g} {line.unit}"


def key_table(title: str, rows: Iterable[tuple[str, object]]) -> Table:
    """Table of names and values."""
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold", overflow="fold")
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, str(value))
    return table


def record_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """Table with a header."""
    table = FittingTable(title=title, title_justify="left")
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    return table


def figure_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """Narrow table of names and many columns of figures."""
    table = record_table(title, columns, rows)
    table.box, table.padding, table.pad_edge = SIMPLE_HEAD, (0, 1, 0, 0), False
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def utc_minute(at_s: float) -> str:
    """Format a Unix time, s, with its zone."""
    return f"{datetime.fromtimestamp(at_s, UTC):%Y-%m-%d %H:%M} UTC"


def _interruption(cycle: Mapping[str, Any]) -> str:
    """Return the executed share and the uncertain blocks of an interrupted pass; empty for a whole pass."""
    if cycle.get("how") in {None, "done"}:
        return ""
    text = f"interrupted at {cycle['executed_s'] / cycle['dwell_s']:.0%}"
    uncertain = sum(last - first + 1 for first, last in cycle.get("uncertain") or ())
    return f"{text}, {uncertain} blocks uncertain" if uncertain else text


def _figure(value: object, digits: int) -> str:
    return "" if value is None else f"{float(str(value)):.{digits}f}"


class _JsonOutput:
    """State of the command's JSON object on stdout; there is one at most."""

    is_printed = False


json_output = _JsonOutput()


def emit(
    answer: Mapping[str, Any],
    *,
    as_json: bool,
    table: Callable[[], RenderableType] | None = None,
    lines: Iterable[str] = (),
) -> None:
    """Print JSON on stdout, or a table and lines below it."""
    if as_json:
        json_output.is_printed = True
        say(json_line(answer))
        return
    if table is not None:
        stdout.print(table())
    for line in lines:
        stdout.print(line, markup=False, soft_wrap=True)


def json_line(answer: Mapping[str, Any] | Sequence[Any]) -> str:
    """Return one line of JSON; NaN and infinity are null."""
    return json.dumps(json.loads(json.dumps(answer, default=plain), parse_constant=lambda _: None))
