"""Reading RS274 programs: what is right is read right, and every trap is refused by line and reason."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import polishd_program_formats
from polishd.plugins.rnc_robot.gcode.checks import tool_axis
from polishd.plugins.rnc_robot.gcode.time_words import Scanner
from tests.rs274 import DIALECT, read

HEAD = "G21 G90 G94\nG0 X0 Y0 Z0\n"


def program(body: str, *, head: str = HEAD, end: str = "M2\n") -> Program:
    return read((head + body + end).encode(), "t.rnc")


GOOD = [
    ("feed", "G1 X1 F60\n", [1.0]),
    ("modal F", "G1 X1 F60\nX2\nX4\n", [1.0, 1.0, 2.0]),
    ("F of an earlier block", "F120\nG1 X1\n", [0.5]),
    ("F of a rapid", "G0 Z0 F30\nG1 X1\n", [2.0]),
    ("trailing point", "G1 X1 F1500.\n", [0.04]),
    ("leading point", "G1 X.5 F60.\n", [0.5]),
    ("lower case", "g1 x1 f60\n", [1.0]),
    ("no blanks", "G1X1F60\n", [1.0]),
    ("blanks inside numbers", "G 1 X 1 0 . 5 F 6 0\n", [10.5]),
    ("leading zeros", "G01 X001 F0060\n", [1.0]),
    ("N words", "N10 G1 X1 F60\nN20 X2\n", [1.0, 1.0]),
    ("comments with traps", "G1 X1 F60 (G4 P9) ; G4 P9 #1 /\n", [1.0]),
    ("comment between words", "G1 (a) X1 (b) F60\n", [1.0]),
    ("plus signs", "G1 X+1 F+60\n", [1.0]),
    ("tabs", "\tG1\tX1\tF60\t\n", [1.0]),
    ("inch", "G20\nG1 X1 F60\n", [1.0]),
    ("incremental", "G91 G1 X1 F60\nX1 Y1\n", [1.0, 2**0.5]),
    ("spindle and coolant", "S1000 M3 M8\nG1 X1 F60\nM5 M9\n", [1.0]),
    ("path modes", "G64 P0.01\nG1 X1 F60\nG61.1\nX2\n", [1.0, 1.0]),
    ("inverse", "G93 G1 X1 F60\nX2 F120\n", [1.0, 0.5]),
    ("inverse, turning on the spot", "G93 G1 A5 F60\n", [1.0]),
    ("dwell", "G1 X1 F60\nG4 P0.25\nG1 X2\nG4 P.5\n", [0.25, 0.5]),
    ("dwell with blanks", "G1 X1 F60\ng 4 p 0 . 7 5\n", [0.75]),
    ("P before G4", "G1 X1 F60\nP0.5 G4\n", [0.5]),
    ("dwell of zero", "G1 X1 F60\nG4 P0\n", [0.0]),
    ("dwell after a rapid is no point", "G4 P3\nG1 X1 F60\nG4 P1\nG0 Z9\nG4 P5\n", [1.0]),
    ("dwell before all feed moves", "G4 P3\nG1 X1 F60\n", [1.0]),
    ("a move in and a move out without dwell", "G1 Z-1 F60\nG1 X1\nG4 P2\nX2\nG4 P3\nG1 Z5\n", [2.0, 3.0]),
    ("a move that goes nowhere", "G1 X1 F60\nG1 X1\nX2\n", [1.0, 1.0]),
]


@pytest.mark.parametrize(("body", "times"), [case[1:] for case in GOOD], ids=[case[0] for case in GOOD])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_good(body: str, times: list[float], newline: str) -> None:
    text = (HEAD + body + "M2\n").replace("\n", newline).encode()
    found = read(text, "t.rnc")
    np.testing.assert_allclose(found.time_s, times, rtol=1e-12)
    assert found.text == text
    assert (found.block == found.line - 1).all()
    assert all(b"." in found.blocks[i] or found.blocks[i].strip() for i in found.block)


BROKEN_FILES = [
    (b"", "empty"),
    (b" \r\n\n", "empty"),
    (b"\x7fELF\x02\x01\x01\x00", "no text"),
    (b"G1 X1 F60\x00\nM2", "line 1: byte 0x00"),
    ("G21\nG0 X0\n".encode("utf-16"), "byte order mark"),
    (b"\xef\xbb\xbfG21\nM2\n", "byte order mark"),
    (b"G21\rG0 X0\rM2\r", "carriage returns"),
    (HEAD.encode() + b"G1 X1 F60\nX2\n", "without M2"),
    (HEAD.encode() + b"G1 X1 F60\nX2", 'cut short: "X2"'),
    (b"%\n" + HEAD.encode() + b"G1 X1 F60\n", "without M2"),
    (HEAD.encode() + b"M2\n", "nothing in it carries time"),
    (HEAD.encode() + b"G0 X1\nG4 P1\nG0 X2\nG4 P1\nM2\n", "nothing in it carries time"),
    (b"G1 X1 Y1 Z1 F60\nM2\n", "from an unknown X"),
    (b"X1 F60\nM2\n", "before any G0 or G1"),
    (b"G91 G0 X1\nM2\n", "G91 before any absolute position"),
    (b"G0 X0 Y0\nG1 X1 F60\nG0 Z5\nM2\n", "a point before Z is stated"),
    (b"G0 X0 Y0 Z0\nG1 X1 F60\nG0 A5\nM2\n", "a point before A is stated"),
]


@pytest.mark.parametrize(("text", "reason"), BROKEN_FILES)
def test_broken_files(text: bytes, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        read(text, "t.rnc")
    assert reason in str(caught.value)
    assert "t.rnc" in str(caught.value)


@pytest.mark.parametrize("end", ["M2", "M2\n", "M30\r\n", "M02 (end)", "M2\n%\n", "m2 ; \u00e9\n\n\n"])
def test_ends(end: str) -> None:
    assert program("G1 X1 F60\n", end=end).n == 1


def test_what_follows_the_end_is_not_read() -> None:
    found = program("G1 X1 F60\n", end="M2\nG1 X#9 \u00e9 [\nG4 P5\n")
    assert found.n == 1
    assert any("after the program's end (line 4)" in warning for warning in found.warnings)
    found = program("G1 X1 F60\n", head="%\n" + HEAD, end="%\nG1 X5\n")
    assert (found.n, len(found.warnings)) == (1, 1)


def test_a_motion_in_the_last_block_counts() -> None:
    assert program("G1 X1 F60\n", end="G1 X3 M2").time_s.tolist() == [1.0, 2.0]


def test_mixed_line_ends_and_bytes_in_comments() -> None:
    text = b"%\r\nG21 G90 G94 (\xe9\xff)\nG0 X0 Y0 Z0\r\n\r\nG1 X1 F60 ;\x80\n\nX2\r\nM30"
    found = read(text, "t.rnc")
    assert found.line.tolist() == [5, 7]
    assert found.lines == 8
    assert found.blocks[4].startswith(b"G1 X1")


def test_columns() -> None:
    found = program("G0 X1 Y2 Z3 A10 C90\nG1 X4 Y6 A20 F300\nG0 Z50\nG1 Z3 F600\n")
    np.testing.assert_array_equal(found.start_mm, [[1, 2, 3], [4, 6, 50]])
    np.testing.assert_array_equal(found.end_mm, [[4, 6, 3], [4, 6, 3]])
    np.testing.assert_allclose(found.length_mm, [5, 47])
    np.testing.assert_allclose(found.axis, [[np.sin(np.radians(20)), 0, np.cos(np.radians(20))]] * 2, atol=1e-15)
    np.testing.assert_allclose(found.time_s, [1.0, 4.7])
    assert (found.encoding, found.dialect, found.name) == ("feed", "rs274", "t.rnc")
    assert found.max_feed_mm_min == pytest.approx(600)


def test_dwells_are_on_the_spot() -> None:
    found = program("G1 X1 F60\nG4 P2\nG1 X2 F90\nG4 P1\n")
    assert found.encoding == "dwell"
    assert found.line.tolist() == [4, 6]
    np.testing.assert_array_equal(found.start_mm, [[1, 0, 0], [2, 0, 0]])
    np.testing.assert_array_equal(found.start_mm, found.end_mm)
    assert found.max_feed_mm_min == 90


def test_inches() -> None:
    found = program("G20\nG0 X1 Y1 Z1\nG1 X2 F10\n")
    np.testing.assert_allclose(found.end_mm, [[50.8, 25.4, 25.4]])
    assert found.time_s.tolist() == pytest.approx([6.0])
    assert found.max_feed_mm_min == pytest.approx(254)


def test_what_is_assumed_is_said() -> None:
    found = program("G0 X0 Y0\nG1 X1 F60\n", head="")
    assert {warning.split(":")[0] for warning in found.warnings} == {
        "no G21 in the program", "no G90 in the program", "no G94 in the program", "the program does not state Z",
    }  # fmt: skip
    assert program("G1 X1 F60\n").warnings == ()


def test_tool_axis_is_upright_without_angles() -> None:
    np.testing.assert_array_equal(program("G1 X1 F60\n").axis, [[0, 0, 1]])
    np.testing.assert_allclose(
        tool_axis("CA", np.array([90.0]), np.zeros(1), np.array([0.0])), [[0, -1, 0]], atol=1e-15
    )


def test_the_format_is_picklable() -> None:
    formats = pickle.loads(pickle.dumps(polishd_program_formats([])))
    again = formats[0]
    assert again.name == "rs274"
    assert again.read(HEAD.encode() + b"G1 X1 F60\nM2", "x").n == 1


def test_a_line_without_end_is_refused_before_it_is_gathered() -> None:
    taken = 0

    def chunks() -> Iterator[bytes]:
        nonlocal taken
        for _ in range(1000):
            taken += 1
            yield b"G1 X1 " * 100

    with pytest.raises(ProgramError, match="line 1: the line is longer"):
        list(Scanner(DIALECT, "t.rnc").pieces(chunks()))
    assert taken <= 2


WORDS = st.sampled_from(
    [
        "G0",
        "G1",
        "G4",
        "G20",
        "G21",
        "G90",
        "G91",
        "G93",
        "X1",
        "X-2.5",
        "Y.5",
        "Z0",
        "A1",
        "F60",
        "P1",
        "P0.5",
        "(c)",
        ";",
        "#1",
        "%",
        "M2",
        "N1",
        "[",
        "O1",
        "é",
        "\r",
        "\0",
        " ",
    ]
)


@given(st.lists(st.lists(WORDS, max_size=5).map(" ".join), max_size=12).map("\n".join))
def test_anything_is_read_or_refused(text: str) -> None:
    try:
        found = read(text.encode(), "t.rnc")
    except ProgramError as error:
        assert "t.rnc" in str(error)  # noqa: PT017  it may also be read
    else:
        assert np.isfinite(found.time_s).all()
        assert np.isfinite(found.end_mm).all()


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(text: bytes) -> None:
    with pytest.raises(ProgramError):
        read(text, "t.rnc")
