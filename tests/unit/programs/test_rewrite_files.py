"""Rewriting from file to file: bounded memory and memory agree, comments find their line, parts are whole or none."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from polishd.api import ConfigError, ProgramError
from polishd.model.program import Encoding
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import read, rewrite
from polishd.plugins.rnc_robot.verify import verify
from polishd.programs import rewrite as program_files
from polishd.programs.rewrite import DwellTable, RewriteResult, require_new_target, rewrite_file, target_file
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS

HEAD = b"G21 G90 G94\nG0 X0 Y0 Z0\n"
DWELL = HEAD + b"G1 X1 F60\nG4 P1\nG1 X3\nG4 P.5\nM2\n"


def rewritten(
    folder: Path, text: bytes, times: list[float], name: str = "rs274", encoding: Encoding | None = None, **said: bool
) -> tuple[RewriteResult, bytes]:
    """What was written, and its bytes."""
    (folder / "p.rnc").write_bytes(text)
    (folder / "d.csv").write_text("".join(f"{time_s!r}\n" for time_s in times))
    table = DwellTable(folder / "d.csv")
    done = rewrite_file(folder / "p.rnc", table, folder / "new.rnc", dialect(name), encoding, **said)
    return done, (folder / "new.rnc").read_bytes()


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.full
def test_streamed_and_held_write_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    text = HEAD + b"".join(b"G1 X%d F60\nG4 P0.%d\n" % (i, 1 + i % 9) for i in range(1, 400)) + b"M2"
    times = rng.uniform(0.001, 2, 399).tolist()
    monkeypatch.setattr("polishd.plugins.rnc_robot.gcode.rewrite.PIECE_BYTES", 100)
    streamed, one = rewritten(tmp_path, text, times)
    held, other = rewritten(tmp_path, text, times, encoding="dwell")
    assert one == other == rewrite(dialect("rs274"), read(dialect("rs274"), text, "t"), np.array(times))
    assert streamed.points == held.points == 399
    assert streamed.asked_total_s == pytest.approx(sum(times), abs=1e-12)
    assert streamed.dwell_total_s == pytest.approx(held.dwell_total_s, abs=1e-9)
    assert streamed.dwell_total_s == pytest.approx(sum(times), abs=1e-4)
    assert left(tmp_path) == ["d.csv", "new.rnc", "p.rnc"]


@pytest.mark.parametrize("encoding", ["feed", "inverse"])
def test_another_encoding_is_proved_before_it_is_written(tmp_path: Path, encoding: Encoding) -> None:
    done, text = rewritten(tmp_path, DWELL, [2.0, 4.0], encoding=encoding)
    assert done.encoding == encoding
    assert done.dwell_total_s == pytest.approx(6.0, rel=1e-4)
    assert b"G4" not in text
    assert verify(DWELL, text, dialect("rs274")).identical_motion


def test_what_cannot_be_proved_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_files, "rewrite", lambda *_: DWELL.replace(b"X3", b"X4"))
    with pytest.raises(ProgramError, match=re.escape('"G1 X3" became line 5 "G1 X4"')):
        rewritten(tmp_path, DWELL, [1.0, 2.0], encoding="feed")
    assert left(tmp_path) == ["d.csv", "p.rnc"]


@pytest.mark.parametrize("times", [[1.0], [1.0, 2.0, 3.0], [1.0, -1.0], [1.0, 1e99]])
@pytest.mark.parametrize("encoding", [None, "dwell"])
def test_what_does_not_fit_leaves_the_old_file(tmp_path: Path, times: list[float], encoding: Encoding | None) -> None:
    (tmp_path / "new.rnc").write_bytes(b"old")
    with pytest.raises(ProgramError):
        rewritten(tmp_path, DWELL, times, encoding=encoding)
    assert (tmp_path / "new.rnc").read_bytes() == b"old"
    assert left(tmp_path) == ["d.csv", "new.rnc", "p.rnc"]


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("name", "head", "before"),
    [
        ("rs274", b"", 0),
        ("rs274", b"%\n", 1),
        ("rs274", b"\r\n%\r\n", 2),
        ("rs274", b"(x)\n%\n", 0),
        ("fanuc", b"%\nO1234\n", 2),
        ("siemens", b"%_N_PART_MPF\n;$PATH=/_N_WKS_DIR\n", 2),
    ],
)
@pytest.mark.parametrize("encoding", [None, "dwell"])
def test_the_comment_stands_behind_what_must_come_first(
    tmp_path: Path, name: str, head: bytes, before: int, encoding: Encoding | None
) -> None:
    body = {"fanuc": b"G0 X0. Y0. Z0.\nG1 X1. F60.\nG4 X1.\nG1 X2.\nG4 X2.\nM30\n"}.get(
        name, b"G0 X0 Y0 Z0\nG1 X1 F60\nG4 %c1\nG1 X2\nG4 %c2\nM30\n" % (2 * (b"F" if name == "siemens" else b"P",))
    )
    text = head + body
    if b"\r" in head:
        text = head + body.replace(b"\n", b"\r\n")
    _, plain = rewritten(tmp_path, text, [1.0, 2.0], name, encoding)
    assert plain == text
    _, marked = rewritten(tmp_path, text, [1.0, 2.0], name, encoding, comment=True)
    lines = marked.split(b"\n")
    assert re.fullmatch(rb"[(;] ?polishd [0-9.]+, 20[-0-9]{8} [0-9:]{5} UTC: dwell rewritten\)?\r?", lines[before])
    assert lines[before].endswith(b"\r") == text.splitlines(keepends=True)[0].endswith(b"\r\n")
    assert b"\n".join(lines[:before] + lines[before + 1 :]) == text
    found = verify(text, marked, dialect(name))
    assert found.identical_motion
    assert {change.kind for change in found.other_changes} == {"comment"}


def test_a_comment_fits_into_the_shortest_lines(tmp_path: Path) -> None:
    _, marked = rewritten(tmp_path, DWELL, [1.0, 2.0], "grbl", comment=True)
    assert read(dialect("grbl"), marked, "t").n == 2


def test_only_the_first_piece_is_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.plugins.rnc_robot.gcode.rewrite.PIECE_BYTES", 16)
    _, marked = rewritten(tmp_path, DWELL, [1.0, 2.0], comment=True)
    assert marked.count(b"polishd") == 1
    assert marked.startswith(b"(polishd")


def test_what_is_read_back_must_be_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever goes wrong on the way to the disk: the output gets no name before it has been read back."""
    monkeypatch.setattr(program_files, "rewrite_stream", lambda *_, **__: None)
    with pytest.raises(ProgramError, match=r"new\.rnc: the file is empty"):
        rewritten(tmp_path, DWELL, [1.0, 2.0])
    assert left(tmp_path) == ["d.csv", "p.rnc"]


