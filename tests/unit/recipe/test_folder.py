"""Files for people: each whole, and read back as it was written."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from polishd.recipe.folder import RunFolder


@dataclass(frozen=True)
class Note:
    text: str
    count: int


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    found = RunFolder(tmp_path / "a" / "run")
    found.create()
    return found


def test_create_makes_parents_and_may_be_repeated(folder: RunFolder) -> None:
    folder.create()
    assert folder.path.is_dir()


def test_a_folder_a_cycle(folder: RunFolder) -> None:
    assert folder.cycle(3).path == folder.path / "cycle-03"
    assert sorted(["cycle-10", "cycle-09"]) == [folder.cycle(k).path.name for k in (9, 10)], "in order by name, too"


def test_bytes_and_copies(folder: RunFolder, tmp_path: Path) -> None:
    folder.bytes("program.rnc", b"G1\r\n")
    source = tmp_path / "scan.dat"
    source.write_bytes(b"\x00\xff")
    folder.copy(source, "map.dat")
    assert (folder.path / "program.rnc").read_bytes() == b"G1\r\n"
    assert (folder.path / "map.dat").read_bytes() == b"\x00\xff"
    assert sorted(path.name for path in folder.path.iterdir()) == ["map.dat", "program.rnc"]


def test_a_copy_that_fails_leaves_the_old_one(folder: RunFolder, tmp_path: Path) -> None:
    folder.bytes("map.dat", b"old")
    with pytest.raises(FileNotFoundError):
        folder.copy(tmp_path / "gone.dat", "map.dat")
    assert (folder.path / "map.dat").read_bytes() == b"old"


def test_a_folder_that_somebody_deleted_is_made_anew(folder: RunFolder, tmp_path: Path) -> None:
    cycle = folder.cycle(0)
    for write in (lambda: cycle.bytes("x", b"x"), lambda: cycle.copy(Path(__file__), "y"), lambda: cycle.json("z", {})):
        shutil.rmtree(folder.path, ignore_errors=True)
        assert not cycle.holds("x")
        write()
    assert cycle.holds("z")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"a": 1.5, "b": [1, 2]}, {"a": 1.5, "b": [1, 2]}),
        (Note("x", 2), {"text": "x", "count": 2}),
        ({"n": np.int64(3), "x": np.float64(0.25), "yes": np.bool_(True)}, {"n": 3, "x": 0.25, "yes": True}),
        ({"path": Path("/tmp/x")}, {"path": "/tmp/x"}),
    ],
)
def test_json(folder: RunFolder, content: object, expected: object) -> None:
    folder.json("x.json", content)
    assert json.loads((folder.path / "x.json").read_text()) == expected
    assert (folder.path / "x.json").read_text().endswith("}\n")


def test_json_that_cannot_be_written_leaves_the_old_one(folder: RunFolder) -> None:
    folder.json("x.json", {"a": 1})
    with pytest.raises(TypeError, match="not JSON: object"):
        folder.json("x.json", {"a": object()})
    assert json.loads((folder.path / "x.json").read_text()) == {"a": 1}


def test_arrays(folder: RunFolder) -> None:
    height = np.array([[1.5, np.nan], [-0.0, 1e300]])
    folder.arrays("x.npz", {"height": height, "mask": np.isfinite(height), "pitch": 0.5})
    with np.load(folder.path / "x.npz") as archive:
        back = dict(archive)
    assert set(back) == {"height", "mask", "pitch"}
    assert np.array_equal(back["height"], height, equal_nan=True)
    assert back["mask"].dtype == np.bool_
    assert float(back["pitch"]) == 0.5


def test_a_table(folder: RunFolder) -> None:
    folder.table("x.csv", {"seq": np.arange(2), "t_s": np.array([0.1, 123456.789]), "on": np.array([True, False])})
    assert (folder.path / "x.csv").read_text() == "seq,t_s,on\n0,0.1,1\n1,123456.789,0\n"


def test_a_table_of_nothing_has_its_header(folder: RunFolder) -> None:
    folder.table("x.csv", {"seq": np.zeros(0), "t_s": np.zeros(0)})
    assert (folder.path / "x.csv").read_text().splitlines() == ["seq,t_s"]
