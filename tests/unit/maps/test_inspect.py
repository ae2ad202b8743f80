"""``polishd map FILE...`` as from the shell: exact figures of real files, JSON as promised, one bad file among good."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sdfio

from polishd.maps.map_files import distinguish_names
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat, surface
from tests.unit.plugins.interferometer.map_files_other import points_file, sdf_second

KEYS = [
    "path", "format", "rows", "cols", "pitch_mm", "pitches_mm", "missing", "pv_nm", "rms_nm", "pv_tilt_removed_nm",
    "rms_tilt_removed_nm", "bands", "sha256", "warnings",
]  # fmt: skip
# metrology.md: rows, columns, pitch in mm, missing samples, PV and RMS about the mean in nm
REAL: dict[str, tuple[int, int, float | None, int, float, float]] = {
    "zygo_metropro.dat": (432, 425, 0.1179242, 47_241, 330.700173, 44.591409),
    "zygo_mx.datx": (259, 33, 1.0, 776, 453.030479, 80.817653),
    "codev.int": (256, 256, None, 14_105, 54.545398, 10.883244),
    "mountainsmap.sdf": (20, 30, 0.001, 1, 599.0, 172.996075),
    # its samples are not square: 0.128 by 0.315 um
    "profilometer.x3p": (650, 650, None, 0, 554.336200, 77.280333),
}


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal in which no table is cut."""
    monkeypatch.setattr(stdout, "_width", 220)


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return dat(tmp_path / "good.dat", surface())


