"""FITS as astropy writes it and as it stands in files by hand."""

from __future__ import annotations

import gzip
import hashlib
import io
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import MapError
from polishd.plugins.interferometer.formats import fits
from tests.unit.plugins.interferometer.map_files_other import PITCH_MM, fits_by_hand, fits_file, heights_nm


def put(folder: Path, content: bytes) -> Path:
    path = folder / "map.fits"
    path.write_bytes(content)
    return path


def hand_made(data: bytes, **cards: str) -> bytes:
    """A 3 x 2 image of the given cards over sensible ones."""
    words = {"SIMPLE": "T", "BITPIX": "16", "NAXIS": "2", "NAXIS1": "3", "NAXIS2": "2", "BUNIT": "'nm      '"}
    return fits_by_hand(words | cards, data)


INTEGERS = np.array([[1, 2, 3], [4, 5, -999]], dtype=">i2")


def test_heights_come_back_the_right_way_up(tmp_path: Path) -> None:
    surface = fits.read(put(tmp_path, fits_file(OBJECT="M1", INSTRUME="Fisba")))
    np.testing.assert_array_equal(surface.height_nm, heights_nm())
    assert surface.pitch_mm == pytest.approx(PITCH_MM)
    assert surface.unsaid == {"surface", "orientation"}
    assert (surface.part_id, surface.instrument) == ("M1", "Fisba")


def test_integers_are_scaled_in_double_and_blank_is_missing(tmp_path: Path) -> None:
    content = hand_made(INTEGERS.tobytes(), BSCALE="0.1", BZERO="1000000.0", BLANK="-999")
    surface = fits.read(put(tmp_path, content))
    expected = np.array([[1e6 + 0.4, 1e6 + 0.5, np.nan], [1e6 + 0.1, 1e6 + 0.2, 1e6 + 0.3]])
    np.testing.assert_allclose(surface.height_nm, expected, rtol=1e-15)


def test_the_library_agrees(tmp_path: Path) -> None:
    from astropy.io import fits as astropy_fits

    path = put(tmp_path, hand_made(INTEGERS.tobytes(), BSCALE="0.5", BZERO="2.0"))
    np.testing.assert_allclose(fits.read(path).height_nm, astropy_fits.getdata(path)[::-1])


def test_the_first_image_extension_is_taken(tmp_path: Path) -> None:
    from astropy.io import fits as astropy_fits

    image = astropy_fits.ImageHDU(heights_nm()[::-1])
    image.header["BUNIT"] = "um"
    file = io.BytesIO()
    astropy_fits.HDUList([astropy_fits.PrimaryHDU(), image, astropy_fits.ImageHDU(np.zeros((2, 2)))]).writeto(file)
    surface = fits.read(put(tmp_path, file.getvalue()))
    np.testing.assert_allclose(surface.height_nm, heights_nm() * 1e3)
    assert surface.unsaid == {"surface", "orientation", "pitch"}


def test_no_more_units_are_looked_at_than_a_file_of_maps_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from astropy.io import fits as astropy_fits

    monkeypatch.setattr(fits, "MOST_EXTENSIONS", 3)
    seen: list[Any] = []
    monkeypatch.setattr(fits, "_is_image", lambda header: not seen.append(header))
    image = astropy_fits.PrimaryHDU(heights_nm())
    file = io.BytesIO()
    astropy_fits.HDUList([image, *(astropy_fits.ImageHDU(np.zeros((2, 2))) for _ in range(6))]).writeto(file)
    fits.read(put(tmp_path, file.getvalue()))
    assert len(seen) == 1 + 3  # until the first image, and of all that count


@pytest.mark.parametrize("unit", [None, "waves", "counts", "rad"])
def test_an_unknown_unit_is_left_open(tmp_path: Path, unit: str | None) -> None:
    surface = fits.read(put(tmp_path, fits_file(BUNIT=unit)))
    assert "unit" in surface.unsaid
    np.testing.assert_array_equal(surface.height_nm, heights_nm())


@pytest.mark.parametrize(
    ("cards", "pitch_mm"),
    [
        ({"CDELT1": -0.2, "CDELT2": 0.2}, 0.2),
        ({"CDELT1": None, "CDELT2": None, "CD1_1": 3e2, "CD2_2": 3e2, "CUNIT1": "um", "CUNIT2": "um"}, 0.3),
        ({"CUNIT1": None}, None),
        ({"CUNIT1": "deg", "CUNIT2": "deg"}, None),
        ({"CDELT1": None}, None),
        ({"CDELT1": 0.5}, None),
    ],
)
def test_the_pitch_is_what_its_keywords_say(tmp_path: Path, cards: dict[str, Any], pitch_mm: float | None) -> None:
    assert fits.read(put(tmp_path, fits_file(**cards))).pitch_mm == pytest.approx(pitch_mm)


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", ["map.fits.gz", "map.fits", "map.gz"])
def test_a_packed_file_is_read_by_its_content(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(gzip.compress(fits_file(OBJECT="M1")))
    assert fits.FITS.sniff(path.read_bytes()[:4096], path)
    surface = fits.read(path)
    np.testing.assert_array_equal(surface.height_nm, heights_nm())
    assert surface.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert not fits.FITS.sniff(gzip.compress(b"anything else"), path)


def test_a_packed_file_that_bursts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="32 times the file"):
        fits.read(put(tmp_path, gzip.compress(fits_file(np.zeros((1000, 1000))))))


