"""Document model of the reports, and its writers: one HTML file, or a PDF of A4 pages.

A report is a function from facts to a ``ReportDocument``. ``html`` and ``pdf`` write it.
"""

from __future__ import annotations

import base64
import io
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure as Page
from matplotlib.font_manager import findfont, get_font
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from polishd.rendering.plots import INK, MUTED, RC, RULE, polishd_style

DASH = "–"
"""Text of a figure that is not known."""


class ReportValue(NamedTuple):
    """A figure of the report, with its key in the report's JSON."""

    text: str
    key: str
    """Path in the JSON, joined by dots; an index of a list is a number from 0."""
    value: float

    @classmethod
    def of(cls, answer: Mapping[str, Any], key: str, form: str) -> ReportValue | str:
        """Format the number at a key; a dash if the value is null, not finite or not a number."""
        found: Any = answer
        for step in key.split("."):
            if found is None:
                return DASH
            found = found[int(step)] if isinstance(found, Sequence) else found[step]
        if isinstance(found, bool) or not isinstance(found, int | float) or not math.isfinite(found):
            return DASH
        # "z": never a negative zero
        return cls(format(found, f"z{form}" if form.endswith("f") else form), key, found)


Cell = ReportValue | str


class Table(NamedTuple):
    """Names in the first column, figures or text in the others. Without a head, ``head`` is empty."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]


class Verdict(NamedTuple):
    """Result of a run or of a judgement, and its color."""

    kind: Literal["good", "bad", "plain"]
    text: str


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG picture and its caption."""

    name: str
    caption: str
    content: bytes
    wide: bool = True
    """As wide as the page; otherwise half of it."""

    @property
    def base64(self) -> str:
        """Content for a ``data:`` URL."""
        return base64.b64encode(self.content).decode("ascii")


@dataclass(frozen=True, slots=True)
class DocumentSection:
    """A section of a chapter: tables, then notes, then pictures, then links to files."""

    title: str
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    pictures: Sequence[Picture] = ()
    files: Sequence[str] = ()
    """Paths relative to the report's own folder."""


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter: verdict, title, facts and sections. A fact without a value is not shown."""

    title: str
    facts: Sequence[tuple[str, str]]
    sections: Sequence[DocumentSection]
    verdict: Verdict | None = None


@dataclass(frozen=True, slots=True)
class ReportDocument:
    """A complete report."""

    title: str
    chapters: Sequence[Chapter]
    footer: str
    """Program, version and time: at the end of the HTML page, and at the foot of each PDF page."""
    header: tuple[str, str] = ("", "")
    """Left and right text at the head of each PDF page."""


# HTML: one file with style and pictures inside. It opens offline, refers to no other server, and can be printed.


def html(document: ReportDocument) -> str:
    """Return the HTML page. A figure is a ``<data>`` element with its value and key. Text from files is escaped."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["quote"] = quote
    return environment.get_template("document.html.jinja").render(document=document)


# PDF: A4 pages with searchable text. A table continues on the next page; a picture is never divided.

WIDTH_IN, HEIGHT_IN = 8.27, 11.69
MARGIN_IN = 0.75
INNER_IN = WIDTH_IN - 2 * MARGIN_IN
TEXT_PT = 8.0
LINE_IN = 0.17
LETTER_IN = 0.64 * TEXT_PT / 72
"""Width of a letter at ``TEXT_PT``, rounded up: the columns are laid out by it."""
GAP_IN = 0.2
"""Between two columns."""
PDF_DPI = 200
VERDICT_COLORS = {"good": ("#e3f4ec", "#00664a"), "bad": ("#fbe8df", "#9c3f00"), "plain": ("#e4e8ec", INK)}
"""Background and text color of a verdict."""


def pdf(document: ReportDocument) -> bytes:
    """Return the PDF."""
    return paged(document)[0]


