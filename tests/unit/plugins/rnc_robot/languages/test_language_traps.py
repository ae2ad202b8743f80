"""What a robot program may not hold: each trap is refused by file, line, text, reason and advice."""

from __future__ import annotations

import re

import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages import read
from tests.unit.plugins.rnc_robot.languages.robot_programs import (
    DWELL,
    HEAD,
    LANGUAGES,
    MOVE,
    PROGRAMS,
    TAIL,
    around,
    profile,
)  # fmt: skip

POSE = b"[[2,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
RAPID = [
    # the time
    (b"WaitTime t1;", "no plain number"),
    (b"WaitTime 0.5*2;", "no plain number"),
    (b"WaitTime \\InPos,t1;", "no plain number"),
    (b"WaitTime 0,5;", "no plain number"),
    (b"WaitTime \\InPos 0.5;", "no plain number"),
    (b"WaitTime 0x10;", "no plain number"),
    (b"WaitTime;", "a call, or a statement that the profile does not know"),
    (b"WaitTime0.5;", "does not know this statement"),
    (b"MoveL p1,v10,fine,tool0;\nWaitTime -0.5;", "zero or more"),
    (b"MoveL p1,v10,fine,tool0;\nWaitTime 1e999;", "zero or more"),
    (b"WaitTime 0.5;", "two dwells at one point"),
    # fly-by
    (b"MoveL p1,v10,z10,tool0;\nWaitTime 0.5;", "fly-by move of line 6"),
    (b"MoveL p1,v10,z0,tool0;\nWaitTime 0.5;", "fly-by"),
    (b"MoveL p1,v10,zMine,tool0;\nWaitTime 0.5;", "fly-by"),
    (b"MoveL p1,v10,[FALSE,5,8,8,0.8,8,0.8],tool0;\nWaitTime 0.5;", "fly-by"),
    # what runs when
    (b"WaitDI di1,1;", "waits for a signal"),
    (b"WaitUntil di1=1;", "waits for a signal"),
    (b"Stop;", "waits for a signal or an operator"),
    (b"FOR i FROM 1 TO 5 DO\nWaitTime 0.5;\nENDFOR", "loops"),
    (b"WHILE TRUE DO\nENDWHILE", "loops"),
    (b"IF x=1 THEN\nENDIF", "loops"),
    (b"IF x=1 WaitTime 3;", "loops"),
    (b"GOTO again;", "loops"),
    (b"Path_10;", "a call"),
    (b"Grind 1,2;", "a call"),
    (b"p1:=Offs(p1,0,0,1);", "assignments"),
    (b"p1.trans.x:=4;", "assignments"),
    (b"VelSet 50,t1;WaitTime t1;", "no plain number"),
    (b"again:", "does not know this statement|a call, or"),
    # where
    (b"MoveL Offs(p1,0,0,h),v10,fine,tool0;", "relative or computed"),
    (b"MoveL Offs(p1,0,0,1e999),v10,fine,tool0;", "offset beyond any robot"),
    (b"MoveL RelTool(p1,0,0,5),v10,fine,tool0;", "relative or computed"),
    (b"MoveL p1\\ID:=5,v10,fine,tool0;", "not read"),
    (b"MoveL \\Conc,p1,v10,fine,tool0;", "not read"),
    (b"MoveL *,v10,fine,tool0;", "not read"),
    (b"MoveL p9,v10,fine,tool0;\nWaitTime 1;", "position p9 is not declared"),
    (b"MoveL " + POSE + b",v10,fine,tool1;\nWaitTime 1;", "another tool or frame"),
    (b"MoveL " + POSE + b",v10,fine,tool0\\WObj:=w1;\nWaitTime 1;", "another tool or frame"),
    (b"MoveL " + POSE.replace(b"[0,1,0,0]", b"[0,1,1,0]") + b",v10,fine,tool0;\nWaitTime 1;", "no rotation"),
    (b"MoveL " + POSE.replace(b"[2,", b"[1e99,") + b",v10,fine,tool0;\nWaitTime 1;", "beyond any robot"),
    (b"CONST robtarget P1:=" + POSE + b";", "declared in line 2 too"),
    # text
    (b'TPWrite "WaitTime 9;', "a call, or"),
    (b"SetDO do1,1; ? ", "does not know this statement"),
    (b"\xe4;", "does not know this statement"),
    (b"MoveL p1,v10,fine,tool0; ! a\rWaitTime 9;", "carriage return"),
]
KRL = [
    (b"WAIT SEC T1", "no plain number"),
    (b"WAIT SEC 0.5*2", "no plain number"),
    (b"WAIT SEC 0,5", "no plain number"),
    (b"WAIT SEC", "no plain number"),
    (b"LIN XP1\nWAIT SEC -1", "zero or more"),
    (b"WAIT SEC 0.5", "two dwells at one point"),
    (b"WAIT FOR $IN[1]", "waits for a signal"),
    (b"WAIT 0.5", "waits for a signal"),
    (b"HALT", "waits for a signal"),
    (b"LIN XP1 C_DIS\nCONTINUE\nWAIT SEC 0.5", "CONTINUE"),
    (b"LIN_REL {X 1}", "relative"),
    (b"PTP_REL {A1 1}", "relative"),
    (b"LIN {X 5}", "not read"),
    (b"LIN {X 5,Z 1,Y 2,A 0,B 0,C 0}", "not read"),
    (b"LIN XP1:FRAME", "not read"),
    (b"LIN XP9\nWAIT SEC 1", "position XP9 is not declared"),
    (b"SLIN XP1 WITH $ACC.CP=1", "not read"),
    (b"SPLINE", "not read"),
    (b"FOR I=1 TO 5\nENDFOR", "loops"),
    (b"LOOP", "loops"),
    (b"IF TRUE THEN", "loops"),
    (b"GOTO M1", "loops"),
    (b"INTERRUPT DECL 21 WHEN $IN[1]==TRUE DO STOP_IT()", "loops"),
    (b"TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE", "loops"),
    (b"SUB1()", "calls"),
    (b"FDAT_ACT={TOOL_NO 1,BASE_NO 3,IPO_FRAME #TCP}", "assignments"),
    (b"XP1.X=5", "assignments"),
    (b"XP1=XP2", "assignments"),
    (b"T1=T2", "assignments"),
    (b"$TIMER[1]=0.5", "assignments"),
    (b"XP1={X 1,Y 0,Z 0,A 0,B 0,C 180}", "declared in line 2 too"),
    (b"$BASE=BASE_DATA[3]\nLIN XP1\nWAIT SEC 1", "another tool or frame"),
    (b"$OV_PRO=50;\xe4\nWAIT SEC 1", "two dwells"),
    (b"nonsense here", "does not know this statement"),
]
TP = [
    (b"   3:  WAIT R[1] ;", "no plain number"),
    (b"   3:  WAIT DI[1]=ON ;", "for a signal"),
    (b"   3:  WAIT   .50 ;", "no plain number"),
    (b"   3:  WAIT   .50(sec)", "no plain number"),
    (b"   3:L P[2] 10mm/sec FINE ;\n   4:  WAIT -1.00(sec) ;", "zero or more"),
    (b"   3:  WAIT   .50(sec) ;", "two dwells at one point"),
    (b"   3:L P[2] 10mm/sec CNT100 ;\n   4:  WAIT   .50(sec) ;", "fly-by move of line 6"),
    (b"   3:L P[2] 10mm/sec CNT0 ;\n   4:  WAIT   .50(sec) ;", "fly-by"),
    (b"   3:L P[2] 10mm/sec CNT R[3] ;\n   4:  WAIT   .50(sec) ;", "fly-by"),
    (b"   3:L P[2] 10mm/sec FINE Offset,PR[1] ;", "not read"),
    (b"   3:L P[2] 10mm/sec FINE INC ;", "not read"),
    (b"   3:L P[2] 10mm/sec FINE Tool_Offset,PR[1] ;", "not read"),
    (b"   3:L P[2] 10mm/sec FINE TB .10sec,CALL SPRAY ;", "not read"),
    (b"   3:L PR[2] 10mm/sec FINE ;", "not read"),
    (b"   3:L P[R[2]] 10mm/sec FINE ;", "not read"),
    (b"   3:J P[2] 10% FINE TB .10sec,CALL SPRAY ;", "not read"),
    (b"   3:L P[9] 10mm/sec FINE ;\n   4:  WAIT   .50(sec) ;", "position 9 is not declared"),
    (b"   3:  CALL SUB1 ;", "calls"),
    (b"   3:  JMP LBL[1] ;", "loops, branches and calls"),
    (b"   3:  IF R[1]=5,JMP LBL[1] ;", "loops"),
    (b"   3:  FOR R[1]=1 TO 5 ;", "loops"),
    (b"   3:  PAUSE ;", "loops"),
    (b"   3:  R[1]=R[1]+1 ;", "registers"),
    (b"   3:  PR[1,3]=5 ;", "registers"),
    (b"   3:  $WAITTMOUT=100 ;", "registers"),
    (b"   3:  UFRAME_NUM=7 ;\n   4:L P[2] 10mm/sec FINE ;\n   5:  WAIT   .50(sec) ;", "another tool or frame"),
    (b"   3:  WELD_ON ;", "does not know this statement"),
    (b"WAIT .50(sec) ;", "does not know this statement"),
]
UR = [
    (b"  sleep(t1)", "no plain number"),
    (b"  sleep(0.5*2)", "no plain number"),
    (b"  sleep(1, 2)", "no plain number"),
    (b"  movel(p1)\n  sleep(-1)", "zero or more"),
    (b"  sleep(0.5)", "two dwells at one point"),
    (b"  movel(p1, a=1, v=0.1, r=0.001)\n  sleep(0.5)", "fly-by move of line 6"),
    (b"  movel(p1, 1, 0.1, 0, 0.001)\n  sleep(0.5)", "fly-by"),
    (b"  movel(p1, accel, speed, 0, blend)\n  sleep(0.5)", "fly-by"),
    (b"  movep(p1, 1, 0.1, 0.001)\n  sleep(0.5)", "fly-by"),
    (b"  movel(pose_add(p1, p[0,0,0.1,0,0,0]))", "not read"),
    (b"  movel([0,0,0,0,0,0])", "not read"),
    (b"  movel(p2)\n  sleep(1)", "position p2 is not declared before"),
    (b"  movel(p[0,0,0])", "not read"),
    (b"  servoj([0,0,0,0,0,0])", "not read"),
    (b"  p1 = p[0,0,0,0,0,0]", "declared in line 2 too"),
    (b"  p2 = pose_trans(p1, p1)", "assignments"),
    (b"  t1 = get_steptime()", "assignments"),
    (b"  p1[2] = 0.5", "does not know this statement"),
    (b"  while (True):\n  end", "loops"),
    (b"  if (x):\n  end", "loops"),
    (b"  thread t():\n  end", "loops"),
    (b"  polish2()", "calls"),
    (b"  socket_open(1)", "calls"),
    (b"  set_tcp(p[0,0,0.2,0,0,0])\n  movel(p1)\n  sleep(1)", "another tool or frame"),
    (b"  SLEEP(1)", "calls"),
    (b"  def other():\n  end", "a routine inside a routine"),
]
OUT = b"6 L Z+50 FMAX\n"
MACHINE = "a feed move in machine coordinates"
H = [
    (b"6 L X+10 RL F600\n", "radius compensation"),
    (b"6 L X+10 RR\n", "radius compensation"),
    (b"6 L X+10RL F600\n", "radius compensation"),
    (b"6 L X+10 RL FMAX\n", "radius compensation"),
    (b"6 M136\n", "feed per revolution"),
    (b"6 M3 M136\n", "feed per revolution"),
    (b"6 L X+10 F0.1 M136\n", "feed per revolution"),
    (b"6 L X+10 FMAX M3 M0136\n", "feed per revolution"),
    (b"6 L X+10 FU0.1\n", "not read"),
    (b"6 L Z-1 F600 M91\n", MACHINE),
    (b"6 L Z-1 M92\n", MACHINE),
    (b"6 L Z-1 R0 F600 M8 M91\n", MACHINE),
    (b"6 L X+10 F600 M130\n", MACHINE),
    (b"6 M104\n", MACHINE),
    (b"6 L Z-1 R0 FMAX M91\n7 L X+10 F600\n", "not complete"),
    (b"6 L Z-1 FMAX M5 M92\n7 L X+10 Y+1\n", "not complete"),
    (b"6 L A+0 C+0 FMAX M91\n7 L X+10 Y+1 Z+1 A+3\n", "not complete"),
    (b"6 L Z-1 R0 FMAX M91 M136\n", "feed per revolution"),
    (b"6 TOOL CALL 5 Z S1000 DL+0.5 DR+1\n", "length or radius offset"),
    (b"6 TOOL CALL 5 Z S1000 F500 DR2:+1\n", "length or radius offset"),
    (b"6 TOOL CALL Z DL-0.1\n", "length or radius offset"),
    (b"6 TOOL CALL 5 Z S1000\n7 L X+10\n8 FUNCTION DWELL TIME1\n", "another tool or frame"),
    (b"6 TOOL CALL 1 Z FU0.1\n", "another unit than mm/min"),
    (b"6 L X+10 M99\n", "cycles"),
    (b"6 L X+10 Y+1 R0 FMAX M99\n", "cycles"),
    (b"6 M89\n", "cycles"),
    (b"6 FUNCTION TCPM F CONT AXIS POS PATHCTRL AXIS\n", "F CONT"),
    (b"6 M6\n", "waits for a person"),
    (b"6 L X+10 M0\n", "waits for a person"),
    (b"6 M101\n", "changes tools, feeds or the path"),
    (b"6 L X+10 M124\n", "changes tools, feeds or the path"),
    (b"6 M30\n7 L X+10\n", "after the end of the program in line 6"),
    (b"6 M5 M2\n" + OUT, "after the end of the program in line 6"),
    (b"6 L Z+50 R0 FMAX M30\n7 FUNCTION DWELL TIME1\n", "after the end of the program in line 6"),
    (b"6 L X+10 M9 M02\n" + OUT, "after the end of the program in line 6"),
]
MELFA = [
    (b"End\nMvs P1\n", "after the end of the program in line 6"),
    (b"Hlt\nMov P1\n", "after the end of the program in line 6"),
    (b"M_Tool=2\nMvs P1\nDly 1\n", "another tool or frame"),
]
KRL += [
    (b"$IPO_MODE=#TCP", "the robot holds the part"),
    (b"$ORI_TYPE=#CONSTANT", "orientation type"),
    (b"DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}", "a part that the robot holds"),
]
TP += [(b"   3:L P[2] 10mm/sec FINE RTCP ;", "the robot holds the part")]
TRAPS = [
    (name, body, reason)
    for name, traps in (
        ("rapid", RAPID), ("krl", KRL), ("fanuc-tp", TP), ("urscript", UR), ("heidenhain", H), ("melfa-basic", MELFA),
    )
    for body, reason in traps
]  # fmt: skip


