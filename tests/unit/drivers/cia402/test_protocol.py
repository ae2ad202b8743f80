"""Frames of CANopen against the document's vectors, and against nonsense."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.protocol import (
    Address,
    EmergencyMessage,
    NodeHeartbeat,
    NodeState,
    Request,
    SdoAborted,
    SdoValue,
    SdoWritten,
)
from polishd.drivers.transport.can_bus import CanFrame
from tests.vectors import vectors

ADDRESSES = st.builds(Address, st.integers(0, 0xFFFF), st.integers(0, 0xFF))
STATUS, TARGET, MODE = protocol.STATUS_WORD, protocol.TARGET_VELOCITY, protocol.MODE


def frame(name: str) -> CanFrame:
    identifier, _, data = vectors("cia402")[name].partition("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data))


def test_what_we_send_is_the_vectors() -> None:
    assert protocol.start_node(5) == frame("start_node")
    assert protocol.reset_communication(5) == frame("reset_communication")
    assert protocol.heartbeat(0x45) == frame("our_heartbeat")
    assert Request(STATUS).frame(5) == frame("read_status_word")
    assert Request(TARGET, (10_000).to_bytes(4, "little")).frame(5) == frame("write_target_velocity_10000")
    assert Request(MODE, b"\x03").frame(5) == frame("write_mode_velocity")


def test_what_we_hear_is_the_vectors() -> None:
    heard = {
        "heartbeat": NodeHeartbeat(NodeState.OPERATIONAL),
        "boot": NodeHeartbeat(NodeState.BOOT),
        "status_word_enabled": SdoValue(STATUS, b"\x37\x06", sized=True),
        "written_target_velocity": SdoWritten(TARGET),
        "refused_mode": SdoAborted(MODE, 0x06090030),
        "emergency_heartbeat": EmergencyMessage(0x8130, 0x11),
        "emergency_over": EmergencyMessage(0, 0),
    }
    for name, message in heard.items():
        assert protocol.decode(5, frame(name)) == message
        assert protocol.decode(6, frame(name)) is None


@pytest.mark.parametrize(
    ("identifier", "data"),
    [
        (0x705, ""),
        (0x705, "06"),
        (0x705, "0500"),
        (0x085, "308111"),
        (0x085, "308111000000000000"),
        (0x585, "4b416000370200"),
        (0x585, "4041600010000000"),  # segmented
        (0x585, "5b41600037020000"),
        (0x585, "6141600000000000"),
        (0x585, "c041600000000000"),
        (0x605, "4b41600037020000"),
        (0x185, "3702000000000000"),
    ],
)
def test_what_canopen_does_not_have_is_none(identifier: int, data: str) -> None:
    assert protocol.decode(5, CanFrame(identifier, bytes.fromhex(data))) is None


def test_only_silence_and_the_bus_are_of_the_connection() -> None:
    assert [
        code for code in (0x1000, 0x2310, 0x8110, 0x8130, 0x8140, 0x8210) if EmergencyMessage(code, 0).of_connection
    ] == [
        0x8110,
        0x8130,
        0x8140,
    ]


@given(ADDRESSES, st.binary(min_size=1, max_size=4))
def test_what_is_written_says_how_much_of_it_counts(address: Address, data: bytes) -> None:
    sent = Request(address, data).frame(5).data
    assert len(sent) == 8
    assert sent[0] & 0xE3 == 0x23
    assert sent[4 : 8 - (sent[0] >> 2 & 3)] == data


@given(ADDRESSES, ADDRESSES, st.booleans())
def test_an_answer_is_about_the_object_and_of_the_kind_that_was_asked_for(
    asked: Address, about: Address, write: bool
) -> None:
    request = Request(asked, b"\x01" if write else None)
    same = asked == about
    assert request.answered_by(SdoValue(about, b"\x01", sized=True)) == (same and not write)
    assert request.answered_by(SdoWritten(about)) == (same and write)
    assert request.answered_by(SdoAborted(about, 1)) == same


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_any_frame_is_survived(identifier: int, data: bytes) -> None:
    protocol.decode(5, CanFrame(identifier, data))


@given(st.sampled_from([0x585, 0x705, 0x085]), st.binary(max_size=8))
def test_of_our_drive_what_is_taken_is_whole(identifier: int, data: bytes) -> None:
    message = protocol.decode(5, CanFrame(identifier, data))
    assert message is None or len(data) == (1 if identifier == 0x705 else 8)
