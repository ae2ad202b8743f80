"""Results of a study's cases: none is computed twice, incomplete ones are ignored, and the table is complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from polishd.model.errors import ConfigError
from polishd.studies.cases import Case, made_of, versions
from polishd.studies.engine import CaseResult, FinishedCase
from polishd.studies.result_store import JOURNAL, TABLE, ResultStore, read_table


def case(number: int = 0, of: str = "a", **at: Any) -> Case:
    return Case(number, number, at, "nothing", "exact", 1, of)


def done(one: Case, error: str = "", **figures: Any) -> FinishedCase:
    rows = () if error else ({"passes": 1, "rms_nm": [9.0, 0.1 + 0.2], "why": "", **figures},)
    return FinishedCase(one, CaseResult(one.number, rows, error, 2.0, 1.0), 1)


def test_what_is_known_is_found_again_whole_or_from_the_journal(tmp_path: Path) -> None:
    first, second = case(0, "a", force=[1.0, 1.0]), case(1, "b", force=[2.0, 2.0])
    kept = ResultStore(tmp_path)
    kept.add(done(first))
    assert kept.find(second) is None
    again = ResultStore(tmp_path)
    assert again.find(first) is not None, "of the journal"
    again.add(done(second))
    again.merge([first, second], "text")
    assert not (tmp_path / JOURNAL).exists()
    rows, text = read_table(tmp_path)
    assert text == "text"
    assert [(row["case"], row["over.force"], row["rms_nm"]) for row in rows] == [
        (0, 1.0, [9.0, 0.1 + 0.2]),
        (1, 2.0, [9.0, 0.1 + 0.2]),
    ]
    assert json.loads(rows[0]["versions"]) == dict(versions())
    assert ResultStore(tmp_path).find(second) is not None, "of the table"


def test_cases_of_another_study_or_as_it_was_are_counted(tmp_path: Path) -> None:
    kept = ResultStore(tmp_path)
    for number, of in enumerate("abc"):
        kept.add(done(case(number, of)))
    assert kept.count_others([case(0, "a"), case(1, "b"), case(2, "c"), case(3, "d")]) == 0
    assert kept.count_others([case(0, "a"), case(1, "x")]) == 2


def test_a_case_that_moved_in_the_study_is_known_by_what_decides_it(tmp_path: Path) -> None:
    kept = ResultStore(tmp_path)
    kept.add(done(case(0, "a", force=1.0)))
    kept.merge([case(7, "a", force=1.0)], "")
    ((row,), _) = read_table(tmp_path)
    assert row["case"] == 7


def test_a_line_torn_by_a_kill_is_done_again(tmp_path: Path) -> None:
    kept = ResultStore(tmp_path)
    kept.add(done(case(0, "a")))
    kept.add(done(case(1, "b")))
    journal = tmp_path / JOURNAL
    torn = journal.read_text()[:-30]
    journal.write_text(torn)
    (rows, _) = read_table(tmp_path)
    assert [row["case"] for row in rows] == [0], "who shows it leaves it to the study that writes there"
    assert journal.read_text() == torn
    again = ResultStore(tmp_path)
    assert again.find(case(0, "a")) is not None
    assert again.find(case(1, "b")) is None
    again.add(done(case(1, "b")))
    assert len(journal.read_text().splitlines()) == 2


def test_a_case_that_failed_is_a_row_and_is_tried_again(tmp_path: Path) -> None:
    kept = ResultStore(tmp_path)
    kept.add(done(case(0, "a"), "killed its worker: signal 9"))
    assert kept.find(case(0, "a")) is None
    kept.merge([case(0, "a")], "")
    ((row,), _) = read_table(tmp_path)
    assert row["error"] == "killed its worker: signal 9"
    assert ResultStore(tmp_path).find(case(0, "a")) is None
    kept.add(done(case(0, "a")))
    kept.merge([case(0, "a")], "")
    ((row,), _) = read_table(tmp_path)
    assert row["error"] is None


def test_values_of_several_kinds_are_their_json(tmp_path: Path) -> None:
    kept, cases = ResultStore(tmp_path), [case(0, "a", force=1.0), case(1, "b", force="much")]
    for one in cases:
        kept.add(done(one))
    kept.merge(cases, "")
    rows, _ = read_table(tmp_path)
    assert [row["over.force"] for row in rows] == ["1.0", '"much"']


@pytest.mark.parametrize("line", ["{", "[]", '{"of": "x", "rows": []}', json.dumps({"of": "x", "rows": [{"a": 1}]})])
def test_a_line_that_is_no_case_is_refused(tmp_path: Path, line: str) -> None:
    (tmp_path / JOURNAL).write_text(f"{line}\n")
    with pytest.raises(ConfigError, match=r"cases.jsonl:1: no case of a study"):
        ResultStore(tmp_path)


def test_an_invalid_table_and_a_folder_without_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"no {TABLE} and no {JOURNAL}"):
        read_table(tmp_path)
    (tmp_path / TABLE).write_bytes(b"no table")
    with pytest.raises(ConfigError, match=r"cases.parquet: cannot read"):
        ResultStore(tmp_path)


def test_a_file_that_is_named_counts(tmp_path: Path) -> None:
    (tmp_path / "tif.npz").write_bytes(b"one")
    part = {"process": {"tif": "tif.npz", "rows": ["none"]}}
    first = made_of((part, tmp_path))
    (tmp_path / "tif.npz").write_bytes(b"two")
    assert made_of((part, tmp_path)) != first
    assert made_of((part, tmp_path / "elsewhere")) != first


def test_without_a_folder_it_is_kept_in_memory_only(tmp_path: Path) -> None:
    kept = ResultStore(None)
    kept.add(done(case()))
    kept.merge([case()], "")
    assert kept.table(case())[0]["passes"] == 1
    assert not list(tmp_path.iterdir())
