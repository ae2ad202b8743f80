"""X3P: what x3pio writes and DigitalSurf wrote, and broken archives."""

from __future__ import annotations

import io
import re
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import x3pio

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats import common, x3p
from tests.unit.plugins.interferometer.map_files_other import HOLES, PITCH_MM, heights_nm, unzipped, x3p_file, zipped


def put(folder: Path, content: bytes) -> Path:
    path = folder / "map.x3p"
    path.write_bytes(content)
    return path


def edited(old: str, new: str) -> bytes:
    """The example with something else in main.xml, its checksum left out."""
    members = unzipped(x3p_file())
    members.pop("md5checksum.hex")
    text = members["main.xml"].decode()
    assert re.search(old, text)
    members["main.xml"] = re.sub(old, new, text).encode()
    return zipped(members)


def test_the_shared_file_is_read_exactly(shared_data: Path) -> None:
    surface = x3p.read(shared_data / "profilometer.x3p")
    z = surface.height_nm
    assert z.shape == (650, 650)
    assert np.isnan(z).sum() == 0
    assert np.ptp(z) == pytest.approx(554.336200, rel=1e-6)
    assert z.std() == pytest.approx(77.280333, rel=1e-6)


def test_pixels_that_are_not_square_have_no_pitch_and_no_profile_mends_it(shared_data: Path) -> None:
    surface = x3p.read(shared_data / "profilometer.x3p")
    assert surface.pitch_mm is None
    assert surface.unsaid == {"square pixels"}
    assert "0.000127657 mm wide and 0.000314582 mm high" in surface.warnings[0]


@pytest.mark.parametrize("storage", x3pio.DataStorage)
def test_heights_come_back_the_right_way_up(tmp_path: Path, storage: x3pio.DataStorage) -> None:
    surface = x3p.read(put(tmp_path, x3p_file(storage=storage)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-10)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)
    assert not surface.unsaid
    assert "upside down" in surface.orientation
    assert surface.reader_version == x3p.FORMAT.version


def test_rows_lie_where_the_library_puts_them(tmp_path: Path) -> None:
    path = put(tmp_path, x3p_file())
    points = x3pio.read(path).layers[0].points().reshape(-1, 3)
    top = points[points[:, 1] == points[:, 1].max()]
    np.testing.assert_allclose(x3p.read(path).height_nm[0], top[np.argsort(top[:, 0]), 2] * 1e9, atol=1e-10)


def test_integers_are_scaled_and_their_validity_file_is_the_mask(tmp_path: Path) -> None:
    surface = x3p.read(put(tmp_path, x3p_file(z_type=x3pio.DataType.INT16)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=0.01)
    assert all(np.isnan(surface.height_nm[place]) for place in HOLES)


def test_written_and_read_is_the_same_map(tmp_path: Path) -> None:
    taken = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
    surface = SurfaceMap(heights_nm(), PITCH_MM, part_id="M1", instrument="Verifire", taken_at=taken)
    path = put(tmp_path, x3p.write(surface))
    back = x3p.read(path)
    np.testing.assert_allclose(back.height_nm, surface.height_nm, rtol=1e-15)
    assert (back.pitch_mm, back.instrument, back.taken_at) == (PITCH_MM, "Verifire", taken)
    metadata = x3pio.read(path).metadata
    assert metadata is not None
    assert metadata.comment == "part M1"


def test_what_others_stumble_over_is_not_written(tmp_path: Path) -> None:
    path = put(tmp_path, x3p.write(SurfaceMap(heights_nm(), PITCH_MM)))
    back = x3p.read(path)
    assert (back.taken_at, back.instrument) == (None, "")
    text = unzipped(path.read_bytes())["main.xml"].decode()
    assert "<Revision>ISO5436 - 2000</Revision>" in text
    assert re.search("<(Manufacturer|Model|Serial|Version)></|<(Manufacturer|Model|Serial|Version)/>", text) is None


@pytest.mark.parametrize("unsaid", [{"unit"}, {"surface"}, {"orientation"}])
def test_unknown_values_are_not_written(unsaid: set[str]) -> None:
    with pytest.raises(MapError, match=unsaid.copy().pop()):
        x3p.write(SurfaceMap(heights_nm(), PITCH_MM, unsaid=frozenset(unsaid)))


def test_a_map_without_a_pitch_is_not_written() -> None:
    with pytest.raises(MapError, match="lateral scale"):
        x3p.write(SurfaceMap(heights_nm(), None, unsaid=frozenset({"pitch"})))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<SizeX>7<", "<SizeX>8<", "504 bytes"),
        ("<SizeX>7<", "<SizeX>70000000000<", "no interferometer's camera"),
        ("<SizeZ>1<", "<SizeZ>2<", "504 bytes"),
        ("<Increment>0.000125<", "<Increment>-0.000125<", "pitch in"),
        ("<Increment>0.000125<", "<Increment>inf<", "finite"),
        (r"<MD5ChecksumPointData>[0-9a-f]{32}", "<MD5ChecksumPointData>" + "0" * 32, "MD5"),
        (r"\?>", '?><!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]>', "[Ee]ntit"),
        ("</Record1>", "", "XML"),
    ],
)
def test_a_broken_description_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(MapError, match=said):
        x3p.read(put(tmp_path, edited(old, new)))


def test_a_rotated_placement_leaves_the_orientation_open(tmp_path: Path) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    options = {"placement": x3pio.Placement(rotation=turn), "coordinate_system": x3pio.CoordinateSystem.VIEW}
    surface = x3p.read(put(tmp_path, x3p_file(**options)))
    assert surface.unsaid == {"orientation"}
    assert surface.warnings == (x3p.ROTATED,)


def test_a_file_changed_after_it_was_written_is_refused(tmp_path: Path) -> None:
    members = unzipped(x3p_file())
    data = bytearray(members["bindata/data.bin"])
    data[8] ^= 1
    with pytest.raises(MapError, match="MD5"):
        x3p.read(put(tmp_path, zipped(members | {"bindata/data.bin": bytes(data)})))


def test_a_torn_archive_is_refused(tmp_path: Path) -> None:
    for size in (0, 3, 100, len(x3p_file()) - 30):
        with pytest.raises(MapError, match=r"map\.x3p"):
            x3p.read(put(tmp_path, x3p_file()[:size]))


def test_what_unpacks_to_more_than_any_map_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", bytes(10_000))
    monkeypatch.setattr(common, "MOST_BYTES", 1000)
    with pytest.raises(MapError, match="unpacks to more than 1000"):
        x3p.read(put(tmp_path, bomb.getvalue()))


def test_only_archives_of_that_name_are_claimed() -> None:
    head = x3p_file()[:64]
    assert x3p.sniff(head, Path("a.X3P"))
    assert x3p.sniff(head, Path("a.zip"))  # main.xml comes first
    assert not x3p.sniff(b"PK\x03\x04" + bytes(60), Path("a.npz"))
    assert not x3p.sniff(b"GRD 2 2", Path("a.x3p"))
