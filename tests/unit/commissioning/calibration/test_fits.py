"""``polishd calibrate`` as from the shell: what it finds, the fragment it writes, and that a cell takes it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from polishd.config.cell import load_config
from polishd.model.process import HybridRobot, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.removal.contact import hertz_depth_mm, removal_rate_nm_s, volume_rate_nm_mm2_s
from polishd.process.robot.compliance import tip_compliance_mm_per_n
from polishd.sim_backends.common.metropro import DatMap, pack
from tests.unit.cli_result import Polishd
from tests.unit.process.moves import inward_axis

EXAMPLE = Path(__file__).parents[4] / "examples" / "cell.toml"
TRUE = dataclasses.replace(
    HybridRobot(), limb_stiffness_n_per_mm=16.0e3, a_stiffness_n_mm_per_rad=5.5e7, c_stiffness_n_mm_per_rad=7.0e7
)
COLUMNS = "x_mm,y_mm,z_mm,axis_x,axis_y,axis_z,dir_x,dir_y,dir_z,compliance_um_per_n"


def loading_tests(path: Path, n: int, noise: float, seed: int) -> Path:
    """Tests of the true robot at random places, the tool dipped inward, loaded along the normal and sideways."""
    rng = np.random.default_rng(seed)
    radius, angle = rng.uniform(50, 400, n), rng.uniform(0, 2 * np.pi, n)
    tip = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(1750, 2250, n)])
    normal = np.tile([0.0, 0.0, -1.0], (n, 1))
    axis = inward_axis(tip, normal, 15.0)
    side = rng.standard_normal((n, 3))
    direction = np.where(np.arange(n)[:, None] % 2 == 0, normal, side / np.linalg.norm(side, axis=1)[:, None])
    matrix = tip_compliance_mm_per_n(TRUE, tip, axis) * 1e3
    found = np.einsum("ni,nij,nj->n", direction, matrix, direction) * (1 + noise * rng.standard_normal(n))
    rows = np.column_stack([tip, axis, direction, found])
    np.savetxt(path, rows, delimiter=",", header=COLUMNS, comments="", fmt="%.9g")
    return path


def cell_with(tmp_path: Path, *fragments: str) -> Path:
    listed = ", ".join(f'"{name}"' for name in fragments)
    (tmp_path / "cell.toml").write_text(f"include = [{listed}]\n{EXAMPLE.read_text()}")
    return tmp_path / "cell.toml"


@pytest.mark.full
def test_stiffnesses_are_found_and_a_cell_takes_them(polishd: Polishd, tmp_path: Path) -> None:
    tests = loading_tests(tmp_path / "tests.csv", 40, 0.03, 1)
    more = loading_tests(tmp_path / "more.csv", 200, 0.0, 2)
    out = tmp_path / "stiff.toml"
    answer = polishd("calibrate", "stiffness", tests, "--held-out", more, "--out", out, "--json").answer
    assert answer["held_out"]["tests"] == 200
    assert answer["held_out"]["mean_percent"] < 4.19
    assert answer["held_out"]["max_percent"] < 6.38
    assert answer["cross_validated"]["mean_percent"] < 6.0
    robot = load_config(cell_with(tmp_path, "stiff.toml")).robot_model()
    assert isinstance(robot, HybridRobot)
    assert robot.a_stiffness_n_mm_per_rad == pytest.approx(5.5e7, rel=0.1)
    assert robot.limb_stiffness_n_per_mm == pytest.approx(16.0e3, rel=0.15)
    assert robot.tool_length_mm == 420.0, "what was not fitted is the cell's"


def made_up(path: Path, n: int, spread: float, seed: int) -> Path:
    """Write a file with the same places and invented numbers."""
    rows = np.loadtxt(loading_tests(path, n, 0.0, seed), delimiter=",", skiprows=1)
    rows[:, -1] = 1.5 * (1 + spread * np.random.default_rng(seed).uniform(-1, 1, n))
    np.savetxt(path, rows, delimiter=",", header=COLUMNS, comments="", fmt="%.9g")
    return path


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("n", "spread"), [(12, 0.4), (40, 0.4), (40, 0.15)])
def test_random_numbers_are_not_believed(polishd: Polishd, tmp_path: Path, n: int, spread: float, seed: int) -> None:
    tests, out = made_up(tmp_path / "t.csv", n, spread, seed), tmp_path / "stiff.toml"
    said = polishd("calibrate", "stiffness", tests, "--out", out)
    assert (said.code, said.out) == (10, "")
    assert f"{tests}: the fit is off by " in said.err
    assert "nothing was written (--anyway writes it)" in said.err
    assert not out.exists()


@pytest.mark.full
def test_random_numbers_are_written_if_one_insists_and_the_fragment_says_so(polishd: Polishd, tmp_path: Path) -> None:
    tests, out = made_up(tmp_path / "t.csv", 40, 0.4, 1), tmp_path / "stiff.toml"
    shown = polishd("calibrate", "stiffness", tests)
    assert shown.code == 0, "without --out it is only shown"
    assert "DO NOT BELIEVE THIS: the fit is off by " in shown.err
    answer = polishd("calibrate", "stiffness", tests, "--out", out, "--anyway", "--json").answer
    assert len(answer["doubts"]) >= 1
    assert "; DOUBTFUL: the fit is off by " in out.read_text()
    load_config(cell_with(tmp_path, "stiff.toml"))


@pytest.mark.one_of_each
@pytest.mark.parametrize("noise", [0.03, 0.05])
@pytest.mark.parametrize("n", [12, 40])
@pytest.mark.parametrize("seed", range(5))
def test_good_tests_are_believed(polishd: Polishd, tmp_path: Path, n: int, noise: float, seed: int) -> None:
    out = tmp_path / "stiff.toml"
    said = polishd("calibrate", "stiffness", loading_tests(tmp_path / "t.csv", n, noise, seed), "--out", out, "--json")
    assert said.answer["doubts"] == []
    assert out.exists()


@pytest.mark.full
def test_held_out_tests_of_another_robot_are_reported(polishd: Polishd, tmp_path: Path) -> None:
    tests, other = loading_tests(tmp_path / "t.csv", 40, 0.03, 1), made_up(tmp_path / "o.csv", 40, 0.4, 2)
    (doubt,) = polishd("calibrate", "stiffness", tests, "--held-out", other, "--json").answer["doubts"]
    assert doubt.startswith("the held-out tests are off by ")


@pytest.mark.full
def test_people_see_uncertainties_and_errors(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("calibrate", "stiffness", loading_tests(tmp_path / "t.csv", 40, 0.03, 3), "--cell", EXAMPLE)
    assert said.code == 0
    assert "a_stiffness_n_mm_per_rad" in said.out
    assert "error cross-validated: mean " in said.out
    assert "the tests do not determine up_" in said.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.csv"], "without --out nothing is written"


@pytest.mark.parametrize(
    ("spoil", "code", "says"),
    [
        (lambda text: text.replace("dir_x", "dirx"), 3, "t.csv:1: the column 'dir_x' is missing"),
        (lambda text: text.replace("\n", "\n\n", 3).rsplit(",", 1)[0] + ",soft\n", 3, "compliance_um_per_n is 'soft'"),
        (lambda text: "\n".join(text.splitlines()[:4]) + "\n", 10, "3 loading tests are too few"),
        (lambda text: text.rsplit(",", 1)[0] + ",-1.5\n", 10, "point 19: the compliance of loading test is -1.5 um/N"),
    ],
)
def test_a_table_that_is_none_is_refused(polishd: Polishd, tmp_path: Path, spoil: object, code: int, says: str) -> None:
    path = loading_tests(tmp_path / "t.csv", 20, 0.03, 1)
    path.write_text(spoil(path.read_text()))  # type: ignore[operator]
    said = polishd("calibrate", "stiffness", path, "--out", tmp_path / "out.toml", "--json")
    assert said.failure == code
    assert says in said.err
    assert not (tmp_path / "out.toml").exists()


def test_a_measured_cell_has_no_stiffness(polishd: Polishd, tmp_path: Path) -> None:
    text = EXAMPLE.read_text().replace('type = "hybrid" ', 'type = "measured"\ntable = "t.csv" ')
    (tmp_path / "cell.toml").write_text(text.replace("tool_length_mm = 420.0", ""))
    (tmp_path / "t.csv").write_text("x_mm,y_mm,z_mm,compliance_um_per_n\n1,2,3,1.5\n")
    tests = loading_tests(tmp_path / "tests.csv", 20, 0.03, 1)
    said = polishd("calibrate", "stiffness", tests, "--cell", tmp_path / "cell.toml")
    assert said.code == 3
    assert "kinematics.type: 'measured': a table has no stiffness to fit" in said.err


def map_file(path: Path, height_nm: FloatArray, pitch_mm: float = 0.05) -> Path:
    path.write_bytes(pack(DatMap(height_nm, pitch_mm, "DEMO-100")))
    return path


@pytest.fixture
def spot_maps(tmp_path: Path) -> tuple[Path, Path]:
    """Before and after 20 s of the paper's spot at gamma 0.9 with a Preston constant of 2e-9 cm2/N; tilt and noise."""
    process = ToolProcess(preston_cm2_per_n=2e-9)
    x = (np.arange(200) - 99.5) * 0.05
    right, up = x[None, :] - 0.4, -x[:, None] + 0.25
    spot = 20 * removal_rate_nm_s(process, 0.9 * hertz_depth_mm(process), right, up)
    rng = np.random.default_rng(2)
    before = 30 * np.sin(right / 3) * np.cos(up / 4)
    after = before - spot + 5 * right + 2 + rng.standard_normal(spot.shape)
    return map_file(tmp_path / "before.dat", before), map_file(tmp_path / "after.dat", after)


