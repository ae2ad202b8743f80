"""``polishd tif`` and ``polishd compliance`` as from the shell: figures, pictures, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polishd.commissioning.rehearsal.simulated_cell import demo_program
from polishd.config.cell import load_config
from polishd.config.table_files import tif_bytes
from polishd.model.process import MeasuredTif
from tests.unit.cli_result import Polishd

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"


def changed(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "cell.toml").write_text(text)
    return tmp_path / "cell.toml"


def test_the_tif_of_the_paper(polishd: Polishd) -> None:
    answer = polishd("tif", EXAMPLE, "--json").answer
    assert answer["depth_mm"] == pytest.approx(0.14835, abs=5e-6)
    assert answer["contact_radius_mm"] == pytest.approx(1.7225, abs=5e-5)
    assert answer["peak_pressure_mpa"] == pytest.approx(1.9311, abs=5e-5)
    assert answer["peak_nm_s"] == pytest.approx(162, abs=0.5)
    assert answer["volume_mm3_min"] == pytest.approx(0.058, abs=5e-4)
    assert 0 < answer["dissipative_fraction"] < 1e-3
    profile = answer["profile_y"]
    assert len(profile["y_mm"]) == len(profile["rate_nm_s"])
    assert max(profile["rate_nm_s"]) == pytest.approx(answer["peak_nm_s"], rel=1e-3)


def test_a_smaller_depth_removes_as_its_power_of_1_5(polishd: Polishd) -> None:
    whole, part = (polishd("tif", EXAMPLE, "--depth-ratio", g, "--json").answer for g in ("1", "0.87"))
    assert part["depth_mm"] / whole["depth_mm"] == pytest.approx(0.87)
    assert part["volume_mm3_min"] / whole["volume_mm3_min"] == pytest.approx(0.87**1.5, rel=2e-3)
    assert part["contact_radius_mm"] / whole["contact_radius_mm"] == pytest.approx(0.87**0.5)


@pytest.mark.full
def test_people_get_a_table_and_a_picture(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("tif", EXAMPLE, "--out", tmp_path / "spot.png")
    assert said.code == 0
    assert "0.14835 mm" in said.out
    assert f"written to {tmp_path}" in said.out.replace("\n", "")
    with Image.open(tmp_path / "spot.png") as picture:
        assert min(picture.size) > 300


def test_a_resolved_force_goes_deeper(polishd: Polishd, tmp_path: Path) -> None:
    cell = changed(tmp_path, ("force_n = 12.0\n", 'force_n = 12.0\nnormal_force = "resolved"\n'))
    assert polishd("tif", cell, "--json").answer["depth_mm"] == pytest.approx(0.1518, abs=5e-5)


@pytest.mark.full
def test_a_measured_tif_shows_what_was_measured(polishd: Polishd, tmp_path: Path) -> None:
    x = np.arange(-20, 21) * 0.1
    (tmp_path / "spot.npz").write_bytes(
        tif_bytes(MeasuredTif(30 * np.exp(-(x[:, None] ** 2) - x[None, :] ** 2), 0.1, 90.0, 0.9))
    )
    cell = changed(tmp_path, ('removal_model = "hertz_preston"', 'removal_model = "measured_tif"\ntif = "spot.npz"'))
    answer = polishd("tif", cell, "--json", "--out", tmp_path / "spot.png").answer
    assert (answer["depth_ratio"], answer["peak_nm_s"]) == (0.9, 30.0)
    assert answer["volume_mm3_min"] == pytest.approx(30 * np.pi * 60e-6, rel=0.02)
    assert (tmp_path / "spot.png").stat().st_size > 1000


@pytest.mark.parametrize("ratio", ["0", "-1", "nan"])
def test_a_depth_ratio_that_is_none_is_refused(polishd: Polishd, ratio: str) -> None:
    said = polishd("tif", EXAMPLE, "--depth-ratio", ratio, "--json")
    assert said.failure == 10
    assert "depth ratio" in said.err


@pytest.mark.full
def test_a_picture_that_cannot_be_written_is_one_clear_error(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("tif", EXAMPLE, "--out", tmp_path / "none" / "spot.png")
    assert said.code == 3
    assert "spot.png: cannot be written" in said.err


def test_the_compliance_of_the_shipped_robot_is_the_published_one(polishd: Polishd) -> None:
    answer = polishd("compliance", EXAMPLE, "--json").answer
    found = answer["workspace"]
    assert 1.03 < found["compliance_um_per_n"]["min"] < found["compliance_um_per_n"]["max"] < 1.98
    assert 0.83 < found["gamma"]["min"] < found["gamma"]["max"] < 0.92
    assert 0 < found["out_of_reach"] < 0.15 * found["places"]
    assert "program" not in answer


@pytest.mark.full
def test_the_compliance_along_a_program(polishd: Polishd, tmp_path: Path) -> None:
    (tmp_path / "p.rnc").write_bytes(demo_program(load_config(EXAMPLE)))
    said = polishd("compliance", EXAMPLE, "--program", tmp_path / "p.rnc", "--out", tmp_path / "c.png", "--json")
    along = said.answer["program"]
    assert along["points"] > 5000
    assert 0.86 < along["gamma"]["min"] < along["gamma"]["max"] < 0.885
    assert (along["jumps"], along["fallbacks"]) == (0, 0)
    with Image.open(tmp_path / "c.png") as picture:
        assert picture.size[0] > picture.size[1] > 400
    assert "along p.rnc" in polishd("compliance", EXAMPLE, "--program", tmp_path / "p.rnc").out


@pytest.mark.full
def test_a_frenet_frame_on_a_raster_says_how_often_there_is_none(polishd: Polishd, tmp_path: Path) -> None:
    cell = changed(tmp_path, ('frame = "surface"', 'frame = "frenet"'))
    (tmp_path / "p.rnc").write_bytes(demo_program(load_config(EXAMPLE)))
    along = polishd("compliance", cell, "--program", tmp_path / "p.rnc", "--json").answer["program"]
    assert along["fallbacks"] > 0.9 * along["points"]


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (("origin_mm = [300.0, 220.0, 2315.0]", "origin_mm = [900.0, 220.0, 2315.0]"), 10, "point 0: "),
        (("tool_length_mm = 420.0", "tool_length_mm = 420.0\nlimb_ea_n = -1.0"), 3, "limb_ea_n: -1.0 is out of range"),
        (("dip_deg = 15.0", "dip_deg = 90.0"), 3, "process.dip_deg: 90.0 is out of range"),
        (("[compliance]", "a_stiffness_n_mm_per_rad = 2e6\n[compliance]"), 10, "gamma would not be above 0"),
    ],
)
def test_what_cannot_be_is_refused_by_value_unit_and_point(
    polishd: Polishd, tmp_path: Path, change: tuple[str, str], code: int, says: str
) -> None:
    (tmp_path / "p.rnc").write_bytes(demo_program(load_config(EXAMPLE)))
    said = polishd("compliance", changed(tmp_path, change), "--program", tmp_path / "p.rnc", "--json")
    assert said.failure == code
    assert says in said.err
    assert said.err.startswith("polishd: ")


@pytest.mark.full
def test_the_place_of_least_change_is_shown_written_and_found_again(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("compliance", EXAMPLE, "--place", "--within", 100, "--out", tmp_path / "p.png", "--json").answer
    best, present = said["best"][0], said["present"]
    assert said["gain_nm"] == pytest.approx(present["error_nm"] - best["error_nm"])
    assert best["error_nm"] <= present["error_nm"]
    with Image.open(tmp_path / "p.png") as picture:
        assert picture.size[0] > 400
    origin = "origin_mm = [300.0, 220.0, 2315.0]"
    assert origin in EXAMPLE.read_text()
    moved = changed(tmp_path, (origin, f"origin_mm = {best['origin_mm']}"))
    again = polishd("compliance", moved, "--place", "--within", 1, "--json").answer["present"]
    assert again["error_nm"] == pytest.approx(best["error_nm"], rel=1e-6)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--within", "0"), "the distance to search within is 0 mm"),
        (("--removal", "-1"), "the mean removal is -1 nm"),
        (("--program", "p.rnc"), "--place searches"),
    ],
)
def test_a_search_that_cannot_be_is_refused(polishd: Polishd, words: tuple[str, str], says: str) -> None:
    said = polishd("compliance", EXAMPLE, "--place", *words)
    assert said.code != 0
    assert says in said.err
    assert said.out == ""
