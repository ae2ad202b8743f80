"""SDF: what sdfio writes, what stands in a file by hand, and what MountainsMap wrote."""

from __future__ import annotations

import struct
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import sdfio

from polishd.api import MapError
from polishd.plugins.interferometer.formats import sdf
from tests.unit.plugins.interferometer.map_files_other import (
    COLUMNS,
    PITCH_MM,
    ROWS,
    heights_nm,
    sdf_ascii,
    sdf_binary,
    sdf_second,
)

ITEM = {"INT8": 1, "INT16": 2, "INT32": 4}


def put(folder: Path, content: bytes) -> Path:
    path = folder / "map.sdf"
    path.write_bytes(content)
    return path


def test_the_shared_file_is_read_exactly(shared_data: Path) -> None:
    surface = sdf.read(shared_data / "mountainsmap.sdf")
    z = surface.height_nm
    assert z.shape == (20, 30)
    assert np.isnan(z).sum() == 1
    assert np.nanmax(z) - np.nanmin(z) == pytest.approx(599.0, rel=1e-6)
    assert np.nanstd(z) == pytest.approx(172.996075, rel=1e-6)
    assert surface.pitch_mm == pytest.approx(0.001)
    assert np.isnan(z[-1, -1])  # the file's first row is the lowest


@pytest.mark.parametrize("content", [sdf_binary(), sdf_ascii()], ids=["by hand", "ascii"])
def test_heights_come_back_the_right_way_up(tmp_path: Path, content: bytes) -> None:
    surface = sdf.read(put(tmp_path, content))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-10)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)
    assert not surface.unsaid


@pytest.mark.one_of_each
@pytest.mark.parametrize("kind", [kind for kind in sdfio.DataType if not kind.name.startswith("U")])
def test_the_second_editions_header_is_four_bytes_longer(tmp_path: Path, kind: sdfio.DataType) -> None:
    content = sdf_second(kind)
    assert (content[:8], struct.unpack_from("<II", content, 42)) == (b"bISO-2.0", (COLUMNS, ROWS))
    step_nm = np.nanmax(np.abs(heights_nm())) / np.iinfo(f"i{ITEM[kind.name]}").max if "INT" in kind.name else 1e-4
    for whole in (content, b"\xef\xbb\xbf" + content, content + b"Operator = A\r\n"):
        surface = sdf.read(put(tmp_path, whole))
        np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=step_nm)
        assert surface.pitch_mm == pytest.approx(PITCH_MM)
    for start in range(8, 85):  # no byte of the header makes another error than a refusal
        for value in (0, 1, 0xFF):
            broken = content[:start] + bytes([value]) + content[start + 1 :]
            with suppress(MapError):
                sdf.read(put(tmp_path, broken))


def test_samples_beyond_the_second_editions_are_refused(tmp_path: Path) -> None:
    content = bytearray(sdf_second())
    struct.pack_into("<I", content, 42, COLUMNS - 1)
    with pytest.raises(MapError, match="more than its header asks for"):
        sdf.read(put(tmp_path, bytes(content)))


def test_the_date_is_the_headers(tmp_path: Path) -> None:
    at = datetime(2019, 3, 14, 10, 22, tzinfo=UTC)
    surface = sdf.read(put(tmp_path, sdf_second(create_date=at)))
    assert (surface.taken_at, surface.date_from) == (at, "header")
    assert sdf.read(put(tmp_path, sdf_second(create_date=None))).taken_at is None


