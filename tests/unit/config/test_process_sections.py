"""The robot's kinds, the Preston constant's unit, and fragments that a cell includes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.config.study import load_study
from polishd.config.table_files import tif_bytes
from polishd.model.errors import ConfigError
from polishd.model.process import ComplianceOptions, HybridRobot, MeasuredCompliance, MeasuredTif, Optic, SerialRobot

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
SERIAL = """type = "serial"
dh = [[0, 90, 290, 0], [270, 0, 0, -90], [70, 90, 0, 0], [0, -90, 302, 0], [0, 90, 0, 0], [0, 0, 72, 180]]
joint_stiffness_n_mm_per_rad = [1e9, 1e9, 1e9, 1e8, 1e8, 1e8]
joint_limits_deg = [[-165, 165], [-110, 110], [-110, 70], [-160, 160], [-120, 120], [-400, 400]]
home_deg = [0, 20, 10, 0, 60, 0]
tool_length_mm = 150.0
"""


def cell(tmp_path: Path, text: str, overrides: dict[str, Any] | None = None) -> CellConfig:
    (tmp_path / "cell.toml").write_text(text)
    return load_config(tmp_path / "cell.toml", overrides)


def refused(tmp_path: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        cell(tmp_path, text)
    return str(caught.value).replace(f"{tmp_path}/", "")


def with_kinematics(example: str, keys: str) -> str:
    return re.sub(r"\[kinematics\][^\[]*", f"[kinematics]\n{keys}\n", example)


def line_of(text: str, fragment: str) -> int:
    return text[: text.index(fragment)].count("\n") + 1


def test_without_a_type_the_robot_is_the_hybrid(tmp_path: Path, example: str) -> None:
    text = with_kinematics(example, "tool_length_mm = 300.0\nbase_joints_mm = [[0,250,0],[-216,-125,0],[216,-125,0]]")
    robot = cell(tmp_path, text).robot_model()
    assert isinstance(robot, HybridRobot)
    assert robot.tool_length_mm == 300.0
    assert robot.base_joints_mm == ((0, 250, 0), (-216, -125, 0), (216, -125, 0))


def test_a_serial_arm_has_keys_of_its_own(tmp_path: Path, example: str) -> None:
    robot = cell(tmp_path, with_kinematics(example, SERIAL)).robot_model()
    assert isinstance(robot, SerialRobot)
    assert robot.dh[1] == (270, 0, 0, -90)
    assert robot.joint_limits_deg[2] == (-110, 70)


def test_a_measured_cell_names_a_table(tmp_path: Path, example: str) -> None:
    (tmp_path / "loaded.csv").write_text(
        "# by hand\nz_mm,x_mm,y_mm,compliance_um_per_n,who\n5,1,2,1.5,me\n6,3,4,1.75,you\n"
    )
    robot = cell(tmp_path, with_kinematics(example, 'type = "measured"\ntable = "loaded.csv"')).robot_model()
    assert isinstance(robot, MeasuredCompliance)
    np.testing.assert_array_equal(robot.tip_mm, [[1, 2, 5], [3, 4, 6]])
    np.testing.assert_array_equal(robot.compliance_um_per_n, [1.5, 1.75])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, r"loaded\.csv: cannot be read"),
        ("", r"loaded\.csv: has no table"),
        (
            "x_mm,x_mm,y_mm,z_mm,compliance_um_per_n\n1,1,2,3,4\n",
            r"loaded\.csv:1: there are 2 columns 'x_mm'",
        ),
        ("x_mm,y_mm,z_mm,compliance\n1,2,3,4\n", r"loaded\.csv:1: the column 'compliance_um_per_n' is missing"),
        ("x_mm,y_mm,z_mm,compliance_um_per_n\n1,2,3,1.5\n\n1,2,x,4\n", r"loaded\.csv:4: z_mm is 'x'"),
        ("x_mm,y_mm,z_mm,compliance_um_per_n\n1,2,3\n", r"loaded\.csv:2: compliance_um_per_n is missing"),
        ("x_mm,y_mm,z_mm,compliance_um_per_n\n1,2,3,nan\n", r"loaded\.csv:2: .* write a finite number"),
    ],
)
def test_a_table_that_is_none_is_named(tmp_path: Path, example: str, content: str | None, says: str) -> None:
    if content is not None:
        (tmp_path / "loaded.csv").write_text(content)
    config = cell(tmp_path, with_kinematics(example, 'type = "measured"\ntable = "loaded.csv"'))
    with pytest.raises(ConfigError, match=says):
        config.robot_model()


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('type = "parallel"', "kinematics: must be 'hybrid', 'serial' or 'measured'"),
        ("a_stiffness_n_mm_per_rad = -4.36e7", "kinematics.a_stiffness_n_mm_per_rad: -43600000.0 is out of range"),
        ("tool_lenght_mm = 400.0", "kinematics.tool_lenght_mm: unknown key; did you mean 'tool_length_mm'?"),
        ('type = "measured"', "kinematics.table: is missing; add it: table = ..."),
        (SERIAL.replace("1e9, 1e9, 1e9", "1e9, -1e9, 1e9"), "kinematics.joint_stiffness_n_mm_per_rad: -1"),
        (SERIAL.replace(", [0, 0, 72, 180]", ""), "kinematics.dh: has 5 entries; must have 6"),
        (SERIAL + "stroke_mm = [900.0, 1700.0]", "kinematics.stroke_mm: unknown key"),
        ('beam = "stiff"', "kinematics.beam: 'stiff' is not allowed; must be 'exact' or 'paper'"),
    ],
)
def test_faults_of_the_robot_name_key_and_line(tmp_path: Path, example: str, keys: str, says: str) -> None:
    text = with_kinematics(example, keys)
    message = refused(tmp_path, text)
    assert says in message
    key = says.partition(":")[0].partition(".")[2]
    place = line_of(text, f"\n{key} =") + 1 if f"\n{key} =" in text else line_of(text, "[kinematics]")
    assert message.startswith(f"cell.toml:{place}: ")


@pytest.mark.parametrize(
    ("written", "cm2_per_n"),
    [
        ('"2e-9 cm2/N"', 2e-9),
        ('"2e-9 cm^2/N"', 2e-9),
        ('"2e-9 cm²/N"', 2e-9),
        ('"2e-7 mm2/N"', 2e-9),
        ('"2e-13 1/Pa"', 2e-9),
        ('"2e-13 m2/N"', 2e-9),
        ('"2e-7 1/MPa"', 2e-9),
    ],
)
def test_the_preston_constant_carries_its_unit(tmp_path: Path, example: str, written: str, cm2_per_n: float) -> None:
    text = re.sub(r"preston = .*", f"preston = {written}", example)
    config = cell(tmp_path, text)
    assert config.tool_process().preston_cm2_per_n == pytest.approx(cm2_per_n, rel=1e-12)
    assert config.effective()["process"]["preston"].endswith(" cm2/N")


@pytest.mark.parametrize("written", ['"2e-9 cm"', '"fast"', '"2e-9 1/psi"', "-1e-9", "0.0", "true", '"1 cm2/N"'])
def test_a_preston_constant_that_is_none_is_refused(tmp_path: Path, example: str, written: str) -> None:
    text = re.sub(r"preston = .*", f"preston = {written}", example)
    assert refused(tmp_path, text).startswith(f"cell.toml:{line_of(text, 'preston =')}: process.preston: ")


@pytest.mark.parametrize("written", ["1.49e-9", '"1.49e-9"', '" 1.49e-9 "'])
def test_a_preston_constant_without_its_unit_is_refused_with_what_to_write(
    tmp_path: Path, example: str, written: str
) -> None:
    says = r"process\.preston: "
    text = re.sub(r"preston = .*", f"preston = {written}", example)
    assert re.match(rf"cell\.toml:{line_of(text, 'preston =')}: {says}", refused(tmp_path, text))
    (tmp_path / "f.toml").write_text(f"[process]\npreston = {written}\n")
    assert re.match(rf"f\.toml:2: {says}", refused(tmp_path, f'include = ["f.toml"]\n{example}'))
    study = tmp_path / "study.toml"
    study.write_text(re.sub(r"preston = .*", f"preston = {written}", (EXAMPLES / "table_iii.toml").read_text()))
    with pytest.raises(ConfigError, match=rf"study\.toml:\d+: {says}"):
        load_study(study)


def test_a_fragment_replaces_what_the_cell_says(tmp_path: Path, example: str) -> None:
    (tmp_path / "stiff.toml").write_text("[kinematics]\na_stiffness_n_mm_per_rad = 5e7\n")
    (tmp_path / "tif.toml").write_text('[process]\npreston = "3e-9 cm2/N"\n')
    config = cell(tmp_path, f'include = ["stiff.toml", "tif.toml"]\n{example}')
    robot = config.robot_model()
    assert isinstance(robot, HybridRobot)
    assert (robot.a_stiffness_n_mm_per_rad, robot.tool_length_mm) == (5e7, 420.0)
    assert config.tool_process().preston_cm2_per_n == 3e-9
    assert config.included == {
        "kinematics.a_stiffness_n_mm_per_rad": str(tmp_path / "stiff.toml"),
        "process.preston": str(tmp_path / "tif.toml"),
    }
    assert config.effective() != cell(tmp_path, example).effective()


def test_an_override_has_the_last_word(tmp_path: Path, example: str) -> None:
    (tmp_path / "f.toml").write_text("[process]\nforce_n = 9.0\n")
    text = f'include = ["f.toml"]\n{example}'
    assert cell(tmp_path, text).process.force_n == 9.0
    assert cell(tmp_path, text, {"process.force_n": 8.0}).process.force_n == 8.0


@pytest.mark.parametrize(
    ("fragment", "says"),
    [
        (
            "[kinematics]\na_stiffness_n_mm_per_rad = -1.0\n",
            "f.toml:2: kinematics.a_stiffness_n_mm_per_rad: -1.0 is out",
        ),
        ("[proces]\nforce_n = 1.0\n", "proces: unknown key; did you mean 'process'?"),
        ("[process\n", "f.toml:1: this is not TOML"),
        ('include = ["g.toml"]\n', "f.toml:1: include: a fragment cannot include another"),
        (None, "f.toml: cannot be read"),
    ],
)
def test_faults_of_a_fragment_name_the_fragment(tmp_path: Path, example: str, fragment: str | None, says: str) -> None:
    if fragment is not None:
        (tmp_path / "f.toml").write_text(fragment)
    assert says in refused(tmp_path, f'include = ["f.toml"]\n{example}')


@pytest.mark.parametrize("include", ['"f.toml"', "[1]", "true"])
def test_include_is_a_list_of_names(tmp_path: Path, example: str, include: str) -> None:
    assert refused(tmp_path, f"include = {include}\n{example}").startswith("cell.toml:1: include: must be a list")


def test_the_other_nouns_of_the_physics(tmp_path: Path, example: str) -> None:
    tif = MeasuredTif(np.array([[0.0, 1.0], [2.0, 0.5]]), 0.1, 30.0, 0.9, rotates=False)
    (tmp_path / "spot.npz").write_bytes(tif_bytes(tif))
    overrides = {
        "process.tif": "spot.npz",
        "compliance.frame": "frenet",
        "compliance.dip_direction": "fixed",
        "compliance.dip_azimuth_deg": 30,
        "part.curvature_radius_mm": 800.0,
        "part.conic": -1.0,
    }
    config = cell(tmp_path, example, overrides)
    assert config.compliance_options() == ComplianceOptions(frame="frenet", dip_direction="fixed", dip_azimuth_deg=30.0)
    assert config.optic() == Optic(800.0, -1.0)
    got = config.measured_tif()
    assert got is not None
    np.testing.assert_array_equal(got.rate_nm_s, tif.rate_nm_s)
    assert (got.pitch_mm, got.azimuth_deg, got.depth_ratio, got.rotates) == (0.1, 30.0, 0.9, False)


def test_a_measured_tif_is_needed_and_must_be_one(tmp_path: Path, example: str) -> None:
    assert "process.tif: is missing" in refused(
        tmp_path, example.replace('removal_model = "hertz_preston"', 'removal_model = "measured_tif"')
    )
    (tmp_path / "spot.npz").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(ConfigError, match=r"spot\.npz: is not a measured TIF"):
        cell(tmp_path, example, {"process.tif": "spot.npz"}).measured_tif()
    np.savez(
        tmp_path / "flat.npz", rate_nm_s=np.zeros((3, 3)), pitch_mm=1.0, azimuth_deg=0.0, depth_ratio=1.0, rotates=True
    )
    with pytest.raises(ConfigError, match="is zero"):
        cell(tmp_path, example, {"process.tif": "flat.npz"}).measured_tif()


def test_a_part_smaller_than_its_curvature_allows(tmp_path: Path, example: str) -> None:
    text = example.replace("[part]", "[part]\ncurvature_radius_mm = 40.0")
    assert "part.curvature_radius_mm: 40 mm is too small for an aperture of 100 mm" in refused(tmp_path, text)
