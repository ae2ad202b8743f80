"""The simulated controller's readers of INFORM and VAL3: positions, moves, waits, numbers, and what they refuse."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.program_tracker import PlcProgramFile
from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.languages.make import PathTimes, language_program
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.program import read
from polishd.sim_backends.common.hidden_truth import tool_axis
from polishd.sim_backends.plc_robot.controller import DONE, FAULT, PAUSED, READY, RUNNING, PlcProgram
from polishd.sim_backends.plc_robot.inform import InformReader
from polishd.sim_backends.plc_robot.language import LanguageReader
from polishd.sim_backends.plc_robot.val3 import Val3Reader
from polishd.sim_backends.robot.program_reader import SimProgramBlock
from tests.unit.sim_backends.plc_robot.test_controller import Bench

HOME = (0.0, 0.0, 60.0, 0.0, 0.0)
JOB = b"""/JOB
//NAME POLISHD
//POS
///NPOS 3,0,0,0,0,0
///USER 1
///TOOL 1
///POSTYPE USER
///RECTAN
///RCONF 0,0,0,0,0,0,0,0
C00000=0.000,0.000,20.000,180.0000,0.0000,0.0000
C00001=0.000,0.000,0.000,180.0000,0.0000,0.0000
C00002=10.000,0.000,0.000,180.0000,10.0000,0.0000
//INST
///DATE 2026/01/01 00:00
////FRAME USER 1
NOP
'a part
MOVJ C00000 VJ=5.00
MOVL C00001 V=100.0 PL=0
TIMER T=0.30
TIMER T=0.40
PAUSE
MOVL C00002 V=10.0 PL=1
TIMER T=0.50
PAUSE
MOVL C00000 V=100.0 PL=0
END
"""
PROGRAM = b"""<?xml version="1.0" encoding="utf-8" ?>
<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2">
  <Program name="polish">
    <Code><![CDATA[
begin
  // a part
  pPath[0].trsf={0.000,0.000,20.000,180.0000,0.0000,0.0000}
  pPath[1].trsf={0.000,0.000,0.000,180.0000,0.0000,0.0000}
  pPath[2].trsf={10.000,0.000,0.000,180.0000,-10.0000,0.0000}
  movej(pPath[0],tPolish,mTravel)
  mTravel.tvel=100
  mTravel.blend=off
  movel(pPath[1],tPolish,mTravel)
call polDwell(0.300)
call polDwell(0.400)
call polPause()
  mPolish.tvel=10
  movel(pPath[2],tPolish,mPolish)
  waitEndMove()
  delay(0.5)
call polPause()
  movel(pPath[0],tPolish,mTravel)
  waitEndMove()
end
]]></Code>
  </Program>
