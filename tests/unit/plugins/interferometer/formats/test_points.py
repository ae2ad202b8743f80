"""Lists of points: any order, holes, separators, units in the header; off the grid is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import MapError
from polishd.plugins.interferometer.formats import points
from tests.unit.plugins.interferometer.map_files_other import PITCH_MM, heights_nm, points_file


def put(folder: Path, content: bytes, name: str = "map.csv") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.one_of_each
@pytest.mark.parametrize("separator", [",", ";", "\t", " ", " , ", "   "])
@pytest.mark.parametrize("missing", ["nan", "No Data", "NaN", "N/A", "***", "null", "-1.#IND", "1.#QNAN", "nan(ind)"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_way_to_write_it_is_the_same_map(tmp_path: Path, separator: str, missing: str, end: str) -> None:
    surface = points.read(put(tmp_path, points_file(separator, missing=missing, end=end)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)
    assert not surface.unsaid


def test_an_empty_height_is_missing(tmp_path: Path) -> None:
    surface = points.read(put(tmp_path, points_file(missing="")))
    np.testing.assert_array_equal(np.isnan(surface.height_nm), np.isnan(heights_nm()))


def test_a_decimal_comma_is_one_between_semicolons(tmp_path: Path) -> None:
    content = points_file(";", header="").replace(b".", b",")
    surface = points.read(put(tmp_path, b"X [mm]; Y [mm]; Z [nm]\n" + content))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)


def test_any_order_and_left_out_points_are_the_same_map(tmp_path: Path) -> None:
    header, *lines = points_file().splitlines(keepends=True)
    kept = [line for line in lines if b"nan" not in line]
    np.random.default_rng(1).shuffle(kept)
    surface = points.read(put(tmp_path, header + b"".join(kept)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)


@pytest.mark.parametrize(
    ("header", "nm", "mm"),
    [
        ("x_mm y_mm z_um\n", 1e3, 1.0),
        ('"X (um)","Y (um)","Z (nm)"\n', 1.0, 1e-3),
        ("# made by hand\n# x[m],y[m],z[mm]\n", 1e6, 1e3),
        ("Report\n\nX/mm\tY/mm\tHeight/nm\n", 1.0, 1.0),
        ("X / mm,Y / mm,Z / nm\n", 1.0, 1.0),
        ("x mm,y mm,height um\n# made by hand, twice, or more\n", 1e3, 1.0),
        ("X_UM,Y_UM,Z_NM\n", 1.0, 1e-3),
    ],
)
def test_units_of_the_header_count(tmp_path: Path, header: str, nm: float, mm: float) -> None:
    surface = points.read(put(tmp_path, points_file(header=header).replace(b"nan", b"nan")))
    assert surface.factors["nm_per_unit"] == nm
    assert surface.pitch_mm == pytest.approx(PITCH_MM * mm)


@pytest.mark.parametrize("header", ["x [mm],y [mm],z [\u00b5m]\n", "# units: mm, mm, \u00b5m\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_the_micro_sign_is_known_in_both_encodings(tmp_path: Path, header: str, encoding: str) -> None:
    surface = points.read(put(tmp_path, header.encode(encoding) + points_file(header="")))
    assert (surface.factors["nm_per_unit"], surface.pitch_mm) == (1e3, pytest.approx(PITCH_MM))


@pytest.mark.parametrize("unit", [b"?m", b"\x81m", b"\xef\xbf\xbdm", b"~m"])
def test_a_unit_that_lost_its_micro_sign_is_not_taken_for_metres(tmp_path: Path, unit: bytes) -> None:
    for header in (b"x [mm],y [mm],z [%b]\n" % unit, b"%b %b %b\n" % (unit, unit, unit)):
        surface = points.read(put(tmp_path, header + points_file(header="")))
        assert "unit" in surface.unsaid
        assert surface.factors["nm_per_unit"] == 1.0


@pytest.mark.parametrize("separator", ["; ", " "])
def test_a_comma_beside_a_point_is_not_taken_for_the_decimal_one(tmp_path: Path, separator: str) -> None:
    rows = [separator.join((f"{x * 0.5}", f"{y * 0.5}", f"{900 + 10 * y + x:,}")) for y in range(12) for x in range(9)]
    assert rows[-1].endswith("1,018")
    path = put(tmp_path, "\n".join(["x_mm;y_mm;z_nm", *rows, ""]).encode(), "map.xyz")
    with pytest.raises(MapError, match=r"map\.xyz:9[0-9]: a number has a comma, and other numbers have a point"):
        points.read(path)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["1,0,2", "1,x,3", "2,0,1"], r"map\.csv:3: '1 x 3' is no point x y z"),
        (["1,0,2", "1,1", "2,0,1"], r"map\.csv:3: '1 1' is no point x y z"),
        (["1,0,2", "1d-2,1,3"], r"map\.csv:3: '1d-2 1 3' is no point x y z"),
    ],
)
def test_the_first_line_that_is_no_point_is_named(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(MapError, match=said):
        points.read(put(tmp_path, "\n".join(["x_mm,y_mm,z_nm", *lines, ""]).encode()))


def test_a_torn_last_line_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"map\.csv:3: the file is torn"):
        points.read(put(tmp_path, b"x_mm,y_mm,z_nm\n1,0,2\n1,"))


def test_text_in_utf_16_is_refused_by_its_name(tmp_path: Path) -> None:
    content = points_file().decode().encode("utf-16")
    assert points.sniff(content[:100], Path("map.csv"))
    with pytest.raises(MapError, match=r"map\.csv: is UTF-16 text\. Save it as UTF-8"):
        points.read(put(tmp_path, content))


def test_heights_that_no_instrument_measures_are_warned_of(tmp_path: Path) -> None:
    def warnings(height_nm: str) -> tuple[str, ...]:
        rows = [f"{x * 0.5},{y * 0.5},{height_nm if x == 3 else 7.0}" for y in range(5) for x in range(6)]
        return points.read(put(tmp_path, "\n".join(["x_mm,y_mm,z_nm", *rows, ""]).encode())).warnings

    assert warnings("7.0") == ("all 30 heights are equal: nothing was measured",)
    assert warnings("499000") == ()
    [warning] = warnings("2500000")
    assert warning.startswith("neighbours 0.5 mm apart differ by up to 2.5 mm: check the unit of heights")


@pytest.mark.parametrize(
    "line", ["a" + " " * 20_000 + "1,b,c", "x_mm,y_mm,z_um" + " " * 300, "1" * 2000 + " " + "1" * 2000 + "x"]
)
def test_a_long_line_before_the_points_is_no_title(tmp_path: Path, line: str) -> None:
    surface = points.read(put(tmp_path, points_file(header=f"{line}\n")))
    assert surface.unsaid == {"unit", "pitch"}


@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        (points.TITLE, "a" + " " * 20_000 + "1"),
        (points.POINT, b"1" * 20_000 + b" " + b"1" * 20_000 + b"x"),
        (points.DECIMAL_COMMA, b" " * 500_000 + b"1 2 3 4"),
    ],
)
def test_a_long_line_that_does_not_match_is_gone_over_once(pattern: re.Pattern[Any], text: Any) -> None:
    assert pattern.fullmatch(text) is None  # a day, where each blank is tried as the end of each part


def test_without_units_they_are_left_open(tmp_path: Path) -> None:
    surface = points.read(put(tmp_path, points_file(header="x,y,z\n")))
    assert surface.unsaid == {"unit", "pitch"}
    assert surface.pitch_mm is None
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)


def test_a_wavefront_is_not_taken_for_a_surface(tmp_path: Path) -> None:
    assert points.read(put(tmp_path, points_file(header="x_mm,y_mm,opd_nm\n"))).unsaid == {"surface"}


def grid(x: np.ndarray, y: np.ndarray) -> bytes:
    return b"x_mm y_mm z_nm\n" + b"".join(
        f"{a:.6f} {b:.6f} {i}\n".encode() for i, (a, b) in enumerate(zip(x.ravel(), y.ravel(), strict=True))
    )


def test_rounded_coordinates_are_still_a_grid(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.round(np.arange(400) * 0.1179242, 3), np.round(np.arange(30) * 0.1179242, 3))
    surface = points.read(put(tmp_path, grid(x, y)))
    assert surface.height_nm.shape == (30, 400)
    assert surface.pitch_mm == pytest.approx(0.1179242, rel=1e-4)


@pytest.mark.parametrize("kind", ["turned", "scattered", "twice", "line", "stretched"])
def test_what_lies_on_no_grid_is_refused(tmp_path: Path, kind: str) -> None:
    x, y = np.meshgrid(np.arange(12.0), np.arange(10.0))
    if kind == "turned":
        x, y = x * 0.96 - y * 0.28, x * 0.28 + y * 0.96
    elif kind == "scattered":
        x = x + np.random.default_rng(2).uniform(-0.3, 0.3, x.shape)
    elif kind == "twice":
        x, y = np.append(x, 3.0), np.append(y, 3.0)
    elif kind == "line":
        x, y = x[0], y[0]
    else:
        x = x**1.1
    with pytest.raises(MapError, match=r"grid|place"):
        points.read(put(tmp_path, grid(x, y)))


def test_far_off_points_are_no_reason_to_allocate(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"grid|place"):
        points.read(put(tmp_path, points_file() + b"1e6,1e6,3\n"))


@pytest.mark.parametrize(
    "content",
    [b"", b"\0\1\2", b"a,b,c\n", b"1,2\n3,4\n", b"1,2,3,4\n1,2,3,4\n", b"1,2,3\n1,x,3\n", b"nan,1,2\n" * 5, b"1,2,3"],
)
def test_what_is_no_such_list_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(MapError, match=r"map\.csv"):
        points.read(put(tmp_path, content))


def test_infinite_heights_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="infinite"):
        points.read(put(tmp_path, points_file(missing="inf")))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("1 1 inf", "an infinite height, 1 in all. Write nan"),
        ("1 0 5", "a point lies on an earlier one, at 1 places in all: not one map. Export each map"),
        ("1.4 1 5", "x lies 0.20 pixel off a regular grid of 0.333333 (in the unit of x), and 0.1 is allowed. Export"),
        ("nan 1 5", "a point has no coordinates, 1 in all. Export the map"),
    ],
)
def test_a_point_that_is_refused_is_named_by_its_line(tmp_path: Path, line: str, what: str) -> None:
    lines = [f"{x} {y} {x + y}" for y in range(3) for x in range(6)]
    lines[7] = line
    path = tmp_path / "a.xyz"
    path.write_text("\n".join(["# x mm y mm z nm", *lines[:3], "# a pause", "", *lines[3:]]) + "\n")
    with pytest.raises(MapError, match=re.escape(f"{path}:11: {what}")):
        points.read(path)


def test_only_text_with_points_is_claimed() -> None:
    assert points.sniff(b"title\n1.5;2;3\n", Path("a.txt"))
    assert not points.sniff(b"title\nno numbers\n", Path("a.txt"))
    assert not points.sniff(b"1 2 3\n", Path("a.dat"))
    assert not points.sniff(b"Zygo XYZ Data File\n1 2 3\n", Path("a.xyz"))


@pytest.mark.parametrize("separator", ["\t", "  "])
def test_a_decimal_comma_is_one_between_blanks(tmp_path: Path, separator: str) -> None:
    surface = points.read(put(tmp_path, points_file(separator).replace(b".", b",")))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)


def test_the_titles_say_which_column_is_which(tmp_path: Path) -> None:
    lines = points_file(separator=",").splitlines()[1:]
    swapped = b"\n".join(b",".join(line.split(b",")[at] for at in (1, 0, 2)) for line in lines) + b"\n"
    surface = points.read(put(tmp_path, b"y_mm,x_mm,z_nm\n" + swapped))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)


def test_rows_of_a_camera_count_from_the_top(tmp_path: Path) -> None:
    lines = [f"{row},{column},{z}" for (row, column), z in np.ndenumerate(heights_nm())]
    surface = points.read(put(tmp_path, "\n".join(["row,col,z_nm", *lines, ""]).encode()))
    np.testing.assert_allclose(surface.height_nm, heights_nm())
    assert surface.unsaid == {"pitch"}


def test_titles_of_something_else_leave_the_order_open(tmp_path: Path) -> None:
    surface = points.read(put(tmp_path, points_file(header="lon,lat,h\n")))
    assert surface.unsaid == {"unit", "pitch", "orientation"}
    assert points.ODD_TITLES in surface.warnings


def test_a_list_that_stops_inside_a_row_is_torn(tmp_path: Path) -> None:
    lines = points_file().splitlines(keepends=True)
    by_columns = [lines[0], *sorted(lines[1:], key=lambda line: float(line.split()[0].split(b",")[0]))]
    for listed in (lines, by_columns):
        for cut in (1, 2, 3):
            with pytest.raises(MapError, match=rf"last (row|column) lacks {cut} points: torn"):
                points.read(put(tmp_path, b"".join(listed[:-cut])))


def test_a_list_that_ends_inside_a_line_is_read_with_a_warning(tmp_path: Path) -> None:
    surface = points.read(put(tmp_path, points_file().rstrip(b"\n")))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-9)
    assert surface.warnings == (points.CUT,)


@pytest.mark.parametrize("marker", ["-9999", "32767", "99999.0"])
def test_an_undeclared_marker_is_refused(tmp_path: Path, marker: str) -> None:
    with pytest.raises(MapError, match="marker of missing data"):
        points.read(put(tmp_path, points_file(missing=marker)))
