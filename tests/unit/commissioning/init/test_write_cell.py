"""``polishd init``: from answers to a valid cell, and the errors of wrong answers."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning.init.answers import answers_of
from polishd.commissioning.init.arms import ARMS
from polishd.commissioning.init.draft import draft_cell
from polishd.commissioning.init.write_cell import Seat, find_seat, reached
from polishd.config.cell import CellConfig, load_config
from polishd.config.instrument_profile import load_profile
from polishd.config.table_files import read_tif, tif_bytes
from polishd.maps.map_files import MapSource
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.process import MeasuredTif, SerialRobot
from polishd.pipeline import precheck, steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.plugin_loader import load_cell, load_own
from tests.unit.maps.maps import dat, surface

LENS = """
[kinematics]
arm = "ur10e"
tool_length_mm = 180.0

[part]
id = "MIRROR-7"
aperture_mm = 20
curvature_radius_mm = 800.0
"""


def init(folder: Path, answers: str, *options: str) -> dict[str, Any]:
    """What it says as JSON; a PolishdError is raised as it is."""
    (folder / "answers.toml").write_text(answers)
    words = ["init", str(folder / "cell"), "--from", str(folder / "answers.toml"), "--json", *options]
    said = CliRunner().invoke(app, words)
    if isinstance(said.exception, PolishdError):
        raise said.exception
    assert said.exit_code == 0, said.output
    shown: dict[str, Any] = json.loads(said.stdout.splitlines()[-1])
    return shown


@pytest.mark.full
def test_an_arm_and_a_part_become_a_cell_whose_program_its_plan_takes(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS)
    assert shown["written"] == ["cell.toml", "drive.eds", "instrument.toml", "program.rnc"]
    config, hooks = load_cell(tmp_path / "cell" / "cell.toml")
    robot = config.robot_model()
    assert isinstance(robot, SerialRobot)
    assert (robot.dh, robot.tool_length_mm) == (ARMS["ur10e"].dh, 180.0)
    assert (config.part.id, config.part.aperture_mm, config.part.curvature_radius_mm) == ("MIRROR-7", 20.0, 800.0)
    recipe = make_recipe(config, hooks)
    program = steps.read_program(recipe, config.program_path)
    assert precheck.precheck_plan(recipe, program, hooks.check_plan) == []
    assert not load_profile(tmp_path / "cell" / "instrument.toml").instrument.commissioned


@pytest.mark.full
def test_what_was_assumed_is_marked_above_its_key_and_what_was_answered_is_not(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS)
    lines = (tmp_path / "cell" / "cell.toml").read_text().splitlines()
    marked = []
    for at, line in enumerate(lines):
        if line.startswith("# TODO: assumed, check: "):
            marked.append(next(key for key in lines[at:] if not key.startswith("#")).partition(" ")[0])
    assert sorted(marked) == sorted(key.partition(".")[2] for key in shown["look"])
    assert "part.origin_mm" in shown["look"]
    assert not {"part.id", "part.aperture_mm", "kinematics.tool_length_mm"} & set(shown["look"])


@pytest.mark.full
def test_an_unmeasured_cell_has_no_correction_and_says_what_comes_next(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS)
    assert load_config(tmp_path / "cell" / "cell.toml").process.correction == "none"
    assert "polishd calibrate tif" in shown["look"]["process.correction"]
    (step,) = (step for step in shown["todo"] if step["what"] == "calibrate tif")
    assert step["done"] is False
    assert "witness part" in step["found"]
    init(tmp_path, LENS + '[process]\ncorrection = "exact"\n', "--force")
    assert load_config(tmp_path / "cell" / "cell.toml").process.correction == "exact"


@pytest.mark.full
def test_a_dry_run_writes_nothing_and_shows_the_same_text(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS, "--dry-run")
    assert not (tmp_path / "cell").exists()
    init(tmp_path, LENS)
    assert shown["texts"]["cell.toml"] == (tmp_path / "cell" / "cell.toml").read_text()


@pytest.mark.full
def test_a_dialog_without_input_says_how_to_give_answers_and_writes_nothing(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["init", str(tmp_path / "cell")], input="")
    assert said.exit_code == 2
    assert "polishd init DIR --from ANSWERS.toml" in " ".join(said.stderr.replace("│", " ").split())
    assert "Aborted" not in said.stderr
    assert not (tmp_path / "cell").exists()


@pytest.mark.full
def test_nothing_is_overwritten_without_being_asked(tmp_path: Path) -> None:
    init(tmp_path, LENS)
    cell = tmp_path / "cell" / "cell.toml"
    cell.write_text("# mine\n")
    with pytest.raises(ConfigError, match=r"cell\.toml.*there already, and nothing was written.*--force"):
        init(tmp_path, LENS)
    assert cell.read_text() == "# mine\n"
    init(tmp_path, LENS, "--force")
    assert load_config(cell).part.id == "MIRROR-7"


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("answers", "said"),
    [
        (LENS.replace("ur10e", "ur10ee"), r"answers\.toml:3: kinematics\.arm: .*did you mean 'ur10e'"),
        (
            LENS.replace("aperture_mm", "apperture_mm"),
            r"toml:8: part\.apperture_mm: unknown key; did you",
        ),
        (LENS + "[process]\nforce_n = -3.0\n", r"answers\.toml:11: process\.force_n: -3\.0 is out of range"),
        (LENS + '[robot]\ntype = "robot_link"\naddres = "x"\n', r"answers\.toml:12: robot\.addres: unknown key"),
        (
            LENS + '[spot]\nfile = "x.npz"\nseconds = 3.0\n',
            r"answers\.toml:11: spot\.file: cannot be combined",
        ),
        (LENS + "robot = 3\n", r"answers\.toml:10: part\.robot: unknown key"),
        ('robot = "left"\n' + LENS, r"answers\.toml:1: robot.maker: there is no robot 'left'"),
        (LENS + '[instrument]\nsample = "no.dat"\n', r"toml:11: instrument\.sample: .*no\.dat: cannot be read"),
        (LENS + '[spot]\nfile = "no.csv"\npitch_mm = 1.0\n', r"toml:10: spot: .*no\.csv: is no array of a spot"),
        (LENS.replace("arm =", 'type = "hybrid"\narm ='), r"toml:4: kinematics\.arm: goes with type = \"serial\""),
        ("[part", r"answers\.toml:1: this is not TOML"),
    ],
)
def test_a_wrong_answer_is_reported_with_its_line_and_nothing_is_written(
    tmp_path: Path, answers: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        init(tmp_path, answers)
    assert not (tmp_path / "cell").exists()


@pytest.mark.full
def test_an_arm_without_rows_is_left_to_be_filled_in_and_says_where(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS.replace('arm = "ur10e"', 'type = "serial"'))
    assert "kinematics.dh" in shown["fill_in"]
    assert "program.rnc" not in shown["written"]
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: kinematics\.dh: is missing"):
        load_config(tmp_path / "cell" / "cell.toml")
    assert "kinematics.dh" in shown["todo"][0]["found"]
    lines = (tmp_path / "cell" / "cell.toml").read_text().splitlines()
    filled = [line.removeprefix("# ") for line in lines if not line.startswith("# TODO")]
    text = "\n".join(line for line in filled if re.match(r"\[|\]|\w+ = |  \[", line))
    (tmp_path / "filled.toml").write_text(text)
    assert isinstance(load_config(tmp_path / "filled.toml").robot_model(), SerialRobot)


OWN_ROWS = """
[kinematics]
type = "serial"
tool_length_mm = 200.0
dh = [[260, -90, 675, 0], [680, 0, 0, 0], [35, -90, 0, 0], [0, 90, 670, 0], [0, -90, 0, 0], [0, 0, 115, 0]]
joint_limits_deg = [[-170, 170], [-190, 45], [-120, 156], [-185, 185], [-120, 120], [-350, 350]]
home_deg = [0, -60, 70, 0, 60, 0]

