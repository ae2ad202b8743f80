"""Robot programs are read for what they say: places, tool axes, feeds, times and lines."""

from __future__ import annotations

import re

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages import read, rewrite
from polishd.plugins.rnc_robot.languages.statements import LONGEST_LINE
from tests.unit.plugins.rnc_robot.languages.robot_programs import (
    DWELL,
    HEAD,
    LANGUAGES,
    MOVE,
    PROGRAMS,
    TAIL,
    around,
    many,
    profile,
)  # fmt: skip


def line_ends(text: bytes, way: str) -> bytes:
    """The program as other systems save it."""
    lines = text.split(b"\n")
    if way == "crlf":
        return b"\r\n".join(lines)
    if way == "mixed":
        return b"".join(line + (b"\r\n" if index % 2 else b"\n") for index, line in enumerate(lines[:-1]))
    return text.rstrip(b"\n") if way == "no final newline" else text


@pytest.mark.parametrize("way", ["lf", "crlf", "mixed", "no final newline"])
@pytest.mark.parametrize("name", LANGUAGES)
def test_a_program_is_read_and_written_back_to_the_byte(name: str, way: str) -> None:
    said = PROGRAMS[name]
    text = line_ends(said.text, way)
    program = read(profile(name), text, "part.txt")
    assert program.time_s.tolist() == said.time_s
    assert program.line.tolist() == said.line
    assert program.block.tolist() == [line - 1 for line in said.line]
    np.testing.assert_allclose(program.end_mm, said.end_mm, atol=1e-9)
    np.testing.assert_allclose(program.axis, said.axis, atol=1e-6)
    np.testing.assert_allclose(program.feed_mm_min, said.feed_mm_min)
    assert program.max_feed_mm_min == np.nanmax(said.feed_mm_min)
    assert (program.dialect, program.encoding, program.unit) == (name, "dwell", "s")
    assert program.lines == said.text.count(b"\n")
    assert (program.start_mm == program.end_mm).all()
    assert rewrite(profile(name), program, program.time_s) == text


@pytest.mark.one_of_each
@pytest.mark.parametrize("piece", [b" ", b"0", b"a", b"a ", b"(", b",", b"a:=", b"="])
@pytest.mark.parametrize("name", LANGUAGES)
def test_a_line_beyond_the_limit_is_refused_before_templates_are_tried(name: str, piece: bytes) -> None:
    said = PROGRAMS[name]
    long = (piece * (LONGEST_LINE + 1))[: LONGEST_LINE + 1]
    place = rf"part\.txt, line {said.text.count(10) + 1}: .*a line of more than {LONGEST_LINE} bytes.*To do: split it"
    with pytest.raises(ProgramError, match=place):
        read(profile(name), said.text + long, "part.txt")


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_line_as_long_as_the_limit_is_read(name: str) -> None:
    said = PROGRAMS[name]
    program = read(profile(name), said.text + b" " * LONGEST_LINE, "part.txt")
    assert program.time_s.tolist() == said.time_s


@pytest.mark.parametrize("name", LANGUAGES)
def test_every_line_of_a_point_holds_its_number(name: str) -> None:
    program = read(profile(name), PROGRAMS[name].text, "part.txt")
    for line, time_s in zip(program.line, program.time_s, strict=True):
        digits = f"{time_s:g}".lstrip("0").encode()
        assert digits in program.text.split(b"\n")[line - 1]


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf", b"\xff\xfe"])
def test_a_byte_order_mark_is_refused_as_one(name: str, mark: bytes) -> None:
    with pytest.raises(ProgramError, match=r"part\.txt: it starts with a byte order mark\. To do: save it as plain"):
        read(profile(name), mark + PROGRAMS[name].text, "part.txt")


@pytest.mark.parametrize("name", ["rapid", "krl"])
def test_case_does_not_matter(name: str) -> None:
    said = PROGRAMS[name]
    for text in (said.text.lower(), said.text.upper()):
        program = read(profile(name), text, "part.txt")
        assert program.time_s.tolist() == said.time_s
        np.testing.assert_allclose(program.end_mm, said.end_mm, atol=1e-9)


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_hundred_points(name: str) -> None:
    times = [f"{index % 7 + 0.25:.2f}" for index in range(100)]
    program = read(profile(name), many(name, times), "part.txt")
    assert program.time_s.tolist() == [float(time) for time in times]
    if name not in {"fanuc-tp", "inform", "val3", "kawasaki-as"}:  # all their moves lead to one position
        np.testing.assert_allclose(program.end_mm[:, 0] * (1e-3 if name == "urscript" else 1), np.arange(100) * 0.1)