@pytest.mark.parametrize(("name", "body", "reason"), TRAPS)
def test_a_trap_is_refused_by_line(name: str, body: bytes, reason: str) -> None:
    with pytest.raises(ProgramError, match=reason) as refused:
        read(profile(name), around(name, body + b"\n"), "trap.txt")
    found = re.match(r"trap\.txt, line (\d+): .*: \"(.*)\"\. To do: .+\.$", str(refused.value))
    assert found
    line = int(found[1])
    assert 6 <= line <= 6 + body.count(b"\n")
    shown = around(name, body + b"\n").split(b"\n")[line - 1].decode("ascii", "backslashreplace").strip()
    assert found[2] == shown or (len(shown) > 80 and found[2] == shown[:77] + "...")


@pytest.mark.parametrize("name", LANGUAGES)
def test_the_frame_of_the_traps_is_a_good_program(name: str) -> None:
    assert read(profile(name), around(name, b""), "trap.txt").time_s.tolist() == [0.5]


HARMLESS = [
    ("heidenhain", b"6 L Z-1 R0 FMAX M91\n7 L X+0 Y+0 R0 FMAX\n8 L Z+50 FMAX M9\n9 M5\n10 M30\n"),
    ("heidenhain", b"6 TOOL CALL Z S500\n7 L Z+50 R0 FMAX M5 M30\n"),
    ("heidenhain", b"6 L Z+0 FMAX M92 M5\n7 L M140 MB MAX\n8 M2\n"),
    ("krl", b"$IPO_MODE = #BASE\n$ORI_TYPE=#VAR\n"),
    ("melfa-basic", b"Hlt\nEnd\n"),
]


