"""Programs whose positions are in a file beside them: KRL with its .dat, VAL3 with its application's .dtx."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.verify import verify
from polishd.programs.rewrite import DwellTable, read_program_file, rewrite_file

KRL = b"""&ACCESS RVO
DEF part( )
;FOLD INI;%{PE}
BAS (#INITMOV,0 )
;ENDFOLD (INI)
PDAT_ACT=PDEFAULT
$H_POS=XHOME
FDAT_ACT=FP1
PTP XP1
;FOLD LIN P1 Vel=0.02 m/s CPDAT1 Tool[1]:Pad Base[2]:Teil \xe4;%{PE}
$BWDSTART = FALSE
LDAT_ACT=LCPDAT1
FDAT_ACT=FP1
BAS (#CP_PARAMS,0.02)
SET_CD_PARAMS (0)
LIN XP2 C_DIS C_DIS
;ENDFOLD
FDAT_ACT=FP2
BAS (#CP_PARAMS,0.01)
LIN xp3
END
"""
DAT = b"""&ACCESS RVO
DEFDAT  PART PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )
;ENDFOLD
DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P3",POINT2[] "P3"}
; DECL E6POS XP3={X 0,Y 0,Z 0,A 0,B 0,C 0}
DECL E6POS XP1={X 10.0,Y 20.0,Z 5.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0}
DECL E6POS XP2={X 11.0,Y 20.0,Z 5.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0}
  DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
DECL E6POS XP3={X 11.0,Y 22.0,Z 5.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0}
DECL FDAT FP2={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
ENDDAT
"""
PGX = b"""<?xml version="1.0" encoding="utf-8" ?>
<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2">
  <Program name="start" access="public">
    <Code><![CDATA[
begin
  movej(jHome,tPad,mNom)
  movel(pPath,tPad,mFast)
  movel(pPath[1],tPad,mPol[1])
  movel(pPath[2],tPad,mPol[1])
  dOut[0]=true
  movel(pPath[3],tPad,mPol)
end
]]></Code>
  </Program>
</Programs>
"""
DTX = b"""<?xml version="1.0" encoding="utf-8" ?>
<Database xmlns="http://www.staubli.com/robotics/VAL3/Data/2">
  <Datas>
    <!-- <Data name="pPath" type="pointRx"><Value key="1" x="9" /></Data> -->
    <Data name="mFast" type="mdesc" size="1"><Value key="0" tmax="500" blend="off" /></Data>
    <Data name="mPol" access="public" xsi:type="array" type="mdesc" size="2">
      <Value key="0" vel="100" tmax="10" rmax="9999" blend="joint" leave="1" reach="1" />
      <Value key="1" vel="100" tmax="20" rmax="9999" blend="off" leave="1" reach="1" />
    </Data>
    <Data name="pPath" access="public" xsi:type="array" type="pointRx" size="4">
      <Value key="0" x="100.0" z="20" rx="180" shoulder="righty" fatherId="fPart[0]" />
      <Value key="1" x="101.0" z="20" rx="180" fatherId="fPart[0]" />
      <Value key="2" x="101.0" y='2' z="20" rx="180" fatherId="fPart[0]" />
      <Value key="3" x="103.0" y="2" z="20" rx="180" fatherId="fPart[0]" />
    </Data>
  </Datas>
</Database>
"""


def put(folder: Path, **files: bytes) -> Path:
    """The first of the files, written with the others."""
    folder.mkdir(exist_ok=True)
    paths = [folder / name.replace("__", ".") for name in files]
    for path, text in zip(paths, files.values(), strict=True):
        path.write_bytes(text)
    return paths[0]


def test_krl_positions_and_frames_come_from_the_dat(tmp_path: Path) -> None:
    program = read_program_file(dialect("krl"), put(tmp_path, part__src=KRL, PART__DAT=DAT))
    np.testing.assert_allclose(program.end_mm, [[11, 20, 5], [11, 22, 5]])
    np.testing.assert_allclose(program.time_s, [1 / 20, 2 / 10])
    assert not any("FDAT_ACT" in warning for warning in program.warnings)
    alone = dialect("krl")
    with pytest.raises(ProgramError, match=r"line 16: the position XP2 is not declared.*put the \.dat file"):
        formats.read(alone, KRL, "part.src")


def test_val3_positions_speeds_and_blends_come_from_the_dtx_of_another_name(tmp_path: Path) -> None:
    program = read_program_file(dialect("val3"), put(tmp_path, start__pgx=PGX, polish__dtx=DTX))
    np.testing.assert_allclose(program.end_mm, [[101, 0, 20], [101, 2, 20], [103, 2, 20]])
    np.testing.assert_allclose(program.time_s, [1 / 20, 2 / 20, 2 / 10])
    assert program.timing is not None
    assert program.timing.stops.tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("name", "files"),
    [("krl", {"part__src": KRL, "part__dat": DAT}), ("val3", {"start__pgx": PGX, "polish__dtx": DTX})],
)
def test_a_program_is_rewritten_and_read_back_with_the_file_beside_it(
    name: str, files: dict[str, bytes], tmp_path: Path
) -> None:
    profile, path = dialect(name), put(tmp_path / "in", **files)
    program = read_program_file(profile, path)
    asked = program.time_s * np.linspace(0.5, 1.7, program.n)
    text = formats.rewrite(profile, program, asked)
    again = formats.read(profile, text, path.name, program.beside)
    np.testing.assert_allclose(again.time_s, asked, rtol=2e-3)
    np.testing.assert_array_equal(again.end_mm, program.end_mm)
    assert formats.rewrite(profile, program, program.time_s) == path.read_bytes()
    table = tmp_path / "dwell.csv"
    table.write_text("\n".join(map(str, asked.tolist())))
    out = tmp_path / "out" / path.name
    out.parent.mkdir()
    rewrite_file(path, DwellTable(table), out, profile)
    assert out.read_bytes() == text
    assert verify(path, out, profile).identical_motion


def test_the_daemon_reads_and_rereads_with_the_file(tmp_path: Path) -> None:
    path = put(tmp_path, part__src=KRL, part__dat=DAT)
    krl = next(one for one in formats.shipped_formats() if one.name == "krl")
    program = krl.read_file(path, path.read_bytes())
    again = krl.read_rewritten(program, krl.rewrite(program, program.time_s * 2), "part.src")
    np.testing.assert_array_equal(again.end_mm, program.end_mm)
    moved = krl.read_file(put(tmp_path, part__src=KRL, part__dat=DAT.replace(b"X 11.0", b"X 12.0")), KRL)
    assert moved.sha256 != program.sha256


def test_other_frames_in_the_dat_are_refused(tmp_path: Path) -> None:
    bad = DAT.replace(b"FDAT FP2={TOOL_NO 1,BASE_NO 2", b"FDAT FP2={TOOL_NO 1,BASE_NO 3")
    with pytest.raises(ProgramError, match=r"line 20: another tool or frame \(1, 3\) than at the first point \(1, 2\)"):
        read_program_file(dialect("krl"), put(tmp_path, part__src=KRL, part__dat=bad))


@pytest.mark.parametrize(
    ("name", "program", "beside", "reason"),
    [
        ("krl", KRL, DAT.replace(b"X 11.0", b"X xp"), "line 16: the position XP2 is not declared"),
        ("krl", KRL, DAT + b"DECL E6POS XP1={X 1,Y 2,Z 3,A 0,B 0,C 0}\n", "declared in line 8 too"),
        ("krl", KRL, DAT.replace(b"X 11.0", b"X 11e9"), ".dat file beside it, line 9: a position beyond any robot"),
        ("krl", KRL.replace(b"END\n", b"XP2={X 1,Y 2,Z 3,A 0,B 0,C 0}\nEND\n"), DAT, "XP2 gets another value after"),
        ("val3", PGX, DTX.replace(b'x="103.0"', b'x="nan"'), ".dtx file beside it, line 14: a value of pPath"),
        ("val3", PGX, DTX.replace(b'key="3"', b'key="2"'), "line 14: the position pPath[2] is declared twice"),
        ("val3", PGX, DTX.replace(b'key="3"', b'key="4"'), "line 11: the position pPath[3] is not declared"),
        ("val3", PGX, DTX.replace(b'fPart[0]" />\n    </Data>', b'g" />\n    </Data>'), "another tool or"),
        ("val3", PGX, DTX.replace(b'tmax="20"', b'tmax="?"'), "line 8: the speed of this move is no number"),
    ],
)
def test_a_wrong_file_beside_it_is_refused_by_line(name: str, program: bytes, beside: bytes, reason: str) -> None:
    with pytest.raises(ProgramError) as refused:
        formats.read(dialect(name), program, "p", beside)
    assert reason in str(refused.value)
    assert "To do: " in str(refused.value)


def test_a_long_name_without_a_value_in_the_file_is_gone_over_once() -> None:
    beside = DTX.replace(b"</Datas>", b"<Data " + b"a" * 1_000_000 + b"/></Datas>")
    expected = formats.read(dialect("val3"), PGX, "p", DTX).end_mm
    np.testing.assert_array_equal(formats.read(dialect("val3"), PGX, "p", beside).end_mm, expected)


def test_a_program_may_set_a_position_of_the_file_before_it_is_used() -> None:
    text = PGX.replace(b"begin\n", b"begin\n  pPath[3].trsf={103,3,20,180,0,0}\n")
    assert formats.read(dialect("val3"), text, "p", DTX.replace(b' fatherId="fPart[0]"', b"")).end_mm[-1, 1] == 3


def test_several_files_that_may_be_meant_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match=r"a\.dtx, b\.dtx stand beside it"):
        read_program_file(dialect("val3"), put(tmp_path, start__pgx=PGX, a__dtx=DTX, b__dtx=DTX))
    path = put(tmp_path, start__pgx=PGX, start__dtx=DTX)
    assert read_program_file(dialect("val3"), path).n == 3