OFFSET = b"MoveL Offs(p1,0,-0.5,2),v10,fine,tool0;\nWaitTime 2;\n"
BODIES = [
    ("rapid", b"MoveL p1 , v5 , fine , tool0 ;\n\n! MoveL p9;\nWaitTime\n  2.5 ;\n", 2.5, 300.0),
    ("rapid", b"MoveL p1,v100,fine,tool0;WaitTime 2E0;\n", 2.0, 6000.0),
    ("rapid", b"MoveL p1,v33,fine,tool0;\nWaitTime 2;\n", 2.0, None),  # a name of the user's: no speed known
    ("rapid", b"MoveL p1,vSlow,fine,tool0;\nWaitTime 2;\n", 2.0, None),
    ("rapid", b"MoveL p1,[50,500,5000,1000],fine,tool0;\nWaitTime 2;\n", 2.0, 3000.0),
    ("rapid", b"MoveL p1,v100,z50,tool0;\nWaitTime \\InPos , 2;\n", 2.0, 6000.0),
    ("rapid", b"MoveC p1,p1,v10,fine,tool0;\nWaitTime 2;\n", 2.0, 600.0),
    ("rapid", OFFSET, 2.0, 600.0),
    ("rapid", b"reg1:=-5;\nMoveL p1,v10,fine,tool0;\nWaitTime 2;\n", 2.0, 600.0),
    ("krl", b"I=5\n$VEL={CP 0.02,ORI1 100.0,ORI2 100.0}\nLIN XP1\nWAIT SEC 2\n", 2.0, 1200.0),
    ("krl", b"BAS (#CP_PARAMS,0.02)\nLDAT_ACT={VEL 0.02,ACC 100}\nLIN XP1\nWAIT SEC 2\n", 2.0, 1200.0),
    ("krl", b"$VEL.CP=0.02\nSLIN XP1\nWAIT SEC 2\n", 2.0, 1200.0),
    ("krl", b"CIRC XH,{X 1,Y 2,Z 3,A 0,B 0,C 180}\nWAIT SEC 2.0;x\n", 2.0, 6000.0),
    ("krl", b"LIN XP1 C_DIS C_DIS\nWAIT SEC 2\n", 2.0, 6000.0),
    ("fanuc-tp", b"3:L P[2] 10inch/min FINE COORD ;\n:  WAIT 2.00(sec) ;\n", 2.0, 254.0),
    ("fanuc-tp", b"  3:  R[1:speed]=5 ;\n  4:L P[2] 5mm/sec FINE ;\n  5:  WAIT 2.00(sec) ;\n", 2.0, 300.0),
    ("fanuc-tp", b"  3:L P[2] R[1]mm/sec FINE ;\n  4:  WAIT   2.00(sec) ;\n", 2.0, None),
    ("fanuc-tp", b"  3:C P[1]    \n   :  P[2] 50mm/sec FINE    ;\n  4:  WAIT   2.00(sec) ;\n", 2.0, 3000.0),
    ("urscript", b"  movel(p1, a=1.2, v=0.02, t=3, r=0.0)\n  sleep( 2.0 )\n", 2.0, None),
    ("urscript", b"  global speed = 0.1\n  movel(p1, a=accel, v=speed)\n  sleep(2)\n", 2.0, None),
    ("urscript", b"  movel(p1, accel, speed, 0, 0)\n  sleep(2)\n", 2.0, None),
    ("urscript", b"  movel(p1)\n  sleep(2)\n", 2.0, None),
    ("urscript", b"  movep(p1, 1.2, 0.02)\n  sleep(2)\n", 2.0, 1200.0),
    ("urscript", b"  movec(p[0.1,0,0,0,0,0], p1, a=1, v=0.02)\n  sleep(2)\n", 2.0, 1200.0),
]


