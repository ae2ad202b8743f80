"""Two of the cases of ``make pits``, how results are kept, and their page."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from tests.campaigns import result_files
from tests.campaigns.pits import kept as keeping
from tests.campaigns.pits.cases import CASES, LINKS
from tests.campaigns.pits.judge import MOST_NM, WITHIN, Finding, bound_nm, measure
from tests.campaigns.pits.kept import BEGIN, END, PAGE, Kept, text
from tests.system.sim_rig import ROOT

FOUND = Finding("robot link", "override 50 %", "SafetyStop: slow", 0.2, 0.21, 8.0, 100.0, [], 0.5)
CHECKED: dict[str, Any] = {
    "pit": {"removal_nm": 95.4},
    "removal of the program as it is": "60.2 nm at most",
    "if the actuator misreads its force": "13 N removes 5.0 nm more; one that presses 18 N removes 30.1 nm more",
}


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("link", "fault"),
    [("robot link", "stands, reports running"), ("actuator, Modbus RTU", "spike of 36 N")],
)
def test_a_fault_in_contact_is_noticed_and_the_part_loses_no_more_than_the_check_says(
    tmp_path: Path, link: str, fault: str
) -> None:
    finding = measure(link, fault, tmp_path / "cell")
    assert finding.wrong == [], finding
    assert 0.0 < finding.removed_nm <= WITHIN * finding.bound_nm
    assert finding.notice_s is not None
    assert finding.no_force_s is not None
    assert str(tmp_path) not in finding.noticed


def test_the_bound_is_the_checks_own() -> None:
    assert bound_nm(CHECKED) == 95.4
    assert bound_nm(CHECKED, 60.2) == pytest.approx(30.1)
    assert bound_nm(CHECKED, 120.4) == pytest.approx(60.2)


def test_every_robot_link_has_both_faults_and_every_actuator_a_wrong_force() -> None:
    for name, link in LINKS.items():
        kinds = {fault["what"] for fault in link.faults.values()}
        assert kinds >= ({"stand", "override"} if link.device == "robot" else {"press"}), name


def test_results_are_kept_once_and_those_of_other_sources_are_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Kept(tmp_path).left() == CASES
    monkeypatch.setattr(keeping, "of_case", lambda link: "before")
    Kept(tmp_path).add(FOUND)
    monkeypatch.undo()
    case = (FOUND.link, FOUND.fault)
    assert Kept(tmp_path).left()[-1] == case
    Kept(tmp_path).add(replace(FOUND, removed_nm=9.0))
    [row] = Kept(tmp_path).rows()
    assert (row["removed_nm"], row["of"]) == (9.0, keeping.of_case(FOUND.link))
    assert case not in Kept(tmp_path).left()
    assert Kept(tmp_path).left(again=True)[-1] == case


def test_the_table_says_how_measured_and_bound_relate_and_what_is_not_as_required(tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    kept.add(FOUND)
    kept.add(replace(FOUND, fault="override 0 %", removed_nm=160.0, wrong=["160 nm, more than 150 nm"]))
    table = text(kept)
    assert f"2 of {len(CASES)} cases were measured, 1 of them not as required" in table
    line = "| robot link | 2 | 0.20 | 0.21 | 160.0 | 160 % | none | **override 0 %: 160 nm, more than 150 nm** |"
    assert line in table


@pytest.mark.full
def test_a_sitting_of_no_time_measures_nothing_and_prints_no_row() -> None:
    before = PAGE.read_text()
    command = [sys.executable, "-m", "tests.campaigns.pits", "--minutes", "0", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, timeout=60.0)
    assert done.stdout == "", done.stdout
    assert f"{len(Kept().left())} cases are left" in done.stderr
    assert PAGE.read_text() == before
    assert json.loads(json.dumps(asdict(FOUND)))["removed_nm"] == 8.0


def test_the_page_is_written_of_what_is_kept_and_no_row_is_above_what_is_allowed() -> None:
    assert result_files.written(PAGE, BEGIN, END) == text(Kept())
    for row in Kept().rows():
        assert row["removed_nm"] <= min(MOST_NM, WITHIN * row["bound_nm"]), row
