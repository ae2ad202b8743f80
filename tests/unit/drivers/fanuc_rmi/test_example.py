"""The shipped example cell: ``polishd check`` says how much motion the controller's 8 instructions hold."""

from __future__ import annotations

import json
import re
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
    assert json.loads(done.stdout)["motion held by the robot"].startswith("at least 1.26 s in 8 instructions")


def test_check_refuses_points_that_are_too_short_with_the_number(cell: Path) -> None:
    cell.write_text(cell.read_text().replace("least_point_s = 0.18", "least_point_s = 0.15"))
    refused = CliRunner().invoke(app, ["check", str(cell)])
    assert "machine.least_point_s" in str(refused.exception)
    assert "Set machine.least_point_s to 0.165 or more" in str(refused.exception)


@pytest.fixture
def witness(cell: Path) -> Path:
    """The cell with a part that has room for a first touch."""
    text = cell.read_text().replace("aperture_mm = 20.0", "aperture_mm = 40.0")
    cell.write_text(text.replace("[process]", '[process]\nestimates = "machine"'))
    return cell


@pytest.mark.full
def test_a_first_touch_is_timed_moves_that_keep_to_the_least_time_of_a_point(witness: Path) -> None:
    touch = witness.parent / "touch"
    command = ["calibrate", "first-touch", str(witness), "--out", str(touch), "--part", "W-1"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.exception
    times = [float(one) for one in re.findall(r"L P\[\d+\] ([0-9.]+)sec CNT100", (touch / "touch.rnc").read_text())]
    assert len(times) > 100
    assert min(times) >= 0.18 - 0.001
    witness.write_text(f'include = ["touch/fragment.toml"]\n{witness.read_text()}')
    checked = CliRunner().invoke(app, ["check", str(witness), "--json"])
    assert checked.exit_code == 0, checked.exception


@pytest.mark.full
def test_check_refuses_a_program_to_run_as_programmed_whose_points_are_too_short(cell: Path) -> None:
    text = cell.read_text().replace("[dwell]", '[dwell]\nobjective = "as_programmed"\ncross_check = ""')
    cell.write_text(text)
    refused = CliRunner().invoke(app, ["check", str(cell)])
    assert "Have it posted with points of 0.165 s or more" in str(refused.exception)
    program = cell.parent / "part.ls"
    program.write_text(re.sub(r"0\.0\d+sec", "0.2sec", program.read_text()))
    assert CliRunner().invoke(app, ["check", str(cell)]).exit_code == 0
