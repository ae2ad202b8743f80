"""``polishd map absolute``: an instrument of a known error and a known part come back from their maps' files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.maps.map_files import MapSource
from polishd.model.surface import FloatArray
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat
from tests.unit.process.metrology.turned_maps import PITCH_MM, instrument_nm, maps, part_nm, rms_nm, true_nm, turns

NOISE_NM = 0.3
QUARTERS = ["--angles", "0,90,180,270"]


@pytest.fixture(scope="module")
def heights() -> list[FloatArray]:
    return maps(turns(4), NOISE_NM)


@pytest.fixture
def files(tmp_path: Path, heights: list[FloatArray]) -> list[Path]:
    return [dat(tmp_path / f"p{number}.dat", height, PITCH_MM) for number, height in enumerate(heights)]


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "ending", [".dat", pytest.param(".datx", marks=pytest.mark.full), pytest.param(".x3p", marks=pytest.mark.full)]
)
def test_instrument_and_part_come_back(polishd: Polishd, tmp_path: Path, files: list[Path], ending: str) -> None:
    if ending != ".dat":
        for file in files:
            assert polishd("map", "convert", file, file.with_suffix(ending)).code == 0
    given = [file.with_suffix(ending) for file in files]
    system, part = tmp_path / "system.x3p", tmp_path / "part.datx"
    asked = [*QUARTERS, "--out-instrument", system, "--out-part", part, "--json"]
    answer = polishd("map", "absolute", *given, *asked).answer
    instrument = MapSource.of().read(system)
    off = instrument.height_nm - true_nm(instrument_nm)
    assert rms_nm(off) < 0.2 * rms_nm(true_nm(instrument_nm))
    assert rms_nm(off) == pytest.approx(answer["sample_uncertainty_nm"], rel=0.5)
    assert rms_nm(MapSource.of().read(part).height_nm - true_nm(part_nm)) < NOISE_NM
    terms = {(one["n"], one["m"]): one for one in answer["terms"]}
    assert terms[2, 2]["instrument_nm"] == pytest.approx(3 / 6**0.5, abs=0.02)
    assert terms[2, 2]["unknown"] == 0
    assert terms[4, 4]["unknown"] == pytest.approx(1)
    assert {"power", "spherical", "tetrafoil"} <= set(answer["unknown"])
    assert "astigmatism" not in answer["unknown"]
    assert "radius" in answer["demanded"]["power"]
    assert answer["noise_nm"] == pytest.approx(NOISE_NM, rel=0.15)
    assert answer["sense_told"]
    assert answer["hidden_share"] == pytest.approx(0.25, abs=0.05)
    assert answer["instrument"]["out"] == str(system)


@pytest.mark.full
def test_the_system_map_makes_another_map_true(polishd: Polishd, tmp_path: Path, files: list[Path]) -> None:
    """What it is for: the first map less the instrument's, by ``map subtract``, is the part."""
    system, less = tmp_path / "system.x3p", tmp_path / "less.x3p"
    assert polishd("map", "absolute", *files, *QUARTERS, "--out-instrument", system).code == 0
    assert polishd("map", "subtract", files[0], system, "--out", less).code == 0
    off = MapSource.of().read(less).height_nm - true_nm(part_nm)
    assert rms_nm(off) < 1.3 * NOISE_NM
    assert rms_nm(MapSource.of().read(files[0]).height_nm - true_nm(part_nm)) > 4 * NOISE_NM


@pytest.mark.full
def test_the_text_says_what_is_unknown_and_the_file_keeps_its_origin(
    polishd: Polishd, tmp_path: Path, files: list[Path]
) -> None:
    system, picture = tmp_path / "s.x3p", tmp_path / "s.png"
    said = polishd("map", "absolute", *files, *QUARTERS, "--out-instrument", system, "--picture", picture).out
    for words in (
        "unknown, and left in the part: power, spherical",
        "needs a reference of known radius or a flat of known power: power",
        "one more angle, 45 deg from one of 0, 90, 180, 270: tetrafoil",
        "gravity, counts as instrument",
        "secondary astigmatism cos",
        "orders 5 to 10, RMS",
        "and of waves above order 10 26% in square",
    ):
        assert words in " ".join(said.split())
    assert picture.read_bytes().startswith(b"\x89PNG")
    kept = MapSource.of().read(system).history
    assert kept is not None
    assert kept.verb == "absolute"
    assert kept.options["poses"][1] == "p1.dat 90 deg"
    assert "power" in kept.options["without"]
    assert [one.role for one in kept.inputs] == ["map"] * 4
    assert kept.uncertainty_nm is not None


