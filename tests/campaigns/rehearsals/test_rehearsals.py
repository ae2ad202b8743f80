"""Which example cells are rehearsed, how a row reads, and one of the rehearsals."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaigns.rehearsals.rehearse import Finding, cells, line, measure

FOUND = Finding("abb_cell.toml", "abb_rws", "rapid", "in_tolerance", 2, 94.3, 8.91, 8.8, 310.2, "")


def test_every_example_with_a_robot_is_rehearsed() -> None:
    assert {"abb_cell.toml", "kuka_cell.toml", "fanuc_rmi/cell.toml", "cell.toml", "two_robots.toml"} <= cells().keys()
    assert "sim.toml" not in cells()


def test_a_row_has_what_was_measured_and_why_a_part_is_not_accepted() -> None:
    head, row = line().split(), line(FOUND).split()
    assert head[0] == "cell"
    assert row == ["abb_cell.toml", "abb_rws", "rapid", "in_tolerance", "2", "94.3", "8.9", "8.8", "310"]
    failed = Finding("x", "abb_rws", "rapid", "failed", 0, None, None, None, 1.0, "LinkError: silent")
    assert line(failed).split()[-6:] == ["-", "-", "-", "1", "LinkError:", "silent"]
    assert FOUND.is_accepted
    assert not failed.is_accepted


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(1800)
def test_the_abb_example_reaches_its_tolerance(tmp_path: Path) -> None:
    finding = measure("abb_cell.toml", tmp_path)
    assert finding.is_accepted, line(finding)
    assert finding.last_nm == pytest.approx(finding.true_nm, abs=1.0)
