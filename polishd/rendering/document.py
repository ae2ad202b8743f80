"""What people look at: tables, and the style of pictures."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

# A report as what it says: parts with tables, pictures and notes. ``sheet_html`` and ``sheet_pdf`` write it down.


class ReportValue(NamedTuple):
    """A number of the report, and where a program finds it."""

    text: str
    key: str
    """Dotted, in the answer that ``--json`` gives; places in lists are numbers from 0."""
    value: float

    @classmethod
    def of(cls, answer: Mapping[str, Any], key: str, form: str) -> ReportValue | str:
        """What stands there, in this format; a dash where there is nothing, or no finite number."""
        found: Any = answer
        for step in key.split("."):
            if found is None:
                return "–"
            found = found[int(step)] if isinstance(found, Sequence) else found[step]
        if found is None or not math.isfinite(found):
            return "–"
        # no figure is a negative zero
        return cls(format(found, f"z{form}" if form.endswith("f") else form), key, found)


Cell = ReportValue | str


class Table(NamedTuple):
    """Names in the first column, figures or words in the others."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawn picture (PNG) and what it shows."""

    name: str
    caption: str
    content: bytes
    wide: bool = True

    @property
    def base64(self) -> str:
        """The content as it stands inside a page."""
        return base64.b64encode(self.content).decode("ascii")


@dataclass(frozen=True, slots=True)
class DocumentSection:
    """A part of a report: its tables, then its notes, then its pictures."""

    title: str
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True, slots=True)
class Chapter:
    """What a report says of one thing, with the verdict over it, where there is one."""

    title: str
    facts: Sequence[tuple[str, str]]
    parts: Sequence[DocumentSection]
    verdict: str = ""
    good: bool = True


@dataclass(frozen=True, slots=True)
class ReportDocument:
    """A whole report."""

    title: str
    chapters: Sequence[Chapter]
    footer: str
    """Who made it, and when: at the end of the page, and at the foot of each of a PDF's."""
    header: tuple[str, str] = ("", "")
    """Left and right at the head of each of a PDF's pages; empty: nothing."""


# A report as one HTML file, style and pictures inside: it opens offline, refers to nothing, and can be printed.


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
    return templates().get_template("document.html.jinja").render(sheet=sheet)
