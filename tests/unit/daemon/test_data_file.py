"""A program whose positions are in the file beside it: accepted only for a robot that gets them."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.daemon.assembly import require_accepted_by_robot
from polishd.model.errors import ConfigError
from polishd.plugin_loader import load_own

ROOT = Path(__file__).parents[3]
SRC = b"DEF part( )\nPTP XHOME\n$VEL.CP=0.02\nLIN XP1\nLIN XP2\nEND\n"
HOME = b"DECL E6AXIS XHOME={A1 0,A2 -90,A3 90,A4 0,A5 90,A6 0}\n"
POSE = b"DECL E6POS XP%d={X %d,Y 0,Z 60,A 0,B 0,C 180}\n"
DAT = b"DEFDAT part\n" + HOME + POSE % (1, 1) + POSE % (2, 2) + b"ENDDAT\n"
PGX = b"""<Programs><Program name="start"><Code><![CDATA[
begin
  movel(pPath[0],tPad,mPol)
  mPol.tvel=10
  movel(pPath[1],tPad,mPol)
end
]]></Code></Program></Programs>
"""
SET = b"  pPath[%d].trsf={%d,0,60,0,180,0}\n"
DTX = b"""<Database><Datas><Data name="pPath" type="pointRx">
<Value key="0" x="1" z="60" ry="180" /><Value key="1" x="2" z="60" ry="180" />
</Data></Datas></Database>
"""


def require(folder: Path, cell: str, name: str, text: bytes, *beside: tuple[str, bytes]) -> None:
    """Read a program with the files beside it, and ask for the cell's robot."""
    (folder / name).write_bytes(text)
    for other, content in beside:
        (folder / other).write_bytes(content)
    config, hooks = load_config(ROOT / "examples" / cell), load_own()
    program = hooks.program_formats()[config.program.format].read_file(folder / name, text)
    require_accepted_by_robot(config, hooks, program)


def test_kuka_takes_a_program_with_its_dat(tmp_path: Path) -> None:
    require(tmp_path, "kuka_cell.toml", "part.src", SRC, ("part.dat", DAT))


def test_kuka_refuses_a_position_of_the_controllers_own_data(tmp_path: Path) -> None:
    said = r"program\.format: part\.src: robot \(kuka_kvp\) .*line 2: neither .* declares XHOME\. Put"
    with pytest.raises(ConfigError, match=said):
        require(tmp_path, "kuka_cell.toml", "part.src", SRC, ("part.dat", DAT.replace(HOME, b"")))


def test_a_driver_that_delivers_no_dtx_refuses_a_program_with_one(tmp_path: Path) -> None:
    said = r"part\.pgx: robot \(plc_robot\) .*delivers the program without the file beside it\. Have .* move that file"
    with pytest.raises(ConfigError, match=said):
        require(tmp_path, "staubli/cell.toml", "part.pgx", PGX, ("part.dtx", DTX))


def test_a_program_with_its_positions_is_taken_without_a_dtx(tmp_path: Path) -> None:
    text = PGX.replace(b"begin\n", b"begin\n" + SET % (0, 1) + SET % (1, 2))
    require(tmp_path, "staubli/cell.toml", "part.pgx", text)
