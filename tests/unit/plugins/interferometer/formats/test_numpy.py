"""NumPy's files: bare arrays, arrays with coordinates, and what is refused."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import MapError
from polishd.plugins.interferometer.formats import common, numpy
from tests.unit.plugins.interferometer.map_files_other import (
    PITCH_MM,
    coordinates_m,
    heights_nm,
    npy_file,
    npz_file,
    zipped,
)


def put(folder: Path, content: bytes, name: str = "map.npz") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def savez(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=True, **arrays)
    return file.getvalue()


def test_the_shared_map_is_read_exactly(shared_data: Path) -> None:
    path = shared_data / "xray_mirror_map.npz"
    surface = numpy.read(path)
    with np.load(path) as truth:
        assert truth["Y"][0, 0] > truth["Y"][-1, 0]  # row 0 on top already
        np.testing.assert_array_equal(surface.height_nm, truth["Z"] * 1e9)
    assert surface.pitch_mm == pytest.approx(0.361515)
    assert surface.warnings == (numpy.METRES, "Z is taken, not Znoisy")
    assert not surface.unsaid


def test_a_map_whose_y_grows_with_the_row_is_turned(shared_data: Path) -> None:
    path = shared_data / "elongated_mirror_map.npz"
    with np.load(path) as truth:
        assert truth["Y"][0, 0] < truth["Y"][-1, 0]
        np.testing.assert_array_equal(numpy.read(path).height_nm, truth["Z"][::-1] * 1e9)


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4", ">i2", "<u2", "<i8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_bare_array_is_shown_and_says_nothing(tmp_path: Path, dtype: str, order: str) -> None:
    z = np.array(heights_nm(missing=False) + 100.5, dtype=dtype, order=order)  # type: ignore[call-overload]
    surface = numpy.read(put(tmp_path, npy_file(z), "map.npy"))
    np.testing.assert_array_equal(surface.height_nm, z.astype(float))
    assert surface.height_nm.flags.c_contiguous
    assert surface.height_nm.flags.writeable
    assert surface.pitch_mm is None
    assert surface.unsaid == {"unit", "pitch", "surface", "orientation"}


def test_one_array_in_an_archive_is_that_array(tmp_path: Path) -> None:
    surface = numpy.read(put(tmp_path, savez(z=heights_nm(), pitch=0.1)))
    np.testing.assert_array_equal(surface.height_nm, heights_nm())


def test_several_candidates_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"before \(9, 7\), after \(9, 7\)"):
        numpy.read(put(tmp_path, savez(before=heights_nm(), after=heights_nm())))


def test_coordinates_decide_which_way_it_lies(tmp_path: Path) -> None:
    x, y = coordinates_m()
    turned = {"X": x[::-1, ::-1].T, "Y": y[::-1, ::-1].T, "Z": heights_nm()[::-1, ::-1].T / 1e9}
    surface = numpy.read(put(tmp_path, npz_file(**turned)))
    np.testing.assert_allclose(surface.height_nm, heights_nm(), atol=1e-10)
    assert surface.pitch_mm == pytest.approx(PITCH_MM)


def test_coordinates_off_any_grid_are_refused(tmp_path: Path) -> None:
    x, y = coordinates_m()
    with pytest.raises(MapError, match=r"grid|place"):
        numpy.read(put(tmp_path, npz_file(X=x + 0.3 * y, Y=y - 0.3 * x)))
    with pytest.raises(MapError, match="shapes"):
        numpy.read(put(tmp_path, npz_file(X=x[:-1])))


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (heights_nm() * 1j, "complex128"),
        (np.zeros((2, 3, 4)), r"\(2, 3, 4\)"),
        (np.zeros(5), r"\(5,\)"),
        (np.array([[1, "a"]], dtype=object), "object"),
        (np.zeros((2, 2), dtype=bool), "bool"),
        (np.zeros((2, 2), dtype=[("a", "f4")]), "a"),
        (np.zeros((2, 2), dtype="S4"), "S4"),
        (np.full((2, 2), np.nan), "no sample"),
        (np.full((2, 2), np.inf), "infinite"),
        (np.full((2, 2), 3.4e38), "marker of missing data"),
        (np.zeros((0, 4)), r"\(0, 4\)"),
    ],
)
def test_what_is_no_map_is_refused(tmp_path: Path, array: np.ndarray, said: str) -> None:
    with pytest.raises(MapError, match=said):
        numpy.read(put(tmp_path, npy_file(array), "map.npy"))


def test_a_pickle_is_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (str(tmp_path / "sprung"),)

    for name, content in (("map.npy", npy_file(np.array(Trap()))), ("map.npz", savez(Z=np.array([Trap()])))):
        with pytest.raises(MapError, match="object"):
            numpy.read(put(tmp_path, content, name))
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("shape", ["(9, 8)", "(9, 6)", "(10**9, 10**9)", "(-9, -7)", "(90000000000, 7)", "9, 7", "()"])
def test_a_shape_that_the_file_does_not_hold_is_refused(tmp_path: Path, shape: str) -> None:
    content = npy_file()
    at = content.index(b"(9, 7)")
    old = content[at : content.index(b"\n", at)]
    new = old.replace(b"(9, 7)", shape.encode())
    new = new.rstrip().ljust(len(old)) if len(new) > len(old) else new.ljust(len(old))
    with pytest.raises(MapError):
        numpy.read(put(tmp_path, content.replace(old, new[: len(old)]), "map.npy"))


def test_torn_and_padded_files_are_refused(tmp_path: Path) -> None:
    for content in (npy_file()[:-1], npy_file()[:50], npy_file() + b"\0"):
        with pytest.raises(MapError):
            numpy.read(put(tmp_path, content, "map.npy"))


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = zipped({"Z.npy": npy_file() + bytes(10**6)})
    assert len(bomb) < 4000
    monkeypatch.setattr(common, "MOST_BYTES", 10**6)
    with pytest.raises(MapError, match="unpacks to more than"):
        numpy.read(put(tmp_path, bomb))


def test_two_arrays_of_one_name_are_refused(tmp_path: Path) -> None:
    content = savez(a=heights_nm(), b=heights_nm()).replace(b"b.npy", b"a.npy")
    with pytest.raises(MapError, match="two arrays"):
        numpy.read(put(tmp_path, content))


def test_a_preallocated_array_is_refused(tmp_path: Path) -> None:
    z = heights_nm()
    z.ravel()[-16:] = 0.0
    with pytest.raises(MapError, match="tail of zeros"):
        numpy.read(put(tmp_path, npy_file(z), "map.npy"))
    with pytest.raises(MapError, match="tail of zeros"):
        numpy.read(put(tmp_path, npy_file(np.zeros((9, 9))), "map.npy"))


@pytest.mark.parametrize("ordered", [np.ascontiguousarray, np.asfortranarray])
def test_a_background_of_zeros_is_no_tail(tmp_path: Path, ordered: Any) -> None:
    z = np.zeros((20, 30))
    z[2:5, 3:9] = 50.0
    np.testing.assert_array_equal(numpy.read(put(tmp_path, npy_file(ordered(z)), "map.npy")).height_nm, z)
    content = npy_file(ordered(np.random.default_rng(1).normal(size=(20, 30))))
    with pytest.raises(MapError, match="tail of zeros"):
        numpy.read(put(tmp_path, content[: -8 * 40] + bytes(8 * 40), "map.npy"))


def test_coordinates_that_can_be_no_metres_are_refused(tmp_path: Path) -> None:
    x, y = coordinates_m()
    with pytest.raises(MapError, match="marker of missing data"):
        numpy.read(put(tmp_path, savez(X=x * 1e3, Y=y * 1e3, Z=heights_nm())))
