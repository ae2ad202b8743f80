"""TIFF as tifffile writes it: numbers are read, pictures refused, resolutions for printers not believed."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from polishd.api import MapError
from polishd.plugins.interferometer.formats import tiff
from tests.unit.plugins.interferometer.map_files_other import heights_nm, tiff_file

OPEN = {"unit", "surface", "orientation"}


def put(folder: Path, content: bytes) -> Path:
    path = folder / "map.tif"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "options", [{}, {"byteorder": ">"}, {"bigtiff": True}, {"compression": "zlib"}, {"tile": (16, 16)}]
)
@pytest.mark.parametrize("dtype", ["f8", "f4", "i2"])
def test_heights_come_back_as_displayed(tmp_path: Path, options: dict[str, Any], dtype: str) -> None:
    z = heights_nm(missing=dtype != "i2").astype(dtype)
    surface = tiff.read(put(tmp_path, tiff_file(z, **options)))
    np.testing.assert_array_equal(surface.height_nm, z.astype(float))
    assert surface.pitch_mm is None
    assert surface.unsaid == OPEN | {"pitch"}


def test_a_printers_resolution_is_no_pitch(tmp_path: Path) -> None:
    assert tiff.read(put(tmp_path, tiff_file(resolution=(72, 72), resolutionunit="INCH"))).pitch_mm is None


def test_imagejs_scale_is_a_pitch(tmp_path: Path) -> None:
    content = tiff_file(heights_nm().astype("f4"), imagej=True, resolution=(4, 4), metadata={"unit": "mm"})
    surface = tiff.read(put(tmp_path, content))
    assert surface.pitch_mm == pytest.approx(0.25)
    assert surface.unsaid == OPEN


@pytest.mark.parametrize(("unit", "pitch_mm"), [("mm", 0.5), ("µm", 5e-4), (None, 5e-4), ("pixel", None)])
def test_omes_size_is_a_pitch(tmp_path: Path, unit: str | None, pitch_mm: float | None) -> None:
    words: dict[str, Any] = {"PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5}
    if unit:
        words |= {"PhysicalSizeXUnit": unit, "PhysicalSizeYUnit": unit}
    content = tiff_file(heights_nm(), ome=True, metadata={"axes": "YX"} | words)
    assert tiff.read(put(tmp_path, content)).pitch_mm == pytest.approx(pitch_mm)


@pytest.mark.parametrize(("tag", "rows", "columns"), [(1, 1, 1), (2, 1, -1), (3, -1, -1), (4, -1, 1)])
def test_the_orientation_tag_is_obeyed(tmp_path: Path, tag: int, rows: int, columns: int) -> None:
    content = tiff_file(heights_nm()[::rows, ::columns], extratags=[(274, "H", 1, tag, True)])
    np.testing.assert_array_equal(tiff.read(put(tmp_path, content)).height_nm, heights_nm())


def test_rows_stored_as_columns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="orientation 6"):
        tiff.read(put(tmp_path, tiff_file(extratags=[(274, "H", 1, 6, True)])))


def test_the_declared_marker_is_missing_and_an_undeclared_one_refused(tmp_path: Path) -> None:
    z = np.where(np.isnan(heights_nm()), -3.4e38, heights_nm())
    declared = tiff.read(put(tmp_path, tiff_file(z, extratags=[(42113, "s", 0, "-3.4e38", True)])))
    np.testing.assert_array_equal(np.isnan(declared.height_nm), np.isnan(heights_nm()))
    with pytest.raises(MapError, match="marker of missing data"):
        tiff.read(put(tmp_path, tiff_file(z)))


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((4, 5, 3), dtype="u1"),
        np.zeros((5, 6, 4)),
        np.zeros((4, 5), dtype="c8"),
        np.full((3, 3), np.nan),
        np.full((3, 3), np.inf),
    ],
    ids=["colours", "pages", "complex", "empty", "infinite"],
)
def test_what_is_no_map_is_refused(tmp_path: Path, array: np.ndarray) -> None:
    with pytest.raises(MapError):
        tiff.read(
            put(
                tmp_path,
                tiff_file(array, photometric="rgb" if array.shape[-1] == 3 and array.ndim == 3 else "minisblack"),
            )
        )


def test_two_pages_are_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    with tifffile.TiffWriter(file) as writer:
        writer.write(heights_nm(), metadata=None)
        writer.write(heights_nm(), metadata=None)
    with pytest.raises(MapError, match="2 pages"):
        tiff.read(put(tmp_path, file.getvalue()))


@pytest.mark.parametrize("tag", [256, 257])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("size", [0, 70_000, 2**31])
def test_sizes_that_the_file_does_not_hold_are_refused(
    tmp_path: Path, tag: int, compression: str | None, size: int
) -> None:
    content = bytearray(tiff_file(compression=compression))
    with tifffile.TiffFile(io.BytesIO(bytes(content))) as file:
        at = file.pages.first.tags[tag].offset
    struct.pack_into("<HHII", content, at, tag, 4, 1, size)
    with pytest.raises(MapError):
        tiff.read(put(tmp_path, bytes(content)))


def test_torn_files_are_refused(tmp_path: Path) -> None:
    for size in (4, 8, 100, len(tiff_file()) - 1):
        with pytest.raises(MapError):
            tiff.read(put(tmp_path, tiff_file()[:size]))


def test_without_the_extra_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = tiff_file()
    monkeypatch.setitem(sys.modules, "tifffile", None)
    with pytest.raises(MapError, match=r"pip install 'polishd\[tiff\]'"):
        tiff.read(put(tmp_path, content))


@pytest.mark.parametrize("photometric", ["miniswhite", "palette"])
def test_pictures_of_one_channel_are_refused(tmp_path: Path, photometric: str) -> None:
    options = {"colormap": np.zeros((3, 256), dtype="u2")} if photometric == "palette" else {}
    content = tiff_file(np.arange(30, dtype="u1").reshape(5, 6), photometric=photometric, **options)
    with pytest.raises(MapError, match="is a picture"):
        tiff.read(put(tmp_path, content))


def test_a_preallocated_file_is_refused(tmp_path: Path) -> None:
    z = heights_nm()
    z.ravel()[-16:] = 0.0
    with pytest.raises(MapError, match="tail of zeros"):
        tiff.read(put(tmp_path, tiff_file(z)))


@pytest.mark.parametrize(
    ("options", "tag", "index", "value"),
    [
        ({}, 256, 0, 19),
        ({"tile": (16, 16)}, 324, 0, 8),
        ({"tile": (16, 16)}, 325, 0, 0),
        ({"rowsperstrip": 2}, 279, 1, 4),
        ({"rowsperstrip": 2}, 273, 1, 400),
    ],
)
def test_pieces_that_are_not_the_images_are_refused(
    tmp_path: Path, options: dict[str, Any], tag: int, index: int, value: int
) -> None:
    content = bytearray(tiff_file(np.full((17, 20), 3.0), **options))
    with tifffile.TiffFile(io.BytesIO(bytes(content))) as file:
        found = file.pages.first.tags[tag]
        struct.pack_into(
            "<H" if found.dtype == 3 else "<I",
            content,
            found.valueoffset + index * (2 if found.dtype == 3 else 4),
            value,
        )
    with pytest.raises(MapError):
        tiff.read(put(tmp_path, bytes(content)))
