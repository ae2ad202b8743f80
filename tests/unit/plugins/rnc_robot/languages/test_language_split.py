"""Programs in parts: each is complete, starts where the last ended, and together they are the whole."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages import LanguageProfile, read, split
from tests.unit.plugins.rnc_robot.languages.robot_programs import LANGUAGES, PROGRAMS, TP, many, profile

PREAMBLE = "   1:  UFRAME_NUM=1 ;\n   2:  UTOOL_NUM=1 ;\n   3:J P[1] 100% CNT50    ;\n"


def limited(name: str, lines: int) -> LanguageProfile:
    """The profile of a controller that takes fewer lines."""
    return profile(name).model_copy(update={"line_limit": lines})


def job(points: int) -> bytes:
    """A TP program with an approach and a separate position for each point."""
    body, poses = [PREAMBLE], []
    for index in range(1, points + 1):
        line = 2 * index + 2
        body.append(
            f"{line:4d}:L P[{index}] 50mm/sec FINE    ;\n{line + 1:4d}:  WAIT {index % 3:3d}.{index % 100:02d}(sec) ;\n"
        )
        poses.append(
            f"P[{index}]{{\n   GP1:\n\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {index:.3f} mm,\t"
            "Y = 0.000 mm,\tZ = 0.000 mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n};\n"
        )
    return f"/PROG  JOB\n/ATTR\nOWNER = MNEDITOR;\n/MN\n{''.join(body)}/POS\n{''.join(poses)}/END\n".encode()


def body(part: bytes) -> list[bytes]:
    """The lines between /MN and /POS."""
    return part.split(b"/MN\n")[1].split(b"/POS\n")[0].splitlines()


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_program_that_fits_is_its_only_part(name: str) -> None:
    text = PROGRAMS[name].text.replace(b"\n", b"\r\n")
    assert split(profile(name), text) == [text]
    assert split(limited(name, 1000), text) == [text]


def test_a_program_of_as_many_lines_as_the_controller_takes_fits() -> None:
    text = job(10)
    assert len(body(text)) == 23
    assert split(limited("fanuc-tp", 23), text) == [text]
    assert len(split(limited("fanuc-tp", 22), text)) == 2


@pytest.mark.full
@given(st.integers(1, 60), st.integers(6, 40))
def test_parts_are_complete_and_make_up_the_whole(points: int, lines: int) -> None:
    text = job(points)
    whole = read(profile("fanuc-tp"), text, "job.ls")
    parts = split(limited("fanuc-tp", lines), text)
    programs = [read(profile("fanuc-tp"), part, "part.ls") for part in parts]
    np.testing.assert_array_equal(np.concatenate([part.time_s for part in programs]), whole.time_s)
    np.testing.assert_array_equal(np.concatenate([part.end_mm for part in programs]), whole.end_mm)
    assert all(len(body(part)) <= lines for part in parts)
    if len(parts) == 1:
        return
    for number, part in enumerate(parts[1:], start=2):
        assert part.startswith(b"/PROG  JOB_%d\n/ATTR\nOWNER = MNEDITOR;\n/MN\n" % number)
        assert [int(line.split(b":")[0]) for line in body(part)] == list(range(1, len(body(part)) + 1))
        assert [line[5:] for line in body(part)[:2]] == [b"  UFRAME_NUM=1 ;", b"  UTOOL_NUM=1 ;"]
        ended = [line[5:] for line in body(parts[number - 2]) if b"L P[" in line][-1]
        assert body(part)[2][5:] == ended  # it starts where the last ended
    for part in parts:
        used = set(re.findall(rb":[LJ] P\[(\d+)\]", part))
        assert set(re.findall(rb"^P\[(\d+)\]", part, re.MULTILINE)) == used


def test_the_first_part_keeps_its_name_numbers_and_approach() -> None:
    first = split(limited("fanuc-tp", 9), job(10))[0]
    assert first.startswith(b"/PROG  JOB\n")
    assert body(first)[2] == b"   3:J P[1] 100% CNT50    ;"
    assert job(10).split(b"/POS")[0].startswith(first.split(b"/POS")[0])


def test_line_ends_and_bytes_of_comments_stay() -> None:
    text = TP.replace(b"\n", b"\r\n")
    first, second, last = split(limited("fanuc-tp", 8), text)
    for part in (first, second, last):
        assert part.count(b"\r\n") == part.count(b"\n")
        assert b'COMMENT\t\t= "WAIT 9.00(sec)";' in part
    assert b'P[2:"two \xe9"]{' in second
    assert b"P[2:" not in first
    assert b"P[4]" not in first + second + last


def test_without_a_dwell_to_part_it_after_it_is_refused() -> None:
    text = job(3).replace(b"   5:  WAIT", b"   5:  !").replace(b"   7:  WAIT", b"   7:  !")
    with pytest.raises(ProgramError, match=r"job\.ls, line 7: no dwell to part the program after within 4 lines"):
        split(limited("fanuc-tp", 6), text, "job.ls")


def test_what_is_refused_in_reading_is_refused_in_splitting() -> None:
    with pytest.raises(ProgramError, match=r"line 8: .*calls"):
        split(limited("fanuc-tp", 5), job(3).replace(b"   4:L P[1] 50mm/sec FINE    ;", b"   4:  CALL SUB ;"))


@pytest.mark.parametrize("name", ["rapid", "krl", "urscript"])
def test_other_languages_are_split_where_a_profile_has_a_limit(name: str) -> None:
    text = many(name, [f"{index}.25" for index in range(9)])
    whole = read(profile(name), text, "part.txt")
    programs = [read(profile(name), part, "part.txt") for part in split(limited(name, 9), text)]
    assert len(programs) > 2
    np.testing.assert_array_equal(np.concatenate([part.time_s for part in programs]), whole.time_s)
    np.testing.assert_array_equal(np.concatenate([part.end_mm for part in programs]), whole.end_mm)
    np.testing.assert_array_equal(np.concatenate([part.feed_mm_min for part in programs]), whole.feed_mm_min)


def test_positions_and_feeds_set_on_the_way_are_carried_into_the_next_part() -> None:
    text = (
        b"DEF M()\n$TOOL=TOOL_DATA[1]\nPTP XHOME\nXP1={X 1,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=0.1\nLIN XP1\nWAIT SEC 1\n"
        b"XP2={X 2,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=0.2\nLIN XP2\nWAIT SEC 2\nLIN xp1\nWAIT SEC 3\nEND\n"
    )
    parts = split(limited("krl", 8), text)
    assert len(parts) == 3
    assert parts[1].startswith(
        b"DEF M_2()\n$TOOL=TOOL_DATA[1]\nXP1={X 1,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=0.1\nLIN XP1\nXP2={"
    )
    programs = [read(profile("krl"), part, "part.src") for part in parts]
    assert [program.time_s.tolist() for program in programs] == [[1], [2], [3]]
    assert [program.feed_mm_min.tolist() for program in programs] == [[6000], [12000], [12000]]
