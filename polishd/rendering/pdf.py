"""A report as a PDF of A4 pages: text that can be searched, tables that go on over the page, pictures whole."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure as Page
from matplotlib.font_manager import findfont, get_font
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from polishd.rendering.document import Cell, Chapter, DocumentSection, Picture, ReportDocument, ReportValue, Table
from polishd.rendering.plots import INK, MUTED, RC, RULE, polishd_style

WIDE_IN, HIGH_IN = 8.27, 11.69
MARGIN_IN = 0.75
INNER_IN = WIDE_IN - 2 * MARGIN_IN
TEXT_PT = 8.0
LINE_IN = 0.17
LETTER_IN = 0.64 * TEXT_PT / 72
"""Width of a letter at ``TEXT_PT``, generously: columns are laid out by it."""
GAP_IN = 0.2
"""Between two columns."""
DPI = 200
GOOD, BAD = ("#e3f4ec", "#00664a"), ("#fbe8df", "#9c3f00")
"""Ground and ink of a verdict."""


def pdf(sheet: ReportDocument) -> bytes:
    """The report's pages."""
    return paged(sheet)[0]


def paged(sheet: ReportDocument) -> tuple[bytes, int]:
    """The report's pages, and how many there are."""
    target = io.BytesIO()
    with polishd_style(), PdfPages(target, metadata={"Title": sheet.title, "Creator": sheet.footer}) as written:
        pages = _Pages()
        for chapter in sheet.chapters:
            pages.chapter(chapter)
        for number, page in enumerate(pages.done, 1):
            _head(page, sheet.header)
            _foot(page, f"{sheet.footer}; page {number} of {len(pages.done)}")
            written.savefig(page, dpi=DPI)
    return target.getvalue(), len(pages.done)


def _head(page: Page, words: tuple[str, str]) -> None:
    """A line over a rule."""
    if not any(words):
        return
    left, right = MARGIN_IN / WIDE_IN, 1 - MARGIN_IN / WIDE_IN
    for said, at, side in zip(words, (left, right), ("left", "right"), strict=True):
        page.text(at, 1 - 0.45 / HIGH_IN, _written(said), ha=side, fontsize=7, color=MUTED, parse_math=False)
    y = 1 - 0.52 / HIGH_IN
    page.add_artist(Line2D([left, right], [y, y], color=RULE, linewidth=0.6))


def _foot(page: Page, words: str) -> None:
    page.text(0.5, 0.4 / HIGH_IN, _written(words), ha="center", fontsize=7, color=MUTED, parse_math=False)