def test_robot_languages_go_through_memory(tmp_path: Path) -> None:
    said = PROGRAMS["urscript"]
    done, text = rewritten(tmp_path, said.text, [0.25, 2.0], "urscript")
    assert (done.encoding, done.points, done.dwell_total_s) == ("dwell", 2, 2.25)
    assert verify(said.text, text, dialect("urscript")).identical_motion
    for wrong in ({"comment": True}, {"encoding": "feed"}):
        with pytest.raises(ProgramError):
            rewritten(tmp_path, said.text, [0.25, 2.0], "urscript", **wrong)  # type: ignore[arg-type]


def long_program(points: int) -> bytes:
    """FANUC TP: two lines a point."""
    body = "".join(
        f"{2 * i + 1:4d}:L P[{i + 1}] 100mm/sec FINE ;\n{2 * i + 2:4d}:WAIT .50(sec) ;\n" for i in range(points)
    )
    places = "".join(
        f"P[{i + 1}]{{\n   GP1:\n\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {i}.000 mm, Y = 0.000 mm, "
        "Z = 0.000 mm,\n\tW = 180.000 deg, P = 0.000 deg, R = 0.000 deg\n};\n"
        for i in range(points)
    )
    return f"/PROG PART\n/ATTR\n/MN\n{body}/POS\n{places}/END\n".encode()


@pytest.fixture
def short_lines(tmp_path: Path) -> str:
    """A FANUC that takes few lines."""
    path = tmp_path / "small.toml"
    path.write_text('extends = "fanuc-tp"\nname = "small"\nline_limit = 11\n')
    return str(path)


def test_a_program_that_is_too_long_becomes_parts(tmp_path: Path, short_lines: str) -> None:
    times = [0.1 * i for i in range(1, 13)]
    done, first = rewritten(tmp_path, long_program(12), times, short_lines)
    assert [path.name for path in done.out] == ["new.rnc", "new_2.rnc", "new_3.rnc"]
    assert left(tmp_path) == ["d.csv", "new.rnc", "new_2.rnc", "new_3.rnc", "p.rnc", "small.toml"]
    found = [read(dialect(short_lines), path.read_bytes(), path.name) for path in done.out]
    assert found[0].text == first
    assert np.concatenate([part.time_s for part in found]) == pytest.approx(times)