@pytest.mark.parametrize(("name", "body"), HARMLESS)
def test_what_changes_no_point_is_read(name: str, body: bytes) -> None:
    assert read(profile(name), around(name, body), "part.txt").time_s.tolist() == [0.5]


SECOND = {
    "rapid": (b"ENDPROC\nPROC sub()\n", b""),
    "krl": (b"END\nDEF sub()\n", b""),
    "urscript": (b"end\ndef sub():\n", b""),
}


@pytest.mark.parametrize("name", SECOND)
def test_a_second_routine_that_moves_is_refused(name: str) -> None:
    between = SECOND[name][0]
    text = HEAD[name] + MOVE[name] + DWELL[name] + between + MOVE[name] + TAIL[name]
    with pytest.raises(ProgramError, match=r"line 8: a second routine that moves \(the first begins in line"):
        read(profile(name), text, "part.txt")
    still = HEAD[name] + MOVE[name] + DWELL[name] + between + TAIL[name]
    assert read(profile(name), still, "part.txt").n == 1


AFTER = [
    ("rapid", b"MoveL p1,v10,fine,tool0;\n", "after the end of the program"),
    ("rapid", b"MODULE Other\n", "after the end of the program"),
    ("krl", b"WAIT SEC 1\n", "outside any routine"),
    ("fanuc-tp", b"/PROG OTHER\n/ATTR\n/MN\n", "after the end of the program"),
    ("urscript", b"sleep(1)\n", "outside any routine"),
    ("urscript", b"other()\n", "a call of something else"),
    ("urscript", b"m()\nm()\n", "after the end of the program"),
]


