"""The robot controller's own reader of blocks."""

from __future__ import annotations

import pytest

from polishd.model.errors import ProgramError
from polishd.sim_backends.robot.program_reader import Reader, SimProgramBlock

HOME = (0.0, 0.0, 50.0, 0.0, 0.0)


def read(*lines: str) -> list[SimProgramBlock]:
    reader = Reader(HOME)
    return [reader.read(line.encode()) for line in lines]


def test_modal_motion_and_feed() -> None:
    blocks = read("G21 G90 G94", "G0 X1 Y2", "G1 Z0 F600", "X3")
    assert [block.kind for block in blocks] == ["none", "move", "move", "move"]
    assert blocks[1] == SimProgramBlock("move", (1.0, 2.0, 50.0, 0.0, 0.0), 0.0)
    assert blocks[2].rate == 10.0
    assert blocks[3] == SimProgramBlock("move", (3.0, 2.0, 0.0, 0.0, 0.0), 10.0)


def test_rotary_axes() -> None:
    assert read("G1 X1 A15 C-120.5 F60")[0].end == (1.0, 0.0, 50.0, 15.0, -120.5)


def test_inverse_time_wants_f_on_each_block() -> None:
    first, second = read("G93 G1 X1 F120", "X2 F30")
    assert (first.rate, first.inverse) == (0.5, True)
    assert second.rate == 2.0
    with pytest.raises(ProgramError, match="without F"):
        read("G93 G1 X1 F120", "X2")


def test_feed_does_not_survive_a_change_of_its_meaning() -> None:
    with pytest.raises(ProgramError, match="without F"):
        read("G1 X1 F120", "G93", "G94 X2")


def test_inch_and_incremental() -> None:
    blocks = read("G20 G91 G1 X1 F60", "X1", "A5", "G90 X0")
    assert blocks[0].end[0] == pytest.approx(25.4)
    assert blocks[0].rate == pytest.approx(25.4)
    assert blocks[1].end[0] == pytest.approx(50.8)
    assert blocks[2].end[3] == 5.0
    assert blocks[3].end[0] == 0.0


@pytest.mark.parametrize("line", ["G4 P0.75", "P.75 G4", "g 4 p 0 . 7 5", "N10 G04 P0.75 (G4 P9)", "G4P+0.75;P9"])
def test_dwell(line: str) -> None:
    assert read(line)[0] == SimProgramBlock("dwell", HOME, 0.75)


@pytest.mark.parametrize("line", ["", "%", "  ", "(only a comment)", "; G1 X5", "N7", "N7 G17 G40 G64"])
def test_lines_that_do_nothing(line: str) -> None:
    assert read(line)[0] == SimProgramBlock("none", HOME)


def test_pause_and_end() -> None:
    blocks = read("M0", "M2", "G1 X5 F60 but this is not read")
    assert [block.kind for block in blocks] == ["pause", "none", "none"]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("G2 X1 Y1 I1", "cannot read"),
        ("G5", "G or M word"),
        ("M6", "G or M word"),
        ("X1", "before G0"),
        ("G1 X1", "without F"),
        ("G1 X1 F0", "above 0"),
        ("G4", "wants P"),
        ("G4 P-1", "wants P"),
        ("G4 P1 X1", "beside motion"),
        ("G4 X1", "beside motion"),
        ("G1 X1 P2 F60", "P without G4"),
        ("G0 G1 X1 F60", "one group"),
        ("G1 X1 X2 F60", "X twice"),
        ("G1 X#1 F60", "cannot read"),
        ("G1 X[1+2] F60", "cannot read"),
        ("/G1 X1 F60", "cannot read"),
        ("o100 while", "cannot read"),
        ("G1 X1 F60 M2", "beside motion"),
        ("(open G1 X1", "cannot read"),
    ],
)
def test_what_is_not_understood_is_refused(line: str, why: str) -> None:
    with pytest.raises(ProgramError, match=why):
        read(line)


def test_bytes_beyond_ascii_outside_comments_are_refused() -> None:
    with pytest.raises(ProgramError):
        Reader(HOME).read(b"G1 X1 \xff F60")
