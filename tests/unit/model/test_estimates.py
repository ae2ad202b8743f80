"""Classes of causes: the page of the docs has each, with what it may be."""

from __future__ import annotations

from pathlib import Path

from docs.reference.naming import BEGIN, END, PAGE, put
from polishd.model.estimates import CAUSES


def test_the_page_has_each_class() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs/explanation/diagnosis.md").read_text()
    for name in CAUSES:
        assert f"| `{name}` |" in text, name


def test_a_table_is_put_between_the_marks_and_nowhere_else() -> None:
    page = f"a\n{BEGIN}old\n{END}\nb\n"
    assert put(page, "new\n") == f"a\n{BEGIN}new\n{END}\nb\n"
    assert put(put(page, "new\n"), "old\n") == page


def test_the_page_s_marks_are_there() -> None:
    assert Path(PAGE).read_text().count(BEGIN) == Path(PAGE).read_text().count(END) == 1
