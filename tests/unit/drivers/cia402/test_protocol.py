"""Frames of CANopen against the document's vectors, and against nonsense.

The power state machine of CiA 402, against the standard's table and against the simulated drive's own.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProtocolError
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.protocol import (
    Address,
    DriveState402,
    EmergencyMessage,
    NodeHeartbeat,
    NodeState,
    Request,
    SdoAborted,
    SdoValue,
    SdoWritten,
    power_up,
    state_of,
)
from polishd.drivers.transport.can_frames import CanFrame
from polishd.sim_backends.cia402 import device as stage
from polishd.sim_backends.cia402.device import Power
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


def test_received_frames_are_the_vectors() -> None:
    received = {
        "heartbeat": NodeHeartbeat(NodeState.OPERATIONAL),
        "boot": NodeHeartbeat(NodeState.BOOT),
        "status_word_enabled": SdoValue(STATUS, b"\x37\x06", sized=True),
        "written_target_velocity": SdoWritten(TARGET),
        "refused_mode": SdoAborted(MODE, 0x06090030),
        "emergency_heartbeat": EmergencyMessage(0x8130, 0x11),
        "emergency_over": EmergencyMessage(0, 0),
    }
    for name, message in received.items():
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


# CiA 402-2, table of the status word: xxxx xxxx x0xx 0000 and so on, here as (bits that count, their value).
TABLE = {
    "xxxxxxxxx0xx0000": DriveState402.NOT_READY,
    "xxxxxxxxx1xx0000": DriveState402.SWITCH_ON_DISABLED,
    "xxxxxxxxx01x0001": DriveState402.READY,
    "xxxxxxxxx01x0011": DriveState402.SWITCHED_ON,
    "xxxxxxxxx01x0111": DriveState402.ENABLED,
    "xxxxxxxxx00x0111": DriveState402.QUICK_STOP,
    "xxxxxxxxx0xx1111": DriveState402.FAULT_REACTION,
    "xxxxxxxxx0xx1000": DriveState402.FAULT,
}
BITS = [
    (int(text.replace("0", "1").replace("x", "0"), 2), int(text.replace("x", "0"), 2), state)
    for text, state in TABLE.items()
]
"""(mask, value, state)."""
SIMULATED = dict(
    zip(
        range(7),
        [
            DriveState402.SWITCH_ON_DISABLED,
            DriveState402.READY,
            DriveState402.SWITCHED_ON,
            DriveState402.ENABLED,
            DriveState402.QUICK_STOP,
            DriveState402.FAULT_REACTION,
            DriveState402.FAULT,
        ],
        strict=True,
    )
)


def of_the_table(word: int) -> DriveState402 | None:
    found = [state for mask, value, state in BITS if word & mask == value]
    assert len(found) <= 1
    return found[0] if found else None


def test_every_status_word_is_the_tables_state_or_none() -> None:
    for word in (low | high for low in range(0x80) for high in (0, 0x80, 0x1600, 0xFF80)):
        expected = of_the_table(word)
        if expected is None:
            with pytest.raises(ProtocolError, match="no state"):
                state_of(word)
        else:
            assert state_of(word) is expected


@pytest.mark.parametrize("state", SIMULATED)
def test_the_simulated_drive_tells_its_state(state: int) -> None:
    assert state_of(Power(state).status) is SIMULATED[state]


@pytest.mark.parametrize("state", SIMULATED)
def test_the_way_up_leads_there_from_every_state_but_faults(state: int) -> None:
    power = Power(state)
    for control, wanted in power_up(SIMULATED[state]):
        power.command(control)
        assert state_of(power.status) is wanted
    assert (power.state == stage.ENABLED) != SIMULATED[state].failed


@given(st.lists(st.integers(0, 0xFF)), st.sampled_from([stage.QUICK_STOP, stage.ENABLED, stage.READY]))
def test_no_control_words_but_a_reset_lead_out_of_a_fault(words: list[int], state: int) -> None:
    power = Power(state)
    power.fault()
    power.stands()
    for word in words:
        power.command(word & 0x7F)
        assert state_of(power.status).failed
    power.command(protocol.DISABLE_VOLTAGE)
    power.command(protocol.FAULT_RESET)
    assert state_of(power.status) is DriveState402.SWITCH_ON_DISABLED


@given(st.sampled_from(range(7)), st.lists(st.integers(0, 0xFFFF), max_size=20))
def test_a_quick_stop_ends_without_power_whatever_went_before(state: int, words: list[int]) -> None:
    power = Power(state)
    for word in words:
        power.command(word)
    power.command(protocol.QUICK_STOP)
    power.stands()
    assert not state_of(power.status).drives
