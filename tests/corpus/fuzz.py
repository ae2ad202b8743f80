"""Programs for the fuzz: valid lines of each profile in many styles, lines of the corpus, and damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random

from tests.corpus.table import cases

_ODD = [b"\0", b"\r", b"\t", b"\xe4", b"\xff", b"(", b")", b";", b"%", b"#", b"[", b"/", b"*", b"$", b"=", b".", b"-",
        b"+", b"e", b"G", b"M", b"P", b"X", b"F", b"O", b"N", b"9" * 30, b" ", b"G4", b"P9", b"@", b":", b'"',
        b"!", b"~"]  # fmt: skip


@dataclass(frozen=True)
class Grammar:
    """How a valid program of a dialect looks."""

    head: str
    dwells: tuple[str, ...]
    """Formats of a dwell of {s} seconds, {ms} whole milliseconds."""
    inverse: bool = True
    tail: str = "M30\n"
    comments: tuple[str, ...] = ("(G4 P9)", "; G4 P8", "(x)")
    rotary: tuple[str, ...] = (" A{:.2f}", " C{:.3f}", "")
    point: bool = False
    """Numbers need a decimal point."""
    seconds_per: float = 60.0


_G21 = "G21 G90 G94 G17\nG0 X0. Y0. Z0. A0. C0.\n"
_TAPE = "%\nO0001 (PART)\n"
GRAMMARS = {
    "rs274": Grammar(_G21, ("G4 P{s}", "g 4 p{s}", "P{s} G4", "G04P{s}", "G4 P {s}"), tail="M2\n"),
    "fanuc": Grammar(_TAPE + _G21, ("G04 P{ms}", "G04 X{s}", "G04 U{s}", "g04p{ms}"), tail="M30\n%\n",
                     comments=("(G04 P9)", "(x)"), point=True),
    "haas": Grammar(_TAPE + _G21, ("G04 P{ms}", "G4 P{s}", "g04p{s}"), tail="M30\n%\n",
                    comments=("(G04 P9)", "(x)"), point=True),
    "siemens": Grammar("G71 G90 G94 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G4 F{s}", "g4 f{s}", "G04 F{s}"),
                       comments=("; G4 F9", ";x (")),
    "siemens-iso": Grammar(_G21, ("G04 P{ms}", "G04 X{s}", "G04 U{s}"), point=True, comments=("(G04 P9)", "(x)")),
    "twincat-nci": Grammar("G71 G90 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G04 X{s}", "G4 F{s}", "g4 x{s}"), inverse=False,
                           comments=("(G04 X9)", "(x)")),
    "twincat-cnc": Grammar("G71 G90 G94 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G04 X{s}", "G04 {s}", "#TIME {s}", "G4 {s}")),
    "grbl": Grammar("G21 G90 G94\nG0 X0 Y0 Z0\n", ("G4 P{s}", "G4P{s}"), tail="M2\n", rotary=("",)),
    "weihong": Grammar(_G21.replace(" A0. C0.", ""), ("G04 P{ms}", "g4 p{ms}"), inverse=False, rotary=("",),
                       point=True),
    "codesys": Grammar("G90 G17\nG0 X0 Y0 Z0\n", ("G4 T{s}", "G4 Time={s}", "g4 t{s}"), inverse=False, rotary=("",),
                       comments=("(G4 T9)", "(x)"), seconds_per=1.0),
}  # fmt: skip


def program(dialect: str, rng: Random, lines: int, damage: float) -> bytes:
    """A program of about so many lines, of which a share was damaged or taken from the corpus."""
    if dialect in LANGUAGES:
        return _language_program(dialect, rng, lines, damage)
    grammar = GRAMMARS[dialect]
    encoding = rng.choice(["dwell", "dwell", "feed", "inverse"] if grammar.inverse else ["dwell", "dwell", "feed"])
    end = rng.choice(["\n", "\n", "\r\n"])
    write = _Lines(grammar, rng, encoding)
    text = grammar.head + ("G93\n" if encoding == "inverse" else "") + write.first()
    body = [line.encode("latin-1") for line in text.splitlines()]
    while len(body) < lines:
        fresh = [line.encode("latin-1") for line in write.point()]
        body += [_spoilt(dialect, line, rng) if rng.random() < damage else line for line in fresh]
    body += [line.encode() for line in grammar.tail.splitlines()]
    joined = end.encode().join(body)
    return joined + (b"" if rng.random() < 0.2 else end.encode())


class _Lines:
    """Writes points, one after the other, in one encoding."""

    def __init__(self, grammar: Grammar, rng: Random, encoding: str) -> None:
        self._grammar, self._rng, self._encoding = grammar, rng, encoding
        self._number = 0
        self._small = rng.random() < 0.15
        self._commented = rng.random()
        self._place = [0.0, 0.0, 0.0]

    def first(self) -> str:
        return f"F{self._feed()}\n" if self._encoding == "feed" else ""

    def point(self) -> list[str]:
        rng, grammar = self._rng, self._grammar
        found = [self._move()]
        if self._encoding == "dwell":
            seconds = rng.choice([0.0, 0.001, rng.uniform(0, 0.01), rng.random(), rng.uniform(0, 100)])
            number = _number(seconds, rng, True)
            found.append(rng.choice(grammar.dwells).format(s=number, ms=int(seconds * 1000)))
        return [self._style(line) for line in found]

    def _move(self) -> str:
        rng = self._rng
        words = []
        for axis, letter in enumerate("XYZ"):
            if axis == 0 or rng.random() < 0.6:
                self._place[axis] += rng.uniform(1.1, 4) * rng.choice([1, -1])
                words.append(letter + _number(self._place[axis], rng, self._grammar.point))
        turned = rng.choice(self._grammar.rotary).format(rng.uniform(0, 90))
        feed = ""
        if self._encoding == "inverse" or rng.random() < 0.4 or self._number == 0:
            feed = f" F{self._feed()}"
        self._number += 1
        return f"{rng.choice(['G1', 'G01', 'G1'])} {' '.join(words)}{turned}{feed}"

    def _feed(self) -> str:
        return _number(self._rng.uniform(0.5, 40) * self._grammar.seconds_per, self._rng, self._grammar.point)

    def _style(self, line: str) -> str:
        rng, comments = self._rng, self._grammar.comments
        if self._small:
            line = line.lower()
        if rng.random() < 0.2 and not line.startswith("#"):
            line = f"N{self._number}0 {line}"
        if rng.random() < self._commented * 0.3:
            line = f"{line} {rng.choice(comments)}"
        return line + rng.choice(["", "", "", " ", "\t"])


def _number(value: float, rng: Random, point: bool) -> str:
    """Return the value in one of the possible notations."""
    text = f"{value:.{rng.randrange(5)}f}"
    if "." not in text:
        text += "." if point or rng.random() < 0.2 else ""
    elif rng.random() < 0.2 and not point:
        text = text.rstrip("0")
    if float(text) == 0:
        text = text.lstrip("-")
    elif rng.random() < 0.1 and text.startswith("0."):
        text = text[1:]
    return text if any(char.isdigit() for char in text) else "0."


@dataclass(frozen=True)
class Language:
    """How a valid program of a robot language looks; {x}, {y} are mm, {mx}, {my} metres."""

    head: str
    moves: tuple[str, ...]
    dwells: tuple[str, ...]
    neutral: tuple[str, ...]
    odd: tuple[str, ...]
    """Statements that no program survives, or that mean something only elsewhere."""
    tail: str
    comment: str


_POSE = "[0,1,0,0],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]"
_PLACE = (
    "P[{n}]{{\n   GP1:\n\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {x} mm,\tY = -4.5 mm,\tZ = 7 mm,\n"
    "\tW = 180.0 deg,\tP = 0 deg,\tR = 90.000 deg\n}};\n"
)
LANGUAGES = {
    "rapid": Language(
        f"MODULE M\n  CONST robtarget p1:=[[1,0,0],{_POSE}];\n  PROC main()\n    MoveJ p1,v500,z10,tPad;\n",
        (f"MoveL [[{{x}},{{y}},0],{_POSE}],v100,fine,tPad;", "MoveL p1, v50, fine, tPad;", "movel P1,v20,fine,tPad ;",
         "MoveL Offs(p1,{x},{y},0),v200,fine,tPad;", "MoveL p1,v100\\T:=2,fine,tPad;"),
        ("WaitTime {s};", "waittime {s} ;", "WaitTime \\InPos,{s};", "WaitTime\\InPos , {s};"),
        ("SetDO doA,1;", 'TPWrite "WaitTime 9;";', "! WaitTime 9;", "ConfL\\Off;", "AccSet 50,50;"),
        ("WaitTime t1;", "MoveL p2,v100,fine,tPad;", "MoveL p1,v100,z50,tPad;", "ENDPROC", "FOR i FROM 1 TO 9 DO",
         "WaitDI di1,1;", "p1.trans.x:=5;", "Stop;", "WaitTime 1E3;", "MoveC p1,p1,v100,fine,tPad;", "grind;"),
        "  ENDPROC\nENDMODULE\n", "! WaitTime 9;",
    ),
    "krl": Language(
        "DEF M()\nXP1={X 1,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=0.1\nPTP XHOME\n",
        ("LIN {{X {x}, Y {y}, Z 5.0, A 0.0, B 0.0, C 180.0}}", "LIN XP1", "lin xp1",
         "LIN {{X {x},Y {y},Z 5,A 1,B 2,C 3}} C_DIS"),
        ("WAIT SEC {s}", "wait sec {s}", "WAIT  SEC  {s}"),
        ("$OUT[3]=TRUE", "; WAIT SEC 9", "$VEL.CP=0.05", ";FOLD x"),
        ("WAIT SEC T", "LIN XP2", "LIN_REL {X 1}", "FOR I=1 TO 9", "WAIT FOR $IN[1]", "XP1.X=5", "END", "HALT",
         "WAIT SEC 1E3", "CIRC XP1,XP1", "GRIND()"),
        "END\n", "; WAIT SEC 9",
    ),
    "fanuc-tp": Language(
        "/PROG M\n/ATTR\nCOMMENT = \"WAIT 9.00(sec)\";\n/MN\n   1:J P[3] 100% CNT50    ;\n",
        ("{n:4d}:L P[1] 100mm/sec FINE ;", "{n:4d}:L P[2:two] 50cm/min FINE ACC10 ;", "{n}:L P[3] 2.0sec FINE ;"),
        ("{n:4d}:  WAIT    {s}(sec) ;", "{n}:WAIT {s}(sec);"),
        ("{n:4d}:  !WAIT 9.00(sec) ;", "{n:4d}:  DO[1]=OFF ;", "{n:4d}:  ;", "{n:4d}:  //L P[9] 1mm/sec FINE ;"),
        ("  9:  WAIT R[1] ;", "  9:L P[9] 100mm/sec FINE ;", "  9:L P[1] 100mm/sec CNT100 ;", "  9:  JMP LBL[1] ;",
         "  9:  CALL GRIND ;", "  9:  WAIT DI[1]=ON ;", "  9:  R[1]=R[1]+1 ;", "/POS", "  9:  WAIT 999.00(sec) ;"),
        "/POS\n" + "".join(_PLACE.format(n=n, x=1.5 * n) for n in (1, 2, 3)) + "/END\n", "!WAIT 9.00(sec)",
    ),
    "urscript": Language(
        "def m():\n  global p1 = p[0.1, 0.2, 0.3, 3.14, 0, 0]\n  set_tcp(p[0,0,0.1,0,0,0])\n  movej([0,0,0,0,0,0])\n",
        ("  movel(p[{mx}, {my}, 0.3, 0, 3.14, 0], a=1.2, v=0.1)", "  movel(p1, a=1.2, v=0.25, r=0)",
         "  movel(p1, 1.2, 0.1, 0, 0)"),
        ("  sleep({s})", "  sleep( {s} )", "sleep({s})"),
        ("  set_standard_digital_out(1, False)", '  textmsg("# sleep(9)")', "  # sleep(9)", '  $ 3 "Waypoint_2"'),
        ("  sleep(t)", "  movel(p2)", "  movel(p1, r=0.05)", "  while True:", "  p1 = p[0,0,0,0,0,0]", "end",
         "  sync()", "  sleep(1e3)", "  movec(p1, p1)", "  stopl(1)"),
        "end\nm()\n", "# sleep(9)",
    ),
    "inform": Language(
        "/JOB\n//NAME M\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 1\n///POSTYPE ROBOT\n///RECTAN\n"
        "C00001=1.0,2.0,3.0,180.0,0.0,0.0\nC00002=1.5,2.0,3.0,180.0,0.0,0.0\n//INST\nNOP\n",
        ("MOVL C00001 V=12.5 PL=0", "MOVL C00002 V=100.0 PL=0 ACC=20 DEC=20", "MOVL C00001 VR=20.0 PL=0"),
        ("TIMER T={s}", "TIMER  T={s}"),
        ("DOUT OT#(1) ON", "'TIMER T=9.00", "NOP", "MOVJ C00001 VJ=5.00"),
        ("TIMER T=I001", "MOVL C00009 V=10.0 PL=0", "MOVL C00001 V=10.0 PL=8", "JUMP *A", "CALL JOB:X",
         "WAIT IN#(1)=ON",
         "SET I001 5", "END", "TIMER T=999.99", "MOVC C00001 V=9.0", "GRIND"),
        "END\n", "'TIMER T=9.00",
    ),
    "val3": Language(
        "<Programs>\n<Code><![CDATA[begin\np1.trsf={1,0,0,180,0,0}\np[2].trsf={2,0,0,180,0,0}\nmPol.tvel=20\n",
        ("  movel(p1,tPad,mPol)", "  movel(p[2],tPad,mPol)"),
        ("  waitEndMove()\n  delay({s})", "waitEndMove()\ndelay( {s} )"),
        ("  mPol.blend=off", "  // delay(9)", "  mPol.tvel=12.5", "  movej(p1,tPad,mPol)", "  cls()"),
        ("delay(9)", "movel(p9,tPad,mPol)", "movec(p1,p1,tPad,mPol)", "for i=1 to 9", "wait(dIn)", "p1.trsf.x=9", "end",
         "delay(t)", "call grind()"),
        "end]]></Code>\n</Programs>\n", "// delay(9)",
    ),
    "heidenhain": Language(
        "0 BEGIN PGM M MM\n1 TOOL CALL 1 Z S200\n2 L X+0 Y+0 Z+50 A+0 C+0 R0 FMAX M3\n",
        ("{n} L X{x} Y{y} Z+0 F900", "{n} L X{x} A+5", "{n} L Y{y} C+90 F90.5"),
        ("{n} FUNCTION DWELL TIME{s}", "{n} CYCL DEF 9.0 VERWEILZEIT\n9 CYCL DEF 9.1 V.ZEIT {s}"),
        ("{n} ; CYCL DEF 9.1 9", "{n} M8", "{n} L Z+50 FMAX", "{n} CYCL DEF 32.0 TOLERANZ"),
        ("9 CYCL DEF 9.0 X", "9 L IX+5", "9 CC X+1 Y+1", "9 LBL 1", "9 CALL PGM X", "9 FN 0: Q1=+5", "9 STOP",
         "9 FUNCTION DWELL TIME Q1", "9 END PGM M MM", "9 PLANE RESET STAY", "9 LN X+1 NX+0"),
        "8 M30\n9 END PGM M MM\n", "; FUNCTION DWELL TIME9",
    ),
    "melfa-basic": Language(
        "Ovrd 100\nTool (0,0,150,0,0,0)\nCnt 0\nSpd 20\n",
        ("Mvs P1", "Mvs ({x},{y},0,180,0,0)(7,0)", "mvs p2"),
        ("Dly {s}", "dly  {s}"),
        ("M_Out(8)=1", "'Dly 9", "Spd 12.5", "Mov P1"),
        ("Dly M1", "Mvs P9", "Mvs P1,-50", "Mvr P1,P2,P1", "GoTo *A", "Wait M_In(1)=1", "M1=M1+1",
         "For M1=1 To 9", "Cnt 1"),
        "Hlt\nEnd\nP1=(1,0,0,180,0,0)(7,0)\nP2=(2,0,0,180,0,0)(7,0)\n", "'Dly 9",
    ),
    "kawasaki-as": Language(
        ".PROGRAM m()\nACCURACY 1 ALWAYS\nSPEED 20 MM/S ALWAYS\n",
        ("  LMOVE p1", "LMOVE p[2]", "lmove P1"),
        ("  BREAK\n  TWAIT {s}", "break\ntwait {s}"),
        ("  SIGNAL 3", "  ; TWAIT 9", "SPEED 1200 MM/MIN ALWAYS", "JMOVE p1"),
        ("TWAIT 9", "TWAIT t", "LMOVE p9", "LAPPRO p1,50", "SPEED 80", "GOTO 10", "CALL grind",
         "WAIT SIG(1001)", ".END",
         "x = 5", "C1MOVE p1"),
        ".END\n.TRANS\np1 1 0 0 0 180 0\np[2] 2 0 0 0 180 0\n.END\n", "; TWAIT 9",
    ),
}  # fmt: skip


def _language_program(dialect: str, rng: Random, lines: int, damage: float) -> bytes:
    language = LANGUAGES[dialect]
    body: list[bytes] = []
    wordy = rng.random() * 0.4
    while len(body) < lines:
        body += [_spoilt(dialect, line, rng) if rng.random() < damage else line
                 for line in _language_point(language, rng, len(body), wordy)]  # fmt: skip
    text = b"\n".join([language.head.encode().rstrip(b"\n"), *body, language.tail.encode()])
    text = text if rng.random() < 0.7 else text.replace(b"\n", b"\r\n")
    return text if rng.random() < 0.8 else text.rstrip(b"\r\n")


def _language_point(language: Language, rng: Random, number: int, wordy: float) -> list[bytes]:
    """A move, its dwell, and perhaps something between the points."""
    x, y, seconds = (round(rng.uniform(-90, 90), rng.randrange(4)) for _ in range(3))
    said = {"x": x, "y": y, "mx": x / 1e3, "my": y / 1e3, "s": _seconds(abs(seconds), rng)}
    found = [rng.choice(language.moves), rng.choice(language.dwells)]
    if rng.random() < wordy:
        found.insert(rng.choice([0, 2]), rng.choice(language.neutral))
    lines = [line.format(n=n, **said) for n, line in enumerate(found, number + 2)]
    if rng.random() < wordy and language.comment[0] != "!":
        lines[0] += f" {language.comment}"
    return [line.encode() for line in lines]


def _seconds(value: float, rng: Random) -> str:
    """Return a dwell in one of the possible notations."""
    text = f"{value:.{rng.choice([0, 1, 2, 2, 3])}f}"
    return text.removeprefix("0") if text.startswith("0.") and rng.random() < 0.5 else text


@cache
def _corpus(dialect: str) -> list[bytes]:
    if dialect in LANGUAGES:
        return [line.encode() for line in LANGUAGES[dialect].odd]
    return [line for case in cases() if case.dialect == dialect for line in case.text.splitlines() if line.strip()]


def _spoilt(dialect: str, line: bytes, rng: Random) -> bytes:
    kind: Callable[[bytes, Random], bytes] = rng.choice([_cut, _insert, _double, _flip, _swap, _odd])
    return rng.choice(_corpus(dialect)) if rng.random() < 0.25 else kind(line, rng)


def _at(line: bytes, rng: Random) -> int:
    return rng.randrange(len(line) + 1)


def _cut(line: bytes, rng: Random) -> bytes:
    first, last = sorted((_at(line, rng), _at(line, rng)))
    return line[:first] + line[last:]


def _insert(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + rng.choice(_ODD) + line[at:]


def _double(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + line[at:] + line[at:]


def _flip(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + bytes([rng.randrange(256)]).replace(b"\n", b"") + line[at + 1 :]


def _swap(line: bytes, rng: Random) -> bytes:
    words = line.split(b" ")
    rng.shuffle(words)
    return b" ".join(words)


def _odd(line: bytes, rng: Random) -> bytes:
    return rng.choice(_ODD) * rng.randrange(1, 4) + line * rng.randrange(2)
