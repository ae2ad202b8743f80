"""The robot link's frames and messages against the document's vectors, and against nonsense."""

from __future__ import annotations

import json
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import Executed, LinkError, ProtocolError
from polishd.drivers.robot_link import messages
from polishd.drivers.robot_link.frames import MAX_PAYLOAD, Frame, FrameReader, Kind, encode
from polishd.drivers.robot_link.record import ExecutionRecord
from tests.vectors import vectors

VECTORS = {name: bytes.fromhex(value) for name, value in vectors("robot_link").items()}
STATUS = {"state": "held", "program_sha256": "ab", "accepted": 9, "executed": 7, "buffer_s": 0.5, "boot_id": "b"}
WELCOME = {"protocol": 1, "vendor": "V", "model": "M", "serial": "S", "firmware": "F", "boot_id": "b"} | {
    "watchdog_s": 1,
    "window": 512,
    "status": STATUS,
}


def test_what_we_send_is_the_vectors() -> None:
    hello = {"protocol": 1, "role": "writer", "client": "t", "executed_from": 0}
    assert messages.command(Kind.HELLO, hello) == VECTORS["HELLO"]
    assert messages.blocks(7, [b"G1 X1 F60", b"M2"]) == VECTORS["BLOCKS"]


def test_what_we_hear_is_the_vectors() -> None:
    reader = FrameReader()
    accepted, executed = reader.feed(VECTORS["ACCEPTED"] + VECTORS["EXECUTED"])
    assert accepted.kind == Kind.ACCEPTED
    assert messages.accepted(accepted.payload) == (9, 512)
    assert executed.kind == Kind.EXECUTED
    assert messages.executed(executed.payload) == [Executed(7, 1.0, 1.5)]
    assert reader.skipped == 0


def test_frames_come_dribbled() -> None:
    reader = FrameReader()
    stream = b"".join(VECTORS.values())
    frames = [frame for at in range(len(stream)) for frame in reader.feed(stream[at : at + 1])]
    assert [frame.kind for frame in frames] == [Kind.HELLO, Kind.BLOCKS, Kind.ACCEPTED, Kind.EXECUTED]


@pytest.mark.parametrize("at", range(len(VECTORS["ACCEPTED"])))
def test_a_flipped_bit_costs_one_frame_and_no_other(at: int) -> None:
    broken = bytearray(VECTORS["ACCEPTED"])
    broken[at] ^= 0x08
    reader = FrameReader()
    frames = reader.feed(bytes(broken) + VECTORS["EXECUTED"])
    frames += reader.feed(bytes(1 << 20))  # where the length grew, what follows is looked at once the CRC is wrong
    assert [frame.kind for frame in frames] == [Kind.EXECUTED]


def test_impossible_lengths_are_not_waited_for() -> None:
    reader = FrameReader()
    huge = struct.pack(">2sBBI", b"PL", 0x86, 0, MAX_PAYLOAD + 1)
    odd = struct.pack(">2sBBI", b"PL", 0x86, 1, 2)
    assert [frame.kind for frame in reader.feed(huge + odd + VECTORS["ACCEPTED"])] == [Kind.ACCEPTED]
    assert reader.skipped == len(huge + odd)


def test_a_frame_inside_a_broken_one_is_found() -> None:
    outer = bytearray(encode(Kind.STATUS, VECTORS["EXECUTED"]))
    outer[-1] ^= 1
    assert [frame.kind for frame in FrameReader().feed(bytes(outer))] == [Kind.EXECUTED]


@given(st.lists(st.binary(max_size=60), max_size=20), st.integers(0, 2**32))
def test_frames_survive_any_cutting(payloads: list[bytes], seed: int) -> None:
    chance = random.Random(seed)
    stream = b"".join(encode(Kind.STATUS, payload) for payload in payloads)
    reader, frames = FrameReader(), []
    while stream:
        size = chance.randint(1, 40)
        frames += reader.feed(stream[:size])
        stream = stream[size:]
    assert frames == [Frame(Kind.STATUS, payload) for payload in payloads]
    assert reader.skipped == 0


@given(st.binary(max_size=300))
def test_nonsense_gives_nothing_and_harms_nothing(noise: bytes) -> None:
    reader = FrameReader()
    assert reader.feed(noise.replace(b"PL", b"??") + b"?") == []
    assert [frame.kind for frame in reader.feed(VECTORS["ACCEPTED"])] == [Kind.ACCEPTED]


def test_welcome_is_read() -> None:
    welcome = messages.welcome(json.dumps(WELCOME | {"later": "keys are ignored"}).encode())
    assert welcome.identity.vendor == "V"
    assert welcome.identity.boot_id == "b"
    assert (welcome.watchdog_s, welcome.window) == (1.0, 512)
    assert (welcome.progress.state, welcome.progress.accepted, welcome.progress.executed) == ("held", 9, 7)


@pytest.mark.parametrize(
    "change",
    [
        {"protocol": 2},
        {"protocol": None},
        {"vendor": 3},
        {"window": 0},
        {"window": "512"},
        {"watchdog_s": 0},
        {"watchdog_s": None},
        {"status": None},
        {"status": STATUS | {"state": "dancing"}},
        {"status": STATUS | {"accepted": -1}},
        {"status": STATUS | {"executed": 1.5}},
        {"status": STATUS | {"buffer_s": "much"}},
        {"status": STATUS | {"detail": 7}},
    ],
)
def test_a_strange_welcome_is_a_protocol_error(change: dict[str, object]) -> None:
    with pytest.raises(ProtocolError):
        messages.welcome(json.dumps(WELCOME | change).encode())


@pytest.mark.parametrize("payload", [b"", b"{", b"[]", b"\xff\xfe", b'"text"', b"{}"])
def test_strange_json_is_a_protocol_error(payload: bytes) -> None:
    for read in (messages.welcome, messages.ack, messages.nak, messages.status):
        with pytest.raises(ProtocolError):
            read(payload)


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\1", b"\0\1" + bytes(19), b"\0\1" + bytes(21), b"\0\0\0"])
def test_strange_binary_is_a_protocol_error(payload: bytes) -> None:
    for read in (messages.accepted, messages.executed, messages.resend):
        with pytest.raises(ProtocolError):
            read(payload)


def test_resend_is_read() -> None:
    assert messages.resend(struct.pack(">I", 70_000)) == 70_000


def test_the_record_has_no_gaps_and_no_doubles() -> None:
    record = ExecutionRecord("sha", "boot")
    record.extend([Executed(0, 0.0, 1.0), Executed(1, 1.0, 2.5)])
    record.extend([Executed(0, 9.0, 9.0), Executed(1, 9.0, 9.0), Executed(2, 2.5, 3.0)])
    assert [record[seq] for seq in range(len(record))] == [
        Executed(0, 0.0, 1.0),
        Executed(1, 1.0, 2.5),
        Executed(2, 2.5, 3.0),
    ]
    with pytest.raises(LinkError, match="blocks 3 to 4 were lost"):
        record.extend([Executed(5, 4.0, 5.0)])
    assert len(record) == 3
