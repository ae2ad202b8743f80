"""The tables of docs/reference that come from the code are those that ``make reference`` writes."""

from __future__ import annotations

import pytest

from docs.reference.code_tables import FOLDER, PAGES, laid_into


@pytest.mark.parametrize("name", PAGES)
def test_the_tables_of_a_page_are_those_of_the_code(name: str) -> None:
    text = (FOLDER / name).read_text()
    assert laid_into(name, text) == text, "write them anew: make reference"


def test_a_page_that_lacks_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match=r"0 tables begin with .\| method"):
        laid_into("http-api.md", "# HTTP API\n")


def test_a_changed_row_is_replaced() -> None:
    text = (FOLDER / "http-api.md").read_text()
    changed = text.replace("| 403 |", "| yes |", 1)
    assert changed != text
    assert laid_into("http-api.md", changed) == text