[part]
id = "MIRROR-7"
aperture_mm = 20
rotation_rpy_deg = [180.0, 0.0, 0.0]
"""


@pytest.mark.full
def test_an_arm_of_ones_own_is_asked_for_no_stiffness_and_gets_none_of_another_arm(tmp_path: Path) -> None:
    shown = init(tmp_path, OWN_ROWS)
    assert shown["fill_in"] == []
    assert "calibrate stiffness" in shown["look"]["kinematics.joint_stiffness_n_mm_per_rad"]
    robot = load_config(tmp_path / "cell" / "cell.toml").robot_model()
    assert isinstance(robot, SerialRobot)
    reach_mm = 675 + 260 + 680 + 35 + 670 + 115 + 200
    assert len(set(robot.joint_stiffness_n_mm_per_rad)) == 1
    assert 0.8 < robot.joint_stiffness_n_mm_per_rad[0] * 1e-3 / reach_mm**2 < 1.3
    given = OWN_ROWS.replace("tool_length", f"joint_stiffness_n_mm_per_rad = {[3e7] * 6}\ntool_length")
    shown = init(tmp_path, given, "--force")
    assert "kinematics.joint_stiffness_n_mm_per_rad" not in shown["look"]
    assert load_config(tmp_path / "cell" / "cell.toml").robot_model() == replace(
        robot, joint_stiffness_n_mm_per_rad=(3e7,) * 6
    )


def test_of_an_unknown_arm_no_value_of_another_one_is_in_force(tmp_path: Path) -> None:
    shown = init(tmp_path, LENS.replace('arm = "ur10e"', 'type = "serial"'))
    assert shown["fill_in"] == ["kinematics.dh", "kinematics.joint_limits_deg", "kinematics.home_deg", "part.origin_mm"]
    values = tomllib.loads(shown["texts"]["cell.toml"])
    assert set(values["kinematics"]) == {"type", "tool_length_mm", "joint_stiffness_n_mm_per_rad"}
    assert "origin_mm" not in values["part"]


@pytest.mark.full
def test_a_measured_spot_becomes_the_cells_removal(tmp_path: Path) -> None:
    """An array as a file: its samples are the TIF's, and the Preston constant is fitted to its volume."""
    at = np.linspace(-4.0, 4.0, 33)
    rate = np.exp(-(at**2 + at[:, None] ** 2) / 2)
    np.savetxt(tmp_path / "rate.csv", rate, delimiter=",")
    init(tmp_path, LENS + '[spot]\nfile = "rate.csv"\npitch_mm = 0.25\nazimuth_deg = 90.0\n')
    config = load_config(tmp_path / "cell" / "cell.toml")
    tif = config.measured_tif()
    assert tif is not None
    np.testing.assert_allclose(tif.rate_nm_s, rate)
    assert (config.process.removal_model, tif.pitch_mm, tif.azimuth_deg) == ("measured_tif", 0.25, 90.0)
    assert config.process.preston != pytest.approx(1.49e-9, rel=0.01)


