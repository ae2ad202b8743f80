"""linuxcncrsh's lines, as a real one (2.9) sends them, and worse."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProtocolError
from polishd.drivers.linuxcnc.protocol import AXES, RshReply, RshSnapshot, asks, line_of, numbers_of, parse, status_of


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"HELLO ACK EMCNETSVR 1.1\r", RshReply("hello", True, "EMCNETSVR 1.1")),
        (b"HELLO NAK\r", RshReply("hello", False)),
        (b"\rSET ENABLE ACK", RshReply("set enable", True)),
        (b"SET RUN NAK", RshReply("set run", False)),
        (b"GET NONSENSE NAK\r", RshReply("get nonsense", False)),
        (b"PROGRAM_LINE 17\r", RshReply("get program_line", True, "17")),
        (b"PROGRAM_STATUS RUNNING\r", RshReply("get program_status", True, "RUNNING")),
        (b"OPERATOR_DISPLAY polishd ab12 4\r", RshReply("get operator_display", True, "polishd ab12 4")),
        (b"ERROR Bad character '?' used\r", RshReply("get error", True, "Bad character '?' used")),
        (b"INIFILE /etc/machine one.ini\r", RshReply("get inifile", True, "/etc/machine one.ini")),
    ],
)
def test_answers_are_understood(line: bytes, answer: RshReply) -> None:
    assert parse(line) == answer


@pytest.mark.parametrize("line", [b"", b"\r", b"set echo off\r", b"get estop", b"\xff\xfe", b"*", b"nonsense 1"])
def test_echoes_blank_lines_and_garbage_are_none(line: bytes) -> None:
    assert parse(line) is None


@given(st.binary(max_size=60))
def test_no_bytes_break_the_parser(line: bytes) -> None:
    answer = parse(line)
    assert answer is None or answer.to


@pytest.mark.parametrize(
    ("request_", "name"),
    [
        ("hello EMC polishd 1.0", "hello"),
        ("set run 5", "set run"),
        ("get error", "get error"),
        ("set abort", "set abort"),
    ],
)
def test_an_answer_names_its_request(request_: str, name: str) -> None:
    assert asks(request_) == name


def test_values_are_checked() -> None:
    assert status_of("PAUSED") == "paused"
    assert line_of("12") == 12
    assert numbers_of("1 2.5 -3 0 0 0", AXES) == (1.0, 2.5, -3.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("value", ["", "-1", "1.5", "RUNNING", "1 2"])
def test_no_line_number(value: str) -> None:
    with pytest.raises(ProtocolError, match="PROGRAM_LINE"):
        line_of(value)


@pytest.mark.parametrize("value", ["", "1 2 3", "1 2 3 4 5 nan", "1 2 3 4 5 6 7", "a b c d e f", "1 2 3 4 5 inf"])
def test_no_position(value: str) -> None:
    with pytest.raises(ProtocolError):
        numbers_of(value, AXES)


def test_no_status() -> None:
    with pytest.raises(ProtocolError, match="PROGRAM_STATUS"):
        status_of("ASLEEP")


def test_what_prints_alike_stands() -> None:
    here = RshSnapshot(1.0, 1, "running", (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), "")
    there = RshSnapshot(1.1, 1, "running", (0.0, 1.00001, 0.0, 0.0, 0.0, 0.0), "")
    assert not here.moved_since(here)
    assert there.moved_since(here)
