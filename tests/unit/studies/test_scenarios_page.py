"""The page of the scenarios is what a study of them came to."""

from __future__ import annotations

from typing import Any

from docs.reference.naming import put
from docs.reference.scenarios import MARKS, PAGE, tables

ROW = {
    "runs": 4, "accepted": 4, "passes_median": 1.0, "true_rms_nm_median": 1.5, "first_pass_nm_median": 1.8,
    "false_accepts": 0, "forecasts": 6, "held": 5, "first_forecasts": 4, "first_held": 3,
}  # fmt: skip


def row(scenario: str, loop: str, **others: Any) -> dict[str, Any]:
    return {"scenario": scenario, "loop": loop, **ROW, **others}


def test_loops_stand_beside_each_other_and_what_is_slower_is_named() -> None:
    reported = tables([
        row("nothing", "rate"),
        row("nothing", "touched", false_accepts=1),
        row("far", "rate", passes_median=2.0),
        row("far", "touched", passes_median=None, true_rms_nm_median=None, first_held=0),
    ])  # fmt: skip
    assert "| `touched` | 8 | 8 | 1 | 10 of 12, 83% | 3 of 8, 38% | `far` |" in reported
    assert "| `rate` | 8 | 8 | 0 | 10 of 12, 83% | 6 of 8, 75% | none |" in reported
    assert "| `far` | 4 | 4 / 4 | 2 / - | 1.80 / 1.80 | 1.50 / - | 0 / 0 | 3 of 4 / 0 of 4 |" in reported


def test_a_part_that_is_in_tolerance_as_it_comes_takes_no_pass() -> None:
    assert tables([row("good", "rate"), row("good", "machine", passes_median=0.0)]).count("| none |") == 2


def test_what_today_s_loop_never_ends_no_other_is_slower_in() -> None:
    reported = tables([row("far", "rate", passes_median=None), row("far", "machine", passes_median=None)])
    assert reported.count("| none |") == 2


def test_the_page_has_its_marks_once() -> None:
    page = PAGE.read_text()
    assert [page.count(mark) for mark in MARKS] == [1, 1]
    put_anew = put(page, "another table\n", MARKS)
    assert f"{MARKS[0]}another table\n{MARKS[1]}" in put_anew
    assert put_anew.partition(MARKS[0])[0] == page.partition(MARKS[0])[0]
