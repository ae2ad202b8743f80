"""A realistic program in each language, and the frame that single statements are tried in."""

from __future__ import annotations

from typing import NamedTuple

from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.languages import LanguageProfile

LANGUAGES = ("rapid", "krl", "fanuc-tp", "urscript", "inform", "val3", "heidenhain", "melfa-basic", "kawasaki-as")

# Latin-1 bytes in a comment, as an old teach pendant writes them.
RAPID = (
    rb"""%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE Polish
  ! WaitTime 9; Gr"""
    b"\xfc\xdf"
    rb"""e
  TASK PERS tooldata tPad:=[TRUE,[[0,0,150],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];
  CONST string note:="MoveL p10; WaitTime 9; ! no comment";
  CONST robtarget p10:=[[100.5,0,20],[0,1,0,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  LOCAL CONST robtarget p20:=[[101.5,-2,20],[0.7071068,0,0.7071068,0],[0,0,-1,0],
    [9E+09,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    ConfL\Off;
    TPWrite "WaitTime 9;";
    MoveJ p10, v500, z10, tPad\WObj:=wobj1;
    MoveL p10, v100, fine, tPad\WObj:=wobj1;
    WaitTime 0.50;
    MoveL P20, v100\T:=2, z1, tPad \WObj:=wobj1; WaitTime \InPos,.25; ! WaitTime 9;
    movel [[102,0,20],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v20,fine,tPad\WObj:=wobj1;
    waittime 1;
    MoveL Offs(p20,0,0,50),v200,fine,tPad\WObj:=wobj1;
    SetDO doSpindle,0;
  ENDPROC
ENDMODULE
"""
)

KRL = (
    rb"""&ACCESS RVP
&REL 1
&PARAM TEMPLATE = C:\KRC\Roboter\Template\vorgabe
DEF POLISH( )
;FOLD INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
;ENDFOLD (INI)
$TOOL = TOOL_DATA[1]
$BASE = BASE_DATA[2]
$VEL.CP=0.05
PTP XHOME
; WAIT SEC 9 """
    b"\xe4"
    rb"""
DECL E6POS XP1={X 101.0,Y -2.0,Z 5.0,A 90.0,B 0.0,C 90.0,S 2,T 35,E1 0.0}
LIN {X 100.0, Y 0.0, Z 5.0, A 0.0, B 0.0, C 180.0, E1 0.0} C_DIS
WAIT SEC 0.50 ; WAIT SEC 9
lin xp1
wait sec .25
$OUT[3]=FALSE
LIN {X 100.0, Y 0.0, Z 55.0, A 0.0, B 0.0, C 180.0}
END
"""
)

TP = b"""/PROG  POLISH
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "WAIT 9.00(sec)";
LINE_COUNT\t= 12;
DEFAULT_GROUP\t= 1,*,*,*,*;
/APPL
/MN
   1:  UFRAME_NUM=4 ;
   2:  UTOOL_NUM=2 ;
   3:  !WAIT 9.00(sec) ;
   4:  //L P[9] 100mm/sec FINE ;
   5:J P[3] 100% CNT50    ;
   6:L P[1] 100mm/sec FINE ACC10    ;
   7:  WAIT    .50(sec) ;
   8:L P[2:two \xe9] 120cm/min FINE    ;
   9:  WAIT   1.00(sec) ;
  10:  DO[1]=OFF ;
  11:L P[3] 2.0sec FINE    ;
  12:   ;
/POS
P[1]{
   GP1:
\tUF : 4, UT : 2,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =      .044  mm,\tY =    -4.101  mm,\tZ =   300.000  mm,
\tW =     90.000 deg,\tP =     0.000 deg,\tR =     0.000 deg,
\tE1= -1290.488  mm
};
P[2:"two \xe9"]{
   GP1:
\tUF : 4, UT : 2,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =      1.044  mm,\tY =    -4.101  mm,\tZ =   300.000  mm,
\tW =     180.000 deg,\tP =     0.000 deg,\tR =     90.000 deg
};
P[3]{
   GP1:
\tUF : 4, UT : 2,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =      1.044  mm,\tY =    -4.101  mm,\tZ =   350.000  mm,
\tW =     180.000 deg,\tP =     0.000 deg,\tR =     90.000 deg
};
P[4]{
   GP1:
\tUF : 4, UT : 2,
\tJ1=     0.000 deg,\tJ2=     0.000 deg,\tJ3=     0.000 deg
};
/END
"""

