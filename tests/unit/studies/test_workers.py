"""A worker of studies, in this process: it computes each case, and refuses what is no longer the same."""

from __future__ import annotations

import io
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from polishd.config.sweep import load_swept
from polishd.plugins.rnc_robot.gcode import jit
from polishd.studies.cases import Case, cases_of, versions
from polishd.studies.workers import start_worker
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
    """Of a worker in this process."""
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
