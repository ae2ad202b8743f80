"""A report as one HTML file, style and pictures inside: it opens offline, refers to nothing, and can be printed."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from polishd.show.sheet import ReportDocument


def templates(*folders: Path) -> Environment:
    """Templates of these folders, and those beside this file: what comes from files is escaped."""
    return Environment(
        loader=FileSystemLoader([*folders, Path(__file__).parent]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def html(sheet: ReportDocument) -> str:
    """The page. Each figure is a ``<data>`` element: its text for people, its value and key for programs."""
    return templates().get_template("sheet.html.jinja").render(sheet=sheet)