UR = b"""# sleep(9) \xc3\xa4
def polish():
  set_tcp(p[0, 0, 0.15, 0, 0, 0])
  textmsg("# sleep(9)")
  global p1 = p[0.1, 0.2, 0.3, 3.141592653589793, 0, 0]
  movej([0, -1.57, 1.57, 0, 1.57, 0], a=1.4, v=1.05)
  movel(p1, a=1.2, v=0.25, r=0)
  sleep(0.50) # sleep(9)
  $ 3 "Waypoint_2"
  movel(p[0.101, 0.2, 0.3, 0, 1.5707963267948966, 0], 1.2, 0.1, 0, 0)
  sleep(1)
  set_standard_digital_out(1, False)
  movel(p[0.101, 0.2, 0.4, 0, 1.5707963267948966, 0], v=0.25)
end
polish()
"""


INFORM = b"""/JOB
//NAME POLISH
//POS
///NPOS 4,0,0,0,0,0
///TOOL 2
///POSTYPE PULSE
///PULSE
C00000=1000,-2000,3000,0,0,0
///USER 1
///POSTYPE USER
///RECTAN
///RCONF 0,0,0,0,0,0,0,0
C00001=100.000,0.000,20.000,180.0000,0.0000,0.0000
C00002=101.000,-2.000,20.000,90.0000,0.0000,0.0000
C00003=101.000,-2.000,70.000,90.0000,0.0000,0.0000
//INST
///DATE 2024/02/29 12:00
///COMM SCHLEIFEN \xe4
///ATTR SC,RW,RJ
////FRAME USER 1
///GROUP1 RB1
NOP
'TIMER T=9.00 \xe4
MOVJ C00000 VJ=10.00
MOVL C00001 V=100.0 PL=0
TIMER T=0.50
DOUT OT#(1) ON
MOVL C00002 V=12.5 PL=0 ACC=20 DEC=20
TIMER T=1.00
MOVL C00003 V=300.0
END
"""

VAL3 = b"""<?xml version="1.0" encoding="iso-8859-1" ?>
<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2">
  <Program name="polish" access="public">
    <Locals>
      <Local name="nI" type="num" xsi:type="array" size="1" />
    </Locals>
    <Code><![CDATA[begin
  // delay(9) \xe4
  p1.trsf={100, 0, 20, 180, 0, 0}
  pPath[2].trsf={101,-2,20,90,0,0}
  mPol.blend=off
  mPol.tvel=100
  mFast.tvel=800
  movej(jHome,tTool,mNom)
  movel(p1,tTool,mPol) // delay(9)
  waitEndMove()
  delay(0.50)
  mPol.tvel=20
  movel(pPath[2],tTool,mPol)
  waitEndMove()
  delay(1)
  movel(p1,tTool,mFast)
  waitEndMove()
end]]></Code>
  </Program>
</Programs>
"""

HEIDENHAIN = b"""0  BEGIN PGM POLISH MM
1  BLK FORM 0.1 Z X-50 Y-50 Z-20
2  BLK FORM 0.2 X+50 Y+50 Z+0
3  ; CYCL DEF 9.1 9 \xe4
4  TOOL CALL 7 Z S200
5  FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS
6  L X+100 Y+0 Z+50 A+0 C+0 R0 FMAX M3
7  L Z+20 F6000
8  CYCL DEF 9.0 VERWEILZEIT
9  CYCL DEF 9.1 V.ZEIT 0.50
10 L X+101 Y-2 A+90 C+90 F1200 ; FUNCTION DWELL TIME9
11 FUNCTION DWELL TIME1
12 L Z+70 FMAX
13 M30
14 END PGM POLISH MM
"""

MELFA = b"""1 'Dly 9 \xe4
2 Tool (0,0,150,0,0,0)
3 Ovrd 100
4 Cnt 0
5 Mov PHome
6 Spd 100
7 Mvs P1 ' Dly 9
8 Dly 0.50
9 M_Out(8)=1
10 Spd 20
11 Mvs P2
12 Dly 1
13 Spd 300
14 Mvs P3
15 Hlt
16 End
P1=(100.000,0.000,20.000,180.000,0.000,0.000)(7,0)
P3=(101.000,-2.000,70.000,90.000,0.000,0.000)(7,0)
P2=(101.000,-2.000,20.000,90.000,0.000,0.000)(7,0)
"""