def paged(document: ReportDocument) -> tuple[bytes, int]:
    """Return the PDF and its number of pages."""
    target = io.BytesIO()
    metadata = {"Title": document.title, "Creator": document.footer}
    with polishd_style(), PdfPages(target, metadata=metadata) as written:
        pages = _Pages()
        for chapter in document.chapters:
            pages.add_chapter(chapter)
        for number, page in enumerate(pages.done, 1):
            _add_header(page, document.header)
            foot = _encodable(f"{document.footer}; page {number} of {len(pages.done)}")
            page.text(0.5, 0.4 / HEIGHT_IN, foot, ha="center", fontsize=7, color=MUTED, parse_math=False)
            written.savefig(page, dpi=PDF_DPI)
    return target.getvalue(), len(pages.done)


def _add_header(page: Page, texts: tuple[str, str]) -> None:
    """Write the header above a rule."""
    if not any(texts):
        return
    left, right = MARGIN_IN / WIDTH_IN, 1 - MARGIN_IN / WIDTH_IN
    for text, x, side in zip(texts, (left, right), ("left", "right"), strict=True):
        page.text(x, 1 - 0.45 / HEIGHT_IN, _encodable(text), ha=side, fontsize=7, color=MUTED, parse_math=False)
    y = 1 - 0.52 / HEIGHT_IN
    page.add_artist(Line2D([left, right], [y, y], color=RULE, linewidth=0.6))


