"""Requests and answers of the proxy, byte by byte, and what is refused."""

from __future__ import annotations

import struct

import pytest

from polishd.api import DeviceRefused, ProtocolError
from polishd.drivers.kuka_kvp.protocol import (
    KvpAnswer,
    KvpMessage,
    ProgramOrder,
    decode_answer,
    decode_values,
    encode_control,
    encode_read,
    encode_request,
    encode_texts,
)
from tests.vectors import vectors

VECTORS = vectors("kuka_kvp")


def test_requests_are_those_of_the_protocol_document() -> None:
    # samples of 3.5.7 (PING and @PROXY_PORT) and 3.6.1 (reset of the submit interpreter; polishd names the robot's)
    many = encode_request(0x0400, KvpMessage.READ_MANY, encode_read(["PING", "@PROXY_PORT"]))
    assert (
        many.hex()
        == "0400002406020004500049004e0047" + "00000b400050005200 4f00580059005f0050004f0052005400".replace(" ", "")
    )
    reset = encode_request(0x028C, KvpMessage.CONTROL, encode_control(ProgramOrder.RESET))
    assert reset.hex() == "028c00040a010001"
    read = encode_request(48, KvpMessage.READ, encode_texts("$OV_PRO"))
    assert read.hex() == VECTORS["read_request"]
    start = encode_request(0x028C, KvpMessage.CONTROL, encode_control(ProgramOrder.START))
    assert start.hex() == VECTORS["start_request"]


def test_answers_of_the_page_are_read() -> None:
    assert decode_answer(bytes.fromhex(VECTORS["read_answer"])) == (48, KvpAnswer(0, b"\0\003100", 1, True))
    assert decode_answer(bytes.fromhex(VECTORS["start_answer"])) == (0x028C, KvpAnswer(10, b"\2", 1, True))


def test_a_selection_names_the_module_and_forces_it() -> None:
    payload = encode_control(ProgramOrder.SELECT, "/R1/P")
    assert payload == b"\5\0\1" + struct.pack(">H", 5) + "/R1/P".encode("utf-16-le") + b"\0\0\1"


def test_an_answer_has_its_number_its_values_and_its_code() -> None:
    frame = bytes.fromhex("040000150602010002 33003700 01000331003000 3000000101")
    number, answer = decode_answer(frame)
    assert number == 0x0400
    assert answer == KvpAnswer(6, frame[5:-3], 1, True)
    assert decode_values(["A", "B"], answer) == {"A": "37", "B": "100"}


def test_a_variable_that_the_controller_does_not_have_is_named() -> None:
    payload = b"\2\1\0\1" + "7".encode("utf-16-le") + b"\0\0\0"
    with pytest.raises(DeviceRefused, match="no variable POLISHD_CLOCK"):
        decode_values(["$OV_PRO", "POLISHD_CLOCK"], KvpAnswer(6, payload, 0, False))


def test_values_of_an_answer_that_reports_an_error_are_not_used() -> None:
    payload = b"\1\1\0\1" + "7".encode("utf-16-le")
    assert decode_values(["$OV_PRO"], KvpAnswer(6, payload, 1, True)) == {"$OV_PRO": "7"}
    with pytest.raises(ProtocolError, match="no access in reading 1 variables"):
        decode_values(["$OV_PRO"], KvpAnswer(6, payload, 2, False))


@pytest.mark.parametrize("payload", [b"", b"\3", b"\1\1\0\5a\0", b"\1\1\0\1a\0b\0", b"\1\1"])
def test_an_answer_that_breaks_off_is_a_protocol_error(payload: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_values(["A"], KvpAnswer(6, payload, 1, True))


def test_a_frame_without_its_footer_is_a_protocol_error() -> None:
    with pytest.raises(ProtocolError, match="5 bytes"):
        decode_answer(bytes(5))
