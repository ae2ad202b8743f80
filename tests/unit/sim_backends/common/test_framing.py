"""The robot link's codec against the documented vectors, and through dirt."""

from __future__ import annotations

import random
import struct

import pytest

from polishd.sim_backends.common import framing as f
from tests.unit.sim_backends.vectors import vectors

VECTORS = {name: bytes.fromhex(value) for name, value in vectors("robot_link").items()}


def test_what_it_packs_is_what_the_page_shows() -> None:
    hello = {"protocol": 1, "role": "writer", "client": "t", "executed_from": 0, "lease": ""}
    assert f.pack_json(f.HELLO, hello) == VECTORS["HELLO"]
    assert f.pack_blocks(7, [b"G1 X1 F60", b"M2"]) == VECTORS["BLOCKS"]
    assert f.pack(f.ACCEPTED, struct.pack(">IId", 9, 512, 2.5)) == VECTORS["ACCEPTED"]
    assert f.pack_executed([(7, 1.0, 1.5)]) == VECTORS["EXECUTED"]
    assert f.pack(f.RESEND, struct.pack(">I", 7)) == VECTORS["RESEND"]
    nak = {"of": f.RESUME, "code": "stale", "text": "4 stops, not 3: look again"}
    assert f.pack_json(f.NAK, nak) == VECTORS["NAK"]


def test_what_the_page_shows_is_understood() -> None:
    got = dict(f.Splitter().feed(b"".join(VECTORS.values())))
    hello = {"protocol": 1, "role": "writer", "client": "t", "executed_from": 0, "lease": ""}
    assert f.unpack_json(got[f.HELLO]) == hello
    assert f.unpack_json(got[f.RESUME]) == {"until": None, "stops": 3}
    assert f.unpack_json(got[f.HOLD]) == {}
    assert f.unpack_blocks(got[f.BLOCKS]) == (7, [b"G1 X1 F60", b"M2"])
    assert f.unpack_executed(got[f.EXECUTED]) == [(7, 1.0, 1.5)]


def test_bytes_may_come_one_by_one() -> None:
    splitter, got = f.Splitter(), []
    for byte in b"".join(VECTORS.values()):
        got += splitter.feed(bytes([byte]))
    assert [kind for kind, _ in got] == [getattr(f, name) for name in VECTORS]


def test_garbage_between_frames_is_skipped() -> None:
    stream = b"PxPL" + VECTORS["HELLO"] + b"\0PP" + VECTORS["BLOCKS"] + b"P" + VECTORS["ACCEPTED"]
    splitter = f.Splitter()
    assert [kind for kind, _ in splitter.feed(stream)] == [f.HELLO, f.BLOCKS, f.ACCEPTED]


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_frame_is_never_acted_on_and_the_next_one_is(seed: int) -> None:
    rng = random.Random(seed)
    bad = bytearray(VECTORS["BLOCKS"])
    at = rng.randrange(len(bad))
    bad[at] ^= 1 << rng.randrange(8)
    got = list(f.Splitter().feed(bytes(bad) + VECTORS["ACCEPTED"] + VECTORS["HELLO"]))
    assert [kind for kind, _ in got] == [f.ACCEPTED, f.HELLO]


def test_a_huge_length_does_not_swallow_what_follows() -> None:
    splitter = f.Splitter()
    got = list(splitter.feed(b"PL\x03\0\xff\xff\xff\xff" + VECTORS["HELLO"]))
    assert [kind for kind, _ in got] == [f.HELLO]
    assert splitter.broken == 1


@pytest.mark.parametrize(
    "payload", [b"", b"\0" * 5, struct.pack(">IHH", 0, 1, 9) + b"abc", struct.pack(">IH", 0, 0) + b"x"]
)
def test_malformed_blocks(payload: bytes) -> None:
    assert f.unpack_blocks(payload) is None


@pytest.mark.parametrize("payload", [b"", b"[]", b"{", b"\xff"])
def test_malformed_json(payload: bytes) -> None:
    assert f.unpack_json(payload) is None
