"""Example cells with a program in the robot's language: the command in the cell's file makes it, and check takes it."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.config.cell import load_config

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
MADE = re.compile(r"# polishd (program make .*)")


@pytest.fixture(params=["universal_robots", "fanuc_rmi"])
def cell(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    shutil.copy(EXAMPLES / "instrument.toml", tmp_path)
    return Path(shutil.copytree(EXAMPLES / request.param, tmp_path / "cell")) / "cell.toml"


@pytest.mark.one_of_each
def test_the_command_in_the_cell_makes_the_shipped_program(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell.parent)
    program = load_config(cell).program_path
    shipped = program.read_bytes()
    program.unlink()
    made = MADE.search(cell.read_text())
    assert made is not None
    done = CliRunner().invoke(app, shlex.split(made[1]))
    assert done.exit_code == 0, done.exception
    assert program.read_bytes() == shipped


@pytest.mark.full
def test_check_takes_the_cell(cell: Path) -> None:
    done = CliRunner().invoke(app, ["check", str(cell), "--json"])
    assert done.exit_code == 0, done.exception
    assert json.loads(done.stdout)["program"].endswith("time in the time")


@pytest.mark.full
def test_a_first_touch_in_a_language_of_coarse_speeds_keeps_to_their_steps(tmp_path: Path) -> None:
    """INFORM has no time of a move, and speeds in steps of 0.1 mm/s."""
    shutil.copy(EXAMPLES / "instrument.toml", tmp_path)
    cell = Path(shutil.copytree(EXAMPLES / "yaskawa", tmp_path / "cell")) / "cell.toml"
    text = cell.read_text().replace("aperture_mm = 14.0", "aperture_mm = 40.0")
    cell.write_text(text.replace("[process]", '[process]\nestimates = "machine"'))
    touch = cell.parent / "touch"
    done = CliRunner().invoke(app, ["calibrate", "first-touch", str(cell), "--out", str(touch), "--part", "W-1"])
    assert done.exit_code == 0, done.exception
    assert len(set(re.findall(r"V=\d+\.\d\b", (touch / "touch.rnc").read_text()))) > 3
    cell.write_text(f'include = ["touch/fragment.toml"]\n{cell.read_text()}')
    checked = CliRunner().invoke(app, ["check", str(cell)])
    assert checked.exit_code == 0, checked.exception
