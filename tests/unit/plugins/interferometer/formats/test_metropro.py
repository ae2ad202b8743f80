"""MetroPro files written and read back, their fiducials, and what other readers say of both."""

from __future__ import annotations

import struct
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.metropro import COUNT_NM, METROPRO, read, write
from polishd.process.metrology.instrument import same_system
from tests.unit.plugins.interferometer import map_files as make


def found(tmp_path: Path, content: bytes) -> SurfaceMap:
    path = tmp_path / "map.dat"
    path.write_bytes(content)
    return read(path)


SURFACE = SurfaceMap(
    make.HEIGHT_NM,
    0.25,
    part_id="Prüfling 7",
    taken_at=datetime.fromtimestamp(make.TAKEN_S, UTC),
    fiducials_px=((1.5, 2.0), (4.0, 6.25), (0.0, 7.0)),
)


def test_written_files_read_back_within_half_a_count(tmp_path: Path) -> None:
    again = found(tmp_path, write(SURFACE))
    np.testing.assert_allclose(again.height_nm, SURFACE.height_nm, atol=0.5001 * COUNT_NM)
    assert again.pitch_mm == pytest.approx(0.25, rel=1e-7)
    assert (again.part_id, again.taken_at) == (SURFACE.part_id, SURFACE.taken_at)
    assert again.fiducials_px == SURFACE.fiducials_px
    assert (again.unsaid, again.reader_version) == (frozenset(), 2)
    assert METROPRO.write is not None
    assert METROPRO.write(SURFACE) == write(SURFACE)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("Zygo MetroPro, system 62398", "Zygo MetroPro, system 62398"),
        ("Zygo, system 651365", "Zygo MetroPro, system 61541"),  # of a text, or .datx: .dat has 16 bits
        ("4D, system 20714", ""),
        ("", ""),
    ],
)
def test_the_system_is_a_zygo_s_or_none(tmp_path: Path, name: str, shown: str) -> None:
    content = write(replace(SURFACE, instrument=name))
    (number,) = struct.unpack_from(">H", content, 242)
    assert number == int(shown.rpartition(" ")[2] or 0)
    again = found(tmp_path, content)
    assert again.instrument == shown
    if shown:
        assert same_system(again.instrument, name)


