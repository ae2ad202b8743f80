"""Comparison of a study's jobs on two commits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pyarrow import Table
from pyarrow.parquet import write_table

from tests.campaigns.claims import Claim
from tests.campaigns.result_files import sources
from tests.campaigns.same_jobs import continued, differences, figures_of

ROW = {
    "case": 1,
    "ended": "in_tolerance",
    "rms_nm": [18.0, 0.7],
    "ripple_nm": float("nan"),
    "cpu_s": 3.0,
    "why": "good",
}


def rows(folder: Path, *found: dict[str, object]) -> Path:
    write_table(Table.from_pylist(list(found)), folder / "cases.parquet")
    return folder


def test_times_and_texts_are_no_figures_and_nan_equals_itself(tmp_path: Path) -> None:
    then = figures_of(rows(tmp_path, ROW, ROW | {"case": 0}))
    now = figures_of(rows(tmp_path, ROW | {"case": 0, "cpu_s": 9.0}, ROW | {"why": "better said"}))
    assert [row["case"] for row in then] == [0, 1]
    assert list(differences(then, now)) == []


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (
            [ROW | {"rms_nm": [18.0, 0.7000000000000001]}],
            "case 1: rms_nm: [18.0, 0.7] then, [18.0, 0.7000000000000001] now",
        ),
        ([ROW | {"more": 1}], "case 1: more: None then, 1 now"),
        ([ROW, ROW], "1 rows then, 2 now"),
    ],
)
def test_each_other_figure_is_a_difference(now: list[dict[str, object]], said: str) -> None:
    assert list(differences([ROW], now)) == [said]


def test_a_claim_goes_on_only_from_the_sources_that_it_was_measured_on(tmp_path: Path) -> None:
    trees = [tmp_path / name for name in ("then", "now")]
    for number, tree in enumerate(trees):
        (tree / "polishd").mkdir(parents=True)
        (tree / "polishd/a.py").write_text(f"A = {number}\n")
    base, now = trees
    one = Claim("a", "README.md", ("polishd",), of=sources(("polishd",), base))
    [other] = continued([one], ["a"], base, "some jobs", now)
    assert (other.is_fresh(now), other.same, other.date) == (True, "some jobs", one.date)
    for claims in ([replace(one, of="old")], []):
        with pytest.raises(ValueError, match="was not measured on the sources of that commit"):
            continued(claims, ["a"], base, "some jobs", now)
