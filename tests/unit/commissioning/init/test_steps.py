"""``polishd init --status``: the state of a cell follows from the files on disk, step by step."""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.config.instrument_profile import load_profile, write_commissioned
from polishd.model.instrument import CommissioningRecord
from tests.unit.commissioning.init.test_write_cell import LENS, init


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("setup")
    init(folder, LENS)
    return folder / "cell"


@pytest.fixture
def cell(made: Path, tmp_path: Path) -> Path:
    """A copy of a new cell."""
    shutil.copytree(made, tmp_path / "cell")
    return tmp_path / "cell" / "cell.toml"


def setup(cell: Path) -> dict[str, tuple[Any, str, str]]:
    """Return for each step whether it is done, the finding, and the command."""
    said = CliRunner().invoke(app, ["init", str(cell), "--status", "--json"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.stdout.splitlines()[-1])["steps"]
    return {step["what"]: (step["done"], step["found"], step["command"]) for step in found}


@pytest.mark.full
def test_a_new_cell_passes_its_check_and_has_all_else_to_do(cell: Path) -> None:
    found = setup(cell)
    done = [what for what, (is_done, _, _) in found.items() if is_done]
    assert done == ["have a program", "check"]
    assert found["probe"][0] is None
    assert found["plan"][2] == f"polishd plan {cell} MAP --out {cell.parent / 'plan'}"


@pytest.mark.full
def test_steps_are_done_as_their_files_appear_and_undone_as_they_go(cell: Path) -> None:
    text = cell.read_text()
    kept = "\n".join(line for line in text.splitlines() if not line.startswith("# TODO: assumed, check: "))
    cell.write_text('include = ["stiffness.toml"]\n' + kept)
    stiffness = "joint_stiffness_n_mm_per_rad = [3e8, 3e8, 3e8, 9e7, 9e7, 9e7]"
    (cell.parent / "stiffness.toml").write_text(f"[kinematics]\n{stiffness}\n")
    plan = cell.parent / "plan"
    plan.mkdir()
    (plan / "summary.json").write_text('{"outcome": "planned", "job": "MIRROR-7"}')
    (cell.parent / "another").mkdir()
    (cell.parent / "another" / "summary.json").write_text('{"outcome": "planned", "job": "MIRROR-8"}')
    profile = cell.parent / "instrument.toml"
    at = datetime(2026, 11, 1, tzinfo=UTC)
    record = CommissioningRecord(
        at=at,
        artefact="bumps",
        map_sha256="0" * 64,
        correlation=0.99,
        next_best=0.4,
        profile_sha256=load_profile(profile).sha256,
    )
    write_commissioned(profile, record)
    run = cell.parent / "state" / "runs" / "MIRROR-7-1"
    run.mkdir(parents=True)
    (run / "summary.json").write_text('{"outcome": "in_tolerance"}')
    found = setup(cell)
    assert {what for what, (done, _, _) in found.items() if not done} == {"calibrate tif", "rehearse"}
    assert found["run"][1] == "MIRROR-7-1: in_tolerance"
    shutil.rmtree(plan)
    (cell.parent / "program.rnc").unlink()
    found = setup(cell)
    assert (found["plan"][0], found["have a program"][0], found["check"][0]) == (False, False, False)
    assert "program.rnc" in found["check"][1]


@pytest.mark.full
@pytest.mark.parametrize(
    ("outcomes", "done"),
    [
        (["failed"], False),
        (["diverged"], False),
        (["stopped", "in_tolerance"], True),
        (["in_tolerance", "cycles_used"], False),
        (["as_programmed"], True),
    ],
)
def test_a_rehearsal_and_a_run_are_done_where_the_latest_ended_well(
    cell: Path, outcomes: list[str], done: bool
) -> None:
    for runs in (cell.parent / "cell-rehearsal" / "state" / "runs", cell.parent / "state" / "runs"):
        for at, outcome in enumerate(outcomes):
            run = runs / f"MIRROR-7-{at + 1}"
            run.mkdir(parents=True)
            (run / "summary.json").write_text(json.dumps({"outcome": outcome}))
            os.utime(run / "summary.json", ns=(at * 10**9, at * 10**9))
    found = setup(cell)
    assert (found["rehearse"][0], found["run"][0]) == (done, done)
    assert found["rehearse"][1].endswith(f"MIRROR-7-{len(outcomes)}: {outcomes[-1]}")
    assert found["probe"][0] is (None if outcomes == ["failed"] else True)
    sim, own = (cell.parent / "cell-rehearsal" / name for name in ("sim.toml", "cell-rehearsal.toml"))
    assert found["rehearse"][2] == f"polishd sim {sim}, and in another terminal: polishd run {own}"


def test_a_cell_that_cannot_be_read_is_the_first_thing_to_do(cell: Path) -> None:
    cell.write_text(cell.read_text().replace("aperture_mm = 20", "aperture_mm = -20"))
    found = setup(cell)
    assert list(found) == ["write the cell"]
    assert "part.aperture_mm: -20 is out of range" in found["write the cell"][1]


def test_a_cell_that_does_not_exist_is_made_by_init(tmp_path: Path) -> None:
    assert setup(tmp_path / "new") == {
        "write the cell": (False, f"{tmp_path / 'new' / 'cell.toml'}: is missing", f"polishd init {tmp_path / 'new'}")
    }


@pytest.mark.full
def test_each_program_of_a_cell_is_needed(cell: Path) -> None:
    cell.write_text(cell.read_text().replace('"program.rnc"', '["program.rnc", "between.rnc"]'))
    between = cell.parent / "between.rnc"
    found = setup(cell)["have a program"]
    command = f"polishd program make raster --out {between} --cell {cell} --phase 0.5"
    assert found == (False, f"{between}: is missing", command)
    between.write_bytes((cell.parent / "program.rnc").read_bytes())
    assert setup(cell)["have a program"][:2] == (True, f"{cell.parent / 'program.rnc'}, {between}")
