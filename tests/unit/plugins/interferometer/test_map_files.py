"""How files come to rest, are read, claimed, and put away."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.api import MapError, SurfaceMap, SurfaceReader
from polishd.plugins.interferometer import map_files
from polishd.plugins.interferometer.map_files import SettledFiles


def test_a_changed_file_is_not_claimed(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(b"one")
    seen = map_files.identity(path)
    assert seen
    path.write_bytes(b"another")
    assert not map_files.claim_file(path, seen, tmp_path / "taken" / "x.dat", "f" * 64)
    assert path.read_bytes() == b"another"


def test_names_that_are_taken(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / "bad.dat").write_text(str(number))
        assert map_files.quarantine_file(tmp_path / "bad.dat", tmp_path / "q", f"reason {number}")
    names = {path.name: path.read_text().strip() for path in (tmp_path / "q").iterdir()}
    assert names["bad.dat"] == "0"
    assert names["bad-2.dat"] == "2"
    assert names["bad-2.dat.reason.txt"] == "reason 2"
    assert map_files.quarantine_file(tmp_path / "gone.dat", tmp_path / "q", "x") is None


def test_a_reader_that_breaks_is_named(tmp_path: Path) -> None:
    def broken(path: Path) -> SurfaceMap:
        raise KeyError("phase")

    path = tmp_path / "a.xyz"
    path.write_bytes(b"x")
    reader = SurfaceReader("theirs", lambda head, path: True, broken)
    with pytest.raises(MapError, match="the reader 'theirs' failed: KeyError"):
        map_files.read_map(path, [reader])
    with pytest.raises(MapError, match="no reader is loaded"):
        map_files.read_map(path, [])
    with pytest.raises(FileNotFoundError):
        map_files.read_map(tmp_path / "gone", [reader])


def test_settled_counts_polls_and_seconds() -> None:
    a, b = Path("a"), Path("b")
    one, other = map_files.FileIdentity(1, 1, 1), map_files.FileIdentity(2, 1, 1)
    settled = SettledFiles(polls=3, seconds=1.0)
    assert settled.poll({a: one}, 0.0) == []
    assert settled.poll({a: one}, 5.0) == []
    assert settled.poll({a: one, b: one}, 5.1) == [a]
    assert settled.quiet_s(a, 6.0) == 6.0
    assert settled.rest_s(5.1, 0.5) == 0.5
    assert settled.rest_s(5.9, 0.5) == pytest.approx(0.2)
    assert settled.rest_s(6.1, 0.5) == 0.5
    assert settled.poll({a: other, b: one}, 5.2) == []
    assert settled.poll({a: other, b: one}, 5.3) == []
    assert settled.poll({a: other, b: one}, 5.4) == []
    assert settled.poll({a: other, b: one}, 6.3) == [a, b]
    settled.put_off(a, 6.3)
    assert settled.poll({a: other, b: one}, 7.0) == [b]
    assert settled.poll({a: other, b: one}, 7.3) == [b, a], "what was read before comes last"
    settled.put_off(a, 7.3)
    assert settled.poll({a: one, b: one}, 7.4) == [b]
    assert settled.poll({}, 7.5) == []
    settled.put_off(a, 7.5)
    assert settled.quiet_s(a, 7.0) == 0.0
