"""The shop campaign detects each failure that it looks for, and completes a few parts."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.campaigns.shop.__main__ import table
from tests.campaigns.shop.judge import _differences, twice
from tests.campaigns.shop.session import Session

ROW = {
    "session": 0, "parts": 2, "verdicts": {"accepted": 2}, "passes": 3, "torn": 1, "events": 40,
    "kills": {"daemon": 2, "shop": 1}, "releases": 1, "given_back": 1, "resumed": 1, "seconds": 36.0, "wrong": [],
    "date": "2026-01-01", "of": "abcd", "seed": 1,
}  # fmt: skip


def test_a_part_that_two_cells_have_polished_is_found() -> None:
    assert list(twice({"a": {"P-1", "P-2"}, "b": {"P-3"}})) == []
    assert list(twice({"a": {"P-1", "P-2"}, "b": {"P-2"}})) == ["P-2: polished in ['a', 'b']"]


def test_what_is_lost_and_what_is_there_twice_is_found() -> None:
    true = Counter(["one", "two"])
    assert list(_differences("x", Counter(["one", "two"]), true)) == []
    assert list(_differences("x", Counter(["one"]), true)) == ["x: 1 lost, 0 too many: ['two']"]
    assert list(_differences("x", Counter(["one", "two", "two"]), true)) == ["x: 0 lost, 1 too many: ['two']"]


def test_the_page_has_the_sums_of_all_sessions() -> None:
    text = table([ROW, {**ROW, "verdicts": {"accepted": 1, "set aside": 1}, "wrong": ["lost"]}])
    assert "| parts through the shop | 4: 3 accepted, 1 set aside |" in text
    assert "| kill -9 | 4 of a daemon, 2 of a shop |" in text
    assert "| passes, of them interrupted | 6, 2 |" in text
    assert "parts lost | 1 |" in text


@pytest.mark.slow
def test_a_few_parts_come_through_it_and_it_goes_on_where_it_was(tmp_path: Path) -> None:
    for number in range(2):
        came = Session(tmp_path, 7, number, 40.0).run(4, lambda: False, lambda _: None)
        assert came.wrong == []
        assert came.parts == 4
        assert sum(came.kills.values()) > 0
