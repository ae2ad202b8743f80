"""A study goes on where it was, with what was made of the same."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from polishd.config.study import load_study
from polishd.model.errors import ConfigError
from polishd.workbench.studies import loops
from polishd.workbench.studies.kept import RUNS, Case, Kept, made_of
from polishd.workbench.studies.loop import Run
from tests.unit.workbench.studies.test_loops import LOOPS, NONE, study_file


def run_of(case: Case, ended: str = "in_tolerance") -> Run:
    return Run(*case, ended, "", (), 1, (9.0, 1.0), (1.1,), (9.0, 1.1), ((0.5, 1.5, 1.0),), True, 2.0)


@pytest.fixture
def worked(monkeypatch: pytest.MonkeyPatch) -> list[Case]:
    """Cases that were computed, each at once."""
    seen: list[Case] = []

    def work(study: Any, plants: Any, cases: Sequence[Case], jobs: int) -> Any:
        for case in cases:
            seen.append(case)
            yield run_of(case)

    monkeypatch.setattr(loops, "_worked", work)
    return seen


def rows(path: Path, out: Path) -> list[dict[str, Any]]:
    study = load_study(path)
    found = loops.run_loops(study, lambda words: None, seeds=2, jobs=1, kept=Kept(out))  # type: ignore[arg-type]
    return found.as_json()


def test_what_was_done_is_not_done_again(tmp_path: Path, worked: list[Case]) -> None:
    path = study_file(tmp_path, LOOPS + NONE, near=-0.1)
    first = rows(path, tmp_path)
    assert len(worked) == 4
    assert rows(path, tmp_path) == first
    assert len(worked) == 4


def test_what_was_done_with_other_keys_or_another_plant_is(tmp_path: Path, worked: list[Case]) -> None:
    path = study_file(tmp_path, LOOPS + NONE, near=-0.1, far=-0.3)
    rows(path, tmp_path)
    path.write_text(path.read_text().replace('"process.correction" = "none"', '"process.correction" = "linear"'))
    del worked[:]
    rows(path, tmp_path)
    assert {case[1] for case in worked} == {"none"}
    wrong = tmp_path / "wrong" / "far.toml"
    wrong.write_text(wrong.read_text().replace("-0.3", "-0.4"))
    del worked[:]
    rows(path, tmp_path)
    assert {case[0] for case in worked} == {"far"}


def test_a_line_torn_by_a_kill_is_done_again(tmp_path: Path, worked: list[Case]) -> None:
    path = study_file(tmp_path, near=-0.1)
    first = rows(path, tmp_path)
    kept = tmp_path / RUNS
    kept.write_text(kept.read_text()[:-30])
    del worked[:]
    assert rows(path, tmp_path) == first
    assert len(worked) == 1
    assert len(kept.read_text().splitlines()) == 2


def test_a_case_that_ended_in_an_error_is_tried_again(tmp_path: Path) -> None:
    Kept(tmp_path).add(run_of(("a", "b", 1), "error"), "x")
    Kept(tmp_path).add(run_of(("a", "b", 2)), "x")
    kept = Kept(tmp_path)
    assert kept.find(("a", "b", 1), "x") is None
    assert kept.find(("a", "b", 2), "x") == run_of(("a", "b", 2))
    assert kept.find(("a", "b", 2), "y") is None


@pytest.mark.parametrize("line", ["{", "[]", '{"of": "x", "scenario": "a"}', json.dumps({"of": 1, "odd": 2})])
def test_a_line_that_is_none_of_ours_is_told(tmp_path: Path, line: str) -> None:
    (tmp_path / RUNS).write_text(f"{line}\n")
    with pytest.raises(ConfigError, match=r"runs.jsonl:1: is no job of a study; take the line out"):
        Kept(tmp_path)


def test_a_file_that_is_named_counts(tmp_path: Path) -> None:
    (tmp_path / "tif.npz").write_bytes(b"one")
    part = {"process": {"tif": "tif.npz", "rows": ["none"]}}
    first = made_of((part, tmp_path))
    (tmp_path / "tif.npz").write_bytes(b"two")
    assert made_of((part, tmp_path)) != first
    assert made_of((part, tmp_path / "elsewhere")) != first


def test_without_a_folder_nothing_is_kept(tmp_path: Path) -> None:
    kept = Kept(None)
    kept.add(run_of(("a", "b", 1)), "x")
    assert kept.find(("a", "b", 1), "x") is None
    assert not list(tmp_path.iterdir())