@pytest.mark.full
def test_angles_may_stand_in_a_list(polishd: Polishd, tmp_path: Path, files: list[Path]) -> None:
    listed = tmp_path / "poses.csv"
    listed.write_text("file,angle_deg\n" + "".join(f"p{number}.dat,{90 * number}\n" for number in range(4)))
    by_list = polishd("map", "absolute", *files, "--at", listed, "--json").answer
    assert by_list == polishd("map", "absolute", *files, *QUARTERS, "--json").answer
    listed.write_text("file,angle_deg,x_mm,y_mm\np0.dat,0,,\np1.dat,90,6,0\n")
    answer = polishd("map", "absolute", *files[:2], "--at", listed, "--json").answer
    assert [one["shift_mm"] for one in answer["maps"]] == [[0, 0], [6, 0]]
    assert any("where the pose puts it: p0.dat" in note for note in answer["notes"])  # not shifted
    for text, message in {
        "file,angle_deg\np0.dat,0\np1.dat,quarter\n": "poses.csv:3: angle_deg is 'quarter'",
        "file,angle_deg\np0.dat,0\n": "poses.csv: does not say where p1.dat lies; add a line file,angle_deg",
        "file,turn\np0.dat,0\n": "the column 'angle_deg' is missing",
    }.items():
        listed.write_text(text)
        said = polishd("map", "absolute", *files[:2], "--at", listed)
        assert said.code == 3
        assert message in said.err


def test_a_wrong_sense_is_one_line(polishd: Polishd, files: list[Path]) -> None:
    said = polishd("map", "absolute", *files, "--angles", "0,-90,-180,-270")
    assert said.code == 8
    assert "times better with the angles' signs turned" in said.err
    assert "counter-clockwise as the maps are displayed" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.full
def test_what_cannot_be_distinguished_is_refused(polishd: Polishd, tmp_path: Path, files: list[Path]) -> None:
    for asked, code, message in (
        (["--angles", "0,90"], 2, "4 numbers with commas"),
        (["--angles", "0,90,x,1"], 2, "4 numbers with commas"),
        ([], 2, "--angles"),
        ([*QUARTERS, "--shifts", "0,0:1,0"], 2, "2 shifts for 4 maps"),
        (["--angles", "0,0,0,0"], 8, "lies alike in all maps"),
        ([*QUARTERS, "--out-part", files[0]], 3, "is the map that is read"),
        ([*QUARTERS, "--out-part", tmp_path / "a.x3p", "--out-instrument", tmp_path / "a.x3p"], 3, "name two files"),
    ):
        said = polishd("map", "absolute", *files, *asked)
        assert said.code == code, asked
        assert message in " ".join(said.err.replace("│", " ").split()), asked
    one = polishd("map", "absolute", files[0], "--angles", "0")
    assert one.code == 8
    assert "turn the part and measure again" in one.err


def test_maps_of_another_pitch_or_size_are_named(
    polishd: Polishd, tmp_path: Path, files: list[Path], heights: list[FloatArray]
) -> None:
    dat(files[1], heights[1], 2 * PITCH_MM)
    said = polishd("map", "absolute", *files, *QUARTERS)
    assert said.code == 8
    assert "p1.dat: has a pitch of 2 mm" in said.err
    dat(files[1], heights[1][1:], PITCH_MM)
    said = polishd("map", "absolute", *files, *QUARTERS)
    assert said.code == 8
    assert "88 x 89 and 89 x 89 samples" in said.err
    dat(files[1], heights[1], 0.0)
    assert "p1.dat: has no lateral scale" in polishd("map", "absolute", *files, *QUARTERS).err


@pytest.mark.full
def test_an_axis_that_is_given_is_taken(polishd: Polishd, files: list[Path]) -> None:
    middle, off = (
        polishd("map", "absolute", *files, *QUARTERS, "--axis", axis, "--json").answer for axis in ("0,0", "3,-2")
    )
    assert middle["axis_mm"] == pytest.approx([0, 0])
    assert off["axis_mm"] == pytest.approx([3, -2])
    assert off["noise_nm"] > 3 * middle["noise_nm"]
    assert np.isfinite(off["sample_uncertainty_nm"])