@dataclass(slots=True)
class _Pages:
    """Fills pages from top to bottom."""

    done: list[Page] = field(default_factory=list)
    y_in: float = 0.0
    """What is left of the page above its lower margin."""

    def room(self, needed_in: float) -> None:
        """Go on to the next page where this one has not so much left."""
        if not self.done or self.y_in < needed_in:
            self.done.append(Page(figsize=(WIDE_IN, HIGH_IN)))
            self.y_in = HIGH_IN - 2 * MARGIN_IN

    def chapter(self, chapter: Chapter) -> None:
        """On a page of its own."""
        self.y_in = 0.0
        if chapter.verdict:
            self.banner(chapter.verdict, GOOD if chapter.good else BAD)
        self.text(chapter.title, size=16.0, bold=True, after_in=0.08)
        self.table(Table((), [fact for fact in chapter.facts if fact[1]]))
        for part in chapter.parts:
            self.part(part)

    def banner(self, words: str, colours: tuple[str, str]) -> None:
        """Across the page, on a ground of its own: what is read from afar."""
        self.room(4 * LINE_IN)
        high = 1.9 * LINE_IN
        self.y_in -= high
        ground, ink = colours
        box = MARGIN_IN / WIDE_IN, (self.y_in + MARGIN_IN) / HIGH_IN, INNER_IN / WIDE_IN, high / HIGH_IN
        page = self.done[-1]
        page.add_artist(Rectangle(box[:2], *box[2:], facecolor=ground, edgecolor="none", transform=page.transFigure))
        x, y = box[0] + 0.12 / WIDE_IN, box[1] + box[3] / 2
        style: dict[str, Any] = {"fontsize": 11.0, "weight": "bold", "va": "center_baseline", "parse_math": False}
        page.text(x, y, _written(words), color=ink, **style)
        self.y_in -= 0.12

    def part(self, part: DocumentSection) -> None:
        """Its title is never the last line of a page."""
        self.room(1.2 if not part.pictures or part.tables else 3.0)
        self.y_in -= 0.12
        self.text(part.title, size=11.0, bold=True, after_in=0.04)
        for table in part.tables:
            self.table(table)
        for note in part.notes:
            self.text(note, colour=MUTED)
        for picture in part.pictures:
            self.picture(picture)

    def text(
        self, words: str, *, size: float = TEXT_PT, bold: bool = False, colour: str = INK, after_in: float = 0.03
    ) -> None:
        """Lines across the page."""
        step = LINE_IN * size / TEXT_PT
        for line in textwrap.wrap(words, int(INNER_IN / (LETTER_IN * size / TEXT_PT) * (1.0 if bold else 1.15))):
            self.room(step)
            self.put(line, 0.0, size=size, color=colour, weight="bold" if bold else "normal")
            self.y_in -= step
        self.y_in -= after_in

    def put(self, words: str, x_in: float, *, size: float = TEXT_PT, **style: Any) -> None:
        """One line at the place that is next."""
        y_in = self.y_in + MARGIN_IN - LINE_IN * size / TEXT_PT
        x = (MARGIN_IN + x_in) / WIDE_IN
        self.done[-1].text(x, y_in / HIGH_IN, _written(words), fontsize=size, parse_math=False, **style)

    def table(self, table: Table) -> None:
        """Its head stands again on each page that it goes on to."""
        rows = [[_words(cell) for cell in row] for row in table.rows]
        if not rows:
            return
        widths = _widths([list(table.head), *rows] if table.head else rows)
        for number, row in enumerate(rows):
            cells = _wrapped(row, widths)
            high = LINE_IN * max(map(len, cells))
            left = self.y_in
            self.room(high + 2 * LINE_IN)
            if table.head and (number == 0 or self.y_in > left):
                self.row([[name] for name in table.head], widths, MUTED)
            self.row(cells, widths, INK)
        self.y_in -= 0.08

    def row(self, cells: Sequence[Sequence[str]], widths: Sequence[float], colour: str) -> None:
        """Names to the left, all else to the right, with a rule below."""
        top = self.y_in
        starts = [0.0, *accumulate(width + GAP_IN for width in widths)]
        for column, lines in enumerate(cells):
            self.y_in = top
            name = column == 0 or len(cells) == 2
            for line in lines:
                at = starts[column] + (0.0 if name else widths[column])
                self.put(line, at, color=colour, ha="left" if name else "right")
                self.y_in -= LINE_IN
        self.y_in = top - LINE_IN * max(map(len, cells))
        y = (self.y_in + MARGIN_IN - 0.04) / HIGH_IN
        ends = [MARGIN_IN / WIDE_IN, (MARGIN_IN + starts[-1] - GAP_IN) / WIDE_IN]
        self.done[-1].add_artist(Line2D(ends, [y, y], color=RULE, linewidth=0.6))

    def picture(self, picture: Picture) -> None:
        """As wide as the page, or half; with what it shows below."""
        image = imread(io.BytesIO(picture.content))
        wide = INNER_IN * (1.0 if picture.wide else 0.72)
        high = wide * image.shape[0] / image.shape[1]
        self.room(high + 3 * LINE_IN)
        self.y_in -= high
        box = MARGIN_IN / WIDE_IN, (self.y_in + MARGIN_IN) / HIGH_IN, wide / WIDE_IN, high / HIGH_IN
        axes = self.done[-1].add_axes(box)
        axes.imshow(image, aspect="auto", interpolation="none")
        axes.set_axis_off()
        self.text(picture.caption, colour=MUTED, after_in=0.08)


def _written(words: str) -> str:
    """With escapes for the letters that the font does not have: a box in their place says nothing."""
    font = get_font(findfont(RC["font.family"]))
    return "".join(
        letter if font.get_char_index(ord(letter)) else letter.encode("ascii", "backslashreplace").decode()
        for letter in words
    )


def _words(cell: Cell) -> str:
    return cell.text if isinstance(cell, ReportValue) else cell


def _widths(rows: Sequence[Sequence[str]]) -> list[float]:
    """Of each column, by its longest text; the widest gives way where the page is too narrow for all."""
    widths = [max(len(row[column]) for row in rows) * LETTER_IN for column in range(len(rows[0]))]
    over = sum(widths) + GAP_IN * (len(widths) - 1) - INNER_IN
    if over > 0:
        widest = max(range(len(widths)), key=widths.__getitem__)
        widths[widest] = max(widths[widest] - over, 10 * LETTER_IN)
    return widths


def _wrapped(row: Sequence[str], widths: Sequence[float]) -> list[list[str]]:
    return [
        textwrap.wrap(words, max(round(width / LETTER_IN), 4)) or [""] for words, width in zip(row, widths, strict=True)
    ]
