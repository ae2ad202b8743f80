"""Files for people: each whole, and read back as it was written.

What people hand over: one clear error each.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.hookspecs import SurfaceReader
from polishd.model.errors import MapError, ProgramError, StaleMap
from polishd.model.surface import SurfaceMap
from polishd.pipeline.run_folder import SNIFF_BYTES, RunFolder, read_map, read_program_bytes
from tests.unit.daemon.small_job import small_map


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


def test_a_deleted_folder_is_created_again(folder: RunFolder, tmp_path: Path) -> None:
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


def reader(name: str, magic: bytes, seen: list[bytes] | None = None) -> SurfaceReader:
    def sniff(head: bytes, path: Path) -> bool:
        if seen is not None:
            seen.append(head)
        return head.startswith(magic)

    def read(path: Path) -> SurfaceMap:
        return small_map(part_id=f"{name} read {path.name}")

    return SurfaceReader(name, sniff, read)


def test_a_program(tmp_path: Path) -> None:
    path = tmp_path / "p.rnc"
    path.write_bytes(b"G1 X1\r\n\xb5")
    assert read_program_bytes(path) == b"G1 X1\r\n\xb5"


@pytest.mark.parametrize("content", [b"", b" \r\n\t\n"])
def test_an_empty_program(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "p.rnc"
    path.write_bytes(content)
    with pytest.raises(ProgramError, match=r"p\.rnc: the file is empty"):
        read_program_bytes(path)


def test_a_program_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match=r"gone\.rnc: cannot be read: No such file"):
        read_program_bytes(tmp_path / "gone.rnc")
    with pytest.raises(ProgramError, match="cannot be read: Is a directory"):
        read_program_bytes(tmp_path)


def test_the_first_reader_that_knows_the_file_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "m.dat"
    path.write_bytes(b"ABC" + bytes(2 * SNIFF_BYTES))
    seen: list[bytes] = []
    readers = [reader("x", b"X", seen), reader("ab", b"AB"), reader("abc", b"ABC", seen)]
    assert read_map(path, readers).part_id == "ab read m.dat"
    assert [len(head) for head in seen] == [SNIFF_BYTES], "the third is not asked"


def test_an_unknown_map(tmp_path: Path) -> None:
    path = tmp_path / "m.dat"
    path.write_bytes(b"?")
    with pytest.raises(MapError, match=r"no loaded reader knows this file \(tried: x, y\)"):
        read_map(path, [reader("x", b"X"), reader("y", b"Y")])
    with pytest.raises(MapError, match="tried: none"):
        read_map(path, [])


def test_a_text_under_another_name_gets_its_own_name(tmp_path: Path) -> None:
    """By what a reader says of its content, not of a name alone; one that fails at it is named."""

    def odd(head: bytes, path: Path) -> bool:
        return path.suffix == ".odd" and head[4] == 1

    def lists(head: bytes, path: Path) -> bool:
        return path.suffix == ".pts" and head.startswith(b"1 2")

    readers = [
        SurfaceReader("odd", odd, small_map, (".odd",)),
        SurfaceReader("named", lambda head, path: path.suffix == ".nam", small_map, (".nam",)),
        SurfaceReader("lists", lists, small_map, (".pts",)),
    ]
    path = tmp_path / "m.dat"
    path.write_bytes(b"1 2 3")
    with pytest.raises(
        MapError,
        match=r"\(tried: odd, named, lists\); it looks like lists: name it \*\.pts \(or polishd map --format pts\)$",
    ):
        read_map(path, readers)
    path.write_bytes(b"x y")
    with pytest.raises(MapError, match=r"; the reader 'odd' failed on it \(IndexError: .*\): correct its plugin$"):
        read_map(path, readers)
    for content in (b"x y z", b"1 2\0"):
        path.write_bytes(content)
        with pytest.raises(MapError, match=r"\(tried: odd, named, lists\)\. Export the map in one of these formats$"):
            read_map(path, readers)


def test_a_map_that_is_empty_or_gone(tmp_path: Path) -> None:
    path = tmp_path / "m.dat"
    with pytest.raises(MapError, match="cannot be read: No such file"):
        read_map(path, [reader("any", b"")])
    path.touch()
    with pytest.raises(MapError, match="the file is empty"):
        read_map(path, [reader("any", b"")])


def test_whatever_a_reader_does_is_a_bad_map_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "m.dat"
    path.write_bytes(b"?")

    def raises(error: Exception) -> Any:
        raise error

    for broken, says in [
        (
            SurfaceReader("odd", lambda head, path: True, lambda path: raises(ValueError("no\nnumber"))),
            "ValueError: no number",
        ),
        (
            SurfaceReader("odd", lambda head, path: True, lambda path: raises(AttributeError("it"))),
            "AttributeError: it",
        ),
        (SurfaceReader("odd", lambda head, path: raises(IndexError("head")), small_map), "IndexError: head"),
        (SurfaceReader("odd", lambda head, path: True, lambda path: None), "returned NoneType, not a SurfaceMap"),  # type: ignore[arg-type,return-value]
    ]:
        with pytest.raises(MapError, match=rf"m\.dat: the reader 'odd' .*{says}"):
            read_map(path, [broken, reader("any", b"")])
    stale = SurfaceReader("odd", lambda head, path: True, lambda path: raises(StaleMap("older")))
    with pytest.raises(StaleMap, match=r"^older$"):
        read_map(path, [stale])
