"""Dwell as the time of a move: read, rewritten to the byte elsewhere, converted from waits, refused by line."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProgramError
from polishd.model.program import Encoding, Program
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.formats import path_program, read, rewrite
from polishd.plugins.rnc_robot.languages import read as read_language
from polishd.plugins.rnc_robot.languages.move_times import COARSE, carried_speed, misfit
from polishd.plugins.rnc_robot.verify import verify
from tests.unit.plugins.rnc_robot.languages.robot_programs import HEAD, LANGUAGES, TAIL, profile

POSE = b"[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]"
RAPID = (
    b"MODULE Polish ! \xfc\n  CONST speeddata vSlow:=[5,500,5000,1000];\n"
    b"  CONST robtarget p0:=[[0,0,20]," + POSE + b"];\n  CONST robtarget p1:=[[0,0,0]," + POSE + b"];\n  PROC main()\n"
    b"    MoveJ p0,v500,z10,tPad\\WObj:=w;\n    MoveL p1,v300,fine,tPad\\WObj:=w;\n"
    b"    MoveL Offs(p1,1,0,0),v100\\T:=0.250,z1,tPad\\WObj:=w; ! T:=9\n"
    b"    MoveL Offs(p1,2,0,0),v10,z1,tPad\\WObj:=w;\n"
    b"    MoveL Offs(p1,3,0,0),v10\\V:=4.0,z1,tPad\\WObj:=w;\n"
    b"    MoveL Offs(p1,4,0,0),[2.00,500,5000,1000],z1,tPad\\WObj:=w;\n"
    b"    MoveL Offs(p1,5,0,0),vSlow,fine,tPad\\WObj:=w;\n"
    b"    MoveL p0,v300,fine,tPad\\WObj:=w;\n  ENDPROC\nENDMODULE\n"
)
KRL = (
    b"&ACCESS RVP\r\nDEF M()\r\n;FOLD INI \xe4\r\n$VEL.CP=0.3\r\n;ENDFOLD\r\nPTP {X 0,Y 0,Z 20,A 0,B 0,C 180}\r\n"
    b"LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}\r\n$VEL.CP=0.0040 ; $VEL.CP=9\r\n"
    b"LIN {X 1,Y 0,Z 0,A 0,B 0,C 180} C_DIS\r\n  LIN {X 2,Y 0,Z 0,A 0,B 0,C 180} C_DIS\r\n"
    b"LIN {X 3,Y 0,Z 0,A 0,B 0,C 180} C_DIS\r\nSLIN {X 4,Y 0,Z 0,A 0,B 0,C 180} WITH $VEL.CP=0.002 C_SPL\r\n"
    b"$VEL.CP=0.3\r\nLIN {X 4,Y 0,Z 20,A 0,B 0,C 180}\r\nEND\r\n"
)


def times(name: str, text: bytes) -> tuple[Program, list[float]]:
    program = read(profile(name), text, "part.txt")
    return program, [round(float(time), 6) for time in program.time_s]


def test_rapid_states_times_in_five_forms() -> None:
    program, found = times("rapid", RAPID)
    assert found == [0.25, 0.1, 0.25, 0.5, 0.2]
    assert (program.encoding, program.unit) == ("feed", "s and mm/s")
    assert program.line.tolist() == [8, 9, 10, 11, 12]
    assert program.start_mm[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert program.timing is not None
    assert program.timing.stops.tolist() == [False] * 4 + [True]
    assert "2 feed moves are faster than 250 mm/s" in program.warnings[0]
    new = rewrite(profile("rapid"), program, np.array([0.5, 0.4, 0.5, 1.0, 0.8]))
    for old, then in (
        (b"\\T:=0.250", b"\\T:=0.500"),
        (b"v10,z1", b"v10\\V:=2.5,z1"),
        (b"\\V:=4.0", b"\\V:=2.0"),
        (b"[2.00,", b"[1.00,"),
        (b"vSlow,fine", b"vSlow\\V:=1.25,fine"),
    ):
        assert RAPID.count(old) == 1
        assert then in new
    restored = new.replace(b"v10\\V:=2.5,z1", b"v10,z1").replace(b"vSlow\\V:=1.25", b"vSlow")
    for old, then in ((b"0.500", b"0.250"), (b"V:=2.0", b"V:=4.0"), (b"[1.00,", b"[2.00,")):
        restored = restored.replace(old, then)
    assert restored == RAPID
    assert verify(RAPID, new, profile("rapid")).identical_motion


URSCRIPT = (
    b"def p():\n  movel(p[0,0,0,3.14,0,0], a=1.2, v=0.0125)\n  movel(p[0.001,0,0,3.14,0,0], a=1.2, v=0.0125)\n"
    b"  movel(p[0.002,0,0,3.14,0,0], a=1.2, v=0.0125)\nend\n"
)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("urscript", URSCRIPT.replace(b"0.0125", b"12.5"), "line 2: .* 3 are faster than 250 mm/s .*speed in m/s?"),
        ("krl", re.sub(rb"CP=0.00\d+", b"CP=4", KRL), "line 7: .* 6 are faster than 250 mm/s .*speed in m/s?"),
    ],
)
def test_speeds_in_another_unit_are_said(name: str, text: bytes, said: str) -> None:
    with pytest.raises(ProgramError, match=said):
        times(name, text)
    if name == "urscript":
        assert times(name, URSCRIPT)[1] == [0.08, 0.08]


def test_a_speed_of_krl_holds_until_a_move_needs_another() -> None:
    program, found = times("krl", KRL)
    assert found == [0.25, 0.25, 0.25, 0.5]
    assert rewrite(profile("krl"), program, program.time_s) == KRL
    new = rewrite(profile("krl"), program, np.array([0.5, 0.5, 0.25, 1.0]))
    lines, old = new.split(b"\r\n"), KRL.split(b"\r\n")
    assert lines[7] == b"$VEL.CP=0.0020 ; $VEL.CP=9"
    assert lines[8:10] == old[8:10]
    assert lines[10] == b"$VEL.CP=0.0040"
    assert lines[11] == old[10]
    assert lines[12] == old[11].replace(b"0.002 ", b"0.001 ")
    assert lines[13:] == old[12:]
    assert verify(KRL, new, profile("krl")).identical_motion


def test_a_travel_move_keeps_the_speed_that_held_for_it() -> None:
    text = KRL.replace(b"$VEL.CP=0.3\r\nLIN {X 4", b"LIN {X 4").replace(b"0.3\r\n;END", b"0.004\r\n;END")
    text = text.replace(b"$VEL.CP=0.0040 ; $VEL.CP=9\r\n", b"")
    program, found = times("krl", text)
    new = rewrite(profile("krl"), program, program.time_s * np.array([1, 2, 1, 1, 1, 1]))
    assert times("krl", new)[1] == pytest.approx([*found[:1], 2 * found[1], *found[2:]])
    assert new.count(b"$VEL.CP=0.004\r\n") == text.count(b"$VEL.CP=0.004\r\n") + 1


def test_lines_of_tp_are_numbered_anew_where_waits_go() -> None:
    language = profile("fanuc-tp")
    text = path_program(LINE, UP, 600.0, "t", encoding="dwell", dwell_s=0.25, to=language)
    new = rewrite(language, read(language, text, "t.ls"), np.full(12, 0.5), "time")
    assert b"WAIT" not in new
    numbered = [int(line.split(b":")[0]) for line in new.split(b"\n") if line[:4].strip().isdigit() and b":" in line]
    assert numbered == list(range(1, 19))
    assert b"LINE_COUNT\t= 18;" in new
    assert b"  12:L P[9] 0.5sec FINE    ;\n" in new


X = np.arange(13.0)
LINE = np.column_stack([0.9 * X, 0.05 * X * X, 0.2 * np.sin(X)])
UP = np.tile([0.0, 0.0, 1.0], (13, 1))
LEAN = np.column_stack([0.2 * np.sin(X), 0.2 * np.cos(X), np.full(13, np.sqrt(1 - 0.04))])
TIMES = np.array([0.1, 0.2, 0.15, 0.12, 0.3, 0.21, 0.13, 0.17, 0.2, 0.1, 0.25, 0.2]) / 4
ENCODINGS: tuple[Encoding, ...] = ("feed", "time", "dwell")


def made(name: str, encoding: Encoding) -> bytes:
    length = np.linalg.norm(np.diff(LINE, axis=0), axis=1)
    feed = 60 * length / TIMES
    return path_program(LINE, LEAN, feed, "made", encoding=encoding, dwell_s=TIMES, to=profile(name))


def takes(name: str, encoding: Encoding) -> bool:
    rules = profile(name).move_time
    return rules is not None and (encoding != "time" or bool(rules.time))


def close(found: FloatArray, wanted: FloatArray, name: str) -> None:
    """Each within its resolution, and the sum within one step of the residue."""
    language = profile(name)
    assert language.move_time is not None
    step_s = max(language.move_time.quantum_s, language.dwell.quantum_s)
    assert np.abs(found - wanted).max() <= max(0.015 * wanted.max(), step_s)
    assert abs(math.fsum(found) - math.fsum(wanted)) <= max(0.01 * wanted.max(), step_s)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", LANGUAGES)
def test_a_program_is_made_in_each_language_and_read_back(name: str, encoding: Encoding) -> None:
    if not takes(name, encoding):
        with pytest.raises(ProgramError, match="has no form of the time of a move"):
            made(name, encoding)
        return
    program = read(profile(name), made(name, encoding), "made")
    assert (program.n, program.encoding) == (12, encoding)
    np.testing.assert_allclose(program.end_mm, LINE[1:], atol=6e-4)
    np.testing.assert_allclose(program.axis, LEAN[1:], atol=2e-5)
    close(program.time_s, TIMES, name)
    if encoding != "dwell":
        np.testing.assert_allclose(program.start_mm, LINE[:-1], atol=6e-4)
        assert program.timing is not None
        assert not program.timing.stops[:-1].any()


@pytest.mark.one_of_each
@pytest.mark.parametrize("target", ENCODINGS)
@pytest.mark.parametrize("name", LANGUAGES)
def test_waits_become_times_of_moves_and_waits_again(name: str, target: Encoding) -> None:
    language = profile(name)
    text = made(name, "dwell")
    program = read(language, text, "made")
    wanted = 2 * TIMES
    if not takes(name, target):
        with pytest.raises(ProgramError, match="no form of this move that states its time"):
            rewrite(language, program, wanted, target)
        return
    new = rewrite(language, program, wanted, target)
    found = read(language, new, "new")
    assert found.encoding == target
    assert (found.end_mm == program.end_mm).all()
    close(found.time_s, wanted, name)
    proof = verify(text, new, language)
    assert proof.identical_motion, proof.difference
    back = read(language, rewrite(language, found, TIMES, "dwell"), "back")
    assert back.encoding == "dwell"
    assert back.lines == program.lines
    close(back.time_s, TIMES, name)


@pytest.mark.parametrize("encoding", ["feed", "time"])
@pytest.mark.parametrize("name", LANGUAGES)
def test_a_program_of_timed_moves_is_rewritten_in_place(name: str, encoding: Encoding) -> None:
    if not takes(name, encoding):
        return
    language, text = profile(name), made(name, encoding)
    program = read(language, text, "made")
    assert rewrite(language, program, program.time_s) == text
    new = rewrite(language, program, program.time_s[::-1].copy() * 1.5)
    found = read(language, new, "new")
    close(found.time_s, program.time_s[::-1] * 1.5, name)
    assert found.lines == program.lines
    changed = [k for k, (a, b) in enumerate(zip(text.split(b"\n"), new.split(b"\n"), strict=True)) if a != b]
    assert 10 <= len(changed) <= 12
    proof = verify(text, new, language)
    assert proof.identical_motion, proof.difference
    before = b"0.0027" if name == "urscript" else b"2.7"
    moved = new.replace(before, before[:-1] + b"6", 1)
    assert moved != new
    assert not verify(text, moved, language).identical_motion


@pytest.mark.full
@given(
    name=st.sampled_from(["rapid", "krl", "urscript", "heidenhain", "val3"]),
    wanted=st.lists(st.floats(0.05, 5.0), min_size=12, max_size=12),
)
def test_the_residue_is_carried_on(name: str, wanted: list[float]) -> None:
    language = profile(name)
    program = read(language, made(name, "feed"), "made")
    found = read(language, rewrite(language, program, np.array(wanted)), "new")
    np.testing.assert_allclose(found.time_s, wanted, rtol=COARSE)
    assert (found.end_mm == program.end_mm).all()
    assert abs(math.fsum(found.time_s) - math.fsum(wanted)) <= 0.011 * max(wanted)


def test_steps_of_a_speed_add_up_to_no_more_than_one_of_them() -> None:
    """At 3 mm/s a step of INFORM's 0.1 mm/s is 3 % of the time of a move: neighbours make up for it."""
    language = profile("inform")
    program = read(language, made("inform", "feed"), "made")
    wanted = program.length_mm / np.linspace(2.83, 3.44, program.n)
    found = read(language, rewrite(language, program, wanted), "new")
    step_s = 0.1 / 2.83 * wanted.max()
    assert np.abs(found.time_s - wanted).max() > 0.01 * wanted.min()
    assert np.abs(np.cumsum(found.time_s - wanted)).max() <= 0.51 * step_s


