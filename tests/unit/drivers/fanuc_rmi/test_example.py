"""The shipped example cell: ``polishd check`` says how much motion the controller's 8 instructions hold."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from polishd.cli.app import app

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    shutil.copy(EXAMPLES / "instrument.toml", tmp_path)
    return Path(shutil.copytree(EXAMPLES / "fanuc_rmi", tmp_path / "cell")) / "cell.toml"


def test_check_says_how_much_motion_is_held(cell: Path) -> None:
    done = CliRunner().invoke(app, ["check", str(cell), "--json"])
    assert done.exit_code == 0, done.exception
    assert json.loads(done.stdout)["motion held by the robot"].startswith("at least 1.20 s in 8 instructions")


def test_check_refuses_points_that_are_too_short_with_the_number(cell: Path) -> None:
    cell.write_text(cell.read_text().replace("least_point_s = 0.4", "least_point_s = 0.3"))
    refused = CliRunner().invoke(app, ["check", str(cell)])
    assert "machine.least_point_s" in str(refused.exception)
    assert "Set machine.least_point_s to 0.384 or more" in str(refused.exception)
