"""Programs that contradict themselves: line numbers that do not rise, counts in the head, positions without a unit."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages import read, split
from polishd.plugins.rnc_robot.languages.move_times import recode_moves
from tests.unit.plugins.rnc_robot.languages.robot_programs import INFORM, MELFA, TP, profile
from tests.unit.plugins.rnc_robot.languages.test_foreign_programs import tp

TWICE = MELFA.replace(b"9 M_Out", b"8 M_Out")
FALLS = MELFA.replace(b"10 Spd 20", b"6 Spd 20")
NO_SECTION = INFORM.replace(b"///RECTAN\n", b"").replace(b"///PULSE\n", b"")
REFUSED = [
    ("melfa-basic", TWICE, r"line 9: the line number 8 a second time \(the first is in line 8\): \"8 M_Out"),
    ("melfa-basic", FALLS, r"line 10: the line number 6 behind 9 \(in line 9\)"),
    ("inform", INFORM.replace(b"NPOS 4", b"NPOS 20"), "line 4: the head counts 20 positions, the program has 4"),
    ("inform", INFORM.replace(b"///RECTAN", b"///PULSE"), r"line 25: .*C00001 is in pulses .*line 13, under ///PULSE"),
    ("inform", INFORM.replace(b"///RECTAN", b"///ANGLE"), r"C00001 is in pulses or angles .* under ///ANGLE"),
    ("inform", NO_SECTION, r"line 23: the position C00001 has no unit \(line 11\): no ///RECTAN stands before it"),
    ("inform", INFORM.replace(b",0.0000\nC00002", b"\nC00002"), r"C00001 \(line 13\) is not written as x, y, z and an"),
]  # fmt: skip
READ = [
    ("fanuc-tp", TP.replace(b"   8:L", b"   7:L")),
    ("fanuc-tp", TP.replace(b"T\t= 12;", b"T\t= 3;")),
    ("melfa-basic", MELFA.replace(b"9 M_Out", b"M_Out")),
    ("fanuc-tp", TP.replace(b"T\t= 12;", b"T\t= 0;")),
    ("fanuc-tp", TP.replace(b'"WAIT 9.00(sec)"', b'"LINE_COUNT = 3"')),
    ("fanuc-tp", TP.replace(b"  10:", b"    :")),
    ("fanuc-tp", TP.replace(b"  10:", b"    :").replace(b"T\t= 12;", b"T\t= 11;")),
    ("inform", INFORM.replace(b"NPOS 4", b"NPOS 0")),
    ("inform", INFORM.replace(b"NPOS 4,0,0,0", b"NPOS 3,0,0,1")),
    ("inform", INFORM.replace(b"100.000,0.000,20.000,180.0000,0.0000,0.0000", b"100,0,20,180,0,0")),
]


@pytest.mark.parametrize(("name", "text", "reason"), REFUSED)
def test_a_program_that_contradicts_itself_is_refused(name: str, text: bytes, reason: str) -> None:
    with pytest.raises(ProgramError, match=r"^p\.x, line [0-9]+: .*To do: ") as refusal:
        read(profile(name), text, "p.x")
    refusal.match(reason)


@pytest.mark.parametrize(("name", "text"), READ)
def test_what_posts_and_controllers_write_is_no_contradiction(name: str, text: bytes) -> None:
    program = read(profile(name), text, "p.x")
    np.testing.assert_array_equal(program.time_s, [0.5, 1.0])
    assert program.end_mm[0, 2] == (300 if name == "fanuc-tp" else 20)


def test_lines_without_a_number_are_counted_with_the_others() -> None:
    """A rewritten program is read again: its head counts its lines."""
    text = tp("  UFRAME_NUM=0", "J P[1] 50% FINE", "L P[2] 1sec FINE", "L P[3] 1sec FINE").replace("   1:", "    :")
    program = read(profile("fanuc-tp"), text.encode(), "p.ls")
    new = recode_moves(profile("fanuc-tp"), program, program.time_s, "dwell")
    assert b"LINE_COUNT\t= 6;" in new
    assert read(profile("fanuc-tp"), new, "p.ls").n == 2


def test_each_part_of_a_split_program_counts_its_lines() -> None:
    language = profile("fanuc-tp").model_copy(update={"line_limit": 10})
    parts = split(language, TP)
    assert len(parts) == 2
    for part in parts:
        lines = part.split(b"/MN\n")[1].split(b"/POS\n")[0].count(b"\n")
        assert b"LINE_COUNT\t= %d;" % lines in part
        read(language, part, "part.ls")