def test_random_maps_read_back(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    for _ in range(20):
        height = random.normal(0, 10 ** random.uniform(-2, 5), random.integers(1, 40, 2))
        height[random.random(height.shape) < 0.3] = np.nan
        height[0, 0] = 1.0
        again = found(tmp_path, write(replace(SURFACE, height_nm=height, fiducials_px=())))
        np.testing.assert_allclose(again.height_nm, height, atol=0.5001 * COUNT_NM, rtol=1e-12)


def test_the_measured_file_written_again(shared_data: Path, tmp_path: Path) -> None:
    surface = read(shared_data / "zygo_metropro.dat")
    again = found(tmp_path, write(surface))
    np.testing.assert_array_equal(again.height_nm, surface.height_nm)
    assert again.pitch_mm == surface.pitch_mm
    assert again.taken_at == surface.taken_at


def test_as_prysm_reads_both(shared_data: Path, tmp_path: Path) -> None:
    prysm = pytest.importorskip("prysm.io")
    source = shared_data / "zygo_metropro.dat"
    surface = read(source)
    np.testing.assert_allclose(surface.height_nm, prysm.read_zygo_dat(source)["phase"], rtol=1e-9)
    ours = tmp_path / "ours.dat"
    ours.write_bytes(write(surface))
    theirs = prysm.read_zygo_dat(ours)
    np.testing.assert_allclose(theirs["phase"], surface.height_nm, rtol=1e-9)
    assert theirs["meta"]["lateral_resolution"] == pytest.approx((surface.pitch_mm or 0) / 1e3)


def test_without_pitch_and_time(tmp_path: Path) -> None:
    again = found(tmp_path, write(replace(SURFACE, pitch_mm=None, taken_at=None, unsaid=frozenset({"pitch"}))))
    assert (again.pitch_mm, set(again.unsaid), again.taken_at) == (None, {"pitch"}, None)


@pytest.mark.parametrize("word", ["unit", "surface", "orientation", "square pixels"])
def test_unstated_values_are_not_written(word: str) -> None:
    with pytest.raises(MapError, match=word.removesuffix(" pixels")):
        write(replace(SURFACE, unsaid=frozenset({word})))


def test_what_does_not_fit_is_not_written() -> None:
    with pytest.raises(MapError, match="heights beyond"):
        write(replace(SURFACE, height_nm=np.array([[6e6, 0.0]])))
    with pytest.raises(MapError, match="longer than"):
        write(replace(SURFACE, part_id="x" * 41))
    with pytest.raises(MapError, match="characters that"):
        write(replace(SURFACE, part_id="\N{GREEK SMALL LETTER ALPHA}"))
    with pytest.raises(MapError, match="exactly 0 nm"):
        write(replace(SURFACE, height_nm=np.array([[5.0, 1.0, 0.0, 0.0, 0.0, 0.0]])))
    with pytest.raises(MapError, match="do not fit"):
        write(replace(SURFACE, height_nm=np.zeros((1, 70_000))))


def test_fiducials_are_relative_to_the_phase(tmp_path: Path) -> None:
    marks = (2, 14.0, 9.5, 18.0, 12.0, *[0.0] * 10)
    surface = found(tmp_path, make.metropro(origin=(12, 7), fiducials=marks))
    assert surface.fiducials_px == ((2.5, 2.0), (5.0, 6.0))
    assert surface.warnings == ()


@pytest.mark.parametrize("marks", [(1, 99.0, 3.0), (1, float("nan"), 3.0), (7, -1.0, 2.0)])
def test_fiducials_outside_are_not_used(tmp_path: Path, marks: tuple[float, ...]) -> None:
    surface = found(tmp_path, make.metropro(fiducials=(*marks, *[0.0] * 12)))
    assert surface.fiducials_px == ()
    assert "fiducials" in surface.warnings[0]


@pytest.mark.parametrize("count", [0, -1, 8, 30_000])
def test_no_fiducials(tmp_path: Path, count: int) -> None:
    surface = found(tmp_path, make.metropro(fiducials=(count, *[3.0] * 14)))
    assert (surface.fiducials_px, surface.warnings) == ((), ())


@pytest.mark.parametrize(
    "fields",
    [
        {"sign": 1}, {"resolution": 0}, {"resolution": 1}, {"scale": 1.0}, {"obliquity": 1.5}, {"ac": (3, 2, 4)},
        {"magic": b"\x88\x1b\x03\x71"}, {"magic": b"\x88\x1b\x03\x70"}, {"wavelength": 1.064e-6}, {"camera_res": 0.0},
    ],
)  # fmt: skip
def test_the_same_map_in_every_variant(tmp_path: Path, fields: dict[str, Any]) -> None:
    surface = found(tmp_path, make.metropro(**fields))
    nm = abs(surface.factors["nm_per_count"])
    np.testing.assert_allclose(surface.height_nm, make.HEIGHT_NM, atol=0.5001 * nm)
    assert surface.unsaid == ({"pitch"} if fields == {"camera_res": 0.0} else frozenset())


@pytest.mark.parametrize("magic", [b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71"])
@pytest.mark.parametrize("length", [834, 4096])
def test_a_header_is_as_long_as_it_says(tmp_path: Path, magic: bytes, length: int) -> None:
    content = make.metropro(magic=magic)
    (usual,) = struct.unpack_from(">i", content, 6)
    head = bytearray(content[:usual].ljust(length, b"\0")[:length])
    struct.pack_into(">i", head, 6, length)
    surface = found(tmp_path, bytes(head) + content[usual:])
    np.testing.assert_allclose(surface.height_nm, make.HEIGHT_NM, atol=0.5001 * abs(surface.factors["nm_per_count"]))