@pytest.mark.full
def test_two_maps_of_a_spot_become_the_cells_removal(tmp_path: Path) -> None:
    at = (np.arange(81) - 40) * 0.25
    spot_nm = 90.0 * np.exp(-(at**2 + at[:, None] ** 2) / 4)
    dat(tmp_path / "before.dat", np.full_like(spot_nm, 100.0), pitch_mm=0.25)
    dat(tmp_path / "after.dat", 100.0 - spot_nm, pitch_mm=0.25)
    init(tmp_path, LENS + '[spot]\nbefore = "before.dat"\nafter = "after.dat"\nseconds = 30.0\n')
    tif = load_config(tmp_path / "cell" / "cell.toml").measured_tif()
    assert tif is not None
    assert tif.rate_nm_s.max() == pytest.approx(90.0 / 30.0, rel=0.01)


@pytest.mark.full
def test_files_that_answers_name_are_found_from_the_cell_too(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "corners.csv").write_text("x_mm,y_mm\n9,7\n-9,7\n-9,-7\n9,-7\n")
    (tmp_path / "data" / "spot.npz").write_bytes(tif_bytes(MeasuredTif(np.eye(9), 0.5)))
    part = LENS.replace("aperture_mm = 20", 'polygon_file = "data/corners.csv"')
    init(tmp_path, part + '[spot]\nfile = "data/spot.npz"\n')
    config = load_config(tmp_path / "cell" / "cell.toml")
    assert config.outline().size_mm == pytest.approx((18.0, 14.0))
    assert read_tif(config.resolve(str(config.process.tif))).rate_nm_s.tolist() == np.eye(9).tolist()