def test_the_forerunner_lists_its_rows_from_the_top(tmp_path: Path) -> None:
    metadata = sdfio.Metadata(revision=sdfio.Revision.BCR_1_0)
    content = bytearray(sdf_ascii(metadata=metadata, format=sdfio.FileFormat.BINARY))
    surface = sdf.read(put(tmp_path, bytes(content)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-10)
    first = struct.unpack_from("<d", content, len(content) - 8 * ROWS * COLUMNS)[0]
    assert first * 1e9 == pytest.approx(heights_nm()[0, 0])


def test_both_markers_of_missing_points_are_missing(tmp_path: Path) -> None:
    low = np.float64(-np.finfo(float).max).tobytes()
    high = np.float64(np.finfo(float).max).tobytes()
    assert sdf_binary().count(high) == 2
    for content in (sdf_binary(), sdf_binary().replace(high, low)):
        missing = np.isnan(sdf.read(put(tmp_path, content)).height_nm)
        np.testing.assert_array_equal(missing, np.isnan(heights_nm()))


def test_a_file_without_scales_has_no_pitch(tmp_path: Path) -> None:
    surface = sdf.read(put(tmp_path, sdf_binary(pitch_m=(0.0, 0.0))))
    assert surface.pitch_mm is None
    assert surface.unsaid == {"pitch"}


@pytest.mark.parametrize("pitch_m", [(0.0, 1e-4), (-1e-4, 1e-4), (np.nan, np.nan), (np.inf, 1e-4)])
def test_a_pitch_that_is_none_is_refused(tmp_path: Path, pitch_m: tuple[float, float]) -> None:
    with pytest.raises(MapError, match=r"pitch in [xy] is"):
        sdf.read(put(tmp_path, sdf_binary(pitch_m=pitch_m)))


def test_a_pixel_that_is_not_square_is_shown_without_a_pitch(tmp_path: Path) -> None:
    assert sdf.read(put(tmp_path, sdf_binary(pitch_m=(1e-4, 1.002e-4)))).unsaid == {"square pixels"}
    assert sdf.read(put(tmp_path, sdf_binary(pitch_m=(1e-4, 1.0005e-4)))).pitch_mm == pytest.approx(0.100025)


@pytest.mark.parametrize("z_scale", [0.0, -1e-9, np.nan, np.inf])
def test_a_height_scale_that_is_none_is_refused(tmp_path: Path, z_scale: float) -> None:
    with pytest.raises(MapError, match="Zscale"):
        sdf.read(put(tmp_path, sdf_binary(z_scale=z_scale)))


def test_heights_beyond_belief_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="marker of missing data"):
        sdf.read(put(tmp_path, sdf_ascii(z_scale=1e-9).replace(b"e-009", b"e+009")))


def test_torn_files_are_refused(tmp_path: Path) -> None:
    for size in (0, 5, 80, 300, len(sdf_binary()) - 1):
        with pytest.raises(MapError, match=r"map\.sdf"):
            sdf.read(put(tmp_path, sdf_binary()[:size]))


@pytest.mark.parametrize(("at", "value"), [(42, 65535), (44, 65535), (42, 0), (44, 1)])
def test_sizes_that_the_file_does_not_hold_are_refused(tmp_path: Path, at: int, value: int) -> None:
    content = bytearray(sdf_binary())
    struct.pack_into("<H", content, at, value)
    with pytest.raises(MapError):
        sdf.read(put(tmp_path, bytes(content)))


@pytest.mark.parametrize("text", [b"1.0e400", b"x", b"1 2"])
def test_text_that_is_no_height_is_refused(tmp_path: Path, text: bytes) -> None:
    content = sdf_ascii()
    at = content.rfind(b"e-0")
    start = content.rfind(b" ", 0, at) + 1
    broken = content[:start] + text + content[content.find(b" ", at) :]
    with pytest.raises(MapError):
        sdf.read(put(tmp_path, broken))


def test_only_its_own_magic_is_claimed() -> None:
    assert sdf.sniff(b"aISO-1.0", Path("a"))
    assert sdf.sniff(b"BBCR-1.0", Path("a"))
    assert not sdf.sniff(b"abc", Path("a.sdf"))


def test_a_preallocated_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="tail of zeros"):
        sdf.read(put(tmp_path, sdf_binary()[: -8 * 20] + bytes(8 * 20)))


@pytest.mark.parametrize("content", [sdf_binary(), sdf_ascii()], ids=["by hand", "ascii"])
def test_two_files_in_one_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(MapError, match="two were written into one"):
        sdf.read(put(tmp_path, content + content))


def test_samples_beyond_those_stated_are_refused(tmp_path: Path) -> None:
    assert sdf.read(put(tmp_path, sdf_binary() + b"a note\r\n*\r\n")).height_nm.shape == (ROWS, COLUMNS)
    content = bytearray(sdf_binary())
    struct.pack_into("<H", content, 42, COLUMNS - 1)
    with pytest.raises(MapError, match="more than its header asks for"):
        sdf.read(put(tmp_path, bytes(content)))
