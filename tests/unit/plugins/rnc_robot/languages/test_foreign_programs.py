"""Programs in the shapes that controllers, post-processors and shops write: read, or refused with line and remedy."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import detect, dialect
from polishd.plugins.rnc_robot.verify import verify
from tests.unit.plugins.rnc_robot.languages.test_data_file import DTX

EXTAX = "[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"


def rapid(*body: str, more: str = "") -> str:
    """A module of RobotStudio's shape."""
    points = [(10, 0, 0, 70), (20, 0, 0, 20), (30, 16, 0, 20), (40, 16, 8, 20)]
    targets = [f"    CONST robtarget T_{k}:=[[{x},{y},{z}],[0,1,0,0],{EXTAX}];" for k, x, y, z in points]
    return "\n".join(["MODULE Module1", *targets, more, *body, "ENDMODULE"])


def go(target: int, speed: str = "v60", zone: str = "z10") -> str:
    return f"        MoveL T_{target},{speed},{zone},TCP\\WObj:=wPart;"


PATH = ("    PROC Path_10()", go(10, "v1000", "z100"), go(20), go(30), go(40, zone="fine"), "    ENDPROC")
TP = """/PROG  POLI\t  Process
/ATTR
{head}/MN
{lines}
/POS
{positions}/END
"""
ENGLISH = (
    "OWNER\t\t= MNEDITOR;\nCREATE\t\t= DATE 25-01-09  TIME 16:56:42;\nLINE_COUNT\t= {count};\n"
    "TCD:  STACK_SIZE\t= 0,\n      TASK_PRIORITY\t= 50;\nDEFAULT_GROUP\t= 1,*,*,*,*;\n"
)
GERMAN = 'EIGN.\t\t= MNEDITOR;\nKOMM.\t\t= "Gr\xf6\xdfe";\nZEILEN\t\t= 3;\n'


def tp(*lines: str, head: str = ENGLISH, group: str = "") -> str:
    positions = [
        f"P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {k:9.3f}  mm,\tY =     0.000  mm,"
        f"\tZ =   235.074  mm,\n\tW =   145.578 deg,\tP =    -6.192 deg,\tR =    88.040 deg{group}\n}};\n"
        for k in (1, 2, 3)
    ]
    numbered = "\n".join(f"{k:4d}:{line} ;" for k, line in enumerate(lines, 1))
    head = head.replace("{count}", str(len(lines)))
    return TP.format(head=head, lines=numbered, positions="".join(positions))


def job(*body: str, positions: str = "", head: str = "") -> str:
    c = [f"C{k:05d}={x}.000,0.000,20.000,180.00,0.00,0.00\r\n" for k, x in enumerate((100, 101, 103))]
    return (
        f"{head}/JOB\r\n//NAME POLI\r\n//POS\r\n///NPOS 3,0,0,0,0,0\r\n///USER 2\r\n///TOOL 1\r\n///POSTYPE USER\r\n"
        "///RECTAN \r\n///RCONF 1,0,0,0,0,0,0,0\r\n" + (positions or "".join(c)) + "//INST\r\n"
        "///DATE 2024/01/01 10:00\r\n///COMM\r\n///ATTR SC,RW,RJ\r\n////FRAME USER 2\r\n///GROUP1 RB1\r\nNOP\r\n"
        + "".join(f"{line}\r\n" for line in body)
        + "END\r\n"
    )


def val3(*body: str) -> str:
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2">\n'
        '  <Program name="move">\n    <Parameters xmlns="http://www.staubli.com/robotics/VAL3/Param/1">\n'
        '      <Parameter name="x_nX" type="num" xsi:type="element" />\n    </Parameters>\n    <Code><![CDATA[begin\n'
        + "".join(f"  {line}\n" for line in body)
        + "end]]></Code>\n  </Program>\n</Programs>\n"
    )


