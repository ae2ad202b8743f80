"""Wyko and Vision ASCII files, recognized as a map and not a list of points, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.plugins.interferometer import READERS
from polishd.plugins.interferometer.map_files import read_map
from tests.unit.cli_result import Polishd
from tests.unit.plugins.interferometer.map_files_other import wyko_text as text

NAN = np.nan
HEIGHTS = np.array([[1.0, 4.0, 7.0, 10.0], [2.0, NAN, 8.0, 11.0], [3.0, 6.0, 9.0, 12.0]])
"""(rows, columns), row 0 the top."""


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def build(content: str) -> Path:
        path = tmp_path / "scan.asc"
        path.write_bytes(content.encode())
        return path

    return build


@pytest.mark.parametrize(("in_nm", "scale"), [(1, 1.0), (0, 316.4)])
def test_heights_pitch_and_missing_samples(write: Callable[[str], Path], in_nm: int, scale: float) -> None:
    found = read_map(write(text(HEIGHTS, in_nm=in_nm)), READERS)
    assert found.format == "wyko_ascii"
    np.testing.assert_allclose(found.height_nm, HEIGHTS * scale)
    assert found.pitch_mm == pytest.approx(0.002)
    assert found.unsaid == {"orientation"}


def test_pixels_that_are_not_square_keep_both_pitches(write: Callable[[str], Path]) -> None:
    found = read_map(write(text(HEIGHTS, aspect="1.25")), READERS)
    assert found.pitch_mm is None
    assert found.pitches_mm == pytest.approx((0.002, 0.0025))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (text(HEIGHTS, block="Image"), "without heights"),
        (text(HEIGHTS)[:-20], "torn"),
        (text(HEIGHTS).replace("X Size\t4\r\n", ""), "before its block 'Intensity'"),
        (text(HEIGHTS, in_nm=0).replace("632.8", "nm"), "Wavelength is 'nm'"),
        (text(HEIGHTS).replace("12\t11", "x\t11"), "stands among its numbers"),
    ],
)
def test_what_is_broken_is_refused_by_name(write: Callable[[str], Path], content: str, why: str) -> None:
    with pytest.raises(MapError, match=why):
        read_map(write(content), READERS)


def test_polishd_map_shows_it(polishd: Polishd, write: Callable[[str], Path]) -> None:
    answer = polishd("map", write(text(HEIGHTS)), "--json").answer
    assert (answer["format"], answer["missing"], answer["pv_nm"]) == ("wyko_ascii", 1, 11.0)
