"""Frames of the plant's socket are those of docs/protocols/plant.md."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from polishd.sim_backends.common import runtime
from tests.unit.sim_backends.vectors import vectors

VECTORS = vectors("plant")
MESSAGES = {
    "hello": {"hello": "actuator", "pid": 4711, "t": 12.5},
    "samples": {"samples": [[12.5, 0.0], [12.51, 3.25]], "mark": 12.52},
    "engage": {"event": "engage", "t": 12.5},
    "touch": {"touch_um": 5000.0},
}
ROW = [7.0, 12.5, 12.52, 0.02, 1.0, -2.0, 0.5, 15.0, -90.0]


def test_all_vectors_are_tried() -> None:
    assert set(VECTORS) == {*MESSAGES, "rows"}


@pytest.mark.parametrize("name", MESSAGES)
async def test_messages(name: str) -> None:
    frame = bytes.fromhex(VECTORS[name])
    assert runtime.pack_json(MESSAGES[name]) == frame
    assert await read(frame) == MESSAGES[name]


async def test_rows() -> None:
    frame = bytes.fromhex(VECTORS["rows"])
    assert runtime.pack_rows(np.array([ROW])) == frame
    assert np.array_equal(await read(frame), [ROW])


async def read(frame: bytes) -> object:
    reader = asyncio.StreamReader()
    reader.feed_data(frame)
    reader.feed_eof()
    return await runtime.read_frame(reader)