def lines(text: str) -> list[Any]:
    """JSON that holds no NaN and no infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(word)

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", REAL)
def test_real_files_have_the_figures_of_the_page(polishd: Polishd, shared_data: Path, name: str) -> None:
    rows, columns, pitch_mm, missing, pv_nm, rms_nm = REAL[name]
    (answer,) = lines(polishd("map", shared_data / name, "--json").out)
    assert list(answer)[: len(KEYS)] == KEYS
    assert (answer["rows"], answer["cols"], answer["missing"]) == (rows, columns, missing)
    assert answer["pv_nm"] == pytest.approx(pv_nm, rel=1e-6)
    assert answer["rms_nm"] == pytest.approx(rms_nm, rel=1e-6)
    assert answer["pitch_mm"] == (None if pitch_mm is None else pytest.approx(pitch_mm, rel=1e-6))
    assert bool(answer["warnings"]) == (pitch_mm is None)
    assert answer["sha256"] == hashlib.sha256((shared_data / name).read_bytes()).hexdigest()
    assert answer["path"] == str(shared_data / name)
    assert answer["samples"] == rows * columns - missing
    assert 0 < answer["rms_tilt_removed_nm"] <= answer["rms_nm"]


def test_several_real_files_are_a_line_each(polishd: Polishd, shared_data: Path) -> None:
    names = ["codev.int", "mountainsmap.sdf", "zygo_mx.datx"]
    said = polishd("map", *(shared_data / name for name in names), "--json")
    assert (said.code, said.err) == (0, "")
    assert [Path(answer["path"]).name for answer in lines(said.out)] == names


def test_without_lateral_scale(polishd: Polishd, tmp_path: Path) -> None:
    """It is shown, with what is not known as null and a warning; and no band is made up."""
    path = dat(tmp_path / "m.dat", surface(), pitch_mm=0.0)
    answer = polishd("map", path, "--json").answer
    assert (answer["pitch_mm"], answer["bands"], answer["slope_rms_urad"]) == (None, None, None)
    assert "lateral" in " ".join(answer["warnings"])
    said = polishd("map", path)
    assert said.code == 0
    assert "warning: m.dat: CameraRes is 0" in said.out


def test_figures_are_of_the_file_as_it_is(polishd: Polishd, good: Path) -> None:
    height = surface()
    inside = height[np.isfinite(height)]
    answer = polishd("map", good, "--json").answer
    assert answer["pv_nm"] == pytest.approx(np.ptp(inside), abs=0.005)
    assert answer["rms_nm"] == pytest.approx(inside.std(), abs=0.002)
    assert answer["pitch_mm"] == pytest.approx(PITCH_MM, rel=1e-7)
    y, x = np.indices(height.shape)[:, np.isfinite(height)]
    plane = np.stack([np.ones_like(x), x, y], axis=1).astype(float)
    level = inside - plane @ np.linalg.lstsq(plane, inside, rcond=None)[0]
    assert answer["rms_tilt_removed_nm"] == pytest.approx(level.std(), abs=0.002)
    assert answer["pv_tilt_removed_nm"] == pytest.approx(np.ptp(level), abs=0.01)
    assert (answer["part_id"], answer["taken_at"]) == ("blank-7", "2025-10-09T08:53:20+00:00")


def test_trim_erodes_by_the_cross(polishd: Polishd, tmp_path: Path) -> None:
    """A spike on the rim goes with the first pixel; a hole grows; and what the file has stays said."""
    height = np.random.default_rng(1).normal(0.0, 1.0, (21, 31))
    height[0, 4] = 500.0
    height[10, 10] = np.nan
    path = dat(tmp_path / "m.dat", height)
    whole, trimmed = (polishd("map", path, "--json", "--trim", n).answer for n in (0, 2))
    assert whole["pv_nm"] > 400
    assert trimmed["pv_nm"] < 10
    assert (whole["missing"], trimmed["missing"], whole["trim"], trimmed["trim"]) == (1, 1, 0, 2)
    # two pixels off each side, and the 13 of a diamond of radius 2
    assert trimmed["samples"] == 17 * 27 - 13
    mask = np.zeros(height.shape, dtype=bool)
    mask[2:-2, 2:-2] = True
    rows, columns = np.indices(height.shape)
    mask &= abs(rows - 10) + abs(columns - 10) > 2
    assert trimmed["rms_nm"] == pytest.approx(height[mask].std(), abs=0.002)


def test_trimmed_to_nothing(polishd: Polishd, good: Path) -> None:
    said = polishd("map", good, "--trim", 40)
    assert (said.code, said.out) == (8, "")
    assert "--trim 40" in said.err


def test_bands_part_the_map(polishd: Polishd, good: Path) -> None:
    """Names and limits; what is shorter than two pixels no map shows."""
    bands = polishd("map", good, "--json", "--bands", "10,0.12").answer["bands"]
    assert [(band["name"], band["from_mm"], band["to_mm"]) for band in bands] == [
        ("LSF", None, 10.0), ("MSF", 10.0, 0.12), ("HSF", 0.12, None),
    ]  # fmt: skip
    assert bands[0]["rms_nm"] > bands[1]["rms_nm"] > 0
    assert bands[2]["rms_nm"] is None
    four = polishd("map", good, "--json", "--bands", "20,5,2").answer["bands"]
    assert [band["name"] for band in four] == ["LSF", "MSF1", "MSF2", "HSF"]
    assert all(band["rms_nm"] > 0 for band in four)
    default = polishd("map", good, "--json").answer["bands"]
    assert [band["to_mm"] for band in default] == [33.0, 0.12, None]


@pytest.mark.one_of_each
@pytest.mark.parametrize("words", ["", "a", "1,2", "2,2", "5,-1", "inf,1", "nan", "5,0"])
def test_bands_that_are_none(polishd: Polishd, good: Path, words: str) -> None:
    said = polishd("map", good, "--bands", words)
    assert said.code == 2
    assert "--bands" in said.err


def bad_files(folder: Path) -> dict[str, Path]:
    """What is no map, each in its way."""
    torn, empty, text, there = (folder / name for name in ("torn.dat", "empty.dat", "text.dat", "folder"))
    torn.write_bytes(dat(folder / "t.dat", surface()).read_bytes()[:-100])
    empty.touch()
    text.write_text("no map\n")
    there.mkdir()
    return {"torn": torn, "empty": empty, "text": text, "folder": there, "missing": folder / "missing.dat"}


@pytest.mark.one_of_each
@pytest.mark.parametrize("kind", ["torn", "empty", "text", "folder", "missing"])
@pytest.mark.parametrize("json_too", [True, False])
def test_a_file_that_is_no_map_is_one_message(polishd: Polishd, tmp_path: Path, kind: str, json_too: bool) -> None:
    path = bad_files(tmp_path)[kind]
    said = polishd("map", path, *(["--json"] if json_too else []))
    assert (said.code, said.out) == (8, "")
    assert said.err.startswith("polishd: ")
    assert said.err.count("\n") == 1
    assert str(path) in said.err


def test_good_files_among_bad_ones_are_said(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    other = dat(tmp_path / "other.dat", surface(seed=9))
    bad = bad_files(tmp_path)
    said = polishd("map", bad["torn"], good, bad["missing"], other, bad["folder"], "--json")
    assert said.code == 8
    assert [answer["path"] for answer in lines(said.out)] == [str(good), str(other)]
    assert [line.split(":")[1].strip() for line in said.err.splitlines()] == [
        str(bad[kind]) for kind in ("torn", "missing", "folder")
    ]
    said = polishd("map", bad["empty"], good, other)
    assert said.code == 8
    assert "good.dat" in said.out
    assert "other.dat" in said.out
    assert "empty.dat" in said.err


def test_a_broken_sdf_of_the_second_edition_hides_no_other_map(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    """Its header is four bytes longer: a type of samples that is none was looked for in the wrong place."""
    whole, torn = tmp_path / "whole.sdf", tmp_path / "torn.sdf"
    whole.write_bytes(sdf_second())
    torn.write_bytes(sdf_second()[:-9])
    said = polishd("map", torn, whole, tmp_path / ("n" * 300), good, "--json")
    assert (said.code, said.err.count("\n")) == (8, 2)
    assert [Path(answer["path"]).name for answer in lines(said.out)] == ["whole.sdf", "good.dat"]


def points(path: Path) -> Path:
    """A list of x y z, whatever it is called."""
    path.write_bytes(points_file(" ", "x_mm y_mm z_nm\n"))
    return path


@pytest.mark.full
def test_a_list_under_another_name_is_read_as_what_it_is(polishd: Polishd, tmp_path: Path) -> None:
    named, other = points(tmp_path / "a.xyz"), points(tmp_path / "a.dat")
    said = polishd("map", other)
    assert said.code == 8
    assert "it looks like points: name it *.xyz (or polishd map --format xyz)" in said.err
    expected = polishd("map", named, "--json").answer
    for name in ("xyz", ".csv", "points"):
        answer = polishd("map", other, "--format", name, "--json").answer
        assert answer | {"path": ""} == expected | {"path": ""} | {"dated_at": answer["dated_at"]}
    assert polishd("map", "convert", other, tmp_path / "b.x3p", "--format", "xyz").code == 0
    assert polishd("map", "compare", other, named, "--format", "xyz", "--json").answer["difference_rms_nm"] == 0
    wrong = polishd("map", other, "--format", "nonsense")
    assert wrong.code == 2
    assert "metropro" in wrong.err
    assert "no MetroPro file" in polishd("map", other, "--format", "metropro").err


@pytest.mark.full
def test_what_is_like_no_format_gets_no_advice(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"anything at all\n")
    assert "looks like" not in polishd("map", path).err


@pytest.mark.full
def test_where_a_date_comes_from(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    """By the header; where that says nothing, by the file system; and one that cannot be is not used."""
    assert "2025-10-09T08:53:20+00:00 (header)" in polishd("map", good).out
    bare = points(tmp_path / "a.xyz")
    os.utime(bare, (1_600_000_000, 1_600_000_000))
    early = tmp_path / "early.sdf"
    early.write_bytes(sdf_second(create_date=datetime(1980, 1, 1, tzinfo=UTC)))
    keys = ("taken_at", "dated_at", "date_from")
    for path, expected, words in (
        (good, ("2025-10-09T08:53:20+00:00", "2025-10-09T08:53:20+00:00", "header"), "(header)"),
        (bare, (None, "2020-09-13T12:26:40+00:00", "file system"), "(file system: its header has no date)"),
        (early, (None, "1980-01-01T00:00:00+00:00", "guessed"), "(guessed: not used)"),
    ):
        answer = polishd("map", path, "--json").answer
        assert tuple(answer[key] for key in keys) == expected
        assert f"{expected[1]} {words}" in polishd("map", path).out
        written = tmp_path / f"{path.stem}.x3p"
        polishd("map", "convert", path, written, "--json")
        assert (polishd("map", written, "--json").answer["taken_at"] is None) == (expected[0] is None), (
            "made no header's"
        )
    assert "before 1985" in polishd("map", early).out


def test_a_scale_a_million_times_too_large_is_none(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    """312.5 mm a sample for 0.3125 um; a profile may say the right one, and then nothing is warned of."""
    path, profile = tmp_path / "m.sdf", tmp_path / "p.toml"
    sdfio.write(path, surface(80, 70) / 1e9, x_scale=0.3125, y_scale=0.3125)
    answer = polishd("map", path, "--json").answer
    assert (answer["pitch_mm"], answer["bands"], answer["unsaid"]) == (None, None, ["pitch"])
    assert "80 samples of 312.5 mm would be a part of 25 m, more than 20 m" in answer["warnings"][0]
    profile.write_text('name = "x"\n[lateral]\npitch_mm = 3.125e-4\n')
    answer = polishd("map", path, "--json", "--profile", profile).answer
    assert (answer["pitch_mm"], answer["warnings"], answer["unsaid"]) == (3.125e-4, [], [])


@pytest.mark.full
def test_one_key_of_a_profile_is_enough_to_look(polishd: Polishd, tmp_path: Path) -> None:
    """And what it gives is no longer called missing; a file that would say more than is known is not written."""
    path, profile = tmp_path / "m.npy", tmp_path / "p.toml"
    np.save(path, surface())
    plain = polishd("map", path, "--json").answer
    profile.write_text('name = "x"\n[lateral]\npitch_mm = 0.5\n')
    answer = polishd("map", path, "--json", "--profile", profile).answer
    assert (answer["pitch_mm"], answer["unsaid"]) == (0.5, ["orientation", "surface", "unit"])
    assert set(plain["warnings"]) - set(answer["warnings"]) == {
        "the file gives no lateral scale: give --profile with lateral.pitch_mm"
    }
    profile.write_text('name = "x"\n[height]\nunit_nm = 10\n')
    answer = polishd("map", path, "--json", "--profile", profile).answer
    assert answer["rms_nm"] == pytest.approx(10 * plain["rms_nm"])
    assert not any("no unit" in warning for warning in answer["warnings"])
    said = polishd("map", "convert", path, tmp_path / "b.x3p", "--profile", profile)
    assert said.code == 8
    assert "does not state its orientation and surface" in said.err


def test_a_list_without_units_names_the_option_that_gives_its_scale(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / "m.xyz"
    y, x = np.mgrid[0:20, 0:20]
    np.savetxt(path, np.column_stack([x.ravel() * 0.5, y.ravel() * 0.5, (x * y).ravel()]))
    answer = polishd("map", path, "--json").answer
    assert any(one.endswith("give --units, such as --units mm,nm") for one in answer["warnings"]), answer["warnings"]
    answer = polishd("map", path, "--json", "--units", "mm,nm").answer
    assert (answer["pitch_mm"], answer["warnings"]) == (0.5, [])


def test_no_permission_to_read(polishd: Polishd, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good.chmod(0)
    if os.access(good, os.R_OK):  # root may read it all the same
        opened = Path.open

        def refusing(path: Path, *args: Any, **options: Any) -> Any:
            if path == good:
                raise PermissionError(13, "Permission denied")
            return opened(path, *args, **options)

        monkeypatch.setattr(Path, "open", refusing)
    said = polishd("map", good, "--json")
    assert (said.code, said.out) == (8, "")
    assert "Permission denied" in said.err


def test_a_pipe_is_no_file_and_is_not_waited_for(polishd: Polishd, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    said = polishd("map", tmp_path / "pipe")
    assert said.code == 8
    assert "is no file" in said.err


@pytest.mark.full
def test_a_reader_who_leaves_is_no_traceback(good: Path) -> None:
    for words in ([], ["--json"]):
        reading, writing = os.pipe()
        os.close(reading)
        ended = subprocess.run(
            [sys.executable, "-m", "polishd.cli.app", "map", str(good), *words],
            stdout=writing, stderr=subprocess.PIPE, check=False, timeout=60,
        )  # fmt: skip
        os.close(writing)
        assert b"Traceback" not in ended.stderr
        assert ended.returncode != 0


def test_a_name_that_is_no_text(polishd: Polishd, good: Path) -> None:
    """A file's name is bytes: what is no UTF-8 in it must not break the table."""
    odd = good.rename(good.with_name(os.fsdecode(b"m\xff[red]$x$.dat")))
    said = polishd("map", odd)
    assert said.code == 0, said.err
    assert r"m\udcff[red]$x$.dat" in said.out.replace("\n", "")  # a long title is wrapped
    assert json.loads(polishd("map", odd, "--json").out)["path"] == str(odd)


