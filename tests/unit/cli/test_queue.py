"""``polishd queue`` where no daemon runs: judged as a whole, all or none, and written to the journal."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from tests.system.cell_rig import write_small
from tests.unit.cli_result import Polishd


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    return write_small(tmp_path_factory.mktemp("queue") / "cell")


@pytest.fixture
def cell(small: DemoFiles, tmp_path: Path) -> Path:
    """The cell's file, with another state folder."""
    text = small.cell.read_text().replace('state_dir = "state"', f'state_dir = "{tmp_path / "state"}"')
    assert str(tmp_path) in text
    own = small.out / f"{tmp_path.name}.toml"
    own.write_text(text)
    return own


def job(folder: Path, name: str, more: str = "") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(f'[job]\nid = "{name}"\n[part]\nid = "P-{name}"\n{more}')
    return path


def waiting(polishd: Polishd, cell: Path) -> list[str]:
    return [found["name"] for found in polishd("queue", "list", cell, "--json").answer["jobs"] if not found["verdict"]]


@pytest.mark.full
def test_jobs_are_added_listed_moved_and_taken_out(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    said = polishd("queue", "add", cell, *(job(tmp_path, name) for name in ("a", "b", "c")))
    assert said.code == 0, said.err
    assert "P-b" in said.out
    assert polishd("queue", "move", cell, "c", "before", "b").code == 0
    assert waiting(polishd, cell) == ["a", "c", "b"]
    found = polishd("queue", "remove", cell, "a", "--reason", "a chip", "--json").answer["jobs"]
    assert [(one["name"], one["state"], one["reason"]) for one in found if one["verdict"]] == [
        ("a", "removed", "a chip")
    ]
    assert waiting(polishd, cell) == ["c", "b"]


@pytest.mark.full
def test_all_of_a_call_are_added_or_none(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    good, wrong = job(tmp_path, "a"), job(tmp_path, "b", "[process]\nforce_n = -1.0\n")
    said = polishd("queue", "add", cell, good, wrong)
    assert said.code == 3
    assert f"{wrong}:6: process.force_n: -1.0 is out of range" in said.err
    assert waiting(polishd, cell) == []


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("more", "code", "problem"),
    [
        ("[machine]\ncorner_deg = 3.0\n", 3, "machine: "),
        ('[program]\npath = "none.rnc"\n', 3, "none.rnc: cannot be read"),
        ("aperture_mm = 60.0\n", 3, "the program leaves out 49.0 % of the clear aperture"),
        ("origin_mm = [3000.0, 220.0, 2315.0]\n", 3, "out of the workspace"),
    ],
    ids=["the cell's", "no program", "does not cover", "out of reach"],
)
def test_each_is_judged_as_check_does(
    polishd: Polishd, cell: Path, tmp_path: Path, more: str, code: int, problem: str
) -> None:
    said = polishd("queue", "add", cell, job(tmp_path, "a", more))
    assert (said.code, problem in said.err) == (code, True), said.err
    assert waiting(polishd, cell) == []


@pytest.mark.full
def test_a_name_that_waits_is_refused(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    path = job(tmp_path, "a")
    assert polishd("queue", "add", cell, path).code == 0
    said = polishd("queue", "add", cell, path)
    assert said.code == 3
    assert "job.id: 'a' is in the queue already" in said.err


def test_options_of_run_that_do_not_go_together(polishd: Polishd, cell: Path) -> None:
    assert "--until-empty needs --queue" in polishd("run", cell, "--until-empty").err
    assert "--start-held cannot be used with --no-hold" in polishd("run", cell, "--start-held", "--no-hold").err
    assert "--correction cannot be used with --queue" in polishd("run", cell, "--queue", "--correction", "none").err


def test_a_queue_does_not_begin_with_an_instrument_that_nothing_proved(
    polishd: Polishd, cell: Path, tmp_path: Path
) -> None:
    """Not once each part is refused alone: the first of them would be set aside for it."""
    profile = cell.parent / "unproved.toml"
    profile.write_text((cell.parent / "instrument.toml").read_text().partition("[commissioned]")[0])
    cell.write_text(cell.read_text().replace('"instrument.toml"', '"unproved.toml"'))
    refused = polishd("run", cell, "--queue", "--until-empty")
    assert refused.code == 3
    assert "never commissioned" in refused.err
    assert str(tmp_path / "state") in cell.read_text()
    assert not (tmp_path / "state").exists(), "nothing was opened"
