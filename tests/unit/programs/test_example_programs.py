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


@pytest.mark.one_of_each
def test_check_takes_the_cell(cell: Path) -> None:
    done = CliRunner().invoke(app, ["check", str(cell), "--json"])
    assert done.exit_code == 0, done.exception
    assert json.loads(done.stdout)["program"].endswith("time in the time")
