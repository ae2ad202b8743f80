"""``polishd map stitch``: nine sub-apertures of a known surface come back, with how sure each sample is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from polishd.maps.map_files import MapSource
from polishd.model.surface import FloatArray
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat

PITCH_MM = 0.5
SIDE_PX, STEP_PX = 96, 60
NOISE_NM = 1.0


def true_nm(x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """The part: waves of some 20 mm, a saddle and a bump, so that no direction is like another."""
    waves = 40 * np.sin(2 * np.pi * x_mm / 19) * np.cos(2 * np.pi * y_mm / 23 + 0.4)
    bump = 30 * np.exp(-((x_mm - 7) ** 2 + (y_mm + 5) ** 2) / 60)
    return np.asarray(waves + 0.02 * (x_mm**2 - y_mm**2) + bump)


@dataclass
class Mosaic:
    """Nine maps, where they are said to lie, and by how much each lies elsewhere."""

    files: list[Path]
    at: Path
    shifts_mm: FloatArray


def mosaic(folder: Path, *, said: bool = False, power: bool = False, seed: int = 5, rough: bool = True) -> Mosaic:
    """3 x 3 maps with noise; each but the first is shifted by 0.2 px (``said``: as its list has it) and tilted."""
    rng = np.random.default_rng(seed)
    files, lines, shifts = [], ["file,x_mm,y_mm"], []
    along = (np.arange(SIDE_PX) - (SIDE_PX - 1) / 2) * PITCH_MM
    x, y = along[None, :], -along[:, None]
    for number in range(9):
        x0, y0 = (number % 3 - 1) * STEP_PX * PITCH_MM, (1 - number // 3) * STEP_PX * PITCH_MM
        angle = rng.uniform(0, 2 * np.pi)
        shift = 0.2 * PITCH_MM * np.array([np.cos(angle), np.sin(angle)]) * (number > 0)
        height = rng.normal(0, NOISE_NM, (SIDE_PX, SIDE_PX))
        if rough:
            height += true_nm(x + x0 + shift[0], y + y0 + shift[1])
        if number:
            height += rng.normal(0, 50) + rng.normal(0, 3) * x + rng.normal(0, 3) * y
            height += power * rng.normal(0, 20) * (x**2 + y**2) / 500
        files.append(dat(folder / f"p{number}.dat", height, PITCH_MM))
        lines.append(f"p{number}.dat,{x0 + said * shift[0]:.9f},{y0 + said * shift[1]:.9f}")
        shifts.append((0.0, 0.0) if said else tuple(shift))
    at = folder / "at.csv"
    at.write_text("\n".join(lines) + "\n")
    return Mosaic(files, at, np.array(shifts))


def error_nm(answer: dict[str, object], out: Path) -> FloatArray:
    """(ny, nx) of the result, NaN where it has no data. No tilt is taken off."""
    back = MapSource.of().read(out)
    x0, y0 = np.array(answer["centre_mm"])
    x, y = back.grid.axes_mm
    return back.height_nm - true_nm(x + x0, y + y0)


CASES = [
    pytest.param(True, "", False, id="known places"),
    pytest.param(False, "shift", False, id="shift", marks=pytest.mark.full),
    pytest.param(False, "power,shift", True, id="power and shift", marks=pytest.mark.full),
]


@pytest.mark.parametrize(("said", "free", "power"), CASES)
def test_nine_maps_of_a_known_surface_come_back(
    polishd: Polishd, tmp_path: Path, said: bool, free: str, power: bool
) -> None:
    """The error is at most 1.2 times the noise floor, and what the uncertainty map says of it.

    The floor: with every place, piston and tilt known, the best estimate of a sample that n maps have is their mean,
    of variance s^2 / n for noise s. So the floor is s sqrt(mean(1 / n)) over the result's samples: here s = 1 nm, and
    the sides are 96 + 2 x 60 samples, of which 2 x 36 lie in two maps: a side's mean of 1/n is (144 + 72 / 2) / 216 =
    5/6, and n is the product of both sides'; the floor is 5/6 nm. The first map's piston, tilt and power are the
    truth's, so none is taken off the error. Interpolation takes a few percent off the noise, and the 3 samples at the
    edge of maps lie in fewer; both are less than what the 20 % leave.
    """
    given = mosaic(tmp_path, said=said, power=power)
    out, unsure = tmp_path / "c.x3p", tmp_path / "u.x3p"
    asked = ["--at", given.at, "--out", out, "--uncertainty", unsure, *(["--free", free] if free else [])]
    answer = polishd("map", "stitch", *given.files, *asked, "--json").answer
    error = error_nm(answer, out)
    there = np.isfinite(error)
    floor = NOISE_NM * 5 / 6
    assert np.sqrt(np.mean(error[there] ** 2)) < 1.2 * floor
    sigma = MapSource.of().read(unsure).height_nm
    assert 0.8 < np.sqrt(np.mean((error / sigma)[there] ** 2)) < 1.25
    assert answer["noise_nm"] == pytest.approx(NOISE_NM, rel=0.03)
    assert answer["uncertainty_worst_nm"] == pytest.approx(np.nanmax(sigma), rel=1e-3)
    if "shift" in free:
        found = np.array([one["shift_mm"] for one in answer["maps"]])
        sure = np.array([one["shift_uncertainty_mm"] for one in answer["maps"]])
        off = ((found - given.shifts_mm)[1:] / sure[1:]).ravel()
        assert sure.max() < 0.02 * PITCH_MM  # a tenth of what they are
        assert np.abs(off).max() < 4
        assert 0.4 < np.sqrt(np.mean(off**2)) < 2  # all hang on the few overlaps of the first map
    if power:
        assert any("cannot be separated from the part's" in note for note in answer["notes_power"])


def test_where_one_map_is_it_is_less_sure_than_where_four_are(polishd: Polishd, tmp_path: Path) -> None:
    """And what every map has, as the reference's power, is in the result as (R/r)^2, which no overlap shows."""
    given = mosaic(tmp_path, said=True)
    unsure = tmp_path / "u.x3p"
    answer = polishd("map", "stitch", *given.files, "--at", given.at, "--uncertainty", unsure, "--json").answer
    sigma = MapSource.of().read(unsure).height_nm
    middle = sigma.shape[0] // 2
    assert sigma[middle, middle] == pytest.approx(NOISE_NM, rel=0.1)  # the centre of the middle map: it alone
    corner = STEP_PX + (SIDE_PX - STEP_PX) // 2  # between four
    assert sigma[corner, corner] == pytest.approx(NOISE_NM / 2, rel=0.1)
    # the first map lies in a corner, its own furthest sample 47.5 sqrt(2) px off, the result's 2 x 60 px further
    assert answer["power_growth"] == pytest.approx((1 + 120 / 47.5) ** 2, rel=0.05)