def test_a_spot_becomes_a_tif_and_a_preston_constant(
    polishd: Polishd, tmp_path: Path, spot_maps: tuple[Path, Path]
) -> None:
    out = tmp_path / "tif.toml"
    words = ("calibrate", "tif", *spot_maps, "--seconds", "20", "--depth-ratio", "0.9", "--azimuth-deg", "90")
    answer = polishd(*words, "--out", out, "--json").answer
    process = ToolProcess(preston_cm2_per_n=2e-9)
    volume = float(volume_rate_nm_mm2_s(process, 0.9 * hertz_depth_mm(process))[0]) * 60e-6
    assert answer["volume_mm3_min"] == pytest.approx(volume, rel=0.01)
    assert answer["preston_cm2_per_n"] == pytest.approx(2e-9, rel=0.01)
    assert answer["centroid_mm"] == pytest.approx([0.4, -0.25 + 0.1], abs=0.05)
    config = load_config(cell_with(tmp_path, "tif.toml"))
    assert config.process.removal_model == "measured_tif"
    assert config.tool_process().preston_cm2_per_n == pytest.approx(2e-9, rel=0.01)
    tif = config.measured_tif()
    assert tif is not None
    assert (tif.depth_ratio, tif.azimuth_deg, tif.pitch_mm) == (0.9, 90.0, pytest.approx(0.05))
    assert tif.rate_nm_s.sum() * 0.05**2 * 60e-6 == pytest.approx(volume, rel=0.01)
    assert polishd("tif", tmp_path / "cell.toml", "--json").answer["volume_mm3_min"] == pytest.approx(volume, rel=0.01)