def test_of_parts_all_are_written_or_none(tmp_path: Path, short_lines: str) -> None:
    (tmp_path / "new_2.rnc").mkdir()
    with pytest.raises(ProgramError, match=r"new_2\.rnc: "):
        rewritten(tmp_path, long_program(12), [0.5] * 12, short_lines)
    assert left(tmp_path) == ["d.csv", "new_2.rnc", "p.rnc", "small.toml"]


def test_no_part_takes_the_place_of_what_is_read(tmp_path: Path, short_lines: str) -> None:
    source, table = tmp_path / "new_2.rnc", tmp_path / "d.csv"
    source.write_bytes(long_program(12))
    table.write_text("0.5\n" * 12)
    with pytest.raises(ProgramError, match=r"new_2\.rnc: is what is read"):
        rewrite_file(source, DwellTable(table), tmp_path / "new.rnc", dialect(short_lines))
    assert source.read_bytes() == long_program(12)
    assert left(tmp_path) == ["d.csv", "new_2.rnc", "small.toml"]


def test_no_part_replaces_an_existing_file_without_force(tmp_path: Path, short_lines: str) -> None:
    (tmp_path / "new_2.rnc").write_bytes(b"old")
    with pytest.raises(ConfigError, match=r"new_2\.rnc: exists already; name another file, or say --force"):
        rewritten(tmp_path, long_program(12), [0.5] * 12, short_lines, force=False)
    assert (tmp_path / "new_2.rnc").read_bytes() == b"old"
    assert left(tmp_path) == ["d.csv", "new_2.rnc", "p.rnc", "small.toml"]


def test_a_file_gets_its_name_at_the_end_only(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with target_file(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    with pytest.raises(TypeError), target_file(path) as file:
        file.writelines([b"half", "wrong"])  # type: ignore[list-item]
    assert path.read_bytes() == b"new"
    assert left(tmp_path) == ["a"]
    with pytest.raises(ProgramError, match="cannot be written: No such file"), target_file(tmp_path / "none" / "a"):
        pass


@pytest.mark.parametrize("encoding", [None, "dwell"])
def test_nothing_takes_the_place_of_a_pipe(tmp_path: Path, encoding: Encoding | None) -> None:
    os.mkfifo(tmp_path / "new.rnc")
    with pytest.raises(ProgramError, match=r"new\.rnc: cannot be written: it is there, and is no file"):
        rewritten(tmp_path, DWELL, [1.0, 2.0], encoding=encoding)
    assert (tmp_path / "new.rnc").is_fifo()
    assert left(tmp_path) == ["d.csv", "new.rnc", "p.rnc"]


@pytest.mark.parametrize("encoding", [None, "dwell"])
def test_a_program_comes_through_a_pipe(tmp_path: Path, encoding: Encoding | None) -> None:
    _, want = rewritten(tmp_path, DWELL, [2.0, 4.0], encoding=encoding)
    read_end, write_end = os.pipe()
    os.write(write_end, DWELL)
    os.close(write_end)
    table = DwellTable(tmp_path / "d.csv")
    try:
        rewrite_file(Path(f"/dev/fd/{read_end}"), table, tmp_path / "new.rnc", dialect("rs274"), encoding)
    finally:
        os.close(read_end)
    assert (tmp_path / "new.rnc").read_bytes() == want


def test_moves_that_become_points_are_reported_from_the_requested_times(tmp_path: Path) -> None:
    text = DWELL.replace(b"M2", b"X9 F120\nM2")
    done, _ = rewritten(tmp_path, text, [2.0, 4.0], encoding="feed")
    assert (done.rows, done.points) == (2, 3)
    assert done.dwell_total_s == pytest.approx(6.0 + 3.0, rel=1e-4)
    kept, _ = rewritten(tmp_path, text, [2.0, 4.0])
    assert (kept.rows, kept.points) == (2, 2)


def test_a_file_that_is_read_is_known_under_every_name(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_bytes(b"1")
    other.write_bytes(b"1")
    (tmp_path / "link").symlink_to(one)
    (tmp_path / "hard").hardlink_to(one)
    for name in ("one", "link", "hard", "./one"):
        with pytest.raises(ProgramError, match="is what is read"):
            require_new_target(tmp_path / name, other, one)
    require_new_target(other, one)
    require_new_target(tmp_path / "new", one)
    require_new_target(one, tmp_path / "none")
    require_new_target(tmp_path / ("x" * 300), one)  # opening the file reports the error