def test_one_map_for_people(polishd: Polishd, good: Path) -> None:
    said = polishd("map", good, "--trim", 1)
    answer = polishd("map", good, "--trim", 1, "--json").answer
    for words in (
        "metropro", "60 x 48", "1 px trimmed", "0.5 mm", f"{answer['pv_nm']:.6f}", f"{answer['rms_nm']:.6f} nm",
        "blank-7", answer["sha256"], "periods above 33 mm", "MSF", "PVr (36 terms)",
    ):  # fmt: skip
        assert words in said.out, words


def test_several_maps_for_people_are_a_row_each(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    bare = dat(tmp_path / "bare.dat", surface(), pitch_mm=0.0)
    said = polishd("map", bare, good)
    assert said.code == 0
    rows = [line.split() for line in said.out.splitlines() if ".dat" in line and "warning" not in line]
    assert [row[0] for row in rows] == ["bare.dat", "good.dat"]
    assert rows[0][4] == "-"
    assert rows[1][4] == "0.5"
    assert "LSF" in said.out
    assert said.out.count("warning: bare.dat") == 1


def test_maps_of_one_name_are_distinguished(polishd: Polishd, tmp_path: Path) -> None:
    """A run's maps are all called map.dat: the table says which is which."""
    folders = [tmp_path / name for name in ("cycle-00", "cycle-01")]
    for folder in folders:
        folder.mkdir()
    maps = [dat(folder / "map.dat", surface(), pitch_mm=0.0) for folder in folders]
    said = polishd("map", *maps)
    for name in ("cycle-00/map.dat", "cycle-01/map.dat"):
        assert said.out.count(name) == 2  # a row, and a warning
    assert str(tmp_path) not in said.out


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["/a/b.dat", "/a/c.dat"], ["b.dat", "c.dat"]),
        (["/a/b.dat", "/c/b.dat"], ["a/b.dat", "c/b.dat"]),
        (["b.dat", "a/b.dat"], ["b.dat", "a/b.dat"]),
        (["a/b.dat", "a/b.dat"], ["b.dat", "b.dat"]),
        (["/x/m", "/y/m", "/x/n"], ["x/m", "y/m", "x/n"]),
        ([], []),
    ],
)
def test_the_shortest_names_that_tell(paths: list[str], names: list[str]) -> None:
    assert distinguish_names(paths) == names


