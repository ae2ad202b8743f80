"""The devices of a cell: one at a port or several by name, and which of them a job uses."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import PORTS, CellConfig, load_config
from polishd.model.errors import ConfigError

TWO = (Path(__file__).parents[3] / "examples" / "two_robots.toml").read_text()


def loaded(tmp_path: Path, text: str) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return load_config(path)


def test_one_device_at_each_port_is_named_as_its_section(tmp_path: Path, example: str) -> None:
    config = loaded(tmp_path, example)
    assert list(PORTS) == ["actuator", "robot", "spindle", "metrology", "loader", "force_sensor", "monitor"]
    assert list(config.devices) == ["actuator", "robot", "spindle", "metrology"]
    assert config.used == {port: port for port in config.devices}


def test_several_devices_are_named_by_the_user(tmp_path: Path) -> None:
    config = loaded(tmp_path, TWO)
    sides = [f"{port}.{side}" for port in ("actuator", "robot", "spindle") for side in ("left", "right")]
    assert list(config.devices) == [*sides, "metrology"]
    assert config.devices["robot.right"].type == "robot_link"
    assert config.used == {
        "actuator": "actuator.left", "robot": "robot.left", "spindle": "spindle.left", "metrology": "metrology"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ('robot = "left"', 'robot = "lfet"', 'robot = "lfet"', "roles.robot: there is no 'lfet'; did you mean 'left'?"),
        ('robot = "left"\n', "", "[roles]", "roles.robot: is missing: there are 'left', 'right'"),
        ('robot = "left"', 'robt = "left"\nrobot = "left"', "robt", "roles.robt: unknown key; did you mean 'robot'?"),
        (
            'robot = "left"',
            'robot = "left"\nmetrology = "zygo"',
            "metrology =",
            "roles.metrology: there is one metrology, without a name; remove the line, or name it: [metrology.zygo]",
        ),
        ('[robot.right]\ntype = "robot_link"', "[robot.right]", "[robot.right]", "robot.right.type: is missing; add"),
        ("[robot.right]", "[robot]\nspeed = 3\n[robot.right]", "speed = 3", "robot.speed: "),
        ("[robot.right]", '[robot."right arm"]', '[robot."right arm"]', "is not a valid name"),
    ],
)
def test_what_is_wrong_is_placed(tmp_path: Path, old: str, new: str, line: str, says: str) -> None:
    text = TWO.replace(old, new, 1)
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    number = next(n for n, found in enumerate(text.splitlines(), 1) if found.startswith(line))
    assert str(caught.value).startswith(f"{tmp_path / 'cell.toml'}:{number}: ")
    assert says in str(caught.value)


def test_a_section_without_type_or_tables_is_no_device(tmp_path: Path, example: str) -> None:
    with pytest.raises(ConfigError, match=r"robot\.type: is missing; add it: type = \.\.\."):
        loaded(tmp_path, example.replace('type = "robot_link"\n', ""))