INI = (
    "DEF part ( )\n;FOLD INI\n;FOLD BASISTECH INI\nGLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\n"
    "INTERRUPT ON 3\nBAS (#INITMOV,0 )\n;ENDFOLD (BASISTECH INI)\n;ENDFOLD (INI)\n"
)
AXES = "E1 0, E2 0, E3 0, E4 0, E5 0, E6 0"
SPLINE = (
    " WITH $VEL = SVEL_CP(0.02, , LCPDAT{0}), $TOOL = STOOL2(FP{0}), $BASE = SBASE(FP{0}.BASE_NO), $IPO_MODE = "
    "SIPO_MODE(FP{0}.IPO_FRAME), $LOAD = SLOAD(FP{0}.TOOL_NO), $ACC = SACC_CP(LCPDAT{0}), $APO = "
    "SAPO(LCPDAT{0}) C_Spl\n"
)
SPLINES = (
    "DEF part ( )\nDECL E6POS XP1={X 0,Y 0,Z 5,A 0,B 0,C 180}\nDECL E6POS XP2={X 1,Y 0,Z 5,A 0,B 0,C 180}\n"
    "DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\nDECL FDAT FP2={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n"
    "SPTP XP1 WITH $VEL_AXIS[1] = SVEL_JOINT(100), $TOOL = STOOL2(FP1), $BASE = SBASE(FP1.BASE_NO)\n"
    f"SLIN XP2{SPLINE.format(2)}SLIN XP1{SPLINE.format(1)}END\n"
)
MILL = (
    "0  BEGIN PGM side-slots MM \n1  BLK FORM 0.1 Z  X+0  Y-40  Z-100\n2  ;---\n"
    "3  TOOL CALL  Z ;SET TOOL AXIS FOR M140\n"
    "4  L M140 MB MAX\n5  * - Slot1\n6  TOOL CALL 2 Z S3000\n7  M3\n8  L  X+78.008  Y-20 R0 FMAX\n"
    "9  L  Z+15 R0 FMAX\n10 CYCL DEF 32.0 TOLERANCE\n11 CYCL DEF 32.1\n12 L  Z+5 FMAX\n13 L  Z+2.5 F1000\n{}"
    "20 L M140 MB MAX\n21 M30\n22 END PGM side-slots MM \n"
)
DWELLS = (
    "0 BEGIN PGM 2.5D FRAESEN MM\n1 CYCL DEF 247 INIT. REF.PKT ~\n    Q339=1 ;REF.PUNKTNUMMER\n2 TOOL CALL 1 Z S1592\n"
    "3 L X+0 Y+0 Z+50 R0 FMAX\n4 L Z+5 F500\n5 CYCL DEF 9.0 VERWEILZEIT\n6 CYCL DEF 9.1 V.ZEIT 1.5\n"
    "7 L Z+50 FMAX\n8 L X+5 FMAX\n9 L Y+3 F500\n10 CYCL DEF 9.0 DWELL TIME\n11 CYCL DEF 9.1 DWELL2\n"
    "12 M5\n13 END PGM 2.5D FRAESEN MM\n"
)

