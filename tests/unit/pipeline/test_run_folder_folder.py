"""Files for people: each whole, and read back as it was written."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from polishd.model.surface import SurfaceMap
from polishd.pipeline.run_folder import RunFolder


@dataclass(frozen=True)
class Note:
    text: str
    count: int


def of_file(path: Path | None) -> SurfaceMap:
    return SurfaceMap(np.zeros((2, 2)), 1.0, path=path)


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
    source = tmp_path / "scan.dat"
    source.write_bytes(b"\x00\xff")
    folder.write({"program.rnc": b"G1\r\n"})
    folder.map_file(of_file(source))
    assert (folder.path / "program.rnc").read_bytes() == b"G1\r\n"
    assert (folder.path / "map.dat").read_bytes() == b"\x00\xff"
    assert sorted(path.name for path in folder.path.iterdir()) == ["map.dat", "program.rnc"]


def test_a_map_without_a_file_leaves_none(folder: RunFolder) -> None:
    folder.map_file(of_file(None))
    assert list(folder.path.iterdir()) == []


def test_a_copy_that_fails_leaves_the_old_one(folder: RunFolder, tmp_path: Path) -> None:
    folder.bytes("map.dat", b"old")
    with pytest.raises(FileNotFoundError):
        folder.map_file(of_file(tmp_path / "gone.dat"))
    assert (folder.path / "map.dat").read_bytes() == b"old"


def test_a_folder_that_somebody_deleted_is_made_anew(folder: RunFolder, tmp_path: Path) -> None:
    cycle = folder.cycle(0)
    here = of_file(Path(__file__))
    for write in (lambda: cycle.bytes("x", b"x"), lambda: cycle.map_file(here), lambda: cycle.json("z", {})):
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