def test_the_fragment_names_the_tif_as_the_cell_sees_it(
    polishd: Polishd, tmp_path: Path, spot_maps: tuple[Path, Path]
) -> None:
    (tmp_path / "fits").mkdir()
    cell = cell_with(tmp_path)
    out = tmp_path / "fits" / "tif.toml"
    assert polishd("calibrate", "tif", *spot_maps, "--seconds", "20", "--cell", cell, "--out", out).code == 0
    assert load_config(cell_with(tmp_path, "fits/tif.toml")).measured_tif() is not None


@pytest.mark.full
def test_maps_that_do_not_fit_or_show_no_spot_are_refused(
    polishd: Polishd, tmp_path: Path, spot_maps: tuple[Path, Path]
) -> None:
    before, after = spot_maps
    small = map_file(tmp_path / "small.dat", np.full((50, 50), 7.0))
    assert "has not the samples of before.dat" in polishd("calibrate", "tif", before, small, "--seconds", "20").err
    said = polishd("calibrate", "tif", after, before, "--seconds", "20", "--out", tmp_path / "t.toml")
    assert said.code == 10
    assert "no spot stands out" in said.err
    assert polishd("calibrate", "tif", before, after, "--seconds", "0").code == 10
    assert not list(tmp_path.glob("t.*"))
    (tmp_path / "t.npz").mkdir()
    said = polishd("calibrate", "tif", before, after, "--seconds", "20", "--out", tmp_path / "t.toml")
    assert (said.code, list(tmp_path.glob("t.*"))) == (3, [tmp_path / "t.npz"]), "the two files or none"


def test_the_exponent_is_found_and_a_cell_takes_it(polishd: Polishd, tmp_path: Path) -> None:
    gamma = np.linspace(0.6, 1.0, 9)
    volume = 0.058 * gamma**1.42 * (1 + 0.01 * np.random.default_rng(0).standard_normal(9))
    rows = np.column_stack([gamma, volume])
    np.savetxt(tmp_path / "spots.csv", rows, delimiter=",", header="depth_ratio,volume_mm3_min", comments="")
    answer = polishd("calibrate", "exponent", tmp_path / "spots.csv", "--out", tmp_path / "m.toml", "--json").answer
    assert answer["exponent"] == pytest.approx(1.42, abs=3 * answer["uncertainty"])
    assert answer["uncertainty"] < 0.05
    process = load_config(cell_with(tmp_path, "m.toml")).tool_process()
    assert process.depth_exponent == pytest.approx(answer["exponent"], rel=1e-3)
    assert "+-" in polishd("calibrate", "exponent", tmp_path / "spots.csv").out


def test_a_fragment_has_a_name_that_a_cell_can_include(polishd: Polishd, tmp_path: Path) -> None:
    (tmp_path / "spots.csv").write_text("depth_ratio,volume_mm3_min\n0.6,1\n0.8,1.5\n1,2.1\n")
    said = polishd("calibrate", "exponent", tmp_path / "spots.csv", "--out", tmp_path / "m.json")
    assert said.code == 3
    assert "a fragment is a TOML file" in said.err
    said = polishd("calibrate", "exponent", tmp_path / "spots.csv", "--out", tmp_path / "none" / "m.toml")
    assert said.code == 3
    assert "cannot be written" in said.err
