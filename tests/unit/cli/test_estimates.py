"""``polishd estimates``: a cell's estimates, for people and for programs, and how they are forgotten."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.daemon.job import initial_estimates
from polishd.daemon.runtime.exit_record import locked
from polishd.model.estimates import Estimate, Estimates, MachineEstimates
from polishd.pipeline.records import EstimatesInUse
from tests.unit.cli_result import Polishd
from tests.unit.daemon.job.test_initial_estimates_remembering import journal_of

TOOL = {"estimates.tool": "bonnet 7"}
MACHINE = MachineEstimates(
    Estimate(0.82, 0.01),
    applied={"offset_x": 0.4},
    mean={"rate": -0.2, "offset_x": 0.4},
    covariance=((1e-4, 0.0), (0.0, 9e-4)),
)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """One with two jobs of one tool, and one of another."""
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.state_dir.mkdir()
    taught(files.state_dir, "mirror-1", {}, Estimates(Estimate(0.7)))
    taught(files.state_dir, "mirror-2", TOOL, MACHINE)
    taught(files.state_dir, "mirror-3", {}, Estimates(Estimate(0.9, 0.004)))
    return files.cell


def taught(state_dir: Path, name: str, terms: dict[str, str], beliefs: Estimates, *, stops: bool = False) -> None:
    with journal_of(state_dir, name, terms) as journal:
        journal.begin_pass(0, "sha", "boot", 10)
        journal.end_pass(0, "done")
        found = [{"kind": "drift", "what": "x", "stops": "cell"}] if stops else []
        journal.add_facts(0, {**initial_estimates.facts(terms, EstimatesInUse(beliefs, 0.0071)), "findings": found})


def test_the_last_lesson_of_each_tool_and_all_that_identification_believes(polishd: Polishd, cell: Path) -> None:
    said = polishd("estimates", "show", cell)
    assert said.code == 0
    text = " ".join(said.out.split())
    assert "- mirror-3 1 20" in text
    assert "0.900 0.004 7.1" in text
    assert "bonnet 7 mirror-2 1 20" in text
    assert "0.820 0.010 7.1 2 parameters" in text
    assert "offset_x 0.4 0.03 0.4" in text
    assert "mirror-1" not in text


def test_for_programs(polishd: Polishd, cell: Path) -> None:
    answer = json.loads(polishd("estimates", "show", cell, "--json").out)
    assert answer["remember"] is True
    assert [(one["job"], one["tool"]) for one in answer["beliefs"]] == [("mirror-3", ""), ("mirror-2", "bonnet 7")]
    assert answer["beliefs"][1]["believed"]["removal"]["applied"] == {"offset_x": 0.4}


def test_a_tool_that_a_person_had_to_see_to_is_another_one(polishd: Polishd, cell: Path) -> None:
    taught(cell.parent / "state", "mirror-4", {}, Estimates(Estimate(0.5)), stops=True)
    (one,) = json.loads(polishd("estimates", "show", cell, "--json").out)["beliefs"]
    assert one["tool"] == "bonnet 7"


def test_forgetting(polishd: Polishd, cell: Path) -> None:
    said = polishd("estimates", "forget", cell, "--reason", "another pad")
    assert "the next job starts without estimates" in " ".join(said.out.split())
    assert json.loads(polishd("estimates", "show", cell, "--json").out)["beliefs"] == []
    assert "there are no estimates" in polishd("estimates", "show", cell).out


def test_a_cell_whose_daemon_runs_goes_on_with_what_it_knows(polishd: Polishd, cell: Path) -> None:
    with locked(cell.parent / "state"):
        said = polishd("estimates", "forget", cell)
        assert said.code == 3
        assert "another polishd runs this cell" in said.err
        assert len(json.loads(polishd("estimates", "show", cell, "--json").out)["beliefs"]) == 2, (
            "reading disturbs no daemon"
        )


def test_a_cell_that_is_set_not_to_remember_says_so(polishd: Polishd, cell: Path) -> None:
    cell.write_text(cell.read_text().replace("# use_previous = true", "use_previous = false"))
    assert "estimates.use_previous is false" in polishd("estimates", "show", cell).out
