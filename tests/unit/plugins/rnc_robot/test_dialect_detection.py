"""The dialect of a program by its text and name: said, asked for where several fit, refused where none is read."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.dialect import DEFAULT, LANGUAGES, detect, dialect
from polishd.plugins.rnc_robot.formats import COMPARED_BYTES, read, require_one_reading
from tests.commissioned import commissioned
from tests.unit.cli_result import Polishd
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS

EXAMPLE = Path(__file__).resolve().parents[4] / "examples" / "cell.toml"
G_CODE = b"G21 G90 G94\nG0 X0 Y0 Z5\nG1 X1 Z0 F60\nG4 P1\nG1 X3\nG4 P.5\nG0 Z5\nM2\n"


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", sorted(LANGUAGES))
def test_a_robot_program_is_known_by_its_text(polishd: Polishd, tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.txt"
    path.write_bytes(PROGRAMS[name][0])
    answer = polishd("program", "inspect", path, "--json").answer
    assert answer["dialect"] == name
    assert "of its text" in answer["dialect_by"]
    assert f"{name} (" in polishd("program", "inspect", path).out.replace("\n", "")


@pytest.mark.parametrize(
    ("head", "name", "found"),
    [
        (b"&ACCESS RVP\n&REL 1\nDEF k1( )\n", "k1.src", "krl"),
        (b";FOLD INI\n", "a.txt", "krl"),
        (b"  MODULE Polish\n", "a.prg", "rapid"),
        (b"%%%\n  VERSION:1\n%%%\n", "a.prg", "rapid"),
        (b"/PROG  POLISH\r\n/ATTR\r\n", "a.txt", "fanuc-tp"),
        (b"def polish():\n  movel(p[0,0,0,0,0,0])\n", "a.txt", "urscript"),
        (b"", "a.ls", "fanuc-tp"),
        (b"/JOB\n//NAME POLISH\n", "a.jbi", "inform"),
        (b"0 BEGIN PGM POL MM\n", "a.h", "heidenhain"),
        (b"<?xml version='1.0'?>\n<Programs>\n", "a.txt", "val3"),
        (b"10 Mvs P1\n", "a.txt", "melfa-basic"),
        (b".PROGRAM a()\n", "a.txt", "kawasaki-as"),
        (b"", "a.pg", "kawasaki-as"),
        (b"G21\nG1 X1 F60\nG1 X2\n", "a.mod", "rs274"),
        (b"%_N_POL_MPF\n;$PATH=/_N_WKS_DIR\nG1 X1 F60\n", "a.txt", "siemens"),
        (b"G291\nG1 X1 F60\n", "a.mpf", "siemens-iso"),
        (b"DEF REAL A\nG1 X1 F60\n", "a.spf", "siemens"),
        (b"%\nO0100 (POLISH)\nG1 X1 F60\nX2\n", "a.nc", "rs274"),
        (b"/N10 G1 X1 F60\n", "a.nc", "rs274"),
        (b"def = 3\n", "a.nc", "rs274"),
    ],
)
def test_signs(head: bytes, name: str, found: str) -> None:
    assert detect(head, name).dialect == found


@pytest.mark.parametrize(
    ("head", "name", "said"),
    [
        (
            b"<?xml version='1.0'?>\n<Database>\n",
            "a.dtx",
            "a.dtx:2: the file looks like data of a Staubli VAL3 application, which are no program.*name the .pgx",
        ),
        (b"", "a.pjx", "a.pjx: the file looks like data of a Staubli"),
        (
            b"%\nO0100\nG1 X1 F60\nG4 P500\n",
            "a.nc",
            "a.nc:4: fanuc, haas, rs274 fit.*--dialect fanuc or --dialect haas",
        ),
    ],
)
def test_what_is_not_read_or_fits_several_is_said(head: bytes, name: str, said: str) -> None:
    with pytest.raises(ProgramError, match=said):
        detect(head, name)


@pytest.mark.full
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"G21 G90 G94\nG1 X1 F60\nG4 P500\nM30\n", r"3: .*500 s \(rs274, grbl\) and 0.5 s \(fanuc, haas,"),
        (b"G21 G90 G94\nG1 X1 F60\nG4 P.5\nG1 X2\nG4 P2\nM30\n", r"5: .*2 s \(rs274, grbl\) and 0.002 s \(haas"),
        (b"G21 G90 G94\nG1 X1 F60\nG4 P500\n", r"3: .*0.5 s \(fanuc, .*\) and 500 s \(grbl"),  # rs274 wants an end
        (b"G90\nG0 X0\nG1 X1 F60\nM2\n", r"3: .*1 s \(rs274, .*\) and 0.016+7 s \(codesys"),  # mm/s
        (b"G90 G93\nG0 X0\nG1 X1 F20\nM2\n", r"3: .*3 s \(rs274, .*\) and 20 s \(twincat-cnc"),
        (b"G21 G90 G94\n" + b"G1 X1 F60\nG4 P500\nG1 X2\nG4 P500\n" * (COMPARED_BYTES // 9), "3: several dialects fit"),
        (b"G21 G90 G94\nG1 X1 F60\nG4 P.5\nM30\n", ""),
        (b"G21 G90 G94 G61.1\nG1 X1 F60\nG4 P500\nM30\n", ""),  # rs274 alone reads it
        (b"G21 G90 G94\nG0 X0\nG1 X1 F60\nX2\nM2\n", ""),
        (b"G1 X#1 F60\nM2\n", ""),
    ],
)
def test_dialects_that_read_other_times_are_asked_for(text: bytes, said: str) -> None:
    with pytest.raises(ProgramError, match=rf"p\.nc:{said}") if said else nullcontext():
        require_one_reading(text, "p.nc")


@pytest.mark.parametrize("name", sorted(LANGUAGES))
def test_a_cells_dialect_that_is_another_is_named(name: str) -> None:
    """As plan, check and run read it: by program.format."""
    with pytest.raises(ProgramError, match=rf'not G-code: the file looks like .*program\.format = "{name}"'):
        read(dialect("rs274"), PROGRAMS[name][0], "p.rnc")
    with pytest.raises(ProgramError, match="the file looks like G-code"):
        read(dialect(name), G_CODE, "p.rnc")
    other = min(LANGUAGES - {name})
    with pytest.raises(ProgramError, match=f"use --dialect {name}"):
        read(dialect(other), PROGRAMS[name][0], "p.rnc")


def test_every_verb_takes_it_from_the_file(polishd: Polishd, tmp_path: Path) -> None:
    path, dwell, out = tmp_path / "p.src", tmp_path / "d.csv", tmp_path / "n.src"
    path.write_bytes(PROGRAMS["krl"][0])
    points = polishd("program", "inspect", path, "--json").answer["points"]
    dwell.write_text("0.5\n" * points)
    answer = polishd("program", "rewrite", path, "--dwell", dwell, "--out", out, "--json").answer
    assert answer["dialect"] == "krl"
    assert polishd("program", "verify", path, out, "--json").answer["dialect"] == "krl"
    said = polishd("program", "inspect", path, "--dialect", "rs274")
    assert said.code == 9
    assert "not G-code: the file looks like KUKA KRL. To do: use --dialect krl" in said.err


@pytest.mark.parametrize("verb", ["check", "compliance"])
def test_a_cell_whose_format_is_not_its_programs_says_which_it_is(polishd: Polishd, tmp_path: Path, verb: str) -> None:
    cell, program = tmp_path / "cell.toml", tmp_path / "p.src"
    commissioned(tmp_path)
    cell.write_text(with_values(EXAMPLE.read_text(), {"program": {"path": "p.src"}}))
    program.write_bytes(PROGRAMS["krl"][0])
    said = polishd(verb, cell, *([] if verb == "check" else ["--program", program]))
    assert said.code != 0
    assert 'the file looks like KUKA KRL. To do: use --dialect krl (program.format = "krl" in a cell)' in " ".join(
        (said.out + said.err).split()
    )


def test_a_long_line_that_is_no_dwell_is_gone_over_once() -> None:
    assert detect(b"O1\n" + b"G4" * 400_000 + b"\n", "p.nc").dialect == DEFAULT
