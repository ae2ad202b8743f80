"""Reading 4D files: the wedge once, missing samples, and every way to be broken."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap
from polishd.model.instrument import Instrument
from polishd.plugins.interferometer.formats.fourd import FOURD
from polishd.process.metrology.instrument import apply_profile
from tests.unit.plugins.interferometer import map_files as make

Change = Callable[[h5py.File, h5py.Dataset], None]


def found(tmp_path: Path, content: bytes) -> SurfaceMap:
    path = tmp_path / "map.h5"
    path.write_bytes(content)
    return FOURD.read(path)


def given(name: str, value: Any) -> Change:
    """Set an attribute of genraw, or remove it (None)."""

    def change(_: h5py.File, data: h5py.Dataset) -> None:
        if value is None:
            del data.parent.attrs[name]
        else:
            data.parent.attrs[name] = value

    return change


def same(surface: SurfaceMap, factor: float = 1.0) -> None:
    np.testing.assert_allclose(surface.height_nm, factor * make.HEIGHT_NM, rtol=2e-7)


def test_what_stands_in_a_file(tmp_path: Path) -> None:
    surface = found(tmp_path, make.fourd())
    same(surface)
    assert surface.pitch_mm == pytest.approx(make.PITCH_MM)
    assert (surface.format, surface.unsaid, surface.warnings) == ("4d", frozenset(), ())
    assert surface.factors == {"wavelength_nm": pytest.approx(632.8), "wedge": 0.5}
    assert surface.fiducials_px == ()


@pytest.mark.parametrize("wedge", ["0.5", "1.0", "0.500000 ", "1"])
def test_the_wedge_is_applied_once(tmp_path: Path, wedge: str) -> None:
    same(found(tmp_path, make.fourd(wedge=wedge)))
    same(found(tmp_path, make.fourd(change=given("wedge", np.bytes_(wedge)))), 2 * float(wedge))


def test_a_wedge_may_be_a_number(tmp_path: Path) -> None:
    same(found(tmp_path, make.fourd(change=given("wedge", 1.0))), 2.0)


def test_without_wedge_it_may_be_a_wavefront(tmp_path: Path) -> None:
    surface = found(tmp_path, make.fourd(wedge=None))
    same(surface)
    assert surface.unsaid == {"surface"}
    assert "wedge" in surface.warnings[0]


@pytest.mark.parametrize("text", ["632.8 nm", "0.6328 um", "6.328e-7 m", "6328 Angstrom", "632.8nm"])
def test_units_of_the_wavelength(tmp_path: Path, text: str) -> None:
    same(found(tmp_path, make.fourd(change=given("wavelength", np.bytes_(text)))))


@pytest.mark.parametrize("marker", [1.1e37, 9.99e37, 3.4e38, np.inf, np.nan, -9e37])
def test_what_is_missing(tmp_path: Path, marker: float) -> None:
    def change(_: h5py.File, data: h5py.Dataset) -> None:
        data[0, 0] = data[5, 1] = marker

    same(found(tmp_path, make.fourd(change=change)))


@pytest.mark.parametrize("text", [None, b"", b"0", b"0.25 pix", b"0 mm"])
def test_without_lateral_scale(tmp_path: Path, text: bytes | None) -> None:
    def change(file: h5py.File, data: h5py.Dataset) -> None:
        for name in ("xpix", "ypix"):
            given(name, None if text is None else np.bytes_(text))(file, data)

    surface = found(tmp_path, make.fourd(change=change))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})


def test_pixels_that_are_not_square(tmp_path: Path) -> None:
    surface = found(tmp_path, make.fourd(change=given("ypix", np.bytes_("0.5 mm"))))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"square pixels"})


@pytest.mark.parametrize("value", [np.array([3.0, 1.0, 6.5, 4.0]), np.bytes_("(3.0, 1.0) (6.5, 4.0)")])
def test_fiducials(tmp_path: Path, value: Any) -> None:
    assert found(tmp_path, make.fourd(change=given("fiducials", value))).fiducials_px == ((1.0, 3.0), (4.0, 6.5))


@pytest.mark.parametrize("value", [np.array([3.0, 1.0, 6.5]), np.array([3.0, 99.0]), np.bytes_("none")])
def test_fiducials_that_are_none(tmp_path: Path, value: Any) -> None:
    surface = found(tmp_path, make.fourd(change=given("fiducials", value)))
    same(surface)
    assert surface.fiducials_px == ()
    assert "fiducials" in surface.warnings[0]


def test_no_fiducials_at_all(tmp_path: Path) -> None:
    for value in (np.array([]), h5py.Empty("f8"), None):
        surface = found(tmp_path, make.fourd(change=given("fiducials", value)))
        assert (surface.fiducials_px, surface.warnings) == ((), ())


def moved(file: h5py.File, data: h5py.Dataset) -> None:
    file["kept"] = data
    del data.parent["data"]


def external(file: h5py.File, _: h5py.Dataset) -> None:
    del file["measurement0"]
    file["measurement0"] = h5py.ExternalLink("/etc/hostname", "/x")


def zero_tail(_: h5py.File, data: h5py.Dataset) -> None:
    data[2:] = 0.0


def masked(_: h5py.File, data: h5py.Dataset) -> None:
    data[:] = 9.9e37


def text_samples(_: h5py.File, data: h5py.Dataset) -> None:
    parent = data.parent
    del parent["data"]
    parent["data"] = np.full((6, 8), b"1.0")


BROKEN: dict[str, tuple[Change, str]] = {
    "no data": (moved, "has no /measurement0/genraw/data"),
    "link to another file": (external, "ExternalLink"),
    "preallocated": (zero_tail, "tail of zeros"),
    "all masked": (masked, "no sample"),
    "text": (text_samples, "no array of numbers"),
    "no wavelength": (given("wavelength", None), "does not say its wavelength"),
    "wavelength empty": (given("wavelength", np.bytes_("")), "does not say its wavelength"),
    "wavelength without unit": (given("wavelength", np.bytes_("632.8")), "unit is not known"),
    "wavelength in furlongs": (given("wavelength", np.bytes_("1 furlong")), "unit is not known"),
    "wavelength 0": (given("wavelength", np.bytes_("0 nm")), "Wavelength"),
    "wavelength NaN": (given("wavelength", np.bytes_("nan nm")), "not a number"),
    "wavelength absurd": (given("wavelength", np.bytes_("632.8 mm")), "Wavelength"),
    "wavelength twice dotted": (given("wavelength", np.bytes_("6.3.2 nm")), "not a number"),
    "wavelength binary": (given("wavelength", np.bytes_(b"\xff\xfe")), "not a number"),
    "wedge 0": (given("wedge", np.bytes_("0.0")), "IntfScaleFactor"),
    "wedge negative": (given("wedge", np.bytes_("-0.5")), "IntfScaleFactor"),
    "wedge text": (given("wedge", np.bytes_("half")), "not a number"),
    "wedge infinite": (given("wedge", np.inf), "not a number"),
    "pitch negative": (given("xpix", np.bytes_("-0.2 mm")), "pitch in x"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken(tmp_path: Path, case: str) -> None:
    change, reason = BROKEN[case]
    with pytest.raises(MapError, match=reason) as caught:
        found(tmp_path, make.fourd(change=change))
    assert str(caught.value).startswith(f"{tmp_path / 'map.h5'}: ")


@pytest.mark.parametrize("cut", [1, 50, 400, 2000])
def test_torn(tmp_path: Path, cut: int) -> None:
    content = make.fourd()[:-cut]
    with pytest.raises(MapError, match=r"map\.h5"):
        found(tmp_path, content)
    assert FOURD.sniff(content[:4096], tmp_path / "map.h5")


def test_it_cannot_be_written() -> None:
    assert FOURD.write is None


@pytest.mark.parametrize("wedge", ["2.0", "0.25"])
def test_an_odd_wedge_is_applied_with_a_warning(tmp_path: Path, wedge: str) -> None:
    surface = found(tmp_path, make.fourd(wedge=wedge))
    same(surface)
    assert "neither" in surface.warnings[0]


def test_what_4sight_writes(tmp_path: Path) -> None:
    surface = found(tmp_path, make.foursight())
    same(surface)
    assert surface.pitch_mm == pytest.approx(make.PITCH_MM)
    assert (surface.unsaid, surface.warnings, surface.date_from) == (frozenset(), (), "header")
    assert surface.taken_at == datetime(2019, 3, 14, 10, 22, 33).astimezone()
    assert surface.instrument == "4D, system 20714"
    assert apply_profile(surface, Instrument("fizcam", serials=("20714",)))
    with pytest.raises(MapError, match="serials"):
        apply_profile(surface, Instrument("fizcam", serials=("20715",)))


def test_an_aspect_makes_pixels_that_are_not_square(tmp_path: Path) -> None:
    surface = found(tmp_path, make.foursight(aspect="1.2"))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"square pixels"})
    assert "0.25 mm wide and 0.3 mm high" in surface.warnings[0]
    with pytest.raises(MapError, match="pitch in y"):
        found(tmp_path, make.foursight(aspect="-1.0"))


@pytest.mark.one_of_each
@pytest.mark.parametrize("attributes", [{"xpix": ""}, {"xpix": "0.0953"}, {"aspect": "0"}])
def test_4sight_without_a_scale(tmp_path: Path, attributes: dict[str, str]) -> None:
    assert found(tmp_path, make.foursight(**attributes)).unsaid == {"pitch"}


@pytest.mark.parametrize(("text", "by"), [("03/04/2019 10:22:33", "guessed"), ("a Thursday", "header")])
def test_a_date_that_is_none(tmp_path: Path, text: str, by: str) -> None:
    surface = found(tmp_path, make.foursight(date=text))
    assert (surface.measured_at, surface.date_from) == (None, by)
    assert text in surface.warnings[0]


@pytest.mark.parametrize("name", ["xpix", "ypix"])
def test_one_side_of_a_pixel_is_no_pitch(tmp_path: Path, name: str) -> None:
    surface = found(tmp_path, make.fourd(change=given(name, None)))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})