def test_a_profile_is_applied(polishd: Polishd, good: Path) -> None:
    """Turned, negated and halved, with a note; an invalid profile is exit code 3."""
    profile = good.with_name("p.toml")
    profile.write_text('name = "x"\n[orientation]\nrotation_deg = 90\n[height]\nsign = -1\nfactor = 0.5\n')
    plain, turned = polishd("map", good, "--json").answer, polishd("map", good, "--json", "--profile", profile).answer
    assert (turned["rows"], turned["cols"]) == (plain["cols"], plain["rows"])
    assert turned["rms_nm"] == pytest.approx(plain["rms_nm"] / 2, rel=1e-9)
    assert turned["factors"]["profile"]["sign"] == -1
    assert "profile" not in plain["factors"]
    profile.write_text("name = 3\n")
    assert polishd("map", good, "--profile", profile).code == 3
    assert polishd("map", good, "--profile", profile.with_name("none.toml")).code == 3


def test_a_band_that_ends_at_a_third_of_the_part_is_soft(polishd: Polishd, tmp_path: Path) -> None:
    """30 rows of 0.5 mm: 15 mm, a third of which is 5 mm."""
    good = dat(tmp_path / "part.dat", np.random.default_rng(4).normal(0.0, 1.0, (30, 20)))
    bands = polishd("map", good, "--bands", "5.1,4.9", "--json").answer["bands"]
    assert [band["soft"] for band in bands] == [True, True, False]
    said = polishd("map", good, "--bands", "5.1,4.9").out
    assert said.count("soft: longer than a third of the part") == 2
    assert "RMS (soft)" in polishd("map", "compare", good, good, "--bands", "5.1").out
    assert "soft" not in polishd("map", good, "--bands", "5,2").out
