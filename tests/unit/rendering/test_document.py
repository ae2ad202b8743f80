"""The document model and its writers: figures with their keys, verdicts, sections, and pages of a PDF."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from polishd.rendering.document import (
    DASH,
    GAP_IN,
    Chapter,
    DocumentSection,
    ReportDocument,
    ReportValue,
    Table,
    Verdict,
    _column_widths,
    _text_in,
    _wrap,
    html,
    paged,
)
from polishd.rendering.plots import PAGE_IN

PACKAGE = Path(__file__).resolve().parents[3] / "polishd"


def document(*sections: DocumentSection, verdict: Verdict | None = None) -> ReportDocument:
    return ReportDocument("title", [Chapter("chapter", [("known", "1"), ("not known", "")], sections, verdict)], "foot")


@pytest.mark.parametrize(
    ("value", "form", "shown"), [(1.25, ".1f", "1.2"), (3, "d", "3"), (-1e-9, ".2f", "0.00"), (2e5, ".3g", "2e+05")]
)
def test_a_figure_has_text_key_and_value(value: float, form: str, shown: str) -> None:
    assert ReportValue.of({"a": [{"b": value}]}, "a.0.b", form) == (shown, "a.0.b", value)


@pytest.mark.parametrize("value", [None, math.nan, math.inf, "high", True])
def test_what_is_not_a_number_is_a_dash(value: object) -> None:
    assert ReportValue.of({"a": value}, "a", ".1f") == DASH
    assert ReportValue.of({"a": None}, "a.b", ".1f") == DASH


def test_a_wrong_key_is_an_error() -> None:
    with pytest.raises(KeyError):
        ReportValue.of({"a": 1.0}, "b", ".1f")


@pytest.mark.parametrize("kind", ["good", "bad", "plain"])
def test_a_verdict_has_its_class_and_its_banner(kind: str) -> None:
    with_verdict = document(verdict=Verdict(kind, "text"))  # type: ignore[arg-type]
    assert f'<p class="verdict {kind}">text</p>' in html(with_verdict)
    assert paged(with_verdict)[1] == 1


def test_what_is_empty_is_not_on_the_page() -> None:
    page = html(document(DocumentSection("section")))
    assert not re.search("<table|<figure|<img|<p |not known", page)
    assert page.endswith("</html>\n")


def test_a_figure_of_a_table_is_a_data_element() -> None:
    table = Table(("name", "figure"), [("a", ReportValue("1.2", "a.0", 1.25)), ("b", DASH)])
    assert '<td><data value="1.25" data-key="a.0">1.2</data></td>' in html(document(DocumentSection("s", [table])))


def test_a_link_is_relative_and_quoted() -> None:
    page = html(document(DocumentSection("s", files=["cycle-00/a b.rnc"])))
    assert '<a href="cycle-00/a%20b.rnc">a b.rnc</a>' in page


def test_a_long_table_goes_on_to_the_next_pages() -> None:
    table = Table(("term", "value"), [(str(row), "x") for row in range(150)])
    assert paged(document(DocumentSection("s", [table])))[1] == 4


def test_a_table_with_many_long_columns_fits_on_the_page() -> None:
    widths = _column_widths([["x" * 60, "y" * 55, "z" * 5, "w" * 50]])
    assert sum(widths) + 3 * GAP_IN <= PAGE_IN + 1e-6
    assert widths[2] == pytest.approx(min(widths)), "a short column keeps its width"


def test_the_longest_word_of_a_column_stays_in_one_line() -> None:
    name, digest = "cycle-00/registration.json", "0" * 64
    for text, width in zip((name, digest), _column_widths([[name, digest]]), strict=True):
        assert _wrap(text, width, 8.5) == [text]


@pytest.mark.parametrize("text", ["WWWW MMMM " * 40, "W" * 300, "iiii llll " * 40, "", "a  b"])
@pytest.mark.parametrize("bold", [True, False])
def test_no_line_is_wider_than_its_column(text: str, *, bold: bool) -> None:
    lines = _wrap(text, 2.0, 12.0, bold=bold)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert all(_text_in(line, 12.0, bold=bold) <= 2.0 for line in lines)


def test_all_reports_have_one_template_and_one_style() -> None:
    kinds = ("*.jinja", "*.css")
    found = [path.relative_to(PACKAGE).as_posix() for kind in kinds for path in PACKAGE.rglob(kind)]
    own = [name for name in found if not name.startswith("web/")]
    assert own == ["rendering/document.html.jinja", "rendering/report.css"]