POINTS = "\n".join(
    f"{x} {y} {0.2 * x + 0.1 * y:.4g}" for x in range(-20, 21) for y in range(-20, 21) if x * x + y * y <= 400
)
SAMPLED = LENS.replace("aperture_mm = 20\n", "") + '[instrument]\nsample = "points.xyz"\n'


def test_a_sample_without_units_needs_an_answer_and_says_which(tmp_path: Path) -> None:
    (tmp_path / "points.xyz").write_text(POINTS + "\n")
    with pytest.raises(
        ConfigError, match=r'instrument\.sample: .*Give instrument\.sample_units, as sample_units = "mm,nm"'
    ):
        init(tmp_path, SAMPLED)
    with pytest.raises(ConfigError, match="as mm,nm"):
        init(tmp_path, SAMPLED + 'sample_units = "mm,waves"\n')
    assert not (tmp_path / "cell").exists()


@pytest.mark.parametrize(
    ("units", "what"),
    [
        ("um,um", r"instrument\.sample_units: points\.xyz is then 0\.041 mm wide, and the part 20 mm"),
        ("in,um", "is then 1041 mm wide"),
        ("pm,um", "less than 1 nm"),
    ],
)
def test_the_size_of_a_sample_in_the_answered_units_must_fit_the_part(tmp_path: Path, units: str, what: str) -> None:
    (tmp_path / "points.xyz").write_text(POINTS + "\n")
    with pytest.raises(ConfigError, match=what):
        init(tmp_path, LENS + f'[instrument]\nsample = "points.xyz"\nsample_units = "{units}"\n')
    assert not (tmp_path / "cell").exists()


@pytest.mark.full
def test_with_the_answer_the_profile_says_what_the_files_do_not(tmp_path: Path) -> None:
    (tmp_path / "points.xyz").write_text(POINTS + "\n")
    init(tmp_path, SAMPLED + 'sample_units = "mm,um"\n')
    instrument = load_profile(tmp_path / "cell" / "instrument.toml").instrument
    assert (instrument.pitch_mm, instrument.unit_nm) == (1.0, 1e3)
    assert instrument.coordinate_unit_mm == 1.0
    assert load_config(tmp_path / "cell" / "cell.toml").part.aperture_mm == 41
    surface = MapSource.of(None, tmp_path / "cell" / "instrument.toml").read(tmp_path / "points.xyz")
    assert surface.pitch_mm == 1.0
    assert np.nanmax(surface.height_nm) == pytest.approx(1e3 * np.hypot(0.2, 0.1) * 20, rel=0.02)


@pytest.mark.full
def test_the_profile_of_a_sample_that_is_not_square_reads_it_again(tmp_path: Path) -> None:
    lines = [line.split() for line in POINTS.splitlines()]
    (tmp_path / "points.xyz").write_text("".join(f"{x} {1.08 * float(y):g} {z}\n" for x, y, z in lines))
    init(tmp_path, SAMPLED + 'sample_units = "mm,um"\n')
    profile = tmp_path / "cell" / "instrument.toml"
    assert load_profile(profile).instrument.coordinate_unit_mm == 1.0
    surface = MapSource.of(None, profile, partly=False).read(tmp_path / "points.xyz")
    assert surface.pitch_mm == 1.0
    assert surface.height_nm.shape == (44, 41)


@pytest.mark.full
def test_a_map_without_a_scale_is_given_a_pitch(tmp_path: Path) -> None:
    dat(tmp_path / "bare.dat", np.where(np.hypot(*np.mgrid[-20:21, -20:21]) < 20, 3.0, np.nan), pitch_mm=0.0)
    answers = SAMPLED.replace("points.xyz", "bare.dat")
    with pytest.raises(ConfigError, match=r"Give instrument\.sample_pitch_mm, as sample_pitch_mm = 0\.1"):
        init(tmp_path, answers)
    with pytest.raises(ConfigError, match="less than 1 nm"):
        init(tmp_path, answers + "sample_pitch_mm = 1e-9\n")
    init(tmp_path, answers + "sample_pitch_mm = 0.5\n")
    assert load_profile(tmp_path / "cell" / "instrument.toml").instrument.pitch_mm == 0.5