@pytest.mark.full
def test_the_result_says_how_it_came_about(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True)
    out, picture = tmp_path / "c.x3p", tmp_path / "c.png"
    said = polishd("map", "stitch", *given.files, "--at", given.at, "--out", out, "--picture", picture).out
    assert "p8.dat" in said
    assert "residual" in said
    assert "(R/r)^2" in said
    assert "at worst to" in said
    assert picture.read_bytes().startswith(b"\x89PNG")
    kept = MapSource.of().read(out).history
    assert kept is not None
    assert kept.verb == "stitch"
    assert [one.role for one in kept.inputs] == ["reference", *["sub-aperture"] * 8]
    assert kept.options["at"][0] == "p0.dat -30,30 mm"
    assert "history" not in said  # as a thing that the format did not keep


def test_maps_that_do_not_overlap_are_named(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True)
    said = polishd("map", "stitch", given.files[0], given.files[1], given.files[8], "--at", given.at)
    assert said.code == 8
    assert "p8.dat: no overlap leads from there to p0.dat" in said.err
    mended = given.at.read_text().replace("p8.dat,", "p8.dat,1e9,")
    given.at.write_text(mended)
    assert polishd("map", "stitch", *given.files, "--at", given.at).code == 8


def test_a_smooth_part_tells_no_shift(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True, rough=False)
    said = polishd("map", "stitch", *given.files, "--at", given.at, "--free", "shift")
    assert said.code == 8
    assert "the overlaps show no shift" in said.err
    assert polishd("map", "stitch", *given.files, "--at", given.at, "--json").code == 0


@pytest.mark.full
def test_what_is_no_list_of_places_is_reported_with_its_line(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True)
    two = given.files[:2]
    for text, message in {
        "file,x_mm,y_mm\np0.dat,0,0\np1.dat,far,0\n": "at.csv:3: x_mm is 'far'",
        "file,x_mm,y_mm\np0.dat,0,0\np1.dat,30\n": "at.csv:3: y_mm is missing; write a finite number",
        "file,x_mm,y_mm\np0.dat,0,0\np0.dat,30,0\n": "at.csv:3: p0.dat is repeated",
        "file,x_mm\np0.dat,0\n": "at.csv:1: the column 'y_mm' is missing",
        "file,x_mm,y_mm\np0.dat,0,0\n": "at.csv: does not say where p1.dat lies",
    }.items():
        given.at.write_text(text)
        said = polishd("map", "stitch", *two, "--at", given.at)
        assert said.code == 3
        assert message in said.err


def test_maps_of_no_or_of_two_pitches_are_refused(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True)
    height = np.ones((SIDE_PX, SIDE_PX))
    for pitch, message in {0.0: "has no lateral scale", 0.25: "has a pitch of 0.25 mm"}.items():
        dat(given.files[1], height, pitch)
        said = polishd("map", "stitch", *given.files[:2], "--at", given.at)
        assert said.code == 8
        assert "p1.dat" in said.err
        assert message in said.err


def test_free_is_power_or_shift(polishd: Polishd, tmp_path: Path) -> None:
    given = mosaic(tmp_path, said=True)
    said = polishd("map", "stitch", *given.files, "--at", given.at, "--free", "coma")
    assert said.code == 2
    assert "power, shift" in said.err