@pytest.mark.parametrize(("cards", "nm"), [({"UNITS": "MICRONS"}, 1e3), ({"ZUNITS": "mm"}, 1e6), ({"UNITS": "x"}, 1.0)])
def test_the_unit_has_other_names(tmp_path: Path, cards: dict[str, Any], nm: float) -> None:
    surface = fits.read(put(tmp_path, fits_file(BUNIT=None, **cards)))
    np.testing.assert_allclose(surface.height_nm, heights_nm() * nm)
    assert ("unit" in surface.unsaid) == (cards.get("UNITS") == "x")
    assert fits.read(put(tmp_path, fits_file(**cards))).factors["nm_per_unit"] == 1.0  # BUNIT is the standard's


def test_the_date_of_observation_is_utc(tmp_path: Path) -> None:
    surface = fits.read(put(tmp_path, fits_file(**{"DATE-OBS": "2019-03-14T10:22:33"})))
    assert (surface.taken_at, surface.date_from) == (datetime(2019, 3, 14, 10, 22, 33, tzinfo=UTC), "header")
    surface = fits.read(put(tmp_path, fits_file(**{"DATE-OBS": "2019-03-14"})))
    assert (surface.measured_at, surface.date_from) == (None, "guessed")


@pytest.mark.parametrize("text", ['""', "' '", '"'])
def test_a_part_of_quotation_marks_is_none(tmp_path: Path, text: str) -> None:
    assert fits.read(put(tmp_path, fits_file(OBJECT=text))).part_id == ""


def test_turned_axes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="PC1_2 turns"):
        fits.read(put(tmp_path, fits_file(PC1_2=0.1)))


@pytest.mark.parametrize(
    ("cards", "said"),
    [
        ({"NAXIS1": "4000"}, "do not fit"),
        ({"NAXIS1": "4000000000", "NAXIS2": "4000000000"}, "map"),
        ({"NAXIS1": "0"}, "map"),
        ({"NAXIS1": "-3"}, "map"),
        ({"BITPIX": "17"}, "map"),
        ({"NAXIS": "3", "NAXIS3": "1"}, "3 axes"),
        ({"NAXIS": "0"}, "map"),
        ({"BSCALE": "0.0"}, "scale is not known"),
        ({"BSCALE": "1E400"}, "scale is not known"),
        ({"BZERO": "'a'"}, "map"),
    ],
)
def test_headers_that_say_nonsense_are_refused(tmp_path: Path, cards: dict[str, str], said: str) -> None:
    with pytest.raises(MapError, match=said):
        fits.read(put(tmp_path, hand_made(INTEGERS.tobytes(), **cards)))


def test_cubes_and_tables_and_infinities_are_refused(tmp_path: Path) -> None:
    from astropy.io import fits as astropy_fits

    table = io.BytesIO()
    astropy_fits.BinTableHDU(np.zeros(3, dtype=[("z", "f8")])).writeto(table)
    broken = (fits_file(np.zeros((2, 3, 4))), table.getvalue(), fits_file(np.full((2, 2), np.inf)))
    for content in broken:
        with pytest.raises(MapError):
            fits.read(put(tmp_path, content))


def test_torn_and_packed_files_are_refused(tmp_path: Path) -> None:
    whole = fits_file()
    packed = gzip.compress(whole)
    torn = (whole[:20], whole[:2880], whole[:3000], b"SIMPLE  =")
    torn_packed = (
        packed[:-1],
        packed[:20],
        packed + b"more",
        packed[:50] + b"\xff" + packed[51:],
        gzip.compress(b"no"),
    )
    for content in torn + torn_packed:
        with pytest.raises(MapError):
            fits.read(put(tmp_path, content))


def test_without_the_extra_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "astropy.io.fits", None)
    with pytest.raises(MapError, match=r"pip install 'polishd\[fits\]'"):
        fits.read(put(tmp_path, fits_file()))


def test_the_first_of_several_images_is_taken_with_a_warning(tmp_path: Path) -> None:
    from astropy.io import fits as astropy_fits

    file = io.BytesIO()
    images = [astropy_fits.PrimaryHDU(heights_nm()[::-1]), astropy_fits.ImageHDU(np.ones((2, 2)))]
    astropy_fits.HDUList(images).writeto(file)
    surface = fits.read(put(tmp_path, file.getvalue()))
    np.testing.assert_array_equal(surface.height_nm, heights_nm())
    assert "the first of 2 images is taken" in surface.warnings


def test_a_preallocated_file_is_refused(tmp_path: Path) -> None:
    torn = np.append(np.arange(1, 6), np.zeros(25)).astype(">i2")
    with pytest.raises(MapError, match="tail of zeros"):
        fits.read(put(tmp_path, hand_made(torn.tobytes(), NAXIS1="15")))
