"""The local socket between the plant and the devices: who is there, what they do, and up to when they vouch for it.

A frame is ``u32 length, u8 kind, payload``: kind 0 is a JSON object, kind 1 float64 rows (see ``ROW``). Devices send
``{"mark": t}``: all that they did before ``t`` (time.monotonic) has been sent. The plant never integrates beyond the
earliest mark, so latency and order cannot corrupt the part.
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polishd.model.surface import FloatArray

ROW = ("seq", "wall0", "wall1", "dt", "x", "y", "z", "a", "c")
"""Columns of motion rows: block, wall seconds from and to, process seconds, pose half-way (program frame, mm, deg)."""

SOCKET = "plant.sock"
_HEAD = struct.Struct(">IB")

Message = dict[str, Any]


def pack_json(message: Message) -> bytes:
    """A JSON frame."""
    payload = json.dumps(message, separators=(",", ":")).encode()
    return _HEAD.pack(len(payload), 0) + payload


def pack_rows(rows: FloatArray) -> bytes:
    """A frame of (n, k) float64 rows."""
    body = np.ascontiguousarray(rows, dtype="<f8").tobytes()
    return _HEAD.pack(len(body) + 4, 1) + struct.pack(">I", rows.shape[1]) + body


async def read_frame(reader: asyncio.StreamReader) -> Message | FloatArray | None:
    """The next frame, or None at the end of the connection."""
    try:
        length, kind = _HEAD.unpack(await reader.readexactly(_HEAD.size))
        payload = await reader.readexactly(length)
    except (asyncio.IncompleteReadError, ConnectionError):
        return None
    if kind == 0:
        message: Message = json.loads(payload)
        return message
    (columns,) = struct.unpack_from(">I", payload)
    return np.frombuffer(payload, dtype="<f8", offset=4).reshape(-1, columns)


def socket_path(folder: int) -> str:
    """The socket's path through an open folder: the folder's own path may be too long for a socket address."""
    return f"/proc/self/fd/{folder}/{SOCKET}"


@dataclass
class PlantLink:
    """A device's end. Sends never wait; ``run`` reads until the plant is gone."""

    device: str
    welcome: Message
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    on_message: Callable[[Message | FloatArray], None] = field(default=lambda _message: None)
    on_force: Callable[[float], None] = field(default=lambda _acting_n: None)
    """Told what acts between tool and part now, in N."""

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Tell the witness what happened, and when (time.monotonic)."""
        self.ask(event=name, t=time.monotonic() if at_s is None else at_s, **data)

    def samples(self, values: list[tuple[float, float]], mark_s: float) -> None:
        """(time, value) points of this device's force or speed, and up to when they hold."""
        self.ask(samples=values, mark=mark_s)

    def rows(self, rows: FloatArray, mark_s: float, pose: tuple[float, ...]) -> None:
        """Motion since the last call, and the pose at its end; what is not covered by rows was standstill."""
        if len(rows):
            self.writer.write(pack_rows(rows))
        self.ask(mark=mark_s, pose=pose)

    def pace(self, pace: float, at_s: float) -> None:
        """Planned motion within a second of motion, from then on (time.monotonic)."""
        self.ask(pace=pace, t=at_s)

    def ask(self, **message: Any) -> None:
        """Any other message."""
        if not self.writer.is_closing():
            self.writer.write(pack_json(message))

    async def run(self) -> None:
        """Hand over what the plant says; returns when it is gone."""
        while (message := await read_frame(self.reader)) is not None:
            if isinstance(message, dict) and "acting_n" in message:
                self.on_force(float(message["acting_n"]))
            self.on_message(message)


async def connect(state: Path, device: str, **hello: Any) -> PlantLink:
    """Connect a device to the plant of that state folder and introduce it."""
    folder = os.open(state, os.O_RDONLY | os.O_DIRECTORY)
    try:
        reader, writer = await asyncio.open_unix_connection(socket_path(folder), limit=1 << 26)
    finally:
        os.close(folder)
    writer.write(pack_json({"hello": device, "pid": os.getpid(), "t": time.monotonic(), **hello}))
    welcome = await read_frame(reader)
    if not isinstance(welcome, dict):
        raise ConnectionError(f"the plant in {state} did not answer")
    return PlantLink(device, welcome, reader, writer)
