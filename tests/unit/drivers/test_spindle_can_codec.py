"""Frames of the spindle drive against the document's vectors, and against nonsense."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.drivers import spindle_can
from polishd.drivers.spindle_can import CanFrame, DriveState, DriveStatus, Heartbeat, SdoAnswer
from tests.vectors import vectors


def frame(name: str) -> CanFrame:
    identifier, _, data = vectors("spindle_can")[name].partition("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data))


def test_what_we_send_is_the_vectors() -> None:
    assert spindle_can.encode_command(5, run=True, counter=9, rpm=1000) == frame("run_1000_counter_9")
    assert spindle_can.encode_command(5, run=False, counter=10, rpm=0) == frame("stop_counter_10")
    assert spindle_can.encode_upload(5, spindle_can.SERIAL_NUMBER) == frame("identity_request")


def test_what_we_hear_is_the_vectors() -> None:
    assert spindle_can.decode(5, frame("status_at_speed")) == DriveStatus(DriveState.AT_SPEED, 9, 1000.0, 0)
    assert spindle_can.decode(5, frame("identity_answer")) == SdoAnswer(spindle_can.SERIAL_NUMBER, 12345, aborted=False)
    assert spindle_can.decode(5, frame("heartbeat")) == Heartbeat(boot=False)


@pytest.mark.parametrize("name", ["status_at_speed", "identity_answer", "heartbeat"])
def test_other_nodes_are_not_ours(name: str) -> None:
    assert spindle_can.decode(6, frame(name)) is None


@pytest.mark.parametrize(
    ("identifier", "data"),
    [
        (0x185, b""),
        (0x185, bytes(7)),
        (0x185, b"\x04" + bytes(7)),
        (0x705, b""),
        (0x705, b"\x04"),
        (0x705, b"\x05\x00"),
        (0x585, b"\x60" + bytes(7)),
        (0x585, b"\x43\x18\x10"),
        (0x205, bytes(8)),
        (0x080, b""),
    ],
)
def test_what_the_protocol_does_not_have_is_none(identifier: int, data: bytes) -> None:
    assert spindle_can.decode(5, CanFrame(identifier, data)) is None


def test_boot_abort_and_negative_speed() -> None:
    assert spindle_can.decode(5, CanFrame(0x705, b"\0")) == Heartbeat(boot=True)
    abort = spindle_can.decode(5, CanFrame(0x585, bytes.fromhex("8018100500000206")))
    assert abort == SdoAnswer(spindle_can.DriveObject(0x1018, 5), 0x06020000, aborted=True)
    backwards = spindle_can.decode(5, CanFrame(0x185, bytes.fromhex("0101f0d8ffff0000")))
    assert backwards == DriveStatus(DriveState.RAMPING, 1, -1000.0, 0)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_any_frame_is_survived(identifier: int, data: bytes) -> None:
    spindle_can.decode(5, CanFrame(identifier, data))
