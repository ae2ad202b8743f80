"""The choice of example cells, the format of a row, the saved results, and one of the rehearsals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.campaigns import result_files
from tests.campaigns.rehearsals.kept import BEGIN, END, PAGE, Kept, text
from tests.campaigns.rehearsals.rehearse import Finding, cells, line, measure

FOUND = Finding("abb_cell.toml", "abb_rws", "rapid", "in_tolerance", 2, 94.3, 8.91, 8.8, 310.2, "")


def test_every_example_with_a_robot_is_rehearsed() -> None:
    robots = ("abb_cell", "kuka_cell", "fanuc_rmi/cell", "universal_robots/cell", "yaskawa/cell", "staubli/cell")
    assert {f"{name}.toml" for name in (*robots, "cell", "two_robots")} <= cells().keys()
    assert "sim.toml" not in cells()


def test_a_row_has_what_was_measured_and_why_a_part_is_not_accepted() -> None:
    head, row = line().split(), line(FOUND).split()
    assert head[0] == "cell"
    assert row == ["abb_cell.toml", "abb_rws", "rapid", "in_tolerance", "2", "94.3", "8.9", "8.8", "310"]
    failed = Finding("x", "abb_rws", "rapid", "failed", 0, None, None, None, 1.0, "LinkError: silent")
    assert line(failed).split()[-6:] == ["-", "-", "-", "1", "LinkError:", "silent"]
    assert FOUND.is_accepted
    assert not failed.is_accepted


def test_a_result_takes_the_place_of_an_older_one_and_is_measured_again_for_other_sources(tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    assert set(kept.left()) == cells().keys()
    kept.add(replace(FOUND, outcome="failed", reason="robot stands"))
    assert "**failed: robot stands**" in text(kept)
    kept.add(FOUND)
    assert [row["outcome"] for row in kept.rows()] == ["in_tolerance"]
    assert "abb_cell.toml" not in kept.left()
    path = tmp_path / "rehearsals.jsonl"
    path.write_text(path.read_text().replace(kept.rows()[0]["of"], "older"))
    assert kept.left()[-1] == "abb_cell.toml"
    assert f"1 of {len(cells())} cells were rehearsed, 1 of them to their tolerance." in text(kept)
    assert "| abb_cell.toml | abb_rws | rapid | in_tolerance | 2 | 94.3 | 8.9 | - | 8.8 | 310 |" in text(kept)


def test_the_page_is_written_from_what_is_kept() -> None:
    assert result_files.written(PAGE, BEGIN, END) == text(Kept())


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["abb_cell.toml", "fanuc_rmi/cell.toml", "universal_robots/cell.toml"])
def test_an_example_reaches_its_tolerance(tmp_path: Path, name: str) -> None:
    finding = measure(name, tmp_path)
    assert finding.is_accepted, line(finding)
    assert finding.last_nm == pytest.approx(finding.true_nm, abs=1.0)
