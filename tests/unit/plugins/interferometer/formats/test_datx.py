"""Reading Mx files: the measured one to all digits, every unit and version once, and every way to be broken."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.datx import DATX
from polishd.plugins.interferometer.formats.fourd import FOURD
from tests.unit.plugins.interferometer import map_files as make

Change = Callable[[h5py.File, h5py.Dataset], None]


def found(tmp_path: Path, content: bytes) -> SurfaceMap:
    path = tmp_path / "map.datx"
    path.write_bytes(content)
    return DATX.read(path)


def same(surface: SurfaceMap, expected: Any = make.HEIGHT_NM) -> None:
    np.testing.assert_allclose(surface.height_nm, expected, rtol=1e-12)


def unit(name: str) -> Change:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data.attrs["Unit"] = name

    return change


def without(*names: str) -> Change:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        for name in names:
            del data.attrs[name]

    return change


def given(name: str, value: Any) -> Change:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data.attrs[name] = value

    return change


def test_the_measured_file(shared_data: Path) -> None:
    surface = DATX.read(shared_data / "zygo_mx.datx")
    height = surface.height_nm
    assert height.shape == (259, 33)
    assert surface.taken_at is None, "its time is 719529 s: the days from the year 0 to 1970"
    assert surface.pitch_mm == pytest.approx(1.0, rel=1e-6)
    assert int(np.isnan(height).sum()) == 776
    assert float(np.nanmax(height) - np.nanmin(height)) == pytest.approx(453.030479, rel=1e-8)
    assert float(np.nanstd(height)) == pytest.approx(80.817653, rel=1e-8)
    assert (surface.instrument, surface.format) == ("Zygo GPI, system 651365", "datx")
    assert (surface.unsaid, surface.warnings) == (frozenset(), ())


def test_the_measured_file_as_prysm_reads_it(shared_data: Path) -> None:
    prysm = pytest.importorskip("prysm.io")
    theirs = prysm.read_zygo_datx(shared_data / "zygo_mx.datx")["phase"]
    np.testing.assert_allclose(DATX.read(shared_data / "zygo_mx.datx").height_nm, theirs, rtol=1e-9)


@pytest.mark.parametrize("cut", [1, 100, 4096, 60_000, 131_000])
def test_the_measured_file_torn(shared_data: Path, tmp_path: Path, cut: int) -> None:
    path = tmp_path / "torn.datx"
    path.write_bytes((shared_data / "zygo_mx.datx").read_bytes()[:-cut])
    assert DATX.sniff(path.read_bytes()[:4096], path)
    with pytest.raises(MapError, match=re.escape(str(path))):
        DATX.read(path)


def test_what_stands_in_a_file(tmp_path: Path) -> None:
    surface = found(tmp_path, make.datx())
    same(surface)
    assert surface.pitch_mm == pytest.approx(make.PITCH_MM)
    assert (surface.part_id, surface.instrument) == (make.PART, "Zygo GPI, system 651365")
    assert surface.taken_at == datetime.fromtimestamp(make.TAKEN_S, UTC)
    assert (surface.unsaid, surface.reader_version) == (frozenset(), 2)


@pytest.mark.parametrize(
    ("name", "nm"),
    [
        ("NanoMeters", 1.0), ("MicroMeters", 1e3), ("MilliMeters", 1e6), ("Meters", 1e9), ("Angstroms", 0.1),
        ("Waves", 632.8), ("Fringes", 316.4), ("MicroInches", 25.4), ("Inches", 2.54e7),
    ],
)  # fmt: skip
def test_each_unit_is_applied_once(tmp_path: Path, name: str, nm: float) -> None:
    surface = found(tmp_path, make.datx(nm=nm, change=unit(name)))
    same(surface)
    assert surface.unsaid == frozenset()
    assert surface.factors["nm_per_unit"] == pytest.approx(nm)


@pytest.mark.parametrize(
    ("attribute", "value"),
    [("Interferometric Scale Factor", 1.0), ("Obliquity Factor", 2.0), ("Wavelength", 1265.6e-9)],
)
def test_each_factor_is_applied_once(tmp_path: Path, attribute: str, value: float) -> None:
    same(found(tmp_path, make.datx(change=given(attribute, np.array([value])))), 2 * make.HEIGHT_NM)


@pytest.mark.parametrize("name", ["NoUnits", "Furlongs", "Radians"])
def test_an_unknown_unit_is_left_to_the_profile(tmp_path: Path, name: str) -> None:
    surface = found(tmp_path, make.datx(nm=1.0, change=unit(name)))
    same(surface)
    assert surface.unsaid == {"unit"}
    assert name in surface.warnings[0]


def test_no_unit_is_left_to_the_profile(tmp_path: Path) -> None:
    assert found(tmp_path, make.datx(nm=1.0, change=without("Unit"))).unsaid == {"unit"}


@pytest.mark.parametrize("marker", [np.nan, 1.7e308, -1.7e308, 3e38, np.inf, 2147483640.0, 2147483647.0])
def test_no_data_may_be_absent(tmp_path: Path, marker: float) -> None:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        del data.attrs["No Data"]
        data[0, 0] = data[5, 1] = marker

    same(found(tmp_path, make.datx(change=change)))


@pytest.mark.parametrize("marker", [-999.0, 2147483640.0, 0.0])
def test_no_data_may_be_an_ordinary_number(tmp_path: Path, marker: float) -> None:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data.attrs["No Data"] = marker
        data[0, 0] = data[5, 1] = marker

    same(found(tmp_path, make.datx(change=change)))


def test_the_z_converter_stands_in_for_missing_optics(tmp_path: Path) -> None:
    names = ("Wavelength", "Interferometric Scale Factor", "Obliquity Factor")
    same(found(tmp_path, make.datx(change=without(*names))))
    with pytest.raises(MapError, match="does not say its"):
        found(tmp_path, make.datx(change=without("Z Converter", "Wavelength")))


def test_without_lateral_scale(tmp_path: Path) -> None:
    surface = found(tmp_path, make.datx(change=without("X Converter", "Y Converter")))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})
    zero = make.converter("LateralCat", "Pixels", 0.0, 0.0, 0.0, 0.0)

    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data.attrs["X Converter"] = data.attrs["Y Converter"] = zero

    assert found(tmp_path, make.datx(change=change)).unsaid == {"pitch"}


def test_converters_of_another_version(tmp_path: Path) -> None:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data.attrs["X Converter"] = data.attrs["Y Converter"] = np.array([0.0, make.PITCH_MM / 1e3, 0.0, 0.0])

    assert found(tmp_path, make.datx(change=change)).pitch_mm == pytest.approx(make.PITCH_MM)


def test_pixels_that_are_not_square(tmp_path: Path) -> None:
    tall = make.converter("LateralCat", "Pixels", 0.0, 3 * make.PITCH_MM / 1e3, 0.0, 0.0)
    surface = found(tmp_path, make.datx(change=given("Y Converter", tall)))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"square pixels"})


def test_an_older_file_without_links(tmp_path: Path) -> None:
    def change(file: h5py.File, data: h5py.Dataset) -> None:
        file["Measurement/Surface"] = data
        del file["MetaData"]

    same(found(tmp_path, make.datx(change=change)))


@pytest.mark.parametrize("how", [{"dtype": "f4"}, {"chunks": (3, 3), "compression": "gzip"}, {"dtype": ">f8"}])
def test_other_storage(tmp_path: Path, how: dict[str, Any]) -> None:
    with np.errstate(over="ignore"):
        surface = found(tmp_path, make.datx(**how))
    np.testing.assert_allclose(surface.height_nm, make.HEIGHT_NM, rtol=1e-6)


def soft(file: h5py.File, _: h5py.Dataset) -> None:
    file["kept"] = file[f"/Data/Surface/{make.GUID}"]
    del file[f"/Data/Surface/{make.GUID}"]
    file[f"/Data/Surface/{make.GUID}"] = h5py.SoftLink("/kept")


def external(file: h5py.File, _: h5py.Dataset) -> None:
    del file["Data"]
    file["Data"] = h5py.ExternalLink("/etc/hostname", "/Data")


def external_samples(file: h5py.File, _: h5py.Dataset) -> None:
    del file["Data"]
    file.create_dataset(f"/Data/Surface/{make.GUID}", (6, 8), "f8", external=[("/etc/hostname", 0, 384)])


def virtual(file: h5py.File, _: h5py.Dataset) -> None:
    del file["Data"]
    layout = h5py.VirtualLayout((6, 8), "f8")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "x", (6, 8))
    file.create_virtual_dataset(f"/Data/Surface/{make.GUID}", layout)


def instead(**how: Any) -> Change:
    def change(file: h5py.File, _: h5py.Dataset) -> None:
        del file["Data"]
        file.create_dataset(f"/Data/Surface/{make.GUID}", **how)

    return change


def zero_tail(_: h5py.File, data: h5py.Dataset) -> None:
    data[3:] = 0.0


def not_a_table(file: h5py.File, _: h5py.Dataset) -> None:
    del file["MetaData"]
    file["MetaData"] = np.arange(5)


BROKEN: dict[str, tuple[Change, str]] = {
    "soft link": (soft, "SoftLink"),
    "link to another file": (external, "ExternalLink"),
    "samples in another file": (external_samples, "other files"),
    "virtual": (virtual, "other files|longer than the file"),
    "no surface": (lambda file, _: file.pop("Data"), "is missing"),
    "no table": (not_a_table, "no table"),
    "text": (instead(data=np.full((6, 8), b"x")), "no array of numbers"),
    "complex": (instead(data=np.ones((6, 8), complex)), "no array of numbers"),
    "one dimension": (instead(data=np.ones(48)), "no array of numbers"),
    "three dimensions": (instead(data=np.ones((6, 8, 1))), "no array of numbers"),
    "empty": (instead(shape=(0, 8), dtype="f8"), "no phase data"),
    "never written": (instead(shape=(6, 8), dtype="f8"), "not written to its end"),
    "chunks never written": (instead(shape=(60, 80), dtype="f8", chunks=(10, 10)), "not written to its end"),
    "bomb": (instead(data=np.zeros((1500, 1500)), chunks=True, compression="gzip"), "unpack to more than"),
    "larger than a camera": (instead(shape=(90_000, 90_000), dtype="f8", chunks=True), "no interferometer's camera"),
    "chunk larger than all": (instead(shape=(6, 8), maxshape=(None, None), chunks=(9000, 9000), dtype="f8"), "unpack"),
    "preallocated": (zero_tail, "tail of zeros"),
    "no data at all": (lambda _, data: data.write_direct(np.full((6, 8), make.NO_DATA)), "no sample"),
    "wavelength 0": (given("Wavelength", 0.0), "Wavelength"),
    "wavelength NaN": (given("Wavelength", np.nan), "Wavelength"),
    "wavelength in nm": (given("Wavelength", 632.8), "Wavelength"),
    "scale infinite": (given("Interferometric Scale Factor", np.inf), "IntfScaleFactor"),
    "scale negative": (given("Interferometric Scale Factor", -0.5), "IntfScaleFactor"),
    "obliquity 0": (given("Obliquity Factor", 0.0), "Obliquity"),
    "obliquity is text": (given("Obliquity Factor", "one"), "not a number"),
    "pitch NaN": (given("X Converter", make.converter("LateralCat", "Pixels", 0.0, np.nan, 0, 0)), "pitch in x"),
    "huge attribute": (given("Unit", np.zeros(7000)), "does not|larger than|not known"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken(tmp_path: Path, case: str) -> None:
    change, reason = BROKEN[case]
    if case == "huge attribute":
        assert found(tmp_path, make.datx(change=change)).unsaid == {"unit"}
        return
    with pytest.raises(MapError, match=reason) as caught:
        found(tmp_path, make.datx(change=change))
    assert str(caught.value).startswith(f"{tmp_path / 'map.datx'}: ")


@pytest.mark.parametrize(
    "links",
    [
        [("Root", "Attributes", "/x")],
        [("Root", "Measurement", "{A}"), ("{A}", "Surface", "{B}")],
        [("Root", "Measurement", "{A}"), ("{A}", "Surface", "{B}"), ("{B}", "Path", "/Data/elsewhere")],
        [("Root", "Measurement", "Root"), ("Root", "Surface", "Root"), ("Root", "Path", "/Data")],
    ],
)
def test_links_that_lead_nowhere(tmp_path: Path, links: list[tuple[str, str, str]]) -> None:
    with pytest.raises(MapError, match=r"leads to no surface|is missing|no array"):
        found(tmp_path, make.datx(links=links))


def test_a_heap_that_hdf5_would_walk_for_ever(tmp_path: Path) -> None:
    content = bytearray(make.datx())
    at = content.find(b"GCOL") + 16
    assert at > 16
    struct.pack_into("<HHIQ", content, at, 0, 0, 0, 0)
    with pytest.raises(MapError, match="heap"):
        found(tmp_path, bytes(content))


@pytest.mark.parametrize("content", [b"", b"hello" * 900, b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + bytes(5000)])
def test_no_hdf5_at_all(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(MapError, match=r"empty|no HDF5|cannot read it|not HDF5"):
        found(tmp_path, content)


def test_trailing_bytes_change_nothing(tmp_path: Path) -> None:
    same(found(tmp_path, make.datx() + b"junk" * 50))


def test_the_two_hdf5_formats_are_distinguished(tmp_path: Path) -> None:
    for name, content, is_datx in (("a.h5", make.datx(), True), ("b.datx", make.fourd(), False)):
        path = tmp_path / name
        path.write_bytes(content)
        assert DATX.sniff(content[:4096], path) is is_datx
        assert FOURD.sniff(content[:4096], path) is not is_datx
    assert not DATX.sniff(b"text", Path("a.datx"))


def test_written_files_read_back_exactly(tmp_path: Path) -> None:
    assert DATX.write is not None
    surface = found(tmp_path, make.datx())
    content = DATX.write(surface)
    again = found(tmp_path, content)
    np.testing.assert_array_equal(again.height_nm, surface.height_nm)
    for name in ("pitch_mm", "part_id", "taken_at", "unsaid"):
        assert getattr(again, name) == getattr(surface, name), name
    assert DATX.write(surface) == content
    flat = replace(surface, pitch_mm=None, unsaid=frozenset({"pitch"}), taken_at=None, part_id="Prüfling 7")
    again = found(tmp_path, DATX.write(flat))
    assert (again.pitch_mm, set(again.unsaid), again.taken_at, again.part_id) == (None, {"pitch"}, None, "Prüfling 7")


def test_written_files_are_read_by_prysm(tmp_path: Path) -> None:
    prysm = pytest.importorskip("prysm.io")
    assert DATX.write is not None
    path = tmp_path / "ours.datx"
    path.write_bytes(DATX.write(found(tmp_path, make.datx())))
    np.testing.assert_allclose(prysm.read_zygo_datx(path)["phase"], make.HEIGHT_NM, rtol=1e-12)


def test_unstated_values_are_not_written(tmp_path: Path) -> None:
    assert DATX.write is not None
    surface = found(tmp_path, make.datx(change=unit("Furlongs")))
    with pytest.raises(MapError, match="unit"):
        DATX.write(surface)


def test_a_lateral_converter_in_another_unit_is_no_pitch(tmp_path: Path) -> None:
    lateral = make.converter("LateralCat", "MilliMeters", 0.0, make.PITCH_MM, 0.0, 0.0)
    surface = found(tmp_path, make.datx(change=given("X Converter", lateral)))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})
    assert "'MilliMeters' a pixel" in surface.warnings[0]


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_one_converter_is_no_pitch(tmp_path: Path, axis: str) -> None:
    assert found(tmp_path, make.datx(change=without(f"{axis} Converter"))).unsaid == {"pitch"}


FRAME = np.array([(0, 0, 6, 8)], dtype=[(name, "<i4") for name in ("RowStart", "ColumnStart", "Width", "Height")])


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (
            "Z Converter",
            make.converter("HeightCat", "Fringes", 0.0, make.WAVELENGTH_M, 1.0, 1.0),
            "0.5, and 1",
        ),
        (
            "Z Converter",
            make.converter("HeightCat", "NanoMeters", 0.0, make.WAVELENGTH_M, 0.5, 1.0),
            "in Nano",
        ),
        ("Coordinates", FRAME, r"a frame of \(8, 6\)"),
    ],
)
def test_attributes_that_contradict_one_another(tmp_path: Path, name: str, value: Any, said: str) -> None:
    surface = found(tmp_path, make.datx(change=given(name, value)))
    same(surface)
    assert re.search(said, surface.warnings[0])


def test_two_surfaces_are_refused(tmp_path: Path) -> None:
    links = [
        ("Root", "Measurement", make.MEASUREMENT), (make.MEASUREMENT, "Surface", make.GUID),
        (make.MEASUREMENT, "Surface", "{another}"), (make.GUID, "Path", f"/Data/Surface/{make.GUID}"),
    ]  # fmt: skip
    with pytest.raises(MapError, match="two of 'Surface'"):
        found(tmp_path, make.datx(links=links))


def test_two_files_in_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="two were written into one"):
        found(tmp_path, make.datx() + make.datx())


def test_samples_beyond_the_stated_shape_are_refused(tmp_path: Path) -> None:
    content = make.datx()
    shape = struct.pack("<2Q", make.ROWS, make.COLUMNS)
    assert content.count(shape) >= 1
    with pytest.raises(MapError, match=r"384 bytes of .*, and its shape has 336: broken"):
        found(tmp_path, content.replace(shape, struct.pack("<2Q", make.ROWS, make.COLUMNS - 1)))
