"""Reading MetroPro files: the measured one to all digits, the agreed vector, and every way to be broken."""

from __future__ import annotations

import hashlib
import re
import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import MapError
from polishd.plugins.interferometer.formats.metropro import METROPRO, read
from tests.memory import peak_bytes

PROTOCOL = Path(__file__).resolve().parents[4] / "docs" / "protocols" / "metropro_dat.md"
MISSING = 0x7FFFFFF8
FIELDS = {
    "magic": (0, "4s"), "format": (4, ">h"), "length": (6, ">i"), "software": (10, ">h"), "date": (12, "30s"),
    "version": (42, ">3h"), "ac": (52, ">3H"), "size": (68, ">2H"), "bytes": (72, ">i"), "time": (76, ">i"),
    "comment": (80, "82s"), "scale": (164, ">f"), "wavelength": (168, ">f"), "obliquity": (176, ">f"),
    "camera_res": (184, ">f"), "resolution": (218, ">h"), "sign": (232, ">h"), "camera": (234, ">2h"),
    "objective": (246, "12s"), "part": (258, "40s"), "serial": (320, "40s"),
}  # fmt: skip


def dat(counts: list[list[int]], *, tail: bytes = b"", **fields: object) -> bytes:
    """A file with these counts; ``fields`` override the header's."""
    array = np.array(counts, dtype=">i4")
    rows, columns = array.shape
    length = 4096 if fields.get("magic") == b"\x88\x1b\x03\x71" else 834
    header = bytearray(length)
    values: dict[str, object] = {
        "magic": b"\x88\x1b\x03\x6f", "format": 1, "length": length, "software": 1,
        "date": b"Thu Jan 01 00:00:00 1970", "version": (8, 3, 5), "size": (columns, rows), "bytes": array.nbytes,
        "time": 1_700_000_000, "comment": b"vector", "scale": 0.5, "wavelength": 6.328e-7, "obliquity": 1.0,
        "camera_res": 5e-4, "resolution": 2, "camera": (columns, rows), "objective": b"sim", "part": b"DEMO-100",
        "serial": b"DEMO-100",
    } | fields  # fmt: skip
    for name, value in values.items():
        offset, code = FIELDS[name]
        struct.pack_into(code, header, offset, *(value if isinstance(value, tuple) else (value,)))
    buckets = values.get("ac", (0, 0, 0))
    assert isinstance(buckets, tuple)
    return bytes(header) + b"\x01" * (2 * buckets[0] * buckets[1] * buckets[2]) + array.tobytes() + tail