@pytest.mark.full
def test_a_part_whose_assumed_place_is_out_of_reach_lies_where_the_robot_reaches_it(tmp_path: Path) -> None:
    """The paper's robot does not reach 300 mm at the place that is assumed for smaller parts."""
    for answers in ("[part]\naperture_mm = 300.0\n", '[kinematics]\narm = "ur16e"\n[part]\naperture_mm = 300.0\n'):
        config = drafted(tmp_path, answers)
        assert not reached(config)
        seat = find_seat(config)
        assert seat is not None
        assert seat.share == 1.0
        moved = config.model_copy(update={"part": config.part.model_copy(update={"origin_mm": seat.origin_mm})})
        assert reached(moved)
        assert np.linalg.norm(np.subtract(seat.origin_mm, config.part.origin_mm)) < 150.0
    config = drafted(tmp_path, "[part]\naperture_mm = 200.0\n")
    assert find_seat(config) == Seat(config.part.origin_mm)


def drafted(folder: Path, answers: str) -> CellConfig:
    """The cell of these answers, as it is before its part is moved."""
    return draft_cell(answers_of(answers, folder / "answers.toml"), folder / "cell", load_own()).judged()


@pytest.mark.parametrize(
    ("part", "job"), [("LENS 7", "LENS-7"), ("Größe 4", "Gr-e-4"), ("鏡", "job"), ("x" * 70, "x" * 64)]
)
def test_a_job_is_named_after_its_part_in_the_characters_of_a_name(tmp_path: Path, part: str, job: str) -> None:
    config = drafted(tmp_path, f'part = {{ id = "{part}", aperture_mm = 100 }}\njob.tolerance_nm = 2\n')
    assert (config.part.id, config.job.id) == (part, job)


@pytest.mark.full
@pytest.mark.parametrize("part", ["aperture_mm = 300.0", "rectangle_mm = [400.0, 300.0]"])
def test_a_large_part_becomes_a_cell_whose_plan_takes_the_program(tmp_path: Path, part: str) -> None:
    shown = init(tmp_path, f"[part]\n{part}\n")
    assert shown["written"] == ["cell.toml", "drive.eds", "instrument.toml", "program.rnc"]
    assert "moved to where the robot reaches all of it" in shown["look"]["part.origin_mm"]
    config, hooks = load_cell(tmp_path / "cell" / "cell.toml")
    recipe = make_recipe(config, hooks)
    assert precheck.precheck_plan(recipe, steps.read_program(recipe, config.program_path), hooks.check_plan) == []


@pytest.mark.full
@pytest.mark.parametrize(
    ("answers", "said"),
    [
        (
            "[part]\naperture_mm = 800.0\n",
            r"toml:2: part\.aperture_mm: the robot reaches a circle of 800 mm.*; one of \d0% of that size fits at part",
        ),
        (
            "[part]\naperture_mm = 12.0\norigin_mm = [600.0, 440.0, 2315.0]\n",
            r"toml:3: part\.origin_mm: the robot does not reach all of a circle of 12 mm there; it does at part\.or",
        ),
    ],
)
def test_a_part_out_of_reach_is_one_error_with_what_would_be_within_it(tmp_path: Path, answers: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        init(tmp_path, answers)
    assert not (tmp_path / "cell").exists()
    shown = init(tmp_path, answers + '[program]\nmake = "none"\n')
    assert "cell.toml" in shown["written"]


@pytest.mark.slow
@pytest.mark.parametrize("tool_radius_mm", [20.0, 80.0])
def test_the_dwell_of_a_part_of_300_mm_is_solved_within_30_s_of_cpu_time(tmp_path: Path, tool_radius_mm: float) -> None:
    """With 9.8 million entries a matrix takes several times as long; with 4.7 million it is the quicker one."""
    init(tmp_path, f"[part]\naperture_mm = 300.0\n[process]\ntool_radius_mm = {tool_radius_mm}\n")
    height = surface(600, 600)
    measured = dat(tmp_path / "part.dat", height, part="PART-1")
    words = ["plan", str(tmp_path / "cell" / "cell.toml"), str(measured), "--out", str(tmp_path / "plan"), "--json"]
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 0, said.output
    certificate = json.loads((tmp_path / "plan" / "certificate.json").read_text())
    assert certificate["stopped"] == "converged"
    assert certificate["seconds"] < 30.0
