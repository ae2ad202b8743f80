"""Registers and lines of the voice coil against the documents' vectors, and against nonsense."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceIdentity, ProtocolError
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.drives import ActuatorReading, reading_of
from polishd.drivers.transport import lines as numbered
from tests.fakes.actuator import Coil, ModbusCoil
from tests.fakes.devices_by_profile import shipped
from tests.vectors import vectors

MODBUS, LINES = shipped("voice_coil_modbus"), shipped("voice_coil_serial")
CONTACT = ActuatorReading("contact", 11.98, 12.0, 5.0, 0, "")
(LIVE,) = codec.blocks(MODBUS.registers, MODBUS.polled, 125)
(IDENTITY,) = codec.blocks(MODBUS.registers, MODBUS.identifying, 125)


def reading(words: Sequence[int]) -> ActuatorReading:
    return reading_of(MODBUS, codec.signed(MODBUS, codec.values_of(MODBUS, LIVE, words)))


def status(answer: str) -> ActuatorReading:
    return reading_of(LINES, codec.fields_of(LINES, LINES.asks["status"], answer))


def test_one_request_reads_all_that_changes() -> None:
    assert (LIVE.table, LIVE.address, LIVE.count) == ("input", 0, 6)
    assert (IDENTITY.table, IDENTITY.address, IDENTITY.count) == ("input", 100, 30)


def test_modbus_vectors_give_the_reading() -> None:
    frame = bytes.fromhex(vectors("voice_coil_modbus")["inputs"])
    words = struct.unpack(">6H", frame[3:-2])
    assert reading(words) == CONTACT
    assert codec.values_of(MODBUS, LIVE, words)["beat_echo"] == 7


@pytest.mark.parametrize(
    ("force_n", "register"), [(0.0, 0), (12.0, 1200), (0.01, 1), (50.0, 5000), (11.999, 1200), (0.29, 29)]
)
def test_set_points_are_hundredths(force_n: float, register: int) -> None:
    assert codec.words_for(MODBUS.registers["new_set_point"], "", force_n, "high_first", 1) == [register]


def test_pulling_is_negative() -> None:
    assert reading([2, 0xFFFE, 0, 5000, 0, 0]).force_n == -0.02


def test_unknown_states_are_protocol_errors() -> None:
    with pytest.raises(ProtocolError, match="state 5"):
        reading([5, 0, 0, 0, 0, 0])


def test_faults_have_words() -> None:
    assert reading([4, 0, 0, 0, 5, 0]).faults == "watchdog ran out, drive"
    assert CONTACT.faults == ""


def test_identity_registers_are_read() -> None:
    coil = Coil()
    coil.boots = 0x1_0002
    table = ModbusCoil(coil, rtu=True).registers()
    values = codec.values_of(MODBUS, IDENTITY, [table[IDENTITY.address + at] for at in range(IDENTITY.count)])
    assert codec.identity(MODBUS, values) == DeviceIdentity("Fake Coils", "FC-50", "SN-0042", "1.2", boot_id="65538")


def test_identity_of_other_bytes_is_a_protocol_error() -> None:
    with pytest.raises(ProtocolError, match="ASCII"):
        codec.values_of(MODBUS, IDENTITY, [0xFFFF] * 30)


def test_ascii_vectors() -> None:
    lines = vectors("voice_coil_serial")
    assert numbered.encode(7, "F,12.00") == lines["set_force"].encode() + b"\r\n"
    assert numbered.encode(8, "ST?") == lines["status_request"].encode() + b"\r\n"
    assert numbered.decode(lines["ok"].encode() + b"\r") == (7, "OK")
    answer = numbered.decode(lines["status"].encode())
    assert answer is not None
    assert answer[0] == 8
    assert status(answer[1]) == CONTACT


@given(st.integers(0, 0xFFFF), st.text("ABC?,.0123 -", min_size=1, max_size=60))
def test_lines_are_read_as_they_are_written(number: int, body: str) -> None:
    assert numbered.decode(numbered.encode(number, body).rstrip(b"\n")) == (number, body)


@given(st.binary(max_size=200))
def test_broken_lines_are_none(noise: bytes) -> None:
    answer = numbered.decode(noise)
    assert answer is None or numbered.encode(*answer).rstrip() == noise[noise.rfind(b"$") :].rstrip()


@pytest.mark.parametrize("at", range(len(numbered.encode(8, "ST?").strip())))
def test_a_flipped_bit_is_seen(at: int) -> None:
    broken = bytearray(numbered.encode(8, "ST?").strip())
    broken[at] ^= 0x02
    assert numbered.decode(bytes(broken)) is None


@pytest.mark.parametrize("line", [b"", b"$*00", b"$OK*04", b"$x,OK*4B", b"$123456,OK*1E", b"7,OK*1F", b"$7,OK*1f"])
def test_lines_without_sense_are_none(line: bytes) -> None:
    assert numbered.decode(line) is None


def test_noise_before_a_line_is_dropped() -> None:
    assert numbered.decode(b"\xff\x00$7,O$7,OK*1F") == (7, "OK")


@pytest.mark.parametrize(
    "body",
    ["ST", "OK", "ST,5,0.00,0.00,0,0", "ST,2,0.0,0.00,0,0", "ST,2,0.00,0.00,0", "ST,2,0.00,-1.00,0,0", "ST,2,,,,"],
)
def test_strange_status_is_a_protocol_error(body: str) -> None:
    with pytest.raises(ProtocolError, match="no such answer"):
        status(body)


@pytest.mark.parametrize("body", ["OK", "ID,a,b,c,d", "ID,a,b,c,d,e,f", "IX,a,b,c,d,e"])
def test_strange_identity_is_a_protocol_error(body: str) -> None:
    with pytest.raises(ProtocolError, match="no such answer"):
        codec.fields_of(LINES, LINES.asks["identity"], body)
