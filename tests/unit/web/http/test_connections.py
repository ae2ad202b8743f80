"""Slow heads and floods of connections, at a real server: they are closed, and others are answered meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from polishd.web.http import server as connections
from tests.time_limits import SOON_S

ASK = b"GET / HTTP/1.1\r\nhost: a\r\n\r\n"


async def application(scope: Scope, receive: Receive, send: Send) -> None:
    await PlainTextResponse("ok")(scope, receive, send)


@pytest.fixture
async def port() -> AsyncIterator[int]:
    config = uvicorn.Config(
        application, port=0, http=connections.BoundedProtocol, ws="none", lifespan="off", log_level="error"
    )
    server = uvicorn.Server(config)
    config.load()
    server.lifespan = config.lifespan_class(config)
    await server.startup()
    try:
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


@contextlib.asynccontextmanager
async def connected(port: int) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def closed(reader: asyncio.StreamReader) -> bool:
    async with asyncio.timeout(SOON_S):
        try:
            return await reader.read() == b""
        except ConnectionError:
            return True


async def answered(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
    writer.write(ASK)
    async with asyncio.timeout(SOON_S):
        return b"200" in await reader.readuntil(b"ok")


async def tried(port: int) -> bool:
    async with connected(port) as later:
        try:
            return await answered(*later)
        except (asyncio.IncompleteReadError, ConnectionError):
            return False


async def test_a_head_that_comes_slowly_is_closed_and_others_are_answered(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.3)
    async with connected(port) as (slow, its_writer), connected(port) as again:
        its_writer.write(ASK[:-4])
        assert await answered(*again)
        assert await closed(slow)
        async with connected(port) as other:
            assert await answered(*other)


async def test_so_is_the_second_head_of_a_connection(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    async with connected(port) as (reader, writer):
        assert await answered(reader, writer)
        monkeypatch.setattr(connections, "HEAD_S", 0.2)
        writer.write(ASK[:-4])
        assert await closed(reader)


async def test_one_address_holds_so_many_open_and_no_more(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MOST_OF_ADDRESS", 2)
    async with connected(port) as first, connected(port) as second:
        assert await answered(*first)
        assert await answered(*second)
        async with connected(port) as (third, _):
            assert await closed(third)
    async with asyncio.timeout(SOON_S):  # it may not have noticed yet that they are gone
        while not await tried(port):
            pass


async def test_the_rest_of_a_body_that_was_answered_before_is_limited(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The application does not read the body of a GET; a drop of it now and then must not hold the connection open."""
    monkeypatch.setattr(connections, "HEAD_S", 0.2)
    async with connected(port) as (reader, writer):
        writer.write(b"GET / HTTP/1.1\r\nhost: a\r\ncontent-length: 1000000\r\n\r\n")
        async with asyncio.timeout(SOON_S):
            assert b"200" in await reader.readuntil(b"ok")
            ended = asyncio.create_task(closed(reader))
            while not ended.done():
                writer.write(b"x")
                await asyncio.wait([ended], timeout=0.02)
        assert ended.result()


async def test_a_body_that_ends_after_its_answer_leaves_the_connection_usable(port: int) -> None:
    async with connected(port) as (reader, writer):
        writer.write(b"POST / HTTP/1.1\r\nhost: a\r\ncontent-length: 3\r\n\r\n")
        async with asyncio.timeout(SOON_S):
            assert b"200" in await reader.readuntil(b"ok")
        writer.write(b"xyz")
        assert await answered(reader, writer)
