"""``--mask`` as from the shell: what each form holds, in every verb, and the message for an invalid one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.model.surface import Grid
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat

GRID = Grid(40, 60, PITCH_MM)
X, Y = np.broadcast_arrays(GRID.x_mm[None, :], GRID.y_mm[:, None])
R = np.hypot(X, Y)
COLUMN, ROW = np.broadcast_arrays(np.arange(60.0)[None, :], np.arange(40.0)[:, None])
HEIGHT = np.where(np.abs(X) < 14.5, np.sin(X / 3) * 20 + Y**2, np.nan)
DATA = np.isfinite(HEIGHT)


@pytest.fixture
def shown(tmp_path: Path) -> Path:
    """A map of 30 x 20 mm that has no data at its left and right."""
    return dat(tmp_path / "m.dat", HEIGHT)


HOLDS = {
    "circle:0,0,6": R <= 6,
    "circle:3,-2,4.3": np.hypot(X - 3, Y + 2) <= 4.3,
    "annulus:0,0,8,3": (R <= 8) & (R > 3),
    "rectangle:2,1,10.1,6.1": (np.abs(X - 2) <= 5.05) & (np.abs(Y - 1) <= 3.05),
    "not:rectangle:2,1,10.1,6.1": (np.abs(X - 2) > 5.05) | (np.abs(Y - 1) > 3.05),
    "hexagon:0,0,12": (np.abs(Y) <= 6) & (np.abs(X) * np.sqrt(3) + np.abs(Y) <= 12),
    "px:circle:20,10,7": np.hypot(COLUMN - 20, ROW - 10) <= 7,
    "not:px:rectangle:20,10,8,6": (np.abs(COLUMN - 20) > 4) | (np.abs(ROW - 10) > 3),
    "polygon:corners.csv": (Y <= 5) & (Y >= -5 + X + 5) & (X >= -5),
    "px:polygon:pixels.csv": (COLUMN >= 12) & (COLUMN <= 30) & (ROW >= 3) & (ROW <= 9),
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("mask", HOLDS)
def test_only_what_a_mask_holds_counts(
    polishd: Polishd, shown: Path, monkeypatch: pytest.MonkeyPatch, mask: str
) -> None:
    monkeypatch.chdir(shown.parent)
    Path("corners.csv").write_text("# a triangle\nx_mm,y_mm\n-5,5\n-5,-5\n5,5\n")
    Path("pixels.csv").write_text("row,column\n3,12\n9,12\n9,30\n3,30\n")
    held = HOLDS[mask] & DATA
    answer = polishd("map", "m.dat", "--mask", mask, "--json").answer
    assert answer["masks"] == [{"mask": mask, "samples": held.sum(), "of": DATA.sum()}]
    assert (answer["samples"], answer["masked"]) == (held.sum(), DATA.sum() - held.sum())
    assert answer["missing"] == HEIGHT.size - DATA.sum()
    assert answer["rms_nm"] == pytest.approx(HEIGHT[held].std(), rel=1e-4)
    said = polishd("map", "m.dat", "--mask", mask).out
    assert f"holds {held.sum()} of {DATA.sum()} samples with data" in " ".join(said.split())


def test_of_several_masks_what_lies_in_all_counts(polishd: Polishd, shown: Path) -> None:
    answer = polishd("map", shown, "--mask", "circle:-3,0,6", "--mask", "circle:3,0,6", "--json").answer
    both = (np.hypot(X + 3, Y) <= 6) & (np.hypot(X - 3, Y) <= 6)
    assert answer["samples"] == both.sum() < min(record["samples"] for record in answer["masks"])


@pytest.mark.parametrize("pitch_mm", [PITCH_MM, 0.2])
def test_another_map_is_a_mask_where_it_has_data(polishd: Polishd, shown: Path, pitch_mm: float) -> None:
    """Of another pitch: the nearest sample says."""
    grid = GRID if pitch_mm == PITCH_MM else Grid(61, 61, pitch_mm)
    other = dat(shown.parent / "other.dat", np.where(grid.radius_mm() <= 5.05, 1.0, np.nan), pitch_mm)
    held = {word: polishd("map", shown, "--mask", f"{word}map:{other}", "--json").answer for word in ("", "not:")}
    inside = (R <= 5.05) & DATA
    assert held[""]["samples"] == pytest.approx(inside.sum(), abs=0 if grid is GRID else 12)
    assert held[""]["samples"] + held["not:"]["samples"] == DATA.sum()


@pytest.mark.full
def test_every_verb_takes_it(polishd: Polishd, shown: Path, tmp_path: Path) -> None:
    again = dat(tmp_path / "again.dat", HEIGHT + 0.1 * X)
    third = dat(tmp_path / "third.dat", HEIGHT - 0.1 * X)
    mask, count = ("--mask", "circle:0,0,6", "--json"), np.count_nonzero(R <= 6)
    compared = polishd("map", "compare", shown, again, *mask).answer
    assert compared["samples"] == compared["after"]["masks"][0]["samples"] == count
    averaged = polishd("map", "average", shown, again, third, *mask).answer
    assert averaged["samples"] == averaged["masks"][2]["masks"][0]["samples"] == count
    converted = polishd("map", "convert", shown, tmp_path / "cut.x3p", *mask).answer
    assert converted["masks"][0]["samples"] == count
    cut = polishd("map", tmp_path / "cut.x3p", "--json").answer
    assert (cut["samples"], cut["missing"]) == (count, HEIGHT.size - count)


@pytest.mark.full
def test_the_mask_of_each_map_is_reported_and_drawn(
    polishd: Polishd, shown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stdout, "_width", 160)
    again = dat(tmp_path / "again.dat", HEIGHT + 0.1 * X)
    third = dat(tmp_path / "third.dat", HEIGHT - 0.1 * X)
    picture = tmp_path / "p.png"
    said = polishd("map", shown, again, "--mask", "circle:0,0,6", "--out", picture).out
    assert [line.split(":")[0] for line in said.splitlines() if "holds" in line] == ["m.dat", "again.dat"]
    assert picture.stat().st_size > 10_000
    for verb in (("compare", shown, again), ("average", shown, again, third), ("convert", shown, tmp_path / "c.x3p")):
        said = polishd("map", *verb, "--mask", "circle:0,0,6")
        assert (said.code, said.err) == (0, "")
        assert "circle:0,0,6 holds" in said.out


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("mask", "says"),
    [
        ("circle:0,0", "is not a shape. Use circle:X,Y,R"),
        ("circle:0,0,x", "is not a shape. Use circle:X,Y,R"),
        ("not:not:circle:0,0,5", "is not a shape. Use circle:X,Y,R"),
        ("oval:0,0,5", "is not a shape. Use circle:X,Y,R"),
        ("polygon:", "is not a shape. Use circle:X,Y,R"),
        ("circle:0,0,-5", "the outline's radius is -5 mm; it must be above 0"),
        ("circle:nan,0,5", "its centre is no finite number"),
        ("annulus:0,0,3,5", "its hole is not smaller than itself"),
        ("px:map:m.dat", "a map has its own samples; leave out px:"),
    ],
)
def test_what_is_no_mask_is_wrong_use(polishd: Polishd, shown: Path, mask: str, says: str) -> None:
    said = polishd("map", shown, "--mask", mask)
    assert said.code == 2
    assert says in " ".join(said.err.replace("│", " ").split())


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("x_mm,y_mm\n0,0\n1,0\n1,q\n", "c.csv:4: y_mm is 'q'"),
        ("x,y\n0,0\n1,0\n1,1\n", "c.csv:1: the column 'x_mm' is missing"),
        ("x_mm,y_mm\n0,0\n1,0\n", "c.csv: a polygon has 3 to 500 corners, not 2"),
    ],
)
def test_corners_that_are_none_are_named_with_their_line(
    polishd: Polishd, shown: Path, monkeypatch: pytest.MonkeyPatch, content: str, says: str
) -> None:
    monkeypatch.chdir(shown.parent)
    Path("c.csv").write_text(content)
    said = polishd("map", "m.dat", "--mask", "polygon:c.csv")
    assert said.code == 3
    assert says in said.err


def test_a_map_that_is_none_is_said_once(polishd: Polishd, shown: Path) -> None:
    said = polishd("map", shown, shown, "--mask", "map:none.dat")
    assert said.code == 8
    assert said.err.count("none.dat: cannot be read") == 1


def test_a_mask_that_holds_nothing_is_named(polishd: Polishd, shown: Path) -> None:
    said = polishd("map", shown, "--mask", "circle:200,0,5")
    assert said.code == 8
    assert "--mask circle:200,0,5 holds none of its 2320 samples with data; the map is 30 x 20 mm" in said.err
    said = polishd("map", shown, "--mask", "circle:-9,0,3", "--mask", "circle:9,0,3")
    assert "no sample with data lies in all of the 2 masks" in said.err


def test_without_a_pitch_only_pixels_can_be_meant(polishd: Polishd, tmp_path: Path) -> None:
    plain = dat(tmp_path / "plain.dat", HEIGHT, 0.0)
    said = polishd("map", plain, "--mask", "not:circle:0,0,5")
    assert said.code == 8
    assert "has no lateral scale for --mask not:circle:0,0,5; give the instrument's --profile" in said.err
    assert polishd("map", plain, "--mask", "px:circle:30,20,5", "--json").answer["samples"] == 81
    small = dat(tmp_path / "small.dat", HEIGHT[1:])
    said = polishd("map", plain, "--mask", f"map:{small}")
    assert "as a mask it has not the samples of" in said.err