@dataclass(slots=True)
class _Pages:
    """Fills pages from top to bottom."""

    done: list[Page] = field(default_factory=list)
    y_in: float = 0.0
    """Free height of the page above its lower margin."""

    def reserve(self, height_in: float) -> None:
        """Begin a new page if this one has less free height."""
        if not self.done or self.y_in < height_in:
            self.done.append(Page(figsize=(WIDTH_IN, HEIGHT_IN)))
            self.y_in = HEIGHT_IN - 2 * MARGIN_IN

    def add_chapter(self, chapter: Chapter) -> None:
        """Begin a page for each chapter."""
        self.y_in = 0.0
        if chapter.verdict is not None:
            self.add_banner(chapter.verdict)
        self.add_text(chapter.title, size=16.0, bold=True, after_in=0.08)
        self.add_table(Table((), [fact for fact in chapter.facts if fact[1]]))
        for section in chapter.sections:
            self.add_section(section)

    def add_banner(self, verdict: Verdict) -> None:
        """Write the verdict across the page, on a colored background."""
        self.reserve(4 * LINE_IN)
        high = 1.9 * LINE_IN
        self.y_in -= high
        background, ink = VERDICT_COLORS[verdict.kind]
        box = MARGIN_IN / WIDTH_IN, (self.y_in + MARGIN_IN) / HEIGHT_IN, INNER_IN / WIDTH_IN, high / HEIGHT_IN
        page = self.done[-1]
        page.add_artist(
            Rectangle(box[:2], *box[2:], facecolor=background, edgecolor="none", transform=page.transFigure)
        )
        x, y = box[0] + 0.12 / WIDTH_IN, box[1] + box[3] / 2
        style: dict[str, Any] = {"fontsize": 11.0, "weight": "bold", "va": "center_baseline", "parse_math": False}
        page.text(x, y, _encodable(verdict.text), color=ink, **style)
        self.y_in -= 0.12

    def add_section(self, section: DocumentSection) -> None:
        """Keep the title with what follows it."""
        self.reserve(1.2 if not section.pictures or section.tables else 3.0)
        self.y_in -= 0.12
        self.add_text(section.title, size=11.0, bold=True, after_in=0.04)
        for table in section.tables:
            self.add_table(table)
        for note in section.notes:
            self.add_text(note, color=MUTED)
        for picture in section.pictures:
            self.add_picture(picture)
        if section.files:
            self.add_text(f"Files: {', '.join(section.files)}", color=MUTED)

    def add_text(
        self, text: str, *, size: float = TEXT_PT, bold: bool = False, color: str = INK, after_in: float = 0.03
    ) -> None:
        """Wrap a text over the width of the page."""
        step = LINE_IN * size / TEXT_PT
        for line in textwrap.wrap(text, int(INNER_IN / (LETTER_IN * size / TEXT_PT) * (1.0 if bold else 1.15))):
            self.reserve(step)
            self.add_line(line, 0.0, size=size, color=color, weight="bold" if bold else "normal")
            self.y_in -= step
        self.y_in -= after_in

    def add_line(self, text: str, x_in: float, *, size: float = TEXT_PT, **style: Any) -> None:
        """Write one line at the present height."""
        y_in = self.y_in + MARGIN_IN - LINE_IN * size / TEXT_PT
        x = (MARGIN_IN + x_in) / WIDTH_IN
        self.done[-1].text(x, y_in / HEIGHT_IN, _encodable(text), fontsize=size, parse_math=False, **style)

    def add_table(self, table: Table) -> None:
        """Repeat the head of the table on each page."""
        rows = [[cell.text if isinstance(cell, ReportValue) else cell for cell in row] for row in table.rows]
        if not rows:
            return
        widths = _column_widths([list(table.head), *rows] if table.head else rows)
        for number, row in enumerate(rows):
            cells = _wrap(row, widths)
            head = _wrap(table.head, widths)
            before = self.y_in
            self.reserve(LINE_IN * (max(map(len, cells)) + max(map(len, head), default=1) + 1))
            if table.head and (number == 0 or self.y_in > before):
                self.add_row(head, widths, MUTED)
            self.add_row(cells, widths, INK)
        self.y_in -= 0.08

    def add_row(self, cells: Sequence[Sequence[str]], widths: Sequence[float], color: str) -> None:
        """Write the first column to the left, the others to the right, and a rule below."""
        top = self.y_in
        starts = [0.0, *accumulate(width + GAP_IN for width in widths)]
        for column, lines in enumerate(cells):
            self.y_in = top
            left = column == 0 or len(cells) == 2
            for line in lines:
                x_in = starts[column] + (0.0 if left else widths[column])
                self.add_line(line, x_in, color=color, ha="left" if left else "right")
                self.y_in -= LINE_IN
        self.y_in = top - LINE_IN * max(map(len, cells))
        y = (self.y_in + MARGIN_IN - 0.04) / HEIGHT_IN
        ends = [MARGIN_IN / WIDTH_IN, (MARGIN_IN + starts[-1] - GAP_IN) / WIDTH_IN]
        self.done[-1].add_artist(Line2D(ends, [y, y], color=RULE, linewidth=0.6))

    def add_picture(self, picture: Picture) -> None:
        """Place a picture and its caption."""
        image = imread(io.BytesIO(picture.content))
        wide = INNER_IN * (1.0 if picture.wide else 0.72)
        high = wide * image.shape[0] / image.shape[1]
        self.reserve(high + 3 * LINE_IN)
        self.y_in -= high
        box = MARGIN_IN / WIDTH_IN, (self.y_in + MARGIN_IN) / HEIGHT_IN, wide / WIDTH_IN, high / HEIGHT_IN
        axes = self.done[-1].add_axes(box)
        axes.imshow(image, aspect="auto", interpolation="none")
        axes.set_axis_off()
        self.add_text(picture.caption, color=MUTED, after_in=0.08)


def _encodable(text: str) -> str:
    """Escape the letters that the font does not have, which would be printed as empty boxes."""
    font = get_font(findfont(RC["font.family"]))
    return "".join(
        letter if font.get_char_index(ord(letter)) else letter.encode("ascii", "backslashreplace").decode()
        for letter in text
    )


def _column_widths(rows: Sequence[Sequence[str]]) -> list[float]:
    """Width of each column by its longest text; the widest columns are narrowed until all fit on the page."""
    widths = [max(len(row[column]) for row in rows) * LETTER_IN for column in range(len(rows[0]))]
    while (over := sum(widths) + GAP_IN * (len(widths) - 1) - INNER_IN) > 1e-9:
        widest = max(range(len(widths)), key=widths.__getitem__)
        least = 10 * LETTER_IN
        if widths[widest] <= least:
            break
        others = [width for width in widths if width < widths[widest]]
        widths[widest] = max(widths[widest] - over, max(others, default=0.0) - LETTER_IN, least)
    return widths


def _wrap(row: Sequence[str], widths: Sequence[float]) -> list[list[str]]:
    return [
        textwrap.wrap(text, max(round(width / LETTER_IN), 4)) or [""]
        for text, width in zip(row, widths, strict=len(row) > 0)
    ]
