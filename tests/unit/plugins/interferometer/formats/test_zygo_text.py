"""Reading Zygo's text formats: the integer code once, frames and corners, and every way to be broken."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.zygo_text import ZYGO_ASCII, ZYGO_XYZ
from tests.unit.plugins.interferometer import map_files as make

NM = make.ASCII_NM
FORMATS: dict[str, Callable[..., bytes]] = {"zygo_ascii": make.zygo_ascii, "zygo_xyz": make.zygo_xyz}
READERS = {reader.name: reader for reader in (ZYGO_ASCII, ZYGO_XYZ)}


def found(tmp_path: Path, name: str, content: bytes) -> SurfaceMap:
    path = tmp_path / "map.txt"
    path.write_bytes(content)
    return READERS[name].read(path)


def same(surface: SurfaceMap, nm: float = NM) -> None:
    np.testing.assert_allclose(surface.height_nm, make.HEIGHT_NM, atol=0.5001 * nm)


@pytest.mark.parametrize("name", FORMATS)
def test_what_stands_in_a_file(tmp_path: Path, name: str) -> None:
    surface = found(tmp_path, name, FORMATS[name]())
    same(surface)
    assert surface.pitch_mm == pytest.approx(make.PITCH_MM)
    assert (surface.part_id, surface.instrument) == (make.PART, "Zygo, system 651365")
    assert surface.taken_at == datetime.fromtimestamp(make.TAKEN_S, UTC)
    assert (surface.format, surface.warnings, surface.unsaid) == (name, (), frozenset())
    assert surface.factors["origin_px"] == (12, 7)


@pytest.mark.parametrize("name", FORMATS)
def test_a_serial_number_of_quotation_marks_is_none(tmp_path: Path, name: str) -> None:
    assert found(tmp_path, name, FORMATS[name](line6='""" """')).part_id == "M1"
    assert found(tmp_path, name, FORMATS[name](line6="\"''\"", line7='""')).part_id == ""
    assert found(tmp_path, name, FORMATS[name](line6='"5\' mirror"')).part_id == "5' mirror"


@pytest.mark.parametrize("name", FORMATS)
def test_without_lateral_scale(tmp_path: Path, name: str) -> None:
    surface = found(tmp_path, name, FORMATS[name](line8="0 0.5 6.328e-07 0 1 0 0 0"))
    same(surface)
    assert (surface.pitch_mm, set(surface.unsaid), surface.taken_at) == (None, {"pitch"}, None)
    assert "CameraRes" in surface.warnings[0]


@pytest.mark.parametrize("name", FORMATS)
def test_other_line_ends_and_letters(tmp_path: Path, name: str) -> None:
    content = FORMATS[name](line5='"Prüfling, Zustand #7"')
    same(found(tmp_path, name, content))
    same(found(tmp_path, name, content.replace(b"\n", b"\r\n")))


@pytest.mark.parametrize(
    ("line", "text", "nm"),
    [
        ("line11", "0 0 20 1 0 0 0 0 0", 8 * NM),
        ("line11", "2 0 20 1 0 0 0 0 0", NM / 4),
        ("line11", "1 0 20 1 0 0 0 1 0", -NM),
        ("line8", "0 1.0 6.328e-07 0 1 0 2.5e-4 0", 2 * NM),
        ("line8", "0 0.5 6.328e-07 0 2 0 2.5e-4 0", 2 * NM),
        ("line8", "0 0.5 1.2656e-06 0 1.0 0 0.00025 0", 2 * NM),
    ],
)
def test_each_factor_is_applied_once(tmp_path: Path, line: str, text: str, nm: float) -> None:
    surface = found(tmp_path, "zygo_ascii", make.zygo_ascii(nm=nm, lines={line: text}))
    same(surface, abs(nm))
    assert surface.factors["nm_per_count"] == pytest.approx(nm)


@pytest.mark.parametrize("wrap", [1, 7, 48])
def test_phase_wrapped_anyhow(tmp_path: Path, wrap: int) -> None:
    same(found(tmp_path, "zygo_ascii", make.zygo_ascii(wrap=wrap)))


def test_without_intensities(tmp_path: Path) -> None:
    content = make.zygo_ascii(line3="0 0 0 0 0 0").replace(b"1 2 3\n4 5 6\n", b"")
    same(found(tmp_path, "zygo_ascii", content))


@pytest.mark.parametrize("corner", [(12, 7), (0, 0)])
def test_points_count_from_the_camera_or_from_0(tmp_path: Path, corner: tuple[int, int]) -> None:
    same(found(tmp_path, "zygo_xyz", make.zygo_xyz(corner=corner)))


def test_points_in_another_order_tabs_and_empty_lines(tmp_path: Path) -> None:
    head, _, points = make.zygo_xyz().partition(b"\n#\n")
    lines = points.removesuffix(b"\n#\n").split(b"\n")
    turned = b"\n\n".join(line.replace(b" ", b"\t", 2) for line in reversed(lines))
    same(found(tmp_path, "zygo_xyz", head + b"\n#\n" + turned + b"\n#\n"))


def test_thirteen_lines_and_no_end_mark(tmp_path: Path) -> None:
    content = make.zygo_xyz().replace(b'"1.0"\n#', b"#")
    same(found(tmp_path, "zygo_xyz", content))
    same(found(tmp_path, "zygo_xyz", content.removesuffix(b"#\n")))


def test_the_sign_of_points_is_in_them(tmp_path: Path) -> None:
    surface = found(tmp_path, "zygo_xyz", make.zygo_xyz(line11="1 0 20 1 0 0 0 1 0"))
    same(surface)
    assert "sign" in surface.warnings[0]


BOTH: dict[str, tuple[dict[str, str], str]] = {
    "no scale": ({"line8": "0 0 6.328e-07 0 1 0 2.5e-4 0"}, "IntfScaleFactor"),
    "wavelength NaN": ({"line8": "0 0.5 nan 0 1 0 2.5e-4 0"}, "Wavelength"),
    "wavelength in um": ({"line8": "0 0.5 0.6328 0 1 0 2.5e-4 0"}, "Wavelength"),
    "obliquity infinite": ({"line8": "0 0.5 6.328e-07 0 inf 0 2.5e-4 0"}, "Obliquity"),
    "pitch NaN": ({"line8": "0 0.5 6.328e-07 0 1 0 nan 0"}, "CameraRes"),
    "pitch in mm": ({"line8": "0 0.5 6.328e-07 0 1 0 250 0"}, "CameraRes"),
    "pitch negative": ({"line8": "0 0.5 6.328e-07 0 1 0 -2.5e-4 0"}, "CameraRes"),
    "line 8 short": ({"line8": "0 0.5 6.328e-07"}, "line 8 has 3"),
    "line 8 text": ({"line8": "a b c d e f g h"}, "is not Zygo's"),
    "line 4 short": ({"line4": "0 0 8"}, "line 4 has 3"),
    "no rows": ({"line4": "0 0 8 0"}, "no phase data"),
    "negative": ({"line4": "0 0 -8 -6"}, "no phase data"),
    "absurd": ({"line4": "0 0 99999 99999"}, "no interferometer's camera"),
    "larger than it is": ({"line4": "0 0 3000 3000"}, "too short"),
    "one row more": ({"line4": "12 7 8 7"}, "values|lists|too short"),
    "one row less": ({"line4": "12 7 8 5"}, "values|outside"),
    "turned": ({"line4": "12 7 6 8"}, "outside|^$"),
    "resolution": ({"line11": "3 0 20 1 0 0 0 0 0"}, "PhaseRes"),
    "line 11 short": ({"line11": "1 0"}, "is not Zygo's"),
    "line 9 short": ({"line9": ""}, "is not Zygo's"),
}


@pytest.mark.parametrize("case", BOTH)
@pytest.mark.parametrize("name", FORMATS)
def test_broken_headers(tmp_path: Path, name: str, case: str) -> None:
    lines, reason = BOTH[case]
    if (name, case) == ("zygo_ascii", "turned"):
        pytest.skip("48 counts are 48 counts: the file does not show it")
    with pytest.raises(MapError, match=reason) as caught:
        found(tmp_path, name, FORMATS[name](**lines))
    assert str(caught.value).startswith(f"{tmp_path / 'map.txt'}: ")


ASCII, XYZ = make.zygo_ascii(), make.zygo_xyz()
LAST = XYZ.removesuffix(b"\n#\n").rfind(b"\n") + 1
BODIES: dict[str, tuple[str, bytes, str]] = {
    "empty": ("zygo_ascii", b"", "empty"),
    "another format": ("zygo_ascii", XYZ, "no Zygo ASCII"),
    "the other format": ("zygo_xyz", ASCII, "no Zygo XYZ"),
    "no header's end": ("zygo_ascii", ASCII.replace(b"#\n1 2 3", b"1 2 3").replace(b"\n#", b"\n"), "does not end"),
    "a line more": ("zygo_ascii", ASCII.replace(b"1 0\n", b"1 0\n1 0\n", 1), "has 15 lines"),
    "torn": ("zygo_ascii", ASCII[:-2], "does not end in a line"),
    "one value less": ("zygo_ascii", ASCII[: ASCII.rfind(b" ")] + b"\n#\n", "47 values"),
    "one value more": ("zygo_ascii", ASCII[:-3] + b" 5\n#\n", "49 values"),
    "fractions": ("zygo_ascii", ASCII[:-3] + b".5\n#\n", "no integers"),
    "letters": ("zygo_ascii", ASCII[:-3] + b"x\n#\n", "stands among its numbers"),
    "trailing": ("zygo_ascii", ASCII + b"more\n", "follows the end"),
    "zeros": ("zygo_ascii", ASCII[:-20] + bytes(20), "does not end"),
    "no sample": ("zygo_ascii", make.zygo_ascii(make.HEIGHT_NM * np.nan), "no sample"),
    "point torn": ("zygo_xyz", XYZ[:-5], "ends inside a line"),
    "point missing": ("zygo_xyz", XYZ[:LAST] + b"#\n", "lists 47 points"),
    "point doubled": ("zygo_xyz", XYZ[:-2] + XYZ[LAST:-2] + b"#\n", "lists 49 points"),
    "point twice, another missing": ("zygo_xyz", XYZ[:LAST] + b"12 7 0.5\n#\n", "47 of 48 pixels"),
    "point outside": ("zygo_xyz", XYZ[:LAST] + b"99 12 0.5\n#\n", "outside"),
    "between pixels": ("zygo_xyz", XYZ[:LAST] + b"18.5 12 0.5\n#\n", "outside"),
    "two numbers": ("zygo_xyz", XYZ[:LAST] + b"19 12\n#\n", "not 'column row height'"),
    "four numbers": ("zygo_xyz", XYZ[:LAST] + b"19 12 1 2\n#\n", "not 'column row height'"),
    "its own nan": ("zygo_xyz", XYZ[:LAST] + b"19 12 nan\n#\n", "not 'column row height'"),
    "no frame": ("zygo_xyz", make.zygo_xyz(corner=(3, 3)), "no corner"),
    "infinite": ("zygo_xyz", XYZ[:LAST] + b"19 12 1e999\n#\n", "infinite"),
    "all missing": ("zygo_xyz", make.zygo_xyz(make.HEIGHT_NM * np.nan), "no sample"),
    "points trailing": ("zygo_xyz", XYZ + b"1 2 3\n", "follows the end"),
    "points and zeros": ("zygo_xyz", XYZ[:-40] + bytes(40), "ends inside a line|stands among"),
}


@pytest.mark.parametrize("case", BODIES)
def test_broken_bodies(tmp_path: Path, case: str) -> None:
    name, content, reason = BODIES[case]
    with pytest.raises(MapError, match=reason):
        found(tmp_path, name, content)


def test_as_prysm_writes_it(tmp_path: Path) -> None:
    prysm = pytest.importorskip("prysm.io")
    path = tmp_path / "theirs.asc"
    prysm.write_zygo_ascii(path, np.arange(60.0).reshape(6, 10), dx=1e-6)  # it writes 1e3 times the pitch, in "m"
    surface = ZYGO_ASCII.read(path)
    assert surface.height_nm.shape == (6, 10)
    assert (np.diff(surface.height_nm, axis=1) > 0).all()


def test_sniff() -> None:
    assert ZYGO_ASCII.sniff(ASCII, Path("a")) and not ZYGO_ASCII.sniff(XYZ, Path("a"))  # noqa: PT018
    assert ZYGO_XYZ.sniff(XYZ, Path("a")) and not ZYGO_XYZ.sniff(ASCII, Path("a"))  # noqa: PT018