@pytest.mark.parametrize(("name", "text", "reason"), AFTER)
def test_what_follows_the_end_is_refused_unless_it_is_a_comment(name: str, text: bytes, reason: str) -> None:
    with pytest.raises(ProgramError, match=reason):
        read(profile(name), around(name, b"") + text, "part.txt")
    comments = profile(name).comments
    for comment in comments:
        remark = comment.encode() + b" WaitTime 9; sleep(9) \xff\n\n"
        assert read(profile(name), around(name, b"") + remark, "part.txt").n == 1


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_program_that_breaks_off_is_refused_wherever_it_does(name: str) -> None:
    text = PROGRAMS[name].text
    ends = [index + 1 for index in range(len(text) - 1) if text[index : index + 1] == b"\n"]
    whole = {"krl": 1, "urscript": 2, "val3": 3}.get(
        name, 1
    )  # the last lines after the end may be missing: blank, or a call
    for end in ends[: -whole or None]:
        with pytest.raises(ProgramError):
            read(profile(name), text[:end], "part.txt")


@pytest.mark.parametrize("name", LANGUAGES)
@pytest.mark.parametrize("text", [b"", b"\n\n", b"G21 G90\nG1 X1 F100\nG4 P0.5\nM2\n", b"\x00\x01\x02", b"\xff\xfe"])
def test_no_program_at_all_is_refused(name: str, text: bytes) -> None:
    with pytest.raises(ProgramError, match=r"part\.txt.*To do:"):
        read(profile(name), text, "part.txt")


