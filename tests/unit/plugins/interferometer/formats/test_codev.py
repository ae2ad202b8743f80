"""Reading CODE V grids: the sample to all digits, each word of the parameters, and every way to be broken."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.codev import read, sniff
from tests.memory import peak_bytes
from tests.unit.plugins.interferometer import map_files as make

NM = 632.8 / 65536


def found(tmp_path: Path, content: bytes) -> SurfaceMap:
    path = tmp_path / "map.int"
    path.write_bytes(content)
    return read(path)


def same(surface: SurfaceMap, nm: float = NM) -> None:
    np.testing.assert_allclose(surface.height_nm, make.HEIGHT_NM, atol=0.5001 * nm)


def test_the_sample(shared_data: Path) -> None:
    surface = read(shared_data / "codev.int")
    height = surface.height_nm
    assert height.shape == (256, 256)
    assert int(np.isnan(height).sum()) == 14_105
    assert float(np.nanmax(height) - np.nanmin(height)) == pytest.approx(54.545398, rel=1e-8)
    assert float(np.nanstd(height)) == pytest.approx(10.883244, rel=1e-8)
    assert (surface.pitch_mm, set(surface.unsaid), surface.format) == (None, {"pitch"}, "codev")
    assert "no lateral scale" in surface.warnings[0]


@pytest.mark.parametrize("cut", [9, 30, 4000, 400_000, 465_400])
def test_the_sample_torn(shared_data: Path, tmp_path: Path, cut: int) -> None:
    with pytest.raises(MapError, match=re.escape(str(tmp_path / "map.int"))):
        found(tmp_path, (shared_data / "codev.int").read_bytes()[:-cut])


@pytest.mark.parametrize("wrap", [1, 3, 8, 10, 48])
def test_values_wrapped_anyhow(tmp_path: Path, wrap: int) -> None:
    surface = found(tmp_path, make.codev(wrap=wrap))
    same(surface)
    assert "first row is the top" in surface.orientation


@pytest.mark.parametrize(
    ("words", "nda"),
    [
        ("SUR WVL 0.6328 SSZ 65536", 32767),
        ("SUR WVL 0.6328 SSZ 65536.000000 NDA 32767", 32767),
        ("SUR WVL 0.6328 NNB SSZ 65536 NDA -1", -1),
        ("sur wvl 0.6328 ssz 6.5536e4 nda -32768 xsc 1.0", -32768),
        ("NDA 0 SSZ 65536 WVL 6.328E-1 SUR", 0),
    ],
)
def test_words_in_any_order(tmp_path: Path, words: str, nda: int) -> None:
    surface = found(tmp_path, make.codev(words=words, nda=nda))
    same(surface)
    assert surface.unsaid == {"pitch"}


def test_an_end_inside_a_number_is_not_silent(tmp_path: Path) -> None:
    whole, cut = found(tmp_path, make.codev()), found(tmp_path, make.codev().rstrip())
    same(cut)
    assert not any("torn" in warning for warning in whole.warnings)
    assert any("torn" in warning for warning in cut.warnings)


def test_wavelength_and_scale_are_applied_once(tmp_path: Path) -> None:
    same(found(tmp_path, make.codev(words="SUR WVL 1.064 SSZ 1000 NDA 9999", nda=9999, um=1.064, ssz=1000)), 1.064)


def test_a_wavefront_is_left_to_the_profile(tmp_path: Path) -> None:
    surface = found(tmp_path, make.codev(words="WFR WVL 0.6328 SSZ 65536 NDA -32768"))
    same(surface)
    assert surface.unsaid == {"pitch", "surface"}
    assert "wavefront" in surface.warnings[1]


def test_pixels_that_are_not_square(tmp_path: Path) -> None:
    surface = found(tmp_path, make.codev(words="SUR WVL 0.6328 SSZ 65536 NDA -32768 XSC 1.5"))
    same(surface)
    assert surface.unsaid == {"pitch", "square pixels"}


def test_other_line_ends_comments_and_continuation(tmp_path: Path) -> None:
    content = make.codev()
    same(found(tmp_path, content.replace(b"\n", b"\r\n")))
    same(found(tmp_path, content.replace(b"a title\n", b"! more\n\xfcber title!\n! again\n")))
    same(found(tmp_path, content.replace(b" SSZ", b" &\nSSZ")))
    same(found(tmp_path, content.replace(b"a title\n", b"")))
    same(found(tmp_path, content.rstrip(b"\n") + b"\n! the end\n"))


GOOD = make.codev()
BROKEN: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "empty"),
    "no grid": (b"hello\n" * 300, "no CODE V grid"),
    "no line end": (b"GRD 6 8 SUR WVL 1 SSZ 1", "no CODE V grid"),
    "Zernikes": (b"title\nZFR 37 SUR WVL 0.6328 SSZ 1.0\n1 2 3\n", "Zernike coefficients"),
    "one value more": (GOOD + b"7\n", "49 values of 6 rows x 8 columns: more"),
    "one value less": (GOOD[: GOOD.rstrip().rfind(b" ")] + b"\n", "47 values"),
    "no rows": (GOOD.replace(b"GRD 8 6", b"GRD 8 0"), "no phase data"),
    "absurd size": (GOOD.replace(b"GRD 8 6", b"GRD 99999 99999"), "no interferometer's camera"),
    "larger than it is": (GOOD.replace(b"GRD 8 6", b"GRD 4000 4000"), "too short"),
    "size of many digits": (GOOD.replace(b"GRD 8 6", b"GRD 8 " + b"9" * 200), "no interferometer's camera"),
    "no wavelength": (GOOD.replace(b"WVL 0.6328", b""), "WVL and SSZ"),
    "no scale": (GOOD.replace(b"SSZ 65536", b""), "WVL and SSZ"),
    "neither surface nor wavefront": (GOOD.replace(b"SUR", b""), "SUR or WFR"),
    "a filter": (GOOD.replace(b"SUR", b"FIL"), "'FIL'"),
    "both": (GOOD.replace(b"SUR", b"SUR WFR"), "stands there twice"),
    "twice": (GOOD.replace(b"SSZ 65536", b"SSZ 65536 SSZ 1"), "stands there twice"),
    "scale 0": (GOOD.replace(b"SSZ 65536", b"SSZ 0"), "SSZ is 0"),
    "scale negative": (GOOD.replace(b"SSZ 65536", b"SSZ -65536"), "SSZ is"),
    "scale NaN": (GOOD.replace(b"SSZ 65536", b"SSZ nan"), "SSZ is 'NAN'"),
    "scale missing": (GOOD.replace(b"SSZ 65536 NDA -32768", b"NDA -32768 SSZ"), "SSZ is ''"),
    "wavelength in nm": (GOOD.replace(b"WVL 0.6328", b"WVL 632.8"), "Wavelength"),
    "wavelength infinite": (GOOD.replace(b"WVL 0.6328", b"WVL inf"), "WVL is"),
    "unknown word": (GOOD.replace(b"SUR", b"SUR ABC"), "'ABC'"),
    "a letter": (GOOD.replace(b"-32768", b"-3276x", 2), "'x'|NDA is"),
    "a hole of zeros": (GOOD[:150] + bytes(30) + GOOD[180:], "stands among its numbers"),
    "two signs": (GOOD[:-2] + b"--\n", "could not convert|values"),
    "a number too large": (GOOD.rstrip() + b"e999\n", "no numbers"),
    "nothing but missing": (make.codev(make.HEIGHT_NM * np.nan), "no sample"),
    "a run without blanks": (GOOD[:70] + b"1" * 200_000, "in a row|values|no numbers"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken(tmp_path: Path, case: str) -> None:
    content, reason = BROKEN[case]
    with pytest.raises(MapError, match=reason) as caught:
        found(tmp_path, content)
    assert str(caught.value).startswith(f"{tmp_path / 'map.int'}: ")


@pytest.mark.full
def test_memory_is_bounded(tmp_path: Path) -> None:
    rows, columns = 600, 700
    content = make.codev(np.arange(rows * columns, dtype=np.float64).reshape(rows, columns) / 1e3)
    most = 4 * len(content) + 2**22
    assert peak_bytes(lambda: found(tmp_path, content), most) < most


def test_sniff() -> None:
    assert sniff(GOOD, Path("map.txt"))
    assert sniff(b"anything", Path("map.INT"))
    assert not sniff(b"anything", Path("map.txt"))
    assert not sniff(b"GRD 6 8 SUR\0", Path("map.int"))


def test_a_last_number_that_begins_no_data_is_torn(tmp_path: Path) -> None:
    content = make.codev().rstrip()
    whole = content[: content.rfind(b" ") + 1] + b"-32768"
    assert np.isnan(found(tmp_path, whole).height_nm[-1, -1])
    assert not any("torn" in warning for warning in found(tmp_path, whole).warnings)
    for cut in (1, 2, 3, 4):
        with pytest.raises(MapError, match="ends inside a number"):
            found(tmp_path, whole[:-cut])


def test_an_undeclared_marker_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="marker of missing data"):
        found(tmp_path, make.codev(words="SUR WVL 0.6328 SSZ 65536", nda=-32768))