READ = [
    (
        "main calls the path.mod",
        rapid("    PROC main()", "        !Add code", "        Path_10;", "    ENDPROC", *PATH),
        [50 / 60, 16 / 60, 8 / 60],
    ),
    (
        "offsets.mod",
        rapid(
            "PROC main()",
            "MoveL Offs(T_20,1,0,0), v50, z0, tool0;",
            "MoveL Offs(T_20,2,0,0), v50, z0, tool0;",
            "MoveL Offs(T_20,2,5,0), v50, z0, tool0;",
            "ENDPROC",
        ),
        [1 / 50, 5 / 50],
    ),
    (
        "named speeds.mod",
        rapid(
            "PROC main()",
            "ConfJ\\Off;",
            "VelSet 100,2000;",
            go(20, "vM", "fine"),
            go(30, "vP", "z1"),
            go(40, "vT"),
            "ENDPROC",
            more="LOCAL CONST speeddata vM:=v400;\nCONST speeddata vP:=[50,500,5000,1000];\n"
            "TASK PERS speeddata vT:=[20.00,180.00,5000,1080];",
        ),
        [16 / 50, 8 / 20],
    ),
    (
        "named configuration.mod",
        (
            "MODULE M\r\nVAR extjoint extj := [9E9,9E9,9E9,9E9,9E9,9E9];\r\nVAR confdata conf := [0,0,0,0];\r\n"
            "PROC Main()\r\nMoveAbsJ [[0,0,0,0,90,0],extj],v100,fine,t;\r\n"
            "MoveL [[0,0,0],[0,1,0,0],conf,extj],v20,z1,t \\WObj:=F;\r\n"
            "MoveL [[1,0,0],[0,1,0,0],conf,extj],v20,z1,t \\WObj:=F;\r\nENDPROC\r\nENDMODULE\r\n"
        ),
        [1 / 20],
    ),
    (
        "waits.mod",
        rapid(
            "PROC main()",
            "ClkReset c1;",
            "ClkStart c1;",
            go(20, "v100", "fine"),
            "WaitTime\\InPos,0.2;",
            go(30),
            "WaitTime \\InPos,1;",
            "PulseDO\\PLength:=0.2,do1;",
            "ENDPROC",
        ),
        [0.2, 1],
    ),
    (
        "axis start.src",
        INI + ";FOLD STARTPOSITION - BASE IS 0, TOOL IS 12\n$BWDSTART = FALSE\nPDAT_ACT = {VEL 15,ACC 100}\n"
        "FDAT_ACT = {TOOL_NO 12,BASE_NO 0,IPO_FRAME #BASE}\nBAS (#PTP_PARAMS,15)\n"
        "PTP  {A1 5,A2 -90,A3 100,A4 5,A5 -10,A6 -5}\n"
        ";ENDFOLD\n$VEL.CP=0.02\n$ADVANCE=3\n"
        + "".join(f"LIN {{E6POS: X {x}.0, Y 0, Z 20, A 0, B 90, C 0, {AXES}}} C_DIS\n" for x in (0, 1, 3))
        + "END\n",
        [0.05, 0.1],
    ),
    (
        "home constant.src",
        (
            "DEF fab()\nDECL AXIS HOME\nBAS(#INITMOV,0)\nHOME = {A1 0, A2 -90, A3 90, A4 0, A5 30, A6 0}\n"
            "$TOOL = TOOL_DATA[1]\n$BASE = {X 244.87, Y -26.5, Z 177.45, A -90.0, B 0.0, C 0.0 }\n"
            "$ORI_TYPE = #JOINT\nPTP HOME\n"
            "$VEL.CP = 0.05      ; m/s\nLIN {X 0, Y 0, Z 2, A 0, B 90, C 0}\n"
            "LIN {X 5, Y 0, Z 2, A 0, B 90, C 0} C_DIS\nPTP HOME\nEND\n"
        ),
        [0.1],
    ),
    ("spline forms.src", SPLINES, [0.05, 0.05]),
    (
        "speeds.ls",
        tp(
            "  UFRAME_NUM=0",
            "  UTOOL_NUM=1",
            "  OVERRIDE=100%",
            "L P[1] 100mm/sec CNT100   ",
            "L P[2] 10mm/sec CNT100   ",
            "L P[3:end] 120cm/min CNT100 ACC50",
        ),
        [0.1, 0.05],
    ),
    (
        "times.ls",
        tp("J P[1] 50% FINE   ", "L P[2] 0.25sec CNT100   ", "L P[3] .500sec CNT100 ACC50   ", head=GERMAN),
        [0.25, 0.5],
    ),
    (
        "groups.ls",
        tp(
            "J P[1] 50% CNT20   ",
            "  TIMER[1]=RESET",
            "  TIMER[1]=START",
            "L P[2] 20mm/sec FINE   ",
            "  DO[1:Pad]=ON",
            "  WAIT    .30(sec)",
            "L P[3] 50mm/sec FINE   ",
            "  WAIT   1.50(sec)",
            head=ENGLISH + "/APPL\n/APPL\n\nAUTO_SINGULARITY_HEADER;\n  ENABLE_SINGULARITY_AVOIDANCE   : TRUE;\n",
            group="\n   GP2:\n\tUF : 0, UT : 1,\n\tJ1=     0.000 deg,\tJ2=     0.000 deg",
        ),
        [0.3, 1.5],
    ),
    (
        "speeds.jbi",
        job("MOVJ C00000 VJ=5.00", "MOVL C00001 V=20.0", "MOVL C00002 V=20.0 PL=1", head="'PP version: 1\r\n"),
        [0.05, 0.1],
    ),
    (
        "waits.jbi",
        job(
            "MOVL C00000 V=300.0 PL=0",
            "DOUT OT#(1) ON",
            "MOVL C00001 V=12.5 PL=0",
            "TIMER T=0.50",
            "MOVL C00002 V=12.5 PL=0",
            "TIMER T=0.75",
            "DOUT OT#(1) OFF",
        ),
        [0.5, 0.75],
    ),
    ("mill.h", MILL.format("14 L  X+70.008 F480\n15 L  Y-12\n"), [2.5 * 60 / 1000, 1, 1]),
    ("dwells.h", DWELLS, [1.5, 2]),
    (
        "called feed.h",
        MILL.format("14 L  X+70.008\n").replace("F1000", "").replace("S3000", "S3000 F480"),
        [2.5 * 60 / 480, 1],
    ),
    (
        "tcpm.h",
        (
            "0 BEGIN PGM tcp MM\n1 TOOL CALL 1 Z S100\n2 FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS\n"
            "3 L X+0 Y+0 Z+0 R0 FMAX M128\n"
            "4 L X+1 A+30 C+45 F60\n5 L X+2 A+20 C+60\n6 M129\n7 END PGM tcp MM\n"
        ),
        [1, 1],
    ),
    (
        "array.pgx",
        val3("cls()", "movel(pPath[0],flange,mFast)", "movel(pPath[1],flange,mPol)", "dos[1] = true", "waitEndMove()"),
        [0.1],
    ),
    (
        "waits.pgx",
        val3(
            "movel(pPath[1],flange,mPol)",
            "waitEndMove()",
            "delay(0.5)",
            "movel(pPath[2],flange,mPol)",
            "waitEndMove()",
            "delay(1)",
        ),
        [0.5, 1],
    ),
    (
        "literal.pgx",
        val3(
            "p1.trsf={1,0,0,180,0,0}",
            "p2.trsf={3,0,0,180,0,0}",
            "mPol.tvel=20",
            "movel(p1,flange,mPol)",
            "movel(p2,flange,mPol)",
        ),
        [0.1],
    ),
]
REFUSED = [
    ("paths.mod", rapid("PROC main()", "Path_10;", "WaitTime 1.5;", "Path_10;", "ENDPROC", *PATH), 10, "a second call"),
    ("two paths.mod", rapid("PROC main()", "Path_10;", go(20), "ENDPROC", *PATH), 12, "a second routine that moves"),
    (
        "itself.mod",
        rapid("PROC main()", "Path_10;", "ENDPROC", "PROC Path_10()", go(20), go(30), "main;", "ENDPROC"),
        8,
        "calls itself",
    ),
    ("nowhere.mod", rapid("PROC main()", "Grind;", go(20), go(30), "ENDPROC"), 8, "no routine of this name"),
    (
        "force.mod",
        rapid("PROC Polish()", go(20), "FCPressL T_30,v30,300,fine,TCP\\WObj:=wPart;", "ENDPROC"),
        9,
        "does not know",
    ),
    ("velset.mod", rapid("PROC main()", "VelSet 50,2000;", go(20), go(30), "ENDPROC"), 8, "override that is not 100 %"),
    (
        "limit.mod",
        rapid("PROC main()", "VelSet 100,5;", go(20), go(30), "ENDPROC"),
        8,
        r"a limit of the speed below 250 mm/s \(move_time.greatest_mm_s\)",
    ),
    (
        "limit by name.mod",
        rapid("PROC main()", "VelSet 100,vMax;", go(20), go(30), "ENDPROC"),
        8,
        "a limit of the speed",
    ),
    ("array.mod", rapid("PROC main()", "MoveL T{1},v50,z1,tool0;", "ENDPROC"), 8, "not read"),
    ("partial.src", INI + "$VEL.CP = 0.100\nLIN {X 1000,Y 500,Z 82}\nEND\n", 10, "not read"),
    ("loop.src", INI + "FOR I=1 TO 6\n   $VEL_AXIS[I]= 20\nENDFOR\nEND\n", 9, "loops"),
    (
        "tool and base.src",
        SPLINES.replace("SBASE(FP2.BASE_NO)", "SBASE(FP1.BASE_NO)"),
        7,
        "the tool of FP2 with the base of FP1",
    ),
    ("relative.src", INI + "LIN_REL{Z -20}#TOOL\nEND\n", 9, "relative moves"),
    (
        "override.src",
        INI + "$OV_PRO=50\n$VEL.CP=0.1\nLIN {X 0,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1,Y 0,Z 0,A 0,B 0,C 0}\nEND\n",
        9,
        "override",
    ),
    (
        "override.ls",
        tp("  OVERRIDE=20%", "L P[1] 10mm/sec CNT100", "L P[2] 10mm/sec CNT100"),
        10,
        "override that is not 100 %",
    ),
    ("pause.ls", tp("J P[1] 100% FINE", "  PAUSE", "L P[2] 10mm/sec CNT100"), 11, "not read"),
    (
        "register.ls",
        tp("J P[1] 100% FINE", "L P[2] R[63:TravelSpd]mm/sec CNT100"),
        11,
        "speed of this move is no number",
    ),
    ("offset.ls", tp("L P[1] 100mm/sec CNT100 Offset,PR[5:before pick]   "), 10, "not read"),
    ("call.ls", tp("J P[1] 100% FINE", "  CALL LASER_OFF   "), 11, "calls are not read"),
    (
        "pulses.jbi",
        job(
            "MOVJ C00000 VJ=5.00",
            "MOVL C00001 V=80.0",
            positions="///PULSE\r\nC00000=1000,0,20,0,0,0\r\nC00001=9,0,2,0,0,0\r\nC00002=9,0,2,0,0,0\r\n",
        ),
        22,
        r"the position C00001 is in pulses or angles of the axes \(line 12, under ///PULSE\)",
    ),
    ("station.jbi", job("MOVL C00000 EC00000 V=20.0"), 20, "not read"),
    ("nwait.jbi", job("MOVL C00000 V=20.0 PL=0 NWAIT"), 20, "not read"),
    ("call.jbi", job("MOVL C00000 V=20.0 PL=0", "CALL JOB:TRJ1"), 21, "calls are not read"),
    ("shift.jbi", job("SFTON P000 RF"), 20, "variables are not read"),
    ("arc.h", MILL.format("14 CC  X+700.01  Z+108\n15 CP IPA+90 DR+ F1000\n"), 15, "not read"),
    ("parameter.h", MILL.format("14 FN 0: Q50 =+550 ; Cutting\n"), 15, "parameters"),
    ("comma.h", MILL.format("14 L X-6,964 Y+0 F1000\n"), 15, "decimal comma"),
    ("open.h", MILL.format("14 L M140 MB MAX\n15 L X+1 F100\n"), 16, "not complete"),
    (
        "drill.h",
        MILL.format("14 CYCL DEF 200 DRILLING ~\n    Q200=+5    ;SET-UP CLEARANCE\n"),
        15,
        "not read|set by the program",
    ),
    ("parameter.pgx", val3("pPoint.trsf.x = x_nX", "movel(pPoint,tTool,mNom)"), 8, "assignments"),
    ("call.pgx", val3('putln("started")', "call x_000()"), 9, "calls"),
    ("arc.pgx", val3("movec(pPath[1],pPath[2],flange,mPol)"), 8, "not read"),
    ("approach.pgx", val3("pA = appro(pPath[0], {0, 0, -100, 0, 0, 0})"), 8, "assignments|not read"),
    ("no wait.pgx", val3("movel(pPath[1],flange,mPol)", "delay(0.5)"), 9, "delay does not wait"),
]