AS = b""".PROGRAM polish() ; TWAIT 9
  ; TWAIT 9 \xe4
  ACCURACY 1 ALWAYS
  JMOVE p0
  SPEED 100 MM/S ALWAYS
  LMOVE p1
  BREAK
  TWAIT 0.50
  SIGNAL 3
  SPEED 1200 MM/MIN ALWAYS
  LMOVE p2
  BREAK
  TWAIT 1 ; TWAIT 9
  SPEED 300 MM/S ALWAYS
  LMOVE p0
.END
.TRANS
p0 101.000 -2.000 70.000 0.000 90.000 0.000
p1 100.000 0.000 20.000 0.000 180.000 0.000
p2 101.000 -2.000 20.000 0.000 90.000 0.000
.END
"""


class Expected(NamedTuple):
    """A program and what it says."""

    text: bytes
    time_s: list[float]
    line: list[int]
    end_mm: list[list[float]]
    axis: list[list[float]]
    feed_mm_min: list[float]


NAN = float("nan")
PROGRAMS = {
    "rapid": Expected(
        RAPID,
        [0.5, 0.25, 1.0],
        [17, 18, 20],
        [[100.5, 0, 20], [101.5, -2, 20], [102, 0, 20]],
        [[0, 0, 1], [-1, 0, 0], [0, 0, 1]],
        [6000, NAN, 1200],
    ),
    "krl": Expected(
        KRL,
        [0.5, 0.25],
        [17, 19],
        [[100, 0, 5], [101, -2, 5]],
        [[0, 0, 1], [-1, 0, 0]],
        [3000, 3000],
    ),
    "fanuc-tp": Expected(
        TP,
        [0.5, 1.0],
        [15, 17],
        [[0.044, -4.101, 300], [1.044, -4.101, 300]],
        [[0, 1, 0], [0, 0, 1]],
        [6000, 1200],
    ),
    "urscript": Expected(
        UR,
        [0.5, 1.0],
        [8, 11],
        [[100, 200, 300], [101, 200, 300]],
        [[0, 0, 1], [-1, 0, 0]],
        [15000, 6000],
    ),
    "inform": Expected(
        INFORM, [0.5, 1.0], [26, 29], [[100, 0, 20], [101, -2, 20]], [[0, 0, 1], [0, 1, 0]], [6000, 750]
    ),
    "val3": Expected(VAL3, [0.5, 1.0], [17, 21], [[100, 0, 20], [101, -2, 20]], [[0, 0, 1], [0, 1, 0]], [6000, 1200]),
    "heidenhain": Expected(
        HEIDENHAIN, [0.5, 1.0], [10, 12], [[100, 0, 20], [101, -2, 20]], [[0, 0, 1], [1, 0, 0]], [6000, 1200]
    ),
    "melfa-basic": Expected(
        MELFA, [0.5, 1.0], [8, 12], [[100, 0, 20], [101, -2, 20]], [[0, 0, 1], [0, 1, 0]], [6000, 1200]
    ),
    "kawasaki-as": Expected(
        AS, [0.5, 1.0], [8, 13], [[100, 0, 20], [101, -2, 20]], [[0, 0, 1], [-1, 0, 0]], [6000, 1200]
    ),
}

