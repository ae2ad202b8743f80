"""``polishd history``: a table for people, JSON for programs, and a picture."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from polishd.cli.history import draw
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.daemon.journal.history import FaultEvent, HistoryMeasurement, JobHistory
from tests.unit.cli_result import Polishd
from tests.unit.daemon.journal.test_history import polished


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """One with two jobs."""
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.state_dir.mkdir()
    polished(files.state_dir, "mirror-1")
    polished(files.state_dir, "mirror-2", outcome=None)
    return files.cell


def test_a_row_a_job_and_what_went_wrong(polishd: Polishd, cell: Path) -> None:
    said = polishd("history", cell)
    assert said.code == 0
    text = " ".join(said.out.split())
    assert "2 jobs (1 in tolerance, 1 under way, or given up); 2 of 2 passes as forecast (expected: 9 of 10)" in text
    assert "1 + 1 torn 20.00 -> 1.50" in text
    assert "LinkError" in text


@pytest.mark.full
def test_for_programs(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    said = polishd("history", cell, "--json", "--out", tmp_path / "h.png")
    first, second = json.loads(said.out)["jobs"]
    assert (first["job"], first["outcome"], second["outcome"]) == ("mirror-1", "in_tolerance", "")
    assert (first["rate"], first["measured"][0]["judged"][0]["holds"]) == (0.9, False)
    assert first["ended"] is not None
    assert second["ended"] is None
    assert (tmp_path / "h.png").read_bytes().startswith(b"\x89PNG")


def test_no_job_yet_is_one_line(polishd: Polishd, tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "a demo", None, 2.0, 4, None).cell
    said = polishd("history", cell)
    assert said.code == 3
    assert f"Run polishd run '{cell}'" in said.err, "it can be copied"


@pytest.mark.full
@pytest.mark.parametrize("jobs", [0, 40])
def test_the_picture_of_nothing_and_of_months(monkeypatch: pytest.MonkeyPatch, jobs: int) -> None:
    monkeypatch.setattr("polishd.rendering.plots.DPI", 30)
    week = 7 * 86400.0
    history = [
        JobHistory(
            k + 1,
            f"j{k}",
            "P",
            k * week,
            k * week + 3600,
            "in_tolerance" if k % 3 else "stalled",
            2,
            0,
            99.0,
            (
                HistoryMeasurement(k * week, 20.0, (), 0.95, 0.01, 1.0, True),
                HistoryMeasurement(k * week + 60, 1.5, (), None, None, None, None),
            ),
            tuple(FaultEvent(k * week, f"kind-{n}", "x") for n in range(k % 9)),
        )
        for k in range(jobs)
    ]
    assert draw("cell", history).startswith(b"\x89PNG")
