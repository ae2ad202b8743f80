"""Byte streams over real sockets and pseudo-terminals."""

from __future__ import annotations

import asyncio
import errno
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from polishd.api import ByteStream, DeviceClaimed, LinkError
from polishd.drivers.transport import streams
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.streams import LineReader, ReadBuffer, open_stream
from polishd.util import address_claims
from tests.fakes.wires import Peer, PtyWire, TcpWire
from tests.time_limits import within


class Recorder(Peer):
    """Peer that keeps the bytes that it receives."""

    def __init__(self) -> None:
        super().__init__()
        self.received = b""

    def on_bytes(self, data: bytes) -> None:
        self.received += data


Ends = tuple[ByteStream, PtyWire | TcpWire, Recorder]


@pytest.fixture(params=["tcp", "serial"])
async def ends(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[Ends]:
    peer = Recorder()
    wire: PtyWire | TcpWire
    if request.param == "tcp":
        wire = await TcpWire(peer).start()
        stream = await open_stream(Tcp("127.0.0.1", wire.port))
    else:
        wire = PtyWire(peer, tmp_path / "line")
        stream = await open_stream(SerialLine(wire.path))
    await asyncio.sleep(0.01)
    yield stream, wire, peer
    await stream.close()
    await stream.close()
    await wire.close()


async def test_bytes_go_both_ways(ends: Ends) -> None:
    stream, _, peer = ends
    await stream.write(b"there")
    while peer.received != b"there":  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    peer.send(b"and back")
    assert await stream.read(3, 1.0) == b"and"
    assert await stream.read(100, 1.0) == b" back"


async def test_silence_is_a_link_error_and_not_the_end(ends: Ends) -> None:
    stream, _, peer = ends
    with pytest.raises(LinkError, match=r"silent for 0\.01 s"):
        await stream.read(1, 0.01)
    peer.send(b"late")
    assert await stream.read(4, 1.0) == b"late"


async def test_a_cut_wakes_the_reader(ends: Ends) -> None:
    stream, wire, _ = ends
    reading = asyncio.create_task(stream.read(1, 9.0))
    await asyncio.sleep(0)
    wire.cut()
    with within(1.0), pytest.raises(LinkError):
        await reading
    with pytest.raises(LinkError):
        await stream.read(1, 9.0)
    with pytest.raises(LinkError):
        await stream.write(b"x" * 100)


async def test_a_closed_stream_says_so(ends: Ends) -> None:
    stream, _, _ = ends
    await stream.close()
    with pytest.raises(LinkError, match="closed"):
        await stream.read(1, 1.0)
    with pytest.raises(LinkError, match="closed"):
        await stream.write(b"x")


async def test_what_came_before_the_cut_is_read(tmp_path: Path) -> None:
    peer = Recorder()
    wire = await TcpWire(peer).start()
    stream = await open_stream(Tcp("127.0.0.1", wire.port))
    await asyncio.sleep(0.01)
    peer.send(b"last words")
    await asyncio.sleep(0.01)
    wire.cut()
    await asyncio.sleep(0.01)
    assert await stream.read(100, 1.0) == b"last words"
    with pytest.raises(LinkError):
        await stream.read(100, 1.0)
    await stream.close()
    await wire.close()


async def test_a_peer_that_takes_nothing_is_dead(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, wire, _ = ends
    monkeypatch.setattr(streams, "WRITE_S", 0.05)
    if isinstance(wire, PtyWire):
        asyncio.get_running_loop().remove_reader(wire._master)
    else:
        for client in wire._clients:
            client.pause_reading()
    with pytest.raises(LinkError, match="takes no data"):
        await stream.write(bytes(1 << 24))


async def test_no_peer_listens() -> None:
    with pytest.raises(LinkError, match=r"tcp://127\.0\.0\.1:9"):
        await open_stream(Tcp("127.0.0.1", 9))
    with pytest.raises(LinkError, match="serial:/nowhere/tty"):
        await open_stream(SerialLine(Path("/nowhere/tty")))


async def test_a_serial_line_is_ours_alone(tmp_path: Path) -> None:
    wire = PtyWire(Recorder(), tmp_path / "line")
    stream = await open_stream(SerialLine(wire.path))
    with pytest.raises(LinkError, match="another program has the port open"):
        await open_stream(SerialLine(wire.path))
    await stream.close()
    again = await open_stream(SerialLine(wire.path))
    await again.close()
    await wire.close()


async def test_a_late_wake_up_loses_nothing() -> None:
    buffer = ReadBuffer("it")
    taking = asyncio.create_task(buffer.read(10, 0.01))
    await asyncio.sleep(0)
    time.sleep(0.03)  # noqa: ASYNC251 -- the loop was stalled past the time, and the bytes came meanwhile
    buffer.feed(b"in time")
    assert await taking == b"in time"


async def test_lines_are_cut_out_of_anything(ends: Ends) -> None:
    stream, _, peer = ends
    lines = LineReader(stream, longest=10)
    for part in (b"one\ntw", b"o\n", b"x" * 35, b"\nthree\n"):
        peer.send(part)
        await asyncio.sleep(0.005)
    assert [await lines.next(1.0) for _ in range(3)] == [b"one", b"two", b"three"]
    peer.send(b"unfinished")
    with pytest.raises(LinkError, match="silent"):
        await lines.next(0.02)


async def test_an_address_that_another_program_has_is_not_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    """And once it is free it is claimed while the stream is open, and no longer."""
    connected = 0

    class Counts(Recorder):
        def on_connect(self) -> None:
            nonlocal connected
            connected += 1

    wire = await TcpWire(Counts()).start()
    there = Tcp("localhost", wire.port)
    with monkeypatch.context() as patched:

        def busy(path: Path) -> int:
            raise BlockingIOError(errno.EWOULDBLOCK, '{"pid": 7, "command": "polishd run", "cell": "north"}')

        patched.setattr(address_claims, "_lock_file", busy)
        with pytest.raises(DeviceClaimed, match=r"pid 7 \(polishd run\), cell 'north'"):
            await open_stream(there)
    await asyncio.sleep(0.05)
    assert connected == 0
    stream = await open_stream(there)
    held = set(stream.claimed.keys)
    assert f"tcp:localhost:{wire.port}" in held
    await stream.close()
    assert not stream.claimed.keys
    assert not held & set(address_claims._locks)
    await wire.close()
