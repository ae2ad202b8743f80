"""The robot link's frames and messages against the document's vectors, and against nonsense."""

from __future__ import annotations

import hashlib
import json
import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.api import ExecutedBlock, LinkError, ProtocolError
from polishd.drivers.robot_link import protocol
from polishd.drivers.robot_link.driver import ExecutionRecord
from polishd.drivers.robot_link.protocol import MAX_PAYLOAD, Frame, FrameReader, FrameType, encode, header_check
from tests.vectors import vectors

VECTORS = {name: bytes.fromhex(value) for name, value in vectors("robot_link").items()}
STATUS = {
    "state": "held",
    "program_sha256": "ab",
    "accepted": 9,
    "executed": 7,
    "buffer_s": 0.5,
    "boot_id": "b",
    "stops": 0,
}
WELCOME = {"protocol": 1, "vendor": "V", "model": "M", "serial": "S", "firmware": "F", "boot_id": "b"} | {
    "watchdog_s": 1,
    "window": 512,
    "lease": "l1",
    "status": STATUS,
}


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_what_we_send_is_the_vectors() -> None:
    hello = {"protocol": 1, "role": "writer", "client": "t", "executed_from": 0, "lease": ""}
    assert protocol.command(FrameType.HELLO, hello) == VECTORS["HELLO"]
    lines = [b"G1 X1 F60", b"M2"]
    load = {"program_sha256": sha256(b"\n".join(lines)), "blocks_sha256": sha256(b"G1 X1 F60\nM2\n")}
    assert protocol.command(FrameType.LOAD, load | {"blocks": 2, "approach_blocks": 0}) == VECTORS["LOAD"]
    assert protocol.blocks(7, lines) == VECTORS["BLOCKS"]
    assert protocol.command(FrameType.RESUME, {"until": None, "stops": 3}) == VECTORS["RESUME"]
    assert protocol.command(FrameType.LIFT, {"distance_mm": 15.0}) == VECTORS["LIFT"]
    assert encode(FrameType.HOLD) == protocol.command(FrameType.HOLD, {}) == VECTORS["HOLD"]


def test_received_frames_are_the_vectors() -> None:
    reader = FrameReader()
    names = ("ACCEPTED", "EXECUTED", "RESEND", "NAK")
    accepted, executed, resend, nak = reader.feed(b"".join(VECTORS[name] for name in names))
    assert accepted.kind == FrameType.ACCEPTED
    assert protocol.accepted(accepted.payload) == (9, 512, 2.5)
    assert executed.kind == FrameType.EXECUTED
    assert protocol.executed(executed.payload) == [ExecutedBlock(7, 1.0, 1.5)]
    assert (resend.kind, protocol.resend(resend.payload)) == (FrameType.RESEND, 7)
    assert protocol.nak(nak.payload) == protocol.Nak(FrameType.RESUME, "stale", "4 stops, not 3: look again")
    assert reader.skipped == 0


def test_frames_come_dribbled() -> None:
    reader = FrameReader()
    stream = b"".join(VECTORS.values())
    frames = [frame for at in range(len(stream)) for frame in reader.feed(stream[at : at + 1])]
    assert [frame.kind for frame in frames] == [FrameType[name] for name in VECTORS]


@pytest.mark.parametrize("at", range(len(VECTORS["ACCEPTED"])))
def test_a_flipped_bit_costs_one_frame_and_no_other(at: int) -> None:
    broken = bytearray(VECTORS["ACCEPTED"])
    broken[at] ^= 0x08
    reader = FrameReader()
    frames = reader.feed(bytes(broken) + VECTORS["EXECUTED"])
    assert [frame.kind for frame in frames] == [FrameType.EXECUTED]


def test_impossible_lengths_are_not_waited_for() -> None:
    reader = FrameReader()
    huge = struct.pack(">2sBBI", b"PL", 0x86, header_check(0x86, MAX_PAYLOAD + 1), MAX_PAYLOAD + 1)
    odd = struct.pack(">2sBBI", b"PL", 0x86, header_check(0x86, 2) ^ 1, 2)
    assert [frame.kind for frame in reader.feed(huge + odd + VECTORS["ACCEPTED"])] == [FrameType.ACCEPTED]
    assert reader.skipped == len(huge + odd)


def test_a_frame_inside_a_broken_one_is_found() -> None:
    outer = bytearray(encode(FrameType.STATUS, VECTORS["EXECUTED"]))
    outer[-1] ^= 1
    assert [frame.kind for frame in FrameReader().feed(bytes(outer))] == [FrameType.EXECUTED]


@given(st.lists(st.binary(max_size=60), max_size=20), st.integers(0, 2**32))
def test_frames_survive_any_cutting(payloads: list[bytes], seed: int) -> None:
    chance = random.Random(seed)
    stream = b"".join(encode(FrameType.STATUS, payload) for payload in payloads)
    reader, frames = FrameReader(), []
    while stream:
        size = chance.randint(1, 40)
        frames += reader.feed(stream[:size])
        stream = stream[size:]
    assert frames == [Frame(FrameType.STATUS, payload) for payload in payloads]
    assert reader.skipped == 0


