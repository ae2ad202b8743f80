"""A corpus of traps from real RNC files: each is read with the right seconds, or refused by line. Never 1000 times off.

Each entry is a whole small program, so that it can be fed to another reader as it stands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from polishd.api import ProgramError
from tests.rs274 import read, rewrite

START = b"G21 G90 G94\nG0 X0 Y0 Z0\n"
MOVED = START + b"G1 X1 F60\n"
END = b"M2\n"


class Good(NamedTuple):
    """A program that says one thing only, and what that is."""

    name: str
    text: bytes
    seconds: list[float]
    """Time of each timed point."""
    lines: list[int]
    """1-based lines."""
    rewritten: bytes | None = None
    """The text once the first point is given 1.25 s; None where its own style is shown elsewhere."""


class Bad(NamedTuple):
    """A program that may mean several things, or none."""

    name: str
    text: bytes
    line: int
    reason: str


def dwell(name: str, line: bytes, seconds: float, rewritten: bytes | None = None) -> Good:
    """One dwell on line 4."""
    new = None if rewritten is None else MOVED + rewritten + b"\n" + END
    return Good(name, MOVED + line + b"\n" + END, [seconds], [4], new)


def feed(name: str, line: bytes, seconds: float, rewritten: bytes | None = None) -> Good:
    """One feed move on line 3."""
    new = None if rewritten is None else START + rewritten + b"\n" + END
    return Good(name, START + line + b"\n" + END, [seconds], [3], new)


def bad_dwell(name: str, line: bytes, reason: str) -> Bad:
    """Something on line 4, after a feed move."""
    return Bad(name, MOVED + line + b"\n" + END, 4, reason)


def bad_feed(name: str, line: bytes, reason: str) -> Bad:
    """Something on line 3, before any feed move."""
    return Bad(name, START + line + b"\n" + END, 3, reason)


GOOD = [
    # dwell: P is seconds, whatever it looks like in another dialect
    dwell("P is seconds", b"G4 P0.5", 0.5, b"G4 P1.25"),
    dwell("P of 500 without a point is 500 s, not ms", b"G4 P500", 500.0, b"G4 P1.25"),
    dwell("P of 500 with a point is the same", b"G4 P500.", 500.0, b"G4 P1.25"),
    dwell("P of 1500.0", b"G04 P1500.0", 1500.0, b"G04 P1.25"),
    dwell("a millisecond", b"G4 P0.001", 0.001, b"G4 P1.250"),
    dwell("P without a leading zero", b"G4 P.5", 0.5, b"G4 P1.25"),
    dwell("P with leading zeros", b"G4 P000.50", 0.5, b"G4 P001.25"),
    dwell("P with a plus", b"G4 P+0.5", 0.5, b"G4 P+1.25"),
    dwell("P after a comment that looks like it", b"(G4 P9) G4 P0.5", 0.5, b"(G4 P9) G4 P1.25"),
    dwell("comment between G4 and P", b"G4 (P9) P0.5", 0.5, b"G4 (P9) P1.25"),
    dwell("semicolon comment with a dwell", b"G4 P0.5 ; G4 P9", 0.5, b"G4 P1.25 ; G4 P9"),
    dwell("semicolon comment with a parenthesis", b"G4 P0.5 ;(P9", 0.5, b"G4 P1.25 ;(P9"),
    dwell("parenthesis with a semicolon", b"(a;b) G4 P0.5", 0.5, b"(a;b) G4 P1.25"),
    dwell("comment with a variable", b"G4 P0.5 (P#1)", 0.5, b"G4 P1.25 (P#1)"),
    dwell("comment with bytes beyond ASCII", b"G4 P0.5 (\xfcber \xb5m)", 0.5, b"G4 P1.25 (\xfcber \xb5m)"),
    dwell("P before G4", b"P0.5 G4", 0.5, b"P1.25 G4"),
    dwell("blanks inside everything", b"g 4 p 0 . 7 5", 0.75, b"g 4 p 1.25"),
    dwell("tabs for blanks", b"\tG4\tP0.75\t", 0.75, b"\tG4\tP1.25\t"),
    dwell("no blanks at all", b"N40G4P0.75", 0.75, b"N40G4P1.25"),
    dwell("N word with a number like a dwell", b"N9 G4 P0.75", 0.75, b"N9 G4 P1.25"),
    dwell("lower case", b"g04 p0.75", 0.75, b"g04 p1.25"),
    dwell("G with a point", b"G4.0 P0.75", 0.75, b"G4.0 P1.25"),
    dwell("dwell of nothing", b"G4 P0", 0.0, b"G4 P1.25"),
    dwell("nine decimals", b"G4 P0.123456789", 0.123456789),
    dwell("carriage return", b"G4 P0.5\r", 0.5, b"G4 P1.25\r"),
    # feed: seconds are 60 L / F, where L and F count in the same unit
    feed("F with a trailing point", b"G1 X25 F1500.", 1.0, b"G1 X25 F1200."),
    feed("F without a point", b"G1 X25 F1500", 1.0, b"G1 X25 F1200"),
    feed("F before G1", b"F1500 G1 X25", 1.0, b"F1200 G1 X25"),
    feed("F below one", b"G1 X1 F.5", 120.0, b"G1 X1 F48.0"),
    feed("lower case feed", b"g1x25f1500", 1.0, b"g1x25f1200"),
    feed("blanks inside the feed", b"G1 X25 F1 500", 1.0, b"G1 X25 F1200"),
    feed("leading zeros of codes", b"G01 X025 F01500", 1.0),
    feed("comment that holds a feed", b"G1 X25 (F9) F1500 ; F9", 1.0, b"G1 X25 (F9) F1200 ; F9"),
    feed("comment that holds an M2", b"G1 X25 F1500 (M2)", 1.0, b"G1 X25 F1200 (M2)"),
    feed("length over three axes", b"G1 X2 Y3 Z6 F420", 1.0, b"G1 X2 Y3 Z6 F336"),
    feed("turning while moving does not lengthen it", b"G1 X25 A30 C90 F1500", 1.0, b"G1 X25 A30 C90 F1200"),
    Good("modal F", START + b"G1 X1 F60\nX3\nX6\n" + END, [1.0, 2.0, 3.0], [3, 4, 5]),
    Good("F in a separate line", START + b"F60\nG1 X1\n" + END, [1.0], [4]),
    Good("F of a rapid governs the next feed move", START + b"G0 Z0 F60\nG1 X1\n" + END, [1.0], [4]),
    Good("modal G1", START + b"G1 X1 F60\nY2\n" + END, [1.0, 2.0], [3, 4]),
    Good("inches: length and feed alike", b"G20 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\n" + END, [1.0], [3]),
    Good("incremental", b"G21 G90 G94\nG0 X5 Y0 Z0\nG91 G1 X1 F60\nX1\n" + END, [1.0, 1.0], [3, 4]),
    Good("G93: F20 is 3 s, not 20 s", START + b"G93 G1 X1 F20\nX9 F20\n" + END, [3.0, 3.0], [3, 4]),
    Good("G93 is blind to units", b"G20 G90\nG0 X0 Y0 Z0\nG93 G1 X1 F30\n" + END, [2.0], [3]),
    Good("G94 that only says what is so", START + b"G94 G1 X1 F60\n" + END, [1.0], [3]),
    Good("distance mode changes on the way", START + b"G1 X1 F60\nG91 X1\nG90 X5\n" + END, [1.0, 1.0, 3.0], [3, 4, 5]),
    # the file around the blocks
    Good("CRLF", (MOVED + b"G4 P0.5\n" + END).replace(b"\n", b"\r\n"), [0.5], [4]),
    Good("LF and CRLF mixed", START + b"G1 X1 F60\r\nG4 P0.5\nM2\r\n", [0.5], [4]),
    Good("no final newline", MOVED + b"G4 P0.5\nM2", [0.5], [4]),
    Good("percent before and after", b"%\n" + MOVED + b"G4 P0.5\n%\n", [0.5], [5]),
    Good("percent with blanks", b" % \r\n" + MOVED + b"G4 P0.5\nM30\n%", [0.5], [5]),
    Good("empty lines and comment lines", b"\n(a)\n" + MOVED + b"\n; G4 P9\nG4 P0.5\n" + END, [0.5], [8]),
    Good("text after M2 is not a program", MOVED + b"G4 P0.5\nM2\nG4 P500\nG1 X#9 [\xe9\n", [0.5], [4]),
    Good("M30 ends it too", MOVED + b"G4 P0.5\nM30\nG4 P500\n", [0.5], [4]),
    Good("an M2 inside a comment does not", MOVED + b"(M2) G4 P0.5\n" + END, [0.5], [4]),
    Good("a dwell before the first feed move is no point", START + b"G4 P500\nG1 X1 F60\nG4 P0.5\n" + END, [0.5], [5]),
    Good("a dwell after an inverse-time move", START + b"G93 G1 X1 F60\nG4 P0.5\n" + END, [0.5], [4]),
    Good("a dwell after a rapid is no point", MOVED + b"G4 P0.5\nG0 Z9\nG4 P500\n" + END, [0.5], [4]),
]

BAD = [
    # dwells of other dialects
    bad_dwell("Fanuc X", b"G4 X1.5", "dwell and axes"),
    bad_dwell("Fanuc X without a point: s or ms", b"G04 X1500", "dwell and axes"),
    bad_dwell("Fanuc U", b"G04 U1.5", "another dialect"),
    bad_dwell("SINUMERIK F is no feed", b"G4 F1.5", "another dialect"),
    bad_dwell("SINUMERIK F beside P", b"G4 P1 F1.5", "another dialect"),
    bad_dwell("SINUMERIK revolutions", b"G4 S10", "revolutions"),
    bad_dwell("TwinCAT's bare number", b"G04 3.0", "a blank inside"),
    bad_dwell("TwinCAT's #TIME", b"#TIME 2.5", "variables"),
    bad_dwell("CODESYS T", b"G4 T1", "tool change"),
    bad_dwell("CODESYS Time=", b"G4 Time=0.5", "Time"),
    bad_dwell("RAPID", b"WaitTime 0.5;", "WaitTime"),
    bad_dwell("KRL", b"WAIT SEC 0.5", "WAIT"),
    bad_dwell("FANUC TP", b"WAIT .50(sec) ;", "WAIT"),
    bad_dwell("URScript", b"sleep(0.5)", "sleep"),
    bad_dwell("decimal comma", b"G4 P0,5", "comma"),
    bad_dwell("exponent", b"G4 P5e-1", "exponents"),
    bad_dwell("unit behind the number", b"G4 P500ms", "ms"),
    bad_dwell("a dwell below zero", b"G4 P-0.5", "below zero"),
    bad_dwell("G4 alone", b"G4", "without its time"),
    bad_dwell("P of nothing", b"G4 P", "P without a number"),
    bad_dwell("P of a lone point", b"G4 P.", "P without a number"),
    bad_dwell("P twice", b"G4 P1 P2", "twice"),
    bad_dwell("P that has no G4", b"P0.5", "P without G4"),
    bad_dwell("dwell and motion in one block", b"G4 P1 X2", "dwell and axes"),
    bad_dwell("dwell and G1 in one block", b"G1 X2 G4 P1", "dwell and axes"),
    bad_dwell("P of a variable", b"G4 P#1", "variables"),
    bad_dwell("P of a named variable", b"G4 P#<pause>", "variables"),
    bad_dwell("P of an expression", b"G4 P[#1*2]", "expressions"),
    bad_dwell("a loop around it", b"O100 REPEAT [10]", "O-words"),
    bad_dwell("a call", b"o<wait> call [0.5]", "sub-programs"),
    bad_dwell("block delete", b"/G4 P0.5", "block delete"),
    bad_dwell("block delete by number", b"/2 G4 P0.5", "block delete"),
    bad_dwell("block delete after N", b"N40 /G4 P0.5", "block delete"),
    bad_dwell("checksum", b"G4 P0.5*71", "checksums"),
    bad_dwell("comment that never ends", b"G4 P0.5 (G4 P9", "not closed"),
    bad_dwell("comment in a comment", b"(a (b) P9) G4 P0.5", "not closed"),
    bad_dwell("byte beyond ASCII outside comments", b"G4 P0.5\xb5", "no word"),
    bad_dwell("no-break space", b"G4\xa0P0.5", "holds the byte 0xa0, which is no word"),
    bad_dwell("no-break space in UTF-8", "G4\u00a0P0.5".encode(), "holds U+00A0 (no-break space), which is no word"),
    bad_dwell("Cyrillic P", "G4 \u0420.5".encode(), "holds U+0420 (cyrillic capital letter er), which is no word"),
    bad_dwell("minus sign of a word processor", "G4 P\u22120.5".encode(), "P without a number"),
    bad_dwell("a byte that is no text", b"G4 P0.5\x1a", "no word"),
    bad_dwell("macro call with P", b"G65 P9010", "G65 is not known"),
    bad_dwell("sub-program with P", b"M98 P100", "M98 is not known"),
    bad_dwell("G4.1", b"G4.1 P0.5", "G4.1 is not known"),
    bad_dwell("a wait for a person", b"M0", "person"),
    Bad("two dwells at one point", MOVED + b"G4 P1\nG4 P2\n" + END, 5, "two dwells"),
    # feeds
    bad_feed("no F anywhere", b"G1 X25", "without F"),
    bad_feed("F of zero", b"G1 X25 F0", "not above zero"),
    bad_feed("F of zero with decimals", b"G1 X25 F0.000", "not above zero"),
    bad_feed("F below zero", b"G1 X25 F-60", "not above zero"),
    bad_feed("F of a variable", b"G1 X25 F#1", "variables"),
    bad_feed("F twice", b"G1 X25 F60 F1500", "twice"),
    bad_feed("feed per revolution", b"G95 G1 X25 F0.1", "revolution"),
    bad_feed("surface speed", b"G96 S100", "spindle"),
    bad_feed("an arc's length is not its chord", b"G2 X1 Y1 I1 J0 F60", "an arc, and time sits"),
    bad_feed("turning on the spot at mm/min", b"G1 A30 F60", "turns on the spot"),
    bad_feed("F beside a change to inches", b"G20 F60", "change of units"),
    Bad("F does not outlive a change to inches", START + b"F60\nG20\nG1 X1\n" + END, 5, "without F"),
    Bad("F of G94 is none of G93", START + b"F60\nG93\nG1 X1\n" + END, 5, "without F"),
    Bad("in G93 F is not modal", START + b"G93 G1 X1 F60\nX2\n" + END, 4, "without F"),
    Bad("G93 and G94 in one file", START + b"G93 G1 X1 F60\nG94 X2 F60\n" + END, 4, "two places"),
    Bad("G91 from nowhere", b"G21 G91\nG1 X1 F60\n" + END, 2, "G91 before any absolute position"),
    Bad("an absolute move from nowhere", b"G21 G90\nG1 X1 F60\n" + END, 2, "from an unknown X"),
    Bad("no end: the file may be cut", MOVED + b"G4 P0.5", 4, "without M2"),
    Bad("cut inside a number", MOVED + b"G4 P0.", 4, "without M2"),
]


def test_the_corpus_is_large_and_its_names_are_its_own() -> None:
    names = [trap.name for trap in [*GOOD, *BAD]]
    assert len(names) >= 120
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("trap", GOOD, ids=lambda trap: trap.name)
def test_it_is_read_with_the_right_seconds(trap: Good) -> None:
    found = read(trap.text, "t.rnc")
    assert found.line.tolist() == trap.lines
    # exact but for the order of two products: a factor of 1000 (or 60, or 25.4) cannot hide in that
    np.testing.assert_allclose(found.time_s, trap.seconds, rtol=1e-14)


@pytest.mark.parametrize("trap", GOOD, ids=lambda trap: trap.name)
def test_the_same_times_give_the_same_bytes(trap: Good) -> None:
    found = read(trap.text, "t.rnc")
    assert rewrite(found, found.time_s) == trap.text


@pytest.mark.parametrize("trap", [trap for trap in GOOD if trap.rewritten], ids=lambda trap: trap.name)
def test_a_new_time_is_written_in_the_old_style_and_nowhere_else(trap: Good) -> None:
    found = read(trap.text, "t.rnc")
    assert rewrite(found, np.array([1.25])) == trap.rewritten


@pytest.mark.one_of_each
@pytest.mark.parametrize("factor", [1e-3, 0.5, 1.7, 1e3])
@pytest.mark.parametrize("trap", GOOD, ids=lambda trap: trap.name)
def test_what_is_written_is_read_back(trap: Good, factor: float) -> None:
    found = read(trap.text, "t.rnc")
    wanted = np.maximum(found.time_s, 1e-3) * factor
    again = read(rewrite(found, wanted), "t.rnc")
    np.testing.assert_allclose(again.time_s, wanted, rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(again.line, found.line)
    np.testing.assert_array_equal(again.end_mm, found.end_mm)


@pytest.mark.parametrize("trap", BAD, ids=lambda trap: trap.name)
@pytest.mark.parametrize("newline", [b"\n", b"\r\n"], ids=["LF", "CRLF"])
def test_it_is_refused_by_line_and_reason(trap: Bad, newline: bytes) -> None:
    with pytest.raises(ProgramError) as caught:
        read(trap.text.replace(b"\n", newline), "t.rnc")
    message = str(caught.value)
    assert message.startswith(f"t.rnc, line {trap.line}: ")
    assert trap.reason in message
    assert "To do: " in message


@pytest.mark.parametrize("trap", BAD, ids=lambda trap: trap.name)
def test_a_refused_program_cannot_be_rewritten_by_way_of_a_good_one(trap: Bad) -> None:
    """Rewriting interprets the text again: a Program that carries another text than it was read from is refused."""
    good = read(MOVED + b"G4 P0.5\n" + END, "t.rnc")
    with pytest.raises(ProgramError):
        rewrite(replace(good, text=trap.text), good.time_s)
