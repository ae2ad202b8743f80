"""The file that is handed over, and which of its lines a controller means."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceRefused
from polishd.config.controller_profile import LineVariable, ProgramTable
from polishd.drivers.plc_robot.program_tracker import PlcProgramFile, dwells_s

TABLE = ProgramTable()
BLOCKS = [b"G90", b"G0 Z10", b"G1 X1 F60", b"G1 X2", b"G0 Z10", b"M30"]


def line(**keys: object) -> LineVariable:
    return LineVariable.model_validate({"address": "x", "type": "uint32", "shows": "executed", **keys})


def numbered(blocks: list[bytes], step: int) -> list[bytes]:
    return [b"N%d %s" % (step * (at + 1), block) for at, block in enumerate(blocks)]


def test_dwells_stand_before_the_first_stop_and_a_pause_before_each() -> None:
    file = PlcProgramFile(BLOCKS, (2, 4), TABLE, line=line(), proof_s=(0.25, 0.5))
    assert file.text.splitlines() == [
        *BLOCKS[:2], b"G4 P0.250", b"G4 P0.500", b"M0", *BLOCKS[2:4], b"M0", *BLOCKS[4:],
    ]  # fmt: skip
    assert file.proof == (3, 4)
    assert file.pauses == {5: 2, 8: 4}
    assert [file.block_at(at) for at in range(1, 11)] == [0, 1, 1, 1, 2, 2, 3, 4, 4, 5]


def test_without_a_word_for_done_a_pause_stands_before_the_end() -> None:
    file = PlcProgramFile(BLOCKS, (2,), TABLE, line=line(), pause_at_end=True)
    assert file.text.splitlines()[-3:] == [b"G0 Z10", b"M0", b"M30"]
    assert file.end == 5


@pytest.mark.parametrize(
    ("first", "shown", "found"), [(1, 0, 0), (1, 1, 1), (1, 3, 3), (0, 0, 1), (0, 2, 3), (1, 99, 7)]
)
def test_lines_are_counted_as_the_controller_counts(first: int, shown: int, found: int) -> None:
    assert PlcProgramFile(BLOCKS, (2,), TABLE, line=line(first=first)).line_of(shown) == found


def test_a_language_without_an_end_of_ours_gets_none() -> None:
    table = ProgramTable(pause="Stop;", dwell="WaitTime {seconds:.3f};", end="")
    lines = [b"MODULE m", b"PROC main()", b"MoveL p1;", b"MoveL p2;", b"ENDPROC", b"ENDMODULE"]
    file = PlcProgramFile(lines, (3,), table, line=line(), proof_s=(0.25,))
    assert file.text.splitlines() == [*lines[:3], b"WaitTime 0.250;", b"Stop;", *lines[3:]]
    assert PlcProgramFile(lines[:2], (), TABLE, line=line()).text.endswith(b"PROC main()\nM2\n")


def test_a_pause_before_the_own_end_of_a_language() -> None:
    table = ProgramTable(pause="PAUSE", dwell="TIMER T={seconds:.2f}", end="", last="END", line_end="crlf")
    lines = [b"/JOB", b"NOP", b"MOVL C0", b"MOVL C1", b"END", b""]
    file = PlcProgramFile(lines, (3,), table, line=line(), proof_s=(0.25,), pause_at_end=True)
    assert file.lines == (*lines[:3], b"TIMER T=0.25", b"PAUSE", lines[3], b"PAUSE", b"END", b"")
    assert (file.end, file.pauses) == (4, {5: 3, 7: 4})
    assert PlcProgramFile(lines, (3,), table, line=line()).end is None
    with pytest.raises(DeviceRefused, match="the program has no line END, which ends it"):
        PlcProgramFile(lines[:4], (3,), table, line=line(), pause_at_end=True)


def test_n_words_tell_the_line_and_ours_go_on_from_those_before() -> None:
    file = PlcProgramFile(
        numbered(BLOCKS, 10), (2,), TABLE, line=line(counts="n_words"), proof_s=(0.25,), pause_at_end=True
    )
    assert file.text.splitlines()[2:4] == [b"N21 G4 P0.250", b"N22 M0"]
    assert file.text.splitlines()[-2:] == [b"N51 M0", b"N60 M30"]
    assert [file.line_of(shown) for shown in (0, 10, 20, 21, 22, 30, 51, 60)] == [0, 1, 2, 3, 4, 5, 8, 9]


@pytest.mark.parametrize("blocks", [numbered(BLOCKS, 1), [b"N10 G90", b"N10 G0 Z1", b"G1 X1", b"M30"]])
def test_n_words_without_room_or_twice_are_refused(blocks: list[bytes]) -> None:
    with pytest.raises(DeviceRefused, match="in steps of 10"):
        PlcProgramFile(blocks, (2,), TABLE, line=line(counts="n_words"), proof_s=(0.25, 0.5))


@given(st.integers(2, 40), st.sets(st.integers(0, 45)), st.integers(0, 3), st.booleans())
def test_each_line_of_the_program_is_its_own_block(count: int, stops: set[int], dwells: int, ends: bool) -> None:
    blocks = [b"G1 X%d" % at for at in range(count)]
    file = PlcProgramFile(blocks, stops, TABLE, line=line(), proof_s=[0.5] * dwells, pause_at_end=ends)
    for index, text in enumerate(file.text.splitlines()):
        if text.startswith(b"G1"):
            assert blocks[file.block_at(file.line_of(index + 1))] == text


JOB = [b"/JOB", b"//NAME M2", b"NOP", b"MOVL C00001 V=10.0 PL=0", b"MOVL C00002 V=10.0 PL=0", b"END"]
NO_END = ProgramTable(pause="PAUSE", dwell="TIMER T={seconds:.2f}", dwell_step_s=0.01, end="", line_end="crlf")


def test_a_job_is_counted_from_its_first_instruction_and_has_its_controllers_line_ends() -> None:
    """And a name that looks like the end of G-code ends nothing."""
    file = PlcProgramFile(JOB, (4,), NO_END, line=line(first=0, starts_at="NOP"), proof_s=(0.25,))
    assert file.text.split(b"\r\n") == [*JOB[:4], b"TIMER T=0.25", b"PAUSE", *JOB[4:], b""]
    assert [file.line_of(shown) for shown in (0, 1, 2, 3, 5)] == [3, 4, 5, 6, 8]
    assert file.line_of(9) == 8
    with pytest.raises(DeviceRefused, match="the file has no line NOP"):
        PlcProgramFile(JOB[3:], (1,), NO_END, line=line(first=0, starts_at="NOP"))


def test_statements_are_counted_by_how_they_begin() -> None:
    lines = [b"begin", b"  m.tvel=3", b"  movel(p,t,m)", b"  waitEndMove()", b"  movel(q,t,m)", b"end"]
    table = ProgramTable(pause="call polPause()", dwell="call polDwell({seconds:.3f})", end="")
    counted = line(counts="statements", counted=["movel(", "call "])
    file = PlcProgramFile(lines, (3,), table, line=counted, proof_s=(0.25,))
    assert [file.line_of(shown) for shown in range(6)] == [0, 3, 4, 5, 7, 7]
    assert file.proof == (4,)
    assert file.pauses == {5: 3}


@given(st.floats(0.005, 3.0), st.sampled_from([0.001, 0.01, 0.5]))
def test_dwells_are_whole_steps_so_that_the_file_says_what_is_checked(report_s: float, step_s: float) -> None:
    for seconds in dwells_s(report_s, step_s):
        assert seconds >= step_s
        assert abs(seconds / step_s - round(seconds / step_s)) < 1e-6
