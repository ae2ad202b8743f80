"""Reading RS274 programs: what is right is read right, and every trap is refused by line and reason."""

from __future__ import annotations

import pickle
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import polishd_program_formats
from polishd.plugins.rnc_robot.make import raster_program
from polishd.plugins.rnc_robot.rs274 import read, tool_axis

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


TRAPS = [
    ("variable", "G1 X#1 F60\n", 3, "variables"),
    ("P#1", "G1 X1 F60\nG4 P#1\n", 4, "variables"),
    ("expression", "G1 X1 F60\nG4 P[#1*2]\n", 4, "expressions"),
    ("assignment", "#1=5\n", 3, "variables"),
    ("O-word", "O100 WHILE [1]\n", 3, "O-words"),
    ("named sub", "o<sub> call\n", 3, "O-words"),
    ("o100 alone", "o100\n", 3, "O-words"),
    ("arc", "G2 X1 Y1 I1 J0 F60\n", 3, "arcs"),
    ("arc by radius", "G3 X1 R1 F60\n", 3, "arcs"),
    ("tool vector", "G1 X1 I0 J0 K1 F60\n", 3, "I, J, K"),
    ("per revolution", "G95\n", 3, "revolution"),
    ("surface speed", "G96 S100\n", 3, "spindle"),
    ("dwell in revolutions", "G1 X1 F60\nG4 S10\n", 4, "revolutions"),
    ("G4 F", "G1 X1 F60\nG4 F1.5\n", 4, "another dialect"),
    ("G4 X", "G1 X1 F60\nG4 X1.5\n", 4, "dwell and axes"),
    ("G4 U", "G1 X1 F60\nG4 U1.5\n", 4, "U is not known"),
    ("G4 T", "G1 X1 F60\nG4 T1\n", 4, "tool change"),
    ("G4 alone", "G1 X1 F60\nG4\n", 4, "without P"),
    ("bare G04 3.0", "G1 X1 F60\nG04 3.0\n", 4, "is not known"),
    ("dwell and motion", "G1 X1 F60\nG4 P1 X2\n", 4, "dwell and axes"),
    ("negative dwell", "G1 X1 F60\nG4 P-1\n", 4, "below zero"),
    ("two dwells", "G1 X1 F60\nG4 P1\nG4 P2\n", 5, "two dwells"),
    ("P alone", "G1 X1 F60 P3\n", 3, "P without G4"),
    ("G4 and G64", "G1 X1 F60\nG4 G64 P3\n", 4, "whose P"),
    ("block delete", "/G1 X1 F60\n", 3, "block delete"),
    ("checksum", "N1 G1 X1 F60*71\n", 3, "checksums"),
    ("unknown G", "G1 X1 F60\nG28\n", 4, "G28 is not known"),
    ("G92", "G92 X0\n", 3, "G92 is not known"),
    ("G55", "G55\n", 3, "G55 is not known"),
    ("G1.5", "G1.5 X1 F60\n", 3, "G1.5 is not known"),
    ("unknown M", "M66\n", 3, "M66 is not known"),
    ("stop for a person", "M0\n", 3, "person"),
    ("tool", "T1 M6\n", 3, "tool change"),
    ("B axis", "G1 X1 B3 F60\n", 3, "B axis"),
    ("unknown word", "G1 X1 Q3 F60\n", 3, "Q is not known"),
    ("exponent", "G1 X1e1 F60\n", 3, "E is not known"),
    ("word without number", "G1 X F60\n", 3, "X without a number"),
    ("twice", "G1 X1 X2 F60\n", 3, "twice"),
    ("two motions", "G0 G1 X1 F60\n", 3, "contradict"),
    ("N late", "G1 X1 N5 F60\n", 3, "N is not the first"),
    ("open comment", "G1 X1 F60 (no end\n", 3, "not closed"),
    ("nested comment", "G1 X1 F60 (a (b) c)\n", 3, "not closed"),
    ("comment in a number", "G1 X(ten)10 F60\n", 3, "X without a number"),
    ("stray closing", "G1 X1 F60 )\n", 3, "without its ("),
    ("number alone", "12.5\n", 3, "no RS274"),
    ("two points", "G1 X1.2.3 F60\n", 3, "no RS274"),
    ("non-ASCII outside comments", "G1 X1 F60 \u00e9\n", 3, "no RS274"),
    ("percent with text", "%_N_PART_MPF\n", 3, "% stands alone"),
    ("absurd number", "G1 X1 F99999999999999\n", 3, "beyond any machine"),
    ("no F", "G1 X1\n", 3, "without F"),
    ("F zero", "G1 X1 F0\n", 3, "not above zero"),
    ("F negative", "G1 X1 F-60\n", 3, "not above zero"),
    ("inverse without F", "G93 G1 X1 F60\nX2\n", 4, "without F"),
    ("F lost by G93 to G94", "G93 G1 X1 F60\nG94\nG1 X2\n", 5, "without F"),
    ("F lost by inch", "F60\nG20\nG1 X1\n", 5, "without F"),
    ("F beside inch", "G20 F60\nG1 X1\n", 3, "change of units"),
    ("G93 and G94", "G93 G1 X1 F60\nG94 X2 F60\n", 4, "two places"),
    ("G93 and dwell", "G93 G1 X1 F60\nG4 P1\n", 3, "two places"),
    ("few dwells among feeds", "G1 X1 F60\nG4 P1\nX2\nX3\nX4\nX5\nX6\nX7\n", 5, "two places"),
    ("turning on the spot", "G1 A5 F60\n", 3, "turns on the spot"),
    ("axes after G80", "G80\nX1 F60\n", 4, "before any G0 or G1"),
    ("long line", "G1 X1 F60 (" + "x" * 250 + ")\n", 3, "longer than 255"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("body", "line", "reason"), [case[1:] for case in TRAPS], ids=[case[0] for case in TRAPS]
)  # fmt: skip
def test_traps(body: str, line: int, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        program(body)
    message = str(caught.value)
    assert message.startswith(f"t.rnc, line {line}: ")
    assert reason in message
    assert "To do: " in message


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
    (b"G1 X1 Y1 Z1 F60\nM2\n", "nobody knows what X"),
    (b"X1 F60\nM2\n", "before any G0 or G1"),
    (b"G91 G0 X1\nM2\n", "nobody said where X is"),
    (b"G0 X0 Y0\nG1 X1 F60\nG0 Z5\nM2\n", "Z is said only later"),
    (b"G0 X0 Y0 Z0\nG1 X1 F60\nG0 A5\nM2\n", "A is said only later"),
]


@pytest.mark.parametrize(("text", "reason"), BROKEN_FILES)
def test_broken_files(text: bytes, reason: str) -> None:
    with pytest.raises(ProgramError) as caught:
        read(text, "t.rnc")
    assert reason in str(caught.value)
    assert "t.rnc" in str(caught.value)


@pytest.mark.parametrize("end", ["M2", "M2\n", "M30\r\n", "M02 (end)", "%", "%\n", "M2\n%\n", "m2 ; \u00e9\n\n\n"])
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
        "nobody said G21", "nobody said G90", "nobody said G94", "nobody said where Z is",
    }  # fmt: skip
    assert program("G1 X1 F60\n").warnings == ()


def test_tool_axis_is_upright_without_angles() -> None:
    np.testing.assert_array_equal(program("G1 X1 F60\n").axis, [[0, 0, 1]])
    np.testing.assert_allclose(tool_axis(np.array([90.0]), np.array([0.0])), [[0, -1, 0]], atol=1e-15)


def test_the_format_is_picklable() -> None:
    (fmt,) = polishd_program_formats()
    again = pickle.loads(pickle.dumps(fmt))
    assert again.name == "rs274"
    assert again.read(HEAD.encode() + b"G1 X1 F60\nM2", "x").n == 1


def test_ten_thousand_lines_are_quick() -> None:
    n = 10_000
    points = np.stack([np.linspace(-50, 50, n), np.sin(np.arange(n)), np.zeros(n)], axis=1)
    text = raster_program(points, np.tile([0.0, 0.1, 0.995], (n, 1)), 600.0, "big")
    seconds = []
    for _ in range(3):
        start = time.process_time()
        read(text, "big")
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.3


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
