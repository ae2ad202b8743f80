"""``robot = "abb"`` and the others: driver, language, arm, and the part's frame in the maker's terms."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning.init.answers import Answers
from polishd.commissioning.init.arms import ARMS
from polishd.commissioning.init.connected import Connected
from polishd.commissioning.init.makers import FRAMES, MAKERS
from polishd.commissioning.init.questions import ask_questions
from polishd.config.cell import load_config
from polishd.model.errors import ConfigError
from polishd.model.process import SerialRobot
from polishd.plugin_loader import load_own
from polishd.process.robot.serial import chain
from tests.unit.commissioning.init.test_questions import Person
from tests.unit.commissioning.init.test_write_cell import init
from tests.unit.maps.maps import dat

PART = '[part]\nid = "P-1"\naperture_mm = 12.0\n'
DRIVERS = {
    "abb": "abb_rws",
    "fanuc": "fanuc_rmi",
    "kuka": "kuka_kvp",
    "yaskawa": "plc_robot",
    "staubli": "plc_robot",
    "ur": "universal_robots",
    "linuxcnc": "linuxcnc",
}


def said(*words: str) -> dict[str, Any]:
    """The answer of a command as JSON."""
    done = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


@pytest.mark.full
@pytest.mark.parametrize("maker", MAKERS)
def test_a_robot_by_its_maker_gives_a_first_plan(tmp_path: Path, maker: str) -> None:
    """The commands of docs/how-to/connect-a-robot.md: the cell passes its check, and a map becomes a program."""
    shown = init(tmp_path, f'robot = "{maker}"\n{PART}[job]\ntolerance_nm = 9.0\n')
    cell = tmp_path / "cell" / "cell.toml"
    assert MAKERS[maker].program in shown["written"], shown["program"]
    assert load_config(cell).robot.type == DRIVERS[maker]
    assert said("check", str(cell))["reach"].startswith("all ")
    x, y = np.meshgrid(np.arange(-26, 27) * 0.25, np.arange(-26, 27) * 0.25)
    dat(tmp_path / "map.dat", 40.0 * np.exp(-((x - 2) ** 2 + y**2) / 12.0), pitch_mm=0.25, part="P-1")
    plan = tmp_path / "plan"
    said("plan", str(cell), str(tmp_path / "map.dat"), "--out", str(plan))
    made = plan / "program.rnc"
    assert made.read_bytes() != (tmp_path / "cell" / MAKERS[maker].program).read_bytes(), "with dwell of the map"


@pytest.mark.parametrize("name", ARMS)
def test_each_arm_looks_down_at_home_and_reaches_as_far_as_its_maker_says(name: str) -> None:
    arm = ARMS[name]
    robot = SerialRobot(arm.dh, (1e9,) * 6, arm.limits_deg, arm.home_deg, 0.0)
    at = chain(robot, np.radians([arm.home_deg]))
    np.testing.assert_allclose(at.axis[0], [0.0, 0.0, 1.0], atol=1e-9)
    assert all(low <= home <= high for home, (low, high) in zip(arm.home_deg, arm.limits_deg, strict=True))
    if name in REACH_MM:
        assert _wrist_reach_mm(arm.dh) == pytest.approx(REACH_MM[name], abs=6.0)


REACH_MM = {
    "irb4600-40-255": 2550.0,
    "irb6700-200-260": 2600.0,
    "m20ia": 1811.0,
    "kr10-r1100": 1101.0,
    "kr30-3": 2033.0,
    "gp25": 1730.0,
    "tx2-90": 900.0,
}
"""Values of the makers' data sheets, from axis 1 to the wrist."""


def _wrist_reach_mm(dh: Any) -> float:
    """Axis 1 to the wrist's center with the arm stretched."""
    (a1, _, _, _), (a2, _, _, _), (a3, _, _, _), (_, _, d4, _), *_ = dh
    return float(a1 + abs(a2) + math.hypot(a3, d4))