@pytest.mark.parametrize("residue_s", [-9.0, 9.0])
@pytest.mark.parametrize("speed_mm_s", ["least", "greatest", 0.992, 1.1005, 2.5])
def test_a_residue_makes_no_move_refused_that_fits_without_it(speed_mm_s: str | float, residue_s: float) -> None:
    """At the limits of a speed, and where the next step of it misses the time by more than a tenth."""
    rules = profile("inform").move_time
    assert rules is not None
    speed = speed_mm_s if isinstance(speed_mm_s, float) else getattr(rules, f"{speed_mm_s}_mm_s")
    number = carried_speed(rules, 1.0, 1.0 / speed, residue_s, 60.0)
    assert misfit(rules, 1.0, 1.0 / speed, number, 60.0) == ""
    assert number.time_s == pytest.approx(1.0 / speed, rel=COARSE)


REFUSED = [
    (
        "rapid",
        b"MoveL p1,vmax,fine,tool0;\nMoveL Offs(p1,1,0,0),vUser,z1,tool0;\n",
        5,
        "speed of this move is no number",
    ),
    ("rapid", b"MoveL p1,v500,fine,tool0;\nMoveC p1,Offs(p1,1,0,0),v10,z1,tool0;\n", 5, "not read"),
    ("krl", b"LIN XP1\n$VEL.CP=0.01\nCIRC XP1,{X 5,Y 0,Z 0,A 0,B 0,C 180}\n", 6, "an arc cannot carry its time"),
    ("krl", b"LIN XP1\n$VEL.CP=0\nLIN {X 5,Y 0,Z 0,A 0,B 0,C 180}\n", 6, "a speed of zero"),
    (
        "fanuc-tp",
        b"   1:L P[1] 300mm/sec FINE ;\n   2:L P[2] R[1]mm/sec CNT100 ;\n",
        5,
        "speed of this move is no number",
    ),
    ("urscript", b"  movel(p1, v=0.3)\n  movel(p[0.1,0,0,0,3.1,0], a=1)\n", 5, "speed of this move is no number"),
    ("urscript", b"  movel(p1, v=0.3)\n  movel(p[0.1,0,0,0,3.1,0], t=-0.2)\n", 5, "a number of seconds above zero"),
    ("inform", b"MOVL C00001 V=300.0\nMOVL C00001 V=I001\n", 5, "not read"),
    ("val3", b"movel(p1,tTool,mPol)\nmPol.tvel=nSpeed\n", 5, "assignments are not read"),
    ("val3", b"movel(p1,tTool,mPol)\ndelay(0.5)\n", 5, "delay does not wait"),
    ("heidenhain", b"3 L X+0 Y+0 Z+0 FMAX\n4 L X+5 FAUTO\n", 5, "not read"),
    ("heidenhain", b"3 L X+0 Y+0 Z+0 FMAX\n4 L IX+5 F100\n", 5, "not read"),
    ("melfa-basic", b"Mvs P1\nMvr P1,P2,P3\n", 5, "not read"),
    ("kawasaki-as", b"LMOVE p1\nSPEED 80\n", 5, "a speed or accuracy for one move"),
    ("kawasaki-as", b"LMOVE p1\nTWAIT 0.5\n", 5, "TWAIT begins before the move has ended"),
]