</Programs>
"""
Reader = tuple[LanguageReader, list[SimProgramBlock]]


def taken(kind: type[LanguageReader], text: bytes, name: str = "polishd") -> Reader:
    reader = kind(HOME, name)
    blocks = [reader.read(line) for line in text.removesuffix(b"\n").split(b"\n")]
    reader.finish()
    return reader, blocks


def moves(blocks: list[SimProgramBlock]) -> list[SimProgramBlock]:
    return [block for block in blocks if block.kind == "move"]


@pytest.mark.parametrize(("kind", "text"), [(InformReader, JOB), (Val3Reader, PROGRAM)])
def test_positions_speeds_waits_and_stops(kind: type[LanguageReader], text: bytes) -> None:
    reader, blocks = taken(kind, text)
    over, down, along, up = moves(blocks)
    assert over.end[:3] == (0.0, 0.0, 20.0)
    assert (down.rate, down.exact, along.rate, along.exact) == (100.0, True, 10.0, False)
    assert along.end[3] == pytest.approx(10.0), "leans by 10 deg"
    assert up.end[:4] == pytest.approx(over.end[:4])
    assert [block.rate for block in blocks if block.kind == "dwell"] == [0.3, 0.4, 0.5]
    assert sum(block.kind == "pause" for block in blocks) == 2
    assert len(reader.numbers) == len(blocks)


def test_a_lean_about_fixed_axes_and_about_turned_ones_is_not_the_same() -> None:
    """Rx Ry Rz of INFORM turn about the fixed X, Y, Z: the same numbers in VAL3 lean to the other side."""
    _, job = taken(InformReader, JOB)
    _, program = taken(Val3Reader, PROGRAM.replace(b"-10.0000", b"10.0000"))
    (_, _, c_job), (_, _, c_program) = (
        (block.end[2], block.end[3], block.end[4]) for block in (moves(job)[2], moves(program)[2])
    )
    assert abs(abs(c_job - c_program) - 180.0) < 1e-6


def test_inform_counts_instructions_from_nop_and_val3_counts_moves_and_calls() -> None:
    job, _ = taken(InformReader, JOB)
    lines = JOB.split(b"\n")
    at = {text: job.numbers[lines.index(text)] for text in (b"NOP", b"'a part", b"TIMER T=0.30", b"PAUSE", b"END")}
    assert list(at.values()) == [0, 1, 4, 6, 11]
    program, _ = taken(Val3Reader, PROGRAM)
    lines = PROGRAM.split(b"\n")
    found = [program.numbers[lines.index(text)] for text in (b"begin", b"call polPause()", b"  delay(0.5)", b"end")]
    assert found == [0, 5, 6, 8]


@pytest.mark.parametrize(("kind", "text"), [(InformReader, JOB), (Val3Reader, PROGRAM)])
def test_lines_of_polishd_are_no_blocks_of_the_program(kind: type[LanguageReader], text: bytes) -> None:
    program = PlcProgram.of(text, kind)
    added = [program.lines[int(at)] for at in program.inserted]
    assert len(added) == 4
    assert b"  delay(0.5)" not in added
    assert b"TIMER T=0.50" not in added
    assert program.blocks == len(program.lines) - 4


def test_a_delivered_job_is_the_program_that_was_planned() -> None:
    """By its hash: the driver's lines are taken out again, and line ends stay."""
    planned = JOB.replace(b"\n", b"\r\n").replace(b"TIMER T=0.30\r\nTIMER T=0.40\r\nPAUSE\r\n", b"")
    planned = planned.replace(b"PAUSE\r\n", b"")
    lines = [line.rstrip(b"\r") for line in planned.split(b"\n")]
    at = lines.index(b"MOVL C00002 V=10.0 PL=1")
    profile = load_controller_profile("yaskawa-inform", Path())
    file = PlcProgramFile(lines, (at, at + 2), profile.program, line=profile.variables.line, proof_s=(0.3, 0.4))
    assert PlcProgram.of(file.text, InformReader).sha256 == hashlib.sha256(planned).hexdigest()
    assert file.text.removesuffix(b"\r\n") == JOB.replace(b"\n", b"\r\n")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"MOVL C00001 V=100.0 PL=0", b"MOVL C00009 V=100.0 PL=0", "C00009 is not known"),
        (b"MOVL C00001 V=100.0 PL=0", b"MOVL C00001 PL=0", "without V="),
        (b"MOVL C00001 V=100.0 PL=0", b"MOVL C00001 V=100.0 PL=9", "PL=9"),
        (b"MOVL C00001 V=100.0 PL=0", b"MOVC C00001 V=100.0 PL=0", "cannot read 'MOVC"),
        (b"MOVL C00001 V=100.0 PL=0", b"MOVL C00001 V=100.0 NWAIT", "'NWAIT' is not one of"),
        (b"TIMER T=0.50", b"TIMER T=B000", "'B000' is not a number"),
        (b"TIMER T=0.50", b"TIMER T=700.00", "more than 655.35"),
        (b"TIMER T=0.50", b"JUMP *A", "cannot read 'JUMP"),
        (b"///RECTAN", b"///PULSE", "C00000 is not known"),
        (b"//NAME POLISHD", b"//NAME OTHER", "named 'OTHER', its file 'polishd'"),
        (b"C00001=0.000,", b"C00001=", "has 5 numbers, not 6"),
        (b"END\n", b"", "no end"),
    ],
)
def test_what_inform_does_not_have_is_refused(old: bytes, new: bytes, said: str) -> None:
    assert old in JOB
    with pytest.raises(ProgramError, match=said.replace("*", r"\*")):
        taken(InformReader, JOB.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"movel(pPath[1],tPolish,mTravel)", b"movel(pPath[7],tPolish,mTravel)", r"pPath\[7\] is not known"),
        (b"movel(pPath[1],tPolish,mTravel)", b"movel(pPath[1],mTravel)", "2 arguments"),
        (b"movel(pPath[1],tPolish,mTravel)", b"movec(pPath[1],pPath[2],tPolish,mTravel)", "cannot read movec"),
        (b"  mPolish.tvel=10\n", b"", "mPolish.tvel is not set"),
        (b"mPolish.tvel=10", b"mPolish.tvel=0", "must be above 0"),
        (b"mTravel.blend=off", b"mTravel.blend=some", "cannot read mTravel.blend"),
        (b"  waitEndMove()\n  delay(0.5)", b"  delay(0.5)", "delay does not wait"),
        (b"delay(0.5)", b"delay(nWait)", "'nWait' is not a number"),
        (b"call polPause()", b"call other()", "not known"),
        (b"  // a part", b"  for i = 1 to 3", "cannot read 'for"),
        (b"\nend\n", b"\n", "no end"),
    ],
)
def test_what_val3_does_not_have_is_refused(old: bytes, new: bytes, said: str) -> None:
    assert old in PROGRAM
    with pytest.raises(ProgramError, match=said):
        taken(Val3Reader, PROGRAM.replace(old, new, 1))


def loaded(bench: Bench, name: str, text: bytes) -> None:
    (bench.folder / name).write_bytes(text)
    bench.plc.inputs["program"] = name
    bench.pulse("load")