_POSE = b"[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]"
_TP_POSE = b"""P[%d]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX = %d.000 mm,\tY = 0.000 mm,\tZ = 0.000 mm,
\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg
};
"""
HEAD = {
    "rapid": b"MODULE M\nCONST robtarget p1:=[[1,0,0]," + _POSE + b"];\nPROC main()\n",
    "krl": b"DEF M()\nXP1={X 1,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=0.1\n",
    "fanuc-tp": b"/PROG M\n/ATTR\n/MN\n",
    "urscript": b"def m():\n  p1 = p[0.001, 0, 0, 3.1415926, 0, 0]\n  set_tcp(p[0,0,0,0,0,0])\n",
    "inform": b"//NAME M\n///RECTAN\nC00001=1.000,0.000,0.000,180.0,0.0,0.0\n",
    "val3": b"begin\np1.trsf={1,0,0,180,0,0}\nmPol.tvel=100\n",
    "heidenhain": b"0 BEGIN PGM M MM\n1 TOOL CALL 1 Z\n2 M3\n",
    "melfa-basic": b"Ovrd 100\nP1=(1,0,0,180,0,0)(7,0)\nSpd 100\n",
    "kawasaki-as": b".PROGRAM m()\nACCURACY 1 ALWAYS\nSPEED 100 MM/S ALWAYS\n",
}
"""Three lines before the body."""
MOVE = {
    "rapid": b"MoveL p1,v100,fine,tool0;\n",
    "krl": b"LIN XP1\n",
    "fanuc-tp": b"    :L P[1] 100mm/sec FINE ;\n",
    "urscript": b"  movel(p1, a=1.2, v=0.1)\n",
    "inform": b"MOVL C00001 V=100.0 PL=0\n",
    "val3": b"movel(p1,tTool,mPol)\n",
    "heidenhain": b"3 L X+1 Y+0 Z+0 A+0 C+0 F6000\n",
    "melfa-basic": b"Mvs P1\n",
    "kawasaki-as": b"LMOVE p1\n",
}
DWELL = {
    "rapid": b"WaitTime 0.5;\n",
    "krl": b"WAIT SEC 0.5\n",
    "fanuc-tp": b"    :  WAIT    .50(sec) ;\n",
    "urscript": b"  sleep(0.5)\n",
    "inform": b"TIMER T=0.5\n",
    "val3": b"waitEndMove() delay(0.5)\n",
    "heidenhain": b"4 FUNCTION DWELL TIME0.5\n",
    "melfa-basic": b"Dly 0.5\n",
    "kawasaki-as": b"BREAK\nTWAIT 0.5\n",
}
TAIL = {
    "rapid": b"ENDPROC\nENDMODULE\n",
    "krl": b"END\n",
    "fanuc-tp": b"/POS\n" + _TP_POSE % (1, 1) + _TP_POSE % (2, 2) + b"/END\n",
    "urscript": b"end\n",
    "inform": b"END\n",
    "val3": b"end\n",
    "heidenhain": b"9 END PGM M MM\n",
    "melfa-basic": b"End\n",
    "kawasaki-as": b".END\n.TRANS\np1 1 0 0 0 180 0\n.END\n",
}


def profile(name: str) -> LanguageProfile:
    """The shipped profile of a robot language."""
    found = dialect(name)
    assert isinstance(found, LanguageProfile)
    return found


def around(name: str, body: bytes) -> bytes:
    """A whole program: a point (lines 4 and 5), then ``body`` from line 6 on."""
    return HEAD[name] + MOVE[name] + DWELL[name] + body + TAIL[name]


def many(name: str, times: list[str]) -> bytes:
    """A program with these dwells as they stand, one point each."""
    body = []
    for index, time in enumerate(times):
        x = f"{index % 1000 * 0.1:.4f}"
        body.append(
            {
                "rapid": f"MoveL [[{x},0,0],{_POSE.decode()}],v50,fine,tool0;\nWaitTime {time};\n",
                "krl": f"LIN {{X {x},Y 0,Z 0,A 0,B 0,C 180}}\nWAIT SEC {time}\n",
                "fanuc-tp": f"  {2 * index + 1}:L P[1] 50mm/sec FINE ;\n  {2 * index + 2}:  WAIT {time}(sec) ;\n",
                "urscript": f"  movel(p[{x},0,0,3.14159,0,0], a=1, v=0.1)\n  sleep({time})\n",
                "inform": f"MOVL C00001 V=50.0 PL=0\nTIMER T={time}\n",
                "val3": f"movel(p1,tTool,mPol)\nwaitEndMove()\ndelay({time})\n",
                "heidenhain": f"1 L X{x} Y0 Z0 F3000\n2 FUNCTION DWELL TIME{time}\n",
                "melfa-basic": f"Mvs ({x},0,0,180,0,0)(7,0)\nDly {time}\n",
                "kawasaki-as": f"LMOVE p1\nBREAK\nTWAIT {time}\n",
            }[name].encode()
        )
    return HEAD[name] + b"".join(body) + TAIL[name]
