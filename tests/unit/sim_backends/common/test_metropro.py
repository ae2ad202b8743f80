"""The instrument's writer against the documented layout, and the small reader against it and the real file."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.sim_backends.common.metropro import HEADER, UNIT_NM, DatMap, pack, read, unpack
from tests.unit.sim_backends.vectors import vectors


def small() -> bytes:
    height = np.array([[1000.0, -1000.0], [np.nan, 0.0]]) * UNIT_NM
    return pack(DatMap(height, 0.5, "DEMO-100", 1700000000, "vector", "sim"))


def test_the_documented_vector() -> None:
    expected = vectors("metropro_dat")
    data = small()
    assert data[HEADER:].hex() == expected["phase"]
    assert len(data) == int(expected["length"])
    assert hashlib.sha256(data).hexdigest() == expected["sha256"]


def test_the_header_where_the_page_says_it_is() -> None:
    data = small()
    assert data[:4].hex() == "881b036f"
    assert struct.unpack_from(">hi", data, 4) == (1, 834)
    assert struct.unpack_from(">hhhhhhi", data, 48) == (0, 0, 0, 0, 0, 0, 0)
    assert struct.unpack_from(">hhhhi", data, 64) == (0, 0, 2, 2, 16)
    assert struct.unpack_from(">i", data, 76) == (1700000000,)
    assert data[80:86] == b"vector"
    assert struct.unpack_from(">f", data, 164) == (0.5,)
    assert struct.unpack_from(">f", data, 184)[0] == pytest.approx(5e-4)
    assert struct.unpack_from(">h", data, 218) == (2,)
    assert struct.unpack_from(">h", data, 232) == (0,)
    assert data[258:298].rstrip(b"\0") == b"DEMO-100"
    assert data[320:360].rstrip(b"\0") == b"DEMO-100"


def test_round_trip() -> None:
    rng = np.random.default_rng(5)
    height = rng.normal(0.0, 50.0, (30, 41))
    height[3:6, 7] = np.nan
    back = unpack(pack(DatMap(height, 0.5, "P1", 1234567890, "hello", origin_px=(3, 4))))
    assert np.array_equal(np.isnan(back.height_nm), np.isnan(height))
    assert np.nanmax(np.abs(back.height_nm - height)) <= UNIT_NM / 2 + 1e-9
    assert (back.part, back.taken_s, back.comment, back.origin_px) == ("P1", 1234567890, "hello", (3, 4))
    assert back.pitch_mm == pytest.approx(0.5)


@pytest.mark.parametrize("size", [0, 3, 100, 833, 834, 849, 851])
def test_a_file_of_the_wrong_length_is_refused(size: int) -> None:
    data = (small() + b"\0")[:size]
    with pytest.raises(MapError):
        unpack(data)


def test_sign_and_resolution_are_applied() -> None:
    data = bytearray(small())
    struct.pack_into(">h", data, 232, 1)
    struct.pack_into(">h", data, 218, 0)
    assert unpack(bytes(data)).height_nm[0, 0] == pytest.approx(-1000.0 * UNIT_NM * 32, rel=1e-6)
    struct.pack_into(">h", data, 218, 7)
    with pytest.raises(MapError, match="resolution"):
        unpack(bytes(data))


def test_the_shared_file(shared_data: Path) -> None:
    data = read(shared_data / "zygo_metropro.dat")
    valid = data.height_nm[np.isfinite(data.height_nm)]
    assert data.height_nm.shape == (432, 425)
    assert data.pitch_mm == pytest.approx(0.1179242, rel=1e-6)
    assert data.origin_px == (139, 38)
    assert data.part == ""
    assert np.ptp(valid) == pytest.approx(330.700173, rel=1e-6)
    assert valid.std() == pytest.approx(44.591409, rel=1e-6)
