"""Units of point lists: from the header, from ``--units``, and pixels that are not square."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.conditioning import resample_square
from polishd.process.metrology.instrument import apply_profile, require_profile
from tests.unit.cli_result import Polishd

POINTS = [(x, y, 10.0 * x + 3.0 * y + x * y) for x in range(6) for y in range(5)]


def listed(path: Path, header: str, between: str = " ", wide: float = 1.0) -> Path:
    lines = [between.join(f"{value:g}" for value in (wide * x, y, z)) for x, y, z in POINTS]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("header", "between", "pitch_mm", "nm"),
    [
        ("# x mm y mm z nm", " ", 1.0, 1.0),
        ("x [mm],y [mm],z [um]", ",", 1.0, 1e3),
        ("# X(um) Y(um) Z(nm)", "\t", 1e-3, 1.0),
        ("x y z mm mm um", " ", 1.0, 1e3),
        ("x y z\n[mm] [mm] [um]", " ", 1.0, 1e3),
        ("# units: mm, mm, nm", " ", 1.0, 1.0),
        ("x;y;z\nm;m;um", ";", 1e3, 1e3),
        ("x_mm,y_mm,z_nm", ",", 1.0, 1.0),
    ],
)
def test_the_first_lines_name_units(
    polishd: Polishd, tmp_path: Path, header: str, between: str, pitch_mm: float, nm: float
) -> None:
    answer = polishd("map", listed(tmp_path / "a.txt", header, between), "--json").answer
    assert answer["pitch_mm"] == pytest.approx(pitch_mm)
    assert answer["pv_nm"] == pytest.approx(82.0 * nm)
    assert answer["unsaid"] == []


def test_units_are_said_for_a_file_that_does_not(polishd: Polishd, tmp_path: Path) -> None:
    path = listed(tmp_path / "a.xyz", "")
    assert polishd("map", path, "--json").answer["unsaid"] == ["pitch", "unit"]
    answer = polishd("map", path, "--units", "mm,um", "--json").answer
    assert (answer["pitch_mm"], answer["pv_nm"], answer["unsaid"]) == (1.0, 82e3, [])
    only = polishd("map", path, "--units", "um", "--json").answer
    assert (only["pitch_mm"], only["pv_nm"], only["unsaid"]) == (None, 82e3, ["pitch"])
    kept = listed(tmp_path / "b.csv", "x_mm,y_mm,z_nm", ",")
    answer = polishd("map", kept, "--units", "mm,um", "--json").answer
    assert answer["pv_nm"] == 82.0
    assert "not used: the file says its own" in answer["warnings"][0]
    said = polishd("map", path, "--units", "mm,lines")
    assert said.code == 2
    assert "as mm,nm" in said.err


def test_pixels_that_are_not_square_keep_both_pitches(polishd: Polishd, tmp_path: Path) -> None:
    path = listed(tmp_path / "a.csv", "x_mm,y_mm,z_nm", ",", wide=0.5)
    answer = polishd("map", path, "--json").answer
    assert (answer["pitch_mm"], answer["pitches_mm"]) == (None, [0.5, 1.0])
    assert "0.5 x 1 mm" in polishd("map", path).out


def _wave(ny: int, nx: int, wide: float, high: float) -> SurfaceMap:
    x, y = (np.arange(nx) - (nx - 1) / 2) * wide, ((ny - 1) / 2 - np.arange(ny)) * high
    height = 50 * np.cos(x[None, :] / 4) * np.sin(y[:, None] / 5 + 0.3)
    doubts = {"square pixels": "not square"}
    return SurfaceMap(
        height, None, pitches_mm=(wide, high), doubts=doubts, unsaid=frozenset(doubts), warnings=("not square",)
    )


@pytest.mark.parametrize(("wide", "high"), [(0.5, 0.65), (0.65, 0.5), (0.5, 1.0)])
def test_they_are_resampled_when_the_map_is_conditioned(wide: float, high: float) -> None:
    found = resample_square(_wave(80, 90, wide, high))
    assert found.pitch_mm == min(wide, high)
    assert found.pitches_mm is None
    assert found.unsaid == frozenset()
    x, y = found.grid.x_mm, found.grid.y_mm
    true = 50 * np.cos(x[None, :] / 4) * np.sin(y[:, None] / 5 + 0.3)
    inside = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(found.height_nm[inside], true[inside], atol=0.02)


def test_no_data_stay_no_data() -> None:
    surface = _wave(40, 50, 0.5, 0.65)
    surface.height_nm[:10] = np.nan
    surface.height_nm[20, 20] = np.nan
    found = resample_square(surface)
    assert np.isnan(found.height_nm[:12]).all()
    assert np.isfinite(found.height_nm[14:25, :15]).all()
    assert 1 <= np.count_nonzero(np.isnan(found.height_nm[20:])) <= 3


def test_a_profile_takes_such_a_map() -> None:
    instrument = Instrument(name="own", mirror=True, gives=frozenset())
    found = apply_profile(_wave(40, 50, 0.5, 0.65), instrument)
    assert found.pitch_mm == 0.5
    assert any("resampled to 0.5 mm" in words for words in found.warnings)


PROFILE = """name = "own"
gives = ["surface", "orientation"]
[height]
unit_nm = 1
[lateral]
"""


def test_a_profile_with_one_pitch_does_not_squash_a_list_without_units(polishd: Polishd, tmp_path: Path) -> None:
    path, profile = listed(tmp_path / "a.xyz", "", wide=0.5), tmp_path / "p.toml"
    profile.write_text(PROFILE + "pitch_mm = 0.5\n")
    refused = polishd("map", path, "--profile", profile)
    assert refused.code == 8
    assert "not square, 0.5 x 1 in the unit of its coordinates" in refused.err
    assert "coordinate_unit_mm" in refused.err
    square = listed(tmp_path / "b.xyz", "")
    assert polishd("map", square, "--profile", profile, "--json").answer["pitch_mm"] == 0.5


def test_the_unit_of_a_profile_reads_a_list_as_its_header_would(polishd: Polishd, tmp_path: Path) -> None:
    bare, headed = listed(tmp_path / "a.xyz", "", wide=0.5), listed(tmp_path / "b.xyz", "# x mm y mm z nm", wide=0.5)
    profile = tmp_path / "p.toml"
    profile.write_text(PROFILE + "coordinate_unit_mm = 1.0\npitch_mm = 0.5\n")
    one, other = (polishd("map", path, "--profile", profile, "--json").answer for path in (bare, headed))
    assert one["pitch_mm"] == other["pitch_mm"] == 0.5
    assert one["rms_nm"] == other["rms_nm"]
    assert one["unsaid"] == []
    assert any("resampled to 0.5 mm" in words for words in one["warnings"])
    profile.write_text(PROFILE + "coordinate_unit_mm = 25.4\npitch_mm = 0.5\n")
    assert "has a pitch of 12.7 mm, the profile 'own' 0.5 mm" in polishd("map", bare, "--profile", profile).err
    profile.write_text(PROFILE + "coordinate_unit_mm = 1e-6\n")
    refused = polishd("map", bare, "--profile", profile)
    assert refused.code == 8
    assert "less than 1 nm. Check the unit" in refused.err


def test_the_refusal_of_a_list_without_units_asks_for_the_unit() -> None:
    bare = SurfaceMap(np.eye(4), None, unsaid=frozenset({"pitch"}), factors={"pitches_in_its_unit": (0.25, 0.27)})
    for instrument in (None, Instrument("own")):
        with pytest.raises(MapError, match="coordinate_unit_mm, the millimeters in one unit"):
            require_profile(bare, instrument)
    assert apply_profile(bare, Instrument("own", coordinate_unit_mm=1.0)).pitch_mm == 0.25


def test_no_file_is_written_that_loses_the_shape_of_the_pixels(polishd: Polishd, tmp_path: Path) -> None:
    path = listed(tmp_path / "a.xyz", "", wide=0.5)
    refused = polishd("map", "convert", path, tmp_path / "a.dat", "--units", "nm")
    assert refused.code == 8
    assert "not square" in refused.err
    assert not (tmp_path / "a.dat").exists()


@pytest.mark.parametrize(
    ("units", "what"),
    [
        ("pm,nm", "a sample would be 5e-10 mm wide, less than 1 nm. Check the unit"),
        ("m,m", "heights"),
        ("nm,m", "less than 1 nm"),
    ],
)
def test_units_that_no_map_has_are_refused(polishd: Polishd, tmp_path: Path, units: str, what: str) -> None:
    path = listed(tmp_path / "a.xyz", "", wide=0.5)
    refused = polishd("map", path, "--units", units)
    assert refused.code == 8
    assert re.search(what, refused.err)


def test_a_part_of_more_than_20_m_and_steep_heights_in_units_of_the_option(polishd: Polishd, tmp_path: Path) -> None:
    wide = tmp_path / "wide.xyz"
    wide.write_text("".join(f"{9 * x} {9 * y} {x + y}\n" for x in range(6) for y in range(5)))
    refused = polishd("map", wide, "--units", "m,nm")
    assert refused.code == 8
    assert "more than 20 m. Check the unit" in refused.err
    steep = polishd("map", wide, "--units", "um,mm", "--json").answer
    assert any("check the unit of heights" in words for words in steep["warnings"])


def test_a_header_with_such_units_loses_its_scale_also_where_pixels_are_not_square(
    polishd: Polishd, tmp_path: Path
) -> None:
    path = listed(tmp_path / "a.csv", "x_pm,y_pm,z_nm", ",", wide=0.5)
    answer = polishd("map", path, "--json").answer
    assert (answer["pitch_mm"], answer["pitches_mm"]) == (None, None)
    assert "pitch" in answer["unsaid"]
    assert any("its lateral scale is not used" in words for words in answer["warnings"])
