"""Document model of the reports, and its writers: one HTML file, or a PDF of A4 pages.

A report is a function from facts to a ``ReportDocument``. ``html`` and ``pdf`` write it.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate, zip_longest
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure as Page
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import FT2Font
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from polishd.rendering.plots import INK, MUTED, PAGE_DPI, PAGE_IN, RC, RULE, polishd_style

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
    """A PNG picture and its caption, as wide as the page (``plots.PAGE_IN``)."""

    name: str
    caption: str
    content: bytes

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
MARGIN_IN = (WIDTH_IN - PAGE_IN) / 2
TEXT_PT, SMALL_PT = 8.5, 8.0
"""Size of the text, and of notes, captions, header and footer."""
SPACING = 1.36
"""Height of a line over the size of its text."""
GAP_IN = 0.2
"""Between two columns."""
NARROWEST_IN = 0.8
"""Width that a column keeps."""
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
            page.text(0.5, 0.4 / HEIGHT_IN, foot, ha="center", fontsize=SMALL_PT, color=MUTED, parse_math=False)
            written.savefig(page, dpi=PAGE_DPI)
    return target.getvalue(), len(pages.done)


def _add_header(page: Page, texts: tuple[str, str]) -> None:
    """Write the header above a rule."""
    if not any(texts):
        return
    left, right = MARGIN_IN / WIDTH_IN, 1 - MARGIN_IN / WIDTH_IN
    for text, x, side in zip(texts, (left, right), ("left", "right"), strict=True):
        page.text(x, 1 - 0.45 / HEIGHT_IN, _encodable(text), ha=side, fontsize=SMALL_PT, color=MUTED, parse_math=False)
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
        self.add_facts([fact for fact in chapter.facts if fact[1]])
        for section in chapter.sections:
            self.add_section(section)

    def add_banner(self, verdict: Verdict) -> None:
        """Write the verdict across the page, on a colored background."""
        background, ink = VERDICT_COLORS[verdict.kind]
        lines = _wrap(verdict.text, PAGE_IN - 0.24, 12.0, bold=True)
        step = _line_in(12.0)
        high = step * len(lines) + 0.16
        self.reserve(high + 0.5)
        page = self.done[-1]
        corner = MARGIN_IN / WIDTH_IN, (self.y_in - high + MARGIN_IN) / HEIGHT_IN
        box = Rectangle(corner, PAGE_IN / WIDTH_IN, high / HEIGHT_IN, transform=page.transFigure)
        box.set(facecolor=background, edgecolor="none")
        page.add_artist(box)
        self.y_in -= 0.06
        for line in lines:
            self.add_line(line, 0.12, size=12.0, color=ink, weight="bold")
            self.y_in -= step
        self.y_in -= 0.22

    def add_facts(self, facts: Sequence[tuple[str, str]]) -> None:
        """Write names and values in two columns."""
        half = (len(facts) + 1) // 2
        names_in = [_widest([name for name, _ in column]) for column in (facts[:half], facts[half:])]
        column_in = (PAGE_IN - GAP_IN) / 2
        for pair in zip_longest(facts[:half], facts[half:], fillvalue=("", "")):
            cells = [
                _wrap(value, column_in - name_in - 0.12, TEXT_PT)
                for (_, value), name_in in zip(pair, names_in, strict=True)
            ]
            self.reserve(_line_in(TEXT_PT) * max(map(len, cells)))
            top = self.y_in
            for column, ((name, _), lines) in enumerate(zip(pair, cells, strict=True)):
                left_in = column * (column_in + GAP_IN)
                self.y_in = top
                self.add_line(name, left_in, color=MUTED)
                for line in lines:
                    self.add_line(line, left_in + names_in[column] + 0.12)
                    self.y_in -= _line_in(TEXT_PT)
            self.y_in = top - _line_in(TEXT_PT) * max(map(len, cells)) - 0.02
        self.y_in -= 0.06

    def add_section(self, section: DocumentSection) -> None:
        """Keep the title with what follows it."""
        first_in = _picture_in(section.pictures[0])[0] if section.pictures and not section.tables else 0.6
        self.reserve(first_in + 0.7)
        self.y_in -= 0.1
        self.add_text(section.title, size=11.0, bold=True, after_in=0.05)
        for table in section.tables:
            self.add_table(table)
        for note in section.notes:
            self.add_text(note, size=SMALL_PT, color=MUTED)
        for picture in section.pictures:
            self.add_picture(picture)
        if section.files:
            self.add_text(f"Files: {', '.join(section.files)}", size=SMALL_PT, color=MUTED)

    def add_text(
        self, text: str, *, size: float = TEXT_PT, bold: bool = False, color: str = INK, after_in: float = 0.03
    ) -> None:
        """Wrap a text over the width of the page."""
        for line in _wrap(text, PAGE_IN, size, bold=bold):
            self.reserve(_line_in(size))
            self.add_line(line, 0.0, size=size, color=color, weight="bold" if bold else "normal")
            self.y_in -= _line_in(size)
        self.y_in -= after_in

    def add_line(self, text: str, x_in: float, *, size: float = TEXT_PT, **style: Any) -> None:
        """Write one line at the present height."""
        y_in = self.y_in + MARGIN_IN - size / 72
        x = (MARGIN_IN + x_in) / WIDTH_IN
        self.done[-1].text(x, y_in / HEIGHT_IN, _encodable(text), fontsize=size, parse_math=False, **style)

    def add_table(self, table: Table) -> None:
        """Repeat the head of the table on each page."""
        rows = [[cell.text if isinstance(cell, ReportValue) else cell for cell in row] for row in table.rows]
        if not rows:
            return
        widths = _column_widths([list(table.head), *rows] if table.head else rows)
        head = _wrap_row(table.head, widths) if table.head else []
        for number, row in enumerate(rows):
            cells = _wrap_row(row, widths)
            before = self.y_in
            self.reserve(_line_in(TEXT_PT) * (max(map(len, cells)) + max(map(len, head), default=0)) + 0.14)
            if head and (number == 0 or self.y_in > before):
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
                self.y_in -= _line_in(TEXT_PT)
        self.y_in = top - _line_in(TEXT_PT) * max(map(len, cells)) - 0.04
        y = (self.y_in + MARGIN_IN + 0.02) / HEIGHT_IN
        ends = [MARGIN_IN / WIDTH_IN, (MARGIN_IN + starts[-1] - GAP_IN) / WIDTH_IN]
        self.done[-1].add_artist(Line2D(ends, [y, y], color=RULE, linewidth=0.6))

    def add_picture(self, picture: Picture) -> None:
        """Place a picture and its caption."""
        high, image = _picture_in(picture)
        caption = _wrap(picture.caption, PAGE_IN, SMALL_PT)
        self.reserve(high + _line_in(SMALL_PT) * len(caption))
        self.y_in -= high
        box = MARGIN_IN / WIDTH_IN, (self.y_in + MARGIN_IN) / HEIGHT_IN, PAGE_IN / WIDTH_IN, high / HEIGHT_IN
        axes = self.done[-1].add_axes(box)
        axes.imshow(image, aspect="auto", interpolation="none")
        axes.set_axis_off()
        self.add_text(picture.caption, size=SMALL_PT, color=MUTED, after_in=0.06)


def _picture_in(picture: Picture) -> tuple[float, Any]:
    """Return the height of a picture that is as wide as the page, and its samples."""
    image = imread(io.BytesIO(picture.content))
    return PAGE_IN * image.shape[0] / image.shape[1], image


# Text is laid out by its width in the font that the PDF is written in.


@lru_cache
def _font(*, bold: bool) -> FT2Font:
    return get_font(findfont(FontProperties(family=RC["font.family"], weight="bold" if bold else "normal")))


def _encodable(text: str) -> str:
    """Escape the letters that the font does not have, which would be printed as empty boxes."""
    font = _font(bold=False)
    return "".join(
        letter if font.get_char_index(ord(letter)) else letter.encode("ascii", "backslashreplace").decode()
        for letter in text
    )


def _line_in(size: float) -> float:
    return SPACING * size / 72


@lru_cache(maxsize=4096)
def _text_in(text: str, size: float, *, bold: bool = False) -> float:
    """Width of a text."""
    font = _font(bold=bold)
    font.set_size(size, 72)
    font.set_text(_encodable(text))
    return float(font.get_width_height()[0]) / 64 / 72


def _widest(texts: Sequence[str]) -> float:
    return max((_text_in(text, TEXT_PT) for text in texts), default=0.0)


def _column_widths(rows: Sequence[Sequence[str]]) -> list[float]:
    """Width of each column by its longest text; the widest columns are narrowed until all fit on the page.

    A column keeps its longest word in one line as long as others can be narrowed.
    """
    columns = [[row[column] for row in rows] for column in range(len(rows[0]))]
    widths = [_widest(column) + 0.01 for column in columns]
    words = [_widest([word for text in column for word in text.split()]) + 0.01 for column in columns]
    for least in (words, [NARROWEST_IN] * len(widths)):
        while (over := sum(widths) + GAP_IN * (len(widths) - 1) - PAGE_IN) > 1e-9:
            some = [at for at, width in enumerate(widths) if width > least[at] + 1e-6]
            if not some:
                break
            widest = max(some, key=widths.__getitem__)
            others = max((width for width in widths if width < widths[widest]), default=0.0)
            widths[widest] = max(widths[widest] - over, others - 0.05, least[widest])
    return widths


def _wrap_row(row: Sequence[str], widths: Sequence[float]) -> list[list[str]]:
    return [_wrap(text, width, TEXT_PT) for text, width in zip(row, widths, strict=True)]


def _wrap(text: str, width_in: float, size: float, *, bold: bool = False) -> list[str]:
    """Divide a text into lines of a width: between words, and within a word that is wider."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if _text_in(longer, size, bold=bold) <= width_in:
            lines[-1] = longer
            continue
        if lines[-1]:
            lines.append("")
        for letter in word:
            if lines[-1] and _text_in(lines[-1] + letter, size, bold=bold) > width_in:
                lines.append("")
            lines[-1] += letter
    return lines