def beside(name: str) -> bytes:
    return DTX if name.endswith(".pgx") else b""


@pytest.mark.parametrize(("name", "text", "times"), READ, ids=[name for name, *_ in READ])
def test_a_foreign_program_is_read_and_rewritten(name: str, text: str, times: list[float]) -> None:
    data = text.encode("latin-1")
    language = dialect(detect(data, name).dialect)
    program = formats.read(language, data, name, beside(name))
    np.testing.assert_allclose(program.time_s, times, rtol=1e-9)
    assert formats.rewrite(language, program, program.time_s) == data
    wanted = program.time_s * 1.25
    new = formats.rewrite(language, program, wanted)
    again = formats.read(language, new, name, beside(name))
    np.testing.assert_allclose(again.time_s, wanted, rtol=0.01, atol=0.0051)
    assert verify(data, new, language, beside=beside(name)).identical_motion


@pytest.mark.parametrize(("name", "text", "line", "reason"), REFUSED, ids=[name for name, *_ in REFUSED])
def test_a_foreign_program_is_refused_with_line_and_remedy(name: str, text: str, line: int, reason: str) -> None:
    data = text.encode("latin-1")
    with pytest.raises(ProgramError, match=rf"line {line}: .*({reason}).*To do: "):
        formats.read(dialect(detect(data, name).dialect), data, name, beside(name))


def test_a_rapid_move_behind_a_dwell_sets_the_coordinates_that_hold() -> None:
    """A block after it that leaves Z out works at the height of the rapid move."""
    program = formats.read(dialect("heidenhain"), DWELLS.encode(), "p.h")
    assert program.end_mm.tolist() == [[0, 0, 5], [5, 3, 50]]