DAMAGE = st.tuples(
    st.sampled_from(["drop", "flip", "cut", "twice", "noise"]), st.integers(0, 1 << 16), st.integers(0, 7)
)


def damaged(frame: bytes, how: str, at: int, bit: int) -> bytes:
    """A frame as a bad wire hands it over; never the frame itself."""
    at %= len(frame)
    if how == "flip":
        return frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]
    return {"drop": b"", "cut": frame[:at], "twice": frame[:at] * 2, "noise": b"PL" * bit + b"P"}[how]


@pytest.mark.full
@settings(max_examples=300)
@given(st.lists(st.tuples(st.binary(max_size=40), st.none() | DAMAGE), max_size=30), st.integers(1, 50))
def test_sound_frames_among_damaged_ones_are_all_found_and_no_other(
    sent: list[tuple[bytes, tuple[str, int, int] | None]], size: int
) -> None:
    # a frame is marked, so that none is taken for another; a guard of zeros ends what a broken length waits for
    whole = [(encode(FrameType.STATUS, bytes([255, seq]) + payload), harm) for seq, (payload, harm) in enumerate(sent)]
    wire = b"".join(frame if harm is None else damaged(frame, *harm) for frame, harm in whole) + bytes(1 << 16)
    reader = FrameReader()
    found = [frame for at in range(0, len(wire), size * 40) for frame in reader.feed(wire[at : at + size * 40])]
    assert found == [Frame(FrameType.STATUS, frame[8:-4]) for frame, harm in whole if harm is None]


@given(st.binary(max_size=300))
def test_nonsense_gives_nothing_and_harms_nothing(noise: bytes) -> None:
    reader = FrameReader()
    assert reader.feed(noise.replace(b"PL", b"??") + b"?") == []
    assert [frame.kind for frame in reader.feed(VECTORS["ACCEPTED"])] == [FrameType.ACCEPTED]


def test_welcome_is_read() -> None:
    welcome = protocol.welcome(json.dumps(WELCOME | {"later": "keys are ignored"}).encode())
    assert welcome.identity.vendor == "V"
    assert welcome.identity.boot_id == "b"
    assert (welcome.watchdog_s, welcome.window, welcome.lease) == (1.0, 512, "l1")
    assert (welcome.progress.state, welcome.progress.accepted, welcome.progress.executed) == ("held", 9, 7)


@pytest.mark.parametrize(
    "change",
    [
        {"protocol": 2},
        {"protocol": None},
        {"vendor": 3},
        {"window": 0},
        {"window": "512"},
        {"lease": 5},
        {"watchdog_s": 0},
        {"watchdog_s": None},
        {"status": None},
        {"status": STATUS | {"state": "dancing"}},
        {"status": STATUS | {"accepted": -1}},
        {"status": STATUS | {"executed": 1.5}},
        {"status": STATUS | {"stops": None}},
        {"status": STATUS | {"buffer_s": "much"}},
        {"status": STATUS | {"detail": 7}},
    ],
)
def test_a_strange_welcome_is_a_protocol_error(change: dict[str, object]) -> None:
    with pytest.raises(ProtocolError):
        protocol.welcome(json.dumps(WELCOME | change).encode())


@pytest.mark.parametrize("payload", [b"", b"{", b"[]", b"\xff\xfe", b'"text"', b"{}"])
def test_strange_json_is_a_protocol_error(payload: bytes) -> None:
    for read in (protocol.welcome, protocol.ack, protocol.nak, protocol.status):
        with pytest.raises(ProtocolError):
            read(payload)


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\1", b"\0\1" + bytes(19), b"\0\1" + bytes(21), b"\0\0\0"])
def test_strange_binary_is_a_protocol_error(payload: bytes) -> None:
    for read in (protocol.accepted, protocol.executed, protocol.resend):
        with pytest.raises(ProtocolError):
            read(payload)


def test_resend_is_read() -> None:
    assert protocol.resend(struct.pack(">I", 70_000)) == 70_000


def test_the_record_has_no_gaps_and_no_doubles() -> None:
    record = ExecutionRecord("sha", "boot")
    record.extend([ExecutedBlock(0, 0.0, 1.0), ExecutedBlock(1, 1.0, 2.5)])
    record.extend([ExecutedBlock(0, 9.0, 9.0), ExecutedBlock(1, 9.0, 9.0), ExecutedBlock(2, 2.5, 3.0)])
    assert [record[seq] for seq in range(len(record))] == [
        ExecutedBlock(0, 0.0, 1.0),
        ExecutedBlock(1, 1.0, 2.5),
        ExecutedBlock(2, 2.5, 3.0),
    ]
    with pytest.raises(LinkError, match="blocks 3 to 4 were lost"):
        record.extend([ExecutedBlock(5, 4.0, 5.0)])
    assert len(record) == 3