FILES = {"POLISHD.JBI": (JOB, 4, 6, 9), "polish.pgx": (PROGRAM, 3, 5, 7)}
"""Text, number of the first wait, and of both pauses."""


@pytest.mark.parametrize("name", FILES)
def test_the_controller_runs_it_and_shows_its_numbers(tmp_path: Path, name: str) -> None:
    text, wait, *pauses = FILES[name]
    bench = Bench(tmp_path)
    loaded(bench, name, text)
    assert bench.state == READY
    bench.pulse("start")
    bench.until(lambda: bench.plc.shown["line"] == wait)
    began_s, clock_s = bench.plc.shown["line_began"], bench.plc.shown["clock"]
    assert isinstance(began_s, float)
    assert isinstance(clock_s, float)
    assert 0.0 <= clock_s - began_s <= 0.3
    bench.until(lambda: bench.state == PAUSED)
    assert bench.plc.shown["line"] == pauses[0]
    bench.pulse("start")
    bench.until(lambda: bench.state == RUNNING)
    bench.until(lambda: bench.state == PAUSED)
    assert bench.plc.shown["line"] == pauses[1]
    bench.pulse("start")
    bench.until(lambda: bench.state == DONE)


def test_val3_shows_a_move_through_the_wait_behind_it_from_the_moves_own_begin(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    loaded(bench, "polish.pgx", PROGRAM)
    for _ in range(2):
        bench.pulse("start")
        bench.until(lambda: bench.state in (PAUSED, DONE))
    lines = PROGRAM.split(b"\n")
    move, wait = (bench.plc.motion.executed[lines.index(text)] for text in (lines[17], b"  delay(0.5)"))
    assert lines[17].startswith(b"  movel(pPath[2]")
    assert wait[2] - move[1] > 1.4, "a second of motion and a half of waiting"
    restarted = Bench(tmp_path)
    loaded(restarted, "polish.pgx", PROGRAM)
    restarted.pulse("start")
    restarted.until(lambda: restarted.state == PAUSED)
    restarted.pulse("start")
    restarted.until(lambda: len(restarted.plc.motion.executed) > lines.index(b"  waitEndMove()"))
    restarted.run(0.2)
    assert restarted.plc.shown["line"] == 6
    began_s, clock_s = restarted.plc.shown["line_began"], restarted.plc.shown["clock"]
    assert isinstance(began_s, float)
    assert isinstance(clock_s, float)
    assert clock_s - began_s > 1.0


@pytest.mark.parametrize(
    ("name", "text"), [("POLISHD.JBI", JOB.replace(b"END\n", b"")), ("OTHER.JBI", JOB), ("a.pgx", PROGRAM[:-200])]
)
def test_a_program_that_is_cut_off_or_of_another_name_is_an_alarm(tmp_path: Path, name: str, text: bytes) -> None:
    bench = Bench(tmp_path)
    loaded(bench, name, text)
    assert (bench.state, bench.plc.shown["alarm"]) == (FAULT, 1)


TIME: dict[str, Callable[[LanguageProfile], PathTimes]] = {
    "feed": lambda _: PathTimes("feed", np.array([600.0, 300.0, 450.0]), np.zeros(3)),
    "dwell": lambda _: PathTimes("dwell", np.full(3, 1200.0), np.array([0.5, 0.25, 0.75])),
}


@pytest.mark.parametrize("encoding", TIME)
@pytest.mark.parametrize(("name", "kind"), [("inform", InformReader), ("val3", Val3Reader)])
def test_both_readers_see_the_same_motion_in_a_program_that_polishd_makes(
    name: str, kind: type[LanguageReader], encoding: str
) -> None:
    """The plugin's reader and the controller's know nothing of each other."""
    profile = dialect(name)
    assert isinstance(profile, LanguageProfile)
    points = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.1], [4.0, 3.0, 0.0], [0.0, 3.0, -0.1]])
    axis = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.1, -0.2, 1.0], [-0.2, 0.1, 1.0]])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    text = language_program(profile, points, axis, TIME[encoding](profile), "part")
    program = read(profile, text, "part")
    reader, blocks = taken(kind, text, "POLISH")
    assert reader.ended
    polished = [blocks[int(at)] for at in program.block] if encoding == "feed" else moves(blocks)[2:-1]
    np.testing.assert_allclose([block.end[:3] for block in polished], program.end_mm, atol=1e-3)
    a, c = np.array([block.end[3:] for block in polished]).T
    np.testing.assert_allclose(tool_axis(a, c), program.axis, atol=1e-5)
    assert (np.abs(np.diff(c)) <= 180.0).all(), "the shorter way round"
    if encoding == "feed":
        np.testing.assert_allclose([60.0 * block.rate for block in polished], program.feed_mm_min)
    else:
        np.testing.assert_allclose([block.rate for block in blocks if block.kind == "dwell"], program.time_s)
