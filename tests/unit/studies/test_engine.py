"""The engine over a pool of processes, and its worker in this process.

A case that raises, hangs or kills its worker is an answer, and stops nothing else. A worker computes each case, and
refuses what is no longer the same.
"""

from __future__ import annotations

import io
from concurrent.futures import Future
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from polishd.config.sweep import load_swept
from polishd.model.errors import ConfigError
from polishd.plugins.rnc_robot.gcode import jit
from polishd.studies import engine
from polishd.studies.cases import Case, cases_of, versions
from polishd.studies.engine import CaseResult, FinishedCase, LocalPool, Task, start_worker, work
from polishd.util import array_stream
from polishd.util.worker_main import serve
from tests.unit.studies.studies import TABLE_III, variant

SPOT = """
kind = "spots"
title = "t"
[spots.one]
size_mm = 20.0
rpm = 1000.0
force_n = 12.0
dip_deg = 15.0
[[sweep.group]]
over."process.tool_modulus_mpa" = [4.0, 5.0]
over.seconds = [30.0, 60.0]
"""

ODD = "tests.unit.studies.faulty_worker"


@pytest.fixture(autouse=True)
def _interpreter_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker compiles for small programs, too; the other tests of this process must not."""
    monkeypatch.setattr(jit, "LARGE_BYTES", jit.LARGE_BYTES)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(SPOT)
    return path


def answers(study: Path, *cases: Case) -> list[dict[str, Any]]:
    """Return the answers of a worker in this process."""
    requests, found = io.BytesIO(), io.BytesIO()
    for case in cases:
        array_stream.write(requests, {"study": str(study), "run": "r", "case": asdict(case)})
    requests.seek(0)
    stated, answer = start_worker()
    assert stated == {"versions": dict(versions())}
    serve(answer, requests, found)
    found.seek(0)
    return [message for message, _ in iter(lambda: array_stream.read(found), None)]


def test_rows_are_those_of_the_case(study: Path) -> None:
    cases = cases_of(load_swept(study))
    assert len(cases) == 4
    found = answers(study, *cases)
    volumes = [one["rows"][0]["volume_mm3"] for one in found]
    assert volumes[1] == pytest.approx(2 * volumes[0])
    assert volumes[3] == pytest.approx(2 * volumes[2])
    assert volumes[0] != volumes[2]
    assert [len(one["rows"]) for one in found] == [2, 2, 2, 2], "both readings of the size"
    assert all(one["wall_s"] > 0 for one in found)


def test_a_study_that_was_changed_is_refused(study: Path) -> None:
    case = cases_of(load_swept(study))[0]
    study.write_text(SPOT.replace("1000.0", "900.0"))
    (refused,) = answers(study, case)
    assert "has changed since the study began" in refused["error"]
    (refused,) = answers(study, replace(case, of="other"))
    assert "error" in refused


def test_what_cannot_be_computed_is_that_cases_own(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_III)
    path.write_text(path.read_text() + '\n[[sweep.group]]\nover."spots.1.size_mm" = [0.001, 40.0]\n')
    found = answers(path, *cases_of(load_swept(path)))
    assert "ConfigError" in found[0]["failed"]
    assert len(found[1]["rows"]) == 12


@pytest.fixture(autouse=True)
def odd(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers with scripted results."""
    monkeypatch.setattr(engine, "TARGET", f"{ODD}:start")


def cases(*what: str) -> list[Case]:
    return [Case(k, k, {"what": one}, None, None, None, str(k)) for k, one in enumerate(what)]


def worked(folder: Path, some: list[Case], workers: int = 2, within_s: float = 60.0) -> dict[int, FinishedCase]:
    with LocalPool(workers) as pool:
        return {done.case.number: done for done in work(folder / "study.toml", some, pool, within_s)}


@pytest.mark.full
def test_all_cases_come_each_once(tmp_path: Path) -> None:
    found = worked(tmp_path, cases(*[""] * 200))
    assert sorted(found) == list(range(200))
    assert all(done.answer.rows == ({"rms_nm": number / 3},) for number, done in found.items())
    assert all(done.tries == 1 for done in found.values())


@pytest.mark.full
def test_a_case_that_raises_or_kills_its_worker_is_retried_once_and_reported(tmp_path: Path) -> None:
    found = worked(tmp_path, cases("", "raises", "", "dies", "", "once dies", "once raises", ""))
    assert {number: done.answer.error for number, done in found.items() if done.answer.error} == {
        1: "ValueError: no",
        3: "the study worker was ended by SIGKILL (is the computer out of memory?): out of luck",
    }
    assert [found[number].tries for number in range(8)] == [1, 2, 1, 2, 1, 2, 2, 1]
    assert all(found[number].answer.rows for number in (0, 2, 4, 5, 6, 7))


@pytest.mark.full
def test_what_hangs_is_killed_at_its_limit(tmp_path: Path) -> None:
    found = worked(tmp_path, cases("", "hangs", ""), workers=1, within_s=0.5)
    assert found[1].answer.error.startswith("the study worker exceeded its limit: ")
    assert found[0].answer.rows
    assert found[2].answer.rows


class Lonely(LocalPool):
    """An executor without workers until the lack is reported."""

    def __init__(self) -> None:
        super().__init__(1)
        self.lack, self.said, self.given = "no worker at x", list[str](), list[tuple[Task, Future[list[CaseResult]]]]()

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        self.given.append((task, Future()))
        return self.given[-1][1]

    def come(self, words: str) -> None:
        """A read starts one."""
        self.said.append(words)
        self.lack = ""
        for task, future in self.given:
            if not future.done():
                future.set_result([CaseResult(case.number, ({},)) for case in task.cases])


def test_a_lack_of_workers_is_reported_once_and_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "LOOK_S", 0.05)
    with Lonely() as lonely:
        (done,) = work(tmp_path / "study.toml", cases(""), lonely, report_wait=lonely.come)
    assert done.answer.rows == ({},)
    assert lonely.said == ["no worker at x; the study waits", "a worker is there; the study continues"]


@pytest.mark.full
def test_one_that_is_slow_is_not_called_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "LOOK_S", 0.05)
    said: list[str] = []
    with LocalPool(1) as pool:
        found = list(work(tmp_path / "study.toml", cases("hangs"), pool, 0.3, said.append))
    assert "limit 0.3 s" in found[0].answer.error
    assert not said


@pytest.mark.full
def test_a_refusal_ends_the_study(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="files differ"):
        worked(tmp_path, cases("", "refuses", ""))


@pytest.mark.full
def test_other_versions_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "TARGET", f"{ODD}:start_with_other_versions")
    with pytest.raises(ConfigError, match=rf"other versions: scipy 0\.1 for {versions()['scipy']}; install the same"):
        worked(tmp_path, cases(""))


@pytest.mark.full
def test_a_worker_that_does_not_start_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "TARGET", f"{ODD}:start_in_vain")
    with pytest.raises(ConfigError, match="did not start: ended with exit code 1: ModuleNotFoundError"):
        worked(tmp_path, cases(""))


@pytest.mark.full
def test_leaving_in_the_middle_leaves_no_process(tmp_path: Path) -> None:
    pool = LocalPool(2)
    with pool:
        for _ in work(tmp_path / "study.toml", cases("", "hangs", "hangs"), pool):
            break
        alive: list[Any] = list(pool._children._all)
        assert alive
    assert not any(worker.alive for worker in alive)
