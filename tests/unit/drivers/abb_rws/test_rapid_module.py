"""The module for an ABB controller: the program's lines with triggers, its reports, and what is refused."""

from __future__ import annotations

import pytest

from polishd.api import DeviceRefused
from polishd.drivers.abb_rws.http_link import Login, events_of
from polishd.drivers.abb_rws.rapid_module import MARK, assemble, rapid_lines

TARGET = b"[[1,2,3],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
PROGRAM = [
    b"%%% VERSION:1 LANGUAGE:ENGLISH %%%",
    b"MODULE part",
    b"  CONST robtarget p1:=" + TARGET + b";",
    b"  PROC polish()",
    b"    MoveAbsJ home,v100,z10,tool0;",
    b"    MoveL p1,v100,fine,pad\\WObj:=glass; ! first",
    b"    MoveL Offs(p1,0.5,0,0),v20\\T:=0.25,z1,pad\\WObj:=glass; ! second",
    b"    SpindleOn;",
    b"    WaitTime 0.5;",
    b"  ENDPROC",
    b"ENDMODULE",
]


def test_the_programs_lines_stay_but_for_the_trigger_of_a_fly_by_point() -> None:
    module = assemble(rapid_lines(PROGRAM), [], 7)
    kept = [line for line in module.lines if not line.endswith(MARK)]
    changed = [(new, old) for new, old in zip(kept, PROGRAM, strict=True) if new != old]
    assert changed == [
        (b"MODULE polishd_part", b"MODULE part"),
        (
            b"    TriggL Offs(p1,0.5,0,0),v20\\T:=0.25,polishd_p2,z1,pad\\WObj:=glass; ! second",
            b"    MoveL Offs(p1,0.5,0,0),v20\\T:=0.25,z1,pad\\WObj:=glass; ! second",
        ),
    ]
    assert module.text.count(b"PROC main()") == 1
    assert [module.lines[at] for at, block in enumerate(module.block_of) if block >= 0] == kept


def test_a_speed_that_a_trigger_cannot_have_becomes_speeddata() -> None:
    lines = [b"MoveL p1,v100,z1,tool0;", b"MoveL p2,v100\\V:=7.5,z1,tool0;", b"MoveL p3,v100\\V:=7.5,fine,tool0;"]
    own = [line for line in assemble(rapid_lines(lines), [], 7).lines if not line.endswith(MARK)]
    assert own[1:] == [b"TriggL p2,[7.5,500,5000,1000],polishd_p2,z1,tool0;", lines[2]]


def test_reports_say_how_many_blocks_are_executed_and_stop_before_the_next() -> None:
    module = assemble(rapid_lines(PROGRAM), [6, 8, 99], 7)
    assert module.stops == (6, 8)
    # begin; the first point, up to the stop; the second up to the wait; the wait up to the end of the routine; the end
    assert module.done_after == [0, 6, 8, 9, 11]
    assert module.last_report == 4
    at = module.lines.index(b"Stop;" + MARK)
    assert module.lines[at - 1] == b"polishd_stop:=6;" + MARK


def test_lines_without_a_module_become_one() -> None:
    lines = [b"MoveL " + TARGET + b",v100,z1,tool0;"] * 2
    module = assemble(rapid_lines(lines), [1], 7)
    assert module.lines[0] == b"MODULE polishd_part" + MARK
    assert module.lines[-1] == b"ENDMODULE" + MARK
    assert module.done_after == [0, 1, 2, 2]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"FOR i FROM 1 TO 3 DO", "block 1: FOR cannot be tracked"),
        (b"MoveL p1,v100,z1,tool0; MoveL p2,v100,z1,tool0;", "block 1: a line must hold one statement"),
        (b"MoveL p1,", "block 1: a line must hold one statement"),
        (b"MoveL p1,vSlow\\V:=3,z1,tool0;", "block 1: a trigger has no .*V"),
        (b"MoveL p1,v100,z1;", "block 1: a MoveL has 4 arguments, not 3"),
        (b"TriggL p1,v100,t,z1,tool0;", "block 1: polishd adds the triggers"),
    ],
)
def test_what_cannot_be_tracked_is_refused_by_its_block(line: bytes, why: str) -> None:
    with pytest.raises(DeviceRefused, match=why):
        rapid_lines([b"MoveL p1,v100,z1,tool0;", line])


def test_a_second_routine_that_moves_is_refused() -> None:
    routine = [b"PROC a()", b"MoveL p1,v100,z1,tool0;", b"ENDPROC"]
    with pytest.raises(DeviceRefused, match="block 5: a second routine moves"):
        rapid_lines([*routine, *routine])


def test_a_program_of_another_language_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="no line of the program moves or waits in RAPID"):
        rapid_lines([b"G1 X0", b"M2"])


def test_the_digest_is_that_of_rfc_2617() -> None:
    login = Login("Mufasa", "Circle Of Life", digest=True)
    assert login.challenged(
        'Digest realm="testrealm@host.com", nonce="dcd98b7102dd2f0e8b11d0f600bfb0c093", opaque="5c"'
    )
    header = login.header("GET", "/dir/index.html")
    # without qop: MD5(MD5(user:realm:password):nonce:MD5(method:uri)), RFC 2069's form
    assert 'response="670fd8c2df070c60b045671b8b24ff02"' in header
    assert 'opaque="5c"' in header


def test_events_name_resource_and_value() -> None:
    link = '<a href="/rw/rapid/symbol/data/RAPID/T/m/v;value" rel="self"/>'
    text = f'<ul><li class="rap-data" title="v">{link}<span class="value">[1,2,3]</span></li></ul>'
    assert events_of(text) == [("/rw/rapid/symbol/data/RAPID/T/m/v;value", "[1,2,3]")]
    assert events_of(text.replace('<span class="value">[1,2,3]</span>', "")) == [
        ("/rw/rapid/symbol/data/RAPID/T/m/v;value", "")
    ]
