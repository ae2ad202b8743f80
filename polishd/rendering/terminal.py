"""Tables for people. Programs read ``--json`` instead."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.segment import Segment
from rich.status import Status
from rich.table import Table
from rich.text import Text

from polishd.model.text import printable
from polishd.model.tolerance import LineResult, line_results
from polishd.util.serialization import plain

# What reaches a terminal: text from outside has its control characters escaped here, and nowhere else.


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text on stdout, or on stderr."""
    typer.echo(printable(text), err=err, nl=nl)


def escape_logs() -> None:
    """Escape what this process logs to stderr where no log file is set up."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_Escaped())


class _Escaped(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


WIDE = 160
"""Columns where stdout is no terminal: a file or a pipe should lose no figure."""


class Terminal(Console):
    """Rich's, for text that is not ours: no markup is taken from it, and its control characters are escaped."""

    def __init__(self, **how: Any) -> None:
        super().__init__(markup=False, emoji=False, **how)

    def render_str(self, text: str, **how: Any) -> Text:
        """See Console: what is laid out as wide as it is shown."""
        return super().render_str(printable(text), **how)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """See Console; what moves the cursor comes from rich itself, as ``control``."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def status(self, status: RenderableType, **how: Any) -> Status:
        """See Console."""
        return _Status(status, console=self, **how)


class _Status(Status):
    """Rich's own takes markup from its text."""

    def __init__(self, status: RenderableType, **how: Any) -> None:
        super().__init__(_unmarked(status), **how)

    def update(self, status: RenderableType | None = None, **how: Any) -> None:
        super().update(None if status is None else _unmarked(status), **how)


def _unmarked(status: RenderableType) -> RenderableType:
    return Text(status) if isinstance(status, str) else status


stderr = Terminal(stderr=True)
stdout = Terminal(width=None if sys.stdout is not None and sys.stdout.isatty() else WIDE)


def cycle_table(summary: Mapping[str, Any]) -> Table:
    """One row a measurement: what was measured, and what the pass after it predicted and did."""
    period = float(summary.get("tolerance_period_mm") or 0.0)
    table = Table(title=f"{summary['job']}: {summary['outcome']}", title_justify="left")
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
    if torn := any(map(_torn, summary["cycles"])):
        table.add_column("pass")
    for number, cycle in enumerate(summary["cycles"]):
        figures = [_figure(cycle.get(key), 3 if key == "rate" else 2) for key in columns]
        tool = [cycle.get("tool") or ""] if tools else []
        table.add_row(str(number), *figures, *tool, *([_torn(cycle)] if torn else []))
    return table


def outcome_tables(summary: Mapping[str, Any]) -> RenderableType:
    """The measurements, and below them the drawing's lines: not of a short tolerance that is judged as measured."""
    judged = [one for cycle in summary["cycles"] for one in line_results(cycle)]
    if not judged or (summary.get("tolerance_nm") is not None and all(one.bound is None for one in judged)):
        return cycle_table(summary)
    return Group(cycle_table(summary), tolerance_table(summary))


def tolerance_table(summary: Mapping[str, Any]) -> Table:
    """One row a line of the tolerance: what each measurement had, the worst line of the last one first."""
    judged = [line_results(cycle) for cycle in summary["cycles"]]
    by_line = [{one.what: one for one in measured} for measured in judged]
    table = Table(title=f"{summary['job']}: tolerance", title_justify="left")
    for name in ("line", "limit", *map(str, range(len(judged)))):
        table.add_column(name, justify="left" if name == "line" else "right")
    table.add_column("last one holds")
    for line in sorted(judged[-1], key=lambda one: -one.excess):
        values = [_figure(found[line.what].value, 2) if line.what in found else "" for found in by_line]
        table.add_row(line.what, f"{line.limit:g} {line.unit}", *values, _holding(line))
    return table


def _holding(line: LineResult) -> str:
    word = "yes" if line.holds else f"no, {line.excess:.3g} times the limit"
    if line.bound is not None:
        return f"{word}; {line.bound_words}"
    if line.uncertainty is None:
        return word
    return f"{word}; {'not ' if line.unsure else ''}sure: +- {line.uncertainty:.2g} {line.unit}"


def key_table(title: str, rows: Iterable[tuple[str, object]]) -> Table:
    """Two columns, name and value."""
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in rows:
        table.add_row(name, str(value))
    return table


def record_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """A plain table with a header."""
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    return table


def figure_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """Many columns of figures after a first one of names: without rules between them, to fit a terminal."""
    table = record_table(title, columns, rows)
    table.box, table.padding, table.pad_edge = SIMPLE_HEAD, (0, 1, 0, 0), False
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def _torn(cycle: Mapping[str, Any]) -> str:
    """How much of the pass was executed, where it did not come to its end, and what nobody knows of it."""
    if cycle.get("how") in {None, "done"}:
        return ""
    torn = f"interrupted at {cycle['executed_s'] / cycle['dwell_s']:.0%}"
    uncertain = sum(last - first + 1 for first, last in cycle.get("uncertain") or ())
    return f"{torn}, {uncertain} blocks uncertain" if uncertain else torn


def _figure(value: object, digits: int) -> str:
    return "" if value is None else f"{float(str(value)):.{digits}f}"


def emit(
    answer: Mapping[str, Any],
    *,
    as_json: bool,
    table: Callable[[], RenderableType] | None = None,
    lines: Iterable[str] = (),
) -> None:
    """JSON on stdout for programs; a table for people, and lines below it."""
    if as_json:
        say(json_line(answer))
        return
    if table is not None:
        stdout.print(table())
    for line in lines:
        stdout.print(line, markup=False, soft_wrap=True)


def json_line(answer: Mapping[str, Any] | Sequence[Any]) -> str:
    """One line of JSON; what is no number in it (NaN, infinity) is null."""
    return json.dumps(json.loads(json.dumps(answer, default=plain), parse_constant=lambda _: None))
