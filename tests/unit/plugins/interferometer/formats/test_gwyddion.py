"""Gwyddion's files as gwyfile writes them, and broken ones."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from gwyfile.objects import GwyContainer, GwyDataField, GwyObject

from polishd.api import MapError
from polishd.plugins.interferometer.formats import gwyddion
from tests.unit.plugins.interferometer.map_files_other import COLUMNS, PITCH_MM, ROWS, gwy_bytes, gwy_file, heights_nm


def put(folder: Path, content: bytes) -> Path:
    path = folder / "map.gwy"
    path.write_bytes(content)
    return path


def test_heights_and_mask_are_read(tmp_path: Path) -> None:
    surface = gwyddion.read(put(tmp_path, gwy_file()))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-10)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)
    assert not surface.unsaid
    assert surface.warnings == ("2 samples under Gwyddion's mask are taken as missing",)


def test_the_library_agrees(tmp_path: Path) -> None:
    path = put(tmp_path, gwy_file(masked=False))
    field = GwyObject.fromfile(str(path))["/0/data"]
    np.testing.assert_array_equal(gwyddion.read(path).height_nm, field.data * 1e9)


@pytest.mark.parametrize(("unit", "lateral", "nm", "mm"), [("nm", "mm", 1.0, 1.0), ("um", "um", 1e3, 1e-3)])
def test_units_are_the_files_own(tmp_path: Path, unit: str, lateral: str, nm: float, mm: float) -> None:
    surface = gwyddion.read(put(tmp_path, gwy_file(unit, lateral, xreal=COLUMNS * 0.5, yreal=ROWS * 0.5)))
    np.testing.assert_allclose(surface.height_nm, heights_nm() / 1e9 * nm)
    assert surface.pitch_mm == pytest.approx(0.5 * mm)


@pytest.mark.parametrize("unit", ["V", "deg", "", "wave", "A"])
def test_a_unit_that_is_no_length_is_left_open(tmp_path: Path, unit: str) -> None:
    surface = gwyddion.read(put(tmp_path, gwy_file(unit, unit)))
    assert surface.unsaid == {"unit", "pitch"}
    assert surface.pitch_mm is None
    np.testing.assert_allclose(surface.height_nm, heights_nm() / 1e9)


def test_the_lowest_of_several_channels_is_taken_and_said(tmp_path: Path) -> None:
    container = GwyContainer()
    size = {"xreal": 1e-3, "yreal": 1e-3, "si_unit_xy": "m", "si_unit_z": "m"}
    container["/12/data"] = GwyDataField(np.ones((2, 2)), **size)
    container["/3/data"] = GwyDataField(np.arange(4.0).reshape(2, 2) / 1e9, **size)
    surface = gwyddion.read(put(tmp_path, gwy_bytes(container)))
    np.testing.assert_allclose(surface.height_nm, [[0, 1], [2, 3]])
    assert "channel 3 of 3, 12 is taken" in surface.warnings


def test_a_mask_of_another_shape_is_refused(tmp_path: Path) -> None:
    container = GwyContainer()
    container["/0/data"] = GwyDataField(np.zeros((2, 2)))
    container["/0/mask"] = GwyDataField(np.zeros((2, 3)))
    with pytest.raises(MapError, match="mask is"):
        gwyddion.read(put(tmp_path, gwy_bytes(container)))


def test_pixels_that_are_not_square_have_no_pitch(tmp_path: Path) -> None:
    assert gwyddion.read(put(tmp_path, gwy_file(xreal=1e-3))).unsaid == {"square pixels"}


@pytest.mark.parametrize("size", [0.0, -1e-3, np.nan, np.inf])
def test_a_size_that_is_none_is_refused(tmp_path: Path, size: float) -> None:
    with pytest.raises(MapError, match="pitch in x"):
        gwyddion.read(put(tmp_path, gwy_file(xreal=size)))


def test_torn_and_padded_files_are_refused(tmp_path: Path) -> None:
    whole = gwy_file()
    for content in (whole[:3], whole[:30], whole[: len(whole) // 2], whole[:-1], whole + b"\0"):
        with pytest.raises(MapError, match=r"map\.gwy"):
            gwyddion.read(put(tmp_path, content))


@pytest.mark.parametrize("value", [0, 8, -7, 2**31 - 1])
def test_a_resolution_that_the_samples_do_not_have_is_refused(tmp_path: Path, value: int) -> None:
    whole = gwy_file()
    at = whole.index(b"xres\0i") + 6
    with pytest.raises(MapError, match="samples"):
        gwyddion.read(put(tmp_path, whole[:at] + struct.pack("<i", value) + whole[at + 4 :]))


def test_objects_within_objects_do_not_exhaust_the_stack(tmp_path: Path) -> None:
    inner = b""
    for _ in range(3000):
        inner = b"a\0o" + b"X\0" + struct.pack("<I", len(inner)) + inner
    content = b"GWYPGwyContainer\0" + struct.pack("<I", len(inner)) + inner
    with pytest.raises(MapError, match="no channel"):
        gwyddion.read(put(tmp_path, content))


def test_a_field_stuffed_with_other_things_is_refused(tmp_path: Path) -> None:
    container = GwyContainer()
    container["/0/data"] = GwyDataField(np.zeros((2, 2)))
    container["/0/data"]["junk"] = "x" * 10_000
    with pytest.raises(MapError, match="more than its samples"):
        gwyddion.read(put(tmp_path, gwy_bytes(container)))


def test_a_unit_that_the_library_would_read_for_ever_is_refused(tmp_path: Path) -> None:
    endless = gwy_file().replace(b"unitstr\0sm\0", b"unitstr\0smm", 1)
    with pytest.raises(MapError, match="broken at byte"):
        gwyddion.read(put(tmp_path, endless))


def test_a_container_without_a_field_is_refused(tmp_path: Path) -> None:
    container = GwyContainer()
    container["/0/data"] = "a text"
    with pytest.raises(MapError, match="no data field"):
        gwyddion.read(put(tmp_path, gwy_bytes(container)))


def test_without_the_extra_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gwyfile.objects", None)
    with pytest.raises(MapError, match=r"pip install 'polishd\[gwy\]'"):
        gwyddion.read(put(tmp_path, gwy_file()))
