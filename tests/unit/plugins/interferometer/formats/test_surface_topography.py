"""The tail: the real worker process, with a stand-in for SurfaceTopography on its path."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from polishd.api import MapError
from polishd.plugins.interferometer.formats import surface_topography

STAND_IN = """
import dateutil.parser
import numpy as np
print("a library that prints")

class Topography:
    dim, is_uniform, nb_grid_pts, unit = 2, True, (3, 2), {unit!r}
    info = {{"instrument": {{"name": "Wyko NT"}}, **{info}}}
    pixel_size = (2000.0, {y_nm})
    def to_unit(self, unit):
        assert unit == "nm"
        return self
    def heights(self):
        z = np.arange(6.0).reshape(3, 2)  # [x, y]
        return np.ma.masked_array(z, mask=z == 4)

class Reader:
    channels = [1, 2]
    def format(self):
        return "opd"
    def topography(self):
        {body}
        return Topography()

def open_topography(name, format):
    assert format == "opd", format
    return Reader()
"""


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder on the worker's path."""
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    return folder


def put(
    folder: Path,
    library: Path | None = None,
    body: str = "pass",
    unit: str | None = "m",
    y_nm: float = 2e3,
    info: str = "{}",
) -> Path:
    if library is not None:
        (library / "SurfaceTopography.py").write_text(STAND_IN.format(body=body, unit=unit, y_nm=y_nm, info=info))
    path = folder / "map.OPD"
    path.write_bytes(b"anything")
    return path


@pytest.mark.full
def test_what_the_worker_says_is_the_map(tmp_path: Path, library: Path) -> None:
    path = put(tmp_path, library)
    surface = surface_topography.read(path)
    np.testing.assert_array_equal(surface.height_nm, [[0, 2, np.nan], [1, 3, 5]])
    assert surface.pitch_mm == pytest.approx(2e-3)
    assert surface.unsaid == {"orientation", "surface"}
    assert surface.instrument == "Wyko NT"
    assert surface.format == "tail:opd"
    assert surface.sha256 == hashlib.sha256(b"anything").hexdigest()
    assert surface.warnings == ("the default one of 2 channels is taken",)


@pytest.mark.full
def test_a_date_that_the_library_fills_in_is_guessed(tmp_path: Path, library: Path) -> None:
    """``Date 02:15:18`` is month, day and year, and read as a time of today: a map of years ago would be new."""
    path = put(tmp_path, library, info="{'acquisition_time': dateutil.parser.parse('02:15:18')}")
    surface = surface_topography.read(path)
    assert surface.taken_at is not None
    assert (surface.date_from, surface.measured_at) == ("guessed", None)
    assert "is today's, as if filled in: the map counts as not dated" in surface.warnings[-1]


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("text", "by"), [("02/15/18 10:32:11", "header"), ("02/15/18", "guessed"), ("2018-02-15T10:32:11Z", "header")]
)
def test_a_date_with_its_year_is_the_headers(tmp_path: Path, library: Path, text: str, by: str) -> None:
    surface = surface_topography.read(
        put(tmp_path, library, info=f"{{'acquisition_time': dateutil.parser.parse({text!r})}}")
    )
    assert surface.date_from == by
    assert surface.taken_at
    assert surface.taken_at.year == 2018
    assert surface.taken_at.tzinfo


@pytest.mark.full
def test_what_is_no_date_at_all_is_none(tmp_path: Path, library: Path) -> None:
    surface = surface_topography.read(put(tmp_path, library, info="{'acquisition_time': 'soon'}"))
    assert (surface.taken_at, surface.warnings) == (None, ("the default one of 2 channels is taken",))


@pytest.mark.full
def test_a_file_without_units_leaves_them_open(tmp_path: Path, library: Path) -> None:
    surface = surface_topography.read(put(tmp_path, library, unit=None))
    assert surface.unsaid == {"orientation", "surface", "unit", "pitch"}
    assert surface.pitch_mm is None


@pytest.mark.full
def test_pixels_that_are_not_square_have_no_pitch(tmp_path: Path, library: Path) -> None:
    assert "square pixels" in surface_topography.read(put(tmp_path, library, y_nm=3e3)).unsaid


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise ValueError('corrupt')", "cannot read it: corrupt"),
        ("import os; os._exit(3)", "ended with exit code 3"),
        ("import os; os.abort()", "was ended by SIGABRT"),
        ("import a_missing_one", "No module named 'a_missing_one'"),
        ("bytearray(2**40)", "MemoryError"),
        ("Topography.dim = 1", "not an even map"),
        ("Topography.nb_grid_pts = (10**5, 10**5)", "no map of a camera"),
        ("Topography.nb_grid_pts = (3, 3)", r"states 3 x 3 samples, and has \(3, 2\)"),
        ("Topography.pixel_size = (float('nan'),) * 2", "pitch in x"),
        ("Topography.heights = lambda self: np.full((3, 2), np.inf)", "infinite"),
        ("open({path!r}, 'ab').write(b'more')", "changed while it was read"),
    ],
)
def test_what_goes_wrong_there_is_refused_here(tmp_path: Path, library: Path, body: str, said: str) -> None:
    with pytest.raises(MapError, match=said) as refused:
        surface_topography.read(put(tmp_path, library, body.format(path=str(tmp_path / "map.OPD"))))
    assert "map.OPD" in str(refused.value)


@pytest.mark.full
def test_a_worker_that_hangs_is_ended(tmp_path: Path, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface_topography, "BOUNDS", surface_topography.BOUNDS._replace(wall_s=0.5))
    with pytest.raises(MapError, match=r"exceeded its limit: .*limit 0\.5 s"):
        surface_topography.read(put(tmp_path, library, "import threading; threading.Event().wait()"))


@pytest.mark.full
def test_without_the_extra_it_says_so(tmp_path: Path, library: Path) -> None:
    assert not list(library.iterdir())
    with pytest.raises(MapError, match=r"pip install 'polishd\[tail\]'"):
        surface_topography.read(put(tmp_path))


def test_other_files_are_neither_claimed_nor_read(tmp_path: Path) -> None:
    assert surface_topography.sniff(b"", Path("a.SUR"))
    for name in ("a.dat", "a.h5", "a.npy", "a.txt", "a"):
        assert not surface_topography.sniff(b"DIGITAL SURF", Path(name))
        with pytest.raises(MapError, match="none of the formats"):
            surface_topography.read(tmp_path / name)