@pytest.mark.parametrize(("name", "body", "line", "says"), REFUSED)
def test_what_is_not_understood_is_refused_with_line_and_remedy(name: str, body: bytes, line: int, says: str) -> None:
    with pytest.raises(ProgramError, match=rf"line {line}: .*{says}.*To do: "):
        read_language(profile(name), HEAD[name] + body + TAIL[name], "part.txt")


@pytest.mark.parametrize(
    ("name", "time_s", "says"),
    [
        ("krl", 1e-3, r"line 9: a speed of 1000 mm/s; a timed move takes 0\.05 to 250 mm/s"),
        ("krl", 1e3, r"line 9: a speed of 0\.001 mm/s"),
        ("krl", -1.0, r"line 9: a time of -1\.0 s cannot be written"),
        ("krl", math.nan, "line 9: a time of nan s"),
    ],
)
def test_times_that_cannot_be_written(name: str, time_s: float, says: str) -> None:
    program, _ = times(name, KRL)
    with pytest.raises(ProgramError, match=says):
        rewrite(profile(name), program, np.array([time_s, 0.25, 0.25, 0.5]))


def test_a_speed_too_coarse_for_its_time_is_refused_and_a_time_of_the_move_takes_it() -> None:
    language = profile("fanuc-tp")
    program = read(language, path_program(LINE, UP, 600.0, "t", to=language), "t.ls")
    slow = program.length_mm / 0.345
    with pytest.raises(ProgramError, match=r"speeds are written in steps of 0\.1 mm/s.*--encoding time"):
        rewrite(language, program, slow)
    found = read(language, rewrite(language, program, slow, "time"), "new.ls")
    np.testing.assert_allclose(found.time_s, slow, atol=1e-3)


def test_a_wait_behind_a_blend_is_refused() -> None:
    program, _ = times("rapid", RAPID)
    with pytest.raises(ProgramError, match="line 8: the move blends into the next one"):
        rewrite(profile("rapid"), program, program.time_s, "dwell")


def test_a_wait_without_a_way_cannot_become_a_time() -> None:
    language = profile("krl")
    text = HEAD["krl"] + b"LIN XP1\nWAIT SEC 0.5\nLIN {X 5,Y 0,Z 0,A 0,B 0,C 180}\nWAIT SEC 0.5\n" + TAIL["krl"]
    program = read(language, text, "part.src")
    with pytest.raises(ProgramError, match=r"line 4: the way of this move is not known"):
        rewrite(language, program, program.time_s, "feed")


@pytest.mark.parametrize("change", [b"0.3\r\nLIN {X 4", b"LIN {X 2,Y 0,Z 0", b"\xe4"])
def test_a_changed_byte_beside_the_times_is_no_proof(change: bytes) -> None:
    assert KRL.count(change) == 1
    changed = KRL.replace(change, change.replace(b"0", b"1", 1).replace(b"\xe4", b"\xe5"))
    assert not verify(KRL, changed, profile("krl")).identical_motion