@pytest.mark.parametrize("name", LANGUAGES)
@pytest.mark.parametrize("other", LANGUAGES)
def test_a_program_in_another_language_is_refused(name: str, other: str) -> None:
    if name != other:
        with pytest.raises(ProgramError):
            read(profile(name), PROGRAMS[other].text, "part.txt")


@pytest.mark.parametrize("name", LANGUAGES)
def test_time_in_two_places_is_refused(name: str) -> None:
    assert read(profile(name), around(name, 4 * MOVE[name]), "part.txt").n == 1
    first = (HEAD[name] + MOVE[name] + DWELL[name]).count(b"\n") + 1
    with pytest.raises(ProgramError, match=rf"line {first}: 1 feed moves have a dwell, 5 have none"):
        read(profile(name), around(name, 5 * MOVE[name]), "part.txt")


@pytest.mark.parametrize("name", LANGUAGES)
def test_moves_without_any_dwell_carry_no_time(name: str) -> None:
    with pytest.raises(ProgramError, match="nothing carries time"):
        read(profile(name), HEAD[name] + MOVE[name] + TAIL[name], "part.txt")


def test_a_position_of_tp_in_another_frame_is_refused() -> None:
    text = around("fanuc-tp", b"   3:L P[2] 10mm/sec FINE ;\n   4:  WAIT 1.00(sec) ;\n")
    assert read(profile("fanuc-tp"), text, "part.ls").n == 2
    at = text.rindex(b"UF : 1")
    with pytest.raises(ProgramError, match=r"line 6: another tool or frame \(1, 2\) than at the first point \(1, 1\)"):
        read(profile("fanuc-tp"), text[:at] + b"UF : 2" + text[at + 6 :], "part.ls")


def test_only_constant_robtargets_are_positions() -> None:
    text = around("rapid", b"")
    for scope in (b"PERS", b"VAR", b"TASK PERS"):
        with pytest.raises(ProgramError, match="p1 is not declared as a constant"):
            read(profile("rapid"), text.replace(b"CONST", scope), "part.mod")