TILTED = Rotation.from_euler("XYZ", [10.0, -20.0, 30.0], degrees=True)
Q = TILTED.as_quat()
GIVEN = {
    "abb": ("wobj", [900.0, 20.0, 500.0, Q[3], Q[0], Q[1], Q[2]]),
    "kuka": ("base", [900.0, 20.0, 500.0, *TILTED.as_euler("ZYX", degrees=True)]),
    "fanuc": ("uframe", [900.0, 20.0, 500.0, *TILTED.as_euler("xyz", degrees=True)]),
    "yaskawa": ("user_frame", [900.0, 20.0, 500.0, *TILTED.as_euler("xyz", degrees=True)]),
    "staubli": ("frame", [900.0, 20.0, 500.0, 10.0, -20.0, 30.0]),
    "ur": ("feature", [0.9, 0.02, 0.5, *TILTED.as_rotvec()]),
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("maker", GIVEN)
def test_the_parts_frame_is_stated_in_the_makers_terms(tmp_path: Path, maker: str) -> None:
    key, values = GIVEN[maker]
    numbers = [float(value) for value in values]
    shown = init(
        tmp_path, f'[robot]\nmaker = "{maker}"\n{key} = {numbers}\n{PART}[program]\nmake = "none"\n', "--dry-run"
    )
    part = tomllib.loads(shown["texts"]["cell.toml"])["part"]
    assert part["origin_mm"] == pytest.approx([900.0, 20.0, 500.0])
    assert part["rotation_rpy_deg"] == pytest.approx([10.0, -20.0, 30.0], abs=1e-5)
    assert not {"part.origin_mm", "part.rotation_rpy_deg"} & set(shown["look"])
    assert FRAMES[key] is MAKERS[maker].frame


@pytest.mark.parametrize(
    ("answers", "problem"),
    [
        ('robot = "abbb"\n', r"answers\.toml:1: robot.*there is no robot 'abbb'.*did you mean 'abb'"),
        ('[robot]\nmaker = "kuka"\nwobj = [0, 0, 0, 1, 0, 0, 0]\n', r"robot.*wobj: is no frame of .*; it has base"),
        (
            '[robot]\nmaker = "kuka"\nbase = [0, 0, 0]\n',
            r"robot.*base: has 3 numbers, not 6: X, Y, Z in mm and A, B, C",
        ),
        ('[robot]\nmaker = "abb"\nwobj = [0, 0, 0, 1, 1, 0, 0]\n', "q1 to q4 are no rotation"),
        (
            '[robot]\nmaker = "abb"\ntype = "robot_link"\naddress = "tcp://a:1"\n',
            r"robot\.type: maker names the driver",
        ),
        (
            '[robot]\nmaker = "abb"\nwobj = [900, 0, 500, 1, 0, 0, 0]\n[part]\norigin_mm = [1, 2, 3]\n',
            r"robot\.wobj: is the part's place, as is part\.origin_mm",
        ),
    ],
)
def test_a_wrong_answer_of_a_maker_is_refused_with_its_place(tmp_path: Path, answers: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        init(tmp_path, answers)
    assert not (tmp_path / "cell").exists()


@pytest.mark.full
def test_a_maker_is_asked_for_its_arm_its_address_and_the_parts_frame(tmp_path: Path) -> None:
    person = Person(
        maker=["kuka"],
        robot=["kr30-3"],
        robot__address=["tcp://10.0.0.7:7000"],
        robot__base=["[1200, 0, 400, 0, 0, 0]"],
        surface=["sphere"],
        part__off_axis_mm=["[30.0, 0.0]"],
    )
    answers: Answers = ask_questions(tmp_path / "cell", Connected(), load_own(), person)
    asked = [question.key for question in person.questions]
    assert "robot.type" not in asked
    assert (answers.own.robot.maker, answers.own.kinematics.arm) == ("kuka", "kr30-3")
    assert answers.own.robot.base == (1200.0, 0.0, 400.0, 0.0, 0.0, 0.0)
    assert answers.cell["robot"]["address"] == "tcp://10.0.0.7:7000"
    assert answers.cell["part"]["off_axis_mm"] == [30.0, 0.0]
