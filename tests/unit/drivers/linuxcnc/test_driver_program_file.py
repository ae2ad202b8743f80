"""The program file for LinuxCNC: blocks, pauses, and progress messages."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceRefused
from polishd.drivers.linuxcnc.driver import LinuxCncProgramFile

PROGRAM = [b"G21 G90", b"G0 Z10", b"G1 X1 F60", b"G1 X2", b"G0 Z10", b"M2"]


def test_a_pause_stands_before_each_stop_and_a_word_before_the_end() -> None:
    file = LinuxCncProgramFile(PROGRAM, (2, 4), "t0")
    assert file.text.split(b"\n") == [
        *PROGRAM[:2],
        b"(MSG,polishd t0 2) M0",
        *PROGRAM[2:4],
        b"(MSG,polishd t0 4) M0",
        PROGRAM[4],
        b"(MSG,polishd t0 6)",
        b"M2",
        b"",
    ]
    assert file.stops == (2, 4)


def test_a_program_without_an_end_gets_one() -> None:
    assert LinuxCncProgramFile(PROGRAM[:-1], (), "t").text.endswith(b"G0 Z10\n(MSG,polishd t 5)\nM2\n")


@pytest.mark.parametrize(
    "end", [b"M2", b"M30", b"m02", b"N90 M 3 0 (end)", b"M2.", b"G0 X0 M2", b"%", b"/M30", b"M2;done"]
)
def test_the_word_comes_before_whatever_ends_the_program(end: bytes) -> None:
    lines = LinuxCncProgramFile([b"%", b"G1 X1", end, b"after"], (), "t").text.split(b"\n")
    assert lines[2] == b"(MSG,polishd t 4)"
    assert lines[3] == end


@pytest.mark.parametrize("line", [b"M20", b"(M2)", b"G1 X2 ;M30", b"M3 S20", b"M302", b"G4 P0.2", b"T2 M6"])
def test_what_only_looks_like_an_end(line: bytes) -> None:
    text = LinuxCncProgramFile([line, b"M2"], (), "t").text
    assert text.startswith(line + b"\n(MSG")


def test_stops_that_are_none_are_left_out() -> None:
    assert LinuxCncProgramFile(PROGRAM, (0, 2, 2, 6, 99), "t").stops == (2,)
    assert LinuxCncProgramFile([*PROGRAM, b""], (6,), "t").stops == (), "behind the end nothing stops"


@given(st.integers(1, 40), st.sets(st.integers(0, 45)))
def test_lines_of_the_file_are_the_blocks_they_came_from(count: int, stops: set[int]) -> None:
    blocks = [b"G1 X%d" % at for at in range(count)]
    file = LinuxCncProgramFile(blocks, stops, "t")
    for index, line in enumerate(file.text.split(b"\n")):
        if line.startswith(b"G1"):
            assert blocks[file.block_at(index + 1)] == line
    assert file.block_at(0) == 0
    assert file.block_at(10**6) == count


@pytest.mark.parametrize(
    "message", ["", "OK", "polishd t", "polishd other 3", "polishd t 3 4", "polishd t x", "hi t 3"]
)
def test_words_of_others_are_not_ours(message: str) -> None:
    assert LinuxCncProgramFile(PROGRAM, (), "t").reached(message) is None


def test_our_words_say_how_many_are_executed() -> None:
    assert LinuxCncProgramFile(PROGRAM, (), "t").reached("polishd t 3") == 3


def test_it_is_written_whole_and_others_can_read_it(tmp_path: Path) -> None:
    file = LinuxCncProgramFile(PROGRAM, (), "t")
    (tmp_path / "p.ngc").write_bytes(b"old")
    path = file.write(tmp_path, "p.ngc")
    assert path.read_bytes() == file.text
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceRefused, match=r"nowhere.*program_dir"):
        LinuxCncProgramFile(PROGRAM, (), "t").write(tmp_path / "nowhere", "p.ngc")


def test_nothing_is_left_of_a_file_that_cannot_be_put_there(tmp_path: Path) -> None:
    (tmp_path / "p.ngc").mkdir()
    with pytest.raises(DeviceRefused):
        LinuxCncProgramFile(PROGRAM, (), "t").write(tmp_path, "p.ngc")
    assert [path.name for path in tmp_path.iterdir()] == ["p.ngc"]