@pytest.mark.parametrize(("name", "body", "time_s", "feed_mm_min"), BODIES)
def test_a_point_in_other_words(name: str, body: bytes, time_s: float, feed_mm_min: float | None) -> None:
    program = read(profile(name), around(name, body), "part.txt")
    assert program.time_s.tolist() == [0.5, time_s]
    if feed_mm_min is None:
        assert np.isnan(program.feed_mm_min[1])
        assert any("1 points are not written as numbers" in warning for warning in program.warnings)
    else:
        assert program.feed_mm_min[1] == pytest.approx(feed_mm_min)


def test_an_offset_is_added_to_a_rapid_position() -> None:
    program = read(profile("rapid"), around("rapid", OFFSET), "part.txt")
    assert program.end_mm.tolist() == [[1, 0, 0], [1, -0.5, 2]]


def test_a_position_may_be_declared_after_its_use_where_the_language_says_so() -> None:
    late = b"CONST robtarget p7:=[[7,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\nENDMODULE\n"
    text = around("rapid", b"MoveL p7,v10,fine,tool0;\nWaitTime 1;\n").replace(b"ENDMODULE\n", late)
    assert read(profile("rapid"), text, "part.txt").end_mm[1, 0] == 7


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_dwell_that_no_feed_move_leads_to_is_no_point(name: str) -> None:
    text = HEAD[name] + DWELL[name] + MOVE[name] + DWELL[name] + TAIL[name]
    program = read(profile(name), text, "part.txt")
    assert program.line.tolist() == [(HEAD[name] + DWELL[name] + MOVE[name] + DWELL[name]).count(b"\n")]
    assert program.warnings == ("1 dwells that no feed move leads to are not points and are not changed",)
    new = rewrite(profile(name), program, np.array([0.75]))
    later = re.sub(rb"[.]50?", b".75", DWELL[name])
    assert new == HEAD[name] + DWELL[name] + MOVE[name] + later + TAIL[name]


@pytest.mark.parametrize("name", LANGUAGES)
def test_feed_moves_without_a_dwell_are_no_points(name: str) -> None:
    program = read(profile(name), around(name, 3 * MOVE[name]), "part.txt")
    assert program.n == 1
    assert program.warnings == ("3 feed moves have no dwell: they are not points, and their time is not changed",)


def test_a_fly_by_in_krl_is_a_warning_as_the_wait_stops_the_advance_run() -> None:
    program = read(profile("krl"), PROGRAMS["krl"].text, "part.src")
    assert any("after fly-by moves" in warning for warning in program.warnings)


def test_a_program_that_names_no_feed_at_all_is_read() -> None:
    text = HEAD["urscript"] + b"movel(p1)\n" + DWELL["urscript"] + TAIL["urscript"]
    program = read(profile("urscript"), text, "part.script")
    assert np.isnan(program.feed_mm_min).all()
    assert program.max_feed_mm_min == 0
    assert program.warnings == ("the feeds of 1 points are not written as numbers: not known",)


def test_krl_tells_tools_and_bases_apart() -> None:
    frame = b"FDAT_ACT={TOOL_NO 1,BASE_NO %d,IPO_FRAME #BASE}\n"
    text = HEAD["krl"] + frame % 2 + MOVE["krl"] + DWELL["krl"] + frame % 2 + MOVE["krl"] + DWELL["krl"] + TAIL["krl"]
    assert read(profile("krl"), text, "part.src").n == 2
    with pytest.raises(ProgramError, match=r"line 8: another tool or frame \(1, 3\) than at the first point \(1, 2\)"):
        read(profile("krl"), text[::-1].replace((frame % 2)[::-1], (frame % 3)[::-1], 1)[::-1], "part.src")


def test_inline_forms_of_krl_are_read_with_a_warning() -> None:
    body = b";FOLD LIN P1 Vel=0.1 m/s CPDAT1\n$BWDSTART=FALSE\nLDAT_ACT=LCPDAT1\nFDAT_ACT=FP1\nBAS(#CP_PARAMS,0.1)\n"
    program = read(profile("krl"), around("krl", body + b"LIN XP1\n;ENDFOLD\nWAIT SEC 1\n"), "part.src")
    assert program.n == 2
    assert any("tool and base of the points stand elsewhere" in warning for warning in program.warnings)


def test_a_program_longer_than_the_controller_takes_is_read_with_a_warning() -> None:
    short = profile("fanuc-tp").model_copy(update={"line_limit": 19})
    program = read(short, many("fanuc-tp", ["1.00"] * 10), "part.ls")
    assert program.warnings == ("20 lines in the program, the controller takes 19: split it",)