VECTOR = [[1000, -1000], [MISSING, 0]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.dat"


def test_the_measured_file(shared_data: Path) -> None:
    found = read(shared_data / "zygo_metropro.dat")
    height = found.height_nm
    assert height.shape == (432, 425)
    assert found.pitch_mm == pytest.approx(0.1179242, rel=1e-6)
    assert int(np.isnan(height).sum()) == 47_241
    assert float(np.nanmax(height) - np.nanmin(height)) == pytest.approx(330.700173, rel=1e-8)
    assert float(np.nanstd(height)) == pytest.approx(44.591409, rel=1e-8)
    assert (found.part_id, found.format, found.warnings) == ("", "metropro", ())
    assert found.taken_at == datetime(2015, 4, 24, 19, 54, 52, tzinfo=UTC)


@pytest.mark.parametrize("cut", [1, 3, 4, 4000, 700_000, 1_349_000])
def test_the_measured_file_torn(shared_data: Path, path: Path, cut: int) -> None:
    content = (shared_data / "zygo_metropro.dat").read_bytes()
    path.write_bytes(content[:-cut])
    with pytest.raises(MapError, match=re.escape(str(path))):
        read(path)
    path.write_bytes(content[: -(cut + 20)] + bytes(cut + 20))
    with pytest.raises(MapError, match=r"tail of zeros|Wavelength|PhaseRes|IntfScale|phase data|bytes"):
        read(path)


def test_the_agreed_vector(path: Path) -> None:
    content = dat(VECTOR)
    vector = dict(line.split() for line in PROTOCOL.read_text().partition("```vectors\n")[2].splitlines()[:2])
    assert content[834:].hex() == vector["phase"]
    assert len(content) == int(vector["length"])
    path.write_bytes(content)
    found = read(path)
    nm = 0.5 * float(np.float32(6.328e-7)) / 131072 * 1e9
    np.testing.assert_allclose(found.height_nm, [[1000 * nm, -1000 * nm], [np.nan, 0]], rtol=1e-12)
    assert found.pitch_mm == pytest.approx(0.5, rel=1e-7)
    assert (found.part_id, found.path) == ("DEMO-100", path)
    assert found.taken_at == datetime.fromtimestamp(1_700_000_000, UTC)
    assert found.sha256 == hashlib.sha256(content).hexdigest()
    stated = re.search(r"^sha256 ([0-9a-f]{64})$", PROTOCOL.read_text(), re.MULTILINE)
    assert stated is None or stated[1] == found.sha256


@pytest.mark.parametrize(
    ("fields", "factor"),
    [
        ({"sign": 1}, -1.0),
        ({"sign": -1}, -1.0),
        ({"resolution": 1}, 4.0),
        ({"resolution": 0}, 32.0),
        ({"scale": 1.0}, 2.0),
        ({"obliquity": 2.0}, 2.0),
        ({"magic": b"\x88\x1b\x03\x70"}, 1.0),
        ({"magic": b"\x88\x1b\x03\x71"}, 1.0),
        ({"ac": (3, 2, 4)}, 1.0),
    ],
)
def test_each_factor_is_applied_once(path: Path, fields: dict[str, object], factor: float) -> None:
    path.write_bytes(dat(VECTOR, **fields))
    found = read(path)
    assert found.height_nm[0, 0] == pytest.approx(1000 * 0.5 * 632.8 / 131072 * factor, rel=1e-6)
    assert found.factors["nm_per_count"] == pytest.approx(0.5 * 632.8 / 131072 * factor, rel=1e-6)


@pytest.mark.parametrize(
    ("part", "serial", "expected"),
    [
        (b"A", b"B", "B"),
        (b"A", b"", "A"),
        (b"", b"", ""),
        (b" A \0junk", b"  ", "A"),
        (b"x" * 40, b"", "x" * 40),
        (b"A", b'""', "A"),
        (b"' '", b'" "', ""),
        (b'5" flat', b"", '5" flat'),
    ],
)
def test_part_id(path: Path, part: bytes, serial: bytes, expected: str) -> None:
    path.write_bytes(dat(VECTOR, part=part, serial=serial))
    assert read(path).part_id == expected


def test_without_lateral_scale_it_warns(path: Path) -> None:
    path.write_bytes(dat(VECTOR, camera_res=0.0))
    found = read(path)
    assert found.pitch_mm is None
    assert "CameraRes" in found.warnings[0]


def test_without_timestamp(path: Path) -> None:
    path.write_bytes(dat(VECTOR, time=0))
    assert read(path).taken_at is None


BROKEN = {
    "empty": (b"", "empty"),
    "other magic": (b"\x88\x1b\x03\x72" + bytes(2000), "no MetroPro file"),
    "text": (b"hello" * 500, "no MetroPro file"),
    "torn in the header": (dat(VECTOR)[:500], "ends inside its header"),
    "torn in the phase": (dat(VECTOR)[:-1], "849 bytes of 850"),
    "one byte more": (dat(VECTOR, tail=b"\0"), "851 bytes of 850"),
    "preallocated": (dat([[5, 6, 7], [8, 9, 0], [0, 0, 0]]), "tail of zeros"),
    "all zeros": (dat([[0] * 5] * 5), "tail of zeros"),
    "zeros all over": (bytes(5000), "no MetroPro file"),
    "no data": (dat([[MISSING] * 2] * 2), "no sample"),
    "no rows": (dat(VECTOR, size=(2, 0)), "no phase data"),
    "huge": (dat(VECTOR, size=(65535, 65535)), "no interferometer's camera"),
    "huge intensities": (dat(VECTOR)[:52] + b"\xff" * 6 + dat(VECTOR)[58:], "its header asks for"),
    "larger than it is": (dat(VECTOR, size=(2000, 2000)), "of 16000834"),
    "header length": (dat(VECTOR, length=835), "header of 835"),
    "header length of another version": (dat(VECTOR, length=4096), "header of 4096"),
    "resolution": (dat(VECTOR, resolution=3), "PhaseRes is 3"),
    "wavelength zero": (dat(VECTOR, wavelength=0.0), "Wavelength"),
    "wavelength in nm": (dat(VECTOR, wavelength=632.8), "Wavelength"),
    "wavelength NaN": (dat(VECTOR, wavelength=float("nan")), "Wavelength"),
    "scale negative": (dat(VECTOR, scale=-0.5), "IntfScaleFactor"),
    "obliquity infinite": (dat(VECTOR, obliquity=float("inf")), "Obliquity"),
    "pitch NaN": (dat(VECTOR, camera_res=float("nan")), "CameraRes"),
    "pitch negative": (dat(VECTOR, camera_res=-1e-4), "CameraRes"),
    "pitch absurd": (dat(VECTOR, camera_res=5.0), "CameraRes"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken(path: Path, case: str) -> None:
    content, reason = BROKEN[case]
    path.write_bytes(content)
    with pytest.raises(MapError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert reason in str(caught.value)


def test_a_file_that_is_gone_or_a_folder(path: Path, tmp_path: Path) -> None:
    for wrong in (path, tmp_path):
        with pytest.raises(MapError, match="cannot be read"):
            read(wrong)


def test_no_more_is_allocated_than_the_file_warrants(path: Path) -> None:
    content = dat([[1000] * 400] * 400)
    path.write_bytes(content)
    assert peak_bytes(lambda: read(path), 4 * len(content)) < 4 * len(content)
    path.write_bytes(dat([[1000] * 400] * 400, size=(8000, 8000)))

    def refused() -> None:
        with pytest.raises(MapError):
            read(path)

    assert peak_bytes(refused, 3 * len(content)) < 3 * len(content)


def test_sniff() -> None:
    assert METROPRO.name == "metropro"
    assert METROPRO.sniff(dat(VECTOR), Path("a.xyz"))
    assert not METROPRO.sniff(b"", Path("a.dat"))
    assert not METROPRO.sniff(b"\x88\x1b\x03", Path("a.dat"))


@given(st.integers(0, 849), st.binary(min_size=1, max_size=8), st.booleans())
def test_mutated_files_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, at: int, junk: bytes, cut: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.dat"
    content = bytearray(dat(VECTOR))
    content[at : at + len(junk)] = junk
    path.write_bytes(content[: at + 1] if cut else content)
    try:
        found = read(path)
    except MapError as error:
        assert str(path) in str(error)  # noqa: PT017  it may also be read
    else:
        assert np.isfinite(found.height_nm[found.valid]).all()
        assert found.pitch_mm is None or found.pitch_mm > 0
